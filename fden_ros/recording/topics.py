# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which topics of a bag are the force and the displacement."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from fden_ros.errors import InputError
from fden_ros.inputs import TRANSFORMS, TYPE_NAMES
from fden_ros.recording.bag_files import Topic
from fden_ros.recording.headings import COMMANDED
from fden_ros.recording.reader import topic_named

# Words in a topic's name: what it most likely carries.
# cf, cp and js are those of CRTK and dVRK (measured_cf, setpoint_cp, ...).
WORDS = {
    "force": {"force", "wrench", "ft", "fts", "cf"},
    "displacement": {"displacement", "position", "pose", "cp", "probe", "tip", "tcp"},
}


#: The package of an identifier's outputs: nothing measured is in them.
RESULTS = "fden_msgs/"


class NoTopicError(InputError):
    """No topic carries a quantity by its type alone: its field has to be named."""


def find_topic(
    where: str, present: Sequence[Topic], name: str | None, stream: str, others: Collection[Topic]
) -> Topic:
    """Return the topic called `name`, or the only sensible one for `stream`.

    Without a name the candidates are the topics of a usable type that have messages. One is
    sensible if it is the only one left after, in this order: its name's last part is `stream`; it
    is measured, not wanted (``setpoint_cp``, ``goal``); it is no joint states, which are of the
    arm more often than of the probe; its name speaks of `stream`.

    Parameters
    ----------
    where : str
        What has the topics, for the line that says what is wrong.
    present : sequence of Topic
    name : str or None
    stream : str
        ``force`` or ``displacement``.
    others : collection of Topic
        The topics of the other quantities, which are no candidates.
    """
    usable = TYPE_NAMES[stream].values()
    if name is not None:
        topic = topic_with_messages(where, present, name)
        if topic.type_name not in usable:
            raise NoTopicError(
                f"{name} carries {topic.type_name}, which holds no {stream} by itself: name the "
                f"field with --{stream}-field, or choose a topic of {', '.join(sorted(usable))}"
            )
        return topic
    candidates = [
        t for t in present if t.type_name in usable and t.message_count and t not in others
    ]
    chosen = _sensible(candidates, stream)
    if len(chosen) == 1:
        return chosen[0]
    listed = ", ".join(map(_described, chosen or present)) or "none"
    problem = "several topics could carry" if chosen else "no topic can carry"
    hint = f"name it with --{stream}-topic"
    if not chosen:
        hint += f", and the number in it with --{stream}-field"
    if stream == "displacement" and not chosen and any(t.type_name == TRANSFORMS for t in present):
        hint = "where the probe's motion is in /tf, `fden configure` finds the frames"
    if not chosen and any(t.type_name.startswith(RESULTS) for t in present):
        hint = f"fden_msgs are what an identifier makes of a recording: replay that, or {hint}"
    kind = InputError if chosen else NoTopicError
    raise kind(f"{where}: {problem} the {stream}: {listed}; {hint}")


def topic_with_messages(where: str, present: Sequence[Topic], name: str) -> Topic:
    """Return the topic called `name`."""
    topic = topic_named(where, present, name)
    if not topic.message_count:
        raise InputError(
            f"{where}: topic {topic.name} has no messages: choose another, or record it anew"
        )
    return topic


def is_commanded(topic: Topic) -> bool:
    """Return whether a topic carries what is wanted, not measured, by its name."""
    return bool(_words(topic) & COMMANDED)


def _described(topic: Topic) -> str:
    return f"{topic.name} ({topic.type_name}{'' if topic.message_count else ', no messages'})"


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
