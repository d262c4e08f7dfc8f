# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings of one rig cut into air and contact, once it is known which way the probe presses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fden_ros.configure.finding import Seconds
from fden_ros.configure.signs import Course, Mask, Signs, find_signs
from fden_ros.configure.statistics import fit, noise_of
from fden_ros.configure.streams import Streams
from fden_ros.core.arrays import Array

#: Chunks [s] average the noise; each holds at least 4 samples of force and 3 of position.
_CHUNK = 0.05
#: The tool turns above this rate [rad/s].
_TURNING = 0.02
#: A change counts from 6 standard deviations of a chunk, and 0.3 % of the range of the force.
_DEVIATIONS = 6.0
_SHARE = 0.003
#: Medians over this time [s] show the level in the air, which drifts by 0.2 % of the range a
#: second at most.
_WINDOW = 0.6
_DRIFT_SHARE = 0.002
#: The force in the air is followed by medians over this time [s].
_FOLLOW = 2.0
#: Force and motion are compared by their changes over this part of a recording.
_CHANGES = 100
#: In the air the probe travels by this share of its way in contact, at least.
_TRAVEL = 0.2
#: The force in the air follows the motion by less than this share of that in contact.
_FLAT = 0.15
#: Contact that is lost for less than this [s] goes on, as in an oscillation that lifts off.
_SAME = 0.5
#: The variance of a median over that of a mean, of normal noise.
_MEDIAN_VARIANCE = 1.57
#: A contact has at least this many chunks.
_LEAST = 4
#: A recording whose largest change of force is below this many deviations holds no contact.
_LEAST_CHANGE = 12.0


@dataclass(frozen=True)
class Contact:
    """One stretch in contact, as chunks from `first` to before `last`, and in time [s]."""

    first: int
    last: int
    start: float
    end: float


@dataclass(frozen=True)
class Lines:
    """Directions in which force and motion go together, and which end of them is the tissue's.

    Parameters
    ----------
    grows, into : Array
        Unit vectors of the force (k,) and the displacement (j,); into the tissue where `signs`
        are stated.
    signs : Signs
    """

    grows: Array
    into: Array
    signs: Signs


@dataclass(frozen=True)
class Session:
    """A recording in chunks, the tool's weight taken off.

    Parameters
    ----------
    streams : Streams
    edges, times : Array
        Of the chunks [s], (n + 1,) and (n,).
    force, position : Array
        Means of the chunks (n, k), (n, j).
    baseline : Array
        Force in the air, in between interpolated (n, k).
    air, turning : Mask
        Chunks in the air, and those in which the tool turns (n,).
    contacts : tuple of Contact
    leaves : bool
        Whether the force in the air is seen.
    lines : Lines or None
        Of force and motion; None where nothing was touched in any recording of the rig.
    force_noise, motion_noise : Array
        Standard deviation per sample of each component (k,), (j,).
    unloaded : Array
        Force at its own stamps, the tool's weight taken off (m, k).
    """

    streams: Streams
    edges: Array
    times: Array
    force: Array
    position: Array
    baseline: Array
    air: Mask
    turning: Mask
    contacts: tuple[Contact, ...]
    leaves: bool
    force_noise: Array
    motion_noise: Array
    unloaded: Array
    lines: Lines | None

    @property
    def net(self) -> Array:
        """Force of the contact (n, k)."""
        return self.force - self.baseline

    def seconds(self, contacts: tuple[Contact, ...] | None = None) -> Seconds:
        """Return the times of contacts since the first stamp."""
        chosen = self.contacts if contacts is None else contacts
        first = self.streams.start
        return tuple((c.start - first, c.end - first) for c in chosen)

    def air_seconds(self) -> Seconds:
        """Return the stretches in the air since the first stamp."""
        first = self.streams.start
        return tuple(
            (float(self.edges[a] - first), float(self.edges[b] - first))
            for a, b in runs(self.air)
            if b - a >= _LEAST
        )


