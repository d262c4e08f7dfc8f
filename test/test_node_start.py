# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What a node says and does before its first pair of samples, and how it ends."""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fden_msgs.msg import TissueEstimate
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import GetState
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_helpers import LOSSLESS, RELIABLE, Bench, identifier
from sensor_msgs.msg import JointState

from fden_ros.simulation.simulate import START_NS

GOLDEN = Path(__file__).parent.parent / "bags" / "golden"
STEP_NS = 4_000_000


def warnings_of(node: Any, words: str) -> list[str]:
    """The warnings of a node that has ended, with these words."""
    return [line for line in node.output.splitlines() if "[WARN]" in line and words in line]


def wait_for_looks(bench: Bench, count: int) -> None:
    """Wait for so many looks of the node at its inputs, one a second."""
    bench.wait_for(lambda: len(bench.diagnostics) >= count, f"{count} diagnostics")


# First mistakes


def test_a_topic_that_nothing_publishes_is_named_with_one_that_fits_and_the_remap() -> None:
    with Bench() as bench, identifier({"autostart": True}, remap={"force": "/arm/wrench"}) as node:
        has_type = "/force has that type"
        bench.wait_for(lambda: has_type in bench.diagnostic().get("message", ""), has_type)
        wait_for_looks(bench, len(bench.diagnostics) + 4)
    # A loaded machine may discover publisher and node after the first line, which names neither.
    *before, line = warnings_of(node, "/arm/wrench")
    assert len(before) <= 1 and all("start its publisher" in one for one in before)
    assert (
        "nothing publishes /arm/wrench, where geometry_msgs/msg/WrenchStamped is expected" in line
    )
    assert "/force has that type; remap it, -r force:=/force (launch: force_topic:=/force)" in line
    *before, line = warnings_of(node, "/displacement is")
    assert len(before) <= 1 and all("by a node of unknown name, but" in one for one in before)
    assert "/displacement is published by /bench, but no message has come from it" in line


def test_another_type_another_qos_and_a_missing_clock_are_named_with_what_mends_them() -> None:
    reliable = {"qos_overrides./force.subscription.reliability": "reliable"}
    wrong = {"displacement.message": "pose", "use_sim_time": True, **reliable}
    with Bench() as bench:
        bench.node.destroy_publisher(bench.force)
        best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        bench.force = bench.node.create_publisher(WrenchStamped, "/force", best_effort)
        with identifier({"autostart": True, **wrong}) as node:
            wait_for_looks(bench, 5)
            told = bench.diagnostic()["message"]
    for words in (
        "/displacement is published as sensor_msgs/msg/JointState, expected "
        "geometry_msgs/msg/PoseStamped: set displacement.message to joint_state",
        "a publisher on /force offers an incompatible reliability, best_effort where reliable is "
        "asked for: nothing comes from it; "
        "set qos_overrides./force.subscription.reliability to best_effort",
        "use_sim_time is set but nothing publishes /clock: play the bag with --clock",
    ):
        assert len(warnings_of(node, words)) == 1, words
        assert words in told


def test_a_joint_that_is_not_in_the_messages_is_named_with_its_parameter() -> None:
    with (
        Bench() as bench,
        identifier({"autostart": True, "displacement.name": "tip", **LOSSLESS}) as node,
    ):
        bench.wait_until_heard()
        now = iter(range(START_NS, 2 * START_NS, STEP_NS))
        bench.wait_for(
            lambda: bench.publish(next(now), 0.0, 0.0) or len(bench.diagnostics) >= 4,
            "four diagnostics",
        )
    assert len(warnings_of(node, "set displacement.name")) == 1


def test_a_publisher_that_has_just_come_is_no_problem_and_its_first_samples_are_said() -> None:
    with Bench() as bench:
        for publisher in (bench.force, bench.displacement):
            bench.node.destroy_publisher(publisher)
        with identifier({"autostart": True, **LOSSLESS}) as node:
            wait_for_looks(bench, 3)
            bench.force = bench.node.create_publisher(WrenchStamped, "/force", RELIABLE)
            bench.displacement = bench.node.create_publisher(JointState, "/displacement", RELIABLE)
            silent = "/displacement is published by /bench, but no message has come"
            bench.wait_for(lambda: silent in bench.diagnostic().get("message", ""), silent)
            seen = len(bench.diagnostics)
            now = iter(range(START_NS, 2 * START_NS, STEP_NS))
            bench.wait_for(
                lambda: bench.publish(next(now), 0.0, 0.0) or len(bench.diagnostics) >= seen + 2,
                "two diagnostics",
            )
    assert len(warnings_of(node, "nothing publishes /displacement")) == 1
    assert not warnings_of(node, "no message has come")
    assert node.output.count("force and displacement come now") == 1


