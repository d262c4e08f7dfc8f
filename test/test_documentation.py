# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the documentation says is what the code does."""

from __future__ import annotations

import ast
import enum
import functools
import io
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from property_helpers import first
from prose_helpers import (
    BANNED,
    MOST_WORDS,
    comment_units,
    help_units,
    page_units,
    sentences,
    text_units,
    word_count,
)

import fden_ros.core
from fden_ros.cli import build_parser, main
from fden_ros.commands.parameters import parameter_file
from fden_ros.core import (
    Decision,
    Flag,
    OrderSource,
    Phase,
    Status,
    TissueState,
    paper_filter,
    site,
)
from fden_ros.core.contact import air
from fden_ros.core.estimation import (
    Estimate,
    ParameterSet,
    claims,
    hypothesis,
    law_error,
    maximum,
    press_estimate,
    scales,
    smooth_errors,
    whiteness,
)
from fden_ros.core.estimation.proposals import change
from fden_ros.core.outputs import ContactSummary, Output
from fden_ros.core.streams import Reason
from fden_ros.offline.replay import Replay, replay, result_object
from fden_ros.offline.session import gather
from fden_ros.parameters import NODE_PARAMETERS, PARAMETERS, Parameters, read_parameter_file
from fden_ros.recording.source import Selection
from fden_ros.recording.table import Columns
from fden_ros.report.sentence import sentence
from fden_ros.ros.inputs import DAMAGED
from simulation.bag import write_recording
from simulation.scenario import ramp_scenario
from simulation.simulate import EXACT, simulate

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
EXAMPLES = ROOT / "examples"
MESSAGES = ROOT / "msg_defs" / "msg"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.glob("*.md")])
BY_NAME = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
OF_THE_NODE = {parameter.name for parameter in NODE_PARAMETERS} | {"qos_overrides"}


def text_of(page: str | Path) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def section(page: str, heading: str) -> str:
    """Return what stands under a heading, up to the next one that is as high or higher."""
    level = heading.split()[0]
    rest = text_of(page).partition(f"\n{heading}\n")[2]
    assert rest, f"{page} has no section {heading!r}"
    return re.split(rf"(?m)^#{{1,{len(level)}}} ", rest, maxsplit=1)[0]


def rows(text: str) -> list[list[str]]:
    """Return the cells of all rows of tables, their headings left out."""
    found: list[list[str]] = []
    for line in text.splitlines():
        if line.startswith("| ---"):
            found.pop()
        elif line.startswith("|"):
            found.append([cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]])
    return found


def quoted(text: str) -> list[str]:
    return re.findall(r"`([^`]+)`", text)


def code_blocks(text: str) -> list[str]:
    """Return the blocks that are indented by four, less the indentation."""
    blocks = re.findall(r"(?m)(?:^    .*\n(?:\s*\n(?=    ))?)+", text)
    return [re.sub(r"(?m)^    ", "", block).strip("\n") + "\n" for block in blocks]


# Generated from the code


def test_the_parameter_file_holds_every_parameter_at_its_default():
    path = ROOT / "config" / "identifier.yaml"
    assert path.read_text(encoding="utf-8") == parameter_file(), (
        "make it anew: scripts/ros_env scripts/tables"
    )
    assert read_parameter_file(path) == Parameters()


# README


def shown_commands(page: str) -> list[tuple[str, str]]:
    """Return each command of a page that begins with $, with the output shown below it."""
    found = []
    for block in re.split(r"(?m)^(?= +\$ )", text_of(page))[1:]:
        command, _, rest = block.partition("\n")
        indent, _, command = command.partition("$ ")
        shown = re.match(rf"(?:(?:{indent}.*)?\n)*", rest)
        assert shown is not None
        found.append((command, shown.group()))
    return found


def assert_alike(printed: str, shown: str) -> None:
    """Check that words are those that are shown, and numbers but for one in the last digit."""
    number = re.compile(r"\d+(?:\.\d+)?")
    assert number.sub("0", printed).split() == number.sub("0", shown).split(), printed
    for one, other in zip(number.findall(printed), number.findall(shown), strict=True):
        digit = 10.0 ** -len(other.partition(".")[2])
        assert float(one) == pytest.approx(float(other), rel=1e-9, abs=1.01 * digit), printed


