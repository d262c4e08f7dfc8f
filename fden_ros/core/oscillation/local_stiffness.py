# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Stiffness of the place under a palpating probe, from one window of palpation after another.

A window gives the complex stiffness :math:`k = F / X` with a variance :math:`\sigma^2 / |X|^2`.
Surface motion, drift and a place that changes scatter k from window to window: that scatter is
what is measured. Several dynamic linear models run next to each other (West and Harrison, Bayesian
Forecasting and Dynamic Models, 1997, ch. 4 and 12): each discounts older windows by its own
factor, learns sigma with an inverse-gamma law, and counts by how well it predicted the latest
windows. The posterior is a mixture of Student's t. A window costs constant time and memory.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import NOT_BY_CHANCE, Array

#: Part of its weight that a window keeps when the next one comes, one per model: memories of
#: 33, 6, 2.5 windows, and of the newest alone. The same of the scatter and of the evidence.
_DISCOUNTS = np.array([0.97, 0.84, 0.6, 0.2])
_DISCOUNT = 0.9
#: Expected scatter, in multiples of the white noise: a prior of one degree of freedom.
_COLOUR = 3.0
#: A window enters the scatter as at most this normalised square beyond that of its best model:
#: crossing an edge must not count as noise forever.
_MOST_SQUARE = 5.0


class Stiffness(NamedTuple):
    """Complex stiffness k' + j k'' at the palpation's frequency."""

    value: complex  #: [N/m]
    covariance: Array  #: of its two parts [(N/m)^2], shape (2, 2)

    @property
    def uncertain(self) -> float:
        """How far the real part may be off by chance [N/m]."""
        return NOT_BY_CHANCE * math.sqrt(max(float(self.covariance[0, 0]), 0.0))


class LocalStiffness:
    """Follows the stiffness window after window."""

    def __init__(self) -> None:
        count = _DISCOUNTS.size
        self.windows = 0  #: taken since the beginning
        self._mean = np.zeros(count, dtype=complex)
        self._precision = np.zeros(count)  # in units of 1/sigma^2 [m^2]
        # Along k and across it: a place that changes scatters the magnitude, not the phase.
        self._squares = np.zeros((2, count))  # [N^2]
        self._freedom = 1.0
        self._log_weights = np.zeros(count)

    def add(self, stiffness: complex, amplitude: float, sd: float) -> None:
        """Add a window: F / X [N/m], |X| [m], and the deviation by white noise alone [N/m]."""
        information = amplitude**2
        self.windows += 1
        if self.windows == 1:
            self._mean += stiffness
            self._precision += information
            self._squares += (_COLOUR * sd * amplitude) ** 2 + 1e-300
            return
        precision = _DISCOUNTS * self._precision
        freedom = _DISCOUNT * self._freedom
        squares = _DISCOUNT * self._squares
        error = stiffness - self._mean
        turned = error * (stiffness / (abs(stiffness) or 1.0)).conjugate()
        spread = 1.0 / precision + 1.0 / information
        normalized = np.stack([turned.real, turned.imag]) ** 2 / spread  # times sigma^2
        # Predictive densities of the parts, Student's t; their constants are equal.
        log_density = -0.5 * np.log(squares * spread) - 0.5 * (freedom + 1.0) * np.log1p(
            normalized / squares
        )
        self._log_weights = _DISCOUNT * self._log_weights + log_density.sum(axis=0)
        self._log_weights -= self._log_weights.max()
        self._precision = precision + information
        self._mean = self._mean + information / self._precision * error
        # Noise of the first windows may be large even under the best model.
        most = _MOST_SQUARE * squares / freedom + normalized.min(axis=1, keepdims=True)
        self._squares = squares + np.minimum(normalized, most)
        self._freedom = freedom + 1.0

    def value(self) -> Stiffness | None:
        """Return the stiffness at the newest window; None while its variance is infinite."""
        if self._freedom <= 2.0:
            return None
        weights = np.exp(self._log_weights)
        weights /= weights.sum()
        mean = complex(weights @ self._mean)
        apart = self._mean - mean
        # The variance of a Student's t is that of its scale times freedom / (freedom - 2).
        own = self._squares / (self._freedom - 2.0) / self._precision
        parts = np.stack([apart.real, apart.imag])
        direction = mean / (abs(mean) or 1.0)
        turn = np.array([[direction.real, -direction.imag], [direction.imag, direction.real]])
        covariance = (parts * weights) @ parts.T + (turn * (own @ weights)) @ turn.T
        return Stiffness(mean, covariance)