def test_a_consumer_that_comes_late_hears_that_there_is_no_estimate_yet() -> None:
    with identifier({"autostart": True, "stale_timeout": 0.1}):
        with Bench() as early:
            early.wait_for(lambda: early.estimates, "a first word")
        with Bench() as late:
            said = late.wait_for(lambda: late.estimates, "the same word")[0]
    assert said.status == TissueEstimate.STATUS_STALE
    assert said.valid == TissueEstimate.VALID_NONE
    assert said.header.stamp.sec == 0


def test_a_force_of_the_wrong_sign_is_said_before_the_first_press_is_over() -> None:
    """As `force.axis: [0, 0, -1]` on a sensor whose z grows with the press."""
    words = "does it have the wrong sign (force.axis, force.inverted)"
    with (
        Bench() as bench,
        identifier({"autostart": True, **LOSSLESS, "force.axis": "[0.0,0.0,-1.0]"}) as node,
    ):
        bench.wait_until_heard()
        for k in range(700):
            depth = max(0.0, (k - 400) * 1e-5)
            bench.publish(START_NS + k * STEP_NS, 60.0 * depth + 1e-4 * math.sin(k), depth)
        bench.wait_for(
            lambda: words in bench.diagnostic().get("message", ""), "the words on the sign"
        )
        assert not bench.summaries
    assert len(warnings_of(node, words)) == 1


# Lifecycle


def test_an_inactive_node_says_what_it_waits_for() -> None:
    with Bench() as bench, identifier() as node:
        assert bench.change_state(Transition.TRANSITION_CONFIGURE)
        assert bench.change_state(Transition.TRANSITION_ACTIVATE)
        assert bench.change_state(Transition.TRANSITION_DEACTIVATE)
    for words in (
        "unconfigured: it neither listens nor publishes until it is configured "
        "(ros2 lifecycle set /identifier configure)",
        "configured: silent until it is activated (ros2 lifecycle set /identifier activate)",
        "deactivated: silent until it is activated (ros2 lifecycle set /identifier activate)",
    ):
        assert node.output.count(words) == 1, words


def test_a_lifecycle_manager_that_waits_for_no_bond_brings_it_up_and_down() -> None:
    """The requests of nav2's lifecycle manager with ``bond_timeout: 0.0``, one by one."""
    steps = (
        (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
        (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
        (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE),
        (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
        (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE),
        (Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED),
        (Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, State.PRIMARY_STATE_FINALIZED),
    )
    with Bench("/arm/identifier") as bench, identifier(remap={"__ns": "/arm"}) as node:
        for transition, state in steps:
            assert bench.change_state(transition), transition
            assert bench.call(GetState, "get_state").current_state.id == state
    assert node.returncode == 0


@pytest.mark.parametrize(("period", "deadline"), [(0.01, 0.05), (0.2, 1.0)])
def test_the_offered_deadline_follows_the_period_of_the_estimate(
    period: float, deadline: float
) -> None:
    with Bench() as bench, identifier({"autostart": True, "estimate.period": period}):
        bench.wait_until_connected()

        def offered(topic: str) -> float:
            (info,) = bench.node.get_publishers_info_by_topic(f"{bench.name}/{topic}")
            return float(info.qos_profile.deadline.nanoseconds * 1e-9)

        assert offered("estimate") == pytest.approx(deadline)
        # Nobody knows when a probe oscillates.
        assert offered("complex_modulus") > 1e6


# The end


def signals_until_gone(process: subprocess.Popen[str], number: int) -> None:
    """Send a signal again and again, as a terminal and a launch file both do."""
    while process.poll() is None:
        process.send_signal(number)
        time.sleep(0.005)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_node_that_is_interrupted_again_and_again_ends_cleanly(number: signal.Signals) -> None:
    with Bench() as bench, identifier({"autostart": True}) as node:
        bench.wait_until_connected()
        signals_until_gone(node, number)
    assert node.returncode == 0
    assert "Traceback" not in node.output


@contextlib.contextmanager
def importing(module: str, *command: str) -> Iterator[subprocess.Popen[str]]:
    """Run a Python program; yield it when it has just imported a module."""
    program = shutil.which(command[0])
    assert program is not None
    process = subprocess.Popen(
        [program, *command[1:]],
        env={**os.environ, "PYTHONPROFILEIMPORTTIME": "1"},
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    try:
        for line in process.stderr:
            if line.endswith(f" {module}\n"):
                break
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize(
    ("command", "module", "code"),
    [
        (("identifier",), "rclpy.utilities", 0),
        (("force_controller",), "rclpy.utilities", 0),
        (("fden", "replay", str(GOLDEN / "golden_press")), "numpy", 130),
    ],
)
def test_a_program_that_is_interrupted_while_it_starts_ends_cleanly(
    command: tuple[str, ...], module: str, code: int
) -> None:
    with importing(module, *command) as process:
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGINT)
        assert process.stderr is not None
        rest = process.stderr.read()
        assert process.wait(30.0) == code
    assert "Traceback" not in rest
