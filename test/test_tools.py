# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tools that turn while they press: their weight, and a probe that advances along its own axis."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fault_helpers import Outcome, assert_alike, first_press, turn_of, undisturbed
from geometry_msgs.msg import PoseStamped, WrenchStamped
from pipeline_helpers import DISPLACEMENT, FORCE, Item
from scipy.spatial.transform import Rotation

from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.rotation import Transform
from fden_ros.core.streams.tool import ToolPath, ToolPathConfig, ToolWeight
from fden_ros.parameters import check, pipeline_config
from fden_ros.recording.cdr import serialize
from fden_ros.ros.decoding import fast_handler
from fden_ros.ros.inputs import Inputs
from fden_ros.ros.messages import to_stamp

Pose = tuple[np.ndarray, Rotation]
KINDS = {"force": WrenchStamped, "displacement": PoseStamped}


@pytest.fixture
def still() -> Outcome:
    return undisturbed(first_press)


def by_messages(
    force: Callable[[Item], np.ndarray],
    pose: Callable[[Item], Pose],
    parameters: dict[str, Any],
    *,
    is_fast: bool = True,
) -> Outcome:
    """Feed forces and poses of the first press as messages, or as the bytes of messages."""
    s = first_press()
    values = check(s.parameters | parameters)
    outputs: list[Any] = []
    pipeline = Pipeline(pipeline_config(values), outputs.append)
    inputs = Inputs(values, pipeline)
    handlers = {
        name: fast_handler(name, f"geometry_msgs/msg/{kind.__name__}", inputs)
        for name, kind in KINDS.items()
    }
    for item in s.items:
        name = "force" if item.stream == FORCE else "displacement"
        message: Any = KINDS[name]()
        message.header.stamp, message.header.frame_id = to_stamp(item.stamp_ns), "s"
        if name == "force":
            part = message.wrench.force
            part.x, part.y, part.z = map(float, force(item))
        else:
            at, turn = pose(item)
            part, turned = message.pose.position, message.pose.orientation
            part.x, part.y, part.z = map(float, at)
            turned.x, turned.y, turned.z, turned.w = map(float, turn.as_quat())
        if is_fast:
            handlers[name](serialize(message))  # type: ignore[misc]
        else:
            inputs.add(name, message)
    pipeline.finish()
    return Outcome(pipeline, tuple(outputs))


# The weight of a tool that turns

MASS, CENTRE, GRAVITY = 0.3, (0.01, -0.02, 0.05), (0.0, 0.0, -9.80665)


@pytest.mark.parametrize("is_torque", [False, True])
def test_load_is_the_weight_seen_from_the_sensor(is_torque):
    rng = np.random.default_rng(0)
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    turn = Rotation.random(rng=rng)
    tool = ToolWeight(MASS, CENTRE, GRAVITY, tuple(axis), is_torque)
    weight = turn.inv().apply(MASS * np.array(GRAVITY))
    expected = axis @ (np.cross(CENTRE, weight) if is_torque else weight)
    assert tool.load(tuple(turn.as_quat())) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("is_fast", [False, True])
def test_a_tool_that_turns_while_it_presses_gives_what_one_that_does_not_turn_gives(
    is_fast, still
):
    def turn(item: Item) -> Rotation:
        return turn_of(first_press().second(item.stamp_ns))

    def force(item: Item) -> np.ndarray:
        weight = turn(item).inv().apply(MASS * np.array(GRAVITY))
        return np.array([*weight[:2], item.value + weight[2]])

    def pose(item: Item) -> Pose:
        return np.array(item.position), turn(item)

    assert_alike(by_messages(force, pose, {"tool.mass": MASS}, is_fast=is_fast), still)


# A probe that advances along its own axis: tilted approaches against the truth

#: Out of the probe's tip, in its frame.
AXIS = np.array([1.0, 0.0, 0.0])
ALONG = {"displacement.along_tool": True, "displacement.axis": AXIS.tolist()}
#: How the probe stands in the base: its axis 20 degrees off the base's -z, 0.6 m from the origin.
TILT = math.radians(20.0)
UPRIGHT = Rotation.from_euler("y", 90.0, degrees=True)
STANDING = Rotation.from_euler("x", TILT) * UPRIGHT
FAR = np.array([0.4, -0.3, 0.35])


def along_its_axis(wobble: float = 0.0, stretch: float = 1.0, **parameters: Any) -> Outcome:
    """Feed poses of a probe that goes along its axis as far as the first press does.

    Its axis swings by `wobble` [rad]; places follow by summing small steps along it.
    """
    s = first_press()
    moved = [item for item in s.items if item.stream == DISPLACEMENT]
    at, last = FAR.copy(), moved[0]
    poses: dict[int, Pose] = {}
    for item in moved:
        seconds = np.linspace(s.second(last.stamp_ns), s.second(item.stamp_ns), 11)
        turns = [turn_at(second, wobble) for second in seconds]
        step = stretch * (item.value - last.value) / 10.0
        at = at + step * np.sum([turn.apply(AXIS) for turn in turns[1:]], axis=0)
        poses[item.stamp_ns] = at, turns[-1]
        last = item
    return by_messages(
        lambda item: np.array([0.0, 0.0, item.value]),
        lambda item: poses[item.stamp_ns],
        ALONG | parameters,
    )


def turn_at(second: float, wobble: float) -> Rotation:
    swing = [wobble * math.sin(1.1 * second), wobble * math.sin(0.7 * second), 0.3 * second]
    return Rotation.from_euler("xy", swing[:2]) * STANDING * Rotation.from_euler("x", swing[2])


@pytest.mark.parametrize("wobble", [0.0, 0.05])
def test_a_tilted_probe_gives_what_an_upright_one_gives(wobble, still):
    """Also where its axis swings while it presses."""
    found = along_its_axis(wobble)
    assert_alike(found, still)
    assert not found.pipeline.rejected and not found.pipeline.warnings


def test_a_turn_on_the_spot_far_from_the_origin_is_no_way():
    path = ToolPath(ToolPathConfig((1.0, 0.0, 0.0)))
    x, y, z = map(float, FAR)
    for second in np.linspace(0.0, 3.0, 50):
        a, b, c, d = map(float, turn_at(second, 0.3).as_quat())
        way, tilt = path.add(Transform((x, y, z), (a, b, c, d)))
        assert way == 0.0 and tilt == 0.0


def test_against_a_given_normal_depth_is_the_part_along_it_and_the_tilt_is_told(still):
    """The tool goes farther by 1 / cos 20 degrees for the depth that the truth has."""
    normal = {"surface.normal": [0.0, 0.0, -2.0]}
    found = along_its_axis(stretch=1.0 / math.cos(TILT), **normal)
    assert_alike(found, still)
    (words,) = [words for words in found.pipeline.warnings if "askew" in words]
    assert found.pipeline.warnings[words] == 1
    assert "up to 20 degrees askew: the way along the tool is taken for 0.940 of it" in words
    # The punch of 10 mm radius: 20 mm times the tangent.
    assert "by its edge first, over 7.3 mm" in words
