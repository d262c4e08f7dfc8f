# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The shape of `fden`, completion; `fden batch`, and continuous contact and reports from bags."""

from __future__ import annotations

import base64
import html
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_helpers import POSE, ROOT, answer, fden, points, rows_of
from geometry_msgs.msg import PointStamped, WrenchStamped
from matplotlib.font_manager import findfont
from PIL import Image
from rosbags.highlevel import AnyReader

from fden_ros.cli import COMMANDS, main
from fden_ros.core.outputs import Flag
from fden_ros.errors import InputError
from fden_ros.offline import batch
from fden_ros.offline.session import Session, gather
from fden_ros.parameters import check, read_parameter_file
from fden_ros.recording.source import Selection
from fden_ros.recording.writer import BagWriter
from fden_ros.report import style
from fden_ros.report.page import page as page_of
from fden_ros.report.sentence import sentence
from simulation.bag import write_recording
from simulation.scenario import Tissue, load_scenario, ramp_scenario
from simulation.simulate import simulate


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    shown = capsys.readouterr().out
    command = importlib.import_module(f"fden_ros.commands.{name}")
    assert ended.value.code == 0
    assert command.DESCRIPTION in shown and command.EPILOG in shown
    assert f"\nExit codes: 0 {getattr(command, 'EXIT_CODES', {}).get(0, 'done')[:20]}" in shown
    words = " ".join(shown.split())
    assert "2 wrong usage" in words and "130 ended by Ctrl-C" in words
    assert command.EPILOG.startswith("examples:\n") and f"fden {name}" in command.EPILOG


#: A command, its exit code, and words of the one line that says why.
REFUSALS = [
    ("configure {tmp}/nowhere.xlsx", 1, "does not exist"),
    ("configure {pose} --robot kuk", 2, "'kuka_iiwa'"),
    ("benchmark robots --cases frictio -o {tmp}", 1, "there is no case 'frictio'"),
    ("monitor --duration 0", 2, "expected a number above 0, got '0'"),
    ("train nowhere -o {tmp}/l.yaml", 1, "which tissue is it? Write TISSUE=nowhere"),
    ("replay {tmp}/nowhere", 1, "does not exist"),
    ("replay {tmp}/press.csv", 1, "has time, force, depth"),
    ("replay {pose} -o {pose} --force", 1, "the recording itself"),
    ("replay {pose} --force-topic /tool/wrench --force-field wrench.push", 1, "no push"),
    ("replay {pose} --diameter 50furlong", 2, "is not a size"),
    ("replay {pose} --diameter 5mm --area 1mm2", 2, "not allowed with"),
    ("replay http://127.0.0.1:1/press.mcap", 1, "http://127.0.0.1:1/press.mcap cannot be reached"),
]


@pytest.mark.parametrize(("command", "code", "words"), REFUSALS)
def test_what_cannot_be_done_is_one_line_and_an_exit_code(command, code, words, tmp_path, capsys):
    (tmp_path / "press.csv").write_text("time,force,depth\n0,1,2\n")
    places = {"tmp": tmp_path, "pose": POSE, "probe": ROOT / "examples" / "probe.yaml"}
    try:
        found = main([word.format(**places) for word in command.split()])
    except SystemExit as error:
        found = int(str(error.code))
    line = capsys.readouterr().err
    assert (found, line.count("\n")) == (code, 1) and words in line


START = 1_700_000_000_000_000_000


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("fden rep", "replay"),
        ("fden replay rec --conf", "--config"),
        ("fden configure rec --robot ", "kuka_iiwa"),
    ],
)
def test_a_shell_completes_commands_options_and_robots(line, word):
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line))}
    # argcomplete answers on this descriptor.
    command = f"exec 8>&1; exec {sys.executable} -m fden_ros.cli"
    environment = os.environ | asked
    done = subprocess.run(
        ["bash", "-c", command], env=environment, capture_output=True, text=True, check=False
    )
    assert word in done.stdout


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_line_that_the_installation_gives_makes_a_shell_complete_fden(shell, tmp_path):
    if shutil.which(shell) is None:
        pytest.skip(f"needs {shell}")
    script = (ROOT / "scripts" / "install").read_text(encoding="utf-8")
    says = script[script.index("shell=") : script.index("\n}\n", script.index("put_on_path()"))]
    path = f"export PATH={Path(sys.executable).parent}:$PATH"
    said = f"{says}\n}}\nput_on_path '{path}' | tail -n 1"
    environment = {"HOME": str(tmp_path), "PATH": os.environ["PATH"], "SHELL": f"/bin/{shell}"}
    run = {"env": environment, "capture_output": True, "text": True, "check": True}
    line = subprocess.run(["bash", "-ec", said], **run).stdout
    subprocess.run(["bash", "-ec", line], **run)
    asked = {"bash": "complete -p fden", "zsh": "print $_comps[fden]"}[shell]
    done = subprocess.run([shell, "-ic", asked], stdin=subprocess.DEVNULL, **run)
    assert "_python_argcomplete" in done.stdout
    assert "fden" not in done.stderr and "not found" not in done.stderr


