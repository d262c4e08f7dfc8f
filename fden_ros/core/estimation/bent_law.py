# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The response to a measured motion of a law whose relaxation and stress-strain curve are bent.

.. math::
    f(t) = \int E(t-s)\,e^{\delta(\ln(t-s))}\, d\left[\varphi(x(s))\,e^{\epsilon(x(s))}\right],
    \qquad E(t) = t^{-\alpha}/\Gamma(1-\alpha)

:math:`\delta` and :math:`\epsilon` are Gaussian processes on hat functions. The state is ln G,
ln Gn, alpha and the strain origin, then delta and epsilon at their knots: 22 numbers.
"""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.contact_record import ContactRecord
from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.law.characteristic import elastic_responses
from fden_ros.core.law.geometry import Geometry
from fden_ros.core.law.kernel import HIGHEST_ORDER, LOWEST_ORDER

#: Hat functions of each deviation [1].
KNOTS = 9
#: Lengths of the correlation: in ln t [1], two decades, and in strain [1], by the evidence of 99
#: presses of beef. In ln t it is Matern's of order 3/2: an exponential one lets neighbours jump by
#: 0.3 where the ramp is rough. In strain it is exponential: with a smoother one two of
#: six presses of silicone are bent no more than beef.
_KERNEL_LENGTH, _STRAIN_LENGTH = 2.0 * math.log(10.0), 0.3
#: Longest step of a state [1].
_LONGEST_STEP = 0.5
#: Differences of alpha and of the strain origin, for the derivatives [1].
_DIFFERENCE = 1e-4
#: The shortest time of the kernel as a share of the contact's duration [1].
_SHORTEST_SHARE = 1e-3

#: The parts of a state.
LAW = slice(0, 4)
KERNEL = slice(4, 4 + KNOTS)
CHARACTERISTIC = slice(4 + KNOTS, 4 + 2 * KNOTS)
_LOG_G, _LOG_GN = StateIndex.LOG_LINEAR_STIFFNESS, StateIndex.LOG_NONLINEAR_STIFFNESS
_ORDER, _ORIGIN = StateIndex.FRACTIONAL_ORDER, StateIndex.STRAIN_ORIGIN


class BentLaw:
    """The response to the motion of one record, beside the stress that was measured.

    Parameters
    ----------
    record : ContactRecord
        Of n + 1 points.
    geometry : Geometry

    Attributes
    ----------
    steps : ndarray, shape (n,)
        From each point to the next [s].
    time_knots, strain_knots : ndarray, shape (9,)
        Where delta (in ln t) and epsilon (in strain) are free [1].
    kernel_precision, characteristic_precision : ndarray, shape (9, 9)
        Inverse of their prior covariances, at a scale of 1.
    """

    def __init__(self, record: ContactRecord, geometry: Geometry) -> None:
        times, compressions, stresses, _ = record.arrays()
        self._geometry = geometry
        self._compressions, self._stresses = compressions[1:], stresses[1:]
        since = np.maximum(times[1:, None] - times, 0.0)
        # Powers of time are wanted again and again: the logarithm of 0 is that of next to nothing.
        self._log_since = np.log(np.maximum(since, np.finfo(np.float64).tiny))
        self.steps: Array = np.diff(times)
        shortest = max(float(np.min(self.steps)), _SHORTEST_SHARE * times[-1])
        middle = 0.5 * (since[:, :-1] + since[:, 1:])
        self.time_knots: Array = np.linspace(math.log(0.5 * shortest), math.log(times[-1]), KNOTS)
        self._in_time = hats(self.time_knots, np.log(np.maximum(middle, 0.25 * shortest)))
        largest = max(geometry.strain(float(compressions.max())), 1e-6)
        self.strain_knots: Array = np.linspace(0.0, largest, KNOTS)
        self.kernel_precision = _inverse_smooth(self.time_knots, _KERNEL_LENGTH)
        self.characteristic_precision = _inverse_exponential(self.strain_knots, _STRAIN_LENGTH)

    def residual(self, state: Array) -> tuple[Array, Array]:
        """Return measured less predicted stress, and the Jacobian of the latter.

        Parameters
        ----------
        state : ndarray, shape (22,)

        Returns
        -------
        residual : ndarray, shape (n,)
            [Pa].
        jacobian : ndarray, shape (n, 22)
        """
        strains = self.strains(state[_ORIGIN])
        in_strain = hats(self.strain_knots, strains)
        bent = np.exp(in_strain @ state[CHARACTERISTIC])
        g, gn = np.exp(state[_LOG_G]), np.exp(state[_LOG_GN])
        elastic = elastic_responses(strains, g, gn)
        moved = elastic_responses(self.strains(state[_ORIGIN] + _DIFFERENCE), g, gn)
        kernel = np.exp(self._in_time @ state[KERNEL])
        order = state[_ORDER]
        gains = self._gains(order) * kernel
        slope = (self._gains(order + _DIFFERENCE) * kernel - gains) / _DIFFERENCE
        change = _changes(elastic.value * bent)
        stress = gains @ change
        jacobian = np.empty((stress.size, state.size))
        jacobian[:, _LOG_G] = stress
        jacobian[:, _LOG_GN] = gains @ _changes(elastic.by_log_nonlinear_stiffness * bent)
        jacobian[:, _ORDER] = slope @ change
        by_origin = (moved.value - elastic.value) / _DIFFERENCE
        jacobian[:, _ORIGIN] = gains @ _changes(by_origin * bent)
        jacobian[:, KERNEL] = ((gains * change)[:, None, :] @ self._in_time)[:, 0]
        response = elastic.value * bent
        jacobian[:, CHARACTERISTIC] = gains @ _changes(response[:, None] * in_strain)
        return self._stresses - stress, jacobian

    def strains(self, origin: float) -> Array:
        """Return the strains [1] in contact, shape (n,); above the surface 0."""
        strains = [self._geometry.strain(float(u)) for u in self._compressions - origin]
        result: Array = np.maximum(strains, 0.0)
        return result

    def _gains(self, order: float) -> Array:
        """Return the mean of E(t) over every step, as seen from the end of every step, (n, n)."""
        power = 1.0 - order
        powers = np.exp(power * self._log_since)
        rise = powers[:, :-1] - powers[:, 1:]
        gains: Array = rise / self.steps / math.gamma(1.0 + power)
        return gains


def stepped(state: Array, step: Array) -> Array:
    """Return a state after a step of its first numbers, no longer than a linearisation holds."""
    result = state.copy()
    result[: step.size] += np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
    result[_ORDER] = min(max(result[_ORDER], LOWEST_ORDER), HIGHEST_ORDER)
    return result


def hats(knots: Array, points: Array) -> Array:
    """Return the hat functions of uniform knots at points of shape (...), (..., knots)."""
    inside = np.clip(points, knots[0], knots[-1])[..., None]
    result: Array = np.maximum(1.0 - np.abs(inside - knots) / (knots[1] - knots[0]), 0.0)
    return result


def _changes(signal: Array) -> Array:
    """Return the change over each step, from 0 at the touch."""
    before = np.zeros_like(signal)
    before[1:] = signal[:-1]
    changes: Array = signal - before
    return changes


def _inverse_smooth(knots: Array, length: float) -> Array:
    distance = math.sqrt(3.0) * np.abs(knots[:, None] - knots[None, :]) / length
    return np.asarray(np.linalg.inv((1.0 + distance) * np.exp(-distance)), dtype=np.float64)


def _inverse_exponential(knots: Array, length: float) -> Array:
    distance = np.abs(knots[:, None] - knots[None, :]) / length
    return np.asarray(np.linalg.inv(np.exp(-distance)), dtype=np.float64)
