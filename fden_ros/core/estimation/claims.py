# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is claimed of an estimate: a pure function from what is known to what is said.

Reasons are asked in order; each takes some parameters away. Nothing else does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import ParameterSet, converged, determined
from fden_ros.core.estimation.estimator_config import EstimatorConfig


class Evidence(NamedTuple):
    """What claims rest on."""

    mean: Array  #: of (ln G, ln Gn, alpha), shape (3,)
    deviations: Array  #: standard deviations of these, shape (3,)
    probability_beyond_boundary: float  #: P(largest strain > 1/Gn) [1]
    is_solved: bool  #: the posterior's maximum was found
    origin_ambiguity: float  #: standard deviation of the origin times Gn [1]
    is_order_contradicted: bool = False  #: the relaxation is that of another alpha than is stated


class Claims(NamedTuple):
    """What may be said of an estimate."""

    valid: ParameterSet  #: what the data determine, or a setting
    known: ParameterSet  #: what of it has converged
    at_edge: ParameterSet  #: what lies at an end of what the prior allows


#: Standard deviations of the prior beyond which an estimate contradicts it [1].
_EDGE = 4.0
#: An order below this is that of a spring, not of the law [1].
_LEAST_ORDER = 0.015
#: The origin hides G where it is less certain than this part of the boundary strain [1].
_AMBIGUOUS_ORIGIN = 0.2


def claims_of(config: EstimatorConfig, evidence: Evidence) -> Claims:
    """Return what is valid, known and at an edge."""
    at_edge = _at_edge(config, evidence)
    valid = determined(config, evidence.deviations, evidence.probability_beyond_boundary)
    known = converged(config, evidence.deviations, valid)
    for applies, taken in _REASONS:
        if applies(evidence, at_edge):
            known &= ~taken
    return Claims(valid, known, at_edge)


#: What takes claims away, and which.
_REASONS: tuple[tuple[Callable[[Evidence, ParameterSet], bool], ParameterSet], ...] = (
    (lambda evidence, at_edge: not evidence.is_solved, ParameterSet.ALL),
    (lambda evidence, at_edge: bool(at_edge), ParameterSet.ALL),
    (
        lambda evidence, at_edge: evidence.origin_ambiguity > _AMBIGUOUS_ORIGIN,
        ParameterSet.LINEAR_STIFFNESS,
    ),
    (lambda evidence, at_edge: evidence.is_order_contradicted, ParameterSet.FRACTIONAL_ORDER),
)


def _at_edge(config: EstimatorConfig, evidence: Evidence) -> ParameterSet:
    off = np.abs(evidence.mean - config.prior.mean)
    found = ParameterSet.NONE
    each = (
        ParameterSet.LINEAR_STIFFNESS,
        ParameterSet.NONLINEAR_STIFFNESS,
        ParameterSet.FRACTIONAL_ORDER,
    )
    for parameter, distance, sd in zip(each, off, config.prior.deviations, strict=True):
        if sd > 0.0 and distance > _EDGE * sd:
            found |= parameter
    if evidence.mean[2] < _LEAST_ORDER:
        found |= ParameterSet.FRACTIONAL_ORDER
    return found if not config.is_order_given else found & ~ParameterSet.FRACTIONAL_ORDER


def probability_beyond(strain: float, strain_sd: float, log_gn: float, log_gn_sd: float) -> float:
    """Return P(strain > 1/Gn) [1]."""
    if strain <= 0.0:
        return 0.0
    spread = math.hypot(log_gn_sd, strain_sd / strain)
    if spread == 0.0:
        return float(math.log(strain) + log_gn > 0.0)
    return 0.5 * math.erfc(-(math.log(strain) + log_gn) / spread / math.sqrt(2.0))
