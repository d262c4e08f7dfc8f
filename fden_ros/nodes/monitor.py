# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The outputs of one identifier, gathered for a view."""

from __future__ import annotations

import time
from collections import deque
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fden_msgs.msg import PalpationSummary, TissueClassification
from std_msgs.msg import String

from fden_ros.core.outputs import ContactSummary, TissueState
from fden_ros.report.monitor import MonitorView
from fden_ros.ros.messages import summary_of
from fden_ros.ros.plain_node import plain_node, spin_for
from fden_ros.ros.topics import latched
from fden_ros.tissue_feed import TissueFeed

_DEADLINE = 0.5
_RATE_WINDOW = 2.0


class Monitor:
    """Receive everything that one identifier publishes; keep the newest.

    Owns an rclpy context.

    Parameters
    ----------
    identifier : str
        Fully qualified name of the node.
    """

    def __init__(self, identifier: str) -> None:
        self._identifier = identifier
        self._opened = ExitStack()
        self._view = MonitorView(identifier)
        self._arrivals: deque[float] = deque()

    @property
    def summaries(self) -> tuple[ContactSummary, ...]:
        """The newest of each contact."""
        return self._view.summaries

    def __enter__(self) -> Monitor:
        node, self._executor = self._opened.enter_context(plain_node("fden_monitor"))
        self._feed = TissueFeed(
            node, self._identifier, deadline=_DEADLINE, on_state=self._on_state
        )
        node.create_subscription(
            TissueClassification,
            f"{self._identifier}/classification",
            self._on_classification,
            latched(100),
        )
        node.create_subscription(
            PalpationSummary, f"{self._identifier}/palpation", self._on_summary, latched(100)
        )
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        namespace = self._identifier.rsplit("/", 1)[0]
        node.create_subscription(
            String, f"{namespace}/force_controller/gains", self._on_gains, latched(100)
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def spin(self, seconds: float) -> None:
        """Receive for `seconds`."""
        spin_for(self._executor, seconds)

    def view(self) -> MonitorView:
        """Return the present view."""
        now, heard = time.monotonic(), self._arrivals[-1] if self._arrivals else None
        while len(self._arrivals) > 1 and now - self._arrivals[0] > _RATE_WINDOW:
            self._arrivals.popleft()
        recent = sum(now - arrival <= _RATE_WINDOW for arrival in self._arrivals)
        return replace(
            self._view,
            age=None if heard is None else now - heard,
            rate=recent / _RATE_WINDOW,
            refusal=self._feed.refusal(),
        )

    def _see(self, **news: Any) -> None:
        self._view = replace(self._view, **news)

    def _on_state(self, state: TissueState) -> None:
        self._see(state=state)
        self._arrivals.append(time.monotonic())

    def _on_classification(self, message: TissueClassification) -> None:
        probabilities = zip(message.class_names, message.probabilities, strict=True)
        self._see(label=message.label, probabilities=dict(probabilities))

    def _on_summary(self, message: PalpationSummary) -> None:
        summary = summary_of(message)
        # The air after it may contradict a contact.
        others = (s for s in self.summaries if s.contact_id != summary.contact_id)
        self._see(summaries=(*others, summary))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if is_of(status, self._identifier):
                values = {value.key: value.value for value in status.values}
                self._see(diagnostics={"message": status.message, **values})

    def _on_gains(self, message: String) -> None:
        self._see(gains=message.data)


def is_of(status: DiagnosticStatus, identifier: str) -> bool:
    """Return whether a status of ``/diagnostics`` is that of a node."""
    return bool(status.name.split(":")[0].strip("/") == identifier.strip("/"))
