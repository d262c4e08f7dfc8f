# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The slope of force over displacement where the probe is, as it is measured.

No law, no touch, no zero of the force and no origin: a *run* is motion in one direction, and the
slope is that of the least-squares line, over displacement, through the newest part of the newest
run. Of a curve up to the second degree that is the slope in the middle of the window, at the
depth that is stated with it. The window is the narrowest, from a quarter of the run's change of
force on, whose deviation is at most 2 % of the slope; else the one of the least deviation.

A run is kept as *pieces* of the way, the newest the finest, two older ones joined where there are
too many of a length: some hundred at most, whatever the run's length. The deviation is that of
the pieces from a cubic, their correlation included, or of the noise that is stated, or of that in
the last run, where these are larger, and what the cubic part bends the slope by.
"""

from __future__ import annotations

import math
import sys
from collections import deque
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from fden_ros.core.arrays import Array
from fden_ros.core.streams import NANOSECONDS

#: Pieces are at least so long [m]: a stroke of 0.1 mm has 20. Of a smaller probe they are this
#: part of its length at most, 5 um of 20 mm.
_LEAST_PIECE, _LEAST_PIECE_PART = 5e-6, 2.5e-4
#: And at least so many deviations of the displacement's noise: one sample in 30,000 leaves it.
_PIECE_DEVIATIONS = 4.0
#: Pieces of one length before the two oldest are joined: the oldest is a tenth of a window.
_PER_LEVEL = 10
#: Pieces that a window has at least: a cubic takes four of them.
_LEAST_PIECES = 8
#: A window's least part of the force's change in its run: an exponential bends it by 0.2 %.
_LEAST_PART = 0.25
#: Each window that is tried is wider than the last by this factor.
_WIDER = 1.4
#: A window is wide enough where the deviation is at most this part of the slope [1]: on silicones
#: 0.01 is no closer to the curve's own slope (0.2 to 0.5 % in the median), and lies further up.
_FINE = 0.02
#: A slope below this number of its deviations is not known.
_LEAST_RATIO = 4.0
#: And one where the force changes by fewer deviations of its noise than this: drift of the zero in
#: an approach is below 1.
_LEAST_RISE = 3.0
#: Correlation of neighbouring pieces above this counts as this: the factor is 3 then.
_MOST_CORRELATED = 0.8
#: A piece that takes this many times as long as the run's pieces of its length is rest: the last
#: of 32 pieces of a sine's half period takes 3.6 times as long, of a smoothest (minimum jerk)
#: motion 5 times.
_REST = 8.0
#: Motion on in the same direction, after a rest or where a controller shook, counts once the force
#: has changed by this part of what it had before [1]: as tissue relaxes, the last millimetre of a
#: controller that creeps there looks softer, by 20 to 40 % on silicone, with 0.17 of the force.
_LEAST_OF_LAST = 0.25
#: A slope is computed anew where the run has grown by this part of the last window, or where
#: there was none, of the run: eight pieces make a window.
_GROWN = 0.125
#: Samples over which the displacement's noise is a running mean.
_NOISE_SAMPLES = 64
#: Standard deviation of white noise over the mean magnitude of its third differences.
_THIRD_DIFFERENCE = math.sqrt(math.pi / 2.0) / math.sqrt(20.0)


class MeasuredStiffness(NamedTuple):
    """Slope of force over displacement, in one direction."""

    value: float  #: dF/dd [N/m]
    sd: float  #: its standard deviation, of noise and curvature [N/m]
    depth: float  #: displacement in the middle of the window [m]
    width: float  #: of the window [m]
    stamp_ns: int  #: of the window's newest sample


class BothWays(NamedTuple):
    """That of loading and of unloading; None: not known."""

    loading: MeasuredStiffness | None = None
    unloading: MeasuredStiffness | None = None


#: Nothing is known.
NOT_MEASURED = BothWays()


class _Piece(NamedTuple):
    """Part of a run: means over its way."""

    width: float  #: [m]
    duration: float  #: [s]
    place: float  #: from the run's beginning [m]
    square: float  #: of the distance from `place` [m^2]
    cube: float  #: of it [m^3]
    force: float  #: [N]
    variance: float  #: of `force`, over that of a sample [1]

    def joined(self, other: _Piece) -> _Piece:
        """Return both as one."""
        width = self.width + other.width
        own, its = self.width / width, other.width / width
        place = own * self.place + its * other.place
        a, b = self.place - place, other.place - place
        return _Piece(
            width,
            self.duration + other.duration,
            place,
            own * (self.square + a * a) + its * (other.square + b * b),
            own * (self.cube + a * (3.0 * self.square + a * a))
            + its * (other.cube + b * (3.0 * other.square + b * b)),
            own * self.force + its * other.force,
            own * own * self.variance + its * its * other.variance,
        )


class _Open:
    """The piece that is being gathered."""

    def __init__(self, start: float, start_ns: int) -> None:
        self.start, self.start_ns = start, start_ns  #: where and when it began [m, ns]
        self.count = 0
        self.sums = (0.0, 0.0, 0.0, 0.0)

    def add(self, place: float, force: float) -> None:
        """Take a sample: place from the run's beginning [m], force [N]."""
        first, second, third, forces = self.sums
        way = place - self.start
        square = way * way
        self.sums = (first + way, second + square, third + square * way, forces + force)
        self.count += 1

    def closed(self, width: float, stamp_ns: int) -> _Piece:
        """Return it as a piece."""
        way, square, cube, force = (total / self.count for total in self.sums)
        return _Piece(
            width,
            (stamp_ns - self.start_ns) / NANOSECONDS,
            self.start + way,
            square - way * way,
            cube - way * (3.0 * square - 2.0 * way * way),
            force,
            1.0 / self.count,
        )


