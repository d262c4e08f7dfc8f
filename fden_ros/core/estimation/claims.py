# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is claimed of an estimate: pure functions from what is known to what is said.

`claims_of` rests on the estimate's own data; touch, rig and units may take more away.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import CLEAR, Array
from fden_ros.core.estimation.estimate import EACH, Estimate, ParameterSet, inflated
from fden_ros.core.estimation.estimator_config import EstimatorConfig


class Claims(NamedTuple):
    """What may be said of an estimate."""

    observable: ParameterSet  #: what the data determine, or a setting
    known: ParameterSet  #: what of it has converged
    at_edge: ParameterSet  #: what lies at an end of what the prior allows


def claims_of(
    config: EstimatorConfig,
    mean: Array,
    deviations: Array,
    probability_beyond_boundary: float,
    *,
    is_solved: bool,
    is_order_contradicted: bool = False,
) -> Claims:
    """Return what is valid, known and at an edge.

    Parameters
    ----------
    mean, deviations : ndarray, shape (3,)
        Of (ln G, ln Gn, alpha), and their standard deviations [1].
    probability_beyond_boundary : float
        P(largest strain > 1/Gn) [1].
    is_solved : bool
        The grid is settled.
    is_order_contradicted : bool
        The relaxation is that of another alpha than is stated.
    """
    at_edge = _at_edge(config, mean)
    valid = determined(config, deviations, probability_beyond_boundary)
    known = converged(config, deviations, valid)
    if at_edge or not is_solved:
        known = ParameterSet.NONE
    if is_order_contradicted:
        known &= ~ParameterSet.FRACTIONAL_ORDER
    return Claims(valid, known, at_edge)


def widened(config: EstimatorConfig, estimate: Estimate, factor: float) -> Estimate:
    """Return an estimate with a covariance that is `factor` times as large.

    What is still sharp enough stays known.
    """
    log_g, log_gn, order = estimate.with_origin
    wide = estimate._replace(
        covariance=factor * estimate.covariance,
        with_origin=(factor * log_g, factor * log_gn, factor * order),
        contact_point_sd=math.sqrt(factor) * estimate.contact_point_sd,
        components=inflated(estimate.components, factor) if estimate.components else (),
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


def _at_edge(config: EstimatorConfig, mean: Array) -> ParameterSet:
    found = ParameterSet.NONE
    off = np.abs(mean - config.prior.mean)
    for parameter, distance, sd in zip(EACH, off, config.prior.deviations, strict=True):
        if sd > 0.0 and distance > CLEAR * sd:
            found |= parameter
    return found if not config.is_order_given else found & ~ParameterSet.FRACTIONAL_ORDER
