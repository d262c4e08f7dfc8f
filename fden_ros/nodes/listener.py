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

"""Receiving what an identifier publishes, in a plain program."""

from __future__ import annotations

import time
from collections.abc import Mapping
from types import TracebackType
from typing import Any

import rclpy
from fden_msgs.msg import PalpationSummary, TissueEstimate
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from fden_ros.core.outputs import ContactSummary, Status, TissueState
from fden_ros.report.figure import Session
from fden_ros.ros.messages import state_of, summary_of

_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
_LATCHED = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


class Listener:
    """Keep every estimate, but those that say there is none, and summary of one identifier.

    Owns an rclpy context, so that it can live beside other nodes of the process.

    Parameters
    ----------
    identifier : str
        Fully qualified name of the node.
    """

    def __init__(self, identifier: str) -> None:
        self._identifier = identifier
        self.states: list[TissueState] = []
        self.summaries: list[ContactSummary] = []
        self._heard = time.monotonic()

    def __enter__(self) -> Listener:
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node("fden_listener", context=self._context)
        self._node.create_subscription(
            TissueEstimate, f"{self._identifier}/estimate", self._on_estimate, _QOS
        )
        self._node.create_subscription(
            PalpationSummary, f"{self._identifier}/palpation", self._on_summary, _LATCHED
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def spin(self, seconds: float) -> None:
        """Receive for `seconds`."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    @property
    def quiet_for(self) -> float:
        """Seconds since the last message that holds something."""
        return time.monotonic() - self._heard

    def session(self, truth: Mapping[int, Mapping[str, Any]]) -> Session:
        """Return what was received, with the truth by site."""
        return Session(tuple(self.states), tuple(self.summaries), truth)

    def _on_estimate(self, message: TissueEstimate) -> None:
        state = state_of(message)
        if state.status is Status.STALE:
            return
        self._heard = time.monotonic()
        self.states.append(state)

    def _on_summary(self, message: PalpationSummary) -> None:
        self._heard = time.monotonic()
        summary = summary_of(message)
        # The air after it may contradict a contact.
        self.summaries = [s for s in self.summaries if s.contact_id != summary.contact_id]
        self.summaries.append(summary)
