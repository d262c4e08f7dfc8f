# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Problems of the inputs: the topic, what was found there, and the remedy."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from rclpy.subscription import Subscription

from fden_ros.advice import TOPICS
from fden_ros.core.pipeline import Pipeline
from fden_ros.inputs import TRANSFORM_TOPICS, TYPE_NAMES, Inputs
from fden_ros.ros.messages import type_name


@dataclass(frozen=True)
class ListenedTo:
    """One input of a node."""

    stream: str  #: ``force`` or ``displacement``, the name before any remapping
    subscription: Subscription

    def problems(self, node: Node, *, has_come: bool) -> list[str]:
        """Return what is wrong with the publishers of this input, a sentence each.

        `has_come`: a message was received.
        """
        topic, expected = self.subscription.topic_name, type_name(self.subscription.msg_type)
        publishers = node.get_publishers_info_by_topic(topic)
        kinds = sorted({p.topic_type for p in publishers} - {expected})
        found = [self._say("type", kind=kind) for kind in kinds]
        offered = {p.qos_profile.reliability for p in publishers if p.topic_type == expected}
        if self._is_reliable and ReliabilityPolicy.BEST_EFFORT in offered:
            found.append(self._say("reliability"))
        if self.stream in TRANSFORM_TOPICS:
            # Many nodes publish them, or none: they have to connect the frames.
            return found
        if not publishers:
            return [self._nothing_publishes(node, expected)]
        if len(publishers) > 1:
            found.append(self._say("several", count=len(publishers)))
        if not found and not has_come:
            full = {f"{p.node_namespace.rstrip('/')}/{p.node_name}" for p in publishers}
            found.append(self._say("silent", names=", ".join(sorted(full))))
        return found

    def lost(self, received: int, fastest: int, lost: int, dropped: int) -> list[str]:
        """Return that messages were lost in the last second, with the remedy.

        `received` and `fastest` were read in the last second, and in the fastest one so far;
        `lost` in the middleware, and `dropped` by the node, which computes too slowly.
        """
        topic, count = self.subscription.topic_name, lost + dropped
        slower = f"publish it at no more than {max(fastest, 1)} Hz"
        if dropped:
            slower = f"the node cannot keep pace; {slower}, or give it a core of its own"
        elif not self._is_reliable:
            slower += f", or set {self._override} to reliable where its publisher offers that"
        words = f"{count} of {received + count} messages a second on {topic} lost: {slower}"
        return [words] if count else []

    @property
    def _is_reliable(self) -> bool:
        return bool(self.subscription.qos_profile.reliability == ReliabilityPolicy.RELIABLE)

    @property
    def _override(self) -> str:
        return f"qos_overrides.{self.subscription.topic_name}.subscription.reliability"

    def _say(self, code: str, kind: str = "", other: str = "TOPIC", **values: object) -> str:
        """Return a sentence of the table with its values."""
        stream = self.stream
        names = {known: name for name, known in TYPE_NAMES[stream].items()}
        remap = f"-r {stream}:={other}"
        if stream not in TRANSFORM_TOPICS:
            remap += f" (launch: {stream}_topic:={other})"
        if code == "type" and kind not in names:
            code = "unknown type"
        values |= {"topic": self.subscription.topic_name, "override": self._override}
        values |= {"expected": type_name(self.subscription.msg_type), "name": names.get(kind)}
        return str(TOPICS[code].of(stream=stream, remap=remap, kind=kind, other=other, **values))

    def _nothing_publishes(self, node: Node, expected: str) -> str:
        """Report it, and which other topic it could be, preferably one of its type."""
        kinds = set(TYPE_NAMES[self.stream].values())
        own = node.get_subscriber_names_and_types_by_node(node.get_name(), node.get_namespace())
        others = [
            (kind != expected, name, kind)
            for name, types in node.get_topic_names_and_types()
            for kind in kinds.intersection(types)
            if name not in dict(own) and node.count_publishers(name)
        ]
        if not others:
            return self._say("nothing")
        is_other, name, kind = min(others)
        return self._say("other type elsewhere" if is_other else "elsewhere", kind, name)


def pairing_problem(pipeline: Pipeline, inputs: Inputs) -> str | None:
    """Return why messages of all inputs have made no pair of samples; None while some lack."""
    if pipeline.pair_count or not all(map(inputs.has_come, inputs.names)):
        return None
    reasons = [one for one, _ in pipeline.rejected.most_common() if one.split(".")[1] in TOPICS]
    stream, _, code = (reasons or [".no pair"])[0].partition(".")
    reason = f" ({reasons[0]})" if reasons else ""
    advice = TOPICS[code].of(stream=stream)
    return f"force and displacement come, but no pair of them{reason}: {advice}"


def clock_problem(node: Node) -> list[str]:
    """Return that nothing publishes the topic of the time, if so."""
    is_set = node.get_parameter("use_sim_time").value
    return [str(TOPICS["no clock"])] if is_set and not node.get_clock().now().nanoseconds else []


def second_publisher(node: Node, topic: str) -> list[str]:
    """Return that another node publishes the node's own topic, if so."""
    count = node.count_publishers(topic)
    return [str(TOPICS["two identifiers"].of(topic=topic, count=count))] if count > 1 else []
