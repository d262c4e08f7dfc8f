# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The node's own status, once a second: on ``/diagnostics``, and once in its log."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode

from fden_ros.core.pipeline import Pipeline
from fden_ros.nodes.input_problems import clock_problem, pairing_problem, second_publisher
from fden_ros.nodes.session import Session
from fden_ros.ros.status import PipelineProblems, diagnostic_status, status_of

_PERIOD = 1.0
#: A warning of one kind is logged no more often than this [s].
_THROTTLE = 10.0


class Diagnostics:
    """Report for a node: on its session while it is active, before that on refused requests.

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
        """Stop reporting."""
        self._report = None

    def publish(self) -> None:
        """Publish the status; nothing while the node waits for a transition."""
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
    """Rates, rejected samples by reason, and problems of the inputs, in words."""

    def __init__(self, node: LifecycleNode, session: Session) -> None:
        self._node, self._session = node, session
        self._estimates = node.resolve_topic_name("~/estimate")
        self._pipeline_problems = PipelineProblems(session.pipeline)
        self._said: set[str] = set()
        self._seen_before: set[str] = set()
        self._logged: dict[str, float] = {}
        self._has_paired = False
        self._fastest: Counter[str] = Counter()
        self._before: dict[str, Counter[str]] = {}

    def status(self, name: str, refusal: str) -> DiagnosticStatus:
        """Return the status of the last second; log what is new."""
        session, pipeline = self._session, self._session.pipeline
        backlog, news = session.backlog, self._pipeline_problems.look()
        received = self._new("received", backlog.received)
        lost = self._lost(received)
        most_lag, slow = session.lag.look()
        errors = second_publisher(self._node, self._estimates)
        for kind, words in (
            *((one, one) for one in news.warnings),
            *(("rejected", _rejected(pipeline)) for _ in range(min(news.rejected, 1))),
            *(("slow", one) for one in slow),
            *((f"lost {number}", one) for number, one in enumerate(lost)),
        ):
            self._log(kind, words)
        for words in errors:
            self._log("error", words, is_error=True)
        problems = [*self._first_problems(), *news.problems, *lost, *slow]
        numbered = enumerate([*errors, *pipeline.problems, *problems], 1)
        values = {
            **{f"topic.{one.stream}": one.subscription.topic_name for one in session.listened_to},
            **{f"received.{one.stream}": received[one.stream] for one in session.listened_to},
            "waiting": backlog.waiting,
            "lag": f"{session.lag.newest:.4f}",
            "most lag": f"{most_lag:.4f}",
            "late": session.lag.late_count,
            **{f"lost.{k}": n for k, n in sorted((backlog.lost + backlog.dropped).items())},
            "last refusal": refusal,
            "last contact": session.lacks,
            # One by one: a problem may contain the separator of the message.
            **{f"problem {n}": one for n, one in numbered},
        }
        return diagnostic_status(name, problems, pipeline, news.pairs, values, errors=errors)

    def _log(self, kind: str, words: str, *, is_error: bool = False) -> None:
        """Log a warning or an error, of one kind no more often than every ten seconds."""
        now = time.monotonic()
        if now - self._logged.get(kind, -math.inf) < _THROTTLE:
            return
        self._logged[kind] = now
        logger = self._node.get_logger()
        if is_error:
            logger.error(words)
        else:
            logger.warning(words)

    def _first_problems(self) -> list[str]:
        """Return the problems of the inputs; log them once while no samples result."""
        session, pipeline, node = self._session, self._session.pipeline, self._node
        first = [
            problem
            for one in session.listened_to
            for problem in one.problems(node, has_come=session.inputs.has_come(one.stream))
        ]
        pairing = pipeline.transform_problem or pairing_problem(pipeline, session.inputs)
        if pairing:
            first.append(pairing)
        always = clock_problem(node)
        self._say_once([*([] if pipeline.pair_count else first), *always])
        if pipeline.pair_count and self._said and not self._has_paired:
            node.get_logger().info("force and displacement arrive now")
        self._has_paired = pipeline.pair_count > 0
        return [*first, *always]

    def _say_once(self, problems: Sequence[str]) -> None:
        """Log, once each, the problems that the last look also found.

        A publisher that has just been discovered has sent nothing yet.
        """
        for problem in problems:
            if problem in self._seen_before and problem not in self._said:
                self._said.add(problem)
                self._node.get_logger().warning(problem)
        self._seen_before = set(problems)

    def _lost(self, received: Counter[str]) -> list[str]:
        """Return what was lost in the last second, with its remedy, a sentence an input."""
        self._fastest |= received
        lost = self._new("lost", self._session.backlog.lost)
        dropped = self._new("dropped", self._session.backlog.dropped)
        return [
            words
            for one in self._session.listened_to
            for words in one.lost(
                *(counts[one.stream] for counts in (received, self._fastest, lost, dropped))
            )
        ]

    def _new(self, name: str, counts: Counter[str]) -> Counter[str]:
        """Return what was counted since the last look."""
        before, self._before[name] = self._before.get(name, Counter()), counts.copy()
        return counts - before


def _rejected(pipeline: Pipeline) -> str:
    counts = ", ".join(f"{reason} {n}" for reason, n in sorted(pipeline.rejected.items()))
    return f"samples rejected in the last second, by reason so far: {counts}"
