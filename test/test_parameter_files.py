# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Parameter files: the node and `fden replay` read them alike, and refuse them in one line."""

from __future__ import annotations

import contextlib
import gc
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped, WrenchStamped
from live_helpers import LIMIT
from rclpy.context import Context
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from sensor_msgs.msg import JointState

from fden_ros.cli import main
from fden_ros.nodes import identifier
from fden_ros.nodes.identifier import Identifier
from fden_ros.parameters import Parameters, read_parameter_file

BAG = Path(__file__).parent.parent / "bags" / "golden" / "golden_press"
NO_KEY = (
    "no mapping ros__parameters: parameters belong below `/**:`, or the node's name, and "
    "`ros__parameters:`; `fden parameters` prints a file"
)


def any_node(text: str) -> str:
    return f"/**:\n  ros__parameters: {{{text}}}\n"


def written(folder: Path, text: str | bytes | None) -> Path:
    path = folder / "probe.yaml"
    if text is not None:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def live_values(path: Path, node: str, context: Context) -> dict[str, Any]:
    """Every parameter of the identifier as a running node of this name has it."""
    namespace, _, name = node.rpartition("/")
    arguments = ["--ros-args", "--params-file", str(path)]
    arguments += ["-r", f"__ns:={namespace or '/'}", "-r", f"__node:={name}"]
    running = Identifier(context=context, cli_args=arguments)
    try:
        assert running.get_fully_qualified_name() == node
        names = Parameters().as_dict()
        values = {name: running.get_parameter(name).value for name in names}
        return {n: list(v) if hasattr(v, "tolist") else v for n, v in values.items()}
    finally:
        running.destroy_node()


AREA = {"geometry.area": 2e-4}


def sections(named: dict[str, str]) -> str:
    """Sections of a file: the name of the node, and its parameters."""
    return "".join(f"{name}:\n  ros__parameters: {{{text}}}\n" for name, text in named.items())


RIGHT, OTHER = "geometry.area: 2e-4", "geometry.area: 3e-4"
ACCEPTED: dict[str, tuple[str, str, dict[str, Any]]] = {
    "dotted": (any_node("geometry.area: 2.0e-4"), "/identifier", AREA),
    "1e-4 is a number": (
        any_node("force.noise: 1e-4, force.limit: 1E3, site.timeout: 5., prior.alpha: .2"),
        "/identifier",
        {"force.noise": 1e-4, "force.limit": 1e3, "site.timeout": 5.0, "prior.alpha": 0.2},
    ),
    "whole numbers for numbers": (
        any_node("force.axis: [0, 0, -1], force.limit: 10, dither.frequencies: [2]"),
        "/identifier",
        {"force.axis": [0.0, 0.0, -1.0], "force.limit": 10.0, "dither.frequencies": [2.0]},
    ),
    "by name and namespace": (
        sections({"/arm/identifier": RIGHT, "identifier": OTHER}),
        "/arm/identifier",
        AREA,
    ),
    "by another name": (sections({"probe": RIGHT}), "/probe", AREA),
    "one star is one part": (
        sections({"/*": OTHER, "/*/identifier": RIGHT}),
        "/arm/identifier",
        AREA,
    ),
    "two stars are any number of parts": (
        sections({"/**/identifier": RIGHT, "/arm/**": "geometry.thickness: 0.03"}),
        "/arm/left/identifier",
        {**AREA, "geometry.thickness": 0.03},
    ),
    "among others": (
        sections({"other": f"{OTHER}, none.of.ours: 1"}) + any_node(RIGHT),
        "/identifier",
        AREA,
    ),
    "with the node's own": (
        any_node(f"use_sim_time: true, autostart: true, source_timeout: 1, {RIGHT}"),
        "/identifier",
        AREA,
    ),
    "with an override of quality of service": (
        any_node("qos_overrides: {/force: {subscription: {reliability: reliable}}}"),
        "/identifier",
        {},
    ),
}


@pytest.mark.parametrize("case", ACCEPTED)
def test_node_and_replay_read_a_file_alike(case, tmp_path, context):
    text, node, meant = ACCEPTED[case]
    path = written(tmp_path, text)
    expected = Parameters().as_dict() | meant
    assert read_parameter_file(path, node).as_dict() == expected
    assert live_values(path, node, context) == expected


