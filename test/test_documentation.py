# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables, links, commands and outputs of the pages, paths of layouts: as in the code."""

from __future__ import annotations

import enum
import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import pytest

from fden_ros.cli import build_parser
from fden_ros.commands.parameters import parameter_file
from fden_ros.core import Decision, Flag, OrderSource, Phase, Status
from fden_ros.inputs import TYPE_NAMES
from fden_ros.offline.results import DIAGNOSTICS_TOPIC, NODE
from fden_ros.parameters import Parameters, read_parameter_file
from fden_ros.recording.message_types import message_class
from fden_ros.ros.messages import type_name
from fden_ros.ros.topics import OUTPUT_TOPICS

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
MESSAGES = ROOT / "msg_defs" / "msg"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.glob("*.md")])
BY_NAME = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def text_of(page: str | Path) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def code_blocks(text: str) -> list[str]:
    """Return the blocks that are indented by four, less the indentation."""
    blocks = re.findall(r"(?m)(?:^    .*\n(?:\s*\n(?=    ))?)+", text)
    return [re.sub(r"(?m)^    ", "", block).strip("\n") + "\n" for block in blocks]


def test_the_parameter_file_holds_every_parameter_at_its_default():
    path = ROOT / "config" / "identifier.yaml"
    assert path.read_text(encoding="utf-8") == parameter_file(), (
        "make it again: scripts/ros_env scripts/tables"
    )
    assert read_parameter_file(path) == Parameters()


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


@pytest.mark.parametrize("page", ["README.md", "docs/quickstart.md"])
def test_the_commands_of_a_page_print_what_is_shown_one_after_the_other(
    page, tmp_path, monkeypatch
):
    for name in ("examples", "bags", "scripts"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    assert shown_commands(page)
    for command, shown in shown_commands(page):
        done = subprocess.run(["bash", "-ec", command], stdout=subprocess.PIPE, check=True)
        assert_alike(done.stdout.decode(), shown)


@BY_NAME
def test_every_link_of_a_page_leads_somewhere(page):
    for target in re.findall(r"\]\(([^)#]*)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        if target and not target.startswith(("http://", "https://")):
            assert (page.parent / target).exists(), target


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
    named = {
        name
        for line in table.splitlines()[2:]
        for name in re.findall(r"`([^`]+)`", line.split("|")[1])
    }
    assert named == set(members(kind)) - ({"NONE"} if kind is Flag else set())


# Layouts of Foxglove and PlotJuggler

# The node's topics, and those of the bags that `fden bag` makes and of the node's defaults.
TYPES = {f"{NODE}/{topic.name}": type_name(topic.message_type) for topic in OUTPUT_TOPICS} | {
    DIAGNOSTICS_TOPIC: "diagnostic_msgs/msg/DiagnosticArray",
    "/force": "geometry_msgs/msg/WrenchStamped",
    "/displacement": TYPE_NAMES["displacement"][Parameters().displacement.message],
}


def read_by(path: str, separator: str) -> Any:
    """Return what stands at a path: a topic, and fields of its message, one of them indexed."""
    topic = max((one for one in TYPES if path.startswith(one)), key=len)
    value = message_class(TYPES[topic])()
    # PlotJuggler puts the joint's name between topic and field.
    fields = path.removeprefix(topic).replace("/probe", "").split(separator)[1:]
    for field in fields:
        name, _, index = field.partition("[")
        value = getattr(value, name)
        if index:
            assert (index, value.typecode) == ("0]", "d"), path
    return value


@pytest.mark.parametrize(
    ("layout", "separator"), [("foxglove_layout.json", "."), ("plotjuggler_layout.xml", "/")]
)
def test_every_path_of_a_layout_exists(layout, separator):
    text = (ROOT / "config" / layout).read_text(encoding="utf-8").replace(r"\"", '"')
    found = set(
        re.findall(r'[">](/(?:identifier|force|displacement|diagnostics)[^"<]*)["<]', text)
    )
    assert len(found) > 8
    for path in found:
        value = read_by(path, separator)
        assert path in TYPES or isinstance(value, (int, float)) or hasattr(value, "typecode"), path
    # What the layout's own script reads of a message.
    for fields in re.findall(r"const \{ (.*) \} = event.message;", text):
        message = message_class(TYPES["/identifier/estimate"])()
        assert all(hasattr(message, field) for field in fields.split(", "))
