# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Raw messages of a bag on live topics, where there is no ``ros2 bag play``."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

from rclpy.duration import Duration

from fden_ros.errors import InputError
from fden_ros.inputs import TYPE_NAMES
from fden_ros.recording.bag_files import Topic
from fden_ros.recording.message_types import message_class, type_hash
from fden_ros.recording.qos import RELIABLE
from fden_ros.recording.reader import BagReader
from fden_ros.ros.plain_node import plain_node

_INPUT_TYPES = {*TYPE_NAMES["force"].values(), *TYPE_NAMES["displacement"].values()}
#: Reliable queues keep messages for a retransmission.
_QUEUE = 20_000


def problem_of(topic: Topic) -> str:
    """Return why the messages of a topic cannot be published here; empty: they can."""
    try:
        message_class(topic.type_name)
    except InputError as error:
        return f"{topic.name} is not played: {error}"
    if topic.type_hash in ("", type_hash(topic.type_name)):
        return ""
    return f"{topic.name} is not played: it has another {topic.type_name}"


def play(
    bag: BagReader, rate: float = 1.0, remap: Mapping[str, str] | None = None, wait: float = 30.0
) -> int:
    """Publish the recorded bytes once, at their pace; return how many messages.

    Parameters
    ----------
    rate : float
        Speed [1].
    remap : mapping of str to str, optional
        New names of topics.
    wait : float
        For subscribers of force and displacement, and for reliable ones to have all [s].

    Raises
    ------
    InputError
        If there is nothing to play, or nobody listens.
    """
    names = {bag.topic(old).name: new for old, new in (remap or {}).items()}
    topics = [topic for topic in bag.topics if topic.message_count and not problem_of(topic)]
    if not topics:
        raise InputError(f"{bag.path} holds no message to play: choose another bag")
    with plain_node("fden_player") as (node, _):
        publishers = {}
        for topic in topics:
            offered = next(iter(topic.offered_qos), RELIABLE)
            qos = offered if offered.latched else replace(offered, depth=_QUEUE)
            name, kind = names.get(topic.name, topic.name), message_class(topic.type_name)
            publishers[topic.name] = node.create_publisher(kind, name, qos.to_profile())
        wanted = [publishers[topic.name] for topic in topics if topic.type_name in _INPUT_TYPES]
        end = time.monotonic() + wait
        while lacking := [one.topic_name for one in wanted if not one.get_subscription_count()]:
            if time.monotonic() > end:
                raise InputError(f"{', '.join(lacking)}: no subscriber after {wait:g} s")
            time.sleep(0.02)
        began, first_ns, sent = time.monotonic(), bag.start_ns or 0, 0
        for message in bag.messages(list(publishers)):
            due = began + 1e-9 * (message.log_time_ns - first_ns) / rate
            time.sleep(max(due - time.monotonic(), 0.0))
            publishers[message.topic].publish(message.data)
            sent += 1
        for publisher in publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=wait))
        return sent
