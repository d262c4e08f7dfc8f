# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The rows of test/faults.md that only a running node meets: over real DDS."""

from __future__ import annotations

import contextlib
import math
import signal
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from fden_msgs.msg import TissueEstimate
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from live_helpers import LIMIT
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_helpers import LOSSLESS, STEP_NS, Bench, Live, active, identifier
from sensor_msgs.msg import JointState

from fden_ros.ros.messages import to_stamp

GOOD = (
    TissueEstimate.STATUS_NO_CONTACT,
    TissueEstimate.STATUS_CONVERGING,
    TissueEstimate.STATUS_CONVERGED,
)


def row(name: str) -> Callable[[Any], Any]:
    """Say which row of the table a test shows."""
    assert name
    return lambda test: test


@pytest.fixture(scope="module")
def live() -> Iterator[Live]:
    with Bench() as bench, active() as process:
        bench.wait_until_heard()
        shared = Live(bench)
        shared.stream(1.0)
        yield shared
        for message in bench.estimates + bench.summaries:
            # What is not known is NaN.
            assert not any(map(math.isinf, floats_of(message)))
    assert "Traceback" not in process.output
    errors = [line for line in process.output.splitlines() if "[ERROR]" in line]
    assert all("/identifier/estimate has 2 publishers" in line for line in errors)
    if any("/estimate has 2" in one.status[0].message for one in bench.diagnostics):
        assert errors
    # Throttled: one line in ten seconds, whatever comes.
    said = process.output.count("samples rejected in the last second")
    assert said < 3 + len(bench.diagnostics) / 5


@contextlib.contextmanager
def another_publisher(kind: type, qos: QoSProfile) -> Iterator[None]:
    """A second publisher of /force, as of another process."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("another", context=context)
    node.create_publisher(kind, "/force", qos)
    try:
        yield
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def floats_of(message: Any) -> list[float]:
    kinds = message.get_fields_and_field_types().items()
    doubles = [getattr(message, name) for name, kind in kinds if "double" in kind]
    return np.concatenate([np.ravel(one) for one in doubles]).tolist()


@row("sigterm_in_contact")
def test_a_signal_in_a_contact_publishes_its_summary():
    with Bench() as bench, identifier({"autostart": True, **LOSSLESS}) as process:
        bench.wait_until_heard()
        one = Live(bench)
        one.stream(1.5)
        one.stream(1.0, lambda t: 5e-3 * t)
        for _ in range(50):
            if any(found.status in GOOD[1:] for found in bench.estimates):
                break
            # A node that has just started may be late with the first.
            one.stream(0.2, lambda t: 5e-3)
        process.send_signal(signal.SIGTERM)
        bench.wait_for(lambda: bench.summaries, "the summary of the open contact")
        assert process.wait(LIMIT) == 0
    assert not bench.summaries[0].complete


BROKEN = """
from fden_ros.core.estimation import GridEstimator
real, seen = GridEstimator.add, []

def add(self, *block, **options):
    seen.append(self)
    if self is seen[0] and len(seen) > 20:
        raise ZeroDivisionError("on purpose")
    return real(self, *block, **options)

