# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What a bag holds: topics, rates, gaps and jitter, and what a replay would use of them."""

from __future__ import annotations

import math
import statistics
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fden_ros.errors import InputError
from fden_ros.parameters import Parameters
from fden_ros.recording.reader import BagReader, Topic
from fden_ros.recording.source import TRANSFORMS, BagSource, Selection

_STAMPED = 4 + 8  # CDR's header, then the stamp
# The rule for gaps is the pipeline's own: ten usual steps, and at least 20 ms.
_GAP_STEPS = 10.0
_GAP_NS = 20_000_000
_FIRST_STEPS = 1001
_NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class TopicContents:
    """What one topic holds.

    Stamps are those of the headers where there are any, else the times of recording.

    Attributes
    ----------
    name, type_name, message_count
        As in :class:`~fden_ros.recording.reader.Topic`.
    frame : str or None
        frame_id of the first message; None without a header.
    stamped : bool
        Whether its messages have headers.
    start_ns, end_ns : int
        First and last stamp.
    rate : float
        Messages per second, gaps left out [Hz]; 0 with fewer than two.
    jitter : float
        Standard deviation of the step, gaps left out [s].
    gap_count, longest_gap : int, float
        Steps of over 20 ms and ten usual ones, and the longest of them [s].
    backward_count : int
        Stamps that do not exceed the one before.
    zero_count : int
        Stamps of 0.
    delay : float
        Mean time from stamp to recording [s]; 0 without headers.
    """

    name: str
    type_name: str
    message_count: int
    frame: str | None = None
    stamped: bool = False
    start_ns: int = 0
    end_ns: int = 0
    rate: float = 0.0
    jitter: float = 0.0
    gap_count: int = 0
    longest_gap: float = 0.0
    backward_count: int = 0
    zero_count: int = 0
    delay: float = 0.0

    @property
    def duration(self) -> float:
        """Time from the first to the last stamp [s]."""
        return (self.end_ns - self.start_ns) / _NS_PER_S


@dataclass(frozen=True)
class BagContents:
    """What a bag holds.

    Attributes
    ----------
    topics
        By name.
    used : mapping
        ``force``, ``displacement`` and ``surface`` to the topic that a replay would use.
    problems
        Why a replay could not begin, a line each.
    warnings
        What is wrong with the bag, a line each.
    """

    topics: tuple[TopicContents, ...]
    used: Mapping[str, str]
    problems: tuple[str, ...]
    warnings: tuple[str, ...]


def inspect(
    path: str | Path,
    parameters: Parameters,
    selection: Selection | None = None,
    progress: Callable[[int], object] = lambda done: None,
) -> BagContents:
    """Read a bag through and return what it holds.

    Parameters
    ----------
    path : path
    parameters : mapping
        Checked parameter values.
    selection : Selection, optional
        As a replay would be given.
    progress : callable
        Called now and then with the number of messages read.

    Raises
    ------
    InputError
        If the bag cannot be read.
    """
    reader = BagReader(path)
    tallies = {topic.name: _Tally(topic) for topic in reader.topics}
    for done, message in enumerate(reader.messages(), start=1):
        tallies[message.topic].add(message.data, message.log_time_ns)
        if done % 1000 == 0:
            progress(done)
    used, problems = _used(path, parameters, selection or Selection())
    topics = tuple(tally.contents() for tally in tallies.values())
    return BagContents(
        topics=topics,
        used=used,
        problems=tuple(problems),
        warnings=(*reader.warnings, *_warnings(topics, used)),
    )


def contents_object(contents: BagContents) -> dict[str, Any]:
    """Return the contents as what ``fden info --json`` prints."""
    return {
        "topics": [
            {
                "name": t.name,
                "type": t.type_name,
                "messages": t.message_count,
                "frame": t.frame,
                "stamped": t.stamped,
                "start_ns": t.start_ns,
                "end_ns": t.end_ns,
                "rate_hz": t.rate,
                "jitter_s": t.jitter,
                "gaps": t.gap_count,
                "longest_gap_s": t.longest_gap,
                "backward_stamps": t.backward_count,
                "zero_stamps": t.zero_count,
                "delay_s": t.delay,
            }
            for t in contents.topics
        ],
        "used": dict(contents.used),
        "problems": list(contents.problems),
        "warnings": list(contents.warnings),
    }


def _used(
    path: str | Path, parameters: Parameters, selection: Selection
) -> tuple[dict[str, str], list[str]]:
    try:
        return BagSource(path, parameters, selection).inputs, []
    except InputError as error:
        return {}, [str(error)]


