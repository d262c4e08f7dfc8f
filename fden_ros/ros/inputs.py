# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""From measurements to the pipeline: projection, signs, frames, the tool's weight.

Live messages, those of a bag, fields of messages of any type and the rows of a table all come
through :class:`Inputs`, so that the same measurement is the same sample everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from fden_ros.core.streams import (
    NANOSECONDS,
    NumberOrVector,
    Position,
    Quaternion,
    Reason,
    Sink,
    normalised,
)
from fden_ros.parameters import (
    FORCES,
    PLACES,
    MessageKind,
    Parameters,
    frames_config,
    kind_of,
    tool_weight,
    unit_vector,
)

#: Of ``/tf``.
TRANSFORMS = "tf2_msgs/msg/TFMessage"
_PLACES = {value: kind.type_name for value, kind in PLACES.items()}

#: By the name of an input, the type that each value of its parameter ``message`` stands for.
TYPE_NAMES: Mapping[str, Mapping[str, str]] = {
    "force": {value: kind.type_name for value, kind in FORCES.items()},
    "displacement": _PLACES,
    "/tf": {"transforms": TRANSFORMS},
    "/tf_static": {"transforms": TRANSFORMS},
}

#: Of transforms, by names that are the same in every namespace.
TRANSFORM_TOPICS = ("/tf", "/tf_static")

#: Count of the messages whose bytes are no message of their type.
DAMAGED = "damaged"


