# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How far the data bend relaxation and stress-strain curve away from the law.

What is stated of each is the root mean square over the times and the strains seen, without the
part that G, alpha and Gn absorb. No tissue is exactly FDEN: on 78 presses of raw beef the kernel
bends by 0.04 (0.06 in nine of ten) and the characteristic by 0.09 (0.14), nearly all of it at
small strain; where it is loaded, in the upper half of the strains, it is the exponential to 0.008
(0.016). Silicone's kernel bends by 0.02 to 0.04 (once by 0.5), and its curve where it is loaded by
0.015 to 0.026. The fit is in :mod:`fden_ros.core.estimation.law_fit`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.bent_law import CHARACTERISTIC, KERNEL, KNOTS, BentLaw, hats
from fden_ros.core.estimation.estimate import LawError, StateIndex
from fden_ros.core.estimation.nearest_curve import beside_the_law, nearest_curve
from fden_ros.core.law.characteristic import elastic_responses

#: MODEL_MISMATCH when the kernel's error is above this with a probability of 95 % [1]: its lower
#: bound is at most 0.053 on 78 presses of beef, and 0.066 to 0.097 on linear solids of 0.3 to 3 s.
KERNEL_MISMATCH = 0.06
_ONE_SIDED_95 = 1.645
#: MODEL_MISMATCH when the error of the characteristic where it is loaded is above this [1], and
#: the logarithm of the evidence that the characteristic is bent at all above this [1]. Chosen on
#: 78 presses of beef and 6 of silicone, of which 7 and 6 are above both; silicone's least error is
#: 0.0154. The lower bound of the error takes twice the beef with the same silicone. The logarithm
#: is 24 to 355 on silicone; noise alone gave up to 7 in 80 simulated contacts.
LOADED_MISMATCH, _DECISIVE = 0.01535, 10.0
#: The characteristic counts as loaded from this share of the largest strain on [1], with the
#: square of the stress as weight, on 30 points.
_LOADED_SHARE, _LOADED_POINTS = 0.5, 30
#: The kernel's error is stated from this multiple of the record's median step on [1], and over as
#: many knots at least: what it does within a step is hardly known, and bent by 0.5 on one press.
_RESOLVED_STEPS, _LEAST_KNOTS = 2.0, 4

_LOG_G, _LOG_GN = StateIndex.LOG_LINEAR_STIFFNESS, StateIndex.LOG_NONLINEAR_STIFFNESS
_ORDER = StateIndex.FRACTIONAL_ORDER


@dataclass(frozen=True)
class Deviation:
    """A relative deviation from the law."""

    points: Array  #: times [s] or strains [1], shape (n,)
    value: Array  #: relative deviation there [1], shape (n,)
    sd: Array  #: its standard deviation [1], shape (n,)
    error: float  #: root mean square over the points [1]
    error_sd: float  #: its standard deviation [1]


@dataclass(frozen=True)
class LawDeviation:
    """How far relaxation kernel and characteristic are from the law over one contact."""

    kernel: Deviation
    characteristic: Deviation
    loaded: Deviation  #: of the characteristic in the upper half of the strains
    log_linear_stiffness: float  #: ln G of the law from which they deviate
    log_nonlinear_stiffness: float  #: its ln Gn
    #: Order of the power law that is nearest to the bent kernel, over the times seen [1].
    fractional_order: float
    #: Its standard deviation [1]: that of the fit, and the kernel's error, by which the order
    #: changes from one factor e of time to another.
    fractional_order_sd: float
    #: Logarithm of the evidence of a bent characteristic over that of the law's [1].
    curve_evidence: float
    #: Logarithm of the evidence of kernel and characteristic bent over that of the exact law under
    #: a surface that moves more than is stated [1]; infinite where it does not.
    motion_evidence: float
    #: Covariance of (ln G, ln Gn, alpha) with the motion of the surface that the evidence wants,
    #: shape (3, 3), where that is more than is stated.
    motion_covariance: Array | None

    @property
    def error(self) -> LawError:
        """The root mean squares and the order of the relaxation, with their deviations."""
        return LawError(
            self.kernel.error,
            self.kernel.error_sd,
            self.characteristic.error,
            self.characteristic.error_sd,
            self.loaded.error,
            self.loaded.error_sd,
            self.fractional_order,
            self.fractional_order_sd,
        )

    @property
    def is_mismatch(self) -> bool:
        """Whether the relaxation is no power law, or the loaded curve not the law's.

        Not where a surface that moves explains the data better.
        """
        if self.motion_evidence < 0.0:
            return False
        kernel = self.kernel.error - _ONE_SIDED_95 * self.kernel.error_sd
        is_bent = self.curve_evidence > _DECISIVE
        return kernel > KERNEL_MISMATCH or (is_bent and self.loaded.error > LOADED_MISMATCH)


