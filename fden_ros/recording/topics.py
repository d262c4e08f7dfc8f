# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The topics of force and displacement in a bag."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable

from fden_ros.errors import InputError
from fden_ros.inputs import TRANSFORMS, TYPE_NAMES
from fden_ros.recording.bag_files import Topic
from fden_ros.recording.headings import COMMANDED
from fden_ros.recording.reader import BagReader

# Words in a topic's name, and the quantity that they indicate.
# cf, cp and js are those of CRTK and dVRK (measured_cf, setpoint_cp, ...).
WORDS = {
    "force": {"force", "wrench", "ft", "fts", "cf"},
    "displacement": {"displacement", "position", "pose", "cp", "probe", "tip", "tcp"},
}
#: The package of an identifier's outputs, which are not measurements.
RESULTS = "fden_msgs/"


class NoTopicError(InputError):
    """No topic carries a quantity by its type alone: its field has to be named."""


def find_topic(
    reader: BagReader, name: str | None, stream: str, others: Collection[Topic]
) -> Topic:
    """Return the topic called `name`, or the only sensible one for `stream`.

    Without a name the candidates are the topics of a usable type that have messages. One is
    sensible if it is the only one left after these rules, in this order: its name's last part is
    `stream`; it is measured, not commanded (``setpoint_cp``, ``goal``); it is no joint states,
    which usually are the arm's and not the probe's; its name contains a word for `stream`.

    Parameters
    ----------
    reader : BagReader
    name : str or None
    stream : str
        ``force`` or ``displacement``.
    others : collection of Topic
        The topics of the other quantities, which are no candidates.
    """
    usable = TYPE_NAMES[stream].values()
    if name is not None:
        topic = topic_with_messages(reader, name)
        if topic.type_name not in usable:
            raise NoTopicError(
                f"{name} carries {topic.type_name}, which holds no {stream} by itself: name the "
                f"field with --{stream}-field, or choose a topic of {', '.join(sorted(usable))}"
            )
        return topic
    candidates = [
        t for t in reader.topics if t.type_name in usable and t.message_count and t not in others
    ]
    chosen = _sensible(candidates, stream)
    if len(chosen) == 1:
        return chosen[0]
    if chosen:
        raise InputError(
            f"{reader.path}: several topics could carry the {stream}: {_listed(chosen)}; name it "
            f"with --{stream}-topic"
        )
    types = {topic.type_name for topic in reader.topics}
    hint = f"name it with --{stream}-topic, and the number in it with --{stream}-field"
    if stream == "displacement" and TRANSFORMS in types:
        hint = "to follow /tf, set frames.base, frames.probe and displacement.message: tf"
    if any(name.startswith(RESULTS) for name in types):
        hint = f"fden_msgs are outputs of an identifier: replay its recording, or {hint}"
    listed = _listed(reader.topics)
    raise NoTopicError(f"{reader.path}: no topic can carry the {stream}: {listed}; {hint}")


def topic_with_messages(reader: BagReader, name: str) -> Topic:
    """Return the topic called `name`, on which something was recorded."""
    topic = reader.topic(name)
    if not topic.message_count:
        raise InputError(
            f"{reader.path}: topic {topic.name} has no messages: choose another one, or record "
            "it again"
        )
    return topic


def _listed(topics: Iterable[Topic]) -> str:
    return ", ".join(
        f"{one.name} ({one.type_name}{'' if one.message_count else ', no messages'})"
        for one in topics
    )


def is_commanded(topic: Topic) -> bool:
    """Return whether a topic is measured, not commanded, by its name."""
    return bool(_words(topic) & COMMANDED)


def _sensible(candidates: list[Topic], stream: str) -> list[Topic]:
    """Return those of the topics that most likely carry `stream`; see :func:`find_topic`."""
    joints = "sensor_msgs/msg/JointState"
    named = [t for t in candidates if t.name.rsplit("/", 1)[-1] == stream]
    if len(named) == 1:
        return named
    for keep in (
        lambda t: not is_commanded(t),
        lambda t: t.type_name != joints,
        lambda t: _words(t) & WORDS.get(stream, {stream}),
    ):
        candidates = [t for t in candidates if keep(t)] or candidates
        if len(candidates) == 1:
            break
    return candidates


def _words(topic: Topic) -> set[str]:
    return set(re.split(r"[^a-z]+", topic.name.lower()))
