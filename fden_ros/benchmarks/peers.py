# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

r"""Estimators of others, to stand beside FDEN: contact models by recursive least squares.

Each takes samples of time [s], displacement into the tissue [m] and force [N], and predicts the
force of a further motion. Kelvin-Voigt, :math:`F = K x + B \dot x`, is linear. Hunt-Crossley,

.. math:: F = k x^n + \lambda x^n \dot x,

is identified in two ways: by two interconnected estimators, one for k and lambda, one for n (N.
Diolaiti, C. Melchiorri, S. Stramigioli, IEEE Trans. Robot. 21 (2005) 925), and by one that is
linear in the logarithm (A. Haddadi, K. Hashtrudi-Zaad, IEEE Trans. Robot. 28 (2012) 813). The
linear fractional model is :math:`F = K\,D^\alpha x`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

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


class Peer(Protocol):
    """An estimator that is told samples in order, and then asked what comes next."""

    def learn(self, times: Array, displacements: Array, forces: Array) -> None:
        """Take samples, each array of shape (n,)."""

    def predict(self, times: Array, displacements: Array) -> Array:
        """Return the force [N] on the motion after the samples, shape (m,)."""


class RecursiveLeastSquares:
    """Recursive least squares with exponential forgetting.

    Parameters
    ----------
    scales : sequence of float
        Rough sizes of the coefficients; the start is 0 with a thousand times that as deviation.
    forgetting : float
        Weight of the past at each sample, 1: all samples alike.
    start : sequence of float, optional
        Coefficients to start from.

    Examples
    --------
    >>> line = RecursiveLeastSquares([1.0, 1.0])
    >>> for x in (0.0, 1.0, 2.0):
    ...     line.add(np.array([1.0, x]), 3.0 + 2.0 * x)
    >>> np.round(line.coefficients, 4)
    array([3., 2.])
    """

    def __init__(
        self,
        scales: list[float],
        forgetting: float = 1.0,
        start: list[float] | None = None,
    ) -> None:
        self.coefficients: Array = np.array(start if start is not None else [0.0] * len(scales))
        self._covariance = np.diag(_WIDE * np.array(scales) ** 2)
        self._forgetting = forgetting

    def add(self, regressors: Array, value: float) -> None:
        """Take one equation: regressors @ coefficients = value."""
        by_covariance = self._covariance @ regressors
        gain = by_covariance / (self._forgetting + regressors @ by_covariance)
        self.coefficients = self.coefficients + gain * (value - regressors @ self.coefficients)
        covariance = (self._covariance - np.outer(gain, by_covariance)) / self._forgetting
        self._covariance = 0.5 * (covariance + covariance.T)


@dataclass
class KelvinVoigt:
    """F = K x + B dx/dt, by recursive least squares."""

    forgetting: float = 1.0
    coefficients: Array = field(default_factory=lambda: np.zeros(2))

    def learn(self, times: Array, displacements: Array, forces: Array) -> None:
        """Take samples, each array of shape (n,)."""
        estimator = RecursiveLeastSquares([1e3, 1e3], self.forgetting)
        for x, v, f in zip(displacements, _velocity(times, displacements), forces, strict=True):
            estimator.add(np.array([x, v]), float(f))
        self.coefficients = estimator.coefficients

    def predict(self, times: Array, displacements: Array) -> Array:
        """Return the force [N], shape (m,)."""
        stiffness, damping = self.coefficients
        result: Array = stiffness * displacements + damping * _velocity(times, displacements)
        return result


@dataclass
class DiolaitiHuntCrossley:
    """Hunt-Crossley by two interconnected recursive estimators (Diolaiti et al. 2005)."""

    forgetting: float = 1.0
    coefficients: Array = field(default_factory=lambda: np.zeros(2))
    exponent: float = 1.0

    def learn(self, times: Array, displacements: Array, forces: Array) -> None:
        """Take samples, each array of shape (n,)."""
        linear = RecursiveLeastSquares([1e3, 1e3], self.forgetting)
        exponent = RecursiveLeastSquares([1e-2], self.forgetting, [1.0])
        for x, v, f in zip(displacements, _velocity(times, displacements), forces, strict=True):
            if x < _LEAST_DEPTH or f <= 0.0:
                continue
            power = x ** float(exponent.coefficients[0])
            linear.add(np.array([power, power * v]), float(f))
            stiffness, damping = linear.coefficients
            effective = stiffness + damping * v
            if effective > 0.0:
                exponent.add(np.array([math.log(x)]), math.log(f / effective))
                np.clip(exponent.coefficients, 0.0, _LARGEST_EXPONENT, out=exponent.coefficients)
        self.coefficients = linear.coefficients
        self.exponent = float(exponent.coefficients[0])

    def predict(self, times: Array, displacements: Array) -> Array:
        """Return the force [N], shape (m,)."""
        stiffness, damping = self.coefficients
        power = np.maximum(displacements, 0.0) ** self.exponent
        result: Array = power * (stiffness + damping * _velocity(times, displacements))
        return result


@dataclass
class HaddadiHuntCrossley:
    r"""Hunt-Crossley by one recursive estimator (Haddadi and Hashtrudi-Zaad 2012).

    :math:`\ln F \approx \ln k + (\lambda/k) \dot x + n \ln x`, for a small
    :math:`\lambda \dot x / k`.
    """

    forgetting: float = 1.0
    coefficients: Array = field(default_factory=lambda: np.zeros(3))

    def learn(self, times: Array, displacements: Array, forces: Array) -> None:
        """Take samples, each array of shape (n,)."""
        estimator = RecursiveLeastSquares([10.0, 1e3, 1.0], self.forgetting, [0.0, 0.0, 1.0])
        for x, v, f in zip(displacements, _velocity(times, displacements), forces, strict=True):
            if x >= _LEAST_DEPTH and f > 0.0:
                estimator.add(np.array([1.0, v, math.log(x)]), math.log(f))
        self.coefficients = estimator.coefficients

    def predict(self, times: Array, displacements: Array) -> Array:
        """Return the force [N], shape (m,)."""
        log_stiffness, damping, exponent = self.coefficients
        depth = np.log(np.maximum(displacements, _LEAST_DEPTH))
        static = np.exp(np.clip(log_stiffness + exponent * depth, -_LARGEST_LOG, _LARGEST_LOG))
        result: Array = static * (1.0 + damping * _velocity(times, displacements))
        return result


@dataclass
class LinearFractional:
    """F = K D^alpha x, by least squares in K at every order of a fine grid."""

    order: float = 0.0
    stiffness: float = 0.0
    times: Array = field(default_factory=lambda: np.zeros(0))
    displacements: Array = field(default_factory=lambda: np.zeros(0))

    def learn(self, times: Array, displacements: Array, forces: Array) -> None:
        """Take samples, each array of shape (n,)."""
        least = math.inf
        for order in _ORDERS:
            response = fractional_derivative(times, displacements, float(order))
            stiffness = float(forces @ response / (response @ response))
            misfit = float(np.sum((forces - stiffness * response) ** 2))
            if misfit < least:
                least, self.order, self.stiffness = misfit, float(order), stiffness
        self.times, self.displacements = times, displacements

    def predict(self, times: Array, displacements: Array) -> Array:
        """Return the force [N], shape (m,)."""
        response = fractional_derivative(
            np.append(self.times, times),
            np.append(self.displacements, displacements),
            self.order,
        )
        result: Array = self.stiffness * response[self.times.size :]
        return result


@dataclass
class LastValue:
    """The force stays as it was last."""

    force: float = 0.0

    def learn(self, times: Array, displacements: Array, forces: Array) -> None:
        """Take samples, each array of shape (n,)."""
        self.force = float(forces[-1])

    def predict(self, times: Array, displacements: Array) -> Array:
        """Return the force [N], shape (m,)."""
        return np.full(times.size, self.force)


def fractional_derivative(times: Array, values: Array, order: float) -> Array:
    """Return Caputo's D^order of samples that are linear in between, from rest, shape (n,)."""
    lag = np.maximum(times[:, None] - times[None, :], 0.0) ** (1.0 - order)
    rates = np.diff(values) / np.diff(times)
    result: Array = (lag[:, :-1] - lag[:, 1:]) @ rates / gamma(2.0 - order)
    return result


def _velocity(times: Array, displacements: Array) -> Array:
    """Return the backward difference quotients [m/s], the first one as the second, shape (n,)."""
    if times.size < 2:
        return np.zeros(times.size)
    rates: Array = np.diff(displacements) / np.diff(times)
    return np.append(rates[0], rates)
