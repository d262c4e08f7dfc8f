# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a bag holds: topics, rates, gaps and jitter, and what a replay would use of them."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fden_ros.errors import InputError
from fden_ros.parameters import Parameters
from fden_ros.recording.reader import BagReader, Topic
from fden_ros.recording.source import TRANSFORMS, BagSource, Selection

_STAMPED = 4 + 8  # CDR's header, then the stamp
# The rule for gaps is the pipeline's own: ten usual steps, and at least 20 ms.
_GAP_STEPS = 10.0
_GAP_NS = 20_000_000
_NS_PER_S = 1_000_000_000
_HEADERS = ("std_msgs/Header", "std_msgs/msg/Header", "Header")


@dataclass(frozen=True)
class TopicContents:
    """What one topic holds, by the names of ``fden info --json``.

    Stamps are those of the headers where there are any, else the times of recording.
    """

    name: str
    type: str
    messages: int
    frame: str | None  #: frame_id of the first message; None without a header
    stamped: bool  #: whether its messages have headers
    start_ns: int  #: first stamp
    end_ns: int  #: last stamp
    rate_hz: float  #: gaps left out; 0 with fewer than two messages
    jitter_s: float  #: standard deviation of the step, gaps left out
    gaps: int  #: steps of over 20 ms and ten usual ones
    longest_gap_s: float
    backward_stamps: int  #: that do not exceed the one before
    zero_stamps: int
    delay_s: float  #: mean time from stamp to recording; 0 without headers


@dataclass(frozen=True)
class BagContents:
    """What a bag holds."""

    topics: tuple[TopicContents, ...]  #: by name
    used: Mapping[str, str]  #: input, such as ``force``, to the topic that a replay would use
    problems: tuple[str, ...]  #: why a replay could not begin, a line each
    warnings: tuple[str, ...]  #: what is wrong with the bag, a line each

    def as_object(self) -> dict[str, Any]:
        """Return it as what ``fden info --json`` prints."""
        return {**asdict(self), "used": dict(self.used)}


def inspect(
    path: str | Path,
    parameters: Parameters,
    selection: Selection | None = None,
) -> BagContents:
    """Read a bag through and return what it holds, with the selection of a replay.

    Raises
    ------
    InputError
        If the bag cannot be read.
    """
    reader = BagReader(path)
    stamps = {topic.name: _Stamps(topic) for topic in reader.topics}
    for message in reader.messages():
        stamps[message.topic].add(message.data, message.log_time_ns)
    used, problems = _used(path, parameters, selection or Selection())
    topics = tuple(one.contents() for one in stamps.values())
    return BagContents(
        topics=topics,
        used=used,
        problems=tuple(problems),
        warnings=(*reader.warnings, *_warnings(topics, used)),
    )


def _used(
    path: str | Path, parameters: Parameters, selection: Selection
) -> tuple[dict[str, str], list[str]]:
    try:
        return BagSource(path, parameters, selection).inputs, []
    except InputError as error:
        return {}, [str(error)]


def _warnings(topics: tuple[TopicContents, ...], used: Mapping[str, str]) -> Iterator[str]:
    names = {name.partition(" ")[0] for name in used.values()}
    # Transforms of several frames share a topic, and static ones come once.
    chosen = [topic for topic in topics if topic.name in names and topic.type != TRANSFORMS]
    for topic in chosen:
        if topic.zero_stamps:
            yield f"{topic.name}: {topic.zero_stamps} messages are stamped 0: they are not used"
        if topic.backward_stamps:
            yield (
                f"{topic.name}: {topic.backward_stamps} stamps do not exceed the one before: such "
                "messages are dropped"
            )
        if topic.gaps:
            yield f"{topic.name}: {topic.gaps} gaps, the longest of {topic.longest_gap_s:.3g} s"
    if len(chosen) >= 2:
        start = max(topic.start_ns for topic in chosen)
        end = min(topic.end_ns for topic in chosen)
        if start >= end:
            listed = " and ".join(topic.name for topic in chosen)
            yield f"the stamps of {listed} do not overlap: are they of one clock?"


class _Stamps:
    """Stamps of one topic, and when they were recorded."""

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._stamped = _has_header(topic)
        self._frame: str | None = None
        self._stamps, self._recorded = array("q"), array("q")

    def add(self, data: bytes, log_time_ns: int) -> None:
        if self._stamped and not self._stamps:
            self._frame = _frame(data)
        self._stamps.append(_stamp(data) if self._stamped else log_time_ns)
        self._recorded.append(log_time_ns)

    def contents(self) -> TopicContents:
        every, recorded = (np.array(a, np.int64) for a in (self._stamps, self._recorded))
        is_there = every != 0 if self._stamped else np.ones(every.size, bool)
        stamps = every[is_there]
        delay = float(np.mean(recorded[is_there] - stamps)) if stamps.size else 0.0
        is_ahead = np.ones(stamps.size, bool)
        is_ahead[1:] = stamps[1:] > np.maximum.accumulate(stamps)[:-1]
        kept = stamps[is_ahead]
        steps = np.diff(kept)
        is_gap = (steps > _GAP_STEPS * np.median(steps)) & (steps > _GAP_NS) if steps.size else []
        gaps, steady = steps[is_gap], np.delete(steps, np.flatnonzero(is_gap))
        return TopicContents(
            name=self._topic.name,
            type=self._topic.type_name,
            messages=self._topic.message_count,
            frame=self._frame,
            stamped=self._stamped,
            start_ns=int(kept[0]) if kept.size else 0,
            end_ns=int(kept[-1]) if kept.size else 0,
            rate_hz=_NS_PER_S / float(steady.mean()) if steady.size else 0.0,
            jitter_s=float(steady.std()) / _NS_PER_S if steady.size else 0.0,
            gaps=gaps.size,
            longest_gap_s=float(gaps.max(initial=0)) / _NS_PER_S,
            backward_stamps=stamps.size - kept.size,
            zero_stamps=every.size - stamps.size,
            delay_s=delay / _NS_PER_S,
        )


def _has_header(topic: Topic) -> bool:
    """Return whether a type begins with a header, by the definition in the bag."""
    for line in topic.schema.splitlines():
        code = line.partition("#")[0]
        if code.startswith("==="):
            return False
        if code.strip() and "=" not in code:
            return code.split()[0] in _HEADERS
    return False


def _order(data: bytes) -> str:
    return "<" if data[1] & 1 else ">"


def _stamp(data: bytes) -> int:
    """Return the stamp of a header [ns]; 0 where the bytes are too few."""
    if len(data) < _STAMPED:
        return 0
    seconds, nanoseconds = struct.unpack_from(_order(data) + "iI", data, 4)
    return int(seconds) * _NS_PER_S + int(nanoseconds)


def _frame(data: bytes) -> str | None:
    if len(data) < _STAMPED + 4:
        return None
    (length,) = struct.unpack_from(_order(data) + "I", data, _STAMPED)
    return data[_STAMPED + 4 : _STAMPED + 4 + max(length - 1, 0)].decode("utf-8", "replace")
