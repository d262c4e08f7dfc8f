# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How far the tissue is from the law, read off the law's errors of a solution."""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import LawError
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.smooth_errors import KERNEL_HATS, splines
from fden_ros.core.estimation.solution import Solution
from fden_ros.core.estimation.unknowns import ORDER
from fden_ros.core.law import HIGHEST_ORDER, LOWEST_ORDER, left_after, relaxation_weights

#: Places in time and strain at which the errors are read off [1].
_PLACES = 16
#: The loaded part of the characteristic is above this part of the largest strain [1].
_LOADED = 0.7


def law_error(solution: Solution, model: PressModel, seen: tuple[float, float]) -> LawError:
    """Return root mean squares of the errors over what was seen, with their standard deviations.

    Parameters
    ----------
    model : PressModel
        Of which it is a solution.
    seen : tuple of float
        Time since the touch [s], and largest strain [1].
    """
    kernel, characteristic = model.kernel, model.characteristic
    mean, covariance = solution.mean, solution.covariance
    elapsed, strain = seen
    # From 0.03 of the elapsed time on, and from a tenth of the largest strain.
    times = np.geomspace(0.03 * elapsed, elapsed, _PLACES)
    design, slope = _relaxation_functionals(float(mean[ORDER]), times)
    bend = design @ mean[kernel]
    bend_covariance = design @ covariance[kernel, kernel] @ design.T
    own = np.zeros(mean.size)
    own[ORDER], own[kernel] = 1.0, -slope
    strains = np.linspace(0.1 * strain, strain, _PLACES)
    curve, _ = splines(strains, model.last_knot, characteristic.stop - characteristic.start)
    off = curve @ mean[characteristic]
    off_covariance = curve @ covariance[characteristic, characteristic] @ curve.T
    loaded = strains >= _LOADED * strain
    return LawError(
        *_root_mean_square(bend, bend_covariance),
        *_root_mean_square(off, off_covariance),
        *_root_mean_square(off[loaded], off_covariance[np.ix_(loaded, loaded)]),
        float(own @ mean),
        math.sqrt(max(float(own @ covariance @ own), 0.0)),
    )


def _relaxation_functionals(order: float, times: Array) -> tuple[Array, Array]:
    """Return the kernel's error at times less its line in ln t, and the line's slope, by knots."""
    weights = relaxation_weights(float(np.clip(order, LOWEST_ORDER, HIGHEST_ORDER)))
    after = weights * left_after(times)
    errors = (after / after.sum(axis=1, keepdims=True)) @ KERNEL_HATS
    logs = np.log(times)
    line = np.column_stack([np.ones(times.size), logs - logs.mean()])
    fit = np.linalg.pinv(line)
    return errors - line @ fit @ errors, fit[1] @ errors


def _root_mean_square(values: Array, covariance: Array) -> tuple[float, float]:
    size = math.sqrt(float(np.mean(values**2)))
    return size, math.sqrt(max(float(np.mean(covariance.diagonal())), 0.0))
