# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The one table of outputs: topic, type, QoS, and the message made of an output.

The node and the bag of results use it.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from fden_msgs.msg import ComplexModulus, PalpationSummary, TissueClassification, TissueEstimate
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from sensor_msgs.msg import PointCloud2

from fden_ros.core.outputs import (
    Classification,
    ContactSummary,
    DynamicModulus,
    Output,
    TissueState,
)
from fden_ros.ros.messages import (
    classification_message,
    estimate_message,
    modulus_message,
    summary_message,
)
from fden_ros.ros.stiffness_map import StiffnessMap

#: Of the inputs. Deep: the fractional integral never recovers a lost sample.
INPUT_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=10000,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
#: Of the static transforms, which late subscribers receive too.
STATIC_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
_RELIABLE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE
)
#: Offered, so that a subscriber with a deadline is notified when the node freezes.
_LEASE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=Duration(seconds=0.2),
)
#: The offered deadline in periods of the estimate, for a loaded machine, and the least [s].
_DEADLINE_PERIODS, _LEAST_DEADLINE = 5.0, 0.05


def latched(depth: int) -> QoSProfile:
    """Return a profile whose last messages late subscribers receive too."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


@dataclass(frozen=True)
class OutputTopic:
    """One topic, below the node's name, and what is published there."""

    name: str
    message_type: type
    qos: QoSProfile
    output: type  #: of the core, from which the message is made
    #: Makes the message of an output, in a frame, with the map of the sites; None: there is none.
    make: Callable[[Any, str, StiffnessMap], Any]
    has_deadline: bool = False  #: it comes at the period of the estimate

    def profile(self, period: float) -> QoSProfile:
        """Return a profile of its own, with the deadline where there is one.

        Parameters
        ----------
        period : float
            Of the estimate [s].
        """
        profile = copy.copy(self.qos)
        if self.has_deadline:
            deadline = max(_LEAST_DEADLINE, _DEADLINE_PERIODS * period)
            profile.deadline = Duration(seconds=deadline)
        return profile


#: In the order of the messages of one output. Late subscribers still receive the last
#: classification, the last 100 contacts and the present map.
OUTPUT_TOPICS = (
    OutputTopic(
        "estimate",
        TissueEstimate,
        _LEASE,
        TissueState,
        lambda state, frame, sites: estimate_message(state, frame),
        has_deadline=True,
    ),
    OutputTopic(
        "classification",
        TissueClassification,
        latched(1),
        Classification,
        lambda output, frame, sites: classification_message(output, frame),
    ),
    OutputTopic(
        "palpation",
        PalpationSummary,
        latched(100),
        ContactSummary,
        lambda summary, frame, sites: summary_message(summary, frame),
    ),
    OutputTopic(
        "complex_modulus",
        ComplexModulus,
        _RELIABLE,
        DynamicModulus,
        lambda output, frame, sites: modulus_message(output, frame),
    ),
    OutputTopic(
        "stiffness_map",
        PointCloud2,
        latched(1),
        ContactSummary,
        lambda summary, frame, sites: sites.cloud() if summary in sites else None,
    ),
)
_BY_OUTPUT: dict[type, tuple[OutputTopic, ...]] = {
    kind: tuple(topic for topic in OUTPUT_TOPICS if topic.output is kind)
    for kind in (TissueState, Classification, ContactSummary, DynamicModulus)
}


class OutputMessages:
    """Makes the messages of a pipeline's outputs; holds the map of the sites."""

    def __init__(self) -> None:
        self._sites = StiffnessMap()

    def of(self, output: Output, frame: str) -> Iterator[tuple[OutputTopic, Any]]:
        """Yield each topic with its message of an output, in `frame`."""
        if isinstance(output, ContactSummary):
            self._sites.add(output)
        for topic in _BY_OUTPUT[type(output)]:
            message = topic.make(output, frame, self._sites)
            if message is not None:
                yield topic, message
