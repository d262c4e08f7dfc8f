# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Force of a planned motion, with its interval.

The law at a time t after the present, with the motion so far remembered and the one to come
between the points of the plan linear in :math:`\varphi`:

.. math:: f(t) = M(t) + \sum_j g_j(t)\,\Delta\varphi_j + v, \qquad
    g_j(t) = \frac{(t-t_{j-1})^{1-\alpha} - (t-t_j)^{1-\alpha}}{\Gamma(2-\alpha)\,(t_j-t_{j-1})}

M is what the law makes of the past motion (:mod:`fden_ros.control.tissue_memory`). The stress v is
what law and rig leave out at present: the plan begins at what is measured now, and what the law
leaves out stays as it is, or goes on as it went in the hold so far
(:mod:`fden_ros.control.left_out`).

The interval is first-order: derivatives by (ln G, ln Gn, alpha, v) under the estimate's covariance
and the variance of the last innovation. To it comes the variance by which what is left out may
grow while the plan lasts, by the clocks of the posterior's error processes
(:mod:`fden_ros.core.estimation.error_model`),

.. math::
    dv = f^2 \left( 2\sigma_c^2\,|d\ln\varphi| + \frac{2\sigma_k^2}{\ell}\,|d\ln A| \right)
    + (k\,\sigma_s)^2\,dt + (c\,\sigma_d)^2\,dt

with :math:`\sigma_c` the characteristic's relative error, :math:`\sigma_k` the kernel's over
:math:`\ell` of ln t, and the motion of the surface against the stiffness k that it meets; and the
relaxation by what the hold has shown of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fden_ros.control.left_out import Slope
from fden_ros.control.tissue_memory import TissueMemory
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import (
    KERNEL_SHARE,
    NOTHING_UNKNOWN,
    Estimate,
    LoadingAhead,
    StateIndex,
    Uncertainty,
    surface_factor,
)
from fden_ros.core.law import Geometry, elastic_responses, phi
from fden_ros.errors import InputError

#: Just after the present [s]: the first instant of which the memory knows the whole past.
_AT_ONCE = 1e-5
#: Points of a plan are this close at most, as a part of its length.
_FINEST_PART = 40
#: Before a hold has shown the relaxation its deviation is this multiple of the stated one [1]: at
#: the end of a ramp a linear solid of 1 s looks like the law of a wrong alpha.
_UNSEEN_RELAXATION = 2.0
#: Part of the slope of what was left out that goes on [1], part of it by which that is
#: uncertain [1], and part of the kernel's stated deviation by which it changes besides [1].
#: Chosen on 49 presses of beef of one day for a half width of 2.9 % of the peak; on 29 of another
#: the 95 % interval then holds all of the hold to come, at 2.9 %. With 0.6 and 0.4 it has 4.6 %,
#: and holds 99 % in place of 83 % on a poroelastic solid of 20 s.
_KEPT, _SLOPE_CHANGE, _SHOWN_RELAXATION = 0.7, 0.33, 0.3
_DERIVATIVE_STEP = 1e-4
_ORDER_STEP = 0.005


@dataclass(frozen=True)
class Prediction:
    """What will happen, with its deviation."""

    times: Array  #: [s] from the present, shape (n,)
    value: Array  #: force [N], shape (n,)
    sd: Array  #: its standard deviation, shape (n,)

    def interval(self, deviations: float = 2.0) -> tuple[Array, Array]:
        """Return lower and upper bound at a number of standard deviations, shape (n,) each."""
        return self.value - deviations * self.sd, self.value + deviations * self.sd


class _Path(NamedTuple):
    """How the loading changes along a plan, each of shape (n,)."""

    steps: Array  #: of the time [s]
    ahead: LoadingAhead
    stiffness: Array  #: of the stress by the displacement, relaxed [Pa/m]


class _Trend(NamedTuple):
    """Where what the law leaves out is going, by the hold so far."""

    slope: Slope
    kept: float  #: part of the slope that goes on [1]
    variance: float  #: of the slope, by noise and rig [Pa^2]


