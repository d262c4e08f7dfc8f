# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A bag or a table as streams: the input of a replay, as whole vectors and with every joint."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from fden_ros.configure.streams import Streams
from fden_ros.configure.units import NOT_STATED, Unit, unit_of
from fden_ros.core.arrays import Array
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams import Quaternion, Reason
from fden_ros.errors import InputError
from fden_ros.inputs import TYPE_NAMES, Inputs
from fden_ros.message_kinds import MessageKind, NumberOrVector
from fden_ros.parameters import Parameters, check
from fden_ros.progress import progress
from fden_ros.recording.headings import Heading
from fden_ros.recording.source import BagSource, Selection, open_source
from fden_ros.recording.table import Columns, stated_columns
from fden_ros.recording.text import layout_of

#: Message types by their name in `force.message` and `displacement.message`.
MESSAGES = {
    type_name: value
    for name in ("force", "displacement")
    for value, type_name in TYPE_NAMES[name].items()
}
#: Fewer samples of a stream show nothing.
_LEAST_SAMPLES = 50


class Reading(NamedTuple):
    """A recording with its sources of force and displacement; mappings are by stream."""

    path: Path
    streams: Streams
    selection: Selection  #: by which a replay reads the same
    inputs: Mapping[str, str]  #: topic or column
    types: Mapping[str, str]  #: of messages; empty for a table
    joints: Mapping[str, str]  #: names, where there are several
    warnings: tuple[str, ...]
    units: Mapping[str, Unit]


class _Vectors(Inputs):
    """Collects whole vectors and every joint, nothing projected."""

    def __init__(self, parameters: Parameters) -> None:
        super().__init__(parameters, cast(Pipeline, self))
        self._takes_turn = True
        self.stamps: dict[str, list[int]] = {"force": [], "displacement": []}
        self.values: dict[str, list[Any]] = {"force": [], "displacement": []}
        self.turns: list[Quaternion] = []
        self.joints: dict[str, tuple[str, ...]] = {"force": (), "displacement": ()}
        self.rejected: Counter[str] = Counter()  #: by stream

    def reject(self, stream: str, reason: str) -> None:
        """Count a sample that could not be read."""
        self.rejected[stream] += 1

    def add_force(self, frame_id: str, stamp: int, value: NumberOrVector | None) -> None:
        """Add a force."""
        self._keep("force", frame_id, stamp, value)

    def add_displacement(
        self,
        frame_id: str,
        stamp: int,
        value: NumberOrVector | None,
        orientation: Quaternion | None = None,
    ) -> None:
        """Add a number or a position."""
        if self._keep("displacement", frame_id, stamp, value) and orientation is not None:
            self.turns.append(orientation)

    def _keep(self, name: str, frame_id: str, stamp: int, value: NumberOrVector | None) -> bool:
        # A stamp of 0 marks invalid data, as with CRTK.
        is_kept = self._is_own_frame(name, frame_id) and value is not None and stamp != 0
        if is_kept:
            self.stamps[name].append(stamp)
            self.values[name].append(value)
        elif frame_id == self._frames[name]:
            self.reject(name, Reason.MISSING_FIELD)
        return is_kept

    def _joint(self, name: str, kind: MessageKind, message: Any) -> Any:
        values, names = getattr(message, kind.field), tuple(message.name)
        self.joints[name] = self.joints[name] or names
        if names != self.joints[name] or not 0 < len(names) <= len(values):
            return None
        return tuple(float(value) for value in values[: len(names)])

    def stream(self, name: str) -> tuple[NDArray[np.int64], Array]:
        """Return stamps [ns] (n,) and values (n, k) of a stream."""
        values = np.array(self.values[name], dtype=float)
        return np.array(self.stamps[name], dtype=np.int64), values.reshape(len(values), -1)


