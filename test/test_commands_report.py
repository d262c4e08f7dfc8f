# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden report``: what the page says, and that a browser shows it without a complaint."""

from __future__ import annotations

import csv
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fden_ros.cli import main
from fden_ros.offline.session import (
    Innovations,
    Session,
    gather,
)
from fden_ros.parameters import read_parameter_file
from fden_ros.report import style
from fden_ros.report.sentence import sentence
from simulation.bag import write_recording
from simulation.scenario import Tissue, ramp_scenario
from simulation.simulate import simulate

GOLDEN = Path(__file__).parent.parent / "bags" / "golden"
POSE = GOLDEN / "golden_pose"
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
needs_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium is installed: sudo apt-get install chromium"
)


@pytest.fixture(scope="module")
def session() -> Session:
    return gather(POSE, read_parameter_file(POSE / "identifier.yaml"))


@pytest.fixture(scope="module")
def page(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from fden_ros.report.page import page

    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(page(session), encoding="utf-8")
    return path


def browse(page: Path, *options: str) -> tuple[str, list[str]]:
    """Return the page after its scripts ran, and what they, and the page's policy, complained."""
    assert CHROMIUM is not None
    done = subprocess.run(
        [
            *(CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"),
            *(f"--user-data-dir={page.parent / 'profile'}", "--enable-logging=stderr"),
            *(*options, f"file://{page}"),
        ],
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    return done.stdout, [line for line in done.stderr.splitlines() if ":CONSOLE" in line]


# The page


@needs_browser
def test_a_browser_shows_the_numbers_without_a_script_error(page: Path, session: Session) -> None:
    dom, complaints = browse(page, "--dump-dom")
    assert complaints == []
    text = re.sub(r"<[^>]+>", " ", dom)
    shown = np.array([float(number) for number in re.findall(r"\d+\.\d+", text)])
    for summary in session.replay.summaries:
        assert summary.estimate is not None
        for value in np.exp(summary.estimate[:2]):
            assert np.min(np.abs(shown / value - 1.0)) < 1e-3
    assert "2 contacts at 2 sites; all converged." in text
    assert dom.count('<details class="contact" open') == 2
    assert dom.count("<svg") == 3 + 4 * 2


def test_the_page_needs_nothing_from_elsewhere(page: Path) -> None:
    text = page.read_text()
    references = re.findall(r'(?:src|href|xlink:href)="([^"]*)"|url\(([^)]*)\)', text)
    assert references
    assert all((a or b).startswith(("#", "data:")) for a, b in references)
    assert "default-src 'none'" in text
    # Colours of the pictures come from the page.
    pictures = "".join(re.findall(r"<svg.*?</svg>", text, re.DOTALL))
    assert "var(--estimate)" in pictures
    assert not any(colour in pictures for colour in (style.ESTIMATE, style.INK, style.SHADE))


def test_text_from_the_recording_is_escaped(tmp_path: Path, session: Session) -> None:

    from fden_ros.report.page import page as render

    html = render(replace(session, path=Path("<script>alert(1)</script>"), contacts=[]))
    assert "<script>alert" not in html


def test_what_the_data_do_not_allow_is_said_in_words(tmp_path: Path) -> None:
    config = tmp_path / "narrow.yaml"
    text = (POSE / "identifier.yaml").read_text()
    # A stiffness this nonlinear would begin at strains that were not reached.
    config.write_text(
        text + "      nonlinear_stiffness: 2.0\n      nonlinear_stiffness_log_sd: 0.02\n"
    )
    cut = tmp_path / "cut.mcap"
    (source,) = POSE.glob("*.mcap")
    cut.write_bytes(source.read_bytes()[: source.stat().st_size // 3])
    out = tmp_path / "report.html"
    assert main(["report", str(cut), "--config", str(config), "-o", str(out)]) == 0
    said = out.read_text()
    assert "is cut off at byte" in said
    assert "The contact was cut short" in said
    assert "of 1 more G is known" in said
    assert "G is known, Gn is not observable: the strain reached" in said


def test_a_recording_without_contact_is_a_page_that_says_so(tmp_path: Path) -> None:
    table = tmp_path / "air.csv"
    table.write_text("t,f,d\n" + "".join(f"{i * 1e-2},0.0{i % 7},0\n" for i in range(300)))
    out = tmp_path / "report.html"
    assert main(["report", str(table), "--columns", "t,f,d", "-o", str(out)]) == 0
    assert "No contact was found" in out.read_text()


def test_one_sentence_says_what_it_is_how_stiff_and_what_to_do_next(tmp_path: Path) -> None:
    """Pressing as deep as the sentence says makes Gn known."""
    tissue = Tissue(linear_stiffness=520.0, nonlinear_stiffness=8.5, fractional_order=0.131)

    def said(strain: float) -> str:
        recording = simulate(
            ramp_scenario(strain_rate=0.2, max_strain=strain, tissue=tissue, rate_hz=250.0, seed=3)
        )
        bag = write_recording(recording, tmp_path / f"{strain}").path
        return sentence(gather(bag, read_parameter_file(bag / "identifier.yaml")))

    words = re.fullmatch(
        r"[\d.]+ ± [\d.]+ N/m at 1.6 mm; press to ([\d.]+) mm at .*; the target with \d+ %\.",
        said(0.08),
    )
    assert words is not None
    depth = float(words.group(1))
    assert re.fullmatch(r"Liver-like, [\d.]+ ± [\d.]+ N/m at [\d.]+ mm\.", said(depth / 20.0))


# Table


def test_the_table_has_a_row_a_contact(tmp_path: Path, session: Session) -> None:
    table = tmp_path / "contacts.csv"
    arguments = ("batch", str(POSE), "--config", str(POSE / "identifier.yaml"))
    assert main([*arguments, "--workers", "1", "-o", str(table)]) == 0
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["contact_id"]) for row in rows] == [1, 2]
    for row, summary in zip(rows, session.replay.summaries, strict=True):
        assert summary.estimate is not None and summary.position is not None
        assert float(row["g"]) == pytest.approx(np.exp(summary.estimate[0]), rel=1e-12)
        assert float(row["x"]) == summary.position[0]
        assert row["frame"] == "arm_base"


# What is gathered


def test_the_test_tells_large_and_coloured_innovations_from_right_ones() -> None:
    from fden_ros.core.estimation.estimator import Innovation

    def verdict(values: np.ndarray) -> str:
        innovations = Innovations()
        for value in values:
            innovations.add(Innovation(0.0, 0.0, float(value), 1.0))
        assert innovations.test is not None
        return innovations.test.verdict

    passed = 0
    for seed in range(200):
        white = np.random.default_rng(seed).normal(size=300)
        passed += verdict(white) == "as large as the noise explains; white"
        assert "larger than" in verdict(2.0 * white)
        assert "smaller than" in verdict(0.5 * white)
        assert "not white" in verdict(np.convolve(white, np.ones(4) / 2.0, "valid"))
    assert passed >= 190  # 98 % expected of the two tests of 99 %
