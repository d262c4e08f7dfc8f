# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The input messages straight from their bytes: ten times faster than as a whole.

A replay needs a stamp, a frame and one to three numbers of each message, and nothing else of it.
They are read at their places in the CDR encoding (little-endian, version 1, as every ROS 2 writes
on today's machines); anything else is decoded as a whole. Both give the same
numbers, bit for bit, which the tests show. A stream's messages differ in stamp and numbers only:
where all other bytes are those of the last message, its places hold and are not looked for.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

from fden_ros.core.streams import NANOSECONDS
from fden_ros.parameters import FORCES, PLACES, MessageKind
from fden_ros.ros.inputs import DAMAGED, TRANSFORM_TOPICS, Inputs, Places, stream_of

_LITTLE_ENDIAN = b"\x00\x01"
_STAMP = struct.Struct("<iI")  # seconds, nanoseconds
_HEADER = struct.Struct("<iII")  # seconds, nanoseconds, length of the frame's name with its 0
_COUNT = struct.Struct("<I")
_DOUBLE = struct.Struct("<d")
_VECTOR = struct.Struct("<3d")
_QUATERNION = struct.Struct("<4d")
_BODY = 4  # the encapsulation's own header; alignment counts from there
_AFTER_STAMP = _BODY + _STAMP.size
_FRAME = _BODY + _HEADER.size

Handler = Callable[[bytes], None]


class UnusualError(Exception):
    """The bytes are not as expected: the message has to be decoded as a whole."""


def handler_of(stream: str, kind: str, decode: Callable[[bytes], Any], inputs: Inputs) -> Handler:
    """Return what feeds the bytes of a message to `inputs`, or counts them as damaged.

    Parameters
    ----------
    stream : str
        Name of the input.
    kind : str
        Name of the type of its messages.
    decode : callable
        Makes one of its bytes.
    inputs : Inputs
    """
    fast = fast_handler(stream, kind, inputs)

    def handle(data: bytes) -> None:
        try:
            if fast is not None:
                fast(data)
                return
        except (UnusualError, struct.error):
            pass
        try:
            message = decode(data)
        except Exception:
            # Decoders raise RuntimeError, MemoryError and others for bytes that do not fit.
            inputs.reject(stream_of(stream), DAMAGED)
            return
        inputs.add(stream, message)

    return handle


def fast_handler(stream: str, kind: str, inputs: Inputs) -> Handler | None:
    """Return what feeds the bytes of a message to `inputs`; None for other types.

    Parameters
    ----------
    stream : str
        ``force`` or ``displacement``.
    kind : str
        Name of the type of its messages.
    inputs : Inputs

    Returns
    -------
    callable
        Raises `UnusualError` or ``struct.error`` where the message has to be decoded as a whole.
    """
    if stream in TRANSFORM_TOPICS:
        return None
    if kind == "sensor_msgs/msg/JointState":
        return _joint_handler(stream, inputs)
    kinds = FORCES if stream == "force" else PLACES
    own = next((one for one in kinds.values() if one.type_name == kind), None)
    if own is None or not own.size:
        return None
    if stream == "force":
        return _force_handler(inputs, own)
    return _place_handler(inputs.places[stream], own)


def _head(data: bytes) -> tuple[str, int, int]:
    """Return frame, stamp (ns) and where the header ends."""
    if data[:2] != _LITTLE_ENDIAN:
        raise UnusualError
    seconds, nanoseconds, length = _HEADER.unpack_from(data, _BODY)
    end = _FRAME + length
    if not length or end > len(data):
        raise UnusualError
    frame = data[_FRAME : end - 1]
    # Names in plain letters decode to themselves everywhere.
    if not frame.isascii():
        raise UnusualError
    return frame.decode("ascii"), seconds * NANOSECONDS + nanoseconds, end


def _aligned(offset: int, size: int) -> int:
    return offset + (_BODY - offset) % size


class _Layout:
    """Where the numbers of a message are, as long as what surrounds them stays the same.

    Parameters
    ----------
    data : bytes
        A message.
    frame : str
        Its frame.
    start : int
        Where its numbers begin.
    counts : sequence of int
        Where lengths of sequences stand after them.
    """

    def __init__(self, data: bytes, frame: str, start: int, counts: Sequence[int] = ()) -> None:
        self.frame, self.start = frame, start
        self._size = len(data)
        self._head, self._names = data[:_BODY], data[_AFTER_STAMP:start]
        self._counts = [(slice(place, place + 4), data[place : place + 4]) for place in counts]

    def stamp(self, data: bytes) -> int | None:
        """Return the stamp (ns) of another message; None where its places may be others."""
        if len(data) != self._size or data[_AFTER_STAMP : self.start] != self._names:
            return None
        if data[:_BODY] != self._head:
            return None
        for place, count in self._counts:
            if data[place] != count:
                return None
        seconds, nanoseconds = _STAMP.unpack_from(data, _BODY)
        return int(seconds * NANOSECONDS + nanoseconds)


def _force_handler(inputs: Inputs, kind: MessageKind) -> Handler:
    along, take, unpack = inputs.along_force, inputs.take_force, _VECTOR.unpack_from
    turns, take_vector = inputs.turns_force, inputs.take_force_vector
    offset = _VECTOR.size if inputs.takes_torque and kind.torque else 0

    def read(data: bytes, frame: str, stamp: int, start: int) -> None:
        vector = unpack(data, start + offset)
        if turns:
            take_vector(frame, stamp, vector)
        else:
            take(frame, stamp, along(*vector))

    return _handler(read, kind)


def _place_handler(places: Places, kind: MessageKind) -> Handler:
    take, unpack = places.take_position, _VECTOR.unpack_from
    has_turn = places.takes_orientation and bool(kind.orientation)

    def read(data: bytes, frame: str, stamp: int, start: int) -> None:
        turn = _QUATERNION.unpack_from(data, start + _VECTOR.size) if has_turn else None
        take(frame, stamp, unpack(data, start), turn)

    return _handler(read, kind)


def _handler(read: Callable[[bytes, str, int, int], None], kind: MessageKind) -> Handler:
    """Return what finds the numbers of a message; with fewer bytes it is damaged."""
    size, has_child = kind.size * _DOUBLE.size, kind.has_child
    layout: _Layout | None = None

    def handle(data: bytes) -> None:
        nonlocal layout
        stamp = layout.stamp(data) if layout is not None else None
        if layout is None or stamp is None:
            frame, stamp, end = _head(data)
            start = _aligned(_skip_text(data, end) if has_child else end, 8)
            if start + size > len(data):
                raise UnusualError
            layout = _Layout(data, frame, start)
        read(data, layout.frame, stamp, layout.start)

    return handle


def _joint_handler(stream: str, inputs: Inputs) -> Handler:
    is_force = stream == "force"
    joint = (inputs.force_joint if is_force else inputs.places[stream].joint).encode()
    take = None if is_force else inputs.places[stream].take_joint
    layout: _Layout | None = None
    place: int | None = None

    def find(data: bytes) -> int:
        nonlocal layout, place
        frame, stamp, end = _head(data)
        names_end = end = _aligned(end, 4)
        (count,) = _COUNT.unpack_from(data, end)
        end += 4
        for _ in range(count):
            end = _skip_text(data, end)
        names, counts, values = end, [], []
        for _ in range(3):  # position, velocity, effort
            counts.append(_aligned(end, 4))
            start, length, end = _sequence(data, end)
            values.append((start, length))
        start, length = values[2 if is_force else 0]
        index = _joint_index(data, names_end, count, joint)
        place = start + 8 * index if index is not None and index < length else None
        layout = _Layout(data, frame, names, counts)
        return stamp

    def handle(data: bytes) -> None:
        stamp = layout.stamp(data) if layout is not None else None
        if stamp is None:
            stamp = find(data)
        value = None if place is None else _DOUBLE.unpack_from(data, place)[0]
        assert layout is not None
        if take is None:
            inputs.take_force(layout.frame, stamp, inputs.signed_effort(value))
        else:
            take(layout.frame, stamp, value)

    return handle


def _sequence(data: bytes, offset: int) -> tuple[int, int, int]:
    """Return where a sequence of doubles begins, its length and where it ends."""
    offset = _aligned(offset, 4)
    (length,) = _COUNT.unpack_from(data, offset)
    start = offset + 4
    if not length:
        return start, 0, start
    start = _aligned(start, 8)
    end = start + 8 * length
    if end > len(data):
        raise UnusualError
    return start, length, end


def _joint_index(data: bytes, offset: int, count: int, joint: bytes) -> int | None:
    if not joint:
        return 0
    offset += 4
    for index in range(count):
        start = _aligned(offset, 4) + 4
        offset = _skip_text(data, offset)
        if data[start : offset - 1] == joint:
            return index
    return None


def _skip_text(data: bytes, offset: int) -> int:
    offset = _aligned(offset, 4)
    (length,) = _COUNT.unpack_from(data, offset)
    end = offset + 4 + length
    if not length or end > len(data):
        raise UnusualError
    return int(end)
