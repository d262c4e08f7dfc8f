# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The numbers in a bag that could be force or displacement, for a person to choose from."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from typing import Any

import numpy as np

from fden_ros.errors import Hint, InputError
from fden_ros.recording.fields import decoder_of, field_names
from fden_ros.recording.reader import BagReader
from fden_ros.recording.topics import RESULTS

#: Messages of a topic that are looked at, spread over the bag: enough for a range.
_SAMPLES = 1000
#: Elements of a sequence that are looked at: more than an arm has joints, less than an image.
_ELEMENTS = 16
#: Lines of a listing that a person still reads.
_LINES = 60
#: What cannot be a measurement of a press, whatever its values.
_SKIPPED = {"header", "stamp", "layout", "orientation", "rotation"}
#: Types without a number of their own: of many frames, or of bytes that are no numbers.
_PACKED = (
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/PointCloud2",
)


def hint_of(reader: BagReader, unclear: Collection[str]) -> Callable[[], Hint]:
    """Return what makes the listing of a bag's numbers, and the options that name one.

    Parameters
    ----------
    reader : BagReader
    unclear : collection of str
        Those of ``force`` and ``displacement`` that have to be named.
    """

    def hint() -> Hint:
        options = [
            word
            for stream in unclear
            for word in (f"--{stream}-topic", "TOPIC", f"--{stream}-field", "FIELD")
        ]
        lines = _listing(ranges_of(reader))
        return Hint(tuple(lines), tuple(options) if lines else ())

    return hint


def ranges_of(reader: BagReader) -> dict[tuple[str, str], tuple[float, float]]:
    """Return the smallest and largest of each number in a bag, by topic and path of its field."""
    topics = {
        topic.name: topic
        for topic in reader.topics
        if topic.message_count and not topic.type_name.startswith((RESULTS, *_PACKED))
    }
    decoders = {}
    for name, topic in topics.items():
        try:
            decoders[name] = decoder_of(topic)
        except InputError:
            continue
    counts: Counter[str] = Counter()
    found: dict[tuple[str, str], tuple[float, float]] = {}
    for message in reader.messages(decoders) if decoders else ():
        name = message.topic
        counts[name] += 1
        if counts[name] % math.ceil(topics[name].message_count / _SAMPLES):
            continue
        try:
            sample = decoders[name](message.data)
        except Exception:  # damaged bytes raise errors of every kind
            continue
        for path, value in _numbers(sample):
            low, high = found.get((name, path), (value, value))
            found[name, path] = min(low, value), max(high, value)
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
    for name in field_names(value):
        if name not in _SKIPPED:
            yield from _numbers(getattr(value, name), f"{path}.{name}".lstrip("."))


def _listing(ranges: dict[tuple[str, str], tuple[float, float]]) -> list[str]:
    moving = {" ".join(key): span for key, span in ranges.items() if span[0] < span[1]}
    width = max(map(len, moving), default=0)
    lines = [f"{name:{width}}  {low:.6g} to {high:.6g}" for name, (low, high) in moving.items()]
    left = len(lines) - _LINES
    return [*lines[:_LINES], *([f"and {left} more"] if left > 0 else [])]