def air(folder: Path, seed: int, count: int = 300) -> Path:
    """Write a bag of a probe in the air: quick to identify, with content of its own."""
    rng = np.random.default_rng(seed)
    with BagWriter(folder) as bag:
        bag.add_topic("/force", "geometry_msgs/msg/WrenchStamped")
        bag.add_topic("/displacement", "geometry_msgs/msg/PointStamped")
        for index in range(count):
            stamp = START + 2_000_000 * index
            for topic, message in (("/displacement", PointStamped()), ("/force", WrenchStamped())):
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
                if topic == "/force":
                    message.wrench.force.z = float(rng.normal(0, 1e-3))
                bag.write(topic, message, stamp)
    return folder


def test_processes_give_what_replay_gives_and_a_second_run_skips(tmp_path, capsys):
    archive = tmp_path / "archive"
    shutil.copytree(POSE, archive / "press")
    air(archive / "air", 1)
    (archive / "broken.mcap").write_text("no bag")
    table = tmp_path / "results.csv"
    config = str(POSE / "identifier.yaml")
    command = ("batch", archive, "-o", table, "--config", config, "--workers", "1")
    assert fden(*command) == 0
    said = capsys.readouterr()
    assert "3 bags, 0 of them done before, 1 broken; 2 new contacts" in said.out
    (line,) = (line for line in said.err.splitlines() if line.startswith("broken: "))
    assert str(archive / "broken.mcap") in line and "is not a bag" in line
    rows = sorted(rows_of(table), key=lambda row: row["bag"])
    assert [Path(row["bag"]).name for row in rows] == ["air", "broken.mcap", "press", "press"]
    assert [bool(row["error"]) for row in rows] == [False, True, False, False]
    assert rows[0]["contact_id"] == "" and "no contact was found" in rows[0]["warnings"]

    contacts = answer(capsys, "replay", POSE, "--config", config)["contacts"]
    for row, contact in zip(rows[2:], contacts, strict=True):
        for name in (
            *("g", "g_sd", "g_n", "max_force", "start_ns", "converged", "label"),
            *("apparent_stiffness", "apparent_stiffness_sd", "apparent_stiffness_time_scale"),
        ):
            assert row[name] == str(contact[name])
        assert [row[axis] for axis in "xyz"] == [str(value) for value in contact["position"]]
        known = " ".join(contact["converged_parameters"])
        assert row["converged_parameters"] == known != ""

    # What is new is done, and it alone.
    before = table.read_text()
    air(archive / "later", 2)
    assert fden(*command) == 0
    assert "4 bags, 3 of them done before, 0 broken" in capsys.readouterr().out
    assert table.read_text().startswith(before)


def test_bags_are_found_in_folders_and_by_patterns(tmp_path):
    air(tmp_path / "a" / "one", 1, 3)
    air(tmp_path / "a" / ".two.part", 2, 3)
    shutil.copy(tmp_path / "a" / "one" / "one.mcap", tmp_path / "a" / "bare.mcap")
    (tmp_path / "a" / "notes.txt").write_text("x")
    found = batch.find_bags([str(tmp_path / "a"), str(tmp_path / "a" / "*.mcap")])
    assert [path.name for path in found] == ["bare.mcap", "one"]
    with pytest.raises(InputError, match="holds no bag"):
        batch.find_bags([str(tmp_path / "nowhere")])


def test_a_bag_is_done_again_where_its_rows_are_cut_off_and_other_parameters_are_refused(tmp_path):
    work = batch.Work(check({}), Selection())
    bags = [str(air(tmp_path / f"bag{index}", index, 20)) for index in range(2)]
    other = batch.Work(check({"geometry.thickness": 0.03}), Selection())
    assert work.digest() == batch.Work(check({}), Selection()).digest() != other.digest()
    table = tmp_path / "results.csv"
    results = batch.Results(table, work.digest())
    for bag in bags:
        results.add(batch.identify(bag, work))
    whole = batch.Results(table, work.digest())
    assert whole.has(bags[0]) and whole.has(bags[1])
    with pytest.raises(InputError, match="made with other parameters"):
        batch.Results(table, other.digest())
    (row,) = batch.identify(bags[0], work)
    lacking = batch.Results(tmp_path / "lacking.csv", work.digest())
    lacking.add([row | {"contacts": 2}])
    assert not batch.Results(lacking.path, work.digest()).has(bags[0])
    # Killed while it wrote.
    table.write_text(table.read_text()[:-40])
    torn = batch.Results(table, work.digest())
    assert torn.has(bags[0]) and not torn.has(bags[1])
    torn.add(batch.identify(bags[1], work))
    assert [row["bag"] for row in rows_of(table)] == bags