REFUSED: dict[str, tuple[str | bytes | None, str]] = {
    "no file": (None, "cannot read the parameter file: No such file or directory"),
    "misspelt key": (
        any_node("geometry.thicknes: 0.03"),
        "there is no parameter geometry.thicknes; did you mean geometry.thickness?",
    ),
    "a sphere without a radius": (
        any_node("geometry.kind: sphere"),
        "geometry.kind is sphere and geometry.radius is 0: state the radius [m]",
    ),
    "text for the node's truth value": (
        any_node("autostart: maybe"),
        "parameter autostart is 'maybe', must be true or false",
    ),
    "mixed list": (
        any_node("force.axis: [0, 0.5, -1]"),
        "parameter force.axis is [0, 0.5, -1], which ROS 2 cannot read, because it mixes whole "
        "numbers and others, or other types: write [0.0, 0.5, -1.0]",
    ),
    "no value": (any_node("geometry.area: "), "parameter geometry.area has no value"),
    "no mapping ros__parameters": ("geometry.area: 2.0e-4\n", NO_KEY),
    "nothing": ("", NO_KEY),
    "unparsable": (
        "/**: [\n",
        "not valid YAML: while parsing a flow node expected the node content, but found "
        "'<stream end>'",
    ),
    "a name twice": (
        "/**:\n  ros__parameters:\n    prior: {alpha: 0.2}\n    prior: {alpha_sd: 0.02}\n",
        "not valid YAML: prior appears twice in one mapping",
    ),
    "no text": (b"\xff\xfe\x00", "not valid YAML: 'utf-8' codec can't decode"),
    "for another node": (
        "/arm/identifier:\n  ros__parameters: {geometry.area: 2e-4}\n",
        "there is no section for the node /identifier, only for /arm/identifier: `/**` is for "
        "every node",
    ),
}


End = Callable[..., str]


@pytest.fixture
def end_of_node(capfd: pytest.CaptureFixture[str]) -> Iterator[End]:
    """The one line with which a node refuses to start, in this process: without a second each."""

    def late(*_: object) -> None:
        raise TimeoutError("the node runs")

    def end(*arguments: str) -> str:
        signal.alarm(round(LIMIT))
        assert identifier.main(["identifier", "--ros-args", *arguments]) == 1
        signal.alarm(0)
        captured = capfd.readouterr()
        (line,) = (captured.out + captured.err).splitlines()
        assert line.startswith("identifier: ")
        return line

    kinds = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    handlers = {kind: signal.getsignal(kind) for kind in kinds}
    signal.signal(signal.SIGALRM, late)
    yield end
    signal.alarm(0)
    for kind, handler in handlers.items():
        signal.signal(kind, handler)
    # Half-made nodes would be found by their name.
    gc.collect()


@pytest.mark.parametrize("case", REFUSED)
def test_node_and_replay_refuse_a_file_with_the_same_line(case, tmp_path, end_of_node, capfd):
    text, words = REFUSED[case]
    path = written(tmp_path, text)
    # Without autostart too: nothing waits to be configured with what was not meant.
    assert words in end_of_node("--params-file", str(path))
    assert main(["replay", str(BAG), "--config", str(path)]) == 1
    (line,) = capfd.readouterr().err.splitlines()
    assert f"{path}: " in line and words in line


def test_replay_reads_the_sections_of_the_node_that_is_named(tmp_path, capsys):
    path = written(tmp_path, "/arm/identifier:\n  ros__parameters: {geometry.aera: 2e-4}\n")
    assert main(["replay", str(BAG), "--config", str(path), "--node", "arm/identifier"]) == 1
    assert "there is no parameter geometry.aera" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ("--log-level", "loud"),
            "there is no log level loud: it must be one of debug, info, warn, error, fatal, unset",
        ),
        (
            ("-p", "geometry.area=1"),
            "-p geometry.area=1 is not a parameter: expected -p NAME:=VALUE",
        ),
        (("-p", "force.axis:=[1, 2"), "-p force.axis:=[1, 2: not valid YAML"),
        (
            ("--", "--params-file", "probe.yaml"),
            "--params-file counts only after --ros-args: put --ros-args before it",
        ),
    ],
)
def test_mistake_on_the_command_line_ends_the_node_with_one_line(arguments, words, end_of_node):
    assert words in end_of_node(*arguments)


@contextlib.contextmanager
def active(**options: Any) -> Iterator[Identifier]:
    node = Identifier(**options)
    try:
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS
        yield node
    finally:
        node.destroy_node()


def test_overrides_of_quality_of_service_are_those_of_the_remapped_topic(context):
    name = "qos_overrides./ft.subscription.reliability"
    arguments = ["--ros-args", "-r", "force:=ft", "-p", f"{name}:=reliable"]
    with active(context=context, cli_args=arguments) as node:
        assert node.get_parameter(name).value == "reliable"


@pytest.mark.parametrize(
    ("values", "force", "displacement"),
    [
        ({}, WrenchStamped, JointState),
        (
            {"force.message": "joint_state", "displacement.message": "pose"},
            JointState,
            PoseStamped,
        ),
        ({"displacement.message": "transform"}, WrenchStamped, TransformStamped),
        ({"displacement.message": "point"}, WrenchStamped, PointStamped),
    ],
)
def test_node_listens_to_the_types_that_the_parameters_name(values, force, displacement, context):
    overrides = [RosParameter(name, value=value) for name, value in values.items()]
    with active(context=context, parameter_overrides=overrides) as node:
        types = {one.topic_name: one.msg_type for one in Node.subscriptions.fget(node)}
    assert (types["/force"], types["/displacement"]) == (force, displacement)