@pytest.mark.parametrize(("page", "count"), [("README.md", 1), ("docs/configure.md", 2)])
def test_the_commands_of_a_page_print_what_is_shown_one_after_the_other(
    page, count, tmp_path, monkeypatch, capsys
):
    assert len(shown_commands(page)) == count
    for name in ("examples", "bags", "scripts"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    for command, shown in shown_commands(page):
        program, name, *words = shlex.split(command)
        assert (program, name) == ("scripts/ros_env", "fden")
        if page == "README.md":
            # As a newcomer starts it.
            done = subprocess.run(["bash", "-ec", command], stdout=subprocess.PIPE, check=True)
            printed = done.stdout.decode()
        else:
            assert main(words) == 0
            printed = capsys.readouterr().out
        assert_alike(printed, shown)


def test_the_readme_has_at_most_120_lines_and_the_probe_of_the_example():
    text = text_of("README.md")
    assert len(text.splitlines()) <= 120
    assert text_of(EXAMPLES / "probe.yaml") in code_blocks(text)


PRESS = EXAMPLES / "press.csv"
IN_MM = "time_s,force_N,depth_mm*1e-3"
#: ln G, G in Pa s^alpha, and ln Gn of the two contacts.
TRUTH = np.log([[450.0, 9.0], [700.0, 8.0]])


@functools.cache
def _heard(changes: tuple[tuple[str, object], ...], columns: str, path: Path) -> Heard:
    outputs: list[Output] = []
    result = replay(
        path,
        read_parameter_file(EXAMPLES / "probe.yaml").changed(dict(changes)),
        Selection(columns=Columns.parse(columns)),
        on_output=lambda output, _frame: outputs.append(output),
    )
    return Heard(result, outputs)


class Heard(NamedTuple):
    """What the example's recording gives with other parameters than its own."""

    result: Replay
    outputs: list[Output]

    @property
    def summaries(self) -> list[ContactSummary]:
        return list(self.result.summaries)

    @property
    def estimates(self) -> list[Estimate]:
        return [summary.estimate for summary in self.summaries if summary.estimate is not None]

    @property
    def converged(self) -> list[bool]:
        return [summary.converged for summary in self.summaries]

    @property
    def stiffness(self) -> np.ndarray:
        """G [Pa s^alpha] and Gn [1] of both contacts, shape (2, 2)."""
        return np.exp([estimate[:2] for estimate in self.estimates])

    @property
    def errors(self) -> np.ndarray:
        """Of ln G and ln Gn in stated deviations, shape (2, 2)."""
        deviations = np.array([estimate.deviations[:2] for estimate in self.estimates])
        return np.abs(np.log(self.stiffness) - TRUTH) / deviations


def identified(changes: Mapping[str, object], columns: str = IN_MM, path: Path = PRESS) -> Heard:
    return _heard(tuple(changes.items()), columns, path)


def rows_between(path: Path, begin: float, end: float) -> Path:
    """Write the rows of the example between two times [s]; return the file."""
    head, *lines = PRESS.read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if begin < float(line.split(",")[0]) < end]
    path.write_text("\n".join([head, *kept]), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def first_press(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return rows_between(tmp_path_factory.mktemp("first") / "press.csv", -1.0, 6.25)


def test_a_bag_that_leaves_nothing_open_is_ten_times_sharper_as_is_said():
    for arm, exact in zip(identified({}).estimates, identified(EXACT).estimates, strict=True):
        assert np.all(arm.deviations[:2] > 10 * exact.deviations[:2])


def test_a_shallow_press_shows_as_is_said(tmp_path):
    heard = identified({}, path=rows_between(tmp_path / "press.csv", -1.0, 2.05))
    (estimate,) = heard.estimates
    assert heard.converged == [False]
    assert estimate.observable == estimate.known == ParameterSet.LINEAR_STIFFNESS
    g_n = estimate.nonlinear_stiffness
    assert g_n == pytest.approx(4.83, abs=0.01)
    assert g_n * estimate.deviations[1] == pytest.approx(3.53, abs=0.02)
    probe = read_parameter_file(EXAMPLES / "probe.yaml")
    columns = Selection(columns=Columns.parse(IN_MM))
    words = sentence(gather(tmp_path / "press.csv", probe, columns))
    assert f"`{words}`" in text_of("docs/recordings.md")


#: Three standard deviations either way hold Gn from 16.5 to 54.7.
NARROW = {"prior.nonlinear_stiffness": 30.0, "prior.nonlinear_stiffness_log_sd": 0.2}


def test_a_prior_that_excludes_the_tissue_shows_as_is_said(first_press):
    heard = identified(NARROW)
    for summary, estimate in zip(heard.summaries, heard.estimates, strict=True):
        assert not summary.converged and summary.flags & Flag.AT_PRIOR_LIMIT
        assert summary.classes is None
        assert ParameterSet.NONLINEAR_STIFFNESS in estimate.at_edge
    assert heard.stiffness[:, 1] == pytest.approx([11.2, 9.2], abs=0.1)
    states = [output for output in heard.outputs if isinstance(output, TissueState)]
    assert states and all(state.status is not Status.CONVERGED for state in states)
    wide = {**NARROW, "prior.nonlinear_stiffness_log_sd": 1.0, **EXACT}
    heard = identified(wide, path=first_press)
    assert all(heard.converged)
    assert heard.stiffness[:, 1] == pytest.approx([9.0], rel=0.025)


@pytest.mark.parametrize("delay", [-0.01, 0.01])
def test_a_delay_of_10_ms_shows_as_is_said(delay, first_press):
    heard = identified({"displacement.delay": delay})
    assert not heard.converged[0]
    assert heard.summaries[0].flags == Flag.RIG_PRIOR_CONFLICT
    assert heard.summaries[1].flags in (Flag.NONE, Flag.RIG_PRIOR_CONFLICT)
    assert np.all(heard.errors < 1.7)
    exact = identified({**EXACT, "displacement.delay": delay}, path=first_press)
    for summary, estimate in zip(exact.summaries, exact.estimates, strict=True):
        assert not summary.converged
        assert summary.flags & (Flag.MODEL_MISMATCH | Flag.TISSUE_CHANGED)
        assert estimate.deviations[0] > 0.33


@pytest.mark.parametrize("delay", [-0.01, 0.01, *first(0.02, -0.02, -0.0025)])
def test_a_delay_gives_no_wrong_number_under_a_good_status(delay, first_press):
    path = PRESS if abs(delay) == 0.01 else first_press
    heard = identified({"displacement.delay": delay}, path=path)
    claims = [
        (output.site_id, output.estimate)
        for output in (heard.outputs if abs(delay) <= 0.01 else heard.summaries)
        if isinstance(output, TissueState | ContactSummary) and output.estimate is not None
    ]
    assert claims
    for site_id, estimate in claims:
        error = np.abs(estimate.mean - [*TRUTH[site_id - 1], 0.131])
        for index in range(3):
            assert not estimate.knows(index) or error[index] < 5.0 * estimate.deviations[index]


# What a rig leaves open


def costs() -> list[list[str]]:
    return rows(section("docs/robots.md", "## What the rig may have"))


def test_the_page_on_robots_has_the_default_of_every_parameter_of_what_is_not_known():
    stated = {quoted(row[0])[0]: row[1] for row in costs() if quoted(row[0])}
    assert set(stated) == set(EXACT) - {"converged.log_gn_sd"}
    for name, value in stated.items():
        scale, _, unit = value.partition(" ")
        factor = {"mm": 1e-3, "mN": 1e-3, "mm/N": 1e-3, "ms": 1e-3, "%": 1e-2}[unit]
        assert float(scale) * factor == pytest.approx(Parameters().as_dict()[name]), name


@pytest.mark.parametrize("row", costs(), ids=lambda row: row[0])
def test_what_is_not_known_costs_as_much_as_the_page_on_robots_says(row, first_press):
    left_out = {} if row[0] == "all" else dict(EXACT)
    for name in quoted(row[0]):
        del left_out[name]
    deviations = identified(left_out, path=first_press).estimates[0].deviations
    assert deviations == pytest.approx([float(cell) for cell in row[-3:]], rel=0.02, abs=6e-5)


# All pages


@BY_NAME
def test_every_link_of_a_page_leads_somewhere(page):
    for target in re.findall(r"\]\(([^)#]*)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        if target and not target.startswith(("http://", "https://")):
            assert (page.parent / target).exists(), target


@BY_NAME
def test_every_file_that_a_page_names_is_there(page):
    places = (ROOT, ROOT / "fden_ros", ROOT / "fden_ros" / "core")
    names = re.findall(r"`([\w/]+/\w+\.(?:py|md|msg|html|xml|json|rviz))`", text_of(page))
    for name in names:
        assert any((place / name).exists() for place in places), name


@BY_NAME
def test_every_bare_file_that_a_page_names_is_there(page):
    folders = ("benchmark", "config", "examples", "fden_ros", "launch", "simulation", "test")
    known = {path.name for folder in folders for path in (ROOT / folder).rglob("*.*")}
    known |= {path.name for path in ROOT.glob("*.py")}
    for name in re.findall(r"`(\w+\.(?:py|c|h))`", text_of(page)):
        assert name in known, name


def test_every_class_that_the_page_on_the_design_names_is_there():
    sources = [p for folder in ("fden_ros", "msg_defs") for p in (ROOT / folder).rglob("*.*")]
    code = " ".join(p.read_text("utf-8") for p in sources if p.suffix in (".py", ".msg", ".srv"))
    for name in re.findall(r"\b(?:[A-Z][a-z]+){2,}\b", text_of("docs/design.md")):
        assert re.search(rf"\b{name}\b", code), name


DEFAULTS = {parameter.name: parameter.default for parameter in (*PARAMETERS, *NODE_PARAMETERS)}
TISSUE_ESTIMATE = "msg_defs/msg/TissueEstimate.msg"
#: What pages and messages say of numbers of the code, and the numbers.
SAID = [
    ("docs/interface.md", "`other_law_probability` above {}", hypothesis.MISMATCH),
    (TISSUE_ESTIMATE, "other_law_probability is above {};", hypothesis.MISMATCH),
    ("docs/interface.md", "more than {:g} standard deviations off the prior", claims.EDGE),
    (TISSUE_ESTIMATE, "over {:g} standard deviations off its prior: see", claims.EDGE),
    ("docs/interface.md", "within {:g} standard deviations of", press_estimate._CONTRADICTION),
    ("docs/interface.md", "compliance is more than {} standard", site._CONTRADICTION),
    (TISSUE_ESTIMATE, "compliance is over {} standard", site._CONTRADICTION),
    ("fden_ros/offline/remarks.py", "more than {} standard deviations off", site._CONTRADICTION),
    ("docs/robots.md", "1 + (deviations / {})²", site._CONTRADICTION),
    ("docs/interface.md", "{} of ln G (`conv", DEFAULTS["converged.log_g_sd"]),
    ("docs/interface.md", "{} of ln Gn (`conv", DEFAULTS["converged.log_gn_sd"]),
    ("docs/interface.md", "{} (`converged.alpha_sd`)", DEFAULTS["converged.alpha_sd"]),
    ("docs/interface.md", "probability {} (`conv", DEFAULTS["converged.probability"]),
    ("docs/interface.md", "more than `lag_deadline`, {} s", DEFAULTS["lag_deadline"]),
    ("docs/interface.md", "for {} s (`source_timeout`)", DEFAULTS["source_timeout"]),
    ("docs/robots.md", "and {} times as much (`scales.py`)", scales.MOTION_FACTORS[-1]),
    (TISSUE_ESTIMATE, "above {} of the largest strain", law_error._LOADED),
    ("msg_defs/msg/PalpationSummary.msg", "above {} of the largest strain", law_error._LOADED),
    ("docs/design.md", "innovation beyond {:g} deviations", whiteness.NO_CHANCE),
    ("docs/design.md", "by less than {:.4f}", maximum.CONVERGED),
    ("docs/design.md", "u^2 / (u^2 + {}^2)", smooth_errors.STRAIN_FLOOR),
    ("docs/design.md", "log evidence gains {}", change.THRESHOLD),
    ("docs/design.md", "at most {} apart", 2.0 * paper_filter._MEMBER_SD),
    ("docs/design.md", "with a probability of {:.0e}", air._CHANCE),
    ("config/identifier.yaml", "with a probability of {:.0e}", air._CHANCE),
]


@pytest.mark.parametrize(("page", "words", "value"), SAID)
def test_a_number_that_is_said_is_that_of_the_code(page, words, value):
    text = re.sub(r"[\s#\"]+", " ", text_of(page))
    assert words.format(value).replace("e-0", "e-") in text


@pytest.mark.parametrize("page", ["README.md", "QUALITY_DECLARATION.md"])
def test_as_many_faults_are_said_as_the_page_on_faults_has(page):
    count = sum(bool(quoted(row[0])) for row in rows(text_of("docs/faults.md")))
    assert f"{count} faults" in text_of(page)


@BY_NAME
def test_every_parameter_that_a_page_names_exists(page):
    groups = {parameter.name.split(".")[0] for parameter in PARAMETERS}
    known = {parameter.name for parameter in PARAMETERS} | OF_THE_NODE
    for name in re.findall(r"`([a-z_]+\.[a-z_]+)(?:: [^`]*)?`", text_of(page)):
        if name.split(".")[0] in groups and not name.endswith((".py", ".md", ".csv")):
            assert name in known or name.partition(".")[2] in REASONS, name


@BY_NAME
def test_every_fden_command_of_a_page_is_understood(page):
    parser = build_parser()
    lines = [line for block in code_blocks(text_of(page)) for line in block.splitlines()]
    for line in lines:
        found = re.match(r"(?:\$ )?(?:scripts/ros_env )?fden (.*)", line.strip())
        if found and not re.search(r"\b(KIND|BAG|NAME|DIR)\b", found.group(1)):
            words = shlex.split(found.group(1).partition(" > ")[0], comments=True)
            try:
                parser.parse_args(words)
            except SystemExit as error:
                assert not error.code, line  # 0: --help


@pytest.mark.parametrize("page", ["docs/configure.md", "docs/recordings.md"])
def test_the_commands_of_a_page_run_beside_the_files_that_they_name(
    page, first_press, tmp_path, monkeypatch
):
    bag = tmp_path / "presses"
    write_recording(simulate(ramp_scenario(strain_rate=0.3, hold_s=0.3, rate_hz=100.0)), bag)
    (mcap,) = bag.glob("*.mcap")
    files = {"press.mcap": mcap, "palpation.mcap": mcap, "palpation": bag}
    files |= {"press.csv": first_press, "archive": bag}
    command = re.compile(r"(?m)^ {4}(?:scripts/ros_env )?fden ((?:configure|re|batch).*)$")
    lines = [line for line in command.findall(text_of(page)) if not re.search("/plc/|://", line)]
    assert lines
    for number, line in enumerate(lines):
        folder = tmp_path / str(number)
        folder.mkdir()
        probe = EXAMPLES / "probe.yaml" if "press.csv" in line else bag / "identifier.yaml"
        for name, file in {**files, "probe.yaml": probe}.items():
            if f"-o {name}" not in line:
                (folder / name).symlink_to(file)
        monkeypatch.chdir(folder)
        assert main(shlex.split(line, comments=True)) == 0, line


def test_the_commands_of_the_page_on_plans_run_one_after_the_other(tmp_path, monkeypatch):
    for name, file in {"press.csv": PRESS, "config": ROOT / "config"}.items():
        (tmp_path / name).symlink_to(file)
    monkeypatch.chdir(tmp_path)
    lines = re.findall(r"(?m)^ {4}fden ((?:configure|plan|re).*)$", text_of("docs/plan.md"))
    assert len(lines) >= 3
    for line in lines:
        words, _, target = line.partition(" > ")
        printed = io.StringIO()
        with redirect_stdout(printed):
            assert main(shlex.split(words, comments=True)) == 0, line
        if target:
            Path(target).write_text(printed.getvalue(), encoding="utf-8")


# Words


def assert_plain(units: Iterable[str]) -> None:
    """Check that no sentence is long, and that none has a word that no user reads."""
    units = list(units)
    assert units
    spoken = [sentence for unit in units for sentence in sentences(unit)]
    assert not [words for words in spoken if word_count(words) > MOST_WORDS]
    assert not [words for words in spoken if BANNED.search(words)]


@BY_NAME
def test_the_sentences_of_a_page_are_short_and_plain(page):
    assert_plain(page_units(text_of(page)))


@pytest.mark.parametrize("path", sorted(MESSAGES.parent.glob("*/*.[ms][sr][gv]")))
def test_the_comments_of_a_message_are_short_and_plain(path):
    assert_plain(comment_units(text_of(path)))


def test_helps_and_descriptions_are_short_and_plain():
    assert_plain(help_units(build_parser()))
    assert_plain(parameter.description for parameter in (*PARAMETERS, *NODE_PARAMETERS))


def test_the_texts_of_the_code_are_short_and_plain():
    paths = sorted((ROOT / "fden_ros").rglob("*.py"))
    assert_plain(unit for path in paths for unit in text_units(text_of(path)))
    page = re.sub(r"(?s)<(style|script)>.*?</\1>", "", text_of("fden_ros/report/page.html"))
    assert_plain(re.findall(r">([^<>{}]+)<", page))


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (page_units, "A page.\n\n- An item\n  of {}.\n\n    code"),
        (page_units, "| a | b |\n| --- | --- |\n| short | {} |"),
        (comment_units, "float64 x    # one\nfloat64 y    # {}\n             # two"),
        (text_units, 'def f(n):\n    """Doc."""\n    raise ValueError(f"no {{n}} {}")'),
    ],
)
def test_a_long_sentence_is_found_wherever_it_stands(read, text):
    assert_plain(read(text.format("some words and no more")))
    for words in ("such a long word " * 8, "what a user is told of it"):
        with pytest.raises(AssertionError):
            assert_plain(read(text.format(words)))


# The interface


def enumeration(table: str) -> set[str]:
    return {name for row in rows(table) for name in quoted(row[0])}


def constants_of(message: str, prefix: str) -> dict[str, int]:
    """Return the constants of a message by their names without the prefix."""
    pattern = rf"(?m)^uint\d+ {prefix}_(\w+) *= (\d+)"
    return {name: int(value) for name, value in re.findall(pattern, text_of(MESSAGES / message))}


def members(kind: type[enum.IntEnum] | type[enum.IntFlag]) -> dict[str, int]:
    return {name: int(member) for name, member in kind.__members__.items()}


@pytest.mark.parametrize(
    ("prefix", "kind", "message"),
    [
        ("STATUS", Status, "TissueEstimate.msg"),
        ("FLAG", Flag, "TissueEstimate.msg"),
        ("PHASE", Phase, "TissueEstimate.msg"),
        ("ALPHA", OrderSource, "TissueEstimate.msg"),
        ("DECISION", Decision, "TissueClassification.msg"),
    ],
)
def test_the_page_of_the_interface_has_every_value_of_an_enumeration(prefix, kind, message):
    assert constants_of(message, prefix) == members(kind)
    page = text_of("docs/interface.md")
    heading = {"ALPHA": "`alpha_source`", "FLAG": "`flags`"}.get(prefix, f"`{prefix.lower()}`")
    table = page.partition(f"| {heading}")[2].partition("\n\n")[0]
    named = {name for line in table.splitlines()[2:] for name in quoted(line.split("|")[1])}
    assert named == set(members(kind)) - ({"NONE"} if kind is Flag else set())


def test_the_page_of_the_interface_says_which_fields_each_bit_of_valid_covers():
    table = rows(section("docs/interface.md", "### `valid` of an estimate"))
    bits = {quoted(row[0])[0].removeprefix("VALID_"): int(row[1]) for row in table}
    assert {"NONE": 0, **bits} == constants_of("TissueEstimate.msg", "VALID")
    covered = [name for row in table for name in quoted(row[2])]
    fields = re.findall(
        r"(?m)^[\w/]+(?:\[\d*\])?\s+([a-z]\w*)\s*(?:#.*)?$",
        text_of(MESSAGES / "TissueEstimate.msg"),
    )
    always = ["header", "status", "flags", "valid", "site_id", "contact_id"]
    always += ["phase", "lag"]
    assert sorted(covered + always) == sorted(fields)


REASONS = [value for name, value in vars(Reason).items() if name.isupper()] + [DAMAGED]


def test_the_page_of_the_interface_has_every_reason_to_reject_a_sample():
    assert enumeration(section("docs/interface.md", "## Diagnostics")) == set(REASONS)


def test_the_page_of_the_interface_has_every_key_of_the_json():
    result = result_object(identified({}).result)
    named = enumeration(section("docs/interface.md", "## `fden replay --json`"))
    assert named == set(result) | set(result["contacts"][0])


def test_the_page_of_the_interface_has_every_message():
    named = enumeration(section("docs/interface.md", "## Messages").partition("###")[0])
    assert named == {path.stem for path in MESSAGES.glob("*.msg")}


def test_the_page_of_the_interface_has_every_topic_and_service_of_the_node(context):
    import rclpy
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    from fden_ros.nodes.identifier import Identifier

    inputs = {"surface.message": "pose", "frames.base": "base"}
    overrides = [rclpy.parameter.Parameter(name, value=value) for name, value in inputs.items()]
    node = Identifier(context=context, parameter_overrides=overrides)
    try:
        node.trigger_configure()
        node.trigger_activate()
        me, own = node.get_name(), f"/{node.get_name()}/"
        absolute = ("/diagnostics", "/tf", "/tf_static")
        topics = {
            name.replace(own, "~/").removeprefix("" if name in absolute else "/"): types
            for find in (
                node.get_publisher_names_and_types_by_node,
                node.get_subscriber_names_and_types_by_node,
            )
            for name, types in find(me, "/")
            if name not in ("/rosout", "/parameter_events", f"{own}transition_event")
        }
        services = {
            name.replace(own, "~/"): types
            for name, types in node.get_service_names_and_types_by_node(me, "/")
            if types[0].startswith(("std_srvs/", "fden_msgs/"))
        }
        table = {quoted(row[0])[0]: row for row in rows(section("docs/interface.md", "## Topics"))}
        assert set(table) == set(topics)
        for name, types in topics.items():
            assert types[0].replace("/msg/", "/") in quoted(table[name][1]), name
            full = name.replace("~/", own) if name.startswith(("~", "/")) else f"/{name}"
            infos = [*node.get_publishers_info_by_topic(full)]
            infos += node.get_subscriptions_info_by_topic(full)
            profile = next(i.qos_profile for i in infos if i.node_name == me)
            reliable = profile.reliability == ReliabilityPolicy.RELIABLE
            latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            assert (reliable, latched) == (
                "reliable" in table[name][2],
                "latched" in table[name][2],
            ), name
        listed = rows(section("docs/interface.md", "## Services"))
        assert {quoted(row[0])[0]: quoted(row[1])[0] for row in listed} == {
            name: types[0].replace("/srv/", "/") for name, types in services.items()
        }
    finally:
        node.destroy_node()


def test_the_page_on_robots_has_every_argument_of_the_launch_file():
    source = (ROOT / "launch" / "identifier.launch.py").read_text(encoding="utf-8")
    named = enumeration(section("docs/robot.md", "## Install"))
    calls = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Call)]
    declared = {
        call.args[0].value
        for call in calls
        if getattr(call.func, "id", "") == "DeclareLaunchArgument"
        and isinstance(call.args[0], ast.Constant)
    }
    assert named == declared


