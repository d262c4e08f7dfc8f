# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Small estimates that several findings share."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from fden_ros.core.arrays import Array

#: The median of the magnitude of a normal variable, in standard deviations.
_MEDIAN_OF_NORMAL = 0.6745


def pooled(values: ArrayLike, sds: ArrayLike) -> tuple[float, float]:
    """Return the mean of values weighted by their variances, and its standard deviation.

    Where the values scatter by more than their deviations, that counts.
    """
    found, each = np.asarray(values, dtype=float), np.asarray(sds, dtype=float)
    # One without any scatter, as of a coarse sensor, outweighs the others, and no more.
    weights = 1.0 / np.square(np.maximum(each, 1e-9 * max(float(each.max()), 1e-9)))
    mean = float(weights @ found / weights.sum())
    misfit = float(weights @ (found - mean) ** 2) / max(found.size - 1, 1)
    return mean, math.sqrt(max(misfit, 1.0) / float(weights.sum()))


def apart_from_neighbours(times: Array, values: Array) -> Array:
    """Return how far samples (n, k) lie from the lines between their neighbours (n - 2, k).

    Scaled so that its standard deviation is that of white noise on the values.
    """
    step = np.diff(times)
    part = (step[:-1] / (step[:-1] + step[1:]))[:, None]
    apart = values[1:-1] - (1.0 - part) * values[:-2] - part * values[2:]
    return np.asarray(apart / np.sqrt(1.0 + part**2 + (1.0 - part) ** 2))


def noise_of(times: Array, values: Array) -> Array:
    """Return the standard deviation per sample of white noise on smooth values (n, k): (k,).

    By the median of their distances from their neighbours, which bends and contacts do not move.
    """
    if times.size < 8:
        return np.full(values.shape[1], np.nan)
    scaled = np.abs(apart_from_neighbours(times, values))
    median = np.median(scaled, axis=0) / _MEDIAN_OF_NORMAL
    # Where most samples repeat, as of a coarse sensor, the median is 0: then the mean square.
    square = np.sqrt(np.mean(scaled**2, axis=0))
    return np.where(median > 0.0, median, square)
