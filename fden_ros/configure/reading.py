# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A bag or a table as streams: whole vectors, every joint, nothing projected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from fden_ros.configure.session import Mask
from fden_ros.configure.streams import Streams
from fden_ros.configure.transforms import FrameTree
from fden_ros.configure.units import NOT_STATED, STATED_SI, Unit, unit_of
from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.inputs import TRANSFORMS, TYPE_NAMES, stamp_ns
from fden_ros.message_kinds import FORCES, PLACES
from fden_ros.parameters import check
from fden_ros.progress import progress
from fden_ros.recording.bag_files import Topic
from fden_ros.recording.fields import FieldPath, decoder_of
from fden_ros.recording.headings import Heading
from fden_ros.recording.reader import BagReader, decode
from fden_ros.recording.source import BagSource, Selection
from fden_ros.recording.table import Column, TableReader
from fden_ros.recording.text import looks_like_a_table

#: Message types by the name that `force.message` and `displacement.message` have for them.
MESSAGES = {
    type_name: value
    for name in ("force", "displacement")
    for value, type_name in TYPE_NAMES[name].items()
} | {TRANSFORMS: "tf"}
#: By type those that have a vector or a number; of joints all count.
_KINDS = {
    kind.type_name: kind for kind in (*FORCES.values(), *PLACES.values()) if not kind.is_of_joints
}
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
    parameters : dict
        Values of the parameter file that say where force and displacement are, by dotted name.
    units : dict
        What is stated of the unit of each; the streams are in SI units then.
    """

    path: Path
    streams: Streams
    selection: Selection
    inputs: Mapping[str, str]
    types: Mapping[str, str] = field(default_factory=dict)
    joints: Mapping[str, str] = field(default_factory=dict)
    frames: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    parameters: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, Unit] = field(default_factory=lambda: dict(STATED_SI))


def read(
    path: str | Path, selection: Selection | None = None, frames: str | None = None
) -> Reading:
    """Read a recording.

    Parameters
    ----------
    path : path
    selection : Selection, optional
    frames : str, optional
        ``BASE,PROBE``: the displacement is the path of one frame in the other, by transforms; so
        it is, too, where a bag has nothing else.

    Raises
    ------
    InputError
        If it cannot be read, or it is not clear what in it is force and displacement.
    """
    chosen = selection or Selection()
    if chosen.columns is not None or looks_like_a_table(path):
        return _read_table(Path(path), chosen)
    topics = BagReader(path).topics
    carriers = [t for t in topics if t.type_name in TYPE_NAMES["displacement"].values()]
    has_way = any(t.message_count for t in carriers) or "displacement" in chosen.topics
    has_transforms = any(topic.type_name == TRANSFORMS for topic in topics)
    by_frames = frames is not None or (has_transforms and not has_way)
    return _read_bag(Path(path), chosen, frames, by_frames=by_frames)


def _read_table(path: Path, selection: Selection) -> Reading:
    table = TableReader(path, selection.columns, selection.where)
    columns = table.columns
    stamps, forces, places = table.stamps, table.force[:, None], table.displacement[:, None]
    good = np.isfinite(np.hstack([forces, places]))
    least = int(good.sum(axis=0).min())
    if least < _LEAST_SAMPLES:
        raise InputError(f"{path} has {least} rows: at least {_LEAST_SAMPLES} are needed")
    first = int(stamps.min())
    if good.all(axis=1).sum() >= _LEAST_SAMPLES:
        good[:] = good.all(axis=1, keepdims=True)
    (force_times, force), (times, motion) = (_times(stamps, first, good[:, i]) for i in (0, 1))
    streams = Streams(str(path), force_times, forces[force], times, places[motion])
    named = {"force": columns.force, "displacement": columns.displacement}
    return Reading(
        path,
        streams,
        Selection(columns=columns, where=selection.where),
        {stream: table.named(column) for stream, column in named.items()},
        warnings=table.warnings,
        units={
            stream: _unit_of_column(stream, column, is_found=selection.columns is None)
            for stream, column in named.items()
        },
    )


def _unit_of_column(stream: str, column: Column, *, is_found: bool) -> Unit:
    """Return the unit that a factor or a heading states; a column that was found has one."""
    factor = None if column.factor is None else abs(float(column.factor))
    factor = Heading(column.name).factor(stream) if factor is None else factor
    return unit_of(stream, factor or 1.0) if factor or is_found else NOT_STATED


class _Stream:
    """Collects one stream from messages of a topic.

    Parameters
    ----------
    name : str
        ``force`` or ``displacement``.
    topic : Topic
    selection : Selection
        Which may name a field of the messages; otherwise the type says what is read.
    """

    def __init__(self, name: str, topic: Topic, selection: Selection) -> None:
        self.name, self.topic = name, topic
        self._is_stamped = selection.stamps == "header"
        named = selection.fields.get(name)
        self._decode = decoder_of(topic)
        self._kind = None if named else _KINDS.get(topic.type_name)
        text = named or (self._kind.field if self._kind is not None else "")
        self._path = FieldPath(text) if text else None
        self.unit = unit_of(name, 1.0) if topic.type_name in MESSAGES else NOT_STATED
        self.frame, self.damaged = "", 0
        self.stamps: list[int] = []
        self.values: list[tuple[float, ...]] = []
        self.turns: list[tuple[float, ...]] = []
        self.torques: list[tuple[float, ...]] = []
        self.joints: tuple[str, ...] = ()

    def add(self, data: bytes, log_time_ns: int) -> None:
        """Take a message; what does not fit is counted."""
        try:
            message = self._decode(data)
            value = self._value(message)
        except InputError:
            raise
        except Exception:
            self.damaged += 1
            return
        header = getattr(message, "header", None)
        is_stamped = header is not None and self._is_stamped
        stamp = stamp_ns(header.stamp) if header is not None and is_stamped else log_time_ns
        if value is None or stamp == 0:
            # A stamp of 0 marks data that are not valid, as with CRTK.
            self.damaged += 1
            return
        self.frame = self.frame or str(getattr(header, "frame_id", ""))
        self.stamps.append(stamp)
        self.values.append(value)
        if self._kind is not None and self._kind.torque:
            torque = attrgetter(self._kind.torque)(message)
            self.torques.append((torque.x, torque.y, torque.z))
        turn = self._path.orientation(message) if self._path is not None else None
        if self.name == "displacement" and turn is not None:
            self.turns.append(turn)

    def _value(self, message: Any) -> tuple[float, ...] | None:
        if self._path is None:
            values = message.effort if self.name == "force" else message.position
            self.joints = self.joints or tuple(message.name)
            same = tuple(message.name) == self.joints and len(values) >= len(self.joints) > 0
            return tuple(float(v) for v in values[: len(self.joints)]) if same else None
        try:
            found = self._path.number_or_vector(message)
        except InputError as error:
            raise InputError(f"{self.topic.name}: {error}") from None
        return (found,) if isinstance(found, float) else found


def _read_bag(path: Path, selection: Selection, frames: str | None, *, by_frames: bool) -> Reading:
    """Return a bag; `by_frames`: its displacement stands in transforms."""
    any_frames = {"frames.base": "base", "frames.probe": "probe", "displacement.message": "tf"}
    source = BagSource(path, check(any_frames if by_frames else {}), selection)
    tree = FrameTree(str(path))
    streams = {
        name: _Stream(name, source.topics[name], selection)
        for name in (("force",) if by_frames else ("force", "displacement"))
    }
    with progress(f"reading {source.reader.path.name}", source.total) as show:
        topics = {topic.name for topic in source.topics.values()}
        for done, message in enumerate(source.messages(topics), start=1):
            for stream in streams.values():
                if stream.topic.name == message.topic:
                    stream.add(message.data, message.log_time_ns)
            if message.type_name == TRANSFORMS:
                tree.add(decode(message))
            if done % 2000 == 0:
                show(done)
    for name, stream in streams.items():
        if len(stream.stamps) < _LEAST_SAMPLES:
            # What is wrong with the stamps comes first: it is the reason, most likely.
            words = (
                f"{path}: {stream.topic.name} has {len(stream.stamps)} usable samples of the "
                f"{name}: at least {_LEAST_SAMPLES} are needed"
            )
            raise InputError("; ".join((*source.stamp_problems, words)))
    left_out = (
        f"{stream.topic.name}: {stream.damaged} messages without stamp or value are left out"
        for stream in streams.values()
        if stream.damaged
    )
    warnings = (*source.warnings, *left_out)
    if by_frames:
        return _moved_by_frames(path, streams["force"], tree, selection, frames, warnings)
    moved = streams["displacement"]
    places, turns = (np.array(values, dtype=float) for values in (moved.values, moved.turns))
    stamps = np.array(moved.stamps, dtype=np.int64)
    found, joints = _moving_joints(
        _streams(str(path), streams["force"], stamps, places, turns), streams
    )
    return Reading(
        path,
        found,
        selection,
        source.inputs,
        {name: stream.topic.type_name for name, stream in streams.items()},
        joints,
        {name: stream.frame for name, stream in streams.items()},
        warnings,
        units={name: stream.unit for name, stream in streams.items()},
    )


def _moved_by_frames(
    path: Path,
    force: _Stream,
    tree: FrameTree,
    selection: Selection,
    frames: str | None,
    warnings: tuple[str, ...],
) -> Reading:
    """Return a recording whose displacement stands in transforms, the force turned with them."""
    base, probe = tree.frames_for(frames, force.frame)
    moved = tree.path(base, probe)
    if moved.stamps.size < _LEAST_SAMPLES:
        raise InputError(
            f"{path}: {moved.stamps.size} transforms of {probe} in {base}: at least "
            f"{_LEAST_SAMPLES} are needed"
        )
    turned = tree.path(base, force.frame or probe, np.array(force.stamps, dtype=np.int64)).turns
    force.values = [tuple(value) for value in turned.apply(np.array(force.values, dtype=float))]
    return Reading(
        path,
        _streams(str(path), force, moved.stamps, moved.places),
        selection,
        {"force": force.topic.name, "displacement": f"{probe} in {base}"},
        {"force": force.topic.type_name, "displacement": TRANSFORMS},
        {},
        {"force": base},
        warnings,
        {"frames.base": base, "frames.probe": probe},
        {"force": force.unit, "displacement": unit_of("displacement", 1.0)},
    )


def _streams(
    name: str, force: _Stream, stamps: Any, places: Array, turns: Array | None = None
) -> Streams:
    force_stamps = np.array(force.stamps, dtype=np.int64)
    first = int(min(force_stamps.min(), stamps.min()))
    forces, torques = (np.array(v, dtype=float) for v in (force.values, force.torques))
    force_times, kept = _times(force_stamps, first, np.isfinite(forces).all(axis=1))
    good: Mask = np.asarray(np.isfinite(places).all(axis=1))
    is_turn = np.zeros(stamps.size, dtype=bool)
    if turns is not None and turns.shape[:1] == stamps.shape:
        is_turn = np.abs(np.linalg.norm(turns, axis=1) - 1.0) < 0.01
    # An orientation that was never set is none.
    has_turns = turns is not None and bool(np.mean(is_turn) > 0.99)
    times, kept_motion = _times(stamps, first, good & is_turn if has_turns else good)
    return Streams(
        name,
        force_times,
        forces[kept],
        times,
        places[kept_motion],
        torques[kept] if torques.shape[:1] == force_stamps.shape else None,
        turns[kept_motion] if has_turns and turns is not None else None,
    )


def _times(stamps: Any, first: int, good: Mask) -> tuple[Array, Any]:
    """Return increasing times [s] and the indices of the samples that have them."""
    index = np.flatnonzero(good)
    different, where = np.unique(stamps[index], return_index=True)
    return 1e-9 * (different - first).astype(float), index[where]


def _moving_joints(
    streams: Streams, columns: Mapping[str, _Stream]
) -> tuple[Streams, dict[str, str]]:
    """Return the streams with that joint whose motion goes with the force."""
    force, moved = columns["force"].joints, columns["displacement"].joints
    if max(len(force), len(moved)) < 2:
        return streams, {}
    grid = np.arange(streams.start, streams.end, 0.1)
    rises = _steps(grid, streams.force_times, streams.force)
    moves = _steps(grid, streams.motion_times, streams.position)
    together = np.abs(moves.T @ rises)
    best_moved, best_force = np.unravel_index(int(np.argmax(together)), together.shape)
    named: dict[str, str] = {}
    if len(force) > 1:
        named["force"] = force[int(best_force)]
        streams = replace(streams, force=streams.force[:, [best_force]])
    if len(moved) > 1:
        named["displacement"] = moved[int(best_moved)]
        streams = replace(streams, position=streams.position[:, [best_moved]])
    return streams, named


def _steps(grid: Array, times: Array, values: Array) -> Array:
    """Return changes over 0.1 s, each column scaled to length 1."""
    changes = np.diff(np.stack([np.interp(grid, times, c) for c in values.T], axis=1), axis=0)
    return np.asarray(changes / np.maximum(np.linalg.norm(changes, axis=0), 1e-300))
