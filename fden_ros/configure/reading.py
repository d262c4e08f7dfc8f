# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A bag or a table as streams: whole vectors, every joint, nothing projected."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from fden_ros.configure.session import Mask
from fden_ros.configure.streams import Streams
from fden_ros.configure.transforms import FrameTree
from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.parameters import FORCES, PLACES, check
from fden_ros.progress import progress
from fden_ros.recording.bag_files import RawMessage, Topic
from fden_ros.recording.fields import FieldPath, as_number_or_vector, decoder_of
from fden_ros.recording.reader import BagReader, decode
from fden_ros.recording.source import BagSource, Selection
from fden_ros.recording.table import TableReader, stated_columns
from fden_ros.recording.text import looks_like_a_table
from fden_ros.ros.inputs import TRANSFORMS, TYPE_NAMES, stamp_ns

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
    if frames is not None or (has_transforms and not has_way):
        return _read_transforms(Path(path), chosen, frames)
    return _read_bag(Path(path), chosen)


def _read_table(path: Path, selection: Selection) -> Reading:
    columns = selection.columns or stated_columns(path)
    selection = Selection(columns=columns, where=selection.where)
    table = TableReader(path, columns, selection.where)
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
    inputs = {stream: table.named(column) for stream, column in named.items()}
    return Reading(path, streams, selection, inputs, warnings=table.warnings)


@dataclass
class Column:
    """Collects one stream from messages of a topic.

    Parameters
    ----------
    topic : Topic
    field : str, optional
        Of the messages; None: the type says what is read.
    stream : str
        ``force`` or ``displacement``.
    is_stamped : bool
        Whether the stamps of headers count, and not the times of recording.
    """

    topic: Topic
    field: str | None
    stream: str
    is_stamped: bool = True
    frame: str = ""
    damaged: int = 0

    def __post_init__(self) -> None:
        self._decode = decoder_of(self.topic)
        self._kind = None if self.field else _KINDS.get(self.topic.type_name)
        path = self.field or (self._kind.field if self._kind is not None else "")
        self._path = FieldPath(path) if path else None
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
        stamp = log_time_ns
        if header is not None and self.is_stamped:
            stamp = stamp_ns(header.stamp)
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
        turn = self._path.orientation_beside(message) if self._path is not None else None
        if self.stream == "displacement" and turn is not None:
            self.turns.append(turn)

    def _value(self, message: Any) -> tuple[float, ...] | None:
        if self._path is None:
            values = message.effort if self.stream == "force" else message.position
            self.joints = self.joints or tuple(message.name)
            same = tuple(message.name) == self.joints and len(values) >= len(self.joints) > 0
            return tuple(float(v) for v in values[: len(self.joints)]) if same else None
        found = as_number_or_vector(self._path.of(message))
        if found is None:
            text = f"{self.topic.name}: {self._path.text} is neither a number nor a vector"
            raise InputError(text)
        return (found,) if isinstance(found, float) else found


def _read_bag(path: Path, selection: Selection) -> Reading:
    source = BagSource(path, check({}), selection)
    columns = {
        stream: Column(topic, selection.fields.get(stream), stream, selection.stamps == "header")
        for stream, topic in source.topics.items()
    }

    def take(message: RawMessage) -> None:
        for column in columns.values():
            if column.topic.name == message.topic:
                column.add(message.data, message.log_time_ns)

    _read_messages(source, {column.topic.name for column in columns.values()}, take)
    try:
        found = reading_of(path, columns, selection)
    except InputError as error:
        # What is wrong with the stamps comes first: it is the reason, most likely.
        raise InputError("; ".join((*source.stamp_problems, str(error)))) from None
    return replace(found, inputs=source.inputs, warnings=(*source.warnings, *found.warnings))


def _read_transforms(path: Path, selection: Selection, frames: str | None) -> Reading:
    """Return a recording whose displacement stands in transforms, the force turned with them."""
    any_frames = {"frames.base": "base", "frames.probe": "probe", "displacement.message": "tf"}
    source = BagSource(path, check(any_frames), selection)
    is_stamped = selection.stamps == "header"
    force = Column(source.force, selection.fields.get("force"), "force", is_stamped)
    tree = FrameTree(str(path))

    def take(message: RawMessage) -> None:
        if message.topic == force.topic.name:
            force.add(message.data, message.log_time_ns)
        else:
            tree.add(decode(message))

    _read_messages(source, {topic.name for topic in source.topics.values()}, take)
    base, probe = tree.frames_for(frames, force.frame)
    moved = tree.path(base, probe)
    if min(len(force.stamps), moved.stamps.size) < _LEAST_SAMPLES:
        raise InputError(
            f"{path}: {len(force.stamps)} forces and {moved.stamps.size} transforms of {probe} in "
            f"{base}: at least {_LEAST_SAMPLES} of each are needed"
        )
    turned = tree.path(base, force.frame or probe, np.array(force.stamps, dtype=np.int64)).turns
    values = [tuple(value) for value in turned.apply(np.array(force.values, dtype=float))]
    force.values = values
    return Reading(
        path,
        _streams(str(path), force, moved.stamps, moved.places),
        selection,
        {"force": force.topic.name, "displacement": f"{probe} in {base}"},
        {"force": force.topic.type_name, "displacement": TRANSFORMS},
        {},
        {"force": base},
        source.warnings,
        {"frames.base": base, "frames.probe": probe},
    )


def _read_messages(
    source: BagSource, topics: Collection[str], take: Callable[[RawMessage], None]
) -> None:
    with progress(f"reading {source.reader.path.name}", source.total) as show:
        for done, message in enumerate(source.messages(topics), start=1):
            take(message)
            if done % 2000 == 0:
                show(done)


def reading_of(path: Path, columns: Mapping[str, Column], selection: Selection) -> Reading:
    """Return what the topics of ``force`` and ``displacement`` have carried so far.

    Raises
    ------
    InputError
        If one of them has too few samples.
    """
    for stream, column in columns.items():
        if len(column.stamps) < _LEAST_SAMPLES:
            raise InputError(
                f"{path}: {column.topic.name} has {len(column.stamps)} usable samples of the "
                f"{stream}: at least {_LEAST_SAMPLES} are needed"
            )
    moved = columns["displacement"]
    places, turns = (np.array(values, dtype=float) for values in (moved.values, moved.turns))
    stamps = np.array(moved.stamps, dtype=np.int64)
    streams = _streams(str(path), columns["force"], stamps, places, turns)
    streams, joints = _moving_joints(streams, columns)
    left_out = tuple(
        f"{column.topic.name}: {column.damaged} messages without stamp or value are left out"
        for column in columns.values()
        if column.damaged
    )
    return Reading(
        path,
        streams,
        selection,
        {stream: column.topic.name for stream, column in columns.items()},
        {stream: column.topic.type_name for stream, column in columns.items()},
        joints,
        {stream: column.frame for stream, column in columns.items()},
        left_out,
    )


def _streams(
    name: str, force: Column, stamps: Any, places: Array, turns: Array | None = None
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
    streams: Streams, columns: Mapping[str, Column]
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