@dataclass(frozen=True)
class Predictor:
    """The tissue as it is now: parameters, memory and present stress.

    Parameters
    ----------
    geometry : Geometry
    estimate : Estimate
    memory : TissueMemory
        The motion at the site up to now.
    stress : float
        Present value [Pa].
    innovation_variance : float
        Of the stress or the fractional stress, which differ little over seconds [Pa^2].
    uncertainty : Uncertainty
        What is not known of the rig and of the kernel; the characteristic's error is the
        estimate's.
    """

    geometry: Geometry
    estimate: Estimate
    memory: TissueMemory
    stress: float
    innovation_variance: float = 0.0
    uncertainty: Uncertainty = NOTHING_UNKNOWN

    def force(self, times: ArrayLike, displacements: ArrayLike) -> Prediction:
        """Return the force on the tissue while the probe follows a plan.

        Parameters
        ----------
        times : array_like, shape (n,)
            Seconds from the present, positive, increasing.
        displacements : array_like, shape (n,)
            Distance further into the tissue by then [m], linear in between; negative: back.

        Raises
        ------
        InputError
            If the plan has no shape, or its times do not increase from 0.
        """
        wanted, moves = _plan(times, displacements)
        grid = _grid(wanted)
        moved = np.interp(grid, np.append(0.0, wanted), np.append(0.0, moves))
        compressions = self.memory.compression + moved / self.geometry.length
        strains = np.array([self.geometry.strain(float(u)) for u in compressions])

        path = self._path(grid, strains)

        def stresses(logs: Array, order: float, shift: float) -> Array:
            remembered, gains = self._remembered(grid, path, logs, order)
            responses = phi(np.append(self.memory.strain, strains), *np.exp(logs))
            # Contact pushes and does not pull.
            return np.maximum(remembered + gains @ np.diff(responses) + shift, 0.0)

        planned = stresses(*self._parameters, 0.0)
        left_out = self._left_out_variance(path, planned)
        variance = self._variance(stresses, planned) + left_out
        scale = 1.0 / self.geometry.stress_per_force
        return Prediction(
            wanted,
            scale * np.interp(wanted, grid, planned),
            scale * np.sqrt(np.interp(wanted, grid, variance)),
        )

    @property
    def _parameters(self) -> tuple[Array, float]:
        estimate = self.estimate
        return estimate.mean[: StateIndex.FRACTIONAL_ORDER], estimate.fractional_order

    def _remembered(
        self, grid: Array, path: _Path, logs: Array, order: float
    ) -> tuple[Array, Array]:
        """Return the stress while the probe holds still (n,), and what a change of phi adds."""
        held = self.memory.held(np.append(_AT_ONCE, grid), logs, order)
        remembered = held[1:] + self.stress - held[0]
        if self._trend is not None:
            slope = self._slope(self._trend.slope, logs, order)
            remembered += self._trend.kept * slope * path.ahead.ageing
        return remembered, _gains(np.append(0.0, grid), order)

    def _slope(self, slope: Slope, logs: Array, order: float) -> float:
        """Return dv/dlnA over the newest part of the hold [Pa]."""
        return float(slope.weights @ self.memory.left_out(slope.points, logs, order))

    @cached_property
    def _trend(self) -> _Trend | None:
        """Where what the law leaves out is going; None where no hold has shown it.

        The stated deviation of the kernel is that of the slope before the hold: what noise and rig
        explain does not go on.
        """
        slope = self.memory.slope(self.estimate.mean_dwell_time)
        expected = (self.uncertainty.kernel_sd * self.stress) ** 2
        if slope is None or expected == 0.0:
            return None
        elastic = elastic_responses(
            np.array([self.memory.strain]), 1.0, self.estimate.nonlinear_stiffness
        )
        stiffness = self._relaxed * float(elastic.by_strain[0])
        walk = float(self._rig_variance(np.array(stiffness)))
        weights = slope.weights
        variance = self.innovation_variance * float(weights @ weights)
        variance += walk * float(weights @ np.minimum.outer(slope.times, slope.times) @ weights)
        return _Trend(slope, _KEPT * expected / (expected + variance), variance)

    @property
    def _relaxed(self) -> float:
        """Stress by the displacement over the time of the surface's motion, at phi' = 1 [Pa/m]."""
        estimate = self.estimate
        factor = surface_factor(estimate.fractional_order)
        return estimate.linear_stiffness * factor / self.geometry.length

    def _path(self, grid: Array, strains: Array) -> _Path:
        """Return how the loading changes along strains [1] at times [s], (n,) each."""
        elastic = elastic_responses(
            np.append(self.memory.strain, strains), 1.0, self.estimate.nonlinear_stiffness
        )
        steps = np.diff(grid, prepend=0.0)
        ahead = LoadingAhead.along(elastic.value, steps, self.estimate.mean_dwell_time)
        return _Path(steps, ahead, self._relaxed * elastic.by_strain[1:])

    def _left_out_variance(self, path: _Path, stress: Array) -> Array:
        """Return the variance by which the stress left out grows until each time [Pa^2]."""
        estimate, trend = self.estimate, self._trend
        if estimate.mean_dwell_time <= 0.0:
            return np.zeros_like(stress)
        relaxation_error = self._relaxation_error if trend is None else 0.0
        grown = path.ahead.left_out(stress, estimate.model_discrepancy, relaxation_error)
        grown += self._rig_variance(path.stiffness) * path.steps
        relaxation = (relaxation_error * stress) ** 2
        if trend is not None:
            relaxation = (_SHOWN_RELAXATION * self.uncertainty.kernel_sd * stress) ** 2
            relaxation += (_SLOPE_CHANGE * self._slope(trend.slope, *self._parameters)) ** 2
            relaxation += trend.kept * trend.variance
        return np.asarray(np.cumsum(grown) + path.ahead.ageing**2 * relaxation)

    def _rig_variance(self, stiffness: Array) -> Array:
        """Return by how much the variance of the rig's error grows in a second [Pa^2/s]."""
        surface = stiffness * self.uncertainty.surface_motion_sd
        drift = self.geometry.stress_per_force * self.uncertainty.force_drift_sd
        return np.asarray(surface**2 + drift**2)

    @property
    def _relaxation_error(self) -> float:
        """Relative deviation of a relaxation that no hold has shown, in each factor e of its age.

        The evidence so far may widen what is stated, not shrink it.
        """
        stated, found = self.uncertainty.kernel_sd, self.estimate.law_error
        unseen = _UNSEEN_RELAXATION * stated if found is None else found.kernel
        return max(stated, KERNEL_SHARE * self.estimate.model_discrepancy, unseen)

    def _variance(self, function: Callable[[Array, float, float], Array], value: Array) -> Array:
        """Return the variance of a function of the parameters whose value is given."""
        logs, order = self._parameters
        step = _DERIVATIVE_STEP
        noise = math.sqrt(self.innovation_variance)
        by_g = (function(logs + np.array([step, 0.0]), order, 0.0) - value) / step
        by_gn = (function(logs + np.array([0.0, step]), order, 0.0) - value) / step
        by_order = (function(logs, order + _ORDER_STEP, 0.0) - value) / _ORDER_STEP
        by_noise = function(logs, order, noise) - value
        jacobian = np.stack([by_g, by_gn, by_order])
        variance = np.einsum("in,ij,jn->n", jacobian, self.estimate.covariance, jacobian)
        result: Array = np.maximum(variance, 0.0) + by_noise**2
        return result


