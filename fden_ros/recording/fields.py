# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Numbers out of messages of any type, by a path such as ``wrench.torque.z`` or ``data[2]``."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fden_ros.core.streams import Quaternion
from fden_ros.errors import InputError
from fden_ros.recording.bag_files import Topic
from fden_ros.recording.message_types import carried_types, decoder

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
    """Return what decodes a topic's messages, by the definition that the bag carries."""
    types = None
    if topic.definition:
        with contextlib.suppress(InputError):
            types = carried_types(topic.type_name, topic.definition, topic.encoding)
    try:
        return decoder(topic.type_name, types)
    except InputError:
        raise InputError(
            f"{topic.name}: the bag carries no readable definition of {topic.type_name}: "
            f"install the package {topic.type_name.partition('/')[0]}"
        ) from None


def field_names(message: Any) -> list[str]:
    """Return the names of the fields of a decoded message; none of anything else."""
    return [name for name in getattr(message, "__dict__", {}) if not name.startswith("_")]
