# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Message types: their classes, their full definition texts and their hashes."""

from __future__ import annotations

import contextlib
import functools
import importlib
import io
import json
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.records import Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_typestore

from fden_ros.errors import InputError

_TYPE_NAME = re.compile(r"(?P<package>\w+)/(?:msg/)?(?P<name>\w+)")
# The two patterns and the order of the dependencies are those of rosbag2's
# local_message_definition_source.cpp, so that the schemas come out the same, byte for byte.
_FIELD_TYPE = re.compile(r"(?:^|\n)\s*([a-zA-Z0-9_/]+)(?:\[[^\]]*\])?\s+")
_PRIMITIVES = {"bool", "byte", "char", "float32", "float64", "string", "wstring"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
_SEPARATOR = "=" * 80


def full_type_name(type_name: str) -> str:
    """Return ``package/msg/Name`` for ``package/Name`` or ``package/msg/Name``.

    Raises
    ------
    InputError
        When `type_name` is neither.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise InputError(f"{type_name!r} is no message type: expected package/msg/Name")
    return f"{match['package']}/msg/{match['name']}"


@functools.cache
def message_class(type_name: str) -> Any:
    """Return the Python class of a message type such as ``geometry_msgs/msg/WrenchStamped``.

    Raises
    ------
    InputError
        When the type is not installed.
    """
    package, _, name = full_type_name(type_name).split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise InputError(
            f"message type {type_name} is not installed: install the package {package} "
            "or source the workspace that builds it"
        ) from None


@functools.cache
def decoder(type_name: str) -> Callable[[bytes], Any]:
    """Return what makes a message of its CDR bytes: its class, or without ROS its definition.

    Raises
    ------
    InputError
        When the type is neither installed nor one of ROS 2 Jazzy's own.
    """
    try:
        kind = message_class(type_name)
        from rclpy.serialization import deserialize_message
    except (InputError, ImportError) as error:
        known = get_typestore(Stores.ROS2_JAZZY)
        if type_name not in known.types:
            raise InputError(str(error)) from None
        return decoder_by(known.generate_msgdef(type_name, ros_version=2)[0], type_name)
    return lambda data: deserialize_message(data, kind)


def decoder_by(definition: str, type_name: str) -> Callable[[bytes], Any]:
    """Return what makes a message of its CDR bytes by a ``ros2msg`` definition."""
    schema = Schema(id=1, name=type_name, encoding=SchemaEncoding.ROS2, data=definition.encode())
    # What it cannot parse it also prints.
    with contextlib.redirect_stderr(io.StringIO()):
        decode = DecoderFactory().decoder_for(MessageEncoding.CDR, schema)
    assert decode is not None
    return decode


@functools.cache
def message_definition(type_name: str) -> str:
    """Return the ``ros2msg`` schema text: the definition and those of all types it contains.

    Raises
    ------
    InputError
        When the definition of the type, or of one that it contains, is not installed.
    """
    seen: set[str] = set()

    def expand(name: str) -> str:
        text = _interface_file(name, ".msg").read_text(encoding="utf-8")
        parts = [text]
        for dependency in _dependencies(text, name.split("/")[0]):
            if dependency in seen:
                continue
            seen.add(dependency)
            parts.append(f"{_SEPARATOR}\nMSG: {dependency}\n{expand(dependency)}")
        return "\n".join(parts)

    return expand(type_name)


@functools.cache
def type_hash(type_name: str) -> str:
    """Return the hash of the type (``RIHS01_...``), or an empty text where it is not installed."""
    full_name = full_type_name(type_name)
    try:
        description = json.loads(_interface_file(full_name, ".json").read_text(encoding="utf-8"))
    except (InputError, ValueError):
        return ""
    hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
    return hashes.get(full_name, "")


def _dependencies(text: str, package: str) -> list[str]:
    names = set(_FIELD_TYPE.findall(text)) - _PRIMITIVES
    return sorted(name if "/" in name else f"{package}/{name}" for name in names)


def _interface_file(type_name: str, suffix: str) -> Path:
    package, _, name = full_type_name(type_name).split("/")
    for prefix in _prefixes():
        path = Path(prefix, "share", package, "msg", name + suffix)
        if path.is_file():
            return path
    raise InputError(
        f"the definition of {type_name} is not installed: install the package {package} "
        "or source the workspace that builds it"
    )


def _prefixes() -> list[str]:
    # The wheels install their share folders below the environment, which no index need name.
    ament = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [*filter(None, ament), sys.prefix]
