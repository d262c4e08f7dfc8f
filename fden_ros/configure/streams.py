# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Force and motion of a probe as recorded, nothing projected or scaled; and their noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from fden_ros.core.arrays import Array


@dataclass(frozen=True)
class Streams:
    """One recording: force and position with their stamps, in the units of the recording."""

    name: str  #: of the recording
    force_times: Array  #: stamps [s], increasing (n,)
    force: Array  #: (n, 3) of a wrench, (n, 1) of a number
    motion_times: Array  #: stamps [s], increasing (m,)
    position: Array  #: (m, 3) of a pose, (m, 1) of a joint
    #: Unit quaternions x, y, z, w that turn the sensor's frame into the positions' (m, 4).
    orientation: Array | None = None

    @property
    def start(self) -> float:
        """First stamp that both streams have reached [s]."""
        return float(max(self.force_times[0], self.motion_times[0]))

    @property
    def end(self) -> float:
        """Last stamp that both streams have [s]."""
        return float(min(self.force_times[-1], self.motion_times[-1]))

    def rotation_at(self, times: Array) -> Rotation | None:
        """Return the sensor's orientation at `times` (n,)."""
        if self.orientation is None:
            return None
        flips = np.sum(self.orientation[1:] * self.orientation[:-1], axis=1) < 0.0
        signs = np.where(np.cumsum([False, *flips]) % 2 == 1, -1.0, 1.0)
        parts = (signs[:, None] * self.orientation).T
        turns = [np.interp(times, self.motion_times, part) for part in parts]
        return Rotation.from_quat(np.stack(turns, axis=1))

    def turn_rates(self, times: Array) -> Array:
        """Return how fast the tool turns between `times` (n,): (n - 1,) [rad/s]; 0: not known."""
        turns = self.rotation_at(times)
        if turns is None:
            return np.zeros(times.size - 1)
        return np.asarray((turns[1:] * turns[:-1].inv()).magnitude() / np.diff(times))


def pooled(values: ArrayLike, sds: ArrayLike) -> tuple[float, float]:
    """Return the mean weighted by the variances, and its deviation, which scatter widens."""
    found, each = np.asarray(values, dtype=float), np.asarray(sds, dtype=float)
    # One without any scatter, as of a coarse sensor, must not outweigh all others.
    weights = 1.0 / np.square(np.maximum(each, 1e-9 * max(float(each.max()), 1e-9)))
    mean = float(weights @ found / weights.sum())
    misfit = float(weights @ (found - mean) ** 2) / max(found.size - 1, 1)
    return mean, math.sqrt(max(misfit, 1.0) / float(weights.sum()))


def apart_from_neighbours(times: Array, values: Array) -> Array:
    """Return how far samples (n, k) lie from the lines between their neighbours (n - 2, k).

    Its standard deviation is that of white noise on the values.
    """
    step = np.diff(times)
    part = (step[:-1] / (step[:-1] + step[1:]))[:, None]
    apart = values[1:-1] - (1.0 - part) * values[:-2] - part * values[2:]
    return np.asarray(apart / np.sqrt(1.0 + part**2 + (1.0 - part) ** 2))


def noise_of(times: Array, values: Array) -> Array:
    """Return the standard deviation per sample of white noise on smooth values (n, k): (k,).

    By the median of their distances from their neighbours, which bends and contacts do not move.
    """
    scaled = np.abs(apart_from_neighbours(times, values))
    # The median of the magnitude of a normal variable is 0.6745 standard deviations.
    median = np.median(scaled, axis=0) / 0.6745
    # Where most samples repeat, as of a coarse sensor, the median is 0: then the mean square.
    square = np.sqrt(np.mean(scaled**2, axis=0))
    return np.where(median > 0.0, median, square)
