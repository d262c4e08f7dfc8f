# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Playing a bag on live topics, as ``ros2 bag play`` does where that exists."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from rclpy.duration import Duration

from fden_ros.errors import InputError
from fden_ros.recording.bag_files import Topic
from fden_ros.recording.message_types import message_class, type_hash
from fden_ros.recording.qos import RELIABLE, Qos
from fden_ros.recording.reader import BagReader
from fden_ros.ros.inputs import TYPE_NAMES
from fden_ros.ros.plain_node import plain_node

#: Types that carry force or displacement.
INPUT_TYPES = {*TYPE_NAMES["force"].values(), *TYPE_NAMES["displacement"].values()}
_POLL_S = 0.02
_WAIT_TIMEOUT_S = 30.0
# What shared memory's queue does not hold is lost and sent again at the next heartbeat, every 3 s:
# faster than this (messages per second) a subscriber in Python receives less, not more.
_FASTEST_HZ = 4000.0
# Reliable queues keep messages for sending them again.
_QUEUE = 20_000
_ACKNOWLEDGE_TIMEOUT_S = 10.0
_NS_PER_S = 1_000_000_000


class Player:
    """Publish a bag with the recorded bytes, quality of service and pace.

    The player owns an rclpy context, so it can live beside other nodes of the process. Messages
    are paced by log time on the steady clock; a late one goes out at once and none is dropped.
    Header stamps stay as recorded, also when the bag is played again.

    Parameters
    ----------
    bag
        The bag, or its path.
    rate
        Speed (1: as recorded); ``math.inf`` plays as fast as subscribers in Python can follow.
    remap
        New names of topics.

    Raises
    ------
    InputError
        When the bag, a topic or a value cannot be used.

    Examples
    --------
    >>> with Player("ramp") as player:                                      # doctest: +SKIP
    ...     player.wait_for_subscribers()
    ...     player.play()
    """

    def __init__(
        self,
        bag: BagReader | str | Path,
        *,
        rate: float = 1.0,
        remap: Mapping[str, str] | None = None,
    ) -> None:
        if not rate > 0.0:
            raise InputError(f"rate {rate:g} cannot be played: expected a number above 0, or inf")
        self.bag = bag if isinstance(bag, BagReader) else BagReader(bag)
        self._rate = rate
        self._warnings: list[str] = []
        self._topics = self._select()
        self._names = {topic.name: topic.name for topic in self._topics}
        for old, new in (remap or {}).items():
            self.bag.topic(old)
            self._names[old] = new
        self._publishers: dict[tuple[str, str], Any] = {}
        self._opened = ExitStack()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What cannot be played or may not have arrived, a line each."""
        return tuple(self._warnings)

    @property
    def message_count(self) -> int:
        """Messages in one pass."""
        return sum(topic.message_count for topic in self._topics)

    @property
    def duration_s(self) -> float:
        """Length of the bag (s), at rate 1."""
        return ((self.bag.end_ns or 0) - (self.bag.start_ns or 0)) / _NS_PER_S

    @property
    def input_topics(self) -> tuple[str, ...]:
        """Live names of the topics that carry force or displacement."""
        return tuple(
            self._names[topic.name] for topic in self._topics if topic.type_name in INPUT_TYPES
        )

    def __enter__(self) -> Player:
        """Start the node and its publishers."""
        self._node, _ = self._opened.enter_context(plain_node("fden_player"))
        try:
            self._advertise()
        except BaseException:
            self._opened.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Destroy the node; latched messages vanish with it."""
        self._opened.close()

    def wait_for_subscribers(
        self,
        timeout_s: float = _WAIT_TIMEOUT_S,
        on_wait: Callable[[str], None] | None = None,
    ) -> None:
        """Wait until every force and displacement topic has a subscriber.

        Parameters
        ----------
        timeout_s
            How long to wait (s).
        on_wait
            Called with the topics that lack subscribers, and why if one is incompatible, at first
            and when they have changed.

        Raises
        ------
        InputError
            When a topic still lacks subscribers; it says which, and whether one is incompatible.
        """
        deadline = time.monotonic() + timeout_s
        said = ""
        while lacking := self._lacking():
            topics, why = ", ".join(lacking), self._incompatible(lacking)
            if on_wait is not None and topics + why != said:
                said = topics + why
                on_wait(said)
            time.sleep(_POLL_S)
            if time.monotonic() > deadline:
                raise InputError(
                    f"{topics}: no subscriber after {timeout_s:g} s: "
                    f"start it first, or do not wait (--no-wait){why}"
                )

    def play(self, on_progress: Callable[[int, float], None] | None = None) -> int:
        """Publish the bag once, and wait until reliable subscribers have everything.

        Parameters
        ----------
        on_progress
            Called after every message with the number of messages sent and the time within the
            bag (s).

        Returns
        -------
        int
            Number of messages sent.
        """
        start_ns = self.bag.start_ns
        if start_ns is None:
            return 0
        began = time.monotonic()
        sent = 0
        for message in self.bag.messages([topic.name for topic in self._topics]):
            self._sleep_until(began, message.log_time_ns - start_ns, sent)
            self._publishers[message.topic, message.type_name].publish(message.data)
            sent += 1
            if on_progress is not None:
                on_progress(sent, (message.log_time_ns - start_ns) / _NS_PER_S)
        self.wait_until_acknowledged()
        return sent

    def wait_until_acknowledged(self, timeout_s: float = _ACKNOWLEDGE_TIMEOUT_S) -> bool:
        """Wait until reliable subscribers have received all messages; return whether they have."""
        deadline = time.monotonic() + timeout_s
        late = [
            publisher.topic_name
            for publisher in self._publishers.values()
            if not publisher.wait_for_all_acked(
                Duration(seconds=max(0.0, deadline - time.monotonic()))
            )
        ]
        if late:
            self._warnings.append(f"a subscriber to {', '.join(late)} may lack messages")
        return not late

    def _advertise(self) -> None:
        for topic in self._topics:
            self._publishers[topic.name, topic.type_name] = self._node.create_publisher(
                message_class(topic.type_name),
                self._names[topic.name],
                _offer(topic.offered_qos).to_profile(),
            )

    def _lacking(self) -> list[str]:
        return [
            publisher.topic_name
            for (_, type_name), publisher in self._publishers.items()
            if type_name in INPUT_TYPES and not publisher.get_subscription_count()
        ]

    def _incompatible(self, topics: Collection[str]) -> str:
        """Return why a subscriber that is there may not be matched; empty when there is none."""
        for publisher in self._publishers.values():
            topic = publisher.topic_name
            if topic not in topics or publisher.get_subscription_count() > 0:
                continue
            for endpoint in self._node.get_subscriptions_info_by_topic(topic):
                qos = endpoint.qos_profile
                return (
                    f"; {endpoint.node_name} asks {topic} for {qos.reliability.name.lower()}, "
                    f"{qos.durability.name.lower()}, which the bag does not offer"
                )
        return ""

    def _sleep_until(self, began: float, elapsed_ns: int, sent: int) -> None:
        due = began + elapsed_ns / _NS_PER_S / self._rate
        if math.isinf(self._rate):
            due = began + sent / _FASTEST_HZ
        delay = due - time.monotonic()
        if delay > 0.0:
            time.sleep(delay)

    def _select(self) -> tuple[Topic, ...]:
        selected = []
        for topic in self.bag.topics:
            try:
                message_class(topic.type_name)
            except InputError as error:
                self._warnings.append(f"{topic.name} is not played: {error}")
                continue
            installed = type_hash(topic.type_name)
            if topic.type_hash and installed and topic.type_hash != installed:
                self._warnings.append(
                    f"{topic.name} is not played: it was recorded with another {topic.type_name}"
                )
                continue
            selected.append(topic)
        if not selected:
            raise InputError(f"{self.bag.path} has no topic that can be played: choose another")
        return tuple(selected)


def _offer(recorded: Collection[Qos]) -> Qos:
    """Return one offer that suits the subscribers of all recorded ones, with a deep queue."""
    if not recorded:
        return replace(RELIABLE, depth=_QUEUE)
    latched = all(qos.latched for qos in recorded)
    # The depth of a latched topic says how many old messages a late subscriber gets: it stays.
    return Qos(
        reliability="reliable" if all(qos.reliable for qos in recorded) else "best_effort",
        durability="transient_local" if latched else "volatile",
        depth=max(qos.depth for qos in recorded) if latched else _QUEUE,
    )
