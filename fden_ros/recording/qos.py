# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Quality of service as bags store it, in the number form of Humble and the word form of Jazzy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import yaml

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile

# rmw/types.h: the numbers that bags up to ROS 2 Iron hold, in their order.
_WORDS = {
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
}
# RMW_DURATION_INFINITE.
_INFINITE = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class Qos:
    """What a publisher offers; bags may say ``unknown`` and ``system_default`` of each."""

    reliability: str = "reliable"  #: or ``best_effort``
    durability: str = "volatile"  #: or ``transient_local`` (latched)
    depth: int = 10  #: of the queue; 0 when a bag does not know it
    history: str = "keep_last"  #: or ``keep_all``

    @staticmethod
    def from_profile(profile: QoSProfile) -> Qos:
        """Return what a bag says of a topic that is published with a ``rclpy`` profile."""
        words = {name: getattr(profile, name).name.lower() for name in _WORDS}
        return Qos(depth=profile.depth, **words)

    @property
    def reliable(self) -> bool:
        """Whether delivery is guaranteed."""
        return self.reliability != "best_effort"

    @property
    def latched(self) -> bool:
        """Whether late subscribers receive the last messages."""
        return self.durability == "transient_local"

    def to_dict(self) -> dict[str, Any]:
        """Return the mapping that rosbag2 writes from metadata version 9 (Jazzy) on."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(_INFINITE),
            "lifespan": dict(_INFINITE),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_INFINITE),
            "avoid_ros_namespace_conventions": False,
        }

    def to_profile(self) -> QoSProfile:
        """Return the ``rclpy`` profile, with a queue of at least one message."""
        from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

        is_all = self.history == "keep_all"
        return QoSProfile(
            history=HistoryPolicy.KEEP_ALL if is_all else HistoryPolicy.KEEP_LAST,
            depth=0 if is_all else max(self.depth, 1),
            reliability=ReliabilityPolicy[("BEST_EFFORT", "RELIABLE")[self.reliable]],
            durability=DurabilityPolicy[("VOLATILE", "TRANSIENT_LOCAL")[self.latched]],
        )


RELIABLE = Qos()
SENSOR_DATA = Qos(reliability="best_effort", depth=5)
LATCHED = Qos(durability="transient_local", depth=1)


def dump_profiles(profiles: Sequence[Qos]) -> str:
    """Return the YAML text that an MCAP channel of rosbag2 holds as ``offered_qos_profiles``."""
    return yaml.safe_dump([qos.to_dict() for qos in profiles], sort_keys=False).strip()


def parse_profiles(profiles: str | Sequence[Any] | None) -> tuple[Qos, ...]:
    """Return the profiles of a bag, from YAML text or a list; what cannot be read is left out."""
    if isinstance(profiles, str):
        try:
            profiles = yaml.safe_load(profiles)
        except yaml.YAMLError:
            return ()
    if not isinstance(profiles, list):
        return ()
    return tuple(_parse(profile) for profile in profiles if isinstance(profile, dict))


def _parse(profile: dict[str, Any]) -> Qos:
    depth = profile.get("depth", 0)
    words = {name: _word(profile.get(name), known) for name, known in _WORDS.items()}
    return Qos(depth=depth if isinstance(depth, int) and depth >= 0 else 0, **words)


def _word(value: Any, words: tuple[str, ...]) -> str:
    if isinstance(value, int):
        return words[value] if 0 <= value < len(words) else "unknown"
    return value if value in words else "unknown"
