# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Estimators of others, to stand beside FDEN: contact models by recursive least squares.

Each learns from samples of time [s], displacement into the tissue [m] and force [N], and predicts
the force of a further motion. Kelvin-Voigt, :math:`F = K x + B \dot x`, is linear. Hunt-Crossley,

.. math:: F = k x^n + \lambda x^n \dot x,

is identified in two ways: by two interconnected estimators, one for k and lambda, one for n (N.
Diolaiti, C. Melchiorri, S. Stramigioli, IEEE Trans. Robot. 21 (2005) 925), and by one that is
linear in the logarithm, :math:`\ln F \approx \ln k + (\lambda/k) \dot x + n \ln x` (A. Haddadi, K.
Hashtrudi-Zaad, IEEE Trans. Robot. 28 (2012) 813). The linear fractional model is :math:`F =
K\,D^\alpha x`. The recursive ones forget with a time constant of 1 s: it makes them better.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import gamma

from fden_ros.core.arrays import Array

#: A prior that says nothing: variance of every coefficient in units of its own scale squared.
_WIDE = 1e6
#: Hunt-Crossley holds in contact: shallower samples are left out [m].
_LEAST_DEPTH = 1e-5
#: Bounds of the exponent, and of the exponential in a prediction.
_LARGEST_EXPONENT, _LARGEST_LOG = 10.0, 50.0
_ORDERS = np.linspace(0.0, 0.9, 181)
_FORGETTING_TIME = 1.0


class Samples(NamedTuple):
    """What was measured; arrays of shape (n,)."""

    times: Array  #: [s]
    depths: Array  #: [m]
    forces: Array  #: [N]

    @property
    def velocities(self) -> Array:
        """Backward difference quotients [m/s], the first one as the second."""
        rates: Array = np.diff(self.depths) / np.diff(self.times)
        return np.append(rates[:1], rates)

    @property
    def forgetting(self) -> float:
        """Weight of the past at each sample."""
        return math.exp(-float(np.median(np.diff(self.times))) / _FORGETTING_TIME)


#: From what is seen, and times and depths of what is to come, to its force [N].
Peer = Callable[[Samples, Samples], Array]


class RecursiveLeastSquares:
    """Recursive least squares with exponential forgetting.

    Parameters
    ----------
    scales : sequence of float
        Rough sizes of the coefficients; a thousand times that is the deviation at the start.
    forgetting : float
        Weight of the past at each sample, 1: all samples alike.
    start : sequence of float, optional
        Coefficients to start from; by default 0.

    Examples
    --------
    >>> line = RecursiveLeastSquares([1.0, 1.0])
    >>> for x in (0.0, 1.0, 2.0):
    ...     line.add(np.array([1.0, x]), 3.0 + 2.0 * x)
    >>> np.round(line.coefficients, 4)
    array([3., 2.])
    """

    def __init__(
        self, scales: Sequence[float], forgetting: float = 1.0, start: Sequence[float] = ()
    ) -> None:
        self.coefficients: Array = np.array(start or [0.0] * len(scales))
        self._covariance = np.diag(_WIDE * np.array(scales) ** 2)
        self._forgetting = forgetting

    def add(self, regressors: Array, value: float) -> None:
        """Take one equation: regressors @ coefficients = value."""
        by_covariance = self._covariance @ regressors
        gain = by_covariance / (self._forgetting + regressors @ by_covariance)
        self.coefficients = self.coefficients + gain * (value - regressors @ self.coefficients)
        covariance = (self._covariance - np.outer(gain, by_covariance)) / self._forgetting
        self._covariance = 0.5 * (covariance + covariance.T)


def last_value(seen: Samples, ahead: Samples) -> Array:
    """Predict that the force stays as it was last."""
    return np.full(ahead.times.size, seen.forces[-1])


def kelvin_voigt(seen: Samples, ahead: Samples) -> Array:
    """Predict F = K x + B dx/dt."""
    estimator = RecursiveLeastSquares([1e3, 1e3], seen.forgetting)
    for x, v, f in zip(seen.depths, seen.velocities, seen.forces, strict=True):
        estimator.add(np.array([x, v]), float(f))
    stiffness, damping = estimator.coefficients
    result: Array = stiffness * ahead.depths + damping * ahead.velocities
    return result


def diolaiti(seen: Samples, ahead: Samples) -> Array:
    """Predict Hunt-Crossley by two interconnected estimators."""
    linear = RecursiveLeastSquares([1e3, 1e3], seen.forgetting)
    exponent = RecursiveLeastSquares([1e-2], seen.forgetting, [1.0])
    for x, v, f in zip(seen.depths, seen.velocities, seen.forces, strict=True):
        if x < _LEAST_DEPTH or f <= 0.0:
            continue
        power = x ** float(exponent.coefficients[0])
        linear.add(np.array([power, power * v]), float(f))
        effective = linear.coefficients @ np.array([1.0, v])
        if effective > 0.0:
            exponent.add(np.array([math.log(x)]), math.log(f / effective))
            np.clip(exponent.coefficients, 0.0, _LARGEST_EXPONENT, out=exponent.coefficients)
    stiffness, damping = linear.coefficients
    power = np.maximum(ahead.depths, 0.0) ** float(exponent.coefficients[0])
    result: Array = power * (stiffness + damping * ahead.velocities)
    return result


def haddadi(seen: Samples, ahead: Samples) -> Array:
    """Predict Hunt-Crossley by one estimator, linear in the logarithm."""
    estimator = RecursiveLeastSquares([10.0, 1e3, 1.0], seen.forgetting, [0.0, 0.0, 1.0])
    for x, v, f in zip(seen.depths, seen.velocities, seen.forces, strict=True):
        if x >= _LEAST_DEPTH and f > 0.0:
            estimator.add(np.array([1.0, v, math.log(x)]), math.log(f))
    log_stiffness, damping, exponent = estimator.coefficients
    depth = np.log(np.maximum(ahead.depths, _LEAST_DEPTH))
    static = np.exp(np.clip(log_stiffness + exponent * depth, -_LARGEST_LOG, _LARGEST_LOG))
    result: Array = static * (1.0 + damping * ahead.velocities)
    return result


def linear_fractional(seen: Samples, ahead: Samples) -> Array:
    """Predict F = K D^alpha x, by least squares in K at every order of a fine grid."""

    def misfit(order: float) -> tuple[float, float, float]:
        response = fractional_derivative(seen.times, seen.depths, order)
        stiffness = float(seen.forces @ response / (response @ response))
        return float(np.sum((seen.forces - stiffness * response) ** 2)), order, stiffness

    _, order, stiffness = min(misfit(float(order)) for order in _ORDERS)
    times, depths = np.append(seen.times, ahead.times), np.append(seen.depths, ahead.depths)
    result: Array = stiffness * fractional_derivative(times, depths, order)[seen.times.size :]
    return result


def fractional_derivative(times: Array, values: Array, order: float) -> Array:
    """Return Caputo's D^order of samples that are linear in between, from rest, shape (n,)."""
    lag = np.maximum(times[:, None] - times[None, :], 0.0) ** (1.0 - order)
    rates = np.diff(values) / np.diff(times)
    result: Array = (lag[:, :-1] - lag[:, 1:]) @ rates / gamma(2.0 - order)
    return result


PEERS: dict[str, Peer] = {
    "last value": last_value,
    "linear fractional": linear_fractional,
    "Kelvin-Voigt": kelvin_voigt,
    "Hunt-Crossley, Diolaiti": diolaiti,
    "Hunt-Crossley, Haddadi": haddadi,
}