def test_another_table_is_not_touched(tmp_path):
    path = tmp_path / "thesis.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="another kind"):
        batch.Results(path, "")
    path.write_bytes(bytes(range(128, 256)))
    with pytest.raises(InputError, match="not a table of results"):
        batch.Results(path, "")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("continuous") / "bag"
    write_recording(simulate(load_scenario("continuous")), folder)
    return folder


def test_a_path_is_identified_and_its_places_are_a_map(bag, tmp_path, capsys):
    out = tmp_path / "results"
    contacts = answer(capsys, "replay", bag, "--config", bag / "identifier.yaml", "-o", out)[
        "contacts"
    ]
    known = [one for one in contacts if one["apparent_stiffness"] is not None]
    assert len(known) > 20
    assert not any(one["converged"] for one in contacts)
    assert all(one["flags"] == ["touch_not_observed"] for one in contacts)
    assert {name for one in known for name in one["observable_parameters"]} <= {"fractional_order"}
    with AnyReader([out]) as reader:
        read = [
            (connection.topic, reader.deserialize(data, connection.msgtype))
            for connection, _, data in reader.messages()
        ]
    cloud = points([m for topic, m in read if topic == "/identifier/stiffness_map"][-1])
    assert cloud["stiffness"] == pytest.approx([o["apparent_stiffness"] for o in known])
    assert cloud["x"] == pytest.approx([o["position"][0] for o in known], abs=1e-6)


@pytest.fixture(scope="module")
def session() -> Session:
    return gather(POSE, read_parameter_file(POSE / "identifier.yaml"))


