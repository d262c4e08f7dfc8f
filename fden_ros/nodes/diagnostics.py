"""What the node says about itself on ``/diagnostics``, once a second."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import qos_policy_name_from_kind
from rclpy.subscription import Subscription

from fden_ros.core.pipeline import Pipeline
from fden_ros.nodes.backlog import Backlog
from fden_ros.ros.status import diagnostic_status, type_name

_PERIOD = 1.0


class Diagnostics:
    """Rates, rejected samples by reason, and what is wrong with the inputs, in words.

    Parameters
    ----------
    node : LifecycleNode
        Owns the publisher and the timer.
    """

    def __init__(self, node: LifecycleNode) -> None:
        self._node = node
        self._publisher = node.create_lifecycle_publisher(DiagnosticArray, "/diagnostics", 10)
        self._timer: Any = None
        self._pipeline: Pipeline | None = None
        self._subscriptions: Sequence[Subscription] = ()
        self._incompatible: dict[str, str] = {}
        self._lost: dict[str, int] = {}
        self._backlog = Backlog()
        self._pairs_before = 0
        self._rejected_before = 0
        self._lost_before = 0

    def start(
        self, pipeline: Pipeline, subscriptions: Sequence[Subscription], backlog: Backlog
    ) -> None:
        """Begin to report on `pipeline`, fed by `subscriptions`, a list that may still grow."""
        self._backlog = backlog
        self._pipeline = pipeline
        self._subscriptions = subscriptions
        self._incompatible.clear()
        self._lost.clear()
        self._lost_before = 0
        self._pairs_before = self._rejected_before = 0
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self._node.create_timer(_PERIOD, self._publish, clock=steady)

    def stop(self) -> None:
        """Fall silent."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        self._timer = None
        self._pipeline = None

    def destroy(self) -> None:
        """Release the publisher."""
        self.stop()
        self._node.destroy_publisher(self._publisher)

    def incompatible_qos(self, topic: str, event: Any) -> None:
        """Take note of a publisher whose QoS does not match."""
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        problem = (
            f"a publisher on {topic} offers an incompatible {policy.lower()}: nothing "
            f"comes from it"
        )
        self._incompatible[topic] = problem
        self._node.get_logger().warning(problem, throttle_duration_sec=10.0)

    def message_lost(self, topic: str, event: Any) -> None:
        """Take note of messages that came faster than they were read."""
        self._lost[topic] = int(event.total_count)

    def _lost_by_topic(self) -> Counter[str]:
        """Return what the middleware and the backlog dropped so far."""
        return Counter(self._lost) + self._backlog.dropped

    def _publish(self) -> None:
        pipeline = self._pipeline
        if pipeline is None:
            return
        status = diagnostic_status(
            self._node.get_fully_qualified_name(),
            self._problems(pipeline),
            pipeline,
            self._pairs_before,
            {
                "waiting": self._backlog.waiting,
                "most waiting": self._backlog.most_waiting,
                "batches": self._backlog.batches,
                **{
                    f"lost.{topic}": count
                    for topic, count in sorted(self._lost_by_topic().items())
                },
            },
            hardware_id=str(self._node.get_parameter("hardware_id").value),
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
        self._pairs_before = pipeline.pair_count
        self._rejected_before = pipeline.unusual_rejections

    def _problems(self, pipeline: Pipeline) -> list[str]:
        problems = list(self._incompatible.values())
        if pipeline.is_failed:
            problems.append(str(pipeline.failures[-1]))
        for subscription in self._subscriptions:
            problems += self._publisher_problems(subscription)
        if pipeline.pair_count == self._pairs_before:
            problems.append("no pair of force and displacement in the last second")
        lost = sum(self._lost_by_topic().values()) - self._lost_before
        self._lost_before += lost
        if lost:
            problems.append(f"{lost} messages lost in the last second: they come too fast")
            self._node.get_logger().warning(
                f"{lost} messages lost in the last second: they come too fast",
                throttle_duration_sec=10.0,
            )
        rejected = pipeline.unusual_rejections - self._rejected_before
        if rejected:
            problems.append(f"{rejected} samples rejected in the last second")
            self._node.get_logger().warning(
                f"{rejected} samples rejected in the last second, by reason so far: "
                + ", ".join(f"{k} {n}" for k, n in sorted(pipeline.rejected.items())),
                throttle_duration_sec=10.0,
            )
        if (
            self._node.get_parameter("use_sim_time").value
            and not self._node.get_clock().now().nanoseconds
        ):
            problems.append("use_sim_time is set but nothing publishes /clock")
        return problems

    def _publisher_problems(self, subscription: Subscription) -> list[str]:
        topic = subscription.topic_name
        publishers = self._node.get_publishers_info_by_topic(topic)
        if not publishers:
            return [f"nothing publishes {topic}"]
        expected = type_name(subscription.msg_type)
        wrong = {p.topic_type for p in publishers if p.topic_type != expected}
        problems = [
            f"{topic} is published as {kind}, expected {expected}" for kind in sorted(wrong)
        ]
        if len(publishers) > 1:
            problems.append(f"{topic} has {len(publishers)} publishers: their samples are mixed")
        return problems
