# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""One press in a bounded number of blocks: what the posterior is a function of.

A block of samples is kept as its mean stress and the line of its motion at two points, a standard
deviation of the times before and after their mean. These two have the mean and the quadratic of
the block, so a response averaged over them is that of the samples. Blocks that follow one line
within the noise of the motion have that line: noise of the motion would else count as motion, in
the stress and in its derivatives, and other blocks of the same press would give another estimate.
Between all points the motion is linear.

- Near the touch every sample is a block of its own.
- A block ends early where the motion leaves its line.
- Where the probe rests, or moves slowly, blocks grow with the time since the motion last changed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.approach import ApproachMotion
from fden_ros.core.estimation.block import (
    BLOCK_TIME,
    LINE_TOLERANCE,
    SAME_TIME,
    TOUCH_TIME,
    Block,
    Cell,
    Points,
    Sample,
)

#: A block ends where the motion leaves its line by as many standard deviations of the noise [1],
#: beside the tolerance; a block goes on along the line of those before within the noise alone.
_LINE_DEVIATIONS = 4.0
#: Blocks of one press [1]: a press of 0.3 of strain has 100 to 500, each further decade of a hold
#: 50. Where there would be more, each two become one, and all that follow last twice as long.
MOST_BLOCKS = 600


class Record:
    """Takes the samples of one press.

    Parameters
    ----------
    noise_sd : float
        Standard deviation of the compression of a sample [1].
    reach : float
        How far before its nominal place the touch may be, as compression [1]; 0: it is known.
    is_at_rest : bool
        That place is where the compression is 0; else the tissue may be met first where the
        record begins.
    """

    def __init__(
        self,
        noise_sd: float = 0.0,
        reach: float = 0.0,
        *,
        is_at_rest: bool = False,
    ) -> None:
        self.noise_sd = noise_sd
        self._approach = ApproachMotion(reach, is_at_rest=is_at_rest)
        self._cells: list[Cell] = []
        self._rows: list[Block] = []  # of the same; on their path but for those of the newest
        self._path: Cell | None = None  # the newest line that blocks have followed
        self._path_begin = 0  # its first block
        self._open: Cell | None = None
        self._start: float | None = None
        self._changed = 0.0
        self._block_time = BLOCK_TIME
        self.max_compression = -math.inf

    @property
    def end(self) -> float:
        """Time of the newest sample [s]."""
        return self._open.end if self._open is not None else 0.0

    @property
    def size(self) -> int:
        """Blocks so far."""
        return len(self._cells) + (self._open is not None)

    def has_slowed(self, exponent: float) -> bool:
        """Whether the rate of the strain, the compression to this power, has fallen to half."""
        n = 5  # blocks over which a speed is above the noise of the motion: 50 ms
        if len(self._rows) <= n:
            return False
        times = np.array([row.middle for row in self._rows])
        strains = np.maximum([row.compression for row in self._rows], 0.0) ** exponent
        speeds = (strains[n:] - strains[:-n]) / (times[n:] - times[:-n])
        is_slow = speeds < 0.5 * np.maximum.accumulate(speeds)
        is_seen = times[n:] - times[0] > TOUCH_TIME
        return bool((is_slow & is_seen).any())

    def add(self, time: float, compression: float, stress: float, *, is_observed: bool) -> None:
        """Take a sample; `is_observed`: its stress counts, not only its motion."""
        if self._start is None:
            self._start = self._changed = time
        if self._open is not None and self._is_complete(
            self._open, time, compression, is_observed
        ):
            self._close()
        if self._open is None:
            self._open = Cell(time, is_observed)
        self._open.add(time, compression, stress)
        if is_observed:
            self.max_compression = max(self.max_compression, compression)

    def _is_complete(self, cell: Cell, time: float, compression: float, observed: bool) -> bool:
        assert self._start is not None
        if cell.is_observed != observed:
            return True
        # Above a noise of 5e-5 a sample alone tells nothing of the touch.
        if cell.start - self._start < (TOUCH_TIME if self.noise_sd < 5e-5 else 0.0):
            # Above 1 kHz the samples there are blocks of this time [s].
            return time - cell.start > 1e-3 - SAME_TIME
        # Half a step's tolerance, so that jitter of the stamps adds no sample.
        step = (time - cell.start) / cell.count
        if time - cell.start > self._block_time - 0.5 * step + SAME_TIME:
            return True
        if cell.count < 2:
            return False
        spread = math.sqrt(1.0 + 4.0 / cell.count)
        return abs(compression - cell.at(time)) > self._tolerance(spread)

    def _tolerance(self, spread: float) -> float:
        return LINE_TOLERANCE + _LINE_DEVIATIONS * self.noise_sd * spread

    def _close(self) -> None:
        path, longer = self._path, self._newest_path()
        cell, self._open = self._open, None
        assert cell is not None
        if self._cells and self._joins(self._cells[-1], cell):
            cell = self._cells.pop().merged(cell)
            self._rows.pop()
        elif path is not None and longer is None:
            end = self._end_of(path)
            if end is not None:
                self._cells.append(end)
                self._rows.append(end.row())
        if longer is None:
            self._rows = self._rows_on_path(path)
            self._path_begin = len(self._cells)
        self._path = longer or cell
        self._cells.append(cell)
        self._rows.append(cell.row())
        if len(self._cells) >= MOST_BLOCKS:
            self._halve()

    def _halve(self) -> None:
        """Make each two blocks one, but for those near the touch."""
        assert self._start is not None
        self._block_time *= 2.0
        halved: list[Cell] = []
        is_open = False  # the newest of them waits for another
        for cell in self._cells:
            is_near = cell.start - self._start < TOUCH_TIME
            if is_open and halved[-1].is_observed == cell.is_observed and not is_near:
                halved[-1], is_open = halved[-1].merged(cell), False
            else:
                halved.append(cell)
                is_open = not is_near
        self._cells, self._path = halved, halved[-1]
        self._rows = [cell.row() for cell in halved]
        self._path_begin = len(halved) - 1

    def _end_of(self, path: Cell) -> Cell | None:
        """Return the last step of the motion along a path; None: the last block has it nearly.

        The two points of a long block are far from its end, and the motion would turn there.
        """
        last = self._cells[-1]
        middle, spread, _, _ = last.line()
        if last.end - middle - spread <= max(last.step, BLOCK_TIME) + SAME_TIME:
            return None
        end = Cell(last.end - last.step, False)
        for time in (end.start, last.end):
            end.add(time, path.at(time), 0.0)
        return end

    def _rows_on_path(self, path: Cell | None) -> list[Block]:
        """Return all rows, those of the newest blocks on a path; None: there is no block."""
        if path is None:
            return []
        newest = [row.along(path) for row in self._rows[self._path_begin :]]
        return self._rows[: self._path_begin] + newest

    def _newest_path(self) -> Cell | None:
        """Return the path with the samples since the last block, if they go on along it."""
        if (
            self._path is None
            or self._open is None
            or not self._open.is_along(self._path, _LINE_DEVIATIONS * self.noise_sd)
        ):
            return None
        return self._path.merged(self._open)

    def _joins(self, last: Cell, cell: Cell) -> bool:
        """Whether a block goes on with the next; takes note where the motion changes."""
        assert self._start is not None
        middle = cell.line()[0]
        off = abs(cell.compression / cell.count - last.at(middle))
        spread = math.sqrt(1.0 / cell.count + 4.0 / last.count)
        # With 1.5e-5 noise of 0.1 um would move estimates by half a standard deviation.
        if off > 2e-4 + _LINE_DEVIATIONS * self.noise_sd * spread:
            self._changed = cell.start
            return False
        if last.is_observed != cell.is_observed or last.start - self._start < TOUCH_TIME:
            return False
        change = abs(cell.compression / cell.count - last.compression / last.count)
        # It may last for a twentieth of the time since the motion changed.
        return (
            change < 5e-4 + _LINE_DEVIATIONS * self.noise_sd * spread
            and cell.end - last.start <= 0.05 * (cell.end - self._changed) + SAME_TIME
        )

    def points(self) -> Points:
        """Return the record so far as arrays."""
        opened = [] if self._open is None else [self._open]
        path = self._newest_path()
        rows = self._rows_on_path(path or self._path)
        if path is None and self._path is not None and opened:
            opened = [cell for cell in (self._end_of(self._path), *opened) if cell is not None]
        rows += [cell.row() if path is None else cell.row().along(path) for cell in opened]
        rows = [cell.row() for cell in self._approach.cells(self._cells + opened)] + rows
        return _points(rows, self.noise_sd)

    def see_way(self, way: Array) -> None:
        """Take the way of the probe before the first sample.

        `way`: times [s], compressions [1] and stresses [Pa], (3, n).
        """
        self._approach.see_way(way, self._tolerance(1.0))

    def blocks(self, samples: Sequence[Sample]) -> list[Block]:
        """Return the newest samples as a block by itself, or as two where the motion changes."""
        path, begun = self._newest_path(), self._open
        if path is not None or begun is None:
            return [_block_of(samples, path)]
        before = [sample for sample in samples if sample.time < begun.start]
        after = samples[len(before) :]
        return [
            _block_of(part, own) for part, own in ((before, self._path), (after, None)) if part
        ]

    def points_after(self, blocks: Sequence[Block], before: float) -> Points:
        """Return blocks as a record that goes on after the time `before` [s]."""
        return _points(blocks, self.noise_sd, before)


