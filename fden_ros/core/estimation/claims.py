# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is claimed of an estimate: pure functions from what is known to what is said.

Reasons are asked in order; each takes some parameters away. Nothing else does. `claims_of` has
those of the estimate's own data, `reserved` those of the touch, the rig and the units.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import CLEAR, Array
from fden_ros.core.estimation.estimate import EACH, Estimate, ParameterSet
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.mixture import widened


class Evidence(NamedTuple):
    """What claims rest on."""

    mean: Array  #: of (ln G, ln Gn, alpha), shape (3,)
    deviations: Array  #: standard deviations of these, shape (3,)
    probability_beyond_boundary: float  #: P(largest strain > 1/Gn) [1]
    is_solved: bool  #: the grid is settled
    is_order_contradicted: bool = False  #: the relaxation is that of another alpha than is stated
    order_beyond: float = 0.0  #: standard deviations by which alpha wants beyond 0, or the highest


class Claims(NamedTuple):
    """What may be said of an estimate."""

    observable: ParameterSet  #: what the data determine, or a setting
    known: ParameterSet  #: what of it has converged
    at_edge: ParameterSet  #: what lies at an end of what the prior allows


class Reservations(NamedTuple):
    """What stands against an estimate beside its own data."""

    variance_factor: float = 1.0  #: by which contradictions of the data widen the covariance
    is_withheld: bool = False  #: the units or the geometry cannot be right
    is_doubtful: bool = False  #: the newest data are not explained yet


def claims_of(config: EstimatorConfig, evidence: Evidence) -> Claims:
    """Return what is valid, known and at an edge."""
    at_edge = _at_edge(config, evidence)
    valid = determined(config, evidence.deviations, evidence.probability_beyond_boundary)
    known = converged(config, evidence.deviations, valid)
    reasons = (
        (bool(at_edge), ParameterSet.ALL),
        (not evidence.is_solved, ParameterSet.ALL),
        (evidence.is_order_contradicted, ParameterSet.FRACTIONAL_ORDER),
    )
    for holds, unknown in reasons:
        if holds:
            known &= ~unknown
    return Claims(valid, known, at_edge)


def reserved(config: EstimatorConfig, estimate: Estimate, reservations: Reservations) -> Estimate:
    """Return an estimate of which no more is claimed than some reservations leave."""
    if reservations.variance_factor != 1.0:
        estimate = _widened(config, estimate, reservations.variance_factor)
    if reservations.is_withheld or reservations.is_doubtful:
        estimate = estimate._replace(known=ParameterSet.NONE)
    return estimate


def _widened(config: EstimatorConfig, estimate: Estimate, factor: float) -> Estimate:
    """Widen the covariance: what is still sharp enough stays known."""
    log_g, log_gn, order = estimate.with_origin
    wide = estimate._replace(
        covariance=factor * estimate.covariance,
        with_origin=(factor * log_g, factor * log_gn, factor * order),
        contact_point_sd=math.sqrt(factor) * estimate.contact_point_sd,
        components=widened(estimate.components, factor) if estimate.components else (),
        small_motions=tuple(motion.widened(factor) for motion in estimate.small_motions),
    )
    return wide._replace(known=wide.known & converged(config, wide.deviations, wide.observable))


def determined(
    config: EstimatorConfig, deviations: Array, probability_beyond_boundary: float
) -> ParameterSet:
    """Return the parameters that the data determine, or a setting.

    Gn is where the strain has passed 1/Gn: below, the law is linear. G and alpha are where their
    standard deviations are below half of their priors'. An alpha that is given is as stated.

    Parameters
    ----------
    deviations : ndarray, shape (3,)
        Standard deviations of (ln G, ln Gn, alpha) [1].
    probability_beyond_boundary : float
        P(largest strain > 1/Gn) [1].
    """
    # Below half of the prior's deviation the data say three times as much as the prior.
    log_g, _, order = (deviations < 0.5 * config.prior.deviations).tolist()
    found = ParameterSet.NONE
    if probability_beyond_boundary >= config.converged_probability:
        # A stress-strain curve that is seen to bend has a scale, too.
        found |= ParameterSet.STIFFNESS
    if log_g:
        found |= ParameterSet.LINEAR_STIFFNESS
    if order or config.is_order_given:
        found |= ParameterSet.FRACTIONAL_ORDER
    return found


def converged(config: EstimatorConfig, deviations: Array, valid: ParameterSet) -> ParameterSet:
    """Return those of `valid` whose standard deviations, shape (3,), are small enough."""
    limits = np.array(
        [config.converged_log_g_sd, config.converged_log_gn_sd, config.converged_order_sd]
    )
    found = ParameterSet.NONE
    for parameter, is_close in zip(EACH, deviations <= limits, strict=True):
        if is_close:
            found |= parameter
    return found & valid


def _at_edge(config: EstimatorConfig, evidence: Evidence) -> ParameterSet:
    off = np.abs(evidence.mean - config.prior.mean)
    found = ParameterSet.NONE
    for parameter, distance, sd in zip(EACH, off, config.prior.deviations, strict=True):
        if sd > 0.0 and distance > CLEAR * sd:
            found |= parameter
    if evidence.order_beyond > CLEAR:
        # No body relaxes like this: force and displacement may be out of step.
        found |= ParameterSet.FRACTIONAL_ORDER
    return found if not config.is_order_given else found & ~ParameterSet.FRACTIONAL_ORDER