def _plan(times: ArrayLike, values: ArrayLike) -> tuple[Array, Array]:
    instants = np.atleast_1d(np.asarray(times, dtype=float))
    planned = np.atleast_1d(np.asarray(values, dtype=float))
    if instants.ndim != 1 or instants.shape != planned.shape or instants.size == 0:
        raise InputError(
            f"plan: {instants.shape} times and {planned.shape} displacements; give as many of each"
        )
    steps = np.diff(instants, prepend=0.0)
    if not (np.all(steps > 1e-5) and np.all(np.isfinite(planned)) and np.all(np.isfinite(steps))):
        raise InputError(
            "plan: times must increase from 0 by more than 10 µs each, and displacements be finite"
        )
    return instants, planned


def _grid(wanted: Array) -> Array:
    """Return the plan's times with enough others in between, shape (m,)."""
    finest = wanted[-1] / _FINEST_PART
    parts = [
        np.linspace(start, stop, max(math.ceil((stop - start) / finest), 1) + 1)[1:]
        for start, stop in zip(np.append(0.0, wanted[:-1]), wanted, strict=True)
    ]
    return np.concatenate(parts)


def _gains(knots: Array, order: float) -> Array:
    """Return D^alpha at knots[1:] by the changes between the knots, linear in time: (n, n)."""
    since = np.maximum(knots[1:, None] - knots[None, :], 0.0)
    powers = since ** (1.0 - order)
    gains: Array = (powers[:, :-1] - powers[:, 1:]) / np.diff(knots)
    return gains / math.gamma(2.0 - order)
