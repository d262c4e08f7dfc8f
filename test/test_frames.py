# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Forces and positions in frames that move: by /tf, against the truth of a turning arm."""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fault_helpers import Outcome, first_press, outcome_of, turn_of, undisturbed
from frame_helpers import (
    FRAMES,
    MOUNT,
    TIP,
    arm,
    forces,
    place,
    statics,
    tip_position,
    transforms,
    write_bag,
)
from pipeline_helpers import FORCE
from ros_helpers import Bench, active, assert_live_equals_replay, replayed
from scipy.spatial.transform import Rotation, Slerp

from fden_ros.cli import main
from fden_ros.core.outputs import ContactSummary, TissueState
from fden_ros.core.streams.rotation import Transform, angle, slerp
from fden_ros.core.streams.samples import NANOSECONDS
from fden_ros.core.streams.synchronize import Synchronizer
from fden_ros.errors import InputError
from fden_ros.offline.replay import replay
from fden_ros.offline.session import gather
from fden_ros.parameters import check, pipeline_config, read_parameter_file
from fden_ros.recording.definitions import type_hash
from fden_ros.recording.source import Selection
from fden_ros.recording.synthetic import PARAMETER_FILE
from fden_ros.recording.table import Columns
from fden_ros.simulation.simulate import START_NS


def test_slerp_is_that_of_scipy() -> None:
    generator = np.random.default_rng(1)
    for _ in range(200):
        a, b = Rotation.from_quat(generator.normal(size=(2, 4)))
        share = generator.uniform()
        expected = Slerp([0.0, 1.0], Rotation.concatenate([a, b]))(share)
        found = slerp(tuple(a.as_quat()), tuple(b.as_quat()), share)
        assert (Rotation.from_quat(found) * expected.inv()).magnitude() < 1e-9
        assert angle(tuple(a.as_quat()), tuple(b.as_quat())) == pytest.approx(
            (a.inv() * b).magnitude(), abs=1e-9
        )


def test_transforms_chain_as_scipys_rotations_do() -> None:
    def transform(part: tuple[np.ndarray, Rotation]) -> Transform:
        return Transform(tuple(part[0]), tuple(part[1].as_quat()))

    both = transform(MOUNT).then(transform(TIP))
    assert np.allclose(both.translation, MOUNT[0] + MOUNT[1].apply(TIP[0]))
    assert (Rotation.from_quat(both.rotation) * (MOUNT[1] * TIP[1]).inv()).magnitude() < 1e-12
    back = both.inverse().then(both)
    assert np.allclose(back.translation, 0.0) and angle(back.rotation, (0, 0, 0, 1)) < 1e-9


def run(samples: Iterable[Any], **parameters: Any) -> Outcome:
    own = {name.replace("__", "."): value for name, value in parameters.items()}
    return outcome_of(samples, first_press().parameters | FRAMES | own)


@pytest.fixture
def still() -> Outcome:
    return undisturbed(first_press)


@pytest.fixture(scope="module")
def turning() -> Outcome:
    return run(arm(first_press()))


def assert_alike(found: Outcome, expected: Outcome) -> None:
    """As the probe that does not turn, by a third of a standard deviation."""
    assert len(found.summaries) == len(expected.summaries) == 1
    for a, b in zip(found.summaries, expected.summaries, strict=True):
        assert a.estimate is not None and b.estimate is not None
        assert a.converged and a.complete and a.flags == b.flags
        sd = np.sqrt(np.diag(b.estimate.covariance)) + 1e-12
        assert np.all(np.abs(a.estimate.mean - b.estimate.mean) < sd / 3.0)


def test_an_arm_that_turns_gives_what_a_probe_gives_that_does_not(
    turning: Outcome, still: Outcome
) -> None:
    assert_alike(turning, still)
    # The forces before the first transform alone find none.
    assert set(turning.pipeline.rejected) <= {"force.no_transform"}
    assert turning.pipeline.rejected.total() <= 2


def test_the_touch_is_where_the_tip_of_the_arm_is(turning: Outcome) -> None:
    for summary in turning.summaries:
        assert summary.position is not None
        assert np.allclose(summary.position, tip_position(summary.start_ns), atol=1e-4)


def test_a_displacement_topic_beside_the_frames_turns_the_force_alone(still: Outcome) -> None:
    s = first_press()
    moved = [item for item in s.items if item.stream != 0]
    samples = sorted([*arm(s), *moved], key=lambda one: one.stamp_ns)
    assert_alike(run(samples, displacement__message="pose"), still)


def test_the_weight_of_a_tool_that_turns_is_taken_off_along_the_axis_of_the_base(
    still: Outcome,
) -> None:
    """A torque: the weight's own is that of its lever, which turns."""
    s = first_press()
    mass, centre = 0.2, np.array([0.01, 0.0, 0.05])
    turned = []
    for one in forces(s):
        turn = turn_of(s.second(one.stamp_ns)) * TIP[1].inv()
        weight = turn.inv().apply([0.0, 0.0, -9.80665 * mass])
        x, y, z = map(float, np.array(one.force) + np.cross(centre, weight))
        turned.append(one._replace(force=(x, y, z)))
    stamped = sorted([*transforms(s), *turned], key=lambda one: one.stamp_ns)
    tool = {"tool.mass": mass, "tool.centre_of_mass": centre.tolist()}
    values = s.parameters | FRAMES | tool
    config = pipeline_config(check(values | {"geometry.kind": "torsional_rheometer"}))
    assert config.synchronize.frames is not None and config.synchronize.frames.tool is not None
    pairs: list[Any] = []
    synchronizer = Synchronizer(config.synchronize, pairs.append, Counter())
    for one in [*statics(), *stamped]:
        one(_Bare(synchronizer))  # type: ignore[arg-type]
    values_of = {item.stamp_ns: item.value for item in s.items if item.stream == 0}
    assert len(pairs) > 900
    assert max(abs(pair.force - values_of[pair.stamp_ns]) for pair in pairs) < 1e-3


