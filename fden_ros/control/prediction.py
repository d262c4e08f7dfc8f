# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Force of a planned motion, with its interval.

A law at a time t after the present,

.. math:: f(t) = M(t) + v, \qquad v = f(0) - M(0)

with M what it makes of the motion so far (:mod:`fden_ros.control.tissue_memory`) and of the one to
come. The stress v is what law and rig leave out at present: the plan begins at what is measured
now, and what the law leaves out stays as it is, or goes on as it went in the hold so far
(:mod:`fden_ros.control.left_out`).

The interval is first-order: derivatives by the law's parameters and v, under their covariance and
the variance of the last innovation. To it comes the variance by which what is left out may grow
while the plan lasts, by the clocks of the posterior's error processes
(:mod:`fden_ros.core.estimation.error_model`),

.. math::
    dv = f^2 \left( 2\sigma_c^2\,|d\ln\varphi| + \frac{2\sigma_k^2}{\ell}\,|d\ln A| \right)
    + (k\,\sigma_s)^2\,dt + (c\,\sigma_d)^2\,dt

with :math:`\sigma_c` the characteristic's relative error, :math:`\sigma_k` the kernel's over
:math:`\ell` of ln t, and the motion of the surface against the stiffness k that it meets; and the
relaxation by what the hold has shown of it.

The tissue may have another law: with the probability p of that the prediction is the mixture of
both, :math:`(1 - p)\,N(m_0, s_0^2) + p\,N(m_1, s_1^2)`, by its moments.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fden_ros.control.left_out import Slope
from fden_ros.control.tissue_memory import Motion, TissueMemory
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import (
    KERNEL_SHARE,
    NOTHING_UNKNOWN,
    Along,
    Elastic,
    Estimate,
    LawAlong,
    LoadingAhead,
    Uncertainty,
    other_along,
)
from fden_ros.core.law import SHORTEST_STEP, Geometry
from fden_ros.errors import InputError

#: Points of a plan are this close at most, as a part of its length.
_FINEST_PART = 40
#: Before a hold has shown the relaxation its deviation is this multiple of the stated one [1]: at
#: the end of a ramp a linear solid of 1 s looks like the law of a wrong alpha.
_UNSEEN_RELAXATION = 2.0
#: A hold of this time [s] and of this part of the loading's age [1] shows the relaxation.
_SHOWN_TIME, _SHOWN_PART = 1.5, 0.2
#: Part of the slope of what was left out that goes on [1], part of it by which that is
#: uncertain [1], and part of the kernel's stated deviation by which it changes besides [1].
#: Chosen on 49 presses of beef of one day for a half width of 2.9 % of the peak; on 29 of another
#: the 95 % interval then holds all of the hold to come, at 2.9 %. With 0.6 and 0.4 it has 4.6 %,
#: and holds 99 % in place of 83 % on a poroelastic solid of 20 s.
_KEPT, _SLOPE_CHANGE, _SHOWN_RELAXATION = 0.7, 0.33, 0.3
#: The same part of another law, which is exact for none: chosen on simulated poroelastic solids
#: of 2 and 20 s, whose relaxation has many rates [1].
_OTHERS_RELAXATION = 0.6
#: Derivatives are differences over this part of a standard deviation [1].
_DERIVATIVE_PART = 0.1
#: A law that is less likely than this is not asked [1].
_UNLIKELY = 1e-3


@dataclass(frozen=True)
class Prediction:
    """What will happen, with its deviation."""

    times: Array  #: [s] from the present, shape (n,)
    value: Array  #: force [N], shape (n,)
    sd: Array  #: its standard deviation, shape (n,)

    def interval(self, deviations: float = 2.0) -> tuple[Array, Array]:
        """Return lower and upper bound at a number of standard deviations, shape (n,) each."""
        return self.value - deviations * self.sd, self.value + deviations * self.sd