GridEstimator.add = add
"""


@row("estimator_raises_live")
def test_an_exception_of_the_core_ends_a_contact_and_its_site_and_the_node_goes_on():
    parameters = {"autostart": True, "site.timeout": 1.0, **LOSSLESS}
    with Bench() as bench, identifier(parameters, first=BROKEN) as process:
        bench.wait_until_heard()
        one = Live(bench)

        def press() -> None:
            # Through the air: a probe that rested on the surface has not been seen to touch it.
            one.stream(1.5, lambda t: -1e-3)
            one.stream(1.2, lambda t: 5e-3 * t - 1e-3)
            one.stream(0.5, lambda t: -1e-3)

        press()
        bench.wait_for(lambda: bench.summaries, "the summary of the failed contact")
        failed = bench.summaries[0]
        assert failed.flags & TissueEstimate.FLAG_ESTIMATION_FAILED
        assert not failed.complete and not failed.converged
        bench.wait_for(
            lambda: "the estimation failed in contact 1" in bench.diagnostic().get("message", ""),
            "the words in the diagnostics",
        )
        assert bench.diagnostic()["failures"] == "1"
        assert bench.diagnostic_level() == DiagnosticStatus.ERROR
        press()
        bench.wait_for(lambda: len(bench.summaries) > 1, "the next site's summary")
        after = bench.summaries[-1]
        assert after.site_id == failed.site_id + 1 and after.complete
        assert not after.flags & TissueEstimate.FLAG_ESTIMATION_FAILED
        assert after.linear_stiffness > 0.0
        bench.wait_for(
            lambda: bench.diagnostic_level() != DiagnosticStatus.ERROR, "no error any more"
        )
        one.recovers()
    assert process.returncode == 0
    output = process.output  # type: ignore[attr-defined]
    assert output.count("Traceback (most recent call last)") == 1
    assert output.count("ZeroDivisionError: on purpose): this site gives no estimate") == 1


@row("sim_time_without_clock")
def test_sim_time_without_a_clock_is_said_and_the_estimates_go_on():
    with Bench() as bench, active({"use_sim_time": True}):
        bench.wait_until_heard()
        one = Live(bench)
        one.wait_for_words("nothing publishes /clock")
        one.recovers()


@row("wrong_frame")
@row("missing_field")
def test_another_frame_and_a_joint_state_without_a_position_are_counted(live):
    message = JointState(name=["probe"])
    for _ in range(30):
        live.now += STEP_NS
        message.header.stamp = to_stamp(live.now)
        live.bench.publish(live.now, 50.0, 0.0, frame="other")
        live.bench.displacement.publish(message)
    live.wait_for_count("force.wrong_frame", 30)
    live.wait_for_count("displacement.missing_field", 30)
    live.recovers()


@row("two_publishers_live")
@row("wrong_type")
@row("qos_mismatch")
@pytest.mark.parametrize(
    ("kind", "reliability", "words"),
    [
        (WrenchStamped, ReliabilityPolicy.RELIABLE, "2 publishers"),
        (JointState, ReliabilityPolicy.RELIABLE, "expected geometry_msgs/msg/WrenchStamped"),
        (WrenchStamped, ReliabilityPolicy.BEST_EFFORT, "best_effort but reliable is requested"),
    ],
)
def test_another_publisher_that_does_not_fit_is_said(live, kind, reliability, words):
    with another_publisher(kind, QoSProfile(depth=10, reliability=reliability)):
        live.wait_for_words(words)
    live.recovers()


def test_a_second_publisher_of_the_estimate_is_an_error(live):
    node, words = live.bench.node, "/identifier/estimate has 2 publishers"
    other = node.create_publisher(TissueEstimate, "/identifier/estimate", 10)
    live.wait_for_words(words)
    assert live.bench.diagnostics[-1].status[0].level == DiagnosticStatus.ERROR
    node.destroy_publisher(other)
    live.recovers()


@row("topic_stops_live")
def test_a_pause_of_the_topics_is_stale_and_then_over(live):
    live.bench.wait_for(
        lambda: any(e.status == TissueEstimate.STATUS_STALE for e in live.bench.estimates[-1:]),
        "a stale estimate",
    )
    live.bench.wait_for(
        lambda: "no pair" in live.bench.diagnostic().get("message", ""), "the words"
    )
    live.recovers()


@row("parameters_while_active")
def test_parameters_of_wrong_type_or_range_or_while_active_are_refused(live):
    values = {
        "geometry.area": 2e-4,
        "geometry.thickness": -1.0,
        "force.limit": "much",
        "prior.alpha": math.nan,
        "source_timeout": 1e9,
        "no.such": 1.0,
    }
    for name, value in values.items():
        (result,) = live.bench.set_parameters({name: value})
        assert not result.successful and result.reason, name
    live.recovers()


@row("deactivated_in_contact")
def test_deactivating_in_a_contact_reports_it_and_activating_starts_afresh(live):
    live.stream(1.0)
    before = len(live.bench.summaries)
    live.stream(1.0, lambda t: 5e-3 * t)
    live.bench.wait_for(
        lambda: any(e.status in GOOD[1:] for e in live.bench.estimates[-1:]),
        "estimates of the contact",
    )
    assert live.bench.change_state(Transition.TRANSITION_DEACTIVATE)
    live.bench.wait_for(lambda: len(live.bench.summaries) > before, "the summary")
    assert not live.bench.summaries[-1].complete
    assert live.bench.change_state(Transition.TRANSITION_ACTIVATE)
    live.bench.wait_until_heard()
    live.recovers()
