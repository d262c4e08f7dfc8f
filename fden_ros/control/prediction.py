# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Force that the law predicts for a planned motion, with its interval.

The exponential moments of the measured stress hold the tissue's memory. Along the plan

.. math:: D^{-\alpha} f(t) = \varphi(x(t)) + r, \qquad r = D^{-\alpha} f(0) - \varphi(x(0)),

so that the prediction begins at the measured value, and the present error of law and rig
stays constant.

The interval is first-order in the law's parameters and r, plus the variance of the growth of that
error,

.. math::
    v(t) = \int 2 f^2 \sigma_c^2\,|d\ln\varphi| + (k^2\sigma_s^2 + c^2\sigma_d^2)\,dt
    + \left( f\,\sigma_k \ln\frac{A(t)}{A(0)} \right)^2

with :math:`\sigma_c` and :math:`\sigma_k` the relative errors of curve and relaxation, A the age
of the loading, k the stiffness against the motion of the surface, c the stress by force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import NOTHING_UNKNOWN, Estimate, Uncertainty
from fden_ros.core.law import (
    RATE_COUNT,
    SHORTEST_STEP,
    Geometry,
    StressMoments,
    apparent_stiffness_factor,
    elastic_responses,
    memory_weights,
    passed,
)
from fden_ros.errors import InputError

#: Least number of steps of a plan.
_POINTS = 40
#: Derivatives are differences over this part of a standard deviation [1].
_DERIVATIVE_PART = 0.1
#: Least elastic response, by its slope at small strain, whose relative change counts [1].
_LEAST_RESPONSE = 1e-3
#: Multiple of the stated deviation of the relaxation: at the end of a ramp a linear solid of 1 s
#: looks like the law of a wrong alpha. Least age of a loading [s]: that of one block.
_LAW_ALONE, _LEAST_AGE = 2.0, 0.01


@dataclass(frozen=True)
class Prediction:
    """The predicted force, with its deviation."""

    times: Array  #: [s] from the present, shape (n,)
    value: Array  #: force [N], shape (n,)
    sd: Array  #: its standard deviation, shape (n,)

    def interval(self, deviations: float = 2.0) -> tuple[Array, Array]:
        """Return lower and upper bound at a number of standard deviations, shape (n,) each."""
        return self.value - deviations * self.sd, self.value + deviations * self.sd


class TissueMemory(StressMoments):
    """The stress history of a place, in constant memory; `strain` [1], `stress` [Pa] now."""

    strain = stress = 0.0

    def press(self, step: float, strain: float, stress: float) -> None:
        """Add a sample `step` seconds after the last: strain [1] and stress [Pa], 0 in the air."""
        self.add(step, self.stress, stress)
        self.strain, self.stress = strain, stress

    def is_free(self, step: float, strain: float, estimate: Estimate) -> bool:
        """Whether the tissue would have to pull at the probe `step` seconds from the present."""
        decay, gain = passed(step, self.stress, 0.0)
        weights = memory_weights(estimate.fractional_order)[:RATE_COUNT]
        return estimate.is_above_surface(strain, float(weights @ (decay * self.values + gain)))


