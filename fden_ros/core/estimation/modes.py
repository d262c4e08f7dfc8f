# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""A posterior of several modes.

- Starts may lead to maxima that are apart. Each that is likely is kept and followed.
- Below the boundary strain 1/Gn the law is linear, and the likelihood says nothing of Gn. A
  posterior near there is one mode beyond the boundary, and the prior of ln Gn cut off at
  :math:`b = -\ln x_{max}`. With the likelihood L(b) of a linear law its weight is

.. math:: L(b) \int_{-\infty}^{b} p(l)\, dl .
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, log_ndtr

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import Member, mixture
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.record import Points
from fden_ros.core.estimation.scales import Scales
from fden_ros.core.estimation.solution import NEGLIGIBLE, Solution, evidence_under
from fden_ros.core.estimation.unknowns import LAW, LOG_GN

#: Modes that are followed [1], so that a solution has a longest time: no recording had a fourth.
_MOST = 3
#: Maxima closer than this many standard deviations are one [1].
_SAME = 0.2
#: Above the boundary by less than this a law is as good as linear, and one that bends begins so
#: far above it [1].
_NEAR, _BENT = 0.05, 0.3
#: A linear law that is less likely than the bend by this logarithm after as many steps is not
#: sought on [1].
_HOPELESS, _FIRST_STEPS = 40.0, 2


