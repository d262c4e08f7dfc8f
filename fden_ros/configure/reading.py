# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A bag or a table as streams: whole vectors, every joint, nothing projected."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fden_ros.configure.streams import Streams
from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.parameters import check
from fden_ros.progress import progress
from fden_ros.recording.fields import FieldPath, as_number_or_vector, decoder_of
from fden_ros.recording.reader import Topic
from fden_ros.recording.source import BagSource, Selection
from fden_ros.recording.table import TableReader, looks_like_a_table, stated_columns
from fden_ros.ros.messages import stamp_ns

#: Message types by the name that `force.message` and `displacement.message` have for them.
MESSAGES = {
    "geometry_msgs/msg/WrenchStamped": "wrench",
    "sensor_msgs/msg/JointState": "joint_state",
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/TransformStamped": "transform",
    "geometry_msgs/msg/PointStamped": "point",
}
_JOINTS = "sensor_msgs/msg/JointState"
#: Fewer samples of a stream say nothing.
_LEAST_SAMPLES = 50


@dataclass(frozen=True)
class Reading:
    """A recording and where in it force and displacement were.

    Parameters
    ----------
    path : Path
    streams : Streams
    selection : Selection
        With which a replay finds the same.
    inputs : dict
        Topic or column of ``force`` and ``displacement``.
    types : dict
        Message type of each; empty for a table.
    joints : dict
        Joint of each, where there are joints.
    frames : dict
        frame_id of each.
    warnings : tuple of str
    """

    path: Path
    streams: Streams
    selection: Selection
    inputs: dict[str, str]
    types: dict[str, str]
    joints: dict[str, str]
    frames: dict[str, str]
    warnings: tuple[str, ...] = ()


def read(path: str | Path, selection: Selection | None = None) -> Reading:
    """Read a recording.

    Raises
    ------
    InputError
        If it cannot be read, or it is not clear what in it is force and displacement.
    """
    chosen = selection or Selection()
    if chosen.columns is not None or looks_like_a_table(path):
        return _read_table(Path(path), chosen)
    return _read_bag(Path(path), chosen)


def _read_table(path: Path, selection: Selection) -> Reading:
    columns = selection.columns or stated_columns(path)
    selection = Selection(columns=columns, where=selection.where)
    table = TableReader(path, columns, selection.where)
    rows = np.array([(r.stamp_ns, r.force, r.displacement) for r in table.rows()], dtype=object)
    if rows.shape[0] < _LEAST_SAMPLES:
        raise InputError(f"{path} has {rows.shape[0]} rows: at least {_LEAST_SAMPLES} are needed")
    stamps = rows[:, 0].astype(np.int64)
    values = rows[:, 1:].astype(float)
    times, kept = _times(stamps, int(stamps.min()), np.isfinite(values).all(axis=1))
    streams = Streams(str(path), times, values[kept, :1], times, values[kept, 1:])
    return Reading(
        path,
        streams,
        selection,
        {
            "force": f"column {columns.force.name}",
            "displacement": f"column {columns.displacement.name}",
        },
        {},
        {},
        {},
        table.warnings,
    )


@dataclass
class Column:
    """What one topic carries, collected message by message.

    Parameters
    ----------
    topic : Topic
    field : str or None
        Field of its messages; None: the type's own vector or joints.
    what : str
        ``force`` or ``displacement``.
    """

    topic: Topic
    field: str | None
    what: str

    def __post_init__(self) -> None:
        self.stamps: list[int] = []
        self.values: list[tuple[float, ...]] = []
        self.torques: list[tuple[float, ...]] = []
        self.turns: list[tuple[float, ...]] = []
        self.joints: tuple[str, ...] = ()
        self.frame = ""
        self.damaged = 0
        self._decode = decoder_of(self.topic)
        self._path = FieldPath(self.field) if self.field else None

    def add(self, data: bytes, log_time_ns: int) -> None:
        """Take one message as CDR bytes."""
        try:
            message = self._decode(data)
        except Exception:
            # Bytes that do not fit raise errors of many kinds.
            self.damaged += 1
            return
        header = getattr(message, "header", None)
        stamp = stamp_ns(header.stamp) if header is not None else log_time_ns
        value = self._value(message)
        # A stamp of 0 stands for no measurement (CRTK) or none that is stamped.
        if stamp <= 0 or value is None:
            self.damaged += 1
            return
        if header is not None and not self.frame:
            self.frame = str(header.frame_id)
        self.stamps.append(stamp)
        self.values.append(value)

    def _value(self, message: Any) -> tuple[float, ...] | None:
        if self._path is not None:
            found = as_number_or_vector(self._path.of(message))
            if found is None:
                raise InputError(
                    f"{self.topic.name}: {self._path.text} is neither a number nor a vector"
                )
            turn = self._path.orientation_beside(message)
            if self.what == "displacement" and turn is not None:
                self.turns.append(turn)
            return (found,) if isinstance(found, float) else found
        kind = MESSAGES.get(self.topic.type_name)
        if kind == "wrench":
            force, torque = message.wrench.force, message.wrench.torque
            self.torques.append((torque.x, torque.y, torque.z))
            return force.x, force.y, force.z
        if kind == "joint_state":
            values = message.effort if self.what == "force" else message.position
            if not self.joints:
                self.joints = tuple(message.name)
            same = tuple(message.name) == self.joints and len(values) >= len(self.joints) > 0
            return tuple(float(v) for v in values[: len(self.joints)]) if same else None
        if kind == "pose":
            place, turn = message.pose.position, message.pose.orientation
        elif kind == "transform":
            place, turn = message.transform.translation, message.transform.rotation
        else:
            return message.point.x, message.point.y, message.point.z
        self.turns.append((turn.x, turn.y, turn.z, turn.w))
        return place.x, place.y, place.z