def make_sessions(
    recordings: Sequence[Streams], loads: Sequence[Array | None] | None = None
) -> tuple[Session, ...]:
    """Cut recordings of one rig into air and contact.

    Parameters
    ----------
    recordings : sequence of Streams
    loads : sequence of Array, optional
        Force of the tool's weight at the force's stamps (n, k), to be taken off each.
    """
    given = loads or [None] * len(recordings)
    chunks = [_chunks(one, load) for one, load in zip(recordings, given, strict=True)]
    pressed = [one for one in chunks if one.is_pressed]
    if not pressed:
        return tuple(_untouched(one) for one in chunks)
    grows = _force_line(pressed)
    into = _motion_line(pressed, grows)
    signs = find_signs(
        [Course(c.times, c.position @ into, c.force @ grows, ~c.turning) for c in pressed]
    )
    lines = Lines(signs.force * grows, signs.way * into, signs)
    return tuple(_cut(one, lines) if one.is_pressed else _untouched(one) for one in chunks)


@dataclass(frozen=True)
class _Chunks:
    """A recording in chunks, before anything is known of it."""

    streams: Streams
    edges: Array
    times: Array
    force: Array
    position: Array
    turning: Mask
    force_noise: Array  #: per sample (k,)
    chunk_noise: Array  #: (k,)
    unloaded: Array

    @property
    def spread(self) -> float:
        """Range of the force along its line, in deviations of a chunk."""
        still = self.force[~self.turning]
        if len(still) < 2 * _LEAST:
            return 0.0
        centred = still - np.median(still, axis=0)
        direction = np.linalg.svd(centred, full_matrices=False)[2][0]
        noise = float(np.linalg.norm(self.chunk_noise * direction))
        return float(np.ptp(centred @ direction)) / max(noise, 1e-300)

    @property
    def is_pressed(self) -> bool:
        """Whether the force changes by more than its noise."""
        return self.spread >= _LEAST_CHANGE


def _chunks(streams: Streams, load: Array | None) -> _Chunks:
    raw = streams.force if load is None else streams.force - load
    edges = _edges(streams)
    force = _means(streams.force_times, raw, edges)
    position = _means(streams.motion_times, streams.position, edges)
    good = np.isfinite(force[:, 0]) & np.isfinite(position[:, 0])
    times = 0.5 * (edges[1:] + edges[:-1])
    noise = noise_of(streams.force_times, streams.force)
    count = float(np.median(np.diff(edges))) * streams.force_times.size
    count = max(count / max(streams.end - streams.start, 1e-9), 1.0)
    return _Chunks(
        streams,
        edges,
        times,
        _filled(times, force, good),
        _filled(times, position, good),
        _turning(streams, edges),
        noise,
        noise / np.sqrt(count),
        raw,
    )


def _force_line(pressed: Sequence[_Chunks]) -> Array:
    """Return the line along which the force changes most."""
    still = [one.force[~one.turning] for one in pressed]
    centred = np.concatenate([force - np.median(force, axis=0) for force in still])
    return np.asarray(np.linalg.svd(centred, full_matrices=False)[2][0])


