# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Simulated recordings as bags, with the truth inside and the identifier's parameters."""

from __future__ import annotations

import json
from collections.abc import Callable
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
from simulation.simulate import Recording, Stream

PARAMETER_FILE = "identifier.yaml"

_JOINT = "probe"
_NS_PER_S = 1_000_000_000
# By the message of a stream: its type, and the field of the sample.
_FORCE = {
    "wrench": ("geometry_msgs/msg/WrenchStamped", "wrench.force"),
    "joint_state": ("sensor_msgs/msg/JointState", "effort"),
}
_DISPLACEMENT = {
    "joint_state": ("sensor_msgs/msg/JointState", "position"),
    "pose": ("geometry_msgs/msg/PoseStamped", "pose.position"),
    "transform": ("geometry_msgs/msg/TransformStamped", "transform.translation"),
    "point": ("geometry_msgs/msg/PointStamped", "point"),
}


def write_recording(
    recording: Recording, folder: str | Path, *, overwrite: bool = False
) -> BagReader:
    """Write a simulated recording as a rosbag2 folder, and return a reader of it.

    The truth is the first message, JSON in a latched ``std_msgs/String`` on `TRUTH_TOPIC`; a
    parameter file for the identifier, ``identifier.yaml``, lies in the folder. Times of recording
    equal the header stamps.

    Raises
    ------
    InputError
        When the folder cannot be made.
    """
    streams = recording.streams
    for stream in streams:
        if stream.stamp_ns.size == 0:
            raise InputError(f"the recording has no sample for {stream.topic}: make it longer")
    with BagWriter(folder, overwrite=overwrite) as bag:
        bag.add_topic(TRUTH_TOPIC, TRUTH_TYPE, LATCHED)
        makers = []
        for stream in streams:
            type_name, field = _message_of(stream, is_force=stream is recording.force)
            bag.add_topic(stream.topic, type_name, RELIABLE)
            makers.append(_maker(stream, type_name, field))
        start_ns = min(int(stream.stamp_ns[0]) for stream in streams)
        bag.write(TRUTH_TOPIC, String(data=json.dumps(recording.truth)), start_ns)
        for number, index in _by_stamp(streams):
            stream = streams[number]
            bag.write(stream.topic, makers[number](index), int(stream.stamp_ns[index]))
        parameters = _parameter_file(recording)
        (bag.folder / PARAMETER_FILE).write_text(parameters, encoding="utf-8")
    return BagReader(folder)


def _by_stamp(streams: tuple[Stream, ...]) -> list[tuple[int, int]]:
    """Return (stream, index) of all samples by stamp; of equal stamps the first stream's first."""
    stamps = np.concatenate([stream.stamp_ns for stream in streams])
    numbers = np.repeat(np.arange(len(streams)), [stream.stamp_ns.size for stream in streams])
    indices = np.concatenate([np.arange(stream.stamp_ns.size) for stream in streams])
    order = np.argsort(stamps, kind="stable")
    return list(zip(numbers[order].tolist(), indices[order].tolist(), strict=True))


def _parameter_file(recording: Recording) -> str:
    nested: dict[str, Any] = {}
    for name, value in recording.truth["identifier_parameters"].items():
        *groups, leaf = name.split(".")
        group = nested
        for key in groups:
            group = group.setdefault(key, {})
        group[leaf] = value
    parameters = yaml.safe_dump({"/**": {"ros__parameters": nested}}, sort_keys=False)
    return (
        f"# Parameters of the identifier that fit this recording.\n"
        f"# Force topic: {recording.force.topic}\n"
        f"# Displacement topic: {recording.displacement.topic}\n"
        f"{parameters}"
    )


def _message_of(stream: Stream, *, is_force: bool) -> tuple[str, str]:
    known = _FORCE if is_force else _DISPLACEMENT
    if stream.message not in known:
        raise InputError(
            f"{stream.topic} cannot be a {stream.message}: expected one of {', '.join(known)}"
        )
    return known[stream.message]


def _maker(stream: Stream, type_name: str, field: str) -> Callable[[int], Any]:
    """Return the function that makes the message of a sample.

    It reuses one message, so that must be serialised before the next call.
    """
    message = message_class(type_name)()
    message.header.frame_id = stream.frame_id
    if stream.message == "transform":
        message.child_frame_id = _JOINT
    *above, last = field.split(".")
    holder = message
    for name in above:
        holder = getattr(holder, name)
    if stream.message == "joint_state":
        message.name = [_JOINT]
        values = stream.value.tolist()
    else:
        values = _vectors(stream)
        vector = getattr(holder, last)

    def make(index: int) -> Any:
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(int(stream.stamp_ns[index]), _NS_PER_S)
        if stream.message == "joint_state":
            setattr(message, field, [values[index]])
        else:
            vector.x, vector.y, vector.z = values[index]
        return message

    return make


def _vectors(stream: Stream) -> list[list[float]]:
    if stream.message == "wrench":
        return np.outer(stream.value, stream.axis).tolist()
    if stream.position is None:
        raise InputError(
            f"{stream.topic} has no positions, which a {stream.message} needs: use joint_state"
        )
    return stream.position.tolist()