def read(path: str | Path, selection: Selection | None = None) -> Reading:
    """Read a recording, or raise :class:`InputError` where its sources are not clear."""
    chosen, found = selection or Selection(), _Vectors(check({}))
    source = open_source(path, check({}), replace(chosen, from_touch=False))
    with progress(f"reading {Path(path).name}", source.total) as show:
        for done in source.feed(found, lambda log_time_ns, message: None):
            if done % 2000 == 0:
                show(done)
    inputs, warnings, types = source.inputs, [*source.warnings], {}
    if isinstance(source, BagSource):
        for name, topic in source.topics.items():
            types[name] = topic.type_name
            if count := found.rejected[name]:
                lost = f"{count} messages without stamp or value are left out"
                warnings.append(f"{topic.name}: {lost}")
        units = {n: unit_of(n, 1.0) if t in MESSAGES else NOT_STATED for n, t in types.items()}
    else:
        columns = chosen.columns or stated_columns(layout_of(path))
        units = _units_of(columns, is_found=chosen.columns is None)
    for name, stamps in found.stamps.items():
        if len(stamps) < _LEAST_SAMPLES:
            # Problems of the stamps come first: they are the likeliest cause.
            least = f"{len(stamps)} usable samples: at least {_LEAST_SAMPLES} are needed"
            raise InputError("; ".join((*warnings, f"{path}: {inputs[name]} has {least}")))
    streams, joints = _moving_joints(_streams(str(path), found), found.joints)
    return Reading(Path(path), streams, chosen, inputs, types, joints, tuple(warnings), units)


def _units_of(columns: Columns, *, is_found: bool) -> dict[str, Unit]:
    """Return the units of factors or headings; columns found by name have one."""
    units = {}
    for name, column in (("force", columns.force), ("displacement", columns.displacement)):
        factor = Heading(column.name).factor(name) if column.factor is None else column.factor
        units[name] = unit_of(name, abs(factor or 1.0)) if factor or is_found else NOT_STATED
    return units


def _streams(name: str, found: _Vectors) -> Streams:
    force_stamps, forces = found.stream("force")
    stamps, places = found.stream("displacement")
    first = int(min(force_stamps.min(), stamps.min()))
    force_times, kept = _times(force_stamps, first, np.isfinite(forces).all(axis=1))
    good, turns = np.isfinite(places).all(axis=1), np.array(found.turns).reshape(-1, 4)
    is_turn = np.abs(np.linalg.norm(turns, axis=1) - 1.0) < 0.01
    # An orientation that was never set does not count.
    has_turns = turns.shape[0] == stamps.size and bool(is_turn.mean() > 0.99)
    times, moved = _times(stamps, first, good & is_turn if has_turns else good)
    orientation = turns[moved] if has_turns else None
    return Streams(name, force_times, forces[kept], times, places[moved], orientation)


def _times(stamps: Any, first: int, good: Any) -> tuple[Array, Any]:
    """Return increasing times [s] and the indices of the samples that have them."""
    index = np.flatnonzero(good)
    different, where = np.unique(stamps[index], return_index=True)
    return 1e-9 * (different - first).astype(float), index[where]


def _moving_joints(
    streams: Streams, joints: Mapping[str, Sequence[str]]
) -> tuple[Streams, dict[str, str]]:
    """Return the streams with the joint whose motion follows the force."""
    force, moved = joints["force"], joints["displacement"]
    if max(len(force), len(moved)) < 2:
        return streams, {}
    grid = np.arange(streams.start, streams.end, 0.1)
    rises = np.diff([np.interp(grid, streams.force_times, one) for one in streams.force.T])
    moves = np.diff([np.interp(grid, streams.motion_times, one) for one in streams.position.T])
    sizes = np.outer(np.linalg.norm(rises, axis=1), np.linalg.norm(moves, axis=1))
    together = np.abs(rises @ moves.T) / np.maximum(sizes, 1e-300)
    best_force, best_moved = np.unravel_index(int(np.argmax(together)), together.shape)
    named: dict[str, str] = {}
    if len(force) > 1:
        named["force"] = force[int(best_force)]
        streams = replace(streams, force=streams.force[:, [best_force]])
    if len(moved) > 1:
        named["displacement"] = moved[int(best_moved)]
        streams = replace(streams, position=streams.position[:, [best_moved]])
    return streams, named
