# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The cells of a place: presses as arrays, and what each rate remembers of their motion.

Between all points the motion is linear. A cell is the mean of two points. What a rate
:math:`\lambda` has left, at a cell, of a rise that ended at a point is

.. math:: \tfrac12 \sum_{t} e^{-\lambda (t - t_k)}\, (1 - e^{-\lambda h_k}) / (\lambda h_k)

over the two times t of the cell: a tensor (rates, cells, points) of the motion's times alone. The
kernel of any relaxation is its product with the weights of the rates. A new cell appends a row
and its points append columns; older cells never see newer points.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fden_ros.core.arrays import Array, Indices
from fden_ros.core.estimation.record import Block
from fden_ros.core.law import LETTING_GO, RATE_COUNT, RATES

#: Rates of the creep of a free surface: those of the relaxation, and one for all that is slower.
CREEP_RATES: Array = np.append(RATES, 0.0)
#: Parts into which the way to the largest indentation is cut [1], and what it counts less where
#: the motion begins: the stress bends most where it is largest.
_DEPTH_STEPS, _LEAST_DEPTH = 80.0, 0.4
#: Sharpest corners of the motion that are kept, and that no cell lies across [1].
_CORNERS, _TURNS = 12, 6
#: Error of a strain whose motion bends between two samples, over the bend times the step [1].
_CORNER = 0.2
#: What two points miss counts above as many standard deviations of the noise of the motion [1].
_MISSED_DEVIATIONS = 2.0
#: What the first rise counts over all changes of the stress (from 0.3 to 1 long presses are known
#: alike), and the part of the largest stress below which it has not begun [1].
_FIRST_RISE, _LOW = 0.6, 0.1
#: Nothing is left below this exponent [1]: exponentials that underflow take six times as long.
_FORGOTTEN = -60.0


@dataclass(frozen=True, eq=False)
class Press:
    """One press: n points of the motion, N cells of two points."""

    times: Array  #: [s], (n,)
    indentations: Array  #: from the nominal contact point [1], (n,)
    speeds: Array  #: as far as they are above their noise [1/s], (n,)
    first: Indices  #: points of the cells, (N,)
    last: Indices
    middles: Array  #: [s], (N,)
    durations: Array  #: of the blocks in them [s], (N,)
    counts: Array  #: samples, (N,)
    stresses: Array  #: means [Pa], (N,)
    missed: Array  #: strain by which their two points miss the motion [1], (N,)
    steps: Array  #: time between the samples there [s], (N,)
    start: float  #: time of its first point [s]
    #: What the rates remember, (RATE_COUNT + 2, N, n), the last two being slower and faster ones;
    #: of the first cells and points alone until it is :meth:`remembered`.
    memory: Array
    spot: int = 0  #: presses of one spot meet the free surface that those before have left
    #: Of a tail: the indentations at points before it, as far as it depends on them [1].
    earlier: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def end(self) -> float:
        """When the stress is over [s]."""
        return float(self.times[-1]) + LETTING_GO

    @functools.cached_property
    def into_moments(self) -> Array:
        """What makes the moments at its end of stresses at its cells, (33, N).

        The stress is linear between the cells, from 0 at the first point to 0 at the end.
        """
        times = np.concatenate([self.times[:1], self.middles, [self.end]])
        step = np.diff(times)
        y = np.maximum(np.outer(CREEP_RATES, step), 1e-4)
        m1 = -np.expm1(-y) / y
        m2, left = (1.0 - m1) / y, step * np.exp(-np.outer(CREEP_RATES, times[-1] - times[1:]))
        return (left * m2)[:, :-1] + (left * (m1 - m2))[:, 1:]

    def appended(self, tails: Sequence[Press]) -> Press:
        """Return the press with more points and cells behind."""
        parts, ends = (self, *tails), np.cumsum([self.times.size, *(t.times.size for t in tails)])
        found: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in (*_OF_POINTS, *_OF_CELLS)
        }
        for name in ("first", "last"):
            own = [getattr(tail, name) + end for tail, end in zip(tails, ends[:-1], strict=True)]
            found[name] = np.concatenate([getattr(self, name), *own])
        return replace(self, **found)

    def remembered(self) -> Press:
        """Return it with its whole memory."""
        n, size = self.times.size, self.middles.size
        if self.memory.shape[1:] == (size, n):
            return self
        found = np.zeros((RATE_COUNT + 2, size, n))
        _, done, points = self.memory.shape
        found[:, :done, :points] = self.memory
        elapsed = np.diff(self.times, prepend=self.times[0])
        y = np.maximum(np.multiply.outer(RATES, elapsed), 1e-12)
        own = 0.5 * -np.expm1(-y) / y
        rows, first, last = np.arange(done, size), self.first[done:], self.last[done:]
        since = self.times[first][:, None] - self.times
        is_seen = since >= 0.0
        left = np.multiply.outer(-RATES, np.where(is_seen, since, np.inf))
        np.exp(np.maximum(left, _FORGOTTEN, out=left), out=left)
        decay = np.multiply.outer(-RATES, self.times[last] - self.times[first])
        np.multiply(left, 1.0 + np.exp(decay)[:, :, None], out=found[:-2, done:])
        # Of the points between the two of a cell only the second sees anything.
        cell, point = np.nonzero(
            (self.times > self.times[first][:, None]) & (self.times <= self.times[last][:, None])
        )
        between = np.multiply.outer(-RATES, self.times[last[cell]] - self.times[point])
        found[:-2, done + cell, point] = np.exp(between)
        found[-2, done:] = is_seen
        found[-2, done + cell, point] = 0.5
        for ends in (first, last):
            steps = elapsed[ends]
            found[-1, rows, ends] += np.divide(
                0.5, steps, out=np.zeros_like(steps), where=steps > 0.0
            )
        found[:-2, done:] *= own[:, None, :]
        return replace(self, memory=found)