class _Plan(NamedTuple):
    """A motion to come, arrays of shape (n,)."""

    times: Array  #: since the present [s]
    strains: Array  #: at present and by then [1], shape (n + 1,)
    motion: Motion  #: so far and to come


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
        wanted, moves = _checked(times, displacements)
        grid = _grid(wanted)
        moved = np.interp(grid, np.append(0.0, wanted), np.append(0.0, moves))
        compressions = self.memory.compression + moved / self.geometry.length
        strains = [self.geometry.strain(float(u)) for u in compressions]
        motion = self.memory.motion(grid, compressions)
        plan = _Plan(grid, np.append(self.memory.strain, strains), motion)
        found = [(law.weight, *_LawAhead(self, law, plan).moments()) for law in self._laws()]
        weights, means, variances = (np.array(each) for each in zip(*found, strict=True))
        mean = weights @ means
        variance = weights @ (variances + (means - mean) ** 2)
        scale = 1.0 / self.geometry.stress_per_force
        return Prediction(
            wanted,
            scale * np.interp(wanted, grid, mean),
            scale * np.sqrt(np.interp(wanted, grid, variance)),
        )

    def _laws(self) -> list[_Law]:
        """Return what the tissue may obey; the weights add up to 1."""
        estimate, other = self.estimate, self.estimate.other_law
        share = estimate.other_law_probability if other is not None else 0.0
        laws = [
            _Law(
                1.0 - share,
                estimate.mean,
                estimate.covariance,
                partial(LawAlong, self.geometry),
                _SHOWN_RELAXATION,
            )
        ]
        if other is not None:
            made = partial(other_along, self.geometry, other)
            laws.append(_Law(share, other.mean, other.covariance, made, _OTHERS_RELAXATION))
        return [law for law in laws if law.weight > _UNLIKELY]


class _Law(NamedTuple):
    """A law that the tissue may obey."""

    weight: float  #: its probability [1]
    mean: Array  #: of its parameters, shape (n,)
    covariance: Array  #: of them, shape (n, n)
    made: Callable[[Array], Along]  #: the law of given parameters
    #: Part of the kernel's stated deviation by which a relaxation that was shown changes [1].
    shown: float


