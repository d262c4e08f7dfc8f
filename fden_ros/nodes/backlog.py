# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The node's messages: taken from the middleware by a timer, decoded, processed, and counted.

A typed subscription costs 75 us a message, this 20 us: no executor waits for these subscriptions;
a timer takes the messages. While the node computes it takes again after every 32 messages,
before the middleware's queues overflow. The oldest of too many are dropped and counted.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.event_handler import QoSSubscriptionEventType, UnsupportedEventTypeError
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.subscription import Subscription

from fden_ros.inputs import DAMAGED, Inputs, stream_of
from fden_ros.recording.message_types import decoder

#: Period of the timer [s].
TAKE_PERIOD = 0.005
_TAKE_EVERY = 32
#: Timers and services get their turn after 50 ms of processing [s].
_LONGEST_TURN = 0.05
#: More waiting messages than this are dropped, the oldest first: 2 s of two streams at 5 kHz.
_MOST_WAITING = 20_000


class Taken(ReentrantCallbackGroup):
    """Group of subscriptions that no executor waits for; their node leaves them out."""


#: Returns bytes of messages, and when the middleware received each, by the system's clock [ns].
Take = Callable[[], list[tuple[bytes, int]]]


class _Waiting(NamedTuple):
    stream: str
    data: bytes
    received_ns: int


class Backlog:
    """Messages that wait, in the order of each stream.

    Where `is_restamped`, their time is that of their receipt.
    """

    def __init__(self, inputs: Inputs, *, is_restamped: bool) -> None:
        self._inputs, self._is_restamped = inputs, is_restamped
        self.received: Counter[str] = Counter()  #: read so far, by the name of the input
        self.dropped: Counter[str] = Counter()
        self.received_ns = 0  #: of the message that is read, or was last
        self._takes: dict[str, Take] = {}
        self._decoders: dict[str, Callable[[bytes], Any]] = {}
        self._losses: dict[str, Callable[[], int]] = {}
        self._waiting: deque[_Waiting] = deque()

    @property
    def waiting(self) -> int:
        """How many messages wait here."""
        return len(self._waiting)

    @property
    def lost(self) -> Counter[str]:
        """Messages lost so far in the middleware, by the name of the input."""
        return Counter({stream: count() for stream, count in self._losses.items()})

    def listen(self, stream: str, kind: str, subscription: Subscription) -> None:
        """Add a raw subscription, with messages of the type `kind`."""
        self._losses[stream] = _loss_counter(subscription)
        self.add(stream, partial(_taken, subscription), decoder(kind))

    def add(self, stream: str, take: Take, decode: Callable[[bytes], Any]) -> None:
        """Add a source of messages: `take` returns them."""
        self._takes[stream], self._decoders[stream] = take, decode

    def work(self) -> None:
        """Take the waiting messages, and process them for a turn."""
        end = time.monotonic() + _LONGEST_TURN
        waiting = self._waiting
        self._take()
        while waiting and time.monotonic() < end:
            for _ in range(min(_TAKE_EVERY, len(waiting))):
                self._read(waiting.popleft())
            self._take()

    def clear(self) -> None:
        """Drop the waiting messages and their sources."""
        self._waiting.clear()
        self._takes.clear()
        self._losses.clear()

    def _read(self, one: _Waiting) -> None:
        self.received[one.stream] += 1
        self.received_ns = one.received_ns
        try:
            message = self._decoders[one.stream](one.data)
        except Exception:  # decoders raise many kinds for bytes that do not fit
            self._inputs.reject(stream_of(one.stream), DAMAGED)
            return
        received = one.received_ns if self._is_restamped else None
        self._inputs.add(one.stream, message, received)

    def _take(self) -> None:
        """Take the waiting messages, alternating streams: no stream waits long for its partner."""
        found = []
        for stream, take in self._takes.items():
            taken = take()
            found += [(k / len(taken), _Waiting(stream, *one)) for k, one in enumerate(taken, 1)]
        found.sort(key=lambda one: one[0])
        self._waiting.extend(one for _, one in found)
        while len(self._waiting) > _MOST_WAITING:
            self.dropped[self._waiting.popleft().stream] += 1


def _taken(subscription: Subscription) -> list[tuple[bytes, int]]:
    handle = subscription.handle
    take_one = partial(handle.take_message, subscription.msg_type, True)
    with handle:
        return [
            (data, info["received_timestamp"] or time.time_ns())
            for data, info in iter(take_one, None)
        ]


def _loss_counter(subscription: Subscription) -> Callable[[], int]:
    """Return a function that counts the messages that the middleware has lost so far.

    An event of the executor would wake some executors with every message.
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
