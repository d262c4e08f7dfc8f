# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings of one rig divided into air and contact, once the direction of presses is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fden_ros.configure.signs import Course, Mask, Signs, find_signs
from fden_ros.configure.streams import Streams, apart_from_neighbours, noise_of
from fden_ros.core.arrays import Array
from fden_ros.experiments.regression import linear

#: Chunks [s] average the noise; each holds at least 4 samples of force and 3 of position.
_CHUNK = 0.05
#: The calmest force over this number of chunks, as in the air, shows its noise.
_CALM = 10
#: The tool turns above this rate [rad/s].
_TURNING = 0.02
#: A change counts from 6 standard deviations of a chunk, and 0.3 % of the range of the force.
_DEVIATIONS, _PART = 6.0, 0.003
#: Medians over this time [s] show the level in the air, which drifts by 0.2 % of the range a
#: second at most.
_WINDOW = 0.6
DRIFT_PART = 0.002
#: The force in the air is followed by medians over this time [s].
_FOLLOW = 2.0
#: Force and motion are compared by their changes over this part of a recording.
_CHANGES = 100
#: In the air the probe travels at least this part of its stroke in contact, and the force
#: follows the motion by less than this part of that in contact.
_TRAVEL, _FLAT = 0.2, 0.15
#: A contact continues over a loss shorter than this [s], as in an oscillation that lifts off; it
#: has at least this many chunks.
_SAME, _LEAST = 0.5, 4
#: A recording whose largest change of force is below this many deviations holds no contact.
_LEAST_CHANGE = 12.0


class Contact(NamedTuple):
    """One stretch in contact, as chunks from `first` to before `last`, and in time [s]."""

    first: int
    last: int
    start: float
    end: float

    @property
    def span(self) -> slice:
        """Its chunks."""
        return slice(self.first, self.last)


class Lines(NamedTuple):
    """Unit vectors along which force and motion agree, into the tissue where `signs` hold."""

    grows: Array  #: of the force (k,)
    into: Array  #: of the displacement (j,)
    signs: Signs