@pytest.fixture(scope="module")
def page(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(page_of(session), encoding="utf-8")
    return path


def test_the_page_needs_nothing_from_elsewhere(page):
    text = page.read_text()
    references = re.findall(r'(?:src|href|xlink:href)="([^"]*)"|url\(([^)]*)\)', text)
    assert references
    assert all((a or b).startswith(("#", "data:")) for a, b in references)
    assert "default-src 'none'" in text
    # Colours of the pictures come from the page.
    pictures = "".join(re.findall(r"<svg.*?</svg>", text, re.DOTALL))
    assert "var(--estimate)" in pictures
    assert not any(colour in pictures for colour in (style.ESTIMATE, style.INK, style.SHADE))


def test_text_from_the_recording_is_escaped(session):
    text = page_of(replace(session, path=Path("<script>alert(1)</script>"), contacts=[]))
    assert "<script>alert" not in text


def _of_three(session: Session, *, is_withheld: bool) -> Session:
    """Return a session of three contacts at one site; with nothing but the slope known."""
    first = session.contacts[0]
    assert first.summary is not None
    nothing = {"estimate": None, "apparent_stiffness": None, "flags": Flag.MODEL_MISMATCH,
               "converged": False, "classes": None} if is_withheld else {}  # fmt: skip
    width = 2_000_000_000
    times = [first.summary.start_ns + width * n for n in range(3)]
    contacts = [
        replace(first, contact_id=n + 1, summary=replace(
            first.summary, contact_id=n + 1, start_ns=start, end_ns=start + width // 2, **nothing))
        for n, start in enumerate(times)
    ]  # fmt: skip
    summaries = tuple(one.summary for one in contacts if one.summary is not None)
    return replace(session, contacts=contacts, replay=replace(session.replay, summaries=summaries))


CHROMIUM = shutil.which("chromium")
#: Shows a page at several widths, and writes what does not fit into the title.
_LOOK = """<body style="margin: 0"><iframe style="border: 0; height: 800px"></iframe><script>
const frame = document.querySelector("iframe"), found = {};
frame.onload = () => {
  const page = frame.contentDocument, all = [...page.querySelectorAll("body *")];
  for (const width of [400, 800, 1400]) {
    frame.style.width = width + "px";
    const wide = all.filter((one) => !one.closest("g, defs")
      && (one.getBoundingClientRect().right > width + 1
          || (one.scrollWidth > one.clientWidth + 1
              && getComputedStyle(one).overflowX != "visible")));
    const printed = [];
    for (const picture of page.querySelectorAll("svg")) {
      const texts = [...picture.querySelectorAll("text")];
      const boxes = texts.map((one) => one.getBoundingClientRect());
      boxes.forEach((a, n) => boxes.slice(n + 1).forEach((b) => {
        const across = Math.min(a.right, b.right) - Math.max(a.left, b.left);
        const down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        if (across > 2 && down > 0.4 * Math.min(a.height, b.height)) printed.push([across, down]);
      }));
    }
    found[width] = {
      wide: wide.map((one) => one.outerHTML.slice(0, 99)),
      overprinted: printed.length,
      bottom: page.querySelector(".lead strong").getBoundingClientRect().bottom,
      lead: page.querySelector(".lead strong").textContent,
    };
  }
  document.body.textContent = JSON.stringify(found);
};
frame.srcdoc = PAGE;
</script>"""


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
@pytest.mark.parametrize("kind", ["one", "three at one place", "withheld", "path"])
def test_a_browser_shows_the_stiffness_first_and_all_of_the_page_at_any_width(
    kind, session, bag, tmp_path
):
    if kind == "path":
        session = gather(bag, read_parameter_file(bag / "identifier.yaml"))
    elif kind != "one":
        session = _of_three(session, is_withheld=kind == "withheld")
    path = tmp_path / "look.html"
    source = json.dumps(page_of(session)).replace("</", "<\\/")
    path.write_text(_LOOK.replace("PAGE", source), encoding="utf-8")
    options = "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"
    place = f"--user-data-dir={tmp_path / 'profile'}"
    done = subprocess.run(
        [str(CHROMIUM), *options, place, "--virtual-time-budget=9000", path.as_uri()],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, timeout=120, check=True,
    )  # fmt: skip
    found = json.loads(html.unescape(re.sub(r"<[^>]*>", "", done.stdout)))
    for shown in found.values():
        assert shown["wide"] == []
        assert shown["overprinted"] == 0
        assert "N/m" in shown["lead"] and shown["bottom"] < 300


#: The report of golden_pose, 800 by 1600 pixels, in cells of 20 by 20 pixels.
_LOOKS = Path(__file__).with_name("report_800.png")
#: Largest mean difference of two pictures [of 255 levels]. Measured: 0.2 with another digit for
#: each, 4.9 with pictures of half their width, 7.6 without pictures.
_SAME_LOOK = 1.5


def _looks_of(page: str, folder: Path) -> Image.Image:
    """Return how a browser shows a page, with the font that matplotlib brings, in large cells."""
    font = base64.b64encode(Path(findfont("DejaVu Sans")).read_bytes()).decode()
    style = (
        f"<style>@font-face {{font-family: here; src: url(data:font/ttf;base64,{font})}}"
        "* {font-family: here !important}</style>"
    )
    page = page.replace("default-src 'none'", "default-src 'none'; font-src data:", 1)
    (folder / "page.html").write_text(page.replace("</head>", style + "</head>", 1))
    options = "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"
    place = f"--user-data-dir={folder / 'profile'}"
    subprocess.run(
        [str(CHROMIUM), *options, place, "--window-size=800,1600",
         f"--screenshot={folder / 'page.png'}", (folder / "page.html").as_uri()],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=120, check=True,
    )  # fmt: skip
    with Image.open(folder / "page.png") as shot:
        return shot.convert("L").resize((40, 80), Image.Resampling.BOX)


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_the_page_looks_as_it_did(session, tmp_path):
    looks = _looks_of(page_of(session), tmp_path)
    looks.save(tmp_path / _LOOKS.name)  # the new reference, if this look is wanted
    with Image.open(_LOOKS) as stored:
        difference = np.abs(np.asarray(looks, float) - np.asarray(stored, float)).mean()
    assert difference < _SAME_LOOK, f"look at {tmp_path / 'page.png'}"


def test_one_sentence_says_how_stiff_it_is_and_what_to_do_next(tmp_path):
    """Pressing as deep as the sentence says makes Gn known."""
    tissue = Tissue(linear_stiffness=520.0, nonlinear_stiffness=8.5, fractional_order=0.131)

    def said(strain: float) -> str:
        recording = simulate(
            ramp_scenario(strain_rate=0.2, max_strain=strain, tissue=tissue, rate_hz=250.0, seed=3)
        )
        bag = write_recording(recording, tmp_path / f"{strain}").path
        return sentence(gather(bag, read_parameter_file(bag / "identifier.yaml")))

    shallow = r"[\d.]+ ± [\d.]+ N/m at 1.6 mm; press to ([\d.]+) mm for Gn\."
    words = re.fullmatch(shallow, said(0.08))
    assert words is not None
    assert re.fullmatch(
        r"[\d.]+ ± [\d.]+ N/m at [\d.]+ mm, liver-like.*", said(float(words.group(1)) / 20.0)
    )