class Path(NamedTuple):
    """The newest points of a press."""

    times: Array  #: [s], (n,)
    indentations: Array  #: [1], (n,)
    start: float  #: time of the first [s]

    def tail(self, block: Block, noise_sd: float) -> Press:
        """Return the points of one block more, and its cell; none where it was not observed."""
        spread, step = block.spread, block.step
        offsets = (-spread, spread) if spread > 0.0 else (0.0,)
        times = [block.middle + offset for offset in offsets]
        motion = [block.indentation + block.slope * offset for offset in offsets]
        at = self.times[-2:].tolist() + times
        slopes = [
            (b - a) / max(end - begin, 1e-9)
            for (a, b), (begin, end) in zip(
                itertools.pairwise(self.indentations[-2:].tolist() + motion),
                itertools.pairwise(at),
                strict=True,
            )
        ]
        speed = _seen_slope(block.slope, block.slope_sd, noise_sd) if spread else slopes[-1]
        step = step or at[-1] - at[-2]
        bends = [abs(b - a) * step for a, b in itertools.pairwise(slopes)]
        n, count = len(times), int(block.is_observed)
        first = np.zeros(count, dtype=np.intp)

        def of_cell(value: float) -> Array:
            return np.full(count, float(value))

        return Press(
            np.array(times),
            np.array(motion),
            np.full(n, float(speed)),
            first,
            first + n - 1,
            middles=of_cell(block.middle),
            durations=of_cell(block.duration + block.step),
            counts=of_cell(block.samples),
            stresses=of_cell(block.stress),
            missed=of_cell(_CORNER * max(bends, default=0.0)),
            steps=of_cell(max(step, 1e-4)),
            start=self.start,
            memory=_NO_MEMORY,
            earlier=self.indentations,
        )

    def after(self, tail: Press) -> Path:
        """Return the path with the points of a tail."""
        times = np.append(self.times, tail.times)
        return Path(times, np.append(self.indentations, tail.indentations), self.start).needed

    @property
    def needed(self) -> Path:
        """The points that a later one depends on: from the deepest, where no play is left, on."""
        first = min(int(np.argmax(self.indentations)), self.times.size - 2)
        return Path(self.times[first:], self.indentations[first:], self.start)


_NO_MEMORY = np.zeros((RATE_COUNT + 2, 0, 0))
_OF_POINTS = "times", "indentations", "speeds"
_OF_CELLS = "middles", "durations", "counts", "stresses", "missed", "steps"


def _seen_slope(slope: Array | float, slope_sd: Array | float, noise_sd: float) -> Array:
    """Return slopes as far as they are above their noise.

    One counts by half at three of its standard deviations: friction and delay would else meet the
    noise of the motion in a hold.
    """
    square, noise = np.square(slope), np.square(3.0 * noise_sd * np.asarray(slope_sd))
    return np.asarray(slope * square / np.where(square > 0.0, square + noise, 1.0))


@dataclass(frozen=True, eq=False)
class _Rows:
    """Blocks as arrays: points (n,) and observed blocks (m,)."""

    times: Array
    indentations: Array
    speeds: Array
    corners: Array  #: of the points [1]
    steps: Array  #: between the samples about a point [s]
    first: Indices
    last: Indices
    durations: Array
    counts: Array
    stresses: Array

    @property
    def middles(self) -> Array:
        """The middle of each observed block [s], (m,)."""
        return np.asarray(0.5 * (self.times[self.first] + self.times[self.last]))


