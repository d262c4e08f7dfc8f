# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables, links, commands and shown outputs of the pages are those of the code."""

from __future__ import annotations

import ast
import enum
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from fden_ros.cli import build_parser
from fden_ros.commands.parameters import parameter_file
from fden_ros.core import Decision, Flag, OrderSource, Phase, Status
from fden_ros.core.streams import Reason
from fden_ros.inputs import DAMAGED
from fden_ros.offline.replay import replay, result_object
from fden_ros.parameters import NODE_PARAMETERS, PARAMETERS, Parameters, read_parameter_file
from fden_ros.recording.source import Selection

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


def test_the_parameter_file_holds_every_parameter_at_its_default():
    path = ROOT / "config" / "identifier.yaml"
    assert path.read_text(encoding="utf-8") == parameter_file(), (
        "make it anew: scripts/ros_env scripts/tables"
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


def test_the_readme_shows_the_probe_of_the_example():
    assert text_of(EXAMPLES / "probe.yaml") in code_blocks(text_of("README.md"))


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
    parameters = read_parameter_file(EXAMPLES / "probe.yaml")
    result = result_object(replay(EXAMPLES / "press.csv", parameters, Selection()))
    named = enumeration(section("docs/interface.md", "## `fden replay --json`"))
    assert named == set(result) | set(result["contacts"][0])


def test_the_page_of_the_interface_has_every_message():
    named = enumeration(section("docs/interface.md", "## Messages").partition("###")[0])
    assert named == {path.stem for path in MESSAGES.glob("*.msg")}


def test_the_page_of_the_interface_has_every_topic_and_service_of_the_node(context):
    import rclpy
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    from fden_ros.nodes.identifier import Identifier

    inputs = {"frames.base": "base"}
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
    named = enumeration(section("docs/robots.md", "## Install"))
    calls = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Call)]
    declared = {
        call.args[0].value
        for call in calls
        if getattr(call.func, "id", "") == "DeclareLaunchArgument"
        and isinstance(call.args[0], ast.Constant)
    }
    assert named == declared


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


def test_tissue_is_identified_from_arrays_where_there_is_no_ros():
    command = [sys.executable, "-c", WITHOUT_ROS, "examples/identify_arrays.py"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    found = [float(number) for number in re.findall(r"[\d.]+\d", done.stdout)]
    assert found == pytest.approx([450.0, 9.0, 700.0, 8.0], rel=0.1)


def test_every_source_names_its_licence():
    header = "# SPDX-FileCopyrightText: 2026 fden_ros maintainers\n# SPDX-License-Identifier: "
    folders = ("examples", "fden_ros", "launch", "test")
    sources = [ROOT / "setup.py", *(p for f in folders for p in (ROOT / f).rglob("*.py"))]
    assert not [p for p in sources if not p.read_text(encoding="utf-8").startswith(header)]
