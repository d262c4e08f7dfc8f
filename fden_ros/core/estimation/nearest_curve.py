# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The law's stress-strain curve that is nearest to one that bends away from it.

A curve that bends like another G or Gn is the law's; only what is left is an error of the law.
"""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import elastic_responses

#: Gauss-Newton steps of ln Gn, or halves of one, from each start [1], and the longest [1].
_STEPS, _LONGEST_STEP = 12, 0.5
#: Gn times the largest strain at which a search starts, beside that of the fit [1].
_STARTS = (1.5, 3.0, 6.0)


def nearest_curve(strains: Array, wanted: Array, log_gn: float, weights: Array | None) -> float:
    """Return ln Gn of the law's curve that is nearest to a logarithm of stress (n,).

    A Gn below 1/strain gives a line and no slope by which to leave it: other starts lie beyond.
    """
    root = np.ones(strains.size) if weights is None else np.sqrt(weights)
    starts = [log_gn, *(math.log(factor / strains[-1]) for factor in _STARTS)]
    return min(_descend(strains, wanted, start, root) for start in starts)[1]


def _descend(strains: Array, wanted: Array, log_gn: float, root: Array) -> tuple[float, float]:
    """Return the squared distance of the nearest curve found from a start, and its ln Gn."""

    def beside(tried: float) -> tuple[float, float]:
        left, absorbed = beside_the_law(strains, wanted, tried)
        target, columns = root * left, root[:, None] * absorbed
        step = float(np.linalg.lstsq(columns, target, rcond=None)[0][1])
        target = target - columns[:, 0] * (
            columns[:, 0] @ target / (columns[:, 0] @ columns[:, 0])
        )
        return float(target @ target), min(max(step, -_LONGEST_STEP), _LONGEST_STEP)

    distance, step = beside(log_gn)
    for _ in range(_STEPS):
        tried_distance, next_step = beside(log_gn + step)
        if tried_distance < distance:
            log_gn, distance, step = log_gn + step, tried_distance, next_step
        else:
            step *= 0.5
    return distance, log_gn


def beside_the_law(strains: Array, wanted: Array, log_gn: float) -> tuple[Array, Array]:
    """Return how far the logarithm of a curve (n,) is from the law's, and what G, Gn absorb."""
    elastic = elastic_responses(strains, 1.0, math.exp(log_gn))
    by_gn = elastic.by_log_nonlinear_stiffness / elastic.value
    absorbed = np.stack([np.ones_like(strains), by_gn], axis=1)
    return wanted - np.log(elastic.value), absorbed
