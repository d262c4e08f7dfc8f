# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Simulated recordings as bags, with the truth inside and the identifier's parameters."""

from __future__ import annotations

import functools
import heapq
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from std_msgs.msg import String

from fden_ros.errors import InputError
from fden_ros.recording.message_types import message_class
from fden_ros.recording.qos import LATCHED, RELIABLE
from fden_ros.recording.reader import TRUTH_TOPIC, TRUTH_TYPE, BagReader
from fden_ros.recording.writer import BagWriter
from simulation.scenario import DisplacementSensor
from simulation.simulate import Recording, Stream

PARAMETER_FILE = "identifier.yaml"

_JOINT = "probe"
_NS_PER_S = 1_000_000_000
# By the message of a stream: its type, and where the sample is in it.
_FORCE = ("geometry_msgs/msg/WrenchStamped", lambda message: message.wrench.force)
_DISPLACEMENT: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "joint_state": ("sensor_msgs/msg/JointState", lambda message: message),
    "pose": ("geometry_msgs/msg/PoseStamped", lambda message: message.pose.position),
    "point": ("geometry_msgs/msg/PointStamped", lambda message: message.point),
}


def write_recording(
    recording: Recording, folder: str | Path, *, overwrite: bool = False
) -> BagReader:
    """Write a simulated recording as a rosbag2 folder, and return a reader of it.

    The truth is the first message, JSON in a latched ``std_msgs/String`` on `TRUTH_TOPIC`; a
    parameter file for the identifier, ``identifier.yaml``, lies in the folder. Times of recording
    equal the header stamps.
    """
    streams = recording.streams
    for stream in streams:
        if stream.stamp_ns.size == 0:
            words = f"the recording has no sample for {stream.sensor.topic}: make it longer"
            raise InputError(words)
    with BagWriter(folder, overwrite=overwrite) as bag:
        bag.add_topic(TRUTH_TOPIC, TRUTH_TYPE, LATCHED)
        samples = [_samples(bag, stream) for stream in streams]
        start_ns = min(int(stream.stamp_ns[0]) for stream in streams)
        bag.write(TRUTH_TOPIC, String(data=json.dumps(recording.truth)), start_ns)
        # Of equal stamps the force is first.
        for stamp_ns, topic, message in heapq.merge(*samples, key=lambda sample: sample[0]):
            bag.write(topic, message(), stamp_ns)
        own = {"/**": {"ros__parameters": recording.truth["identifier_parameters"]}}
        topics = "".join(f"# Topic: {stream.sensor.topic}\n" for stream in streams)
        words = f"# Parameters of the identifier that fit this recording.\n{topics}"
        text = words + yaml.safe_dump(own, sort_keys=False)
        (bag.folder / PARAMETER_FILE).write_text(text, encoding="utf-8")
    return BagReader(folder)


def _samples(bag: BagWriter, stream: Stream) -> Iterator[tuple[int, str, Callable[[], Any]]]:
    """Add a stream's topic; return stamp, topic and what makes the message of each sample.

    One message is reused, so that must be serialised before the next call.
    """
    sensor, positions = stream.sensor, stream.position
    type_name, vector_of = _FORCE
    if isinstance(sensor, DisplacementSensor):
        type_name, vector_of = _DISPLACEMENT[sensor.message]
    bag.add_topic(sensor.topic, type_name, RELIABLE)
    message = message_class(type_name)()
    message.header.frame_id = sensor.frame_id
    vector = vector_of(message)
    if positions is None:
        positions = np.outer(stream.value, sensor.axis)

    def make(stamp_ns: int, value: float, position: Sequence[float]) -> Any:
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(stamp_ns, _NS_PER_S)
        if vector is message:
            message.name, message.position = [_JOINT], [value]
        else:
            vector.x, vector.y, vector.z = position
        return message

    columns = (stream.stamp_ns.tolist(), stream.value.tolist(), positions.tolist())
    return (
        (sample[0], sensor.topic, functools.partial(make, *sample))
        for sample in zip(*columns, strict=True)
    )
