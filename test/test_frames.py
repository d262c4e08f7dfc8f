# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tools that turn while they press: by /tf, by their weight, along their own axis."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fault_helpers import (
    FRAMES,
    TIP,
    Outcome,
    arm,
    assert_alike,
    first_press,
    forces,
    outcome_of,
    statics,
    transforms,
    turn_of,
    undisturbed,
    write_bag,
)
from geometry_msgs.msg import PoseStamped, WrenchStamped
from pipeline_helpers import DISPLACEMENT, FORCE, Item
from ros_helpers import assert_live_equals_replay
from scipy.spatial.transform import Rotation

from fden_ros.cli import main
from fden_ros.core.outputs import ContactSummary, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.rotation import Transform
from fden_ros.core.streams.tool import ToolPath
from fden_ros.errors import InputError
from fden_ros.inputs import Inputs
from fden_ros.offline.replay import replay
from fden_ros.parameters import check, pipeline_config
from fden_ros.recording.source import Selection
from fden_ros.recording.table import Columns
from fden_ros.ros.messages import to_stamp
from simulation.bag import PARAMETER_FILE

#: It takes a sixth of the time of the grid, which recordings and the node have below.
PAPER = {"estimator.kind": "ekf"}


def run(samples: Iterable[Any], **parameters: Any) -> Outcome:
    own = {name.replace("__", "."): value for name, value in parameters.items()}
    return outcome_of(samples, first_press().parameters | FRAMES | PAPER | own)


@pytest.fixture
def still() -> Outcome:
    return undisturbed(first_press, "ekf")


@pytest.fixture(scope="module")
def turning() -> Outcome:
    return run(arm(first_press()))


def test_an_arm_that_turns_gives_what_a_probe_gives_that_does_not(turning, still):
    assert_alike(turning, still)
    # The forces before the first transform alone find none.
    assert set(turning.pipeline.rejected) <= {"force.no_transform"}
    assert turning.pipeline.rejected.total() <= 2


def test_the_weight_of_a_tool_that_turns_is_taken_off_in_the_frame_of_the_base(still):
    s, mass = first_press(), 0.2
    heavy = []
    for one in forces(s):
        turn = turn_of(s.second(one.stamp_ns)) * TIP[1].inv()
        weight = turn.inv().apply([0.0, 0.0, -9.80665 * mass])
        x, y, z = map(float, np.array(one.force) + weight)
        heavy.append(one._replace(force=(x, y, z)))
    moving = sorted([*transforms(s), *heavy], key=lambda one: one.stamp_ns)
    assert_alike(run([*statics(), *moving], tool__mass=mass), still)


def test_outputs_do_not_depend_on_how_transforms_and_forces_are_interleaved(turning):
    """Each link is a stream of its own; a window that holds everything."""
    s, chance = first_press(), random.Random(5)
    moving = transforms(s)
    left = [
        list(statics()),
        [one for one in moving if one.child == "link"],
        [one for one in moving if one.child == "flange"],
        list(forces(s)),
    ]
    merged: list[Any] = []
    while any(left):
        stream = chance.choice([one for one in left if one])
        merged += [stream.pop(0) for _ in range(min(chance.randint(1, 40), len(stream)))]
    shuffled = run(merged, synchronize__max_wait=60.0)
    assert [c.estimate.mean.tolist() for c in shuffled.summaries if c.estimate] == [
        c.estimate.mean.tolist() for c in turning.summaries if c.estimate
    ]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("arm") / "bag", arm(first_press()))


KINDS = (TissueState, ContactSummary)


def test_a_bag_without_transforms_and_a_table_are_refused_in_one_line(tmp_path):
    golden = Path(__file__).parent.parent / "bags" / "golden" / "golden_press"
    parameters = check(FRAMES)
    with pytest.raises(InputError, match="record /tf and /tf_static too"):
        replay(golden, parameters)
    (tmp_path / "a.csv").write_text("t,f,d\n0,0,0\n")
    with pytest.raises(InputError, match="a table does not hold"):
        replay(tmp_path / "a.csv", parameters, Selection(columns=Columns.parse("t,f,d")))