def _rows(blocks: Sequence[Block], noise_sd: float) -> _Rows:
    middle, spread, indentation, slope, slope_sd, step, duration, count, stress, seen = np.array(
        blocks
    ).T
    is_line = spread > 0.0
    block = np.repeat(np.arange(len(blocks)), 1 + is_line)
    last = np.cumsum(1 + is_line) - 1
    first = last - is_line
    offsets = -spread[block]
    offsets[last] = spread
    times = middle[block] + offsets
    motion = indentation[block] + slope[block] * offsets
    elapsed = np.diff(times, prepend=times[0])
    bends = np.zeros_like(times)
    speeds = _seen_slope(slope, slope_sd, noise_sd)[block]
    if times.size > 2:
        steepness = np.diff(motion) / np.maximum(np.diff(times), 1e-9)
        bends[1:-1] = np.abs(np.diff(steepness))
        # Two points of one time have none.
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.gradient(motion, times)
        speeds = np.where((slope_sd[block] > 0.0) | ~np.isfinite(found), speeds, found)
    # A sample alone knows its step from its neighbours.
    near, own = np.maximum(elapsed, np.append(elapsed[1:], 0.0)), step[block]
    steps = np.where(own > 0.0, np.minimum(own, near), near)
    at = np.flatnonzero(seen)
    return _Rows(
        times, motion, speeds, bends * steps, steps, first[at], last[at],
        (duration + step)[at], count[at], stress[at],
    )  # fmt: skip


