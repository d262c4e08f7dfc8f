# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The tool's weight from turns in the air: the service of the node, how far its answer holds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from fden_msgs.msg import TissueEstimate
from fden_msgs.srv import IdentifyTool
from geometry_msgs.msg import PoseStamped, WrenchStamped
from live_helpers import LIMIT
from numpy.typing import NDArray
from property_helpers import first
from rclpy.duration import Duration
from ros_helpers import PATIENT, RELIABLE, Bench, active
from scipy.spatial.transform import Rotation, Slerp

from fden_ros.configure.streams import Streams
from fden_ros.configure.weight import find_weight, weight_findings
from fden_ros.ros.messages import to_stamp

MASS, CENTRE, GRAVITY = 0.35, np.array([0.01, -0.02, 0.06]), np.array([0.0, 0.0, -9.80665])
START_NS = 1_700_000_000_000_000_000
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Turns:
    """Force and pose of a sensor with a tool that is turned through orientations and back."""

    force_times: Array
    force: Array
    torque: Array
    pose_times: Array
    quaternions: Array

    def streams(self) -> Streams:
        place = np.zeros((self.pose_times.size, 3))
        return Streams(
            "turns",
            *(self.force_times, self.force, self.pose_times, place),
            torque=self.torque,
            orientation=self.quaternions,
        )


