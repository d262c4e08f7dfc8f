# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The numbers in a bag that could be force or displacement, and the two that look most like them.

What is proposed is for a person to judge: nothing is taken without being named.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.errors import Hint, InputError
from fden_ros.recording.fields import decoder_of, field_names
from fden_ros.recording.headings import COMMANDED
from fden_ros.recording.reader import BagReader, Topic
from fden_ros.recording.topics import RESULTS, WORDS

#: Messages of a topic that are looked at, spread over the bag: enough for a range and a likeness.
_SAMPLES = 1000
#: Elements of a sequence that are looked at: more than an arm has joints, less than an image.
_ELEMENTS = 16
#: Lines of a listing that a person still reads.
_LINES = 60
#: Times at which two fields are compared.
_GRID = 400
#: A correlation with time above this is a clock's; a ramp of a probe stops somewhere.
_CLOCK = 0.9999
#: A force of a press [N] spans more times this than its displacement [m]: tissue of 10 N/m.
_STIFFNESS = 10.0
#: What cannot be a measurement of a press, whatever its values.
_SKIPPED = {"header", "stamp", "layout", "orientation", "rotation"}
#: Types without a number of their own: of many frames, or of bytes that are no numbers.
_PACKED = (
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/PointCloud2",
)


@dataclass(frozen=True)
class NumericField:
    """A number in the messages of a topic.

    Parameters
    ----------
    topic : str
    path : str
        Such as ``data[2]``.
    times : Array
        Times of recording [s], shape (n,).
    values : Array
        Shape (n,).
    """

    topic: str
    path: str
    times: Array
    values: Array

    @property
    def span(self) -> float:
        """Largest less smallest value."""
        return float(self.values.max() - self.values.min())

    @property
    def is_clock(self) -> bool:
        """Whether it only counts the time."""
        if self.values.size < 3 or not self.span or np.any(np.diff(self.values) < 0.0):
            return False
        return bool(np.corrcoef(self.times, self.values)[0, 1] > _CLOCK)


def numeric_fields(reader: BagReader) -> list[NumericField]:
    """Return the measured numbers of a bag, by topic and in the order of their fields."""
    topics = {
        topic.name: topic
        for topic in reader.topics
        if topic.message_count and not topic.type_name.startswith(RESULTS)
    }
    decoders = {name: _decoder(topic) for name, topic in topics.items()}
    counts: defaultdict[str, int] = defaultdict(int)
    found: defaultdict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)
    for message in reader.messages([name for name, decode in decoders.items() if decode]):
        name, decode = message.topic, decoders[message.topic]
        counts[name] += 1
        if decode is None or counts[name] % math.ceil(topics[name].message_count / _SAMPLES):
            continue
        try:
            sample = decode(message.data)
        except Exception:  # damaged bytes raise errors of every kind
            continue
        for path, value in _numbers(sample):
            found[name, path].append((message.log_time_ns * 1e-9, value))
    return [NumericField(*key, *np.array(series).T) for key, series in found.items()]


def hint_of(
    reader: BagReader, unclear: Collection[str], topics: Mapping[str, str]
) -> Callable[[], Hint]:
    """Return what makes the listing of a bag's numbers, with the options that would take two.

    Parameters
    ----------
    reader : BagReader
    unclear : collection of str
        Those of ``force`` and ``displacement`` that have to be named.
    topics : mapping
        Topic of each that is known.
    """

    def hint() -> Hint:
        fields = numeric_fields(reader)
        if not any(field.span for field in fields):
            return Hint(())
        chosen = _most_alike(fields, topics)
        options = [
            word
            for stream, field in chosen.items()
            if stream in unclear
            for word in (f"--{stream}-topic", field.topic, f"--{stream}-field", field.path)
        ]
        return Hint(tuple(_listing(fields)), tuple(options))

    return hint


def _decoder(topic: Topic) -> Callable[[bytes], Any] | None:
    if topic.type_name in _PACKED:
        return None
    try:
        return decoder_of(topic)
    except InputError:
        return None


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


def _listing(fields: Sequence[NumericField]) -> list[str]:
    moving = [field for field in fields if field.span]
    shown = moving[:_LINES]
    width = max((len(f"{field.topic} {field.path}") for field in shown), default=0)
    lines = [
        f"{f'{field.topic} {field.path}':{width}}  {field.values.min():.6g} to "
        f"{field.values.max():.6g}{', a clock' if field.is_clock else ''}"
        for field in shown
    ]
    if left := len(moving) - len(shown):
        lines.append(f"and {left} more")
    if still := len(fields) - len(moving):
        lines.append(f"{still} {'number' if still == 1 else 'numbers'} that never change")
    return lines


def _most_alike(
    fields: Sequence[NumericField], topics: Mapping[str, str]
) -> dict[str, NumericField]:
    """Return the force and the displacement that go together best; none where nothing moves."""
    moving = [field for field in fields if field.span and not field.is_clock]
    if len(moving) < 2:
        return {}
    start = max(field.times[0] for field in moving)
    end = min(field.times[-1] for field in moving)
    grid = np.linspace(start, max(start, end), _GRID)
    series = [_normalised(np.interp(grid, field.times, field.values)) for field in moving]
    best: dict[str, NumericField] = {}
    highest = -math.inf
    for force, loads in zip(moving, series, strict=True):
        for moved, places in zip(moving, series, strict=True):
            if force is moved or not _is_of(topics, force, moved):
                continue
            score = abs(float(loads @ places)) + _names(force, moved)
            score -= 1.0 if force.span < _STIFFNESS * moved.span else 0.0
            if score > highest:
                highest, best = score, {"force": force, "displacement": moved}
    return best


def _normalised(values: Array) -> Array:
    """Return values less their mean, of length 1; zeros where they stand still."""
    values = values - values.mean()
    return np.asarray(values / max(float(np.linalg.norm(values)), 1e-300))


def _is_of(topics: Mapping[str, str], force: NumericField, moved: NumericField) -> bool:
    named = {"force": force.topic, "displacement": moved.topic}
    return all(named[stream] == topic for stream, topic in topics.items() if stream in named)


def _names(force: NumericField, moved: NumericField) -> float:
    """Return how much the names speak for a pair, each as much as a full likeness."""
    words = [_words(field) for field in (force, moved)]
    score = sum(
        bool(said & WORDS[stream])
        for said, stream in zip(words, ("force", "displacement"), strict=True)
    )
    return float(score - sum(bool(said & COMMANDED) for said in words))


def _words(field: NumericField) -> set[str]:
    return set(re.split(r"[^a-z]+", f"{field.topic} {field.path}".lower()))