def law_deviation(
    law: BentLaw,
    state: Array,
    covariance: Array,
    curve_evidence: float,
    motion_evidence: float,
    motion_covariance: Array | None,
) -> LawDeviation:
    """Return the deviations from the law of a fit.

    Parameters
    ----------
    law : BentLaw
        Of the record.
    state : ndarray, shape (22,)
        At the maximum of the posterior.
    covariance : ndarray, shape (22, 22)
    curve_evidence, motion_evidence : float
        See :class:`LawDeviation`.
    motion_covariance : ndarray, shape (3, 3), optional
        See :class:`LawDeviation`.
    """
    resolved = math.log(_RESOLVED_STEPS * float(np.median(law.steps)))
    first = min(int(np.searchsorted(law.time_knots, resolved)), KNOTS - _LEAST_KNOTS)
    knots = law.time_knots[first:]
    kernel = _without(
        np.exp(knots),
        state[KERNEL][first:],
        covariance[KERNEL, KERNEL][first:, first:],
        np.stack([np.ones_like(knots), knots], axis=1),
    )
    # At a strain of 0 there is no stress to be off.
    characteristic = _curve(law, state, covariance, law.strain_knots[1:])
    largest = law.strain_knots[-1]
    upper = np.linspace(_LOADED_SHARE * largest, largest, _LOADED_POINTS)
    stress = elastic_responses(upper, 1.0, math.exp(state[_LOG_GN])).value
    loaded = _curve(law, state, covariance, upper, (stress / stress[-1]) ** 2)
    order, order_sd = _power_law(state, covariance, knots)
    return LawDeviation(
        kernel,
        characteristic,
        loaded,
        float(state[_LOG_G]),
        float(state[_LOG_GN]),
        order,
        math.hypot(order_sd, kernel.error),
        curve_evidence,
        motion_evidence,
        motion_covariance,
    )


def _power_law(state: Array, covariance: Array, knots: Array) -> tuple[float, float]:
    """Return the order of the power law nearest to the bent kernel, and its deviation [1].

    Over the last knots in ln t, which are given. A deviation that is linear in ln t is a power law
    as well: which part of the order is alpha depends on where the fit began.
    """
    off = knots - knots.mean()
    along = np.zeros(state.size)
    along[KERNEL.stop - knots.size : KERNEL.stop] = -off / (off @ off)
    along[_ORDER] = 1.0
    variance = float(along @ covariance @ along)
    return float(along @ state), math.sqrt(max(variance, 0.0))


def _curve(
    law: BentLaw, state: Array, covariance: Array, strains: Array, weights: Array | None = None
) -> Deviation:
    """Return the characteristic's deviation at strains from the nearest curve of the law.

    That has a G and a Gn of its own: by as much as the deviation bends like another Gn, the fit's
    Gn is arbitrary.
    """
    at = hats(law.strain_knots, strains)
    spread = at @ covariance[CHARACTERISTIC, CHARACTERISTIC] @ at.T
    bent = at @ state[CHARACTERISTIC]
    wanted = np.log(elastic_responses(strains, 1.0, math.exp(state[_LOG_GN])).value) + bent
    log_gn = nearest_curve(strains, wanted, float(state[_LOG_GN]), weights)
    left, absorbed = beside_the_law(strains, wanted, log_gn)
    return _without(strains, left, spread, absorbed, weights)


def _without(
    points: Array, mean: Array, covariance: Array, absorbed: Array, weights: Array | None = None
) -> Deviation:
    """Return a deviation less its least-squares fit by the columns that parameters absorb."""
    shares = np.ones(points.size) if weights is None else weights
    root = np.sqrt(shares / shares.sum())
    basis, _ = np.linalg.qr(root[:, None] * absorbed)
    left = np.eye(points.size) - (basis / root[:, None]) @ (basis.T * root)
    value, spread = left @ mean, left @ covariance @ left.T
    error = float(np.linalg.norm(root * value))
    along = root**2 * value / error if error > 0.0 else np.zeros_like(value)
    return Deviation(
        points,
        value,
        np.sqrt(np.maximum(spread.diagonal(), 0.0)),
        error,
        math.sqrt(max(float(along @ spread @ along), 0.0)),
    )