def stamp_ns(stamp: Any) -> int:
    """Return a stamp of a message as integer nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def stream_of(name: str) -> str:
    """Return the stream that rejected messages of an input are counted under."""
    return "transform" if name in TRANSFORM_TOPICS else name


class Places:
    """One stream of places: a joint's position, or a position along an axis [m].

    Parameters
    ----------
    stream : str
        As rejected samples are counted.
    axis : Position
        What positions are projected on.
    factor : float
        What a joint's position is multiplied by.
    joint : str
        Whose position counts; empty: the first.
    sink : Sink
        Rejected messages are counted there.
    take : callable
        Called with stamp (ns), place along the axis, position and orientation where they are
        known.
    takes_orientation : bool
        Whether a place without an orientation is of no use.

    Attributes
    ----------
    frame : str or None
        frame_id of its messages; None before the first.
    """

    def __init__(
        self,
        stream: str,
        axis: Position,
        factor: float,
        joint: str,
        sink: Sink,
        take: Callable[[int, float, Position | None, Quaternion | None], None],
        *,
        takes_orientation: bool = False,
    ) -> None:
        self._stream, self._axis, self._factor = stream, axis, factor
        self.joint = joint
        self._sink, self._take = sink, take
        self.takes_orientation = takes_orientation
        self.frame: str | None = None

    def add(self, message: Any, received: int | None = None) -> None:
        """Take a message; with a time of reception [ns], that is its stamp."""
        header = message.header
        stamp = stamp_ns(header.stamp) if received is None else received
        kind = kind_of(message, PLACES)
        if kind.is_of_joints:
            joint = _joint_value(kind, message, self.joint)
            self.take_joint(header.frame_id, stamp, joint)
            return
        orientation = kind.turn(message) if self.takes_orientation else None
        self.add_value(header.frame_id, stamp, kind.value(message), orientation)

    def add_value(
        self,
        frame_id: str,
        stamp: int,
        value: NumberOrVector | None,
        orientation: Quaternion | None = None,
    ) -> None:
        """Take a number or a position; None where there is none."""
        if value is None or isinstance(value, float):
            self.take_joint(frame_id, stamp, value)
        else:
            self.take_position(frame_id, stamp, value, orientation)

    def take_joint(self, frame_id: str, stamp: int, joint: float | None) -> None:
        """Take a number without a place; None where the message does not hold it."""
        if not self._is_own_frame(frame_id):
            return
        # A number says nothing of the tool's orientation.
        if joint is None or self.takes_orientation:
            self._sink.reject(self._stream, Reason.MISSING_FIELD)
            return
        self._take(stamp, self._factor * joint, None, None)

    def take_position(
        self,
        frame_id: str,
        stamp: int,
        position: Position,
        orientation: Quaternion | None = None,
    ) -> None:
        """Take a position [m], and the orientation where it matters."""
        if not self._is_own_frame(frame_id):
            return
        x, y, z = position
        a, b, c = self._axis
        self._take(stamp, a * x + b * y + c * z, position, orientation)

    def _is_own_frame(self, frame_id: str) -> bool:
        if frame_id == self.frame:
            return True
        if self.frame is not None:
            self._sink.reject(self._stream, Reason.WRONG_FRAME)
            return False
        self.frame = frame_id
        return True


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
    force_joint : str
        Joint that is asked for; empty: the first.
    places : dict
        By the name of the input, the streams of places: ``displacement``, where it is a topic.
    """

    def __init__(self, parameters: Parameters, sink: Sink) -> None:
        self._sink = sink
        self._force_axis = unit_vector(parameters.force.axis)
        self.force_joint = parameters.force.name
        self._force_sign = -1.0 if parameters.force.inverted else 1.0
        self.takes_torque = parameters.geometry.kind == "torsional_rheometer"
        frames = frames_config(parameters)
        # Where forces are turned, the weight is taken off where that is done.
        self._tool = tool_weight(parameters) if frames is None else None
        self._base = frames.base if frames is not None and frames.moves_probe else ""
        self._is_along_tool = parameters.displacement.along_tool
        self.turns_force = frames is not None and not self._is_along_tool
        self.transform_topics = TRANSFORM_TOPICS if frames is not None else ()
        self.places: dict[str, Places] = {}
        if not self._base:
            self.places["displacement"] = Places(
                "displacement",
                unit_vector(parameters.displacement.axis),
                -1.0 if parameters.displacement.inverted else 1.0,
                parameters.displacement.name,
                sink,
                self._take_displacement,
                takes_orientation=self._tool is not None or self._is_along_tool,
            )
        self.reset()

    def reset(self) -> None:
        """Let the next messages say their frames anew."""
        self.force_frame = ""
        self._force_frame_known = False
        for places in self.places.values():
            places.frame = None

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the inputs but for transforms, force first."""
        return ("force", *self.places)

    @property
    def displacement_frame(self) -> str:
        """Return the frame_id of the positions; empty before the first."""
        return self._base or self.places["displacement"].frame or ""

    def has_come(self, name: str) -> bool:
        """Return whether a message of an input has come that could be read."""
        return self._force_frame_known if name == "force" else self.places[name].frame is not None

    def reject(self, stream: str, reason: str) -> None:
        """Count a message that cannot be read."""
        self._sink.reject(stream, reason)

    def add(self, name: str, message: Any, received: int | None = None) -> None:
        """Take a message of an input; with a time of reception [ns], that is its stamp."""
        if name in TRANSFORM_TOPICS:
            self._add_transforms(message, received, is_static=name == "/tf_static")
            return
        if name != "force":
            self.places[name].add(message, received)
            return
        header = message.header
        stamp = stamp_ns(header.stamp) if received is None else received
        kind = kind_of(message, FORCES)
        if kind.is_of_joints:
            effort = _joint_value(kind, message, self.force_joint)
            self.take_force(header.frame_id, stamp, self.signed_effort(effort))
            return
        force = kind.value(message, is_torque=self.takes_torque)
        self.add_force_value(header.frame_id, stamp, force)

    def add_force_value(self, frame_id: str, stamp: int, value: NumberOrVector | None) -> None:
        """Take a force [N] that is a number or a vector; None where there is none."""
        if value is None or isinstance(value, float):
            self.take_force(frame_id, stamp, self.signed_effort(value))
        else:
            self.take_force_vector(frame_id, stamp, value)

    def take_force(self, frame_id: str, stamp: int, force: float | None) -> None:
        """Take a force along the axis [N]; None where the message does not hold it."""
        if not self._is_force_frame(frame_id):
            return
        if force is None:
            self._sink.reject("force", Reason.MISSING_FIELD)
            return
        self._sink.add_force(stamp, force)

    def take_force_vector(self, frame_id: str, stamp: int, force: Position) -> None:
        """Take a force [N] in a frame, which may move."""
        if not self.turns_force:
            self.take_force(frame_id, stamp, self.along_force(*force))
        elif self._is_force_frame(frame_id):
            self._sink.add_force_vector(stamp, frame_id.lstrip("/"), force)

    def _is_force_frame(self, frame_id: str) -> bool:
        if frame_id != self.force_frame:
            if self._force_frame_known:
                self._sink.reject("force", Reason.WRONG_FRAME)
                return False
            self.force_frame = frame_id
        self._force_frame_known = True
        return True

    def _add_transforms(self, message: Any, received: int | None, *, is_static: bool) -> None:
        for one in message.transforms:
            place, turn = one.transform.translation, one.transform.rotation
            self._sink.add_transform(
                stamp_ns(one.header.stamp) if received is None else received,
                one.header.frame_id.lstrip("/"),
                one.child_frame_id.lstrip("/"),
                (place.x, place.y, place.z),
                (turn.x, turn.y, turn.z, turn.w),
                is_static=is_static,
            )

    def along_force(self, x: float, y: float, z: float) -> float:
        """Return the part of a force along the axis [N]."""
        a, b, c = self._force_axis
        return float(a * x + b * y + c * z)

    def signed_effort(self, effort: float | None) -> float | None:
        """Return a joint's effort, or another number, as force [N]."""
        return None if effort is None else self._force_sign * effort

    def _take_displacement(
        self,
        stamp: int,
        displacement: float,
        position: Position | None,
        orientation: Quaternion | None,
    ) -> None:
        if not self.places["displacement"].takes_orientation:
            self._sink.add_displacement(stamp, displacement, position)
            return
        try:
            turn = orientation or (0.0, 0.0, 0.0, 0.0)
            load = self._tool.load(turn) if self._tool is not None else 0.0
            turn = normalised(turn)
        except ValueError:
            # Without an orientation neither the weight nor the path along the tool is known.
            self._sink.reject("displacement", Reason.MISSING_FIELD)
            return
        if self._is_along_tool:
            self._sink.add_displacement(stamp, displacement, position, load, turn)
        else:
            self._sink.add_displacement(stamp, displacement, position, load)


def _joint_value(kind: MessageKind, message: Any, joint: str) -> float | None:
    index, values = 0, getattr(message, kind.field)
    if joint:
        if joint not in message.name:
            return None
        index = message.name.index(joint)
    return float(values[index]) if index < len(values) else None