def _warnings(topics: tuple[TopicContents, ...], used: Mapping[str, str]) -> list[str]:
    names = {name.partition(" ")[0] for name in used.values()}
    # Transforms of several frames share a topic, and static ones come once.
    chosen = [t for t in topics if t.name in names and t.type_name != TRANSFORMS]
    warnings = []
    for topic in chosen:
        if topic.zero_count:
            warnings.append(
                f"{topic.name}: {topic.zero_count} messages are stamped 0: they are not used"
            )
        if topic.backward_count:
            warnings.append(
                f"{topic.name}: {topic.backward_count} stamps do not exceed the one before: such "
                "messages are dropped"
            )
        if topic.gap_count:
            warnings.append(
                f"{topic.name}: {topic.gap_count} gaps, the longest of {topic.longest_gap:.3g} s"
            )
    if len(chosen) >= 2:
        start = max(topic.start_ns for topic in chosen)
        end = min(topic.end_ns for topic in chosen)
        if start >= end:
            listed = " and ".join(topic.name for topic in chosen)
            warnings.append(f"the stamps of {listed} do not overlap: are they of one clock?")
    return warnings


@dataclass
class _Tally:
    """Running figures of one topic, in constant memory."""

    topic: Topic
    count: int = 0
    frame: str | None = None
    stamped: bool = False
    first_ns: int = 0
    last_ns: int = 0
    usual_ns: float = 0.0
    first_steps: list[int] = field(default_factory=list)
    steps: int = 0
    mean: float = 0.0
    squares: float = 0.0
    gaps: int = 0
    longest_ns: int = 0
    backward: int = 0
    zeros: int = 0
    delay_ns: int = 0

    def add(self, data: bytes, log_time_ns: int) -> None:
        if self.count == 0:
            self.stamped = _has_header(self.topic)
            self.frame = _frame(data) if self.stamped else None
        self.count += 1
        stamp = _stamp(data) if self.stamped else log_time_ns
        if stamp is None or (self.stamped and stamp == 0):
            self.zeros += 1
            return
        if self.stamped:
            self.delay_ns += log_time_ns - stamp
        if self.first_ns == 0:
            self.first_ns = self.last_ns = stamp
            return
        step = stamp - self.last_ns
        if step <= 0:
            self.backward += 1
            return
        self.last_ns = stamp
        if len(self.first_steps) < _FIRST_STEPS:
            self.first_steps.append(step)
            if len(self.first_steps) == _FIRST_STEPS:
                self._settle()
            return
        self._step(step)

    def contents(self) -> TopicContents:
        if not self.usual_ns:
            self._settle()
        stamped_count = self.count - self.zeros
        return TopicContents(
            name=self.topic.name,
            type_name=self.topic.type_name,
            message_count=self.topic.message_count,
            frame=self.frame,
            stamped=self.stamped,
            start_ns=self.first_ns,
            end_ns=self.last_ns,
            rate=_NS_PER_S / self.mean if self.mean else 0.0,
            jitter=math.sqrt(self.squares / self.steps) / _NS_PER_S if self.steps else 0.0,
            gap_count=self.gaps,
            longest_gap=self.longest_ns / _NS_PER_S,
            backward_count=self.backward,
            zero_count=self.zeros,
            delay=self.delay_ns / _NS_PER_S / stamped_count if stamped_count else 0.0,
        )

    def _settle(self) -> None:
        if self.first_steps:
            self.usual_ns = statistics.median(self.first_steps)
        for step in self.first_steps:
            self._step(step)

    def _step(self, step: int) -> None:
        if step > _GAP_STEPS * self.usual_ns and step > _GAP_NS:
            self.gaps += 1
            self.longest_ns = max(self.longest_ns, step)
            return
        # Welford's recursion.
        self.steps += 1
        change = step - self.mean
        self.mean += change / self.steps
        self.squares += change * (step - self.mean)


def _has_header(topic: Topic) -> bool:
    """Return whether a type begins with a header, by the definition in the bag."""
    for line in topic.schema.splitlines():
        code = line.partition("#")[0].split()
        if code and code[0].startswith("==="):
            return False
        if code and "=" not in line.partition("#")[0]:
            return code[0] in ("std_msgs/Header", "std_msgs/msg/Header", "Header")
    return False


def _order(data: bytes) -> str:
    return "<" if data[1] & 1 else ">"


def _stamp(data: bytes) -> int | None:
    if len(data) < _STAMPED:
        return None
    seconds, nanoseconds = struct.unpack_from(_order(data) + "iI", data, 4)
    return int(seconds) * _NS_PER_S + int(nanoseconds)


def _frame(data: bytes) -> str | None:
    if len(data) < _STAMPED + 4:
        return None
    (length,) = struct.unpack_from(_order(data) + "I", data, _STAMPED)
    return data[_STAMPED + 4 : _STAMPED + 4 + max(length - 1, 0)].decode("utf-8", "replace")
