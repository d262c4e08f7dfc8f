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

"""What the node says about itself, once a second: on ``/diagnostics``, and once in its log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode

from fden_ros.core.pipeline import Pipeline
from fden_ros.nodes.backlog import Backlog
from fden_ros.nodes.input_problems import ListenedTo, clock_problem, pairing_problem
from fden_ros.ros.inputs import TRANSFORM_TOPICS, Inputs
from fden_ros.ros.status import PipelineProblems, diagnostic_status

_PERIOD = 1.0
#: The same words come into the log no more often than this [s].
_THROTTLE = 10.0


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
        self._lost: dict[str, int] = {}
        self._lost_before = 0

    def start(
        self,
        pipeline: Pipeline,
        inputs: Inputs,
        listened_to: Sequence[ListenedTo],
        backlog: Backlog,
        is_collecting: Callable[[], bool],
    ) -> None:
        """Begin to report on `pipeline`, fed by `listened_to`, a list that may still grow.

        While `is_collecting` the samples go to the identification of the tool.
        """
        self._backlog = backlog
        self._is_collecting = is_collecting
        self._pipeline = pipeline
        self._inputs = inputs
        self._listened_to = listened_to
        self._pipeline_problems = PipelineProblems(pipeline)
        self._told: set[str] = set()
        self._seen_before: set[str] = set()
        self._has_paired = False
        self._lost.clear()
        self._lost_before = 0
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
        news = self._pipeline_problems.look()
        for words in news.warnings:
            self._node.get_logger().warning(words, throttle_duration_sec=_THROTTLE)
        self._log_rejected(pipeline, news.rejected)
        problems = [*self._first_problems(pipeline), *news.problems, *self._lost_messages()]
        if pipeline.is_failed:
            problems.insert(0, str(pipeline.failures[-1]))
        status = diagnostic_status(
            self._node.get_fully_qualified_name(),
            problems,
            pipeline,
            news.pairs,
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

    def _first_problems(self, pipeline: Pipeline) -> list[str]:
        """Return what is wrong with the inputs; log it once while nothing has come of them."""
        if self._is_collecting():
            return ["identify_tool is collecting: nothing is estimated until it has answered"]
        inputs = [problem for one in self._listened_to for problem in self._problems_of(one)]
        clock = clock_problem(self._node)
        pairing = pipeline.transform_problem or pairing_problem(pipeline, self._inputs)
        always = [clock] if clock else []
        first = [*inputs, pairing] if pairing else inputs
        self._tell(always if pipeline.pair_count else [*first, *always])
        if pipeline.pair_count and self._told and not self._has_paired:
            self._node.get_logger().info("force and displacement come now")
        self._has_paired = pipeline.pair_count > 0
        return [*first, *always]

    def _problems_of(self, one: ListenedTo) -> list[str]:
        if one.what in TRANSFORM_TOPICS:
            # Many publish them, or none: what counts is whether they connect the frames.
            return one.wrong_publishers(self._node)
        return one.problems(self._node, has_come=self._inputs.has_come(one.what))

    def _tell(self, problems: Sequence[str]) -> None:
        """Log, once each, the problems that were seen at the last look too.

        A publisher that has just been discovered has sent nothing yet.
        """
        for problem in problems:
            if problem in self._seen_before and problem not in self._told:
                self._told.add(problem)
                self._node.get_logger().warning(problem)
        self._seen_before = set(problems)

    def _log_rejected(self, pipeline: Pipeline, rejected: int) -> None:
        if not rejected:
            return
        counts = ", ".join(f"{k} {n}" for k, n in sorted(pipeline.rejected.items()))
        self._node.get_logger().warning(
            f"{rejected} samples rejected in the last second, by reason so far: {counts}",
            throttle_duration_sec=_THROTTLE,
        )

    def _lost_messages(self) -> list[str]:
        lost = sum(self._lost_by_topic().values()) - self._lost_before
        self._lost_before += lost
        if not lost:
            return []
        words = f"{lost} messages lost in the last second: they come too fast"
        self._node.get_logger().warning(words, throttle_duration_sec=_THROTTLE)
        return [words]
