# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which types of messages an input may have, and where in them its numbers are.

To add a type, add a row. The choices of parameters, node, replay and `fden configure` follow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from fden_ros.core.streams import Quaternion, Vector

#: Of a force or a place: a number, or a vector that is projected on the configured axis.
NumberOrVector = float | Vector


@dataclass(frozen=True)
class MessageKind:
    """A type of messages with a header, and paths to its fields."""

    type_name: str
    field: str  #: a vector or a number; of joints one each
    torque: str = ""  #: a vector; empty: it has none of its own
    orientation: str = ""  #: empty: it has none
    is_of_joints: bool = False

    def is_kind_of(self, message: Any) -> bool:
        """Return whether a message is of this type, by its fields."""
        return hasattr(message, self.field.partition(".")[0])

    def value(self, message: Any, *, is_torque: bool = False) -> NumberOrVector:
        """Return the number or the vector of a message, or its torque where it has one."""
        found = attrgetter(self.torque if is_torque and self.torque else self.field)(message)
        return (found.x, found.y, found.z) if hasattr(found, "x") else float(found)

    def turn(self, message: Any) -> Quaternion | None:
        """Return the orientation of a message; None where it has none."""
        if not self.orientation:
            return None
        found = attrgetter(self.orientation)(message)
        return found.x, found.y, found.z, found.w


_JOINTS = "sensor_msgs/msg/JointState"

#: By the values of `force.message`.
FORCES: Mapping[str, MessageKind] = {
    "wrench": MessageKind(
        "geometry_msgs/msg/WrenchStamped", "wrench.force", torque="wrench.torque"
    ),
    "joint_state": MessageKind(_JOINTS, "effort", is_of_joints=True),
}
#: By the values of `displacement.message`.
PLACES: Mapping[str, MessageKind] = {
    "joint_state": MessageKind(_JOINTS, "position", is_of_joints=True),
    "pose": MessageKind(
        "geometry_msgs/msg/PoseStamped", "pose.position", orientation="pose.orientation"
    ),
    "transform": MessageKind(
        "geometry_msgs/msg/TransformStamped",
        "transform.translation",
        orientation="transform.rotation",
    ),
    "point": MessageKind("geometry_msgs/msg/PointStamped", "point"),
}


def kind_of(message: Any, kinds: Mapping[str, MessageKind]) -> MessageKind:
    """Return the kind of a message."""
    return next(kind for kind in kinds.values() if kind.is_kind_of(message))