class _Run:
    """Motion in one direction, from a displacement on.

    `sign` is 1 into the tissue and -1 out of it, `length` the least of a piece [m]. It says
    nothing before the force has changed by `least_change` [N].
    """

    def __init__(
        self, sign: float, start: float, stamp_ns: int, length: float, least_change: float = 0.0
    ) -> None:
        self.sign, self.start, self.length = sign, start, length
        self.least_change = least_change
        self.newest_ns = stamp_ns
        self.width = self.duration = self.noise = 0.0
        #: At which a slope was computed last, and at which it is to be anew [m].
        self.measured_width = self.due_width = 0.0
        self.open = _Open(0.0, stamp_ns)
        self._is_first = True
        self._levels: list[deque[_Piece]] = [deque()]

    def way(self, displacement: float) -> float:
        """Return how far a displacement is along the run [m]."""
        return self.sign * (displacement - self.start)

    def add(self, stamp_ns: int, displacement: float, force: float) -> bool:
        """Take a sample; return whether a piece has been closed."""
        way = self.way(displacement)
        self.open.add(way, self.sign * force)
        steps = math.floor((way - self.open.start) / self.length)
        if steps < 1:
            return False
        width = steps * self.length
        piece, start = self.open.closed(width, stamp_ns), self.open.start + width
        self.open = _Open(start, stamp_ns)
        if self._is_first:
            # It may hold the rest, or the turn, from before.
            self._is_first = False
            return False
        self.width += piece.width
        self.duration += piece.duration
        self.newest_ns = stamp_ns
        self._push(piece)
        return True

    def rests(self, stamp_ns: int) -> bool:
        """Whether the present piece takes so long that the probe is at rest."""
        if not self.duration:
            return False
        usual = self.duration / self.width * self.length
        return (stamp_ns - self.open.start_ns) / NANOSECONDS > _REST * usual

    def _push(self, piece: _Piece) -> None:
        for level in self._levels:
            level.append(piece)
            if len(level) <= _PER_LEVEL:
                return
            piece = level.popleft().joined(level.popleft())
        self._levels.append(deque([piece]))

    def pieces(self) -> list[_Piece]:
        """Return the pieces, the newest first."""
        return [piece for level in self._levels for piece in reversed(level)]


