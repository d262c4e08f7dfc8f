# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Where G and Gn are not to be had: N/m alone is a result, and strokes are no presses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_helpers import answer, fden
from pipeline_helpers import begun

from benchmark.trial import fed
from fden_ros.core.strokes import REMEDY
from fden_ros.ros.status import PipelineProblems

SPRING = 1000.0  # [N/m]
RATE = 100.0
GEOMETRY = {"geometry.area": 7.85e-5, "geometry.thickness": 0.03}
CONFIG = """\
/**:
  ros__parameters:
    geometry: {area: 7.85e-5, thickness: 0.03}
    estimate: {period: 0.02}
"""


def pressed() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, force and depth of a press of a spring, with 0.02 N of noise and a bias of 0.4 N."""
    time = np.arange(0.0, 7.0, 1.0 / RATE)
    depth = 1e-3 * np.interp(time, [0.0, 2.0, 3.5, 5.5, 7.0], [-3.0, 0.0, 1.5, 1.5, -3.0])
    return time, _spring(depth) + 0.4, depth


def palpated(lowest: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of strokes of 3 mm at 1.5 Hz, from a depth [m] that is the lowest."""
    time = np.arange(0.0, 20.0, 1.0 / RATE)
    depth = lowest + 1.5e-3 * (1.0 - np.cos(2.0 * np.pi * 1.5 * time))
    return time, _spring(depth), depth


def _spring(depth: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(4).standard_normal(depth.size)
    return SPRING * np.maximum(depth, 0.0) + 0.02 * noise


def written(path: Path, columns: tuple[np.ndarray, ...]) -> Path:
    np.savetxt(path, np.stack(columns).T, delimiter=",", header="time_s,force_N,depth_m",
               comments="")  # fmt: skip
    return path


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "probe.yaml"
    path.write_text(CONFIG)
    return path


def test_linear_tissue_is_a_result_in_newtons_per_metre_with_one_line_that_says_why(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, config: Path
) -> None:
    table = written(tmp_path / "spring.csv", pressed())
    # G of a spring is known to a fifth.
    config.write_text(CONFIG + "    converged: {log_g_sd: 0.1}\n")
    assert fden("replay", table, "--config", config) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    words = " ".join(printed.out.split())
    assert "N/m known" in words
    assert words.split("contact 1: ")[1].startswith("N/m is known; G and Gn are not known: ")
    row = next(line for line in printed.out.splitlines() if line.startswith("1 "))
    assert row.split()[2].startswith(("(", "–"))
    found = answer(capsys, "replay", table, "--config", config)["contacts"][0]
    for name in ("apparent_stiffness", "measured_slope"):
        assert abs(found[name] - SPRING) < 4.0 * found[f"{name}_sd"]


def test_a_probe_that_never_lifts_is_told_what_to_write_and_then_has_its_stiffness(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, config: Path
) -> None:
    table = written(tmp_path / "strokes.csv", palpated(1e-3))
    assert fden("replay", table, "--config", config) == 3
    printed = capsys.readouterr()
    assert REMEDY in printed.err and "1.5 Hz" in printed.err
    assert "undetermined" not in printed.out  # no row of a table
    config.write_text(f"{config.read_text()}    {REMEDY}\n")
    assert fden("replay", table, "--config", config) == 0
    shown = capsys.readouterr().out
    assert "1 stiffness" in " ".join(shown.split()) or "stiffness, cut short" in shown


@pytest.mark.parametrize(("lowest", "is_told"), [(1e-3, True), (-1e-3, False)])
def test_strokes_are_told_from_presses_once_and_while_they_come(
    lowest: float, is_told: bool
) -> None:
    pipeline, _ = begun(GEOMETRY | {"estimator.kind": "ekf"})
    problems, said = PipelineProblems(pipeline), []
    for number, _ in enumerate(fed(pipeline, *palpated(lowest))):
        if number % RATE == 0:
            said.append(any(REMEDY in words for words in problems.look().warnings))
    pipeline.finish()
    assert pipeline.never_lifts is is_told
    # As what is odd about the input, for ten looks, and never again.
    assert sum(said) == (10 if is_told else 0)
    assert sum(REMEDY in words for words in pipeline.warnings) == is_told
