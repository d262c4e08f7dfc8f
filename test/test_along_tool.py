# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A probe that advances along its own axis: tilted approaches against the truth."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from fault_helpers import Outcome, first_press, undisturbed
from geometry_msgs.msg import PoseStamped, WrenchStamped
from pipeline_helpers import DISPLACEMENT, FORCE
from scipy.spatial.transform import Rotation

from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.rotation import Transform
from fden_ros.core.streams.tool import ToolPath, ToolPathConfig
from fden_ros.parameters import check, pipeline_config
from fden_ros.recording.cdr import serialize
from fden_ros.ros.decoding import fast_handler
from fden_ros.ros.inputs import Inputs
from fden_ros.ros.messages import to_stamp

#: Out of the probe's tip, in its frame.
AXIS = np.array([1.0, 0.0, 0.0])
ALONG = {"displacement.along_tool": True, "displacement.axis": AXIS.tolist()}
#: How the probe stands in the base: its axis 20 degrees off the base's -z, 0.6 m from the origin.
TILT = math.radians(20.0)
UPRIGHT = Rotation.from_euler("y", 90.0, degrees=True)
STANDING = Rotation.from_euler("x", TILT) * UPRIGHT
FAR = np.array([0.4, -0.3, 0.35])


def poses(
    wobble: float = 0.0, stretch: float = 1.0
) -> list[tuple[int, np.ndarray, Rotation, np.ndarray]]:
    """Return stamp, place, turn of a probe that goes along its axis as far as the shift's does.

    Its axis swings by `wobble` [rad]; places follow by summing small steps along it.
    """
    s = first_press()
    moved = [item for item in s.items if item.stream == DISPLACEMENT]
    at, last, found = FAR.copy(), moved[0], []
    for item in moved:
        seconds = np.linspace(s.second(last.stamp_ns), s.second(item.stamp_ns), 11)
        turns = [turn_at(second, wobble) for second in seconds]
        step = stretch * (item.value - last.value) / 10.0
        at = at + step * np.sum([turn.apply(AXIS) for turn in turns[1:]], axis=0)
        assert item.position is not None
        # Sites lie side by side.
        aside = (item.position[0] - moved[0].position[0]) * np.array([1.0, 0.0, 0.0])  # type: ignore[index]
        found.append((item.stamp_ns, at + aside, turns[-1], turns[-1].apply(AXIS)))
        last = item
    return found


def turn_at(second: float, wobble: float) -> Rotation:
    swing = [wobble * math.sin(1.1 * second), wobble * math.sin(0.7 * second), 0.3 * second]
    return Rotation.from_euler("xy", swing[:2]) * STANDING * Rotation.from_euler("x", swing[2])


def by_messages(
    motion: list[tuple[int, np.ndarray, Rotation, np.ndarray]], **parameters: Any
) -> Outcome:
    """Feed forces and poses as the bytes of messages."""
    s = first_press()
    own = {name.replace("__", "."): value for name, value in parameters.items()}
    values = check(s.parameters | ALONG | own)
    outputs: list[Any] = []
    pipeline = Pipeline(pipeline_config(values), outputs.append)
    inputs = Inputs(values, pipeline)
    kinds = {"force": "WrenchStamped", "displacement": "PoseStamped"}
    handlers = {w: fast_handler(w, f"geometry_msgs/msg/{k}", inputs) for w, k in kinds.items()}
    places = iter(motion)
    for item in s.items:
        message: Any
        if item.stream == FORCE:
            name, message = "force", WrenchStamped()
            message.wrench.force.z = item.value
        else:
            name, message = "displacement", PoseStamped()
            _, at, turn, _ = next(places)
            position, orientation = message.pose.position, message.pose.orientation
            position.x, position.y, position.z = map(float, at)
            orientation.x, orientation.y, orientation.z, orientation.w = map(float, turn.as_quat())
        message.header.stamp = to_stamp(item.stamp_ns)
        handlers[name](serialize(message))  # type: ignore[misc]
    pipeline.finish()
    return Outcome(pipeline, tuple(outputs))


@pytest.fixture
def still() -> Outcome:
    return undisturbed(first_press)


def assert_alike(found: Outcome, expected: Outcome) -> None:
    """As the probe that stands upright, by a third of a standard deviation."""
    assert len(found.summaries) == len(expected.summaries) == 1
    for a, b in zip(found.summaries, expected.summaries, strict=True):
        assert a.estimate is not None and b.estimate is not None
        assert a.converged and a.complete and a.flags == b.flags and a.site_id == b.site_id
        sd = np.sqrt(np.diag(b.estimate.covariance)) + 1e-12
        assert np.all(np.abs(a.estimate.mean - b.estimate.mean) < sd / 3.0)


@pytest.mark.parametrize("wobble", [0.0, 0.05])
def test_a_tilted_probe_gives_what_an_upright_one_gives(wobble: float, still: Outcome) -> None:
    """Also where its axis swings while it presses."""
    found = by_messages(poses(wobble))
    assert_alike(found, still)
    assert not found.pipeline.rejected and not found.pipeline.warnings


def test_a_turn_on_the_spot_far_from_the_origin_is_no_way() -> None:
    path = ToolPath(ToolPathConfig((1.0, 0.0, 0.0)))
    x, y, z = map(float, FAR)
    for second in np.linspace(0.0, 3.0, 50):
        a, b, c, d = map(float, turn_at(second, 0.3).as_quat())
        way, tilt = path.add(Transform((x, y, z), (a, b, c, d)))
        assert way == 0.0 and tilt == 0.0


def test_against_a_given_normal_depth_is_the_part_along_it_and_the_tilt_is_told(
    still: Outcome,
) -> None:
    """The tool goes farther by 1 / cos 20 degrees for the depth that the truth has."""
    found = by_messages(poses(stretch=1.0 / math.cos(TILT)), surface__normal=[0.0, 0.0, -2.0])
    assert_alike(found, still)
    (words,) = [words for words in found.pipeline.warnings if "askew" in words]
    assert found.pipeline.warnings[words] == 1
    assert "up to 20 degrees askew: the way along the tool is taken for 0.940 of it" in words
    # The punch of 10 mm radius: 20 mm times the tangent.
    assert "by its edge first, over 7.3 mm" in words
