# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""State of an active identifier: subscriptions, pipeline, outputs.

One object an activation: data from before an interruption are not trusted after it.
"""

from __future__ import annotations

import copy
import threading
import time
from collections.abc import Mapping
from dataclasses import replace

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.lifecycle.publisher import LifecyclePublisher
from rclpy.qos import QoSPolicyKind
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.time import Time

from fden_ros.core.outputs import ContactSummary, Output, Status, TissueState, late, placed, stale
from fden_ros.core.pipeline import Pipeline
from fden_ros.inputs import TRANSFORMS, TYPE_NAMES, Inputs
from fden_ros.nodes.backlog import TAKE_PERIOD, Backlog, Taken
from fden_ros.nodes.input_problems import ListenedTo
from fden_ros.nodes.lag import Lag
from fden_ros.offline.advice import shortfall
from fden_ros.offline.thickness import assumed
from fden_ros.parameters import Parameters, pipeline_config
from fden_ros.recording.message_types import message_class
from fden_ros.ros.topics import INPUT_QOS, STATIC_QOS, OutputMessages

#: Period of the check that the input has not stopped [s].
_STALE_CHECK_PERIOD = 0.05
#: A stale estimate is repeated at this period [s].
_STALE_PERIOD = 1.0


class Session:
    """One activation of the identifier.

    Parameters
    ----------
    node : LifecycleNode
    parameters : Parameters
    publishers : mapping
        By the name of an output topic.
    lock : RLock
        Held in callbacks and transitions.
    """

    def __init__(
        self,
        node: LifecycleNode,
        parameters: Parameters,
        publishers: Mapping[str, LifecyclePublisher],
        lock: threading.RLock,
    ) -> None:
        self._node, self._parameters, self._lock = node, parameters, lock
        self._publishers = publishers
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.pipeline = Pipeline(pipeline_config(parameters), self._publish)
        self.inputs = Inputs(parameters, self.pipeline)
        self.backlog = Backlog(self.inputs, is_restamped=parameters.stamp_source == "receive")
        self.listened_to: list[ListenedTo] = []
        self.lag = Lag()
        self._messages = OutputMessages()
        self._last_state: TissueState | None = None
        self._last_input = self._steady.now()
        self._said_stale: Time | None = None
        self._seen_pairs = self._seen_failures = 0
        self.lacks = ""  #: the newest contact to converge, and the remedy
        self._is_open = False
        self._lag_deadline = 0.0
        self._read_lag_deadline()
        self._timers = [
            node.create_timer(period, action, clock=self._steady)
            for period, action in ((TAKE_PERIOD, self._take), (_STALE_CHECK_PERIOD, self._look))
        ]

    def listen(self) -> None:
        """Subscribe to the inputs."""
        self._is_open = True
        for name in self.inputs.names:
            kind = getattr(self._parameters, name).message
            self._subscribe(TYPE_NAMES[name][kind], name)
        for name in self.inputs.transform_topics:
            self._subscribe(TRANSFORMS, name)
        # rclpy's first line takes a tenth of a second: here, not in the middle of a contact.
        *first, last = (one.subscription.topic_name for one in self.listened_to)
        self._node.get_logger().info(f"listening to {', '.join(first)} and {last}")
        for problem in self.pipeline.problems:
            self._node.get_logger().warning(problem)
        if words := assumed(self.pipeline.config.geometry):
            self._node.get_logger().info(words)

    def finish(self) -> None:
        """Report the open contact and stop listening."""
        self.pipeline.finish()
        self._log_failures()
        self.close()

    def close(self) -> None:
        """Stop listening."""
        self._is_open = False
        self.backlog.clear()
        for one in self.listened_to:
            self._node.destroy_subscription(one.subscription)
        self.listened_to.clear()
        for timer in self._timers:
            self._node.destroy_timer(timer)

    def reset(self) -> str | None:
        """Reset all that was learned; return None, or why that is not possible now."""
        problem = self.pipeline.reset()
        if problem is None:
            self.inputs.reset()
        return problem

    # Inputs

    def _subscribe(self, kind: str, topic: str) -> None:
        subscription = self._node.create_subscription(
            message_class(kind),
            topic,
            lambda data: None,
            copy.copy(STATIC_QOS if topic == "/tf_static" else INPUT_QOS),
            callback_group=Taken(),
            # The diagnostics report the problem, with the override that solves it.
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            qos_overriding_options=QoSOverridingOptions([QoSPolicyKind.RELIABILITY]),
            raw=True,
        )
        self.listened_to.append(ListenedTo(topic, subscription))
        self.backlog.listen(topic, kind, subscription)

    def _take(self) -> None:
        with self._lock:
            if not self._is_open:
                return
            self.backlog.work()

    # Outputs

    def _publish(self, output: Output) -> None:
        if isinstance(output, TissueState):
            self._last_state = output
            output = self._with_lag(output)
        self._publish_messages(output)
        if isinstance(output, ContactSummary):
            self.lacks = shortfall(output, self.pipeline.config)
            if self.lacks:
                self._node.get_logger().info(f"contact {output.contact_id}: {self.lacks}")

    def _with_lag(self, state: TissueState) -> TissueState:
        """Return a state with its age: from the receipt of the sample that completed it to now."""
        lag = max(1e-9 * (time.time_ns() - self.backlog.received_ns), 0.0)
        found = late(replace(state, lag=lag), self._lag_deadline)
        self.lag.add(lag, is_late=found.status is Status.LATE)
        return found

    def _read_lag_deadline(self) -> None:
        self._lag_deadline = float(self._node.get_parameter("lag_deadline").value)

    def _publish_messages(self, output: Output) -> None:
        output = placed(output, self.inputs.displacement_frame)
        for topic, message in self._messages.of(output, self.inputs.force_frame):
            self._publishers[topic.name].publish(message)

    def _look(self) -> None:
        with self._lock:
            if not self._is_open:
                return
            self._read_lag_deadline()
            self._log_failures()
            self._check_stale()

    def _log_failures(self) -> None:
        pipeline = self.pipeline
        new = pipeline.failure_count - self._seen_failures
        self._seen_failures += new
        for failure in list(pipeline.failures)[-new:] if new else ():
            self._node.get_logger().error(f"{failure}\n{failure.traceback}")

    def _check_stale(self) -> None:
        now, pairs = self._steady.now(), self.pipeline.pair_count
        if pairs != self._seen_pairs:
            self._seen_pairs, self._last_input, self._said_stale = pairs, now, None
            return
        waited = _seconds(self._last_input, now)
        if waited < self._node.get_parameter("source_timeout").value:
            return
        if self._said_stale is not None:
            if _seconds(self._said_stale, now) < _STALE_PERIOD:
                return
        elif self._last_state is not None:
            self._node.get_logger().warning(
                f"no usable pair of force and displacement for {waited:.2f} s: the estimate is "
                "stale"
            )
        # Repeated for late subscribers.
        self._said_stale = now
        self._last_state = stale(self._last_state, self.pipeline.standing_flags)
        self._publish_messages(self._last_state)


def _seconds(start: Time, end: Time) -> float:
    return float((end - start).nanoseconds * 1e-9)
