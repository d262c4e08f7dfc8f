# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""One press as a bounded number of blocks: samples in, lines of the motion and mean stresses out.

A block is kept as its mean stress and the line of its motion at two points, a standard deviation
of the times before and after their mean: these have the mean and the quadratic of the block.
Blocks that follow one line within the noise of the motion have that line, or noise of the motion
would count as motion.

- Near the touch every sample is a block of its own.
- A block ends early where the motion leaves its line.
- Where the probe rests, blocks grow with the time since the motion last changed.

The blocks are a function of the samples, not of how these are split into calls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array

#: Duration of a block [s]; of a later one, over the time since the motion left its line [1], and
#: at most [s]; and how long single samples are kept behind the first [s].
BLOCK_TIME, _BLOCK_SHARE, _LONGEST, TOUCH_TIME = 0.01, 0.02, 0.03, 0.05
#: How far the motion may be off its line beside its noise [1]; times that are the same [s].
LINE_TOLERANCE, SAME_TIME = 1.5e-5, 1e-6
#: A block ends where the motion leaves its line by as many standard deviations of the noise [1].
_LINE_DEVIATIONS = 4.0
#: A turn further off than this counts where it is [1].
_KINK = 1e-4
#: Blocks of one press [1]; where there would be more, each two become one.
MOST_BLOCKS = 600
#: Above this noise of the indentation a sample alone tells nothing of the touch [1].
_BLURRED = 5e-5


class Block(NamedTuple):
    """A block as its line, and what was observed."""

    middle: float  #: [s]
    spread: float  #: standard deviation of its times [s]; 0: one sample
    indentation: float  #: [1]
    slope: float  #: [1/s]
    slope_sd: float  #: of the slope over that of a sample [1/s]; 0: one sample has none
    step: float  #: between its samples [s]
    duration: float  #: from its first sample to its last [s]
    samples: int
    stress: float  #: [Pa]
    is_observed: bool

    def along(self, path: Cell) -> Block:
        """Return the same block on the line of a longer one."""
        if path.slope_sd == 0.0:
            return self
        return self._replace(
            indentation=path.at(self.middle), slope=path.line()[3], slope_sd=path.slope_sd
        )


@dataclass
class Cell:
    """Sums over the samples of a block, times counted from its first."""

    start: float
    is_observed: bool
    count: int = 0
    time: float = 0.0
    time_square: float = 0.0
    indentation: float = 0.0
    product: float = 0.0
    stress: float = 0.0
    end: float = 0.0

    @classmethod
    def of(cls, samples: Array) -> Cell:
        """Return the block of observed samples: times, indentations and stresses, (3, n)."""
        t, (u, f) = samples[0] - samples[0, 0], samples[1:]
        time, square, indentation, product, stress = (
            float(one) for one in (t.sum(), t @ t, u.sum(), t @ u, f.sum())
        )
        start, end = float(samples[0, 0]), float(samples[0, -1])
        return cls(start, True, t.size, time, square, indentation, product, stress, end)

    def add(self, time: float, indentation: float, stress: float) -> None:
        """Take a sample."""
        t = time - self.start
        self.count += 1
        self.time += t
        self.time_square += t * t
        self.indentation += indentation
        self.product += t * indentation
        self.stress += stress
        self.end = time

    def merged(self, other: Cell) -> Cell:
        """Return the block of this and the next."""
        shift = other.start - self.start
        square = self.time_square + other.time_square + 2.0 * shift * other.time
        return Cell(
            self.start,
            self.is_observed,
            self.count + other.count,
            self.time + other.time + other.count * shift,
            square + other.count * shift**2,
            self.indentation + other.indentation,
            self.product + other.product + shift * other.indentation,
            self.stress + other.stress,
            other.end,
        )

    def line(self) -> tuple[float, float, float, float]:
        """Return mean time, its standard deviation, mean indentation, and its slope."""
        mean = self.time / self.count
        variance = max(self.time_square / self.count - mean**2, 0.0)
        indentation = self.indentation / self.count
        if self.count == 1 or variance == 0.0:
            return self.start + mean, 0.0, indentation, 0.0
        slope = (self.product / self.count - mean * indentation) / variance
        return self.start + mean, math.sqrt(variance), indentation, slope

    @property
    def slope_sd(self) -> float:
        """Standard deviation of the slope over that of a sample [1/s]; 0: one sample has none."""
        spread = self.line()[1]
        return 1.0 / (spread * math.sqrt(self.count)) if spread > 0.0 else 0.0

    @property
    def step(self) -> float:
        """Time between its samples [s]; 0: it is one sample."""
        return (self.end - self.start) / max(self.count - 1, 1)

    def block(self) -> Block:
        """Return what becomes of it in arrays."""
        return Block(
            *self.line(), self.slope_sd, self.step, self.end - self.start, self.count,
            self.stress / self.count, self.is_observed,
        )  # fmt: skip

    def at(self, time: float) -> float:
        """Return the indentation of the line at a time."""
        mean, _, indentation, slope = self.line()
        return indentation + slope * (time - mean)

    def is_along(self, path: Cell, most: float) -> bool:
        """Whether it goes on along the line of a longer one, but for noise of `most` [1]."""
        begun, width, _, path_slope = path.line()
        middle, spread, indentation, slope = self.line()
        if width == 0.0:
            return self.count == 1
        place = (middle - begun) / width
        mean_sd = math.sqrt(1.0 / self.count + (1.0 + place**2) / path.count)
        if abs(indentation - path.at(middle)) > most * mean_sd:
            return False
        if spread == 0.0:
            return True
        return abs(slope - path_slope) <= most * math.hypot(self.slope_sd, path.slope_sd)