@dataclass(frozen=True)
class Modes:
    """The modes of a posterior."""

    solutions: tuple[Solution, ...]  #: about its maxima, the likeliest first
    weight: float = 1.0  #: of the first
    others: tuple[Member, ...] = ()  #: all modes but the first
    log_gain: float = 0.0  #: logarithm of the evidence of all over that of the first

    @property
    def best(self) -> Solution:
        """The likeliest maximum's."""
        return self.solutions[0]

    def members(self, mean: Array, covariance: Array) -> list[Member]:
        """Return all modes, where the moments of the first have gone on to these."""
        best = self.best
        shift = mean - best.mean
        others = [m._replace(mean=m.mean + shift) for m in self.others]
        found = [Member(self.weight, mean, covariance), *others]
        if best.considered is None:
            return found
        return [m._replace(covariance=m.covariance + best.considered) for m in found]

    def mixed(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """Return the moments of all modes, where those of the first have gone on to these."""
        return mixture(self.members(mean, covariance))


def find_modes(
    posterior: Posterior,
    points: Points,
    starts: Sequence[Array],
    scales: Scales,
    before: Sequence[tuple[Array, Solution]],
    strain: float,
    converged: float,
) -> Modes:
    """Return the modes that starts lead to, and those of a shorter record.

    Parameters
    ----------
    posterior : Posterior
    points : Points
    starts : sequence of ndarray, shape (n,)
    scales : Scales
        To begin with at these.
    before : sequence of (ndarray, Solution)
        Modes of the shorter record, with their states by now: at their own scales, which others
        would be no match for.
    strain : float
        Largest strain of the record [1].
    converged : float
        Maxima are found where a step would lower minus twice the log posterior by less [1].

    Raises
    ------
    FloatingPointError
        If the stress is not finite at any start.
    """
    found = posterior.solutions(points, starts, scales, converged)
    found += _followed(posterior, points, before, strain)
    return _weighed(posterior, points, found, strain)


def follow_modes(
    posterior: Posterior,
    points: Points,
    before: Sequence[tuple[Array, Solution]],
    strain: float,
) -> Modes:
    """Return the modes that those of a shorter record, with their states by now, lead to.

    Raises
    ------
    FloatingPointError
        If the stress is not finite at any of them.
    """
    found = _followed(posterior, points, before, strain)
    if not found:
        raise FloatingPointError("the stress is not finite at any mode")
    return _weighed(posterior, points, found, strain)


def _followed(
    posterior: Posterior,
    points: Points,
    before: Sequence[tuple[Array, Solution]],
    strain: float,
) -> list[Solution]:
    boundary = _boundary(strain)
    found = []
    for state, solution in before:
        begun = [state]
        if state[LOG_GN] < boundary + _NEAR and not posterior.is_known(LOG_GN):
            # Of a linear law no derivative leads to a bend.
            bent = state.copy()
            bent[LOG_GN] = boundary + _BENT
            begun.append(bent)
        for one in begun:
            with contextlib.suppress(*UNSOLVABLE):
                found.append(posterior.tracked(points, one, solution))
    return found


def _weighed(
    posterior: Posterior, points: Points, found: Sequence[Solution], strain: float
) -> Modes:
    """Return the modes that are apart, weighed by their evidence under the same errors."""
    found = sorted(found, key=lambda s: -s.log_evidence)
    if len(found) == 1:
        return _with_linear(posterior, points, Modes((found[0],)), strain)
    errors = found[0].maximum.errors
    evidence = np.array([evidence_under(posterior, points, s, errors) for s in found])
    kept: list[tuple[float, Solution]] = []
    boundary = _boundary(strain)
    has_linear = False
    for k in np.argsort(-evidence):
        likely = float(evidence[k] - evidence.max())
        is_linear = found[k].maximum.state[LOG_GN] < boundary + _NEAR
        if likely < -NEGLIGIBLE or len(kept) == _MOST or (is_linear and has_linear):
            continue
        if all(_are_apart(found[k], s) for _, s in kept):
            kept.append((math.exp(likely), found[k]))
            has_linear |= is_linear
    total = sum(weight for weight, _ in kept)
    others = tuple(Member(w / total, s.mean, s.covariance) for w, s in kept[1:])
    solutions = tuple(s for _, s in kept)
    modes = Modes(solutions, kept[0][0] / total, others, math.log(total / kept[0][0]))
    return _with_linear(posterior, points, modes, strain)


def _boundary(strain: float) -> float:
    """Return ln Gn of a law that is just linear up to a largest strain [1]."""
    return -math.log(strain) if strain > 0.0 else math.inf


def _are_apart(one: Solution, other: Solution) -> bool:
    law = slice(0, len(LAW))
    sd = np.sqrt(np.maximum(other.covariance.diagonal()[law], 1e-300))
    return bool(np.max(np.abs(one.mean - other.mean)[law] / sd) > _SAME)


def _with_linear(posterior: Posterior, points: Points, modes: Modes, strain: float) -> Modes:
    """Return the modes with that of a law that is linear over the record."""
    best = modes.best
    sd = math.sqrt(max(float(best.covariance[LOG_GN, LOG_GN]), 0.0))
    if strain <= 0.0 or sd == 0.0:
        return modes
    boundary = _boundary(strain)
    beyond = (float(best.mean[LOG_GN]) - boundary) / sd
    state = best.maximum.state.copy()
    state[LOG_GN] = min(float(state[LOG_GN]), boundary)
    scales = best.best_scales
    linear = posterior.given(LOG_GN, points, state, scales, _FIRST_STEPS)
    if not linear.is_solved:
        here = evidence_under(posterior, points, linear, best.maximum.errors, LOG_GN)
        if here < best.log_evidence - _HOPELESS:
            return modes
        linear = posterior.given(LOG_GN, points, linear.maximum.state, scales)
    mean = float(posterior.belief.mean[LOG_GN])
    # Whatever the others are: after an earlier press they are known together.
    width = math.sqrt(float(posterior.belief.variances()[LOG_GN]))
    place = (boundary - mean) / width
    there = posterior.evidence(points, replace(best.maximum, scales=scales))
    here = evidence_under(posterior, points, linear, best.maximum.errors, LOG_GN)
    gain = here - there + 0.5 * ((state[LOG_GN] - mean) / width) ** 2
    gain += math.log(width) + float(log_ndtr(place)) - float(log_ndtr(beyond))
    log_gain = float(np.logaddexp(modes.log_gain, gain))
    if beyond < 0.0 and best.maximum.state[LOG_GN] < boundary:
        # The maximum is that of the linear law itself.
        gain, log_gain = math.inf, modes.log_gain
    weight = float(expit(gain + math.log(modes.weight)))
    # Moments of the prior cut off at the boundary.
    ratio = math.exp(-0.5 * place**2 - 0.5 * math.log(2.0 * math.pi) - float(log_ndtr(place)))
    moments, covariance = linear.mean.copy(), linear.covariance.copy()
    moments[LOG_GN] = mean - width * ratio
    covariance[LOG_GN], covariance[:, LOG_GN] = 0.0, 0.0
    covariance[LOG_GN, LOG_GN] = width**2 * max(1.0 - ratio * (place + ratio), 1e-6)
    rest = 1.0 - weight
    others = tuple(m._replace(weight=rest * m.weight) for m in modes.others)
    others = (*others, Member(weight, moments, covariance))
    return Modes(modes.solutions, rest * modes.weight, others, log_gain)
