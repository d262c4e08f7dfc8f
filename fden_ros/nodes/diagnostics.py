# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the node says about itself, once a second: on ``/diagnostics``, and once in its log."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode

from fden_ros.nodes.input_problems import (
    ListenedTo,
    clock_problem,
    lost_problem,
    pairing_problem,
)
from fden_ros.nodes.session import Session
from fden_ros.ros.inputs import TRANSFORM_TOPICS
from fden_ros.ros.status import PipelineProblems, diagnostic_status, status_of

_PERIOD = 1.0
#: A warning of one kind comes into the log no more often than this [s].
_THROTTLE = 10.0


class Diagnostics:
    """Speak for a node: of its session while it is active, before that of what it refused.

    Parameters
    ----------
    node : LifecycleNode
        Owns the publisher and the timer.
    lock : RLock
        Held in callbacks and transitions.

    Attributes
    ----------
    refusal : str
        The last request that was refused, and why; empty: none.
    is_stuck : bool
        Whether that keeps the node from being configured or activated.
    """

    def __init__(self, node: LifecycleNode, lock: threading.RLock) -> None:
        self._node, self._lock = node, lock
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._report: _Report | None = None
        self.refusal, self.is_stuck = "", False
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_PERIOD, self.publish, clock=steady)

    def begin(self, session: Session) -> None:
        """Report on a session from now on."""
        self._report = _Report(self._node, session)

    def end(self) -> None:
        """Fall silent."""
        self._report = None

    def publish(self) -> None:
        """Publish what there is to say; nothing while the node waits for a transition."""
        with self._lock:
            status = self._status()
        if status is None:
            return
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _status(self) -> DiagnosticStatus | None:
        name = self._node.get_fully_qualified_name()
        if self._report is not None:
            return self._report.status(name, self.refusal)
        if self.is_stuck:
            return status_of(name, DiagnosticStatus.ERROR, self.refusal)
        return None


class _Report:
    """Rates, rejected samples by reason, and what is wrong with the inputs, in words."""

    def __init__(self, node: LifecycleNode, session: Session) -> None:
        self._node, self._session = node, session
        self._pipeline_problems = PipelineProblems(session.pipeline)
        self._said: set[str] = set()
        self._seen_before: set[str] = set()
        self._warned: dict[str, float] = {}
        self._has_paired = False
        self._fastest: Counter[str] = Counter()
        self._received_before: Counter[str] = Counter()
        self._lost_before: Counter[str] = Counter()
        self._dropped_before: Counter[str] = Counter()

    def status(self, name: str, refusal: str) -> DiagnosticStatus:
        """Return the status of the last second; log what is new."""
        session, pipeline = self._session, self._session.pipeline
        news = self._pipeline_problems.look()
        backlog = session.backlog
        received = backlog.received - self._received_before
        self._received_before = backlog.received.copy()
        lost = self._lost_messages(received)
        lags = session.lag.look()
        slow = [lags.problem] if lags.problem else []
        if news.rejected:
            counts = ", ".join(f"{k} {n}" for k, n in sorted(pipeline.rejected.items()))
            self._warn(
                "rejected",
                f"{news.rejected} samples rejected in the last second, by reason so far: {counts}",
            )
        for words in news.warnings:
            self._warn(words, words)
        for words in slow:
            self._warn("slow", words)
        for number, words in enumerate(lost):
            self._warn(f"lost {number}", words)
        problems = [*self._first_problems(), *news.problems, *lost, *slow]
        if pipeline.is_failed:
            problems.insert(0, str(pipeline.failures[-1]))
        values = {
            **{f"topic.{one.stream}": one.subscription.topic_name for one in session.listened_to},
            **{f"received.{one.stream}": received[one.stream] for one in session.listened_to},
            "waiting": backlog.waiting,
            "most waiting": backlog.most_waiting,
            "lag": f"{session.lag.newest:.4f}",
            "most lag": f"{lags.most:.4f}",
            "late": session.lag.late_count,
            **{f"lost.{k}": n for k, n in sorted((session.lost + backlog.dropped).items())},
            "last refusal": refusal,
            "last contact": session.lacks,
            # Each alone: a problem may hold the mark that stands between them in the message.
            **{f"problem {n}": one for n, one in enumerate([*pipeline.problems, *problems], 1)},
        }
        return diagnostic_status(name, problems, pipeline, news.pairs, values)

    def _warn(self, kind: str, words: str) -> None:
        """Log a warning, of one kind no more often than every ten seconds."""
        now = time.monotonic()
        if now - self._warned.get(kind, -math.inf) >= _THROTTLE:
            self._warned[kind] = now
            self._node.get_logger().warning(words)

    def _first_problems(self) -> list[str]:
        """Return what is wrong with the inputs; log it once while nothing has come of them."""
        session, pipeline = self._session, self._session.pipeline
        first = [problem for one in session.listened_to for problem in self._problems_of(one)]
        pairing = pipeline.transform_problem or pairing_problem(pipeline, session.inputs)
        if pairing:
            first.append(pairing)
        clock = clock_problem(self._node)
        always = [clock] if clock else []
        self._say_once([*([] if pipeline.pair_count else first), *always])
        if pipeline.pair_count and self._said and not self._has_paired:
            self._node.get_logger().info("force and displacement come now")
        self._has_paired = pipeline.pair_count > 0
        return [*first, *always]

    def _problems_of(self, one: ListenedTo) -> list[str]:
        if one.stream in TRANSFORM_TOPICS:
            # Many publish them, or none: what counts is whether they connect the frames.
            return one.wrong_publishers(self._node)
        return one.problems(self._node, has_come=self._session.inputs.has_come(one.stream))

    def _say_once(self, problems: Sequence[str]) -> None:
        """Log, once each, the problems that were seen at the last look too.

        A publisher that has just been discovered has sent nothing yet.
        """
        for problem in problems:
            if problem in self._seen_before and problem not in self._said:
                self._said.add(problem)
                self._node.get_logger().warning(problem)
        self._seen_before = set(problems)

    def _lost_messages(self, received: Counter[str]) -> list[str]:
        """Return what was lost in the last second, and what mends it, a sentence an input."""
        lost, dropped = self._session.lost, self._session.backlog.dropped
        self._fastest |= received
        words = [
            lost_problem(
                one,
                received[one.stream],
                self._fastest[one.stream],
                lost[one.stream] - self._lost_before[one.stream],
                dropped[one.stream] - self._dropped_before[one.stream],
            )
            for one in self._session.listened_to
        ]
        self._lost_before, self._dropped_before = lost.copy(), dropped.copy()
        return [one for one in words if one]
