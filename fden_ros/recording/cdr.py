# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Messages to CDR bytes, the same bytes every time.

``rclpy.serialization.serialize_message`` leaves its padding uninitialised and, where sequences are
empty, appends more of the same: bags would differ from run to run, and strict readers refuse
such messages. The encoder of ``mcap_ros2`` takes neither numpy arrays nor bytes, which message
classes hold. This is the plain little-endian encoding of ROS 2 (CDR version 1), from the field
types that every generated message class carries.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from rosidl_parser import definition

from fden_ros.errors import InputError
from fden_ros.recording.definitions import message_class

_HEADER = b"\x00\x01\x00\x00"  # little-endian, no options
_LENGTH = struct.Struct("<I")
_FORMATS = dict(
    boolean="?", octet="c", char="B", int8="b", uint8="B", int16="h", uint16="H", int32="i",
    uint32="I", int64="q", uint64="Q", float="f", double="d",
)  # fmt: skip
_Encoder = Callable[[bytearray, Any], None]


def serialize(message: Any) -> bytes:
    """Return the CDR bytes of a ROS 2 message, with every padding byte 0.

    Raises
    ------
    InputError
        When the message has a wide string, or a field holds a value that does not fit its type.
    """
    buffer = bytearray()
    cls: Any = type(message)
    try:
        _encoder_of_class(cls)(buffer, message)
    except (struct.error, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{cls.__name__} cannot be serialised: {error}") from error
    return _HEADER + buffer


@functools.cache
def _encoder_of_class(cls: Any) -> _Encoder:
    names = cls.get_fields_and_field_types()
    fields = [(name, _encoder(slot)) for name, slot in zip(names, cls.SLOT_TYPES, strict=True)]

    def encode(buffer: bytearray, message: Any) -> None:
        for name, encode_field in fields:
            encode_field(buffer, getattr(message, name))

    def encode_empty(buffer: bytearray, message: Any) -> None:
        # A structure needs at least one member: rosidl puts a byte there.
        buffer.append(0)

    return encode if fields else encode_empty


def _encoder(slot: Any) -> _Encoder:
    if isinstance(slot, definition.BasicType):
        return _basic(slot.typename)
    if isinstance(slot, definition.UnboundedString | definition.BoundedString):
        return _encode_string
    if isinstance(slot, definition.NamespacedType):
        return _encoder_of_class(message_class("/".join((*slot.namespaces, slot.name))))
    if isinstance(slot, definition.AbstractNestedType):
        elements = _elements(slot.value_type)
        return elements if isinstance(slot, definition.Array) else _sequence(elements)
    raise InputError(f"a field of type {type(slot).__name__} cannot be serialised: use another")


def _align(buffer: bytearray, size: int) -> None:
    buffer += bytes(-len(buffer) % size)


def _basic(typename: str) -> _Encoder:
    packer = struct.Struct("<" + _FORMATS[typename])
    pack, size = packer.pack, packer.size

    def encode(buffer: bytearray, value: Any) -> None:
        buffer += bytes(-len(buffer) % size)
        buffer += pack(value)

    return encode


def _encode_length(buffer: bytearray, length: int) -> None:
    _align(buffer, _LENGTH.size)
    buffer += _LENGTH.pack(length)


def _encode_string(buffer: bytearray, value: str) -> None:
    data = value.encode()
    _encode_length(buffer, len(data) + 1)
    buffer += data
    buffer.append(0)


def _sequence(elements: _Encoder) -> _Encoder:
    def encode(buffer: bytearray, values: Any) -> None:
        _encode_length(buffer, len(values))
        if len(values):
            elements(buffer, values)

    return encode


def _elements(slot: Any) -> _Encoder:
    if isinstance(slot, definition.BasicType) and slot.typename != "octet":
        dtype = np.dtype(_FORMATS[slot.typename]).newbyteorder("<")

        def encode_numbers(buffer: bytearray, values: Any) -> None:
            _align(buffer, dtype.itemsize)
            buffer += np.asarray(values, dtype).tobytes()

        return encode_numbers
    encode_one = _encoder(slot)

    def encode_each(buffer: bytearray, values: Any) -> None:
        for value in values:
            encode_one(buffer, value)

    return encode_each
