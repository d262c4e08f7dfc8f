# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""A law that is linear over the record: ln Gn is below that of the boundary strain, held there.

Below the boundary strain 1/Gn the law is linear, and the likelihood says nothing of Gn. A
posterior near there is what lies beyond the boundary, and the prior of ln Gn cut off at
:math:`b = -\ln x_{max}`. With the likelihood L(b) of a linear law its evidence is

.. math:: L(b) \int_{-\infty}^{b} p(l)\, dl .
"""

from __future__ import annotations

import math
from dataclasses import replace

from scipy.special import log_ndtr

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.loops import Evaluation
from fden_ros.core.estimation.maxima import Proposed, Solutions, boundary_of
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.solution import Solution
from fden_ros.core.estimation.unknowns import LOG_GN

#: Steps after which a linear law that is less likely than the bend by a logarithm of 40 is not
#: sought on [1].
_FIRST_STEPS = 2


def propose(
    posterior: Posterior, points: Points, found: Solutions, strain: float
) -> Parts[Proposed]:
    """Return the solution of a linear law, and what its boundary leaves of the maxima."""
    best = found.best
    if strain <= 0.0 or best.covariance[LOG_GN, LOG_GN] <= 0.0:
        return Proposed()
    boundary = boundary_of(strain)
    state = best.maximum.state
    known: Evaluation | None = best.maximum.evaluation
    if state[LOG_GN] > boundary:
        starts = [state.copy(), *(one.copy() for one in found.earlier)]
        for one in starts:
            one[LOG_GN] = boundary
        state, known = min(starts, key=lambda one: _misfit(posterior, points, one)), None
    scales = best.best_scales
    linear = yield from posterior.given(LOG_GN, points, state, scales, _FIRST_STEPS, known)
    if not linear.is_solved:
        if posterior.evidence_beside(points, linear, best) < best.log_evidence - 40.0:
            return Proposed()
        begun = linear.maximum
        known = begun.evaluation
        linear = yield from posterior.given(LOG_GN, points, begun.state, scales, known=known)
    mean = float(posterior.belief.mean[LOG_GN])
    # Whatever the others are: after an earlier press they are known together.
    width = math.sqrt(float(posterior.belief.variances()[LOG_GN]))
    place = (boundary - mean) / width
    # Over all scales: those that are best for the bend need not be so without.
    same_errors = replace(linear.maximum, errors=best.maximum.errors)
    linear = yield from posterior.averaged(points, same_errors, posterior.grid, LOG_GN)
    evidence = linear.log_evidence + 0.5 * ((state[LOG_GN] - mean) / width) ** 2
    evidence += math.log(width) + float(log_ndtr(place))
    return Proposed(
        ((evidence, _cut_off(linear, mean, width, place)),),
        tuple(_log_share_beyond(one, boundary) for one in found.maxima),
    )


def _misfit(posterior: Posterior, points: Points, state: Array) -> float:
    """Return the sum of squares of what a state leaves of the stress [Pa^2]."""
    try:
        off = points.stresses - posterior.model.response(points, state).stress
    except UNSOLVABLE:
        return math.inf
    return float(off @ off)


def _log_share_beyond(solution: Solution, boundary: float) -> float:
    """Return ln P(ln Gn > boundary) of a maximum; of one below, the linear law stands for it."""
    sd = math.sqrt(max(float(solution.covariance[LOG_GN, LOG_GN]), 1e-300))
    beyond = (float(solution.mean[LOG_GN]) - boundary) / sd
    if beyond < 0.0 and solution.maximum.state[LOG_GN] < boundary:
        return -math.inf
    return float(log_ndtr(beyond))


def _cut_off(linear: Solution, mean: float, width: float, place: float) -> Solution:
    """Return a linear law with the prior of ln Gn, cut off `place` standard deviations above."""
    ratio = math.exp(-0.5 * place**2 - 0.5 * math.log(2.0 * math.pi) - float(log_ndtr(place)))
    middle, covariance = linear.mean.copy(), linear.covariance.copy()
    middle[LOG_GN] = mean - width * ratio
    covariance[LOG_GN], covariance[:, LOG_GN] = 0.0, 0.0
    covariance[LOG_GN, LOG_GN] = width**2 * max(1.0 - ratio * (place + ratio), 1e-6)
    return replace(linear, mean=middle, covariance=covariance)