@dataclass(frozen=True)
class _LawAhead:
    """What a law makes of a plan."""

    tissue: Predictor
    law: _Law
    plan: _Plan

    def moments(self) -> tuple[Array, Array]:
        """Return mean [Pa] and variance [Pa^2] of the stress, shape (n,) each."""
        planned = self._stress(self._at_mean)
        return planned, self._variance(planned) + self._left_out_variance(planned)

    def _stress(self, along: tuple[Array, Array], shift: float = 0.0) -> Array:
        """Return the stress of the plan, (n,); `shift`: of the present [Pa].

        `along`: a law's stress of the motion so far and to come.
        """
        past, ahead = along
        ahead = ahead + self.tissue.stress + shift - (past[-1] if past.size else 0.0)
        if self._trend is not None:
            slope = self._slope(self._trend.slope, past)
            ahead += self._trend.kept * slope * self._loading.ageing
        # Contact pushes and does not pull.
        return np.maximum(ahead, 0.0)

    @cached_property
    def _at_mean(self) -> tuple[Array, Array]:
        return self.plan.motion.stress(self.law.made(self.law.mean))

    @cached_property
    def _elastic(self) -> Elastic:
        return self.law.made(self.law.mean).elastic(self.plan.strains)

    def _slope(self, slope: Slope, past: Array) -> float:
        """Return dv/dlnA over the newest part of the hold [Pa]; `past`: the law's stress there."""
        instants, stresses = np.array(slope.points).T
        left_out = stresses - np.interp(instants, self.plan.motion.times[: past.size], past)
        return float(slope.weights @ left_out)

    @cached_property
    def _stiffness(self) -> Array:
        """Stress by the displacement over the time of the surface's motion [Pa/m], (n + 1,)."""
        return self._elastic.stiffness / self.tissue.geometry.length

    @cached_property
    def _loading(self) -> LoadingAhead:
        """How the loading changes along the plan."""
        steps = np.diff(self.plan.times, prepend=0.0)
        age = self.tissue.estimate.mean_dwell_time
        return LoadingAhead.along(self._elastic.values, steps, age)

    @cached_property
    def _trend(self) -> _Trend | None:
        """Where what the law leaves out is going; None where no hold has shown it.

        The stated deviation of the kernel is that of the slope before the hold: what noise and rig
        explain does not go on.
        """
        tissue = self.tissue
        slope = tissue.memory.slope(tissue.estimate.mean_dwell_time)
        expected = (tissue.uncertainty.kernel_sd * tissue.stress) ** 2
        if slope is None or expected == 0.0:
            return None
        walk = float(self._rig_variance(self._stiffness[0]))
        weights = slope.weights
        variance = tissue.innovation_variance * float(weights @ weights)
        variance += walk * float(weights @ np.minimum.outer(slope.times, slope.times) @ weights)
        return _Trend(slope, _KEPT * expected / (expected + variance), variance)

    def _left_out_variance(self, stress: Array) -> Array:
        """Return the variance by which the stress left out grows until each time [Pa^2]."""
        estimate, trend = self.tissue.estimate, self._trend if self._is_shown else None
        if estimate.mean_dwell_time <= 0.0:
            return np.zeros_like(stress)
        relaxation_error = self._relaxation_error if trend is None else 0.0
        grown = self._loading.left_out(stress, estimate.model_discrepancy, relaxation_error)
        steps = np.diff(self.plan.times, prepend=0.0)
        grown += self._rig_variance(self._stiffness[1:]) * steps
        relaxation = (relaxation_error * stress) ** 2
        if trend is not None:
            relaxation = (self.law.shown * self.tissue.uncertainty.kernel_sd * stress) ** 2
            relaxation += (_SLOPE_CHANGE * self._slope(trend.slope, self._at_mean[0])) ** 2
            relaxation += trend.kept * trend.variance
        return np.asarray(np.cumsum(grown) + self._loading.ageing**2 * relaxation)

    def _rig_variance(self, stiffness: Array) -> Array:
        """Return by how much the variance of the rig's error grows in a second [Pa^2/s]."""
        uncertainty = self.tissue.uncertainty
        surface = stiffness * uncertainty.surface_motion_sd
        drift = self.tissue.geometry.stress_per_force * uncertainty.force_drift_sd
        return np.asarray(surface**2 + drift**2)

    @property
    def _is_shown(self) -> bool:
        """Whether a hold has shown which law the relaxation has."""
        least = max(_SHOWN_TIME, _SHOWN_PART * self.tissue.estimate.mean_dwell_time)
        return self.tissue.memory.longest_hold >= least

    @property
    def _relaxation_error(self) -> float:
        """Relative deviation of a relaxation that no hold has shown, in each factor e of its age.

        The evidence so far may widen what is stated, not shrink it.
        """
        estimate, stated = self.tissue.estimate, self.tissue.uncertainty.kernel_sd
        found = max(stated, KERNEL_SHARE * estimate.model_discrepancy)
        if not self._is_shown:
            return max(found, _UNSEEN_RELAXATION * stated)
        return max(found, estimate.law_error.kernel) if estimate.law_error is not None else found

    def _variance(self, planned: Array) -> Array:
        """Return the variance of the stress by the parameters and the present stress [Pa^2]."""
        mean, noise = self.law.mean, math.sqrt(self.tissue.innovation_variance)
        result = (self._stress(self._at_mean, noise) - planned) ** 2
        values, axes = np.linalg.eigh(self.law.covariance)
        for value, axis in zip(values, axes.T, strict=True):
            if value > 0.0:
                # Towards a curve that bends: where the other has no effect, that may have.
                step = _DERIVATIVE_PART * math.sqrt(value) * math.copysign(1.0, axis[1]) * axis
                along = self.plan.motion.stress(self.law.made(mean + step))
                result += ((self._stress(along) - planned) / _DERIVATIVE_PART) ** 2
        return result


def _checked(times: ArrayLike, values: ArrayLike) -> tuple[Array, Array]:
    instants = np.atleast_1d(np.asarray(times, dtype=float))
    planned = np.atleast_1d(np.asarray(values, dtype=float))
    if instants.ndim != 1 or instants.shape != planned.shape or instants.size == 0:
        raise InputError(
            f"plan: {instants.shape} times and {planned.shape} displacements; give as many of each"
        )
    steps = np.diff(instants, prepend=0.0)
    if not (
        np.all(steps > SHORTEST_STEP)
        and np.all(np.isfinite(planned))
        and np.all(np.isfinite(steps))
    ):
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
