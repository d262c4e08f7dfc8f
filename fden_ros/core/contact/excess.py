# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Whether the force exceeds what air gives: means over 1 to 16 chunks against such means before.

Over :math:`s` chunks of :math:`n` samples the mean scatters by :math:`\sigma_s/\sqrt{s n}`, where
:math:`\sigma_s` is constant with the scale for white noise, falls for a vibration and grows for a
force that wanders. It is measured in the air at each scale; the threshold is the mean that air
exceeds with a probability of 5e-6, by Student's t.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from fden_ros.core.arrays import Array
from fden_ros.core.contact.chunks import Chunk

#: Means are over so many chunks.
SCALES = (1, 2, 4, 8, 16)
#: Probability that a mean in the air exceeds its threshold: an hour has 180,000 chunks, and what
#: exceeds it must still be explained better by a contact than by a drift.
_CHANCE = 5e-6
#: Longer means are expected to scatter as white noise has it, with the weight of so many of them.
_EXPECTED = 8


class Excess(NamedTuple):
    """The mean of the newest chunks at the scale where it exceeds the air most."""

    ratio: float  #: of the mean above the bias to its threshold [1]
    threshold: float  #: [N]
    scale: int  #: chunks that are averaged


def scatter_of(means: Array, size: float, noise: float) -> tuple[Array, Array]:
    """Return the standard deviation of means in the air [N] and its degrees of freedom, per scale.

    Parameters
    ----------
    means : ndarray, shape (n,)
        Of the chunks in the air [N]; their successive differences count (Allan's variance).
    size : float
        Samples in a chunk.
    noise : float
        Standard deviation per sample within the chunks [N].

    Returns
    -------
    sd, freedom : ndarray, shape (scales,)
    """
    found: list[tuple[float, float]] = []
    freedom, variance = means.size * (size - 1.0), noise**2
    for scale in SCALES:
        count = means.size // scale
        weight = _EXPECTED if means.size == 0 else min(freedom, _EXPECTED)
        freedom = max(count - 1, 0)
        averaged = means[means.size - count * scale :].reshape(count, scale).mean(axis=1)
        steps = np.diff(averaged)
        square_sum = 0.5 * scale * size * float(steps @ steps)
        variance = (square_sum + weight * variance) / (freedom + weight)
        freedom += weight
        found.append((math.sqrt(variance / (scale * size)), freedom))
    sd, degrees = np.array(found).T
    return sd, degrees


def thresholds_of(sd: Array, freedom: Array) -> Array:
    """Return the means that air exceeds with a probability of 5e-6 [N], shape (scales,)."""
    limits: Array = -stdtrit(freedom, _CHANCE) * sd
    return limits


def rises_of(newest: Iterable[Chunk], bias: Callable[[int], float]) -> Array:
    """Return the means of the newest chunks, the last one first, above the bias [N], per scale.

    `bias` gives the force without contact [N] at a stamp.
    """
    found = []
    size, total = 0, 0.0
    for count, chunk in enumerate(newest, start=1):
        size += chunk.size
        total += chunk.size * (chunk.mean - bias(chunk.end_ns))
        if count in SCALES:
            found.append(total / size)
    return np.array(found)


def deepest_fall(means: Array, scale: int) -> float:
    """Return how far means over `scale` of the chunks fell below the bias [N]."""
    if means.size < scale:
        return 0.0
    sums = np.cumsum(np.concatenate([[0.0], means]))
    return max(-float((sums[scale:] - sums[:-scale]).min()) / scale, 0.0)
