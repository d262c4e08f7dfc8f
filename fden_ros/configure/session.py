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

"""A recording cut into air and contact, without knowing any axis, sign or unit.

A probe in contact can only be pushed. So the forces of a recording lie on one side of those in
the air, and along one line; and in the air the probe travels without any change of the force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fden_ros.configure.finding import Seconds
from fden_ros.configure.statistics import noise_of
from fden_ros.configure.streams import Streams
from fden_ros.core.arrays import Array

Mask = NDArray[np.bool_]

#: Chunks [s] average the noise; each holds at least 4 samples of force and 3 of position.
_CHUNK = 0.05
#: The tool turns above this rate [rad/s].
_TURNING = 0.02
#: A change counts from 6 standard deviations of a chunk, and 0.3 % of the range of the force.
_DEVIATIONS = 6.0
_SHARE = 0.003
#: A stretch of this time [s] is flat if it scatters by less than 2.5 times the usual.
_WINDOW = 0.6
_FLAT = 2.5
#: Scatter of more than this share of the range is motion in contact, not noise.
_STILL = 0.02
#: The first stretch of air is taken up to a pause of this time [s].
_PAUSE = 2.0
#: The level in the air drifts by some 0.2 % of the range a second, before more is known.
_DRIFT_SHARE = 0.002
#: The force in the air is followed by medians over this time [s].
_FOLLOW = 2.0
#: In the air the probe travels by this share of its way in contact, at least.
_TRAVEL = 0.2
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


def make_session(streams: Streams, load: Array | None = None) -> Session:
    """Cut a recording into air and contact.

    Parameters
    ----------
    streams : Streams
    load : Array, optional
        Force of the tool's weight at the force's stamps (n, k), to be taken off.
    """
    raw = streams.force if load is None else streams.force - load
    edges = _edges(streams)
    force = _means(streams.force_times, raw, edges)
    position = _means(streams.motion_times, streams.position, edges)
    good = np.isfinite(force[:, 0]) & np.isfinite(position[:, 0])
    times = 0.5 * (edges[1:] + edges[:-1])
    force, position = _filled(times, force, good), _filled(times, position, good)
    turning = _turning(streams, edges)
    noise = noise_of(streams.force_times, streams.force)
    size = max(float(np.median(np.diff(edges))) * streams.force_times.size, 1.0)
    size = max(size / max(streams.end - streams.start, 1e-9), 1.0)
    found = _Air(times, force, position, turning, noise / math.sqrt(size), streams)
    return Session(
        streams,
        edges,
        times,
        force,
        position,
        found.baseline,
        found.air,
        turning,
        found.contacts(edges),
        found.leaves,
        noise,
        noise_of(streams.motion_times, streams.position),
        raw,
    )


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


class _Windows(NamedTuple):
    """Stretches of flat force: when, at which level, how far the probe went, usual scatter."""

    times: Array
    levels: Array
    paths: Array
    noise: float


class _Air:
    """The force in the air, found without an axis."""

    def __init__(
        self,
        times: Array,
        force: Array,
        position: Array,
        turning: Mask,
        chunk_noise: Array,
        streams: Streams,
    ) -> None:
        self._times = times
        still = ~turning
        self.leaves = False
        self.air = np.zeros(times.size, dtype=bool)
        self.baseline = np.broadcast_to(np.median(force, axis=0), force.shape).copy()
        self._height = np.zeros(times.size)
        self._limit = math.inf
        if still.sum() < 2 * _LEAST:
            return
        centred = force - np.median(force[still], axis=0)
        direction = np.linalg.svd(centred[still], full_matrices=False)[2][0]
        line = centred @ direction
        noise = float(np.sqrt(np.sum((chunk_noise * direction) ** 2)))
        spread = float(np.ptp(line[still]))
        self._limit = max(_DEVIATIONS * noise, _SHARE * spread)
        if spread < _LEAST_CHANGE * noise:
            self.air, self.leaves = still.copy(), True
            self.baseline = _followed(times, force, self.air)
            return
        windows = self._windows(line, position, still, noise)
        if windows.times.size < 2:
            return
        self._limit = max(_DEVIATIONS * windows.noise, _SHARE * spread)
        taken = self._grow(windows, _level(windows, self._limit), spread)
        base = _through(self._times, windows.times[taken], windows.levels[taken])
        air: Mask = still & (np.abs(line - base) < self._limit)
        above = float(np.mean((line - base > self._limit)[still]))
        below = float(np.mean((base - line > self._limit)[still]))
        self._height = (line - base) * (1.0 if above >= below else -1.0)
        # A probe pulls nowhere: all that is not air lies on one side.
        self.leaves = min(above, below) < 0.02 + 0.1 * max(above, below)
        self.air = air
        if self.leaves and self.air.sum() >= _LEAST:
            self.leaves = not _follows(self._height, position, self.air, still)
        if self.leaves:
            self.baseline = _followed(times, force, self.air)

    def _windows(self, line: Array, position: Array, still: Mask, noise: float) -> _Windows:
        """Return the stretches of 0.6 s in which the force is flat."""
        width = max(_LEAST + 1, math.ceil(_WINDOW / float(self._times[1] - self._times[0])))
        starts = np.arange(0, line.size - width + 1, max(width // 2, 1))
        index = starts[:, None] + np.arange(width)
        index = index[still[index].all(axis=1)]
        if index.shape[0] < 3:
            return _Windows(np.empty(0), np.empty(0), np.empty(0), 0.0)
        levels, scatter = line[index].mean(axis=1), line[index].std(axis=1, ddof=1)
        usual = min(float(np.quantile(scatter, 0.1)), _STILL * float(np.ptp(line)))
        usual = max(noise, usual)
        flat = scatter < _FLAT * usual
        path = np.linalg.norm(np.diff(position[index], axis=1), axis=2).sum(axis=1)
        times = self._times[index].mean(axis=1)
        return _Windows(times[flat], levels[flat], path[flat], usual)

    def _grow(self, windows: _Windows, level: float, spread: float) -> Mask:
        """Follow the level through its drift, from where it is found to before and after."""
        sd = windows.noise
        taken = _longest(windows.times, np.abs(windows.levels - level) < 0.5 * self._limit)
        slope_prior = _DRIFT_SHARE * spread
        while not taken.all():
            open_ones = np.flatnonzero(~taken)
            times, levels = windows.times[taken], windows.levels[taken]
            since = times[None] - windows.times[open_ones, None]
            nearest = np.argsort(np.abs(since), axis=1)[:, :20]
            since, near_levels = np.take_along_axis(since, nearest, axis=1), levels[nearest]
            centre = since.mean(axis=1)
            away = since - centre[:, None]
            precision = (away**2).sum(axis=1) / sd**2 + 1.0 / slope_prior**2
            slope = (away * near_levels).sum(axis=1) / sd**2 / precision
            predicted = near_levels.mean(axis=1) - slope * centre
            allowed = self._limit + 3.0 * np.abs(centre) / np.sqrt(precision)
            off = np.abs(windows.levels[open_ones] - predicted) / allowed
            # The surest first: once the air after a long contact has joined, a hold cannot.
            if off.min() > 1.0:
                break
            taken[open_ones[off <= max(0.2, float(off.min()))]] = True
        return taken

    def contacts(self, edges: Array) -> tuple[Contact, ...]:
        """Return the stretches in contact; the whole recording where it has no air."""
        if not self.leaves:
            return (Contact(0, self._times.size, float(edges[0]), float(edges[-1])),)
        joined: list[list[int]] = []
        for a, b in runs(self._height > self._limit):
            if joined and float(edges[a] - edges[joined[-1][1]]) < _SAME:
                joined[-1][1] = b
            elif b - a >= _LEAST:
                joined.append([a, b])
        return tuple(Contact(a, b, float(edges[a]), float(edges[b])) for a, b in joined)


def _level(windows: _Windows, width: float) -> float:
    """Return the flat force at which the probe travels most: that of the air."""
    usual = float(np.quantile(windows.paths, 0.75))
    weights = np.minimum(windows.paths, usual) + 0.05 * usual + 1e-300
    order = np.argsort(windows.levels)
    levels, masses = windows.levels[order], np.cumsum(weights[order])
    low = np.searchsorted(levels, levels - 0.5 * width)
    high = np.searchsorted(levels, levels + 0.5 * width, side="right") - 1
    inside = masses[high] - np.where(low > 0, masses[low - 1], 0.0)
    best = int(np.argmax(inside))
    return float(np.median(levels[low[best] : high[best] + 1]))


def _longest(times: Array, mask: Mask) -> Mask:
    """Return the longest part of the mask without a pause of more than 2 s."""
    index = np.flatnonzero(mask)
    parts = np.split(index, np.flatnonzero(np.diff(times[index]) > _PAUSE) + 1)
    chosen = np.zeros_like(mask)
    chosen[max(parts, key=len)] = True
    return chosen


def _through(times: Array, knots: Array, levels: Array) -> Array:
    """Return the line through levels at `knots`, their trend beyond the ends."""
    order = np.argsort(knots)
    knots, levels = knots[order], levels[order]
    line = np.interp(times, knots, levels)
    if knots.size > 4 and float(np.ptp(knots)) > 5.0:
        slope = float(np.polyfit(knots - knots[0], levels, 1)[0])
        line += slope * (np.minimum(times - knots[0], 0.0) + np.maximum(times - knots[-1], 0.0))
    return np.asarray(line)


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


def _follows(height: Array, position: Array, air: Mask, still: Mask) -> bool:
    """Whether the force in what is taken for air follows the motion, as it does in contact.

    Where the probe does not travel there, nothing shows that it is the air.
    """
    pressed = still & ~air
    if pressed.sum() < _LEAST:
        return False
    scale = np.linalg.norm(position[pressed] - position[pressed].mean(axis=0), axis=1).std()
    steps = np.diff(position, axis=0)
    both = still[1:] & still[:-1]
    contact = both & (pressed[1:] | pressed[:-1])
    change = np.diff(height)
    # Into the tissue, as far as the contact shows it.
    into = (steps[contact] * change[contact, None]).sum(axis=0)
    length = float(np.linalg.norm(into))
    if length <= 0.0 or scale <= 0.0:
        return False
    along = steps @ (into / length)
    free = both & air[1:] & air[:-1]
    if free.sum() < _LEAST or float(np.sum(along[free] ** 2)) <= 0.0:
        return True
    slope = float(along[free] @ change[free]) / float(along[free] @ along[free])
    in_contact = float(along[contact] @ change[contact]) / float(along[contact] @ along[contact])
    travel = float(np.sqrt(np.sum(along[free] ** 2)))
    line = position @ into
    longest = max((float(np.ptp(line[a:b])) for a, b in runs(air) if b - a >= _LEAST), default=0.0)
    if longest < _TRAVEL * float(np.ptp(line[pressed])):
        return True
    fit_sd = float(np.std(change[free])) / travel
    return slope > 0.15 * in_contact and slope > 4.0 * fit_sd
