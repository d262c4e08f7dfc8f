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

"""The only way from measurements into the pipeline: projection, signs, frames, the tool's weight.

Live messages, those of a bag, fields of messages of any type and the rows of a table all come
through :class:`Inputs`, so that the same measurement is the same sample everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped, WrenchStamped
from sensor_msgs.msg import JointState

from fden_ros.core.streams.samples import Position, Reason, Sink
from fden_ros.core.streams.tool_weight import Quaternion
from fden_ros.parameters import Parameters, tool_weight, unit_vector
from fden_ros.ros.messages import stamp_ns

FORCE_MESSAGES: dict[str, type] = {"wrench": WrenchStamped, "joint_state": JointState}
DISPLACEMENT_MESSAGES: dict[str, type] = {
    "joint_state": JointState,
    "pose": PoseStamped,
    "transform": TransformStamped,
    "point": PointStamped,
}

#: Count of the messages whose bytes are no message of their type.
DAMAGED = "damaged"

#: A number, or a vector that is projected on the configured axis.
NumberOrVector = float | Position


class Inputs:
    """Feed samples from measurements: project on the axes, pick the joint, hold the frame.

    Parameters
    ----------
    parameters : Parameters
    sink : Sink
        A pipeline, or what stands before it.

    Attributes
    ----------
    force_frame : str
        frame_id of the force messages; the outputs carry it.
    force_joint, displacement_joint : str
        Joints that are asked for; empty: the first.
    """

    def __init__(self, parameters: Parameters, sink: Sink) -> None:
        self._sink = sink
        self._force_axis = unit_vector(parameters.force.axis)
        self._displacement_axis = unit_vector(parameters.displacement.axis)
        self.force_joint = parameters.force.name
        self.displacement_joint = parameters.displacement.name
        self._force_sign = -1.0 if parameters.force.inverted else 1.0
        self._displacement_sign = -1.0 if parameters.displacement.inverted else 1.0
        self._read_force: dict[type, Callable[[Any], float | None]] = {
            WrenchStamped: self._wrench_force,
            JointState: self._joint_force,
        }
        self.takes_torque = parameters.geometry.kind == "torsional_rheometer"
        self._tool = tool_weight(parameters)
        self.takes_orientation = self._tool is not None
        self._read_position: dict[type, Callable[[Any], Position]] = {
            PoseStamped: _pose_position,
            TransformStamped: _transform_position,
            PointStamped: _point_position,
        }
        self.reset()

    def reset(self) -> None:
        """Let the next messages say their frames anew."""
        self.force_frame = ""
        self._force_frame_known = False
        self._displacement_frame: str | None = None

    @property
    def displacement_frame(self) -> str:
        """Return the frame_id of the positions; empty before the first."""
        return self._displacement_frame or ""

    @property
    def has_force(self) -> bool:
        """Return whether a force message has come that could be read."""
        return self._force_frame_known

    @property
    def has_displacement(self) -> bool:
        """Return whether a displacement message has come that could be read."""
        return self._displacement_frame is not None

    def reject(self, stream: str, reason: str) -> None:
        """Count a message that cannot be read."""
        self._sink.reject(stream, reason)

    def add_force(self, message: Any) -> None:
        """Take a force message."""
        header = message.header
        force = self._read_force[type(message)](message)
        self.take_force(header.frame_id, stamp_ns(header.stamp), force)

    def add_displacement(self, message: Any) -> None:
        """Take a displacement message."""
        header = message.header
        stamp = stamp_ns(header.stamp)
        if isinstance(message, JointState):
            joint = _joint_value(message.name, message.position, self.displacement_joint)
            self.take_joint(header.frame_id, stamp, joint)
            return
        position = self._read_position[type(message)](message)
        orientation = _orientation(message) if self.takes_orientation else None
        self.take_position(header.frame_id, stamp, position, orientation)

    def add_force_value(self, frame_id: str, stamp: int, value: NumberOrVector | None) -> None:
        """Take a force [N] that is a number or a vector; None where there is none."""
        if value is None or isinstance(value, float):
            self.take_force(frame_id, stamp, self.signed_effort(value))
        else:
            self.take_force(frame_id, stamp, self.along_force(*value))

    def add_displacement_value(
        self,
        frame_id: str,
        stamp: int,
        value: NumberOrVector | None,
        orientation: Quaternion | None = None,
    ) -> None:
        """Take a displacement or a position [m]; None where there is none."""
        if value is None or isinstance(value, float):
            self.take_joint(frame_id, stamp, value)
        else:
            self.take_position(frame_id, stamp, value, orientation)

    def take_force(self, frame_id: str, stamp: int, force: float | None) -> None:
        """Take a force along the axis [N]; None where the message does not hold it."""
        if frame_id != self.force_frame:
            if self._force_frame_known:
                self._sink.reject("force", Reason.WRONG_FRAME)
                return
            self.force_frame = frame_id
        self._force_frame_known = True
        if force is None:
            self._sink.reject("force", Reason.MISSING_FIELD)
            return
        self._sink.add_force(stamp, force)

    def take_joint(self, frame_id: str, stamp: int, joint: float | None) -> None:
        """Take a displacement without a place [m]; None where the message does not hold it."""
        if not self._is_displacement_frame(frame_id):
            return
        # A number says nothing of the tool's orientation.
        if joint is None or self._tool is not None:
            self._sink.reject("displacement", Reason.MISSING_FIELD)
            return
        self._sink.add_displacement(stamp, self._displacement_sign * joint)

    def take_position(
        self,
        frame_id: str,
        stamp: int,
        position: Position,
        orientation: Quaternion | None = None,
    ) -> None:
        """Take a position [m], and the sensor's orientation where the tool's weight matters."""
        if not self._is_displacement_frame(frame_id):
            return
        x, y, z = position
        a, b, c = self._displacement_axis
        displacement = a * x + b * y + c * z
        if self._tool is None:
            self._sink.add_displacement(stamp, displacement, position)
            return
        try:
            load = self._tool.load(orientation or (0.0, 0.0, 0.0, 0.0))
        except ValueError:
            # Without an orientation the weight cannot be told from the tissue.
            self._sink.reject("displacement", Reason.MISSING_FIELD)
            return
        self._sink.add_displacement(stamp, displacement, position, load)

    def along_force(self, x: float, y: float, z: float) -> float:
        """Return the part of a force along the axis [N]."""
        a, b, c = self._force_axis
        return float(a * x + b * y + c * z)

    def signed_effort(self, effort: float | None) -> float | None:
        """Return a joint's effort, or another number, as force [N]."""
        return None if effort is None else self._force_sign * effort

    def _is_displacement_frame(self, frame_id: str) -> bool:
        if frame_id == self._displacement_frame:
            return True
        if self._displacement_frame is not None:
            self._sink.reject("displacement", Reason.WRONG_FRAME)
            return False
        self._displacement_frame = frame_id
        return True

    def _wrench_force(self, message: WrenchStamped) -> float:
        wrench = message.wrench
        vector = wrench.torque if self.takes_torque else wrench.force
        return self.along_force(vector.x, vector.y, vector.z)

    def _joint_force(self, message: JointState) -> float | None:
        return self.signed_effort(_joint_value(message.name, message.effort, self.force_joint))


def _joint_value(names: list[str], values: Any, joint: str) -> float | None:
    index = 0
    if joint:
        if joint not in names:
            return None
        index = names.index(joint)
    return float(values[index]) if index < len(values) else None


def _pose_position(message: PoseStamped) -> Position:
    position = message.pose.position
    return position.x, position.y, position.z


def _transform_position(message: TransformStamped) -> Position:
    translation = message.transform.translation
    return translation.x, translation.y, translation.z


def _orientation(message: Any) -> Quaternion | None:
    if isinstance(message, PoseStamped):
        turn = message.pose.orientation
    elif isinstance(message, TransformStamped):
        turn = message.transform.rotation
    else:
        return None
    return turn.x, turn.y, turn.z, turn.w


def _point_position(message: PointStamped) -> Position:
    return message.point.x, message.point.y, message.point.z