def turned(seed: int, rotations: Rotation | None = None, mass: float = MASS) -> Turns:
    """Two seconds to each orientation, one of rest there; bias, drift, noise, poses 4 ms late."""
    rng = np.random.default_rng(seed)
    if rotations is None:
        first, across = Rotation.random(rng=rng), rng.permutation(3)[:2]
        tilts = [Rotation.from_euler("xyz"[axis], 60.0, degrees=True) for axis in across]
        rotations = Rotation.concatenate([first, first * tilts[0], first * tilts[1], first])
    count = len(rotations)
    knots = np.array([3.0 * i + rest for i in range(count) for rest in (0.0, 1.0)])
    path = Slerp(knots, Rotation.concatenate([rotations[i // 2] for i in range(2 * count)]))
    force_times = np.arange(0.0, knots[-1], 1 / 200)
    pose_times = np.arange(0.003, knots[-1], 1 / 100)
    weight = path(force_times).inv().apply(mass * GRAVITY)
    drift = force_times[:, None] * rng.normal(0.0, 0.003, 3)
    force = weight + rng.normal(0.0, 2.0, 3) + drift + rng.normal(0.0, 0.02, weight.shape)
    torque = np.cross(CENTRE, weight) + rng.normal(0.0, 0.05, 3)
    torque += rng.normal(0.0, 0.001, weight.shape)
    late = np.clip(pose_times - 0.004, 0.0, None)
    return Turns(force_times, force, torque, pose_times, path(late).as_quat())


def about(axis: str, *degrees: float) -> Rotation:
    return Rotation.concatenate([Rotation.from_euler(axis, d, degrees=True) for d in degrees])


def test_mass_and_centre_lie_within_their_deviations() -> None:
    masses, centres = [], []
    for seed in range(60):
        one = turned(seed).streams()
        mass, centre = weight_findings(find_weight([one]), [one])
        assert mass.claim and isinstance(mass.value, float) and mass.deviation
        assert mass.value == pytest.approx(MASS, rel=0.02)
        masses.append((mass.value - MASS) / mass.deviation)
        assert centre.claim and centre.deviation
        centres.append((np.array(centre.value) - CENTRE) / centre.deviation)
    for errors in (np.array(masses), np.concatenate(centres)):
        assert 0.7 < math.sqrt(float(np.mean(errors**2))) < 1.3
        assert np.mean(np.abs(errors) < 1.96) >= 0.9


@pytest.mark.parametrize(
    ("rotations", "said", "motion"),
    [
        (about("x", 0, 0, 0), "did not turn", "three orientations"),
        (about("x", 0, 15, 0), "degrees only", "three orientations"),
        (about("x", 0, 80, 0), "about one axis, (1.0, 0.0, 0.0)", "another axis"),
        (about("z", 0, 90, 180), "about one axis, (0.0, 0.0, 1.0)", "another axis"),
    ],
)
@pytest.mark.parametrize("seed", first(0, 1, 2))
def test_what_the_turns_lack_is_said_with_the_motion(
    rotations: Rotation, said: str, motion: str, seed: int
) -> None:
    one = turned(seed, rotations).streams()
    for finding in weight_findings(find_weight([one]), [one]):
        assert not finding.claim
        assert said in finding.evidence
        assert motion in finding.motion


# The node


def pose(stamp_ns: int, quaternion: Array, depth: float = 0.0) -> PoseStamped:
    message = PoseStamped()
    message.pose.position.z = depth
    message.header.stamp, message.header.frame_id = to_stamp(stamp_ns), "base"
    turn = message.pose.orientation
    turn.x, turn.y, turn.z, turn.w = (float(v) for v in quaternion)
    return message


def wrench(stamp_ns: int, force: Array, torque: Array) -> WrenchStamped:
    message = WrenchStamped()
    message.header.stamp, message.header.frame_id = to_stamp(stamp_ns), "sensor"
    for part, values in ((message.wrench.force, force), (message.wrench.torque, torque)):
        part.x, part.y, part.z = (float(v) for v in values)
    return message


class Arm:
    """Publishes turns, one after the other."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        bench.node.destroy_publisher(bench.displacement)
        self.poses = bench.node.create_publisher(PoseStamped, "/displacement", RELIABLE)
        bench.displacement = self.poses
        self.began_ns = START_NS

    def turn(self, turns: Turns, stiffness: float = 0.0) -> None:
        """Turn the tool; with a stiffness [N/m] press by 1 mm/s after a second."""
        rows = [(t, 0, i) for i, t in enumerate(turns.force_times)]
        rows += [(t, 1, i) for i, t in enumerate(turns.pose_times)]
        for at, which, index in sorted(rows):
            stamp_ns = self.began_ns + round(1e9 * at)
            depth = 1e-3 * (at - 1.0)
            if which:
                self.poses.publish(pose(stamp_ns, turns.quaternions[index], depth))
            else:
                push = np.array([0.0, 0.0, stiffness * max(depth, 0.0)])
                force = turns.force[index] + push
                self.bench.force.publish(wrench(stamp_ns, force, turns.torque[index]))
        self.began_ns += round(1e9 * (turns.force_times[-1] + 0.005))
        for publisher in (self.poses, self.bench.force):
            assert publisher.wait_for_all_acked(Duration(seconds=LIMIT))

    def ask_until(self, is_right: Callable[[Any], object]) -> Any:
        """Ask until the node has taken in what was sent."""
        answers = []

        def is_answered() -> bool:
            answers.append(self.ask())
            return bool(is_right(answers[-1]))

        self.bench.wait_for(is_answered, "the right answer")
        return answers[-1]

    def ask(self, command: int = IdentifyTool.Request.COMMAND_NEXT) -> Any:
        return self.bench.call(
            IdentifyTool, "identify_tool", IdentifyTool.Request(command=command)
        )


SENSOR = {"displacement.message": "pose", **PATIENT}
IN_CONTACT = (TissueEstimate.STATUS_CONVERGING, TissueEstimate.STATUS_CONVERGED)


@pytest.mark.parametrize("seed", first(101, 102, 103))
def test_the_service_answers_with_the_tool_that_was_turned(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mass = float(rng.uniform(0.1, 0.9))
    with Bench() as bench, active(SENSOR):
        arm = Arm(bench)
        bench.wait_until_heard()
        begun = arm.ask()
        assert begun.collecting and not begun.success
        assert "three orientations 60 degrees apart" in begun.message
        early = arm.ask()
        assert early.collecting and not early.success and "samples" in early.message
        arm.turn(turned(seed, about("y", 0, 70, 0), mass))
        alike = arm.ask_until(lambda answer: answer.collected > 5.9)
        assert alike.collecting and not alike.success and alike.mass == 0.0
        assert "about one axis, (0.0, 1.0, 0.0)" in alike.message
        arm.turn(turned(seed, about("x", 0, 70, 0), mass))
        found = arm.ask_until(lambda answer: answer.success or answer.collected > 11.9)
        assert found.success and not found.collecting, found.message
        assert abs(found.mass - mass) < 4.0 * found.mass_sd < 0.04 * mass
        assert found.centre_known
        assert np.all(np.abs(found.centre_of_mass - CENTRE) < 4.0 * found.centre_of_mass_sd)
        assert found.gravity == pytest.approx(GRAVITY, abs=1e-3)
        assert f"tool.mass: {found.mass:.5g}" in found.message
        assert found.collected > 8.0
        # What it says is what the node takes: the pipeline goes on, and nothing was a contact.
        bench.estimates.clear()
        arm.turn(turned(seed, about("x", 0, 0), mass))
        stale = TissueEstimate.STATUS_STALE  # until the first pair
        bench.wait_for(
            lambda: any(one.status != stale for one in bench.estimates),
            "estimates after the answer",
        )
        no_contact = TissueEstimate.STATUS_NO_CONTACT
        assert {estimate.status for estimate in bench.estimates} - {stale} == {no_contact}
        assert not bench.summaries


def test_in_contact_it_is_refused_and_by_joints_it_cannot_be() -> None:
    with Bench() as bench, active(SENSOR):
        arm = Arm(bench)
        bench.wait_until_heard()
        arm.turn(turned(0, about("x", 0, 0)), stiffness=1000.0)
        bench.wait_for(
            lambda: any(one.status in IN_CONTACT for one in bench.estimates), "the contact"
        )
        refused = arm.ask()
        assert not refused.success and not refused.collecting
        assert refused.message.startswith("the probe is in contact: lift it, then ask again")
    with Bench() as bench, active():
        bench.wait_until_heard()
        refused = Arm(bench).ask()
        assert not refused.success and not refused.collecting
        assert "sensor_msgs/JointState: the tool's weight wants" in refused.message


# A push while it turns
