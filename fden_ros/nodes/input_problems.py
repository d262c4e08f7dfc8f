# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What keeps the inputs from the node: the topic, what was found there, and what mends it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from rclpy.subscription import Subscription

from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams import Reason
from fden_ros.inputs import TRANSFORM_TOPICS, TYPE_NAMES, Inputs
from fden_ros.ros.messages import type_name

#: Other topics that are named where nothing publishes the one that is listened to, at most.
_MOST_NAMED = 3
#: What does without header stamps.
_RECEIVE = "set synchronize.stamp_source to receive"
#: The middleware's name of a node whose publisher was discovered before itself.
_UNKNOWN_NAME = "_NODE_NAME_UNKNOWN_"


@dataclass(frozen=True)
class ListenedTo:
    """One input of a node."""

    stream: str  #: ``force`` or ``displacement``, the name before any remapping
    subscription: Subscription

    def problems(self, node: Node, *, has_come: bool) -> list[str]:
        """Return what is wrong with the publishers of this input, a sentence each.

        Parameters
        ----------
        node : Node
        has_come : bool
            A message was received.
        """
        topic, expected = self.subscription.topic_name, type_name(self.subscription.msg_type)
        publishers = node.get_publishers_info_by_topic(topic)
        problems = self._wrong_publishers(publishers, expected)
        if self.stream in TRANSFORM_TOPICS:
            # Many publish them, or none: what counts is whether they connect the frames.
            return problems
        if not publishers:
            return [self._nothing_publishes(node, expected)]
        if len(publishers) > 1:
            problems.append(f"{topic} has {len(publishers)} publishers: their samples are mixed")
        if not problems and not has_come:
            names = ", ".join(sorted({_full_name(p) for p in publishers}))
            problems.append(f"{topic} is published by {names}, but no message has come from it")
        return problems

    def lost(self, received: int, fastest: int, lost: int, dropped: int) -> list[str]:
        """Return that messages were lost in the last second, and what mends it.

        Parameters
        ----------
        received, fastest : int
            Messages that were read in the last second, and in the fastest second so far.
        lost, dropped : int
            Lost in the middleware, and dropped by the node, which computes too slowly.
        """
        topic, count = self.subscription.topic_name, lost + dropped
        if not count:
            return []
        words = f"{count} of {received + count} messages a second on {topic} lost"
        slower = f"publish it at no more than {max(fastest, 1)} Hz"
        if dropped:
            slower = f"the node cannot keep pace; {slower}, or give it a core of its own"
        elif self.subscription.qos_profile.reliability != ReliabilityPolicy.RELIABLE:
            override = f"qos_overrides.{topic}.subscription.reliability"
            slower += f", or set {override} to reliable where its publisher offers that"
        return [f"{words}: {slower}"]

    def _wrong_publishers(self, publishers: list[Any], expected: str) -> list[str]:
        topic, asked = self.subscription.topic_name, self.subscription.qos_profile
        kinds = sorted({p.topic_type for p in publishers} - {expected})
        problems = [self._other_type(kind, expected) for kind in kinds]
        offered = {p.qos_profile.reliability for p in publishers if p.topic_type == expected}
        is_reliable = asked.reliability == ReliabilityPolicy.RELIABLE
        if is_reliable and ReliabilityPolicy.BEST_EFFORT in offered:
            problems.append(
                f"a publisher on {topic} offers best_effort where reliable is requested: nothing "
                f"comes from it; set qos_overrides.{topic}.subscription.reliability to best_effort"
            )
        return problems

    def _nothing_publishes(self, node: Node, expected: str) -> str:
        others = _published(node, self.stream)
        same = [name for name, kind in others.items() if kind == expected]
        found = f"nothing publishes {self.subscription.topic_name}, where {expected} is expected"
        if same:
            return f"{found}: {_list(same)} has that type; remap it, {self._remap(same[0])}"
        if others:
            name, kind = next(iter(others.items()))
            remap = self._remap(name)
            return f"{found}: {name} is {kind}; remap it, {remap}, and {self._set(kind)}"
        return f"{found}: start its publisher, or remap it, {self._remap('TOPIC')}"

    def _other_type(self, kind: str, expected: str) -> str:
        found = f"{self.subscription.topic_name} is published as {kind}, expected {expected}"
        mend = f"{self._set(kind)}, or " if kind in TYPE_NAMES[self.stream].values() else ""
        return f"{found}: {mend}remap it, {self._remap('TOPIC')}"

    def _remap(self, topic: str) -> str:
        if self.stream in TRANSFORM_TOPICS:
            return f"-r {self.stream}:={topic}"
        return f"-r {self.stream}:={topic} (launch: {self.stream}_topic:={topic})"

    def _set(self, kind: str) -> str:
        value = next(name for name, known in TYPE_NAMES[self.stream].items() if known == kind)
        return f"set {self.stream}.message to {value}"


def pairing_problem(pipeline: Pipeline, inputs: Inputs) -> str | None:
    """Return why messages of all inputs have made no pair of samples; None while some lack."""
    if pipeline.pair_count or not all(map(inputs.has_come, inputs.names)):
        return None
    mends = {
        f"{stream}.{Reason.ZERO_STAMP}": (
            f"the header stamps of the {stream} are not set: set them, or {_RECEIVE}"
        )
        for stream in inputs.names
    } | {
        f"force.{Reason.MISSING_FIELD}": "no joint of that name, or no effort: set force.name",
        f"displacement.{Reason.MISSING_FIELD}": (
            "no joint of that name, or no position or orientation: set displacement.name"
        ),
        f"force.{Reason.NO_TRANSFORM}": "are the stamps of the transforms of the same clock?",
    }
    for reason, _ in pipeline.rejected.most_common():
        if reason in mends:
            return f"force and displacement come, but no pair of them ({reason}): {mends[reason]}"
    return (
        "force and displacement come, but no pair of them: do their header stamps overlap, and "
        f"are they of one clock? If not, {_RECEIVE}"
    )


def clock_problem(node: Node) -> list[str]:
    """Return that the time is that of a topic that nothing publishes, if so."""
    if not node.get_parameter("use_sim_time").value or node.get_clock().now().nanoseconds:
        return []
    return [
        "use_sim_time is set but nothing publishes /clock: play the bag with ros2 bag play "
        "--clock, or set use_sim_time to false"
    ]


def second_publisher(node: Node, topic: str) -> list[str]:
    """Return that another node publishes the node's own topic, if so."""
    count = node.count_publishers(topic)
    if count < 2:
        return []
    return [
        f"{topic} has {count} publishers, whose estimates are mixed: end the other identifier of "
        "this name, or name it with -r __node:=NAME"
    ]


def _published(node: Node, stream: str) -> dict[str, str]:
    """Return other topics, and their types, that could be the input `stream`."""
    kinds = set(TYPE_NAMES[stream].values())
    heard = node.get_subscriber_names_and_types_by_node(node.get_name(), node.get_namespace())
    own = {name for name, _ in heard}
    return {
        name: kind
        for name, types in sorted(node.get_topic_names_and_types())
        for kind in types
        if kind in kinds and name not in own and node.count_publishers(name)
    }


def _list(names: list[str]) -> str:
    rest = len(names) - _MOST_NAMED
    return ", ".join(names[:_MOST_NAMED]) + (f" and {rest} others" if rest > 0 else "")


def _full_name(publisher: Any) -> str:
    if publisher.node_name == _UNKNOWN_NAME:
        return "a node of unknown name"
    return f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
