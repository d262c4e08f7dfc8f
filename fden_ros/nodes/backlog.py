# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the node does when messages come faster than it computes: batches, and counts.

Most of the time a message is read as it comes. After every 32 messages the node looks whether more
have come; then it takes all that wait out of the middleware at once, before its queues overflow,
and works them off in order, the streams side by side. What is too much even for that, the oldest,
is dropped and counted.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

#: Whether more messages wait is looked at after every 32, read one by one or worked off.
_LOOK_EVERY = 32
#: Timers and services get their turn after at most 50 ms of working off [s].
_LONGEST_TURN = 0.05
#: More waiting messages than this are dropped, the oldest first: 2 s of two streams at 5 kHz.
_MOST_WAITING = 20_000


@dataclass(frozen=True)
class Input:
    """One subscription: where more of its messages come from, and what reads one."""

    name: str
    take: Callable[[], bytes | None]
    read: Callable[[bytes], None]


class Backlog:
    """Messages that wait, in the order of each stream."""

    def __init__(self) -> None:
        self.inputs: list[Input] = []
        self.received: Counter[str] = Counter()  #: read so far, by the name of the input
        self.dropped: Counter[str] = Counter()
        self.batches = 0  #: how often messages had to be taken together
        self.most_waiting = 0
        self._waiting: deque[tuple[Input, bytes]] = deque()
        self._since_look = 0

    @property
    def waiting(self) -> int:
        """How many messages wait here."""
        return len(self._waiting)

    def add(self, source: Input, data: bytes) -> None:
        """Take a message: read it now, unless others wait."""
        self._since_look += 1
        if not self._waiting and self._since_look < _LOOK_EVERY:
            self._read(source, data)
            return
        self._waiting.append((source, data))
        self.work()

    def work(self) -> None:
        """Work off what waits, for a turn."""
        end = time.monotonic() + _LONGEST_TURN
        waiting = self._waiting
        self._look()
        while waiting and time.monotonic() < end:
            for _ in range(min(_LOOK_EVERY, len(waiting))):
                self._read(*waiting.popleft())
            self._look()

    def clear(self) -> None:
        """Forget what waits, and where it came from."""
        self._waiting.clear()
        self.inputs.clear()

    def _read(self, source: Input, data: bytes) -> None:
        self.received[source.name] += 1
        source.read(data)

    def _look(self) -> None:
        """Take what waits in the middleware."""
        self._since_look = 0
        before = len(self._waiting)
        self._waiting.extend(_side_by_side(self.inputs))
        self.batches += len(self._waiting) > before + 1
        self.most_waiting = max(self.most_waiting, len(self._waiting))
        while len(self._waiting) > _MOST_WAITING:
            source, _ = self._waiting.popleft()
            self.dropped[source.name] += 1


def _side_by_side(inputs: list[Input]) -> list[tuple[Input, bytes]]:
    """Take what waits of every stream, all over the same time; return it in the order of that.

    One stream after the other, the first would wait for its partners longer than the pairing does.
    """
    found = []
    for source in inputs:
        waiting = list(iter(source.take, None))
        found += [((k + 0.5) / len(waiting), source, data) for k, data in enumerate(waiting)]
    found.sort(key=lambda one: one[0])
    return [(source, data) for _, source, data in found]


def taker(subscription: Any) -> Callable[[], bytes | None]:
    """Return what takes the next message of a raw subscription; it gives None if there is none."""
    handle, kind = subscription.handle, subscription.msg_type

    def take() -> bytes | None:
        with handle:
            taken = handle.take_message(kind, True)
        return None if taken is None else bytes(taken[0])

    return take