class StiffnessMeter:
    """Measures the stiffness of both directions, sample by sample.

    Parameters
    ----------
    noise : float
        Standard deviation of the force's noise that is stated, or the least that is believed [N].
    length : float
        Of the probe or the tissue [m].
    """

    def __init__(self, noise: float, length: float = math.inf) -> None:
        self._noise = noise
        self._least_piece = min(_LEAST_PIECE, _LEAST_PIECE_PART * length)
        self.forget()

    def forget(self) -> None:
        """Forget all samples."""
        self.newest = NOT_MEASURED
        self._run: _Run | None = None
        self._last: deque[float] = deque(maxlen=4)
        self._roughness = 0.0
        #: Noise in the last run [N]: a window may be too short to show how the robot shakes.
        self._seen = 0.0
        #: By the direction of the last run with a slope, see `_LEAST_OF_LAST` [N].
        self._least: dict[float, float] = {}
        self._count = 0

    def skip(self) -> None:
        """Begin a new run: samples are missing."""
        self._finish_run()
        self._last.clear()

    def add(self, stamp_ns: int, displacement: float, force: float) -> bool:
        """Take a sample [m, N]; return whether there is a new slope."""
        self._learn_noise(displacement)
        run = self._run
        if run is None:
            self._run = self._begun(1.0, displacement, stamp_ns)
            return False
        way = run.way(displacement)
        if way < run.open.start - run.length:
            is_new = self._finish_run()
            self._run = self._begun(-run.sign, displacement, stamp_ns)
            return is_new
        has_grown = run.add(stamp_ns, displacement, force)
        if run.rests(stamp_ns):
            is_new = self._finish_run()
            self._run = self._begun(run.sign, displacement, stamp_ns)
            return is_new
        return has_grown and run.width >= run.due_width and self._measure(run)

    def _begun(self, sign: float, displacement: float, stamp_ns: int) -> _Run:
        length = max(self._least_piece, _PIECE_DEVIATIONS * self._roughness)
        return _Run(sign, displacement, stamp_ns, length, self._least.get(sign, 0.0))

    def _learn_noise(self, displacement: float) -> None:
        last = self._last
        last.append(displacement)
        if len(last) < 4:
            return
        a, b, c, d = last
        size = abs(d - a + 3.0 * (b - c)) * _THIRD_DIFFERENCE
        self._count = min(self._count + 1, _NOISE_SAMPLES)
        self._roughness += (size - self._roughness) / self._count

    def _finish_run(self) -> bool:
        run, self._run = self._run, None
        if run is None:
            return False
        is_new = run.width > run.measured_width and self._measure(run)
        if run.noise:
            self._seen = run.noise
            least = max(run.least_change, _LEAST_OF_LAST * _change(np.array(run.pieces())))
            self._least = {run.sign: least}
        return is_new

    def _measure(self, run: _Run) -> bool:
        found = _slope(run, max(self._noise, self._seen))
        run.measured_width = run.width
        run.due_width = run.width + _GROWN * (run.width if found is None else found.width)
        if found is None:
            return False
        way = "loading" if run.sign > 0.0 else "unloading"
        self.newest = self.newest._replace(**{way: found})
        return True


class _Windows(NamedTuple):
    """Windows that begin at the newest piece, from the narrowest on; each of shape (windows,)."""

    widths: Array  #: [m]
    middles: Array  #: [m]
    lines: Array  #: slopes [N/m]
    sds: Array  #: [N/m]
    noises: Array  #: of a sample of the force, as if it were white [N]
    own_noises: Array  #: as they are in each window alone [N]

    @property
    def best(self) -> int | None:
        """The first whose deviation is small, else that of the least; None: no slope is known.

        A slope is known where it stands out from its deviation, and the force's change from noise.
        """
        stands_out = self.lines >= _LEAST_RATIO * self.sds
        known = stands_out & (self.lines * self.widths >= _LEAST_RISE * self.noises)
        if not known.any():
            return None
        fine = np.flatnonzero(known & (self.sds <= _FINE * self.lines))
        return int(fine[0] if fine.size else np.argmin(np.where(known, self.sds, np.inf)))


def _slope(run: _Run, noise: float) -> MeasuredStiffness | None:
    """Return the slope at the end of a run; None: it is not known."""
    pieces = run.pieces()
    if len(pieces) < _LEAST_PIECES:
        return None
    columns = np.array(pieces)
    change = _change(columns)
    if change < run.least_change:
        return None
    windows = _windows(columns, _counts(columns, change, noise), noise)
    best = windows.best
    if best is None:
        return None
    width, middle, line, sd, _, run.noise = (float(each[best]) for each in windows)
    return MeasuredStiffness(line, sd, run.start + run.sign * middle, width, run.newest_ns)