def test_live_equals_replay_with_transforms_bit_for_bit_and_is_right(bag, still):
    result = assert_live_equals_replay(bag, KINDS, remap={"/ft/wrench": "/force"})
    assert result.inputs == {
        "force": "/ft/wrench",
        "displacement": "tip in base",
        "tf": "/tf",
        "tf_static": "/tf_static",
    }
    (summary,), expected = result.summaries, still.summaries[0]
    assert summary.estimate is not None and expected.estimate is not None
    assert summary.position_frame == "base" and summary.converged
    sd = float(np.sqrt(expected.estimate.covariance[0, 0]))
    assert abs(summary.estimate.mean[0] - expected.estimate.mean[0]) < sd / 3.0
    config = ["--config", str(bag / PARAMETER_FILE)]
    assert main(["report", str(bag), *config, "-o", str(bag.parent / "report.html")]) == 0


Pose = tuple[np.ndarray, Rotation]
MESSAGES = {"force": WrenchStamped, "displacement": PoseStamped}


def by_messages(
    force: Callable[[Item], np.ndarray], pose: Callable[[Item], Pose], parameters: dict[str, Any]
) -> Outcome:
    """Feed forces and poses of the first press as messages."""
    s = first_press()
    values = check(s.parameters | PAPER | parameters)
    outputs: list[Any] = []
    pipeline = Pipeline(pipeline_config(values), outputs.append)
    inputs = Inputs(values, pipeline)
    for item in s.items:
        name = "force" if item.stream == FORCE else "displacement"
        message: Any = MESSAGES[name]()
        message.header.stamp, message.header.frame_id = to_stamp(item.stamp_ns), "s"
        if name == "force":
            part = message.wrench.force
            part.x, part.y, part.z = map(float, force(item))
        else:
            at, turn = pose(item)
            part, turned = message.pose.position, message.pose.orientation
            part.x, part.y, part.z = map(float, at)
            turned.x, turned.y, turned.z, turned.w = map(float, turn.as_quat())
        inputs.add(name, message)
    pipeline.finish()
    return Outcome(pipeline, tuple(outputs))


MASS, GRAVITY = 0.3, (0.0, 0.0, -9.80665)


def test_a_tool_that_turns_while_it_presses_gives_what_one_that_does_not_turn_gives(still):
    def turn(item: Item) -> Rotation:
        return turn_of(first_press().second(item.stamp_ns))

    def force(item: Item) -> np.ndarray:
        weight = turn(item).inv().apply(MASS * np.array(GRAVITY))
        return np.array([*weight[:2], item.value + weight[2]])

    def pose(item: Item) -> Pose:
        return np.array(item.position), turn(item)

    assert_alike(by_messages(force, pose, {"tool.mass": MASS}), still)


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


def test_against_a_given_normal_depth_is_the_part_along_it_and_the_tilt_is_told(still):
    """The tool goes farther by 1 / cos 20 degrees for the depth that the truth has."""
    normal = {"surface.normal": [0.0, 0.0, -2.0]}
    found = along_its_axis(stretch=1.0 / math.cos(TILT), **normal)
    assert_alike(found, still)
    (words,) = [words for words in found.pipeline.warnings if "tilted" in words]
    assert found.pipeline.warnings[words] == 1
    assert "up to 20 degrees: only 0.940 of the motion along the tool is depth" in words
    # The punch of 10 mm radius: 20 mm times the tangent.
    assert "with its edge first, over 7.3 mm" in words


def test_a_turn_about_a_far_point_is_no_travel_along_the_tool():
    path = ToolPath((1.0, 0.0, 0.0), None)
    for angle in np.linspace(0.0, 0.6, 31):
        turn = Rotation.from_euler("z", angle)
        place, rotation = turn.apply([0.6, 0.0, 0.0]).tolist(), turn.as_quat().tolist()
        travel, _ = path.add(Transform(tuple(place), tuple(rotation)))
    assert abs(travel) < 1e-12