def _read_bag(path: Path, selection: Selection) -> Reading:
    source = BagSource(path, check({}), selection)
    force = Column(source.force, selection.force_field, "force")
    displacement = Column(source.displacement, selection.displacement_field, "displacement")
    columns = {"force": force, "displacement": displacement}
    names = {column.topic.name for column in columns.values()}
    with progress(f"reading {path.name}", source.total) as show:
        for done, message in enumerate(source.reader.messages(names), start=1):
            for column in columns.values():
                if column.topic.name == message.topic:
                    column.add(message.data, message.log_time_ns)
            if done % 2000 == 0:
                show(done)
    return reading_of(path, force, displacement, selection, source.inputs, source.reader.warnings)


def reading_of(
    path: Path,
    force: Column,
    displacement: Column,
    selection: Selection,
    inputs: dict[str, str],
    warnings: tuple[str, ...] = (),
) -> Reading:
    """Return what two topics have carried so far.

    Raises
    ------
    InputError
        If one of them has too few samples.
    """
    columns = {"force": force, "displacement": displacement}
    for what, column in columns.items():
        if len(column.stamps) < _LEAST_SAMPLES:
            raise InputError(
                f"{path}: {column.topic.name} has {len(column.stamps)} usable samples of the "
                f"{what}: at least {_LEAST_SAMPLES} are needed"
            )
    streams = _streams(str(path), force, displacement)
    streams, joints = _picked(streams, force.joints, displacement.joints)
    left_out = tuple(
        f"{column.topic.name}: {column.damaged} messages without stamp or value are left out"
        for column in columns.values()
        if column.damaged
    )
    return Reading(
        path,
        streams,
        selection,
        inputs,
        {what: column.topic.type_name for what, column in columns.items()},
        joints,
        {what: column.frame for what, column in columns.items()},
        (*warnings, *left_out),
    )


def _streams(name: str, force: Column, displacement: Column) -> Streams:
    force_stamps = np.array(force.stamps, dtype=np.int64)
    motion_stamps = np.array(displacement.stamps, dtype=np.int64)
    first = int(min(force_stamps.min(), motion_stamps.min()))
    forces, places = (
        np.array(force.values, dtype=float),
        np.array(displacement.values, dtype=float),
    )
    torques = np.array(force.torques, dtype=float)
    turns = np.array(displacement.turns, dtype=float)
    force_times, kept = _times(force_stamps, first, np.isfinite(forces).all(axis=1))
    good = np.isfinite(places).all(axis=1)
    whole = turns.shape[:1] == motion_stamps.shape
    if whole:
        # An orientation that was never set is none.
        whole = bool(np.mean(np.abs(np.linalg.norm(turns, axis=1) - 1.0) < 0.01) > 0.99)
    motion_times, kept_motion = _times(motion_stamps, first, good)
    return Streams(
        name,
        force_times,
        forces[kept],
        motion_times,
        places[kept_motion],
        torques[kept] if torques.shape[:1] == force_stamps.shape else None,
        turns[kept_motion] if whole else None,
    )


def _times(stamps: Any, first: int, good: Any) -> tuple[Array, Any]:
    """Return increasing times [s] and the indices of the samples that have them."""
    index = np.flatnonzero(good)
    different, where = np.unique(stamps[index], return_index=True)
    return 1e-9 * (different - first).astype(float), index[where]


def _picked(
    streams: Streams, force_joints: tuple[str, ...], joints: tuple[str, ...]
) -> tuple[Streams, dict[str, str]]:
    """Return the streams with that joint whose motion goes with the force."""
    named: dict[str, str] = {}
    force, position = streams.force, streams.position
    if len(force_joints) > 1 or len(joints) > 1:
        grid = np.arange(streams.start, streams.end, 0.1)
        rises = _steps(grid, streams.force_times, force)
        moves = _steps(grid, streams.motion_times, position)
        together = np.abs(moves.T @ rises)
        best = np.unravel_index(int(np.argmax(together)), together.shape)
        if len(force_joints) > 1:
            force = force[:, best[1] : best[1] + 1]
            named["force"] = force_joints[int(best[1])]
        if len(joints) > 1:
            position = position[:, best[0] : best[0] + 1]
            named["displacement"] = joints[int(best[0])]
    return (
        Streams(
            streams.name,
            streams.force_times,
            force,
            streams.motion_times,
            position,
            streams.torque,
            streams.orientation,
        ),
        named,
    )


def _steps(grid: Array, times: Array, values: Array) -> Array:
    """Return changes over 0.1 s, each column scaled to length 1."""
    changes = np.diff(np.stack([np.interp(grid, times, c) for c in values.T], axis=1), axis=0)
    return np.asarray(changes / np.maximum(np.linalg.norm(changes, axis=0), 1e-300))
