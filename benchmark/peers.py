# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Estimators of others, to stand beside FDEN: contact models by least squares.

Each learns from samples of time [s], displacement into the tissue [m] and force [N], and predicts
the force of a further motion. Kelvin-Voigt, :math:`F = K x + B \dot x`, is linear. Hunt-Crossley,

.. math:: F = k x^n + \lambda x^n \dot x,

is linear in the logarithm, :math:`\ln F \approx \ln k + (\lambda/k) \dot x + n \ln x` (A. Haddadi,
K. Hashtrudi-Zaad, IEEE Trans. Robot. 28 (2012) 813). Both forget with a time constant of 1 s: it
makes them better. The linear fractional model is :math:`F = K\,D^\alpha x`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array

#: Hunt-Crossley holds in contact: shallower samples are left out [m].
_LEAST_DEPTH = 1e-5
#: Bound of the exponential in a prediction.
_LARGEST_LOG = 50.0
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
    def weights(self) -> Array:
        """What is left of each sample at the last, shape (n,)."""
        weights: Array = np.exp((self.times - self.times[-1]) / _FORGETTING_TIME)
        return weights


#: From what is seen, and times and depths of what is to come, to its force [N].
Peer = Callable[[Samples, Samples], Array]


def fractional_derivative(time: Array, values: Array, order: float) -> Array:
    """Return D^order of a series that is 0 up to its first time, by the L1 scheme.

    Parameters
    ----------
    time : array, shape (n,)
        Increasing times [s], any steps.
    values : array, shape (n,)
        The series, linear in between; its first value is reached at once.
    order : float
        Between 0 and 1.

    Returns
    -------
    array, shape (n,)
        The Caputo derivative of what follows the first value (Oldham and Spanier, The Fractional
        Calculus, 1974, ch. 8.2).
    """
    away = np.maximum(time[:, None] - time, 0.0) ** (1.0 - order)
    slopes = np.diff(values) / np.diff(time)
    result: Array = (away[:, :-1] - away[:, 1:]) @ slopes / math.gamma(2.0 - order)
    return result


def last_value(seen: Samples, ahead: Samples) -> Array:
    """Predict that the force stays as it was last."""
    return np.full(ahead.times.size, seen.forces[-1])


def kelvin_voigt(seen: Samples, ahead: Samples) -> Array:
    """Predict F = K x + B dx/dt."""
    design = np.column_stack([seen.depths, seen.velocities])
    stiffness, damping = _weighted(design, seen.forces, seen.weights)
    result: Array = stiffness * ahead.depths + damping * ahead.velocities
    return result


def hunt_crossley(seen: Samples, ahead: Samples) -> Array:
    """Predict Hunt-Crossley, linear in the logarithm."""
    used = (seen.depths >= _LEAST_DEPTH) & (seen.forces > 0.0)
    depths, velocities = seen.depths[used], seen.velocities[used]
    design = np.column_stack([np.ones_like(depths), velocities, np.log(depths)])
    coefficients = _weighted(design, np.log(seen.forces[used]), seen.weights[used])
    log_stiffness, damping, exponent = coefficients
    depth = np.log(np.maximum(ahead.depths, _LEAST_DEPTH))
    static = np.exp(np.clip(log_stiffness + exponent * depth, -_LARGEST_LOG, _LARGEST_LOG))
    result: Array = static * (1.0 + damping * ahead.velocities)
    return result


def _weighted(design: Array, values: Array, weights: Array) -> Array:
    """Return the coefficients of weighted least squares."""
    root = np.sqrt(weights)
    return np.asarray(np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0])


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


def relaxation_order(times: Array, forces: Array) -> float:
    """Return the order of the linear fractional model after a step at time 0: F = K t^-order."""

    def misfit(order: float) -> float:
        response = times**-order
        stiffness = forces @ response / (response @ response)
        return float(np.sum((forces - stiffness * response) ** 2))

    return float(min(_ORDERS, key=misfit))


PEERS: dict[str, Peer] = {
    "last value": last_value,
    "linear fractional": linear_fractional,
    "Kelvin-Voigt": kelvin_voigt,
    "Hunt-Crossley": hunt_crossley,
}
