# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Numbers out of messages of any type, by a path such as ``wrench.torque.z`` or ``data[2]``."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.well_known import SchemaEncoding
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fden_ros.core.streams import Quaternion
from fden_ros.errors import InputError
from fden_ros.recording.definitions import decoder, decoder_by, message_definition
from fden_ros.recording.reader import Topic

Vector = tuple[float, float, float]

_PATH = re.compile(r"[A-Za-z_]\w*(\[\d+\])*(\.[A-Za-z_]\w*(\[\d+\])*)*")
_STEP = re.compile(r"([A-Za-z_]\w*)|\[(\d+)\]")


@dataclass(frozen=True)
class FieldPath:
    """Where in a message a number or a vector lies.

    Parameters
    ----------
    text : str
        Names joined by dots, indices in brackets: ``wrench.force.z``, ``data[2]``.

    Raises
    ------
    InputError
        If `text` is no path.
    """

    text: str

    def __post_init__(self) -> None:
        if _PATH.fullmatch(self.text) is None:
            raise InputError(
                f"{self.text!r} is no path of a field: expected one such as wrench.force.z or "
                "data[2]"
            )

    def of(self, message: Any) -> Any:
        """Return what lies there.

        Raises
        ------
        InputError
            If a name of the path does not exist.
        IndexError
            If a sequence of the path is too short.
        """
        for name, index in _STEP.findall(self.text):
            if index:
                message = message[int(index)]
                continue
            if not hasattr(message, name):
                fields = ", ".join(field_names(message)) or "no fields"
                raise InputError(f"there is no {name} in the path {self.text}: there is {fields}")
            message = getattr(message, name)
        return message

    def orientation_beside(self, message: Any) -> Quaternion | None:
        """Return the orientation that stands beside a position or translation, if one does."""
        above, _, _ = self.text.rpartition(".")
        beside = FieldPath(above).of(message) if above else message
        turn: Any = getattr(beside, "orientation", None) or getattr(beside, "rotation", None)
        if not all(hasattr(turn, axis) for axis in "xyzw"):
            return None
        return float(turn.x), float(turn.y), float(turn.z), float(turn.w)


def as_number_or_vector(value: Any) -> float | Vector | None:
    """Return a number as float, something with x, y, z or three numbers as vector, else None."""
    if isinstance(value, (int, float, np.number)):
        return float(value)
    if all(hasattr(value, axis) for axis in "xyz"):
        return float(value.x), float(value.y), float(value.z)
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 3:
        x, y, z = value
        return float(x), float(y), float(z)
    if getattr(value, "shape", None) == (3,):
        x, y, z = value.tolist()
        return float(x), float(y), float(z)
    return None


def decoder_of(topic: Topic) -> Callable[[bytes], Any]:
    """Return the function that decodes a topic's messages.

    The installed class decodes where its definition is the bag's; else the definition that the
    bag carries does, so that the type need not be installed.

    Raises
    ------
    InputError
        If the bag carries no definition and none is installed.
    """
    carried = topic.schema.strip() if topic.schema_encoding == SchemaEncoding.ROS2 else ""
    if carried in ("", _installed(topic.type_name)):
        try:
            return decoder(topic.type_name)
        except InputError:
            raise InputError(
                f"{topic.name}: the bag carries no readable definition of {topic.type_name}: "
                f"install the package {topic.type_name.partition('/')[0]}"
            ) from None
    try:
        return decoder_by(carried, topic.type_name)
    except NameError:
        return _decoder_of_ros1(topic)
    except (McapError, ValueError, LookupError) as error:
        raise _unreadable(topic, error) from None


def _installed(type_name: str) -> str:
    """Return the installed definition of a type; empty where there is none."""
    try:
        return message_definition(type_name).strip()
    except InputError:
        return ""


def _decoder_of_ros1(topic: Topic) -> Callable[[bytes], Any]:
    """Return the decoder of a type with names such as ``Fz``, which ROS 2 does not allow."""
    types = get_typestore(Stores.EMPTY)
    try:
        types.register(get_types_from_msg(topic.schema, topic.type_name))
        types.get_msgdef(topic.type_name)
    except Exception as error:
        raise _unreadable(topic, error) from None
    return lambda data: types.deserialize_cdr(data, topic.type_name)


def _unreadable(topic: Topic, error: Exception) -> InputError:
    return InputError(
        f"{topic.name}: the definition of {topic.type_name} cannot be read "
        f"({' '.join(str(error).split())}): install its package"
    )


def field_names(message: Any) -> list[str]:
    """Return the names of the fields of a decoded message; none of anything else."""
    if hasattr(message, "get_fields_and_field_types"):
        return list(message.get_fields_and_field_types())
    slots = getattr(message, "__slots__", None) or getattr(message, "__dict__", {})
    return [name for name in slots if not name.startswith("_")]