# Examples


def test_the_examples_stand_in_the_pages_as_they_are():
    def body(name: str) -> str:
        _, quotes, rest = text_of(EXAMPLES / name).partition('"""')
        return quotes + rest

    identify = body("identify_arrays.py").partition('"""\n\n')[2]
    assert identify in code_blocks(text_of("README.md"))
    core = next(b for b in code_blocks(text_of("docs/controller.md")) if b.startswith("known ="))
    assert all(line in body("controller.py") for line in core.splitlines())


WITHOUT_ROS = """
import runpy, sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in ("rclpy", "rcl_interfaces", "ament_index_python") or top.endswith("_msgs"):
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, NoRos())
runpy.run_path(sys.argv[1])
"""


def test_tissue_is_identified_from_arrays_in_eleven_lines_where_there_is_no_ros():
    example = EXAMPLES / "identify_arrays.py"
    lines = example.read_text(encoding="utf-8").partition('"""\n\n')[2].splitlines()
    assert len([line for line in lines if line]) <= 11
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_ROS, str(example)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    shown = next(b for b in code_blocks(text_of("docs/python.md")) if b.startswith("(4"))
    found, told = (
        [float(number) for number in re.findall(r"[\d.]+\d", text)]
        for text in (done.stdout, shown)
    )
    assert found == pytest.approx(told, rel=1e-5)
    heard = identified({})
    assert found == pytest.approx(heard.stiffness.ravel(), rel=1e-8)  # all printed digits
    # What an arm leaves open is in the deviations; without it the truth is met within 1 %.
    assert np.all(heard.errors < 2.5)
    assert identified(EXACT).stiffness == pytest.approx(np.exp(TRUTH), rel=0.01)


def test_every_public_name_of_the_core_is_documented():
    named = set(re.findall(r"\w+", text_of("docs/python.md")))
    assert set(fden_ros.core.__all__) <= named


def test_every_source_names_its_licence():
    header = "# SPDX-FileCopyrightText: 2026 fden_ros maintainers\n# SPDX-License-Identifier: "
    folders = ("examples", "fden_ros", "launch", "test")
    sources = [ROOT / "setup.py", *(p for f in folders for p in (ROOT / f).rglob("*.py"))]
    assert not [p for p in sources if not p.read_text(encoding="utf-8").startswith(header)]
