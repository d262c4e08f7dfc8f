# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Quality of service of a bag's topic, which a subscriber must match."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rosbags import interfaces
from rosbags.rosbag2.metadata import parse_qos

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile


@dataclass(frozen=True)
class Qos:
    """The offer of a publisher; bags may have ``unknown`` and ``system_default`` for each."""

    reliability: str = "reliable"  #: or ``best_effort``
    durability: str = "volatile"  #: or ``transient_local`` (latched)
    depth: int = 10  #: of the queue; 0 when a bag does not know it

    @staticmethod
    def from_profile(profile: QoSProfile) -> Qos:
        """Return the entry of a bag for a topic that is published with a ``rclpy`` profile."""
        names = profile.reliability.name, profile.durability.name
        return Qos(names[0].lower(), names[1].lower(), profile.depth)

    @staticmethod
    def from_bag(offered: Sequence[interfaces.Qos] | str | None) -> tuple[Qos, ...]:
        """Return the profiles of a bag, from YAML or as read; none where it cannot be read."""
        try:
            found = parse_qos(offered) if isinstance(offered, str) else offered or ()
        except Exception:  # a parser raises any kind for arbitrary text
            return ()
        return tuple(
            Qos(one.reliability.name.lower(), one.durability.name.lower(), max(0, one.depth))
            for one in found
        )

    @property
    def latched(self) -> bool:
        """Whether late subscribers receive the last messages."""
        return self.durability == "transient_local"

    def to_bag(self) -> interfaces.Qos:
        """Return the profile for a writer of bags."""
        always: Any = interfaces.QosTime(9223372036, 854775807)  # RMW_DURATION_INFINITE
        return interfaces.Qos(
            interfaces.QosHistory.KEEP_LAST,
            self.depth,
            interfaces.QosReliability[self.reliability.upper()],
            interfaces.QosDurability[self.durability.upper()],
            always,
            always,
            interfaces.QosLiveliness.AUTOMATIC,
            always,
            False,
        )

    def to_profile(self) -> QoSProfile:
        """Return the ``rclpy`` profile, with a queue of at least one message."""
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        is_lossy = self.reliability == "best_effort"
        return QoSProfile(
            depth=max(self.depth, 1),
            reliability=ReliabilityPolicy["BEST_EFFORT" if is_lossy else "RELIABLE"],
            durability=DurabilityPolicy[("VOLATILE", "TRANSIENT_LOCAL")[self.latched]],
        )


RELIABLE = Qos()
LATCHED = Qos(durability="transient_local", depth=1)