def _groups(rows: _Rows, corner: Array, most: int) -> Indices:
    """Return the cell of each observed block, at most some `most` cells.

    They are put together where stress and age of the motion change little, and never across one
    of its sharpest corners. The first rise tells where the contact point is: its logarithm counts,
    however long the press lasts.
    """
    m, middles = rows.stresses.size, rows.middles
    if m <= most:
        return np.arange(m)
    turns = np.zeros(m, dtype=bool)
    turns[np.argsort(-corner, kind="stable")[:_TURNS]] = True
    turns &= corner > max(0.2 * float(corner.max()), 1e-4)
    since = middles - np.maximum.accumulate(np.where(turns, middles - 1e-3, rows.times[0]))
    scale = max(float(np.abs(rows.stresses).max()), 1e-12)
    change = np.abs(np.diff(rows.stresses, prepend=0.0)) / scale
    age = np.maximum(np.diff(np.log(since + 0.02), prepend=math.log(0.02)), 0.0)
    measure = np.cumsum(change) / max(change.sum(), 1e-12) + 0.3 * np.arange(m) / m
    measure += np.cumsum(age) / max(age.sum(), 1e-12)
    rise = np.log(np.maximum.accumulate(np.maximum(rows.stresses, 0.0)) + _LOW * scale)
    measure += _FIRST_RISE * (rise - rise[0]) / max(float(rise[-1] - rise[0]), 1e-12)
    fixed = turns | np.append(False, turns[:-1])
    cells = np.arange(0)
    # Parts of the measure may be without a block: as many more as give as many cells.
    for parts in range(most, 4 * most, most // 4):
        part = np.floor(measure / measure[-1] * (parts - 1e-6)).astype(np.intp)
        begins = (np.diff(part, prepend=part[0]) > 0) | fixed
        begins[0] = False
        if cells.size and np.count_nonzero(begins) >= most:
            break
        cells = np.cumsum(begins)
    return cells


def gathered(blocks: Sequence[Block], noise_sd: float, most: int) -> Press:
    """Return a press of some `most` cells or fewer from all its blocks."""
    rows = _rows(blocks, noise_sd)
    times, first, last = rows.times, rows.first, rows.last
    met = np.append(first[:1], last[:-1] + 1)
    corner = np.maximum.reduceat(rows.corners, met)
    group = _groups(rows, corner, most)
    weights = np.zeros((group[-1] + 1, group.size))
    weights[group, np.arange(group.size)] = rows.counts
    total = weights.sum(axis=1)
    weights /= total[:, None]
    middles, halves = rows.middles, 0.5 * (times[last] - times[first])
    middle = weights @ middles
    spread = np.sqrt(np.maximum(weights @ (middles**2 + halves**2) - middle**2, 0.0))
    spread[spread < 1e-7] = 0.0
    ends = np.round(np.concatenate([middle - spread, middle + spread]), 7)
    grid = _points(rows, ends)
    at = [
        k + int(np.argmax(rows.corners[k:e]))
        for k, e in zip(met, [*met[1:], times.size], strict=True)
    ]
    size = middle.size
    bent = _CORNER * np.sqrt(weights**2 @ (corner**2 + np.append(0.0, corner[:-1]) ** 2))
    press = Press(
        grid,
        np.interp(grid, times, rows.indentations),
        np.interp(grid, times, rows.speeds),
        np.searchsorted(grid, ends[:size]),
        np.searchsorted(grid, ends[size:]),
        middle,
        weights @ rows.durations,
        total,
        weights @ rows.stresses,
        np.hypot(bent, _missed(rows, weights, ends, noise_sd)),
        weights @ np.maximum(rows.steps[at], 1e-4),
        float(grid[0]),
        _NO_MEMORY,
    )
    return press.remembered()


def _missed(rows: _Rows, weights: Array, ends: Array, noise_sd: float) -> Array:
    """Return the strain by which the mean of two points misses that of cells [1], (N,).

    Of cells of several blocks, `weights` (N, m), as far as it is above the noise of the motion:
    a motion that turns within one is no line there.

    Parameters
    ----------
    ends : ndarray, shape (2 N,)
        Times of the first points of the cells, then of the last [s].
    """
    size, m = weights.shape
    times = rows.middles
    motion = 0.5 * (rows.indentations[rows.first] + rows.indentations[rows.last])
    after = np.searchsorted(times, ends).clip(1, m - 1)
    share = np.clip((ends - times[after - 1]) / (times[after] - times[after - 1]), 0.0, 1.0)
    off, cell = weights.copy(), np.tile(np.arange(size), 2)
    np.subtract.at(off, (cell, after - 1), 0.5 * (1.0 - share))
    np.subtract.at(off, (cell, after), 0.5 * share)
    off[(weights > 0.0).sum(axis=1) == 1] = 0.0
    noise = (_MISSED_DEVIATIONS * noise_sd) ** 2 * (off**2 @ (1.0 / rows.counts))
    return np.sqrt(np.maximum((off @ motion) ** 2 - noise, 0.0))


def _points(rows: _Rows, ends: Array) -> Array:
    """Return the times of the motion's points.

    Those of the cells, corners of the motion, its beginning, and steps of the indentation.
    """
    times, motion = rows.times, rows.indentations
    deepest = max(float(motion.max()), 1e-9)
    depth = np.maximum(motion, 0.0) / deepest
    share = _LEAST_DEPTH + (1.0 - _LEAST_DEPTH) * depth**2
    gone = np.cumsum(np.abs(np.diff(motion, prepend=motion[0])) * share)
    gone += 1e-12 * np.arange(times.size)
    way = deepest * (1.0 + 2.0 * _LEAST_DEPTH) / 3.0
    tick = max(way, 0.5 * float(gone[-1])) / _DEPTH_STEPS
    taken = np.sort(np.interp(ends, times, gone))
    ticks = np.arange(gone[0], gone[-1], tick)
    near = np.searchsorted(taken, ticks).clip(1, taken.size - 1)
    far = np.minimum(np.abs(taken[near] - ticks), np.abs(taken[near - 1] - ticks)) > 0.5 * tick
    by_depth = np.interp(ticks[far], gone, times)
    sharpest = np.argsort(-rows.corners, kind="stable")[:_CORNERS]
    first = rows.first[0]
    early = times[(times <= times[first] + 0.02) | (np.arange(times.size) < first)]
    nodes = np.concatenate([ends, times[sharpest], by_depth, early[-20:], times[[0, -1]]])
    grid = np.unique(np.round(nodes, 7))
    own = grid[np.diff(grid, prepend=-1.0) > 1e-5]
    return np.unique(np.concatenate([own, ends]))


@dataclass(frozen=True, eq=False)
class Place:
    """All presses of a place as one record, their arrays one behind the other.

    `older`: the moments of the stress of presses that are no part of it, (33,), at the time
    `older_end` [s].
    """

    presses: tuple[Press, ...]
    older: Array
    older_end: float

    def joined(self, name: str) -> Array:
        """Return an array of all presses."""
        return np.concatenate([getattr(press, name) for press in self.presses])

    def number_of(self, press: Press) -> int:
        """Return the number of a press, or of that which a tail continues: by its beginning."""
        return [own.start for own in self.presses].index(press.start)

    def is_new_spot(self, press: int) -> bool:
        """Whether a press, by its number, is of another spot than the one before it."""
        return press > 0 and self.presses[press].spot != self.presses[press - 1].spot

    @property
    def point_slices(self) -> list[slice]:
        """The points of each press."""
        return _slices([press.times.size for press in self.presses])

    @property
    def cell_slices(self) -> list[slice]:
        """The cells of each press."""
        return _slices([press.middles.size for press in self.presses])


def _slices(sizes: Sequence[int]) -> list[slice]:
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(begin, end) for begin, end in itertools.pairwise(ends)]