def _change(columns: Array) -> float:
    """Return by how much the force has grown along a run [N]."""
    forces = columns[:, 5]
    return float(forces[:3].mean() - forces.min())


def _counts(columns: Array, change: float, noise: float) -> list[int]:
    """Return the pieces of windows that hold enough of the force's change [N], narrowest first."""
    widths = np.cumsum(columns[:, 0])
    rises = _lines(columns) * widths[_LEAST_PIECES - 1 :]
    is_enough = rises >= max(_LEAST_PART * change, _LEAST_RISE * noise)
    last, count, found = len(columns), _LEAST_PIECES, []
    while count < last:
        if is_enough[count - _LEAST_PIECES]:
            found.append(count)
        wider = int(np.searchsorted(widths, _WIDER * widths[count - 1]))
        count = min(max(wider, count + 1), last)
    return [*found, last]


def _lines(columns: Array) -> Array:
    """Return the slopes of the lines through the windows of 8 pieces, of 9 and so on [N/m]."""
    weights, _, places, squares, _, forces, _ = columns.T
    # From the newest end, so that a narrow window at the end of a long way is not rounded off.
    away = places - places[0]
    moments = np.stack([np.ones_like(away), away, away**2 + squares, forces, away * forces])
    sums = np.cumsum(weights * moments, axis=1)[:, _LEAST_PIECES - 1 :]
    total, first, second, force, both = sums
    slopes: Array = (total * both - first * force) / (total * second - first**2)
    return slopes


def _windows(columns: Array, counts: list[int], noise: float) -> _Windows:
    """Return the slopes of windows of so many pieces, with their deviations."""
    own_widths, _, places, squares, cubes, forces, variances = columns.T
    weights = np.where(np.arange(len(columns)) < np.array(counts)[:, None], own_widths, 0.0)
    is_in = weights > 0.0
    widths = weights.sum(axis=1)
    half, middles = 0.5 * widths[:, None], weights @ places / widths
    # Means of the powers of the distance from the middle, in halves, over each piece.
    first, square = (places - middles[:, None]) / half, squares / half**2
    second = first**2 + square
    third = first * (first**2 + 3.0 * square) + cubes / half**3
    design = np.stack([np.ones_like(first), first, second, third], axis=2)
    by_weight = np.swapaxes(design * weights[:, :, None], 1, 2)
    normal = by_weight @ design
    straight, cubic = np.linalg.inv(normal[:, :3, :3])[:, 1:2], np.linalg.inv(normal)
    fitted = design @ (cubic @ (by_weight @ forces)[:, :, None])
    residuals = forces - fitted[:, :, 0]
    # Both slopes in the middle are sums of the forces.
    line = (straight @ by_weight[:, :3])[:, 0]
    bend = line - (cubic[:, 1:2] @ by_weight)[:, 0]
    scaled = np.where(is_in, residuals / np.sqrt(variances), 0.0)
    freedom, total = np.array(counts) - 4, (scaled**2).sum(axis=1)
    lagged = (scaled[:, 1:] * scaled[:, :-1]).sum(axis=1)
    # A negative correlation of neighbours narrows nothing; residuals that are all 0 have none.
    correlated = np.clip(lagged / np.maximum(total, sys.float_info.min), 0.0, _MOST_CORRELATED)
    own = total / freedom * (1.0 + correlated) / (1.0 - correlated)
    of_sample = np.maximum(own, noise**2)
    by_noise = of_sample * (line**2 @ variances)
    bent = (bend @ forces) ** 2 - of_sample * (bend**2 @ variances)
    student = stdtrit(freedom, 0.975) / 1.959964  # of the normal distribution
    sds = np.sqrt(student**2 * by_noise + np.maximum(bent, 0.0)) / half[:, 0]
    lines = line @ forces / half[:, 0]
    return _Windows(widths, middles, lines, sds, np.sqrt(of_sample), np.sqrt(own))
