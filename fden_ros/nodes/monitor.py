# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What one identifier says, gathered for a view of it."""

from __future__ import annotations

import time
from collections import deque
from contextlib import ExitStack

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
    """Hear everything that one identifier publishes; keep the newest.

    Owns an rclpy context.

    Parameters
    ----------
    identifier : str
        Fully qualified name of the node.

    Attributes
    ----------
    summaries : list of ContactSummary
        The newest of each contact.
    """

    def __init__(self, identifier: str) -> None:
        self._identifier = identifier
        self._opened = ExitStack()
        self.summaries: list[ContactSummary] = []
        self._arrivals: deque[float] = deque()
        self._state: TissueState | None = None
        self._heard: float | None = None
        self._classification: TissueClassification | None = None
        self._diagnostics: dict[str, str] = {}
        self._gains = ""

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
        """Return what is known now."""
        now = time.monotonic()
        while self._arrivals and now - self._arrivals[0] > _RATE_WINDOW:
            self._arrivals.popleft()
        classification = self._classification
        return MonitorView(
            identifier=self._identifier,
            state=self._state,
            age=None if self._heard is None else now - self._heard,
            rate=len(self._arrivals) / _RATE_WINDOW,
            refusal=self._feed.refusal(),
            label=classification.label if classification is not None else "",
            probabilities=dict(
                zip(classification.class_names, classification.probabilities, strict=True)
            )
            if classification is not None
            else {},
            summaries=tuple(self.summaries),
            diagnostics=dict(self._diagnostics),
            gains=self._gains,
        )

    def _on_state(self, state: TissueState) -> None:
        self._state, self._heard = state, time.monotonic()
        self._arrivals.append(self._heard)

    def _on_classification(self, message: TissueClassification) -> None:
        self._classification = message

    def _on_summary(self, message: PalpationSummary) -> None:
        summary = summary_of(message)
        # The air after it may contradict a contact.
        self.summaries = [s for s in self.summaries if s.contact_id != summary.contact_id]
        self.summaries.append(summary)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if is_of(status, self._identifier):
                self._diagnostics = {
                    "message": status.message,
                    **{value.key: value.value for value in status.values},
                }

    def _on_gains(self, message: String) -> None:
        self._gains = message.data


def is_of(status: DiagnosticStatus, identifier: str) -> bool:
    """Return whether a status of ``/diagnostics`` is that of a node."""
    return bool(status.name.split(":")[0].strip("/") == identifier.strip("/"))
