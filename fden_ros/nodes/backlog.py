# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The node's messages: taken out of the middleware by a timer, worked off, and counted.

An event of the executor for every message would cost more than reading it: no executor waits for
these subscriptions, and a timer takes what has come, the streams side by side. While the node
computes it takes again after every 32 messages, before the middleware's queues overflow. What is
too much even for that, the oldest, is dropped and counted.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.event_handler import QoSSubscriptionEventType, UnsupportedEventTypeError
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.subscription import Subscription

#: Messages are taken so often [s]. Receiving one costs 52 us with an event for each, 24 us where
#: they are taken every 5 ms, and 15 us every 10 ms, which would make estimates 5 ms older.
TAKE_PERIOD = 0.005
#: While messages are worked off, more are taken after every 32.
_TAKE_EVERY = 32
#: Other timers and services get their turn after at most 50 ms of working off [s].
_LONGEST_TURN = 0.05
#: More waiting messages than this are dropped, the oldest first: 2 s of two streams at 5 kHz.
_MOST_WAITING = 20_000


class Message(NamedTuple):
    """A message as it was taken."""

    data: bytes
    received_ns: int  #: when the middleware received it, by the system's clock


@dataclass(frozen=True)
class Input:
    """One subscription: what takes all that has come, and what reads one message."""

    name: str
    take: Callable[[], list[Message]]
    read: Callable[[bytes], None]


class Backlog:
    """Messages that wait, in the order of each stream."""

    def __init__(self) -> None:
        self.inputs: list[Input] = []
        self.received: Counter[str] = Counter()  #: read so far, by the name of the input
        self.dropped: Counter[str] = Counter()
        self.most_waiting = 0
        self.received_ns = 0  #: of the message that is read, or was last
        self._waiting: deque[tuple[Input, Message]] = deque()

    @property
    def waiting(self) -> int:
        """How many messages wait here."""
        return len(self._waiting)

    def work(self) -> None:
        """Take what has come, and work it off for a turn."""
        end = time.monotonic() + _LONGEST_TURN
        waiting = self._waiting
        self._take()
        while waiting and time.monotonic() < end:
            for _ in range(min(_TAKE_EVERY, len(waiting))):
                source, message = waiting.popleft()
                self.received[source.name] += 1
                self.received_ns = message.received_ns
                source.read(message.data)
            self._take()

    def clear(self) -> None:
        """Forget what waits, and where it came from."""
        self._waiting.clear()
        self.inputs.clear()

    def _take(self) -> None:
        self._waiting.extend(_side_by_side(self.inputs))
        self.most_waiting = max(self.most_waiting, len(self._waiting))
        while len(self._waiting) > _MOST_WAITING:
            source, _ = self._waiting.popleft()
            self.dropped[source.name] += 1


def _side_by_side(inputs: list[Input]) -> list[tuple[Input, Message]]:
    """Take what waits of every stream, all over the same time; return it in the order of that.

    One stream after the other, the first would wait for its partners longer than the pairing does.
    """
    found = []
    for source in inputs:
        taken = source.take()
        found += [((k + 0.5) / len(taken), source, one) for k, one in enumerate(taken)]
    found.sort(key=lambda one: one[0])
    return [(source, message) for _, source, message in found]


class Taken(ReentrantCallbackGroup):
    """Of subscriptions that no executor waits for; their node leaves them out."""


def taker(subscription: Subscription) -> Callable[[], list[Message]]:
    """Return what takes the messages of a raw subscription that have come."""
    handle = subscription.handle
    take_one = partial(handle.take_message, subscription.msg_type, True)

    def take() -> list[Message]:
        with handle:
            # A middleware that does not know when it received a message says 0.
            return [
                Message(data, info["received_timestamp"] or time.time_ns())
                for data, info in iter(take_one, None)
            ]

    return take


def loss_counter(subscription: Subscription) -> Callable[[], int]:
    """Return what counts the messages that the middleware has lost so far.

    It is asked. As an event of the executor it would wake some with every message.
    """
    kind = QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
    try:
        with subscription.handle:
            event: Any = rclpy_implementation.EventHandle(subscription.handle, kind)
    except UnsupportedEventTypeError:
        return lambda: 0

    def count() -> int:
        with event:
            return int(event.take_event().total_count)

    return count