class Record:
    """Takes the samples of one press.

    Parameters
    ----------
    noise_sd : float
        Standard deviation of the indentation of a sample [1].
    reach : float
        How far before its nominal place the touch may be, as indentation [1]; 0: it is known.
    is_at_rest : bool
        That place is where the indentation is 0; else the tissue may be met first where the
        record begins.
    """

    def __init__(self, noise_sd: float, reach: float = 0.0, *, is_at_rest: bool = False) -> None:
        self.noise_sd = noise_sd
        self.approach = Approach(reach, is_at_rest=is_at_rest)
        self._cells: list[Cell] = []
        self._paths: list[Cell] = []  # the lines that blocks have followed
        self._path_of: list[int] = []  # that of each block, by its number
        self._open: Cell | None = None
        self._start: float | None = None
        self._changed = self._turned = 0.0
        self._block_time = BLOCK_TIME
        self.deepest = -math.inf  #: largest indentation observed [1]

    @property
    def blocks(self) -> list[Block]:
        """The complete blocks, with the motion before the first."""
        before = [cell.block() for cell in self.approach.cells(self._cells)]
        own = zip(self._cells, self._path_of, strict=True)
        return before + [cell.block().along(self._paths[path]) for cell, path in own]

    def add(
        self, time: float, indentation: float, stress: float, *, is_observed: bool
    ) -> list[Block]:
        """Take a sample; return the blocks that this completes.

        `is_observed`: its stress counts, not only its motion.
        """
        if self._start is None:
            self._start = self._changed = self._turned = time
        done: list[Block] = []
        if self._open is not None and self._is_complete(
            self._open, time, indentation, is_observed
        ):
            done = self.close()
        if self._open is None:
            self._open = Cell(time, is_observed)
        self._open.add(time, indentation, stress)
        if is_observed:
            self.deepest = max(self.deepest, indentation)
        return done

    def _is_complete(self, cell: Cell, time: float, indentation: float, observed: bool) -> bool:
        """Whether a sample is of another block; takes note where the motion leaves its line."""
        assert self._start is not None
        if cell.is_observed != observed:
            return True
        if cell.start - self._start < (TOUCH_TIME if self.noise_sd < _BLURRED else 0.0):
            # Above 1 kHz the samples there are blocks of 1 ms.
            return time - cell.start > 1e-3 - SAME_TIME
        # Half a step's tolerance, so that jitter of the stamps adds no sample.
        step = (time - cell.start) / cell.count
        later = min(_BLOCK_SHARE * (cell.start - self._turned), _LONGEST)
        whole = max(self._block_time, later)
        if time - cell.start > whole - 0.5 * step + SAME_TIME:
            return True
        if cell.count < 2:
            return False
        spread = math.sqrt(1.0 + 4.0 / cell.count)
        most = LINE_TOLERANCE + _LINE_DEVIATIONS * self.noise_sd * spread
        if abs(indentation - cell.at(time)) <= most:
            return False
        self._turned = time
        return True

    def close(self) -> list[Block]:
        """End the open block; return what this completes."""
        cell, self._open = self._open, None
        if cell is None:
            return []
        done = [cell.block()]
        last, path = (self._cells[-1], self._paths[-1]) if self._cells else (None, None)
        goes_on = path is not None and cell.is_along(path, _LINE_DEVIATIONS * self.noise_sd)
        if path is not None and goes_on:
            self._paths[-1] = path.merged(cell)
            done = [done[0].along(self._paths[-1])]
        if last is not None and self._joins(last, cell):
            cell = last.merged(cell)
            self._cells.pop()
            self._path_of.pop()
        elif path is not None and not goes_on and (end := self._end_of(path, cell)) is not None:
            self._cells.append(end)
            self._path_of.append(len(self._paths) - 1)
            done.insert(0, end.block())
        if not goes_on:
            self._paths.append(cell)
        self._cells.append(cell)
        self._path_of.append(len(self._paths) - 1)
        if len(self._cells) >= MOST_BLOCKS:
            self._halve()
        return done

    def _end_of(self, path: Cell, after: Cell) -> Cell | None:
        """Return the last step of the motion along a path; None: the last block has it nearly.

        The two points of a block are before its end: the motion would turn there.
        """
        last = self._cells[-1]
        middle, spread, _, _ = last.line()
        left = last.end - middle - spread
        if abs(after.line()[3] - path.line()[3]) * left <= _KINK:
            return None
        # Of three or four samples the second point is within the last step.
        end = Cell(max(last.end - last.step, middle + spread), False)
        for time in (end.start, last.end):
            end.add(time, path.at(time), 0.0)
        return end

    def _joins(self, last: Cell, cell: Cell) -> bool:
        """Whether a block goes on with the next; takes note where the motion changes."""
        assert self._start is not None
        off = abs(cell.indentation / cell.count - last.at(cell.line()[0]))
        spread = math.sqrt(1.0 / cell.count + 4.0 / last.count)
        # With 1.5e-5 noise of 0.1 um would move estimates by half a standard deviation.
        if off > 2e-4 + _LINE_DEVIATIONS * self.noise_sd * spread:
            self._changed = cell.start
            return False
        if last.is_observed != cell.is_observed or last.start - self._start < TOUCH_TIME:
            return False
        change = abs(cell.indentation / cell.count - last.indentation / last.count)
        # It may last for a twentieth of the time since the motion changed.
        return (
            change < 5e-4 + _LINE_DEVIATIONS * self.noise_sd * spread
            and cell.end - last.start <= 0.05 * (cell.end - self._changed) + SAME_TIME
        )

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
        self._cells, self._paths, self._path_of = halved, [*halved], [*range(len(halved))]


