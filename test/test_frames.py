# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Forces and positions in frames that move: by /tf, against the truth of a turning arm."""

from __future__ import annotations

import random
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fault_helpers import Outcome, assert_alike, first_press, outcome_of, turn_of, undisturbed
from frame_helpers import (
    FRAMES,
    TIP,
    arm,
    forces,
    statics,
    transforms,
    write_bag,
)
from ros_helpers import Bench, active, assert_live_equals_replay, replayed

from fden_ros.cli import main
from fden_ros.core.outputs import ContactSummary, TissueState
from fden_ros.errors import InputError
from fden_ros.offline.replay import replay
from fden_ros.parameters import check
from fden_ros.recording.definitions import type_hash
from fden_ros.recording.source import Selection
from fden_ros.recording.table import Columns
from simulation.bag import PARAMETER_FILE
from simulation.simulate import START_NS


def run(samples: Iterable[Any], **parameters: Any) -> Outcome:
    own = {name.replace("__", "."): value for name, value in parameters.items()}
    return outcome_of(samples, first_press().parameters | FRAMES | own)


@pytest.fixture
def still() -> Outcome:
    return undisturbed(first_press)


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
    shuffled = run(merged, synchronize__window=60.0)
    assert [c.estimate.mean.tolist() for c in shuffled.summaries if c.estimate] == [
        c.estimate.mean.tolist() for c in turning.summaries if c.estimate
    ]


def test_frames_that_no_transform_connects_are_named():
    s = first_press()
    samples = [one for one in arm(s) if getattr(one, "child", "") != "flange"]
    outcome = run(samples, synchronize__window=1.0)
    assert outcome.pipeline.pair_count == 0
    assert "no chain of transforms leads from sensor to base" in outcome.pipeline.transform_problem
    assert "camera, flange, link" in outcome.pipeline.transform_problem
    assert outcome.pipeline.rejected["force.no_transform"] > 800
    assert outcome.pipeline._synchronizer.waiting < 10_000


# Recordings and the node


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("arm") / "bag", arm(first_press()))


KINDS = (TissueState, ContactSummary)


def test_the_transforms_of_a_bag_are_used(bag, still):
    result, _ = replayed(bag, KINDS)
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


def test_a_bag_without_transforms_and_a_table_are_refused_in_one_line(tmp_path):
    golden = Path(__file__).parent.parent / "bags" / "golden" / "golden_press"
    parameters = check(FRAMES)
    with pytest.raises(InputError, match="record /tf and /tf_static too"):
        replay(golden, parameters)
    (tmp_path / "a.csv").write_text("t,f,d\n0,0,0\n")
    with pytest.raises(InputError, match="a table does not hold"):
        replay(tmp_path / "a.csv", parameters, Selection(columns=Columns.parse("t,f,d")))


def test_live_equals_replay_with_transforms_bit_for_bit(bag):
    assert_live_equals_replay(bag, KINDS, remap={"/ft/wrench": "/force"})


def test_frames_that_nothing_connects_are_named_live_after_2_s():
    words = "no chain of transforms leads from s to base: /tf and /tf_static name none"
    with Bench() as bench, active(FRAMES) as node:
        now = iter(range(START_NS, 2 * START_NS, 4_000_000))
        bench.wait_for(
            lambda: (
                bench.publish(next(now), 0.0, 0.0)
                or sum(words in array.status[0].message for array in bench.diagnostics) >= 3
            ),
            "three looks that say so",
        )
    assert any("[WARN]" in line and words in line for line in node.output.splitlines())


def test_the_transforms_type_is_that_of_the_ros_that_a_robot_runs():
    """The hash of Jazzy's tf2_msgs, by which DDS tells types apart."""
    known = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
    assert type_hash("tf2_msgs/msg/TFMessage") == known
