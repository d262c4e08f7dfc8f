# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Message types: their classes, and how to decode and encode them (the package ``rosbags``).

A decoded message has the fields of its ROS class; sequences of numbers are numpy arrays.
"""

from __future__ import annotations

import functools
import importlib
import os
import re
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fden_ros.errors import InputError

_TYPE_NAME = re.compile(r"(?P<package>\w+)/(?:msg/)?(?P<name>\w+)")
_HEADER = "std_msgs/msg/Header"
_BYTES = {"byte": "uint8", "octet": "uint8", "char": "uint8"}
#: rclpy appends up to this many bytes; fields of another version of the type are more.
_PADDING = 8


def full_type_name(type_name: str) -> str:
    """Return ``package/msg/Name`` for ``package/Name`` or ``package/msg/Name``."""
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise InputError(f"{type_name!r} is not a message type: expected package/msg/Name")
    return f"{match['package']}/msg/{match['name']}"


@functools.cache
def message_class(type_name: str) -> Any:
    """Return the ROS class of a message type such as ``geometry_msgs/msg/WrenchStamped``."""
    package, _, name = full_type_name(type_name).split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise _not_installed(type_name) from None


@functools.cache
def _known_types() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


@functools.cache
def known_types(type_name: str) -> Typestore:
    """Return the types of ROS 2 Jazzy, with those of the package of `type_name`."""
    store = _known_types()
    if type_name in store.types:
        return store
    package, _, name = full_type_name(type_name).split("/")
    # The wheels install their share folders below the environment, which no index need name.
    prefixes = (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix)
    for folder in (Path(prefix, "share", package, "msg") for prefix in prefixes if prefix):
        if (folder / f"{name}.msg").is_file():
            for path in sorted(folder.glob("*.msg")):
                text = path.read_text(encoding="utf-8")
                store.register(get_types_from_msg(text, f"{package}/msg/{path.stem}"))
            return store
    raise _not_installed(type_name)


def carried_types(type_name: str, definition: str, encoding: str) -> Typestore:
    """Return the types of a definition that a bag carries, in the encoding of its schema.

    Those of ROS 1 (``ros1msg``) have the header of ROS 2, which has no ``seq``.
    """
    store = get_typestore(Stores.EMPTY)
    try:
        found = (
            get_types_from_idl(definition)
            if encoding == "ros2idl"
            else get_types_from_msg(definition, type_name)
        )
        if _HEADER in found and encoding == "ros1msg":
            found[_HEADER] = _known_types().fielddefs[_HEADER]
        store.register(found)
        store.get_msgdef(type_name)
    except Exception as error:  # of a parser, for whatever text
        raise InputError(
            f"the definition of {type_name} cannot be read ({' '.join(str(error).split())}): "
            "install its package"
        ) from None
    return store


def type_hash(type_name: str, types: Typestore | None = None) -> str:
    """Return the hash of a type (``RIHS01_...``); an empty text where it is not known."""
    try:
        return (types or known_types(type_name)).hash_rihs01(type_name)
    except (InputError, KeyError):
        return ""


def decoder(type_name: str, types: Typestore | None = None) -> Callable[[bytes], Any]:
    """Return a decoder of CDR bytes, by the types that a bag carries or known ones.

    It raises errors of any kind for bytes that do not fit.
    """
    store: Any = types or known_types(type_name)
    kind = store.get_msgdef(type_name)
    readers = {b"\0\1": kind.deserialize_cdr_le, b"\0\0": kind.deserialize_cdr_be}

    def decode(data: bytes) -> Any:
        # Not by the store, which takes the bytes that rclpy appends for damage.
        message, end = readers[data[:2]](data[4:], 0, kind.cls, store)
        if len(data) - 4 - end > _PADDING:
            raise ValueError(f"{len(data) - 4 - end} bytes more than {type_name} has")
        return message

    return decode


def serialize(message: Any) -> bytes:
    """Return the CDR bytes of a message, decoded or of a ROS class: the same bytes every time."""
    cls = type(message)
    is_decoded = hasattr(message, "__msgtype__")
    name = f"{cls.__module__.partition('.')[0]}/msg/{cls.__name__}"
    name = message.__msgtype__ if is_decoded else name
    store = known_types(name)
    try:
        made = message if is_decoded else _of_class(store, name, message)
        return bytes(store.serialize_cdr(made, name))
    except (struct.error, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{name} cannot be serialised: {error}") from error


def _of_class(store: Any, name: str, message: Any) -> Any:
    """Return an instance of a ROS class as one of the store's, field by field."""
    fields = store.get_msgdef(name).fields
    # A type without fields has a byte, which its class need not have.
    return store.types[name](
        **{field: _converted(store, kind, getattr(message, field, 0)) for field, kind in fields}
    )


def _converted(store: Any, kind: Any, value: Any) -> Any:
    node, what = kind
    if node == Nodetype.BASE:
        return value[0] if isinstance(value, bytes) else value
    if node == Nodetype.NAME:
        return _of_class(store, what, value)
    element, name = what[0]
    if element == Nodetype.NAME:
        return [_of_class(store, name, one) for one in value]
    if name[0] == "string":
        return list(value)
    if name[0] in ("byte", "octet"):
        value = [one[0] for one in value]
    return np.asarray(value, dtype=_BYTES.get(name[0], name[0]))


def _not_installed(type_name: str) -> InputError:
    return InputError(
        f"message type {type_name} is not installed: install the package "
        f"{type_name.partition('/')[0]} or source the workspace that builds it"
    )