class Approach:
    """The motion before the first block; the parameters are those of :class:`Record`."""

    def __init__(self, reach: float, *, is_at_rest: bool) -> None:
        self._reach, self._is_at_rest = reach, is_at_rest
        self._seen: list[Cell] = []

    def add(self, motion: Array, tolerance: float) -> None:
        """Take the motion before the first sample, as far as the touch may be before that.

        Parameters
        ----------
        motion : ndarray, shape (3, n)
            Times [s], indentations [1] and stresses [Pa].
        tolerance : float
            Of the indentation [1].
        """
        if not motion.size or not (self._reach or self._is_at_rest):
            return
        nominal = 0.0 if self._is_at_rest else motion[1, -1]
        behind = np.flatnonzero(motion[1] < nominal - self._reach + tolerance)
        first = int(behind[-1]) if behind.size else int(np.argmin(motion[1]))
        times, indentations, _ = own = motion[:, first:]
        # At most 12 parts as long as each other, in time and in the way forward together.
        forward = np.maximum.accumulate(indentations)
        gone = (times - times[0]) / max(np.ptp(times), SAME_TIME)
        gone += (forward - forward[0]) / max(np.ptp(forward), LINE_TOLERANCE)
        places = np.searchsorted(gone, np.linspace(0.0, gone[-1], 13)[1:-1])
        parts = np.split(own, np.unique(places), axis=1)
        self._seen += [Cell.of(part) for part in parts if part.size]

    def cells(self, cells: Sequence[Cell]) -> list[Cell]:
        """Return the motion before the first block where the touch may have been before that one.

        The probe comes as it goes on, along the line of the blocks near the touch; where that is
        longer than these, as it was seen to come.
        """
        if not self._reach and not self._is_at_rest:
            return []
        near = [c for k, c in enumerate(cells) if k < 3 or c.start - cells[0].start < TOUCH_TIME]
        if len(near) < 2:
            return []
        lines = np.array([cell.line()[::2] for cell in near])
        times, indentations = lines[:, 0] - lines[0, 0], lines[:, 1]
        speed, first = np.polyfit(times, indentations, 1).tolist()
        # Tissue that has not recovered from an earlier press is met where the record begins.
        gone = first if self._is_at_rest else min(first, 0.0)
        # A probe is taken to have come along its line for at most 1 s.
        missing = min(gone + self._reach, 1.0 * speed)
        if missing <= 0.0:
            return []
        if self._seen and missing > TOUCH_TIME * speed:
            return self._seen
        before = Cell(float(lines[0, 0]) - missing / speed, False)
        before.add(before.start, first - missing, 0.0)
        return [before]
