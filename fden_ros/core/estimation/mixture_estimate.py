# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The estimate that a mixture of posteriors stands for: its moments, and what of them is known."""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import (
    Estimate,
    ParameterSet,
    StateIndex,
    converged,
    determined,
)
from fden_ros.core.estimation.estimator_config import EstimatorConfig, Prior
from fden_ros.core.estimation.law_deviation import LawDeviation
from fden_ros.core.estimation.posterior_bank import PosteriorBank
from fden_ros.core.estimation.surface_shift import SurfaceShift

_LOG_G = StateIndex.LOG_LINEAR_STIFFNESS
_LOG_GN = StateIndex.LOG_NONLINEAR_STIFFNESS
_ORDER = StateIndex.FRACTIONAL_ORDER
_ORIGIN = StateIndex.STRAIN_ORIGIN
_SHIFT = StateIndex.SHIFT

#: Alpha is not known where it is farther than this from that of the law's fit, in deviations of
#: both [1]: on 78 presses of beef the ones kept are then 1.3 of their deviations off the order of
#: their holds, all of them 4.1.
_SAME_ORDER = 1.5
#: The relaxation contradicts a stated alpha beyond this many deviations of both [1]: 6e-5 of
#: contacts do by chance; the deviation of the relaxation's order counts as this at least [1].
_CONTRADICTION, _LEAST_ORDER_SD = 4.0, 0.01


def mixture_estimate(
    config: EstimatorConfig,
    bank: PosteriorBank,
    moments: tuple[Array, Array],
    largest_strain: float,
    surface: SurfaceShift,
    deviation: LawDeviation | None,
    *,
    sample_count: int,
    loading_age: float,
) -> Estimate:
    """Return the estimate with everything that is not in the posteriors' covariances.

    Parameters
    ----------
    config : EstimatorConfig
    bank : PosteriorBank
    moments : tuple of ndarray, shape (n,), (n, n)
        Mean and covariance of the state; the covariance is changed in place.
    largest_strain : float
        In all contacts, from the mean's origin [1].
    surface : SurfaceShift
    deviation : LawDeviation, optional
        The newest fit to a bent law.
    sample_count : int
    loading_age : float
        [s].
    """
    mean, covariance = moments
    if deviation is not None and deviation.motion_covariance is not None:
        own = covariance[:_ORIGIN, :_ORIGIN]
        own += _positive(deviation.motion_covariance - own)
    # Strain goes with 1/h: ln G and ln Gn are off together.
    covariance[:_ORDER, :_ORDER] += config.uncertainty.thickness_sd**2
    # Symmetric to the last bit, which products of matrices are not.
    covariance = 0.5 * (covariance + covariance.T)
    # The origin of this contact, where the surface has shifted since the first.
    in_origin = np.zeros(mean.size)
    in_origin[_ORIGIN], in_origin[_SHIFT] = 1.0, surface.way
    beyond = bank.probability_beyond_boundary(largest_strain)
    deviations = np.sqrt(np.maximum(covariance.diagonal()[:_ORIGIN], 0.0))
    valid, at_edge = determined(config, deviations, beyond), bank.at_edge()
    is_solved = bank.best.is_solved and not at_edge
    known = converged(config, deviations, valid) if is_solved else ParameterSet.NONE
    order = float(mean[_ORDER])
    if bank.best.uncertainty.kernel_sd and _is_disputed(
        order, float(deviations[_ORDER]), deviation
    ):
        known &= ~ParameterSet.FRACTIONAL_ORDER
    is_contradicted = deviation is not None and _is_contradicted(config.prior, deviation)
    if is_contradicted:
        known &= ~ParameterSet.FRACTIONAL_ORDER
    return Estimate(
        log_linear_stiffness=float(mean[_LOG_G]),
        log_nonlinear_stiffness=float(mean[_LOG_GN]),
        fractional_order=order,
        covariance=covariance[:_ORIGIN, :_ORIGIN],
        strain_origin=float(mean @ in_origin) + surface.shifted,
        strain_origin_sd=math.sqrt(max(float(in_origin @ covariance @ in_origin), 0.0)),
        probability_beyond_boundary=beyond,
        valid=valid,
        known=known,
        at_edge=at_edge,
        sample_count=sample_count,
        model_error=bank.model_error,
        loading_age=loading_age,
        law_error=deviation.error if deviation is not None else None,
        is_order_contradicted=is_contradicted,
    )


def _is_contradicted(prior: Prior, fit: LawDeviation) -> bool:
    """Whether the relaxation is that of another alpha than is given, or than its prior says."""
    order_sd = max(fit.fractional_order_sd, _LEAST_ORDER_SD)
    both = math.hypot(prior.fractional_order_sd, order_sd)
    return abs(prior.fractional_order - fit.fractional_order) > _CONTRADICTION * both


def _is_disputed(order: float, order_sd: float, fit: LawDeviation | None) -> bool:
    """Whether the fit of the relaxation wants another alpha, where the tissue is not the law's.

    A walk takes any part of the stress that does not relax, the fit any smooth kernel: where the
    relaxation is no power law, each has an alpha of its own.
    """
    if fit is None:
        return False
    both = math.hypot(order_sd, fit.fractional_order_sd)
    return abs(order - fit.fractional_order) > _SAME_ORDER * both


def _positive(matrix: Array) -> Array:
    """Return the positive part of a symmetric matrix, shape (n, n)."""
    values, vectors = np.linalg.eigh(matrix)
    part: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return part