@dataclass(frozen=True)
class Predictor:
    """The tissue as it is now: parameters, memory and present stress.

    `innovation_variance` is that of the stress [Pa^2]; `uncertainty` is of model and rig.
    """

    geometry: Geometry
    estimate: Estimate
    memory: TissueMemory
    innovation_variance: float = 0.0
    uncertainty: Uncertainty = NOTHING_UNKNOWN

    def force(self, times: ArrayLike, displacements: ArrayLike) -> Prediction:
        """Return the force on the tissue while the probe follows a plan.

        `times` are seconds from the present, increasing, shape (n,); `displacements` the distance
        further into the tissue by then [m], linear in between; negative: back.

        Raises
        ------
        InputError
            If the plan has no shape, or its times do not increase from 0.
        """
        wanted, moves = _checked(times, displacements)
        grid = np.union1d(wanted, np.linspace(0.0, wanted[-1], _POINTS + 1)[1:])
        moved = np.interp(grid, np.append(0.0, wanted), np.append(0.0, moves))
        start = self.geometry.compression(self.memory.strain)
        compressions = start + np.append(0.0, moved) / self.geometry.length
        strains = np.array([self.geometry.strain(float(u)) for u in compressions])
        steps = np.diff(grid, prepend=0.0)
        stress, sd = self._stress(steps, strains)
        scale = 1.0 / self.geometry.stress_per_force
        value = scale * np.interp(wanted, grid, stress)
        return Prediction(wanted, value, scale * np.interp(wanted, grid, sd))

    def _stress(self, steps: Array, strains: Array) -> tuple[Array, Array]:
        """Return the stress at the ends of steps [s] and its deviation [Pa], shape (n,) each."""
        values, axes = np.linalg.eigh(self.estimate.covariance)
        # Towards the bend of the curve: the other direction may have no effect.
        signs = np.copysign(1.0, axes[1])
        changes = _DERIVATIVE_PART * np.sqrt(np.maximum(values, 0.0)) * signs * axes
        mean = self.estimate.mean
        offset = _DERIVATIVE_PART * math.sqrt(self.innovation_variance)
        parameters = np.vstack([mean, mean, mean + changes.T])
        offsets = np.array([0.0, offset, 0.0, 0.0, 0.0])
        stresses = self._followed(parameters, offsets, steps, strains)
        stress = stresses[0]
        variance = np.sum((stresses[1:] - stress) ** 2, axis=0) / _DERIVATIVE_PART**2
        return stress, np.sqrt(variance + self._left_out(stress, steps, strains))

    def _followed(self, parameters: Array, offsets: Array, steps: Array, strains: Array) -> Array:
        """Return the stress [Pa] along the plan, shape (m, n).

        By the law with `parameters` (ln G, ln Gn, alpha), shape (m, 3), and r larger by `offsets`.
        """
        weights = np.array([memory_weights(max(order, 0.0)) for order in parameters[:, 2]])
        slow, fast = weights[:, :RATE_COUNT], weights[:, RATE_COUNT]
        linear, nonlinear = np.exp(parameters[:, :2]).T
        pairs = zip(linear.tolist(), nonlinear.tolist(), strict=True)
        wanted = np.array([elastic_responses(strains, g, gn).value for g, gn in pairs])
        stress = np.full(len(parameters), self.memory.stress)
        moments = np.tile(self.memory.values, (len(parameters), 1))
        wanted += (slow @ self.memory.values + fast * stress - wanted[:, 0] + offsets)[:, None]
        found = np.empty((len(parameters), steps.size))
        for k, step in enumerate(steps.tolist()):
            decay, gain = passed(step, stress[:, None], 0.0)
            moments = decay * moments + gain
            by_stress = passed(step, 0.0, 1.0)[1]
            free = wanted[:, k + 1] - np.sum(slow * moments, axis=1)
            # Contact pushes and does not pull.
            stress = np.maximum(free / (slow @ by_stress + fast), 0.0)
            moments += stress[:, None] * by_stress
            found[:, k] = stress
        return found

    def _left_out(self, stress: Array, steps: Array, strains: Array) -> Array:
        """Return the variance of the change of the law's error [Pa^2], (n,)."""
        estimate, stated = self.estimate, self.uncertainty
        elastic = elastic_responses(strains, 1.0, estimate.nonlinear_stiffness)
        response = np.maximum(elastic.value, 0.0) + _LEAST_RESPONSE
        loading = np.abs(np.diff(np.log(response)))
        relaxed = apparent_stiffness_factor(estimate.fractional_order, 1.0)
        stiffness = estimate.linear_stiffness * relaxed * elastic.by_strain[1:]
        rig = (stiffness / self.geometry.length * stated.surface_motion_sd) ** 2
        rig += (self.geometry.stress_per_force * stated.force_drift_sd) ** 2
        grown = 2.0 * (estimate.model_discrepancy * stress) ** 2 * loading + rig * steps
        age = max(estimate.mean_dwell_time, _LEAST_AGE)
        # The data so far may widen the stated error, not shrink it.
        found = estimate.law_error.kernel if estimate.law_error is not None else 0.0
        relaxation = max(_LAW_ALONE * stated.kernel_sd, found) * stress
        # New loading is younger: without it the relaxation error is the largest.
        ageing = np.log1p(np.cumsum(steps) / age)
        return np.asarray(np.cumsum(grown) + (relaxation * ageing) ** 2)


def _checked(times: ArrayLike, values: ArrayLike) -> tuple[Array, Array]:
    instants = np.atleast_1d(np.asarray(times, dtype=float))
    planned = np.atleast_1d(np.asarray(values, dtype=float))
    if instants.ndim != 1 or instants.shape != planned.shape or instants.size == 0:
        raise InputError(
            f"plan: {instants.shape} times, {planned.shape} displacements: give as many of each"
        )
    steps = np.diff(instants, prepend=0.0)
    if not (np.all(steps > SHORTEST_STEP) and np.all(np.isfinite([steps, planned]))):
        raise InputError(
            "plan: times must increase by more than 10 µs, and displacements must be finite"
        )
    return instants, planned
