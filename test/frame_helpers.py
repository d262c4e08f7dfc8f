# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A shift whose probe hangs on an arm that turns: forces in the sensor's frame, and transforms.

The truth comes from scipy's rotations; nothing is shared with the core.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from fault_helpers import Shift, shift, turn_of
from geometry_msgs.msg import TransformStamped, WrenchStamped
from pipeline_helpers import FORCE
from scipy.spatial.transform import Rotation
from tf2_msgs.msg import TFMessage

from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams import NANOSECONDS
from fden_ros.recording.qos import LATCHED, RELIABLE
from fden_ros.recording.writer import BagWriter
from fden_ros.ros.messages import to_stamp
from simulation.bag import PARAMETER_FILE

FRAMES = {"frames.base": "base", "frames.probe": "tip", "displacement.message": "tf"}
#: Of the sensor in the arm's flange, and of the tip in the sensor's frame.
MOUNT = (np.array([0.01, -0.02, 0.06]), Rotation.from_euler("xyz", [0.1, -0.2, 0.7]))
TIP = (np.array([0.0, 0.03, 0.12]), Rotation.from_euler("xyz", [0.0, 0.4, 0.0]))
#: Transforms come at this rate [Hz], and at other stamps than the forces.
RATE = 100.0


class Place(NamedTuple):
    """Where a frame is in its parent, as it arrives."""

    stamp_ns: int
    parent: str
    child: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    is_static: bool = False

    def __call__(self, pipeline: Pipeline) -> None:
        pipeline.add_transform(
            self.stamp_ns,
            self.parent,
            self.child,
            self.translation,
            self.rotation,
            is_static=self.is_static,
        )


class Vector(NamedTuple):
    """A force in the sensor's frame, as it arrives."""

    stamp_ns: int
    force: tuple[float, float, float]
    frame: str = "sensor"

    def __call__(self, pipeline: Pipeline) -> None:
        pipeline.add_force_vector(self.stamp_ns, self.frame, self.force)


def place(
    stamp_ns: int, parent: str, child: str, at: np.ndarray, turn: Rotation, static: bool = False
) -> Place:
    x, y, z = map(float, at)
    a, b, c, d = map(float, turn.as_quat())
    return Place(stamp_ns, parent, child, (x, y, z), (a, b, c, d), static)


def statics() -> list[Place]:
    return [
        place(1, "flange", "sensor", *MOUNT, static=True),
        place(1, "sensor", "tip", *TIP, static=True),
        # Beside the chain.
        place(1, "flange", "camera", *TIP, static=True),
    ]


def link_of(second: float) -> tuple[np.ndarray, Rotation]:
    """Return where the first link is in the base."""
    turn = Rotation.from_euler("zyx", [0.5 * math.sin(0.5 * second), 0.2, 0.1 * second])
    return np.array([0.3, 0.1 * math.cos(0.4 * second), 0.5]), turn


def places(s: Shift, instant_ns: int, stamp_ns: int | None = None) -> list[Place]:
    """Return the two moving links at an instant, so that the tip is where the shift says."""
    stamp = instant_ns if stamp_ns is None else stamp_ns
    second = s.second(instant_ns)
    tip_turn, tip_at = turn_of(second), tip_position(instant_ns)
    sensor_turn = tip_turn * TIP[1].inv()
    sensor_at = tip_at - sensor_turn.apply(TIP[0])
    flange_turn = sensor_turn * MOUNT[1].inv()
    flange_at = sensor_at - flange_turn.apply(MOUNT[0])
    at, turn = link_of(second)
    return [
        place(stamp, "base", "link", at, turn),
        place(stamp, "link", "flange", turn.inv().apply(flange_at - at), turn.inv() * flange_turn),
    ]


def tip_position(instant_ns: int) -> np.ndarray:
    """Return where the tip is, linear between the samples of the shift."""
    stamps, positions = _path()
    return np.array(
        [np.interp(instant_ns - stamps[0], stamps - stamps[0], positions[:, k]) for k in range(3)]
    )


@functools.cache
def _path() -> tuple[np.ndarray, np.ndarray]:
    moved = [item for item in shift().items if item.stream != FORCE]
    return (
        np.array([item.stamp_ns for item in moved]),
        np.array([item.position for item in moved]),
    )


@functools.cache
def forces(s: Shift) -> tuple[Vector, ...]:
    """Return the forces in the sensor's frame."""
    vectors = []
    for item in s.items:
        if item.stream == FORCE:
            second = s.second(item.stamp_ns)
            turn = turn_of(second) * TIP[1].inv()
            x, y, z = map(float, turn.inv().apply([0.0, 0.0, item.value]))
            vectors.append(Vector(item.stamp_ns, (x, y, z)))
    return tuple(vectors)


@functools.cache
def transforms(s: Shift) -> tuple[Place, ...]:
    """Return the transforms of a shift, three milliseconds off the samples."""
    step, first = round(NANOSECONDS / RATE), s.items[0].stamp_ns - 2_000_000
    instants = range(first, s.items[-1].stamp_ns + step, step)
    return tuple(one for instant in instants for one in places(s, instant))


def arm(s: Shift, moving: Iterable[Place] | None = None) -> list[Vector | Place]:
    """Return what arrives of an arm, in order; `moving` in place of its transforms."""
    links = transforms(s) if moving is None else list(moving)
    timed = [(one.stamp_ns, k, one) for k, one in enumerate(links)]
    timed += [(one.stamp_ns, len(links), one) for one in forces(s)]
    return [*statics(), *(one for *_, one in sorted(timed, key=lambda entry: entry[:2]))]


def write_bag(folder: Path, samples: list[Vector | Place]) -> Path:
    """Write what arrives of an arm as a robot records it, with the parameters beside."""
    first = next(one.stamp_ns for one in samples if isinstance(one, Vector))
    fixed = TFMessage(transforms=[stamped(one) for one in samples if is_static(one)])
    with BagWriter(folder) as bag:
        bag.add_topic("/ft/wrench", "geometry_msgs/msg/WrenchStamped", RELIABLE)
        bag.add_topic("/tf", "tf2_msgs/msg/TFMessage", RELIABLE)
        bag.add_topic("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED)
        bag.write("/tf_static", fixed, first)
        for one in samples:
            if isinstance(one, Vector):
                message = WrenchStamped()
                message.header.stamp, message.header.frame_id = to_stamp(one.stamp_ns), one.frame
                force = message.wrench.force
                force.x, force.y, force.z = one.force
                bag.write("/ft/wrench", message, max(one.stamp_ns, first))
            elif not one.is_static:
                message = TFMessage(transforms=[stamped(one)])
                bag.write("/tf", message, max(one.stamp_ns, first))
        parameters = {"/**": {"ros__parameters": shift().parameters | FRAMES}}
        (bag.folder / PARAMETER_FILE).write_text(yaml.safe_dump(parameters))
    return folder


def is_static(one: Vector | Place) -> bool:
    return isinstance(one, Place) and one.is_static


def stamped(one: Vector | Place) -> TransformStamped:
    assert isinstance(one, Place)
    message = TransformStamped(child_frame_id=one.child)
    message.header.stamp, message.header.frame_id = to_stamp(one.stamp_ns), one.parent
    at, turn = message.transform.translation, message.transform.rotation
    at.x, at.y, at.z = one.translation
    turn.x, turn.y, turn.z, turn.w = one.rotation
    return message