class _Bare:
    """Hands samples to a synchronizer as a pipeline does."""

    def __init__(self, synchronizer: Any) -> None:
        self._synchronizer = synchronizer
        self.add_force_vector = synchronizer.add_force_vector

    def add_transform(
        self, stamp_ns: int, parent: str, child: str, at: Any, turn: Any, *, is_static: bool
    ) -> None:
        self._synchronizer.add_transform(
            stamp_ns, parent, child, Transform(at, turn), is_static=is_static
        )


def test_outputs_do_not_depend_on_how_transforms_and_forces_are_interleaved(
    turning: Outcome,
) -> None:
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


def test_static_transforms_outlive_a_reset() -> None:
    s = first_press()
    samples: list[Any] = arm(s)
    middle = len(samples) // 3
    outcome = run([*samples[:middle], lambda p: p.reset(), *samples[middle:]])
    assert outcome.summaries[-1].converged


def test_frames_that_no_transform_connects_are_named() -> None:
    s = first_press()
    samples = [one for one in arm(s) if getattr(one, "child", "") != "flange"]
    outcome = run(samples, synchronize__window=1.0)
    assert outcome.pipeline.pair_count == 0
    assert "no chain of transforms leads from sensor to base" in outcome.pipeline.transform_problem
    assert "camera, flange, link" in outcome.pipeline.transform_problem
    assert outcome.pipeline.rejected["force.no_transform"] > 800
    assert outcome.pipeline._synchronizer.waiting < 10_000


def test_a_frame_that_gets_another_parent_is_counted_and_stays_where_it_was(
    turning: Outcome,
) -> None:
    s = first_press()
    stray = place(s.items[500].stamp_ns, "elsewhere", "flange", *TIP)
    outcome = run(sorted([*arm(s), stray], key=lambda one: one.stamp_ns))
    assert outcome.pipeline.rejected["transform.other_parent"] == 1
    for a, b in zip(outcome.summaries, turning.summaries, strict=True):
        assert a.estimate is not None and b.estimate is not None
        assert math.isclose(a.estimate.mean[0], b.estimate.mean[0])


def test_a_displacement_by_transforms_needs_both_frames() -> None:
    with pytest.raises(InputError, match=r"frames\.probe"):
        pipeline_config(check({"displacement.message": "tf", "frames.base": "base"}))


# Recordings and the node


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("arm") / "bag", arm(first_press()))


KINDS = (TissueState, ContactSummary)


def test_the_transforms_of_a_bag_are_used(bag: Path, still: Outcome) -> None:
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
    out = bag.parent / "out"
    config = ["--config", str(bag / PARAMETER_FILE)]
    assert main(["replay", str(bag), *config, "-o", str(out), "--with-inputs"]) == 0
    (out / PARAMETER_FILE).write_text((bag / PARAMETER_FILE).read_text())
    assert replayed(out, KINDS)[1] == replayed(bag, KINDS)[1]
    assert main(["report", str(bag), *config, "-o", str(bag.parent / "report.html")]) == 0


def test_a_bag_without_transforms_and_a_table_are_refused_in_one_line(tmp_path: Path) -> None:
    golden = Path(__file__).parent.parent / "bags" / "golden" / "golden_press"
    parameters = check(FRAMES)
    with pytest.raises(InputError, match="record /tf and /tf_static too"):
        replay(golden, parameters)
    (tmp_path / "a.csv").write_text("t,f,d\n0,0,0\n")
    with pytest.raises(InputError, match="a table does not hold"):
        replay(tmp_path / "a.csv", parameters, Selection(columns=Columns.parse("t,f,d")))


def test_live_equals_replay_with_transforms_bit_for_bit(bag: Path) -> None:
    assert_live_equals_replay(bag, KINDS, remap={"/ft/wrench": "/force"})


def test_a_report_shows_force_and_displacement_along_their_axes(bag: Path) -> None:
    session = gather(bag, read_parameter_file(bag / PARAMETER_FILE))
    time, low, high = session.displacement.arrays(session.start_ns)
    instants = session.start_ns + np.round(NANOSECONDS * time).astype(np.int64)
    depth = np.array([tip_position(instant)[2] for instant in instants])
    # A bucket holds 1 ms or more of a probe that goes at some mm/s.
    assert time.size > 100 and np.abs(0.5 * (low + high) - depth).max() < 5e-4
    assert high.max() - low.min() > 3e-3
    _, least, largest = session.force.arrays(session.start_ns)
    truth = [
        item.value
        for item in first_press().items
        if item.stream == FORCE and item.stamp_ns <= session.end_ns
    ]
    assert largest.max() == pytest.approx(max(truth), rel=0.01)
    assert least.min() == pytest.approx(min(truth), abs=0.01 * max(truth))


def test_frames_that_nothing_connects_are_named_live_after_2_s() -> None:
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


def test_the_transforms_type_is_that_of_the_ros_that_a_robot_runs() -> None:
    """The hash of Jazzy's tf2_msgs, by which DDS tells types apart."""
    known = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
    assert type_hash("tf2_msgs/msg/TFMessage") == known