@dataclass(frozen=True)
class Session:
    """A recording in chunks, the tool's weight subtracted."""

    streams: Streams
    unloaded: Array  #: force at its own stamps, the tool's weight subtracted (m, k)
    edges: Array  #: of the chunks [s] (n + 1,)
    times: Array  #: middles of the chunks [s] (n,)
    force: Array  #: means of the chunks (n, k)
    position: Array  #: means of the chunks (n, j)
    turning: Mask  #: chunks in which the tool turns (n,)
    air: Mask  #: chunks in the air (n,)
    baseline: Array  #: force in the air, in between interpolated (n, k)
    contacts: tuple[Contact, ...] = ()
    leaves: bool = False  #: whether the force in the air is seen
    lines: Lines | None = None  #: None where nothing was touched in any recording of the rig

    @property
    def net(self) -> Array:
        """Force of the contact (n, k)."""
        return self.force - self.baseline

    @cached_property
    def force_noise(self) -> Array:
        """Standard deviation of the force per sample (k,)."""
        return noise_of(self.streams.force_times, self.streams.force)

    @cached_property
    def motion_noise(self) -> Array:
        """Standard deviation of the position per sample (j,)."""
        return noise_of(self.streams.motion_times, self.streams.position)

    @cached_property
    def force_chunk_noise(self) -> Array:
        """Standard deviation of the force's means (k,), which coloured noise widens."""
        white = self.force_noise / math.sqrt(self._per_chunk(self.streams.force_times))
        apart = apart_from_neighbours(self.times, self.force)
        parts = np.array_split(apart, max(len(apart) // _CALM, 1))
        calm = np.quantile([np.sqrt(np.mean(part**2, axis=0)) for part in parts], 0.1, axis=0)
        return np.maximum(white, calm)

    def noise(self, direction: Array) -> float:
        """Return the standard deviation of the force's means along a direction."""
        return float(np.linalg.norm(self.force_chunk_noise * direction))

    @cached_property
    def motion_chunk_noise(self) -> Array:
        """Standard deviation of the position's means (j,)."""
        return self.motion_noise / math.sqrt(self._per_chunk(self.streams.motion_times))

    def _per_chunk(self, times: Array) -> float:
        return max(times.size / self.times.size, 1.0)

    @property
    def is_pressed(self) -> bool:
        """Whether the force changes along its main line by more than its noise."""
        still = self.force[~self.turning]
        if len(still) < 2 * _LEAST:
            return False
        centred = still - np.median(still, axis=0)
        direction = np.linalg.svd(centred, full_matrices=False)[2][0]
        return float(np.ptp(centred @ direction)) >= _LEAST_CHANGE * self.noise(direction)


def make_sessions(
    recordings: Sequence[Streams], loads: Sequence[Array | None] | None = None
) -> tuple[Session, ...]:
    """Cut recordings of one rig into air and contact, the loads (n, k) subtracted from each."""
    given = loads or [None] * len(recordings)
    sessions = [_uncut(one, load) for one, load in zip(recordings, given, strict=True)]
    pressed = [one for one in sessions if one.is_pressed]
    if not pressed:
        return tuple(sessions)
    still = [one.force[~one.turning] for one in pressed]
    centred = np.concatenate([force - np.median(force, axis=0) for force in still])
    grows = np.asarray(np.linalg.svd(centred, full_matrices=False)[2][0])
    # Over a short time: in a hold the force relaxes without any motion.
    moves = [changes(one, one.force @ grows, one.position, _CHANGES) for one in pressed]
    total = sum((moved.T @ rises for moved, rises in moves), np.zeros(moves[0][0].shape[1]))
    into = np.asarray(total / max(float(np.linalg.norm(total)), 1e-300))
    courses = [
        Course(s.times, s.position @ into, s.force @ grows, ~s.turning, s.noise(grows))
        for s in pressed
    ]
    signs = find_signs(courses)
    lines = Lines(signs.force * grows, signs.motion * into, signs)
    return tuple(_cut(one, lines) if one.is_pressed else one for one in sessions)


def _uncut(streams: Streams, load: Array | None) -> Session:
    """Return a recording in chunks, as if nothing were touched."""
    unloaded = streams.force if load is None else streams.force - load
    edges = _edges(streams)
    times = 0.5 * (edges[1:] + edges[:-1])
    force = _means(streams.force_times, unloaded, edges)
    position = _means(streams.motion_times, streams.position, edges)
    good = np.isfinite(force[:, 0]) & np.isfinite(position[:, 0])
    if good.any() and not good.all():
        force, position = (
            np.stack([np.interp(times, times[good], c[good]) for c in values.T], axis=1)
            for values in (force, position)
        )
    turning: Mask = np.asarray(streams.turn_rates(edges) > _TURNING)
    leaves = int(np.sum(~turning)) >= 2 * _LEAST
    air = ~turning & leaves
    baseline = _followed(times, force, air)
    return Session(
        streams, unloaded, edges, times, force, position, turning, air, baseline, (), leaves
    )


def changes(
    session: Session, push: Array, position: Array, parts: int, span: slice = slice(None)
) -> tuple[Array, Array]:
    """Return changes of position (n, j) and force (n,) over a part of their chunks, unturned."""
    lag, turning = max(2, push.size // parts), session.turning[span]
    still = ~(turning[lag:] | turning[:-lag])
    return (position[lag:] - position[:-lag])[still], (push[lag:] - push[:-lag])[still]


def _cut(session: Session, lines: Lines) -> Session:
    """Return the session: contact is where the force lies above that in the air."""
    still, edges = ~session.turning, session.edges
    push = session.force @ lines.grows
    limit = max(_DEVIATIONS * session.noise(lines.grows), _PART * float(np.ptp(push[still])))
    height = push - _lowest(session.times, push, still, limit)
    air: Mask = still & (np.abs(height) < limit)
    leaves = lines.signs.is_stated and _is_air(
        session.times, height, session.position @ lines.into, air, still
    )
    air = air & leaves
    whole = (Contact(0, push.size, float(edges[0]), float(edges[-1])),)
    contacts = _contacts(height > limit, edges) if leaves else whole
    baseline = _followed(session.times, session.force, air)
    return replace(
        session, air=air, baseline=baseline, contacts=contacts, leaves=leaves, lines=lines
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
    ends = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return list(zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True))


def _edges(streams: Streams) -> Array:
    force, motion = (
        float(times[-1] - times[0]) / (times.size - 1)
        for times in (streams.force_times, streams.motion_times)
    )
    width = max(_CHUNK, 4.0 * force, 3.0 * motion)
    count = max(int((streams.end - streams.start) / width), 1)
    return np.asarray(streams.start + width * np.arange(count + 1))


def _means(times: Array, values: Array, edges: Array) -> Array:
    index = np.searchsorted(times, edges)
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    counts = np.diff(index)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((sums[index[1:]] - sums[index[:-1]]) / counts)


def _lowest(times: Array, push: Array, still: Mask, limit: float) -> Array:
    """Return the level that the force never falls below, except for a drift (n,).

    A contact only pushes: the level follows the lower hull of the force's medians, from the
    lowest of them to both sides, where it is no steeper than a drift.
    """
    width = max(_LEAST + 1, math.ceil(_WINDOW / float(times[1] - times[0])))
    inside = np.flatnonzero(still)
    blocks = np.array_split(inside, max(inside.size // width, 1))
    x = np.array([times[block].mean() for block in blocks])
    y = np.array([np.median(push[block]) for block in blocks])

    def is_above(a: int, b: int, c: int) -> bool:
        return bool((y[b] - y[a]) * (x[c] - x[a]) >= (y[c] - y[a]) * (x[b] - x[a]))

    hull: list[int] = []
    for new in range(x.size):
        while len(hull) > 1 and is_above(hull[-2], hull[-1], new):
            hull.pop()
        hull.append(new)
    steepest = DRIFT_PART * float(np.ptp(push[still]))
    middle = int(np.argmin(y[hull]))
    kept = [hull[middle]]
    for some in (hull[middle + 1 :], hull[:middle][::-1]):
        last = hull[middle]
        for one in some:
            if float(y[one] - y[last]) > limit + steepest * abs(float(x[one] - x[last])):
                break
            kept.append(one)
            last = one
    kept.sort()
    return np.interp(times, x[kept], y[kept])


def _followed(times: Array, values: Array, air: Mask) -> Array:
    """Return medians over 2 s of the values in the air, linear in between (n, k)."""
    seen, inside = times[air], values[air]
    bins = np.floor((seen - times[0]) / _FOLLOW).astype(int)
    parts = [part for one in np.unique(bins) if (part := bins == one).sum() >= _LEAST]
    if not parts:
        return np.broadcast_to(np.median(values, axis=0), values.shape).copy()
    knots = [float(seen[part].mean()) for part in parts]
    levels = np.array([np.median(inside[part], axis=0) for part in parts])
    return np.stack([np.interp(times, knots, column) for column in levels.T], axis=1)


def _is_air(times: Array, height: Array, motion: Array, air: Mask, still: Mask) -> bool:
    """Whether the probe travels in the presumed air, and the force does not follow it."""
    pressed = still & ~air
    if min(int(air.sum()), int(pressed.sum())) < _LEAST:
        return bool(air.sum() >= _LEAST)
    stretches = [motion[a:b] for a, b in runs(air) if b - a >= _LEAST]
    longest = max((float(np.ptp(part)) for part in stretches), default=0.0)
    if longest < _TRAVEL * float(np.ptp(motion[pressed])):
        return False
    design = np.stack([motion, np.ones_like(times), times - times[0]], axis=1)
    free = linear(design[air], height[air])
    change, steps = np.diff(height), np.diff(motion)
    contact = still[1:] & still[:-1] & (pressed[1:] | pressed[:-1])
    in_contact = float(steps[contact] @ change[contact]) / float(steps[contact] @ steps[contact])
    slope, sd = float(free.values[0]), float(free.sds[0])
    return slope + 2.0 * sd < _FLAT * in_contact
