# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings as bags in the layout of a robot, by the package rosbags: its types and CDR."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fden_ros.configure.streams import Streams

ROBOT_STATES = """std_msgs/Header header
int16 state
int16 mode
int16 cmdnum
int16 mt_brake
int16 mt_able
int16 err
int16 warn
float32[] angle
float32[6] pose
float32[6] offset
"""


class RigBag:
    """Writes streams as a bag in the layout of a robot."""

    def __init__(
        self,
        streams: Streams,
        force_topic: str = "/ft/wrench",
        displacement_topic: str = "/arm/pose",
        kind: str = "pose",
    ) -> None:
        self.streams = streams
        self.topics = (force_topic, displacement_topic)
        self.kind = kind
        self.store = get_typestore(Stores.ROS2_HUMBLE)
        self.store.register(get_types_from_msg(ROBOT_STATES, "xarm_msgs/msg/RobotMsg"))

    def write(self, folder: Path) -> Path:
        """Write the bag."""
        s = self.streams
        rows = [(t, 0, i) for i, t in enumerate(s.force_times)]
        rows += [(t, 1, i) for i, t in enumerate(s.motion_times)]
        rows.sort()
        with Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            makers = (self.force, self.displacement)
            connections = [
                writer.add_connection(topic, make(0, 1.0).__msgtype__, typestore=self.store)
                for topic, make in zip(self.topics, makers, strict=True)
            ]
            for time, which, index in rows:
                message = makers[which](index, time)
                data = self.store.serialize_cdr(message, message.__msgtype__)
                writer.write(connections[which], round(time * 1e9) + 500_000, data)
        return folder

    def header(self, time: float, frame: str) -> Any:
        t = self.store.types
        second, rest = divmod(round(time * 1e9), 1_000_000_000)
        stamp = t["builtin_interfaces/msg/Time"](sec=second, nanosec=rest)
        return t["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)

    def force(self, index: int, time: float) -> Any:
        t = self.store.types
        vector = t["geometry_msgs/msg/Vector3"]
        values = [float(v) for v in self.streams.force[index]]
        if len(values) == 1:
            return self.joints(time, [], [0.0, values[0]])
        wrench = t["geometry_msgs/msg/Wrench"](force=vector(*values), torque=vector(0.0, 0.0, 0.0))
        return t["geometry_msgs/msg/WrenchStamped"](self.header(time, "sensor"), wrench)

    def joints(self, time: float, positions: list[float], efforts: list[float]) -> Any:
        return self.store.types["sensor_msgs/msg/JointState"](
            header=self.header(time, ""),
            name=["slide", "probe"],
            position=np.array(positions),
            velocity=np.array([]),
            effort=np.array(efforts),
        )

    def displacement(self, index: int, time: float) -> Any:
        t = self.store.types
        place = [float(v) for v in self.streams.position[index]]
        if len(place) == 1:
            # A second joint that moves, too, but not with the force.
            return self.joints(time, [0.1 * np.sin(0.7 * time), place[0]], [])
        turned = self.streams.orientation
        turn = (0.0, 0.0, 0.0, 1.0) if turned is None else turned[index]
        quaternion = t["geometry_msgs/msg/Quaternion"](*(float(v) for v in turn))
        point = t["geometry_msgs/msg/Point"](*place)
        header = self.header(time, "base")
        if self.kind == "xarm":
            pose = np.array([*(1e3 * v for v in place), 0.0, 0.0, 0.0], dtype=np.float32)
            zeros = np.zeros(6, dtype=np.float32)
            return t["xarm_msgs/msg/RobotMsg"](header, *[0] * 7, zeros, pose, zeros)
        pose = t["geometry_msgs/msg/Pose"](point, quaternion)
        return t["geometry_msgs/msg/PoseStamped"](header, pose)
