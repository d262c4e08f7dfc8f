# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Limits of axes that a value gone astray, or an interval of the prior's width, does not spoil."""

from __future__ import annotations

import numpy as np

from fden_ros.core.arrays import Array

#: Values farther than this factor from the median are astray.
_ASTRAY = 20.0
#: Intervals are shown up to this many times their value, and down to its inverse.
_INTERVAL = 3.0
#: Part of the distance between the limits that is left free at each end.
_MARGIN = 0.08


def interval_limits(values: Array, low: Array, high: Array) -> tuple[float, float]:
    """Return limits for positive values with their intervals.

    Parameters
    ----------
    values, low, high : ndarray, shape (n,)
        What is not finite or not positive is left out.

    Returns
    -------
    tuple of float
        Lower and upper limit; (0, 1) where there is no value.
    """
    is_good = np.isfinite(values) & (values > 0.0)
    if not is_good.any():
        return 0.0, 1.0
    values, low, high = values[is_good], low[is_good], high[is_good]
    middle = np.sort(values)[(values.size - 1) // 2]
    is_near = np.abs(np.log(values / middle)) <= np.log(_ASTRAY)
    values, low, high = values[is_near], low[is_near], high[is_near]
    least = float(np.min(np.fmax(low, values / _INTERVAL)))
    most = float(np.max(np.fmin(high, values * _INTERVAL)))
    margin = _MARGIN * (most - least) or _MARGIN * most
    return least - margin, most + margin


def symmetric_limit(reaches: Array, least: float) -> float:
    """Return the limit of an axis about 0, of at least `least`, for distances from 0 (n,).

    What lies beyond five times the quantile at 0.9 is left out.
    """
    finite = np.abs(reaches[np.isfinite(reaches)])
    if not finite.size:
        return least
    usual = 5.0 * float(np.quantile(finite, 0.9, method="lower"))
    return max(least, 1.1 * float(np.max(finite[finite <= usual], initial=0.0)))