def _block_of(samples: Sequence[Sample], path: Cell | None) -> Block:
    """Return samples as a block, on a path if that goes back to its first."""
    cell = Cell(samples[0].time, True)
    for sample in samples:
        cell.add(sample.time, sample.compression, sample.stress)
    return cell.row() if path is None or cell.start < path.start else cell.row().along(path)


def _points(rows: Sequence[Block], noise_sd: float, before: float | None = None) -> Points:
    """Return blocks as arrays; `before`: the time from which they go on."""
    (
        middle, spread, compression, slope, slope_sd, step, duration, count, stress, seen,
    ) = np.array(rows).T  # fmt: skip
    is_line = spread > 0.0
    block = np.repeat(np.arange(len(rows)), 1 + is_line)
    last = np.cumsum(1 + is_line) - 1
    first = last - is_line
    offsets = -spread[block]
    offsets[last] = spread
    times = middle[block] + offsets
    motion = compression[block] + slope[block] * offsets
    elapsed = np.diff(times, prepend=times[0] if before is None else before)
    bends = np.zeros_like(times)
    # A slope counts by half at three of its standard deviations: friction and delay would else
    # meet the noise of the motion in a hold, which makes them less than they are.
    square, noise = slope**2, (3.0 * noise_sd * slope_sd) ** 2
    speeds = (slope * square / np.where(square > 0.0, square + noise, 1.0))[block]
    if times.size > 2:
        bends[1:-1] = np.abs(np.diff(np.diff(motion) / np.diff(times)))
        speeds = np.where(slope_sd[block] > 0.0, speeds, np.gradient(motion, times))
    # A sample alone knows its step from its neighbours.
    beside, own = np.maximum(elapsed, np.append(elapsed[1:], 0.0)), step[block]
    observed = np.flatnonzero(seen)
    return Points(
        times=times,
        elapsed=elapsed,
        compressions=motion,
        speeds=speeds,
        bends=bends,
        steps=np.where(own > 0.0, np.minimum(own, beside), beside),
        first=first[observed],
        last=last[observed],
        middles=middle[observed],
        durations=(duration + step)[observed],
        counts=count[observed],
        stresses=stress[observed],
        moments=loops.moments(elapsed),
    )
