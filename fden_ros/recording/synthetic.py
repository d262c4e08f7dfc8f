# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Simulated recordings as bags, with the truth inside and the identifier's parameters beside."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String

from fden_ros.errors import InputError
from fden_ros.recording.qos import LATCHED, RELIABLE
from fden_ros.recording.reader import BagReader, decode
from fden_ros.recording.writer import BagWriter
from fden_ros.simulation.simulate import Recording, Stream

TRUTH_TOPIC = "/simulation/truth"
PARAMETER_FILE = "identifier.yaml"

_STRING = "std_msgs/msg/String"
_JOINT = "probe"
_NS_PER_S = 1_000_000_000


def write_recording(
    recording: Recording, folder: str | Path, *, overwrite: bool = False
) -> BagReader:
    """Write a simulated recording as a rosbag2 folder.

    The truth is the first message, JSON in a latched ``std_msgs/String`` on `TRUTH_TOPIC`; a
    parameter file for the identifier, ``identifier.yaml``, lies beside the bag's own files. Times
    of recording equal the header stamps.

    Parameters
    ----------
    recording
        What `fden_ros.simulation.simulate.simulate` returns.
    folder
        The bag to make.
    overwrite
        Replace a bag that is there.

    Returns
    -------
    BagReader
        A reader of the new bag.

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
        bag.add_topic(TRUTH_TOPIC, _STRING, LATCHED)
        makers = [
            _maker(stream, _FORCE if stream is recording.force else _DISPLACEMENT)
            for stream in streams
        ]
        for stream, (type_name, _) in zip(streams, makers, strict=True):
            bag.add_topic(stream.topic, type_name, RELIABLE)
        start_ns = min(int(stream.stamp_ns[0]) for stream in streams)
        bag.write(TRUTH_TOPIC, String(data=json.dumps(recording.truth)), start_ns)
        for number, index in _by_stamp(streams):
            stream = streams[number]
            bag.write(stream.topic, makers[number][1](index), int(stream.stamp_ns[index]))
        parameters = _parameter_file(recording)
        (bag.folder / PARAMETER_FILE).write_text(parameters, encoding="utf-8")
    return BagReader(folder)


def read_truth(bag: BagReader) -> dict[str, Any] | None:
    """Return the truth that a simulated bag carries; None for any other bag."""
    for topic in bag.topics:
        if topic.name == TRUTH_TOPIC and topic.type_name == _STRING:
            for message in bag.messages([TRUTH_TOPIC]):
                return _parse_truth(decode(message).data)
    return None


def _parse_truth(text: str) -> dict[str, Any]:
    try:
        truth = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{TRUTH_TOPIC} holds no JSON ({error}): make the bag anew") from None
    if not isinstance(truth, dict):
        raise InputError(f"{TRUTH_TOPIC} holds no JSON object: make the bag anew")
    return truth


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
    surface = f"# Surface topic: {recording.surface.topic}\n" if recording.surface else ""
    parameters = yaml.safe_dump({"/**": {"ros__parameters": nested}}, sort_keys=False)
    return (
        f"# Parameters of the identifier that fit this recording.\n"
        f"# Force topic: {recording.force.topic}\n"
        f"# Displacement topic: {recording.displacement.topic}\n"
        f"{surface}"
        f"{parameters}"
    )


# From a sample to a message. Every maker fills one message again and again: it is serialised
# before the next sample is asked for.


def _force_wrench(stream: Stream) -> Callable[[int], WrenchStamped]:
    message = WrenchStamped(header=Header(frame_id=stream.frame_id))
    vectors = np.outer(stream.value, stream.axis).tolist()

    def make(index: int) -> WrenchStamped:
        _stamp(message, stream, index)
        force = message.wrench.force
        force.x, force.y, force.z = vectors[index]
        return message

    return make


def _joint(stream: Stream, field: str) -> Callable[[int], JointState]:
    message = JointState(header=Header(frame_id=stream.frame_id), name=[_JOINT])
    values = stream.value.tolist()

    def make(index: int) -> JointState:
        _stamp(message, stream, index)
        setattr(message, field, [values[index]])
        return message

    return make


def _force_joint(stream: Stream) -> Callable[[int], JointState]:
    return _joint(stream, "effort")


def _displacement_joint(stream: Stream) -> Callable[[int], JointState]:
    return _joint(stream, "position")


def _positions(stream: Stream) -> list[list[float]]:
    if stream.position is None:
        raise InputError(
            f"{stream.topic} has no positions, which a {stream.message} needs: use joint_state"
        )
    positions: list[list[float]] = stream.position.tolist()
    return positions


def _point_like(stream: Stream, message: Any, part: Callable[[Any], Any]) -> Callable[[int], Any]:
    positions = _positions(stream)

    def make(index: int) -> Any:
        _stamp(message, stream, index)
        point = part(message)
        point.x, point.y, point.z = positions[index]
        return message

    return make


def _displacement_pose(stream: Stream) -> Callable[[int], PoseStamped]:
    message = PoseStamped(header=Header(frame_id=stream.frame_id))
    return _point_like(stream, message, lambda pose: pose.pose.position)


def _displacement_transform(stream: Stream) -> Callable[[int], TransformStamped]:
    message = TransformStamped(header=Header(frame_id=stream.frame_id), child_frame_id=_JOINT)
    return _point_like(stream, message, lambda transform: transform.transform.translation)


def _displacement_point(stream: Stream) -> Callable[[int], PointStamped]:
    message = PointStamped(header=Header(frame_id=stream.frame_id))
    return _point_like(stream, message, lambda point: point.point)


_Maker = tuple[str, Callable[[Stream], Callable[[int], Any]]]
_FORCE: dict[str, _Maker] = {
    "wrench": ("geometry_msgs/msg/WrenchStamped", _force_wrench),
    "joint_state": ("sensor_msgs/msg/JointState", _force_joint),
}
_DISPLACEMENT: dict[str, _Maker] = {
    "joint_state": ("sensor_msgs/msg/JointState", _displacement_joint),
    "pose": ("geometry_msgs/msg/PoseStamped", _displacement_pose),
    "transform": ("geometry_msgs/msg/TransformStamped", _displacement_transform),
    "point": ("geometry_msgs/msg/PointStamped", _displacement_point),
}


def _maker(stream: Stream, makers: dict[str, _Maker]) -> tuple[str, Callable[[int], Any]]:
    if stream.message not in makers:
        raise InputError(
            f"{stream.topic} cannot be a {stream.message}: expected one of {', '.join(makers)}"
        )
    type_name, prepare = makers[stream.message]
    return type_name, prepare(stream)


def _stamp(message: Any, stream: Stream, index: int) -> None:
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(int(stream.stamp_ns[index]), _NS_PER_S)
