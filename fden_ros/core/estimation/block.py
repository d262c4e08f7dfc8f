# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A block of samples: their mean stress, and the line of their motion.

And a record of them as arrays.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array, Indices

#: Time of a block [s]: twice this costs a factor of 3 at a noise of 0.1 mN (test_core_record).
BLOCK_TIME = 0.01
#: Samples are blocks of their own for so long after the first, just before the touch [s].
TOUCH_TIME = 0.05
#: A block ends where the motion leaves its line by this compression [1], beside the noise.
LINE_TOLERANCE = 1.5e-5
#: Times closer than this are the same [s]: rounding must not decide where blocks end and are
#: joined, or two records of one press would have other blocks, whose evidence cannot be compared.
SAME_TIME = 1e-6


class Sample(NamedTuple):
    """One sample of a press."""

    time: float  #: [s]
    compression: float  #: [1]
    stress: float  #: [Pa]


class Block(NamedTuple):
    """A block as its line, and what was observed."""

    middle: float  #: [s]
    spread: float  #: standard deviation of its times [s]
    compression: float  #: [1]
    slope: float  #: [1/s]
    slope_sd: float  #: of the slope over that of a sample [1/s]; 0: one sample has none
    step: float  #: between its samples [s]; 0: it is one sample
    duration: float  #: from its first sample to its last [s]
    samples: int
    stress: float  #: [Pa]
    is_observed: bool

    def along(self, path: Cell) -> Block:
        """Return the same block on the line of a longer one."""
        if path.slope_sd == 0.0:
            return self
        return self._replace(
            compression=path.at(self.middle), slope=path.line()[3], slope_sd=path.slope_sd
        )


@dataclass
class Cell:
    """Sums over the samples of a block, times counted from its first."""

    start: float
    is_observed: bool
    count: int = 0
    time: float = 0.0
    time_square: float = 0.0
    compression: float = 0.0
    product: float = 0.0
    stress: float = 0.0
    end: float = 0.0

    def add(self, time: float, compression: float, stress: float) -> None:
        """Take a sample."""
        t = time - self.start
        self.count += 1
        self.time += t
        self.time_square += t * t
        self.compression += compression
        self.product += t * compression
        self.stress += stress
        self.end = time

    def merged(self, other: Cell) -> Cell:
        """Return the block of this and the next."""
        shift = other.start - self.start
        return Cell(
            self.start,
            self.is_observed,
            self.count + other.count,
            self.time + other.time + other.count * shift,
            self.time_square
            + other.time_square
            + 2.0 * shift * other.time
            + other.count * shift**2,
            self.compression + other.compression,
            self.product + other.product + shift * other.compression,
            self.stress + other.stress,
            other.end,
        )

    def line(self) -> tuple[float, float, float, float]:
        """Return mean time, its standard deviation, mean compression, and its slope."""
        mean = self.time / self.count
        variance = max(self.time_square / self.count - mean**2, 0.0)
        compression = self.compression / self.count
        if self.count == 1 or variance == 0.0:
            return self.start + mean, 0.0, compression, 0.0
        slope = (self.product / self.count - mean * compression) / variance
        return self.start + mean, math.sqrt(variance), compression, slope

    @property
    def slope_sd(self) -> float:
        """Standard deviation of the slope over that of a sample [1/s]; 0: one sample has none."""
        spread = self.line()[1]
        return 1.0 / (spread * math.sqrt(self.count)) if spread > 0.0 else 0.0

    @property
    def step(self) -> float:
        """Time between its samples [s]; 0: it is one sample."""
        return (self.end - self.start) / max(self.count - 1, 1)

    def row(self) -> Block:
        """Return what becomes of it in arrays."""
        return Block(
            *self.line(), self.slope_sd, self.step, self.end - self.start, self.count,
            self.stress / self.count, self.is_observed,
        )  # fmt: skip

    def at(self, time: float) -> float:
        """Return the compression of the line at a time."""
        mean, _, compression, slope = self.line()
        return compression + slope * (time - mean)

    def is_along(self, path: Cell, most: float) -> bool:
        """Whether it goes on along the line of a longer one, but for noise of `most` [1]."""
        begun, width, _, path_slope = path.line()
        middle, spread, compression, slope = self.line()
        if width == 0.0:
            return self.count == 1
        place = (middle - begun) / width
        mean_sd = math.sqrt(1.0 / self.count + (1.0 + place**2) / path.count)
        if abs(compression - path.at(middle)) > most * mean_sd:
            return False
        if spread == 0.0:
            return True
        return abs(slope - path_slope) <= most * math.hypot(self.slope_sd, path.slope_sd)


@dataclass(frozen=True)
class Points:
    """A record as arrays: `n` points of the motion, `m` blocks observed."""

    #: [s, s, 1, 1/s, 1/s]: the second are the steps that end at the points, the fourth the speeds
    #: as far as they are above their noise, the last the changes of the speed there, (n,).
    times: Array
    elapsed: Array
    compressions: Array
    speeds: Array
    bends: Array
    steps: Array  #: longest time between samples beside a point [s], (n,)
    #: Points of the blocks, (m,).
    first: Indices
    last: Indices
    #: Mean times [s], durations [s], samples [1], mean stresses [Pa], (m,).
    middles: Array
    durations: Array
    counts: Array
    stresses: Array
    moments: Array  #: of the steps that end at the points: those of the loops, (n, 4, RATES)

    @functools.cached_property
    def met(self) -> Indices:
        """The first point that each block meets, the one after those of the block before, (m,)."""
        return np.append(self.first[:1], self.last[:-1] + 1)

    def mean(self, values: Array) -> Array:
        """Return the means over the blocks of values at the points, shape (..., m)."""
        return 0.5 * (values[..., self.first] + values[..., self.last])
