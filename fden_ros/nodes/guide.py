# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Listening to a robot of which nothing is known, saying what to do next, and waiting for it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from fden_ros.configure.reading import Column, Reading, reading_of
from fden_ros.configure.robots import Robot, robot_selection
from fden_ros.configure.survey import Survey, steps_for
from fden_ros.errors import InputError
from fden_ros.recording.bag_files import Topic
from fden_ros.recording.message_types import message_class
from fden_ros.recording.reader import topic_named
from fden_ros.recording.source import Selection
from fden_ros.recording.topics import find_topic
from fden_ros.ros.plain_node import plain_node, spin_for

#: Best effort hears every publisher; the queue holds what comes while a survey is made.
_QOS = QoSProfile(depth=20000, reliability=ReliabilityPolicy.BEST_EFFORT)
#: How long topics are waited for, and between two looks at what has come [s].
_TOPICS_WITHIN = 20.0
_LOOK_EVERY = 2.0
#: Surveys take no more than this part of the time.
_BUSY_PART = 0.5

Look = Callable[[Reading], Survey]


def listen(
    selection: Selection,
    robot: Robot | None,
    look: Look,
    say: Callable[[str], object],
    patience: float,
) -> tuple[Reading, Survey]:
    """Go through the steps with whoever moves the robot; return what has come and is found.

    Parameters
    ----------
    selection : Selection
        Topics and fields, where they are named.
    robot : Robot, optional
        Whose topics they are.
    look : callable
        Makes the survey.
    say : callable
        Called with what to do next, and with what is done.
    patience : float
        A step is given up after this time [s]; Ctrl-C ends all of them.

    Raises
    ------
    InputError
        If there are no topics, or nothing usable comes.
    """
    with plain_node("fden_configure") as (node, executor):
        return _Guide(node, executor, selection, robot, look, say, patience).run()


@dataclass
class _Guide:
    _node: Node
    _executor: SingleThreadedExecutor
    _selection: Selection
    _robot: Robot | None
    _look: Look
    _say: Callable[[str], object]
    _patience: float
    _columns: dict[str, Column] = field(default_factory=dict)

    def run(self) -> tuple[Reading, Survey]:
        topics = self._find_topics()
        for stream, topic in topics.items():
            field = self._selection.fields.get(stream)
            is_stamped = self._selection.stamps == "header"
            self._columns[stream] = Column(topic, field, stream, is_stamped)
            self._say(f"{stream} from {topic.name} ({topic.type_name.replace('/msg/', '/')})")
        for topic in {topic.name: topic for topic in topics.values()}.values():
            self._subscribe(topic)
        try:
            return self._go_through()
        except KeyboardInterrupt:
            reading = self._reading()
            return reading, self._look(reading)

    def _subscribe(self, topic: Topic) -> None:
        columns = [column for column in self._columns.values() if column.topic.name == topic.name]

        def take(data: Any) -> None:
            now = time.time_ns()
            for column in columns:
                column.add(data, now)

        kind = message_class(topic.type_name)
        self._node.create_subscription(kind, topic.name, take, _QOS, raw=True)

    def _go_through(self) -> tuple[Reading, Survey]:
        reading, found = self._first_look()
        for step in steps_for(reading.streams.orientation is not None):
            if step.is_done(found):
                continue
            self._say(f"NOW: {step.says}")
            end = time.monotonic() + self._patience
            while not step.is_done(found) and time.monotonic() < end:
                began = time.monotonic()
                reading = self._reading()
                found = self._look(reading)
                took = time.monotonic() - began
                spin_for(self._executor, max(_LOOK_EVERY, took * (1.0 / _BUSY_PART - 1.0)))
            answer = "done" if step.is_done(found) else "given up"
            self._say(f"{answer}: {step.name}")
        reading = self._reading()
        return reading, self._look(reading)

    def _first_look(self) -> tuple[Reading, Survey]:
        end = time.monotonic() + self._patience
        while True:
            spin_for(self._executor, _LOOK_EVERY)
            try:
                reading = self._reading()
                return reading, self._look(reading)
            except InputError:
                if time.monotonic() > end:
                    raise

    def _reading(self) -> Reading:
        return reading_of(Path("live"), self._columns, self._selection)

    # Topics

    def _find_topics(self) -> dict[str, Topic]:
        self._say("waiting for topics")
        end = time.monotonic() + _TOPICS_WITHIN
        while True:
            spin_for(self._executor, 0.2)
            try:
                return self._chosen(self._present())
            except InputError:
                if time.monotonic() > end:
                    raise

    def _present(self) -> list[Topic]:
        return [
            Topic(name, types[0], self._node.count_publishers(name))
            for name, types in self._node.get_topic_names_and_types()
            if len(types) == 1
        ]

    def _chosen(self, present: list[Topic]) -> dict[str, Topic]:
        selection = self._selection
        if self._robot is not None:
            selection = robot_selection(self._robot, "the robot", present, selection)
            self._selection = selection
        chosen: dict[str, Topic] = {}
        for stream in ("force", "displacement"):
            name = selection.topics.get(stream)
            if name is not None and stream in selection.fields:
                chosen[stream] = topic_named("the robot", present, name)
            else:
                chosen[stream] = find_topic("the robot", present, name, stream, chosen.values())
        return chosen
