# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""From measurements to the pipeline: projection, signs, frames, the tool's weight.

Live messages, those of a bag, fields of messages of any type and the rows of a table all come
through :class:`Inputs`, so that the same measurement is the same sample everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams import (
    NANOSECONDS,
    Position,
    Quaternion,
    Reason,
    normalised,
)
from fden_ros.message_kinds import FORCES, PLACES, MessageKind, NumberOrVector, kind_of
from fden_ros.parameters import Parameters, direction, frames_config, tool_weight

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


class Inputs:
    """Feed samples from measurements: project on the axes, pick the joint, hold the frame.

    Parameters
    ----------
    parameters : Parameters
    sink : Pipeline
        Where the samples go.

    Attributes
    ----------
    names : tuple of str
        Of the inputs but for transforms, force first.
    transform_topics : tuple of str
        Those of the transforms that are used.
    """

    def __init__(self, parameters: Parameters, sink: Pipeline) -> None:
        self._sink = sink
        force, displacement = parameters.force, parameters.displacement
        self._force_axis = direction(force)
        self._displacement_axis = direction(displacement)
        self._joints = {"force": force.name, "displacement": displacement.name}
        self._signs = {
            name: -1.0 if own.inverted else 1.0
            for name, own in (("force", force), ("displacement", displacement))
        }
        self._takes_torque = parameters.geometry.kind == "torsional_rheometer"
        frames = frames_config(parameters)
        # Where forces are turned, the weight is subtracted where that is done.
        self._tool = tool_weight(parameters) if frames is None else None
        self._base = frames.base if frames is not None and frames.moves_probe else ""
        self._is_along_tool = displacement.along_tool
        self._takes_turn = self._tool is not None or self._is_along_tool
        self._turns_force = frames is not None and not self._is_along_tool
        self.transform_topics = TRANSFORM_TOPICS if frames is not None else ()
        self.names = ("force",) if self._base else ("force", "displacement")
        self.reset()

    def reset(self) -> None:
        """Forget the frames: the next messages set them."""
        self._frames: dict[str, str] = {}

    @property
    def force_frame(self) -> str:
        """Return the frame_id of the force messages; the outputs carry it."""
        return self._frames.get("force", "")

    @property
    def displacement_frame(self) -> str:
        """Return the frame_id of the positions; empty before the first."""
        return self._base or self._frames.get("displacement", "")

    def has_come(self, name: str) -> bool:
        """Return whether a message of an input has come that could be read."""
        return name in self._frames

    def reject(self, stream: str, reason: str) -> None:
        """Count a message that cannot be read."""
        self._sink.reject(stream, reason)

    def add(self, name: str, message: Any, received: int | None = None) -> None:
        """Add a message of an input; a time of reception [ns] replaces its stamp."""
        if name in TRANSFORM_TOPICS:
            self._add_transforms(message, received, is_static=name == "/tf_static")
            return
        header = message.header
        stamp = stamp_ns(header.stamp) if received is None else received
        kind = kind_of(message, FORCES if name == "force" else PLACES)
        value: NumberOrVector | None
        if kind.is_of_joints:
            value = self._joint(name, kind, message)
        else:
            value = kind.value(message, is_torque=self._takes_torque)
        if name == "force":
            self.add_force(header.frame_id, stamp, value)
        else:
            turn = kind.turn(message) if self._takes_turn else None
            self.add_displacement(header.frame_id, stamp, value, turn)

    def add_force(self, frame_id: str, stamp: int, value: NumberOrVector | None) -> None:
        """Add a force [N]: a number or a vector, which may turn; None: missing."""
        if not self._is_own_frame("force", frame_id):
            return
        if value is None:
            self._sink.reject("force", Reason.MISSING_FIELD)
        elif isinstance(value, float):
            self._sink.add_force(stamp, self._signs["force"] * value)
        elif self._turns_force:
            self._sink.add_force_vector(stamp, frame_id.lstrip("/"), value)
        else:
            self._sink.add_force(stamp, _along(self._force_axis, value))

    def add_displacement(
        self,
        frame_id: str,
        stamp: int,
        value: NumberOrVector | None,
        orientation: Quaternion | None = None,
    ) -> None:
        """Add a number or a position [m]; None: missing."""
        if not self._is_own_frame("displacement", frame_id):
            return
        # A number does not show the tool's orientation.
        if value is None or (isinstance(value, float) and self._takes_turn):
            self._sink.reject("displacement", Reason.MISSING_FIELD)
        elif isinstance(value, float):
            self._sink.add_displacement(stamp, self._signs["displacement"] * value, None)
        elif self._takes_turn:
            self._add_turned(stamp, value, orientation)
        else:
            self._sink.add_displacement(stamp, _along(self._displacement_axis, value), value)

    def _add_turned(self, stamp: int, value: Position, orientation: Quaternion | None) -> None:
        try:
            turn = orientation or (0.0, 0.0, 0.0, 0.0)
            load = self._tool.load(turn) if self._tool is not None else 0.0
            turn = normalised(turn)
        except ValueError:
            # Without an orientation neither the weight nor the path along the tool is known.
            self._sink.reject("displacement", Reason.MISSING_FIELD)
            return
        along = _along(self._displacement_axis, value)
        if self._is_along_tool:
            self._sink.add_displacement(stamp, along, value, load, turn)
        else:
            self._sink.add_displacement(stamp, along, value, load)

    def _joint(self, name: str, kind: MessageKind, message: Any) -> Any:
        """Return the number of an input's joint; None where the message lacks it."""
        index, values, joint = 0, getattr(message, kind.field), self._joints[name]
        if joint:
            if joint not in message.name:
                return None
            index = message.name.index(joint)
        return float(values[index]) if index < len(values) else None

    def _is_own_frame(self, name: str, frame_id: str) -> bool:
        if self._frames.setdefault(name, frame_id) == frame_id:
            return True
        self._sink.reject(name, Reason.WRONG_FRAME)
        return False

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


def inputs_of(parameters: Parameters, sink: Pipeline | Inputs) -> Inputs:
    """Return what projects measurements for a sink, or what takes them itself."""
    return sink if isinstance(sink, Inputs) else Inputs(parameters, sink)


def _along(axis: Position, value: Position) -> float:
    a, b, c = axis
    x, y, z = value
    return float(a * x + b * y + c * z)