def _motion_line(pressed: Sequence[_Chunks], grows: Array) -> Array:
    """Return the line of the motion that goes with the force, where that grows along `grows`."""
    total = np.zeros(pressed[0].position.shape[1])
    for one in pressed:
        # Over a short time: in a hold the force relaxes without any motion.
        lag = max(2, one.times.size // _CHANGES)
        still = ~(one.turning[lag:] | one.turning[:-lag])
        rises = (one.force[lag:] - one.force[:-lag]) @ grows
        total += (one.position[lag:] - one.position[:-lag])[still].T @ rises[still]
    return np.asarray(total / max(float(np.linalg.norm(total)), 1e-300))


def _untouched(chunks: _Chunks) -> Session:
    still = ~chunks.turning
    leaves = int(still.sum()) >= 2 * _LEAST
    air = still if leaves else np.zeros_like(still)
    return _session(chunks, air, _followed(chunks.times, chunks.force, air), (), leaves, None)


def _cut(chunks: _Chunks, lines: Lines) -> Session:
    """Return the session: contact is where the force lies above that in the air."""
    still = ~chunks.turning
    push = chunks.force @ lines.grows
    limit = _DEVIATIONS * float(np.linalg.norm(chunks.chunk_noise * lines.grows))
    limit = max(limit, _SHARE * float(np.ptp(push[still])))
    height = push - _lowest(chunks.times, push, still, limit)
    air: Mask = still & (np.abs(height) < limit)
    leaves = lines.signs.is_stated and _is_air(
        chunks.times, height, chunks.position @ lines.into, air, still
    )
    if not leaves:
        whole = Contact(0, push.size, float(chunks.edges[0]), float(chunks.edges[-1]))
        middle = np.broadcast_to(np.median(chunks.force, axis=0), chunks.force.shape).copy()
        return _session(chunks, air & False, middle, (whole,), False, lines)
    baseline = _followed(chunks.times, chunks.force, air)
    return _session(chunks, air, baseline, _contacts(height > limit, chunks.edges), True, lines)


def _session(
    chunks: _Chunks,
    air: Mask,
    baseline: Array,
    contacts: tuple[Contact, ...],
    leaves: bool,
    lines: Lines | None,
) -> Session:
    return Session(
        chunks.streams,
        chunks.edges,
        chunks.times,
        chunks.force,
        chunks.position,
        baseline,
        air,
        chunks.turning,
        contacts,
        leaves,
        chunks.force_noise,
        noise_of(chunks.streams.motion_times, chunks.streams.position),
        chunks.unloaded,
        lines,
    )


def _contacts(pressed: Mask, edges: Array) -> tuple[Contact, ...]:
    joined: list[list[int]] = []
    for a, b in runs(pressed):
        if joined and float(edges[a] - edges[joined[-1][1]]) < _SAME:
            joined[-1][1] = b
        elif b - a >= _LEAST:
            joined.append([a, b])
    return tuple(Contact(a, b, float(edges[a]), float(edges[b])) for a, b in joined)


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return start and stop of every run of True."""
    padded = np.concatenate([[False], mask, [False]]).astype(np.int8)
    change = np.diff(padded)
    return list(
        zip(
            np.flatnonzero(change == 1).tolist(),
            np.flatnonzero(change == -1).tolist(),
            strict=True,
        )
    )


def _edges(streams: Streams) -> Array:
    length = streams.end - streams.start
    rates = [
        (times.size - 1) / max(float(times[-1] - times[0]), 1e-9)
        for times in (streams.force_times, streams.motion_times)
    ]
    width = max(_CHUNK, 4.0 / rates[0], 3.0 / rates[1])
    count = max(int(length / width), 1)
    return np.asarray(streams.start + width * np.arange(count + 1), dtype=np.float64)


def _means(times: Array, values: Array, edges: Array) -> Array:
    index = np.searchsorted(times, edges)
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    counts = np.diff(index)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((sums[index[1:]] - sums[index[:-1]]) / counts)


def _filled(times: Array, values: Array, good: Mask) -> Array:
    if good.all() or not good.any():
        return values
    return np.stack([np.interp(times, times[good], c[good]) for c in values.T], axis=1)


def _turning(streams: Streams, edges: Array) -> Mask:
    turns = streams.rotation_at(edges)
    if turns is None:
        return np.zeros(edges.size - 1, dtype=bool)
    steps = np.einsum("nij,nij->n", turns[1:], turns[:-1])
    angles = np.arccos(np.clip(0.5 * (steps - 1.0), -1.0, 1.0))
    return np.asarray(angles / np.diff(edges) > _TURNING)


def _lowest(times: Array, push: Array, still: Mask, limit: float) -> Array:
    """Return the level that the force never falls below, but for a drift (n,).

    A contact only pushes: the level goes along the lower hull of the force's medians, from the
    lowest of them to both sides, as far as it is no steeper than a drift.
    """
    width = max(_LEAST + 1, math.ceil(_WINDOW / float(times[1] - times[0])))
    inside = np.flatnonzero(still)
    blocks = np.array_split(inside, max(inside.size // width, 1))
    knots = np.array([times[block].mean() for block in blocks])
    levels = np.array([np.median(push[block]) for block in blocks])
    hull: list[int] = []
    for new in range(knots.size):
        while len(hull) > 1 and _is_above(knots, levels, hull[-2], hull[-1], new):
            hull.pop()
        hull.append(new)
    steepest = _DRIFT_SHARE * float(np.ptp(push[still]))
    middle = int(np.argmin(levels[hull]))
    kept = [hull[middle]]
    for some in (hull[middle + 1 :], hull[:middle][::-1]):
        last = hull[middle]
        for one in some:
            rise = float(levels[one] - levels[last])
            if rise > limit + steepest * abs(float(knots[one] - knots[last])):
                break
            kept.append(one)
            last = one
    kept.sort()
    return np.interp(times, knots[kept], levels[kept])


def _is_above(x: Array, y: Array, first: int, middle: int, last: int) -> bool:
    """Whether a point lies on or above the line between its neighbours."""
    return bool(
        (y[middle] - y[first]) * (x[last] - x[first])
        >= (y[last] - y[first]) * (x[middle] - x[first])
    )


def _followed(times: Array, values: Array, air: Mask) -> Array:
    """Return the trend of the values in the air, and medians over 2 s about it (n, k)."""
    if air.sum() < _LEAST:
        return np.broadcast_to(np.median(values, axis=0), values.shape).copy()
    since = (times - times[0]) / max(float(times[-1] - times[0]), 1e-9)
    design = np.stack([np.ones_like(since), since], axis=1)
    seen = float(np.ptp(since[air]))
    trend = np.zeros_like(values)
    if seen > 0.3:
        trend = design @ np.linalg.lstsq(design[air], values[air], rcond=None)[0]
    return trend + _medians(times, values - trend, air)


def _medians(times: Array, values: Array, air: Mask) -> Array:
    """Return medians over 2 s of the values in the air, linear in between (n, k)."""
    bins = np.floor((times[air] - times[0]) / _FOLLOW).astype(int)
    inside = values[air]
    knots, levels, noises = [], [], []
    for one in np.unique(bins):
        of_bin = bins == one
        if of_bin.sum() < 3:
            continue
        knots.append(float(times[air][of_bin].mean()))
        levels.append(np.median(inside[of_bin], axis=0))
        noises.append(_MEDIAN_VARIANCE * inside[of_bin].var(axis=0, ddof=1) / of_bin.sum())
    if not knots:
        return np.broadcast_to(np.median(inside, axis=0), values.shape).copy()
    table = np.array(levels)
    if len(knots) > 2:
        # Medians that scatter no more than by noise follow nothing: their mean is nearer.
        middle = table.mean(axis=0)
        moved = table.var(axis=0, ddof=1)
        share = np.clip(1.0 - np.mean(noises, axis=0) / np.maximum(moved, 1e-300), 0.0, 1.0)
        table = middle + share * (table - middle)
    return np.stack([np.interp(times, knots, column) for column in table.T], axis=1)


def _is_air(times: Array, height: Array, way: Array, air: Mask, still: Mask) -> bool:
    """Whether the probe travels in what is taken for air, and the force does not follow it."""
    pressed = still & ~air
    if min(int(air.sum()), int(pressed.sum())) < _LEAST:
        return bool(air.sum() >= _LEAST)
    longest = max((float(np.ptp(way[a:b])) for a, b in runs(air) if b - a >= _LEAST), default=0.0)
    if longest < _TRAVEL * float(np.ptp(way[pressed])):
        return False
    design = np.stack([way, np.ones_like(times), times - times[0]], axis=1)
    free = fit(design[air], height[air])
    change, steps = np.diff(height), np.diff(way)
    contact = still[1:] & still[:-1] & (pressed[1:] | pressed[:-1])
    in_contact = float(steps[contact] @ change[contact]) / float(steps[contact] @ steps[contact])
    slope, sd = float(free.solution[0]), math.sqrt(float(free.covariance[0, 0]))
    return slope + 2.0 * sd < _FLAT * in_contact
