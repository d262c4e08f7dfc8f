# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Numbers in messages of any type, by a path such as ``wrench.torque.z`` or ``data[2]``."""

from __future__ import annotations

import contextlib
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from fden_ros.core.streams import Quaternion
from fden_ros.errors import Hint, InputError
from fden_ros.message_kinds import NumberOrVector
from fden_ros.recording.bag_files import Topic
from fden_ros.recording.message_types import carried_types, decoder
from fden_ros.recording.reader import BagReader
from fden_ros.recording.topics import RESULTS

_PATH = re.compile(r"[A-Za-z_]\w*(\[\d+\])*(\.[A-Za-z_]\w*(\[\d+\])*)*")
_STEP = re.compile(r"([A-Za-z_]\w*)|\[(\d+)\]")
#: Messages of a topic that are examined, spread over the bag: enough for a range.
_SAMPLES = 1000
#: Elements of a sequence that are examined: more than an arm has joints, less than an image.
_ELEMENTS = 16
#: Largest readable number of lines of a listing.
_LINES = 60
#: Fields that cannot be a measurement of a press, whatever their values.
_SKIPPED = {"header", "stamp", "layout", "orientation", "rotation"}
#: Types without a number of their own: of many frames, or of bytes that are no numbers.
_PACKED = (
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/PointCloud2",
)


@dataclass(frozen=True)
class FieldPath:
    """The place of a number or a vector in a message."""

    text: str  #: names joined by dots, indices in brackets: ``wrench.force.z``, ``data[2]``

    def __post_init__(self) -> None:
        if _PATH.fullmatch(self.text) is None:
            raise InputError(
                f"{self.text!r} is not the path of a field: expected one such as wrench.force.z "
                "or data[2]"
            )

    def of(self, message: Any) -> Any:
        """Return the value there; an IndexError says that a sequence is too short."""
        for name, index in _STEP.findall(self.text):
            if index:
                message = message[int(index)]
                continue
            if not hasattr(message, name):
                fields = ", ".join(_field_names(message)) or "no fields"
                raise InputError(f"there is no {name} in the path {self.text}: there is {fields}")
            message = getattr(message, name)
        return message

    def number_or_vector(self, message: Any) -> NumberOrVector | None:
        """Return the number, or what has x, y, z or three numbers; None: a sequence is short."""
        try:
            value = self.of(message)
        except IndexError:
            return None
        if isinstance(value, (int, float, np.number)):
            return float(value)
        if all(hasattr(value, axis) for axis in "xyz"):
            return float(value.x), float(value.y), float(value.z)
        if np.shape(value) == (3,) and np.asarray(value).dtype.kind in "iuf":
            x, y, z = map(float, value)
            return x, y, z
        raise InputError(f"{self.text} is neither a number nor a vector")

    def orientation(self, message: Any) -> Quaternion | None:
        """Return the orientation next to a position or translation, if there is one."""
        above, _, _ = self.text.rpartition(".")
        parent = FieldPath(above).of(message) if above else message
        turn: Any = getattr(parent, "orientation", None) or getattr(parent, "rotation", None)
        if not all(hasattr(turn, axis) for axis in "xyzw"):
            return None
        return float(turn.x), float(turn.y), float(turn.z), float(turn.w)


def decoder_of(topic: Topic) -> Callable[[bytes], Any]:
    """Return a decoder of a topic's messages, by the definition in the bag."""
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


def _field_names(message: Any) -> list[str]:
    return [name for name in getattr(message, "__dict__", {}) if not name.startswith("_")]


def hint_of(reader: BagReader, unclear: Collection[str]) -> Callable[[], Hint]:
    """Return a listing of a bag's numbers, and the options that name one for each of `unclear`."""

    def hint() -> Hint:
        options = [
            word
            for stream in unclear
            for word in (f"--{stream}-topic", "TOPIC", f"--{stream}-field", "FIELD")
        ]
        lines = _listing(_ranges_of(reader))
        return Hint(tuple(lines), tuple(options) if lines else ())

    return hint


def _ranges_of(reader: BagReader) -> dict[str, tuple[float, float]]:
    """Return the smallest and largest of each number in a bag, by topic and path of its field."""
    decoders, every = {}, {}
    for topic in reader.topics:
        if topic.message_count and not topic.type_name.startswith((RESULTS, *_PACKED)):
            with contextlib.suppress(InputError):
                decoders[topic.name] = decoder_of(topic)
                every[topic.name] = math.ceil(topic.message_count / _SAMPLES)
    counts: Counter[str] = Counter()
    found: dict[str, tuple[float, float]] = {}
    for message in reader.messages(decoders):
        counts[message.topic] += 1
        if counts[message.topic] % every[message.topic]:
            continue
        with contextlib.suppress(Exception):  # damaged bytes raise errors of every kind
            for path, value in _numbers(decoders[message.topic](message.data)):
                name = f"{message.topic} {path}"
                low, high = found.get(name, (value, value))
                found[name] = min(low, value), max(high, value)
    return found


def _numbers(value: Any, path: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(value, (bool, str, bytes)):
        return
    if isinstance(value, (int, float, np.number)):
        if math.isfinite(value):
            yield path, float(value)
        return
    if hasattr(value, "__len__"):
        for index in range(min(len(value), _ELEMENTS)):
            yield from _numbers(value[index], f"{path}[{index}]")
        return
    for name in _field_names(value):
        if name not in _SKIPPED:
            yield from _numbers(getattr(value, name), f"{path}.{name}".lstrip("."))


def _listing(ranges: dict[str, tuple[float, float]]) -> list[str]:
    moving = {name: span for name, span in ranges.items() if span[0] < span[1]}
    width = max(map(len, moving), default=0)
    lines = [f"{name:{width}}  {low:.6g} to {high:.6g}" for name, (low, high) in moving.items()]
    left = len(lines) - _LINES
    return [*lines[:_LINES], *([f"and {left} more"] if left > 0 else [])]
