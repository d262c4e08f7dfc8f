# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""A posterior of several modes.

- Starts may lead to maxima that are apart. Each that is likely is kept and followed.
- Below the boundary strain 1/Gn the law is linear, and the likelihood says nothing of Gn. A
  posterior near there is one mode beyond the boundary, and the prior of ln Gn cut off at
  :math:`b = -\ln x_{max}`. With the likelihood L(b) of a linear law its weight is

.. math:: L(b) \int_{-\infty}^{b} p(l)\, dl .

- Beyond the boundary strain the stress grows as :math:`e^{G_n x}`. Where noise hides what comes
  before, the data tell of the strain origin o and G only :math:`G e^{-G_n o}`, as far as the prior
  of both goes. Along that ridge there are nodes; of each counts what the modes leave out there.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, log_ndtr, ndtr

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import Member, mixture
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.press_model import Evaluation
from fden_ros.core.estimation.record import Points
from fden_ros.core.estimation.scales import Scales
from fden_ros.core.estimation.solution import (
    NEGLIGIBLE,
    Solution,
    cost_of,
    evidence_at,
    evidence_under,
)
from fden_ros.core.estimation.unknowns import LAW, LOG_G, LOG_GN, ORIGIN

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
#: Nodes of a hidden origin on each side of the maximum [1], and their steps.
_NODES, _NODE_STEPS = 12, 3
#: A ridge that is less likely than this does not count [1]: its variance would widen an interval
#: of which it is no part.
_TAIL = 0.01
#: An origin that is known to this part of the distance of two nodes is not hidden [1].
_SEEN = 0.5


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
) -> Parts[Modes]:
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
    found = yield from posterior.solutions_in_parts(points, starts, scales, converged)
    found += yield from _followed(posterior, points, before, strain)
    modes = yield from _weighed(posterior, points, found, strain)
    return (yield from _completed(posterior, points, modes, strain))


def follow_modes(
    posterior: Posterior,
    points: Points,
    before: Sequence[tuple[Array, Solution]],
    strain: float,
) -> Parts[Modes]:
    """Return the modes that those of a shorter record, with their states by now, lead to.

    Raises
    ------
    FloatingPointError
        If the stress is not finite at any of them.
    """
    modes = yield from follow_maxima(posterior, points, before, strain)
    return (yield from _completed(posterior, points, modes, strain))


def follow_maxima(
    posterior: Posterior,
    points: Points,
    before: Sequence[tuple[Array, Solution]],
    strain: float,
) -> Parts[Modes]:
    """Return the modes of :func:`follow_modes` that have a maximum.

    Raises
    ------
    FloatingPointError
        If the stress is not finite at any of them.
    """
    found = yield from _followed(posterior, points, before, strain)
    if not found:
        raise FloatingPointError("the stress is not finite at any mode")
    return (yield from _weighed(posterior, points, found, strain))


def _followed(
    posterior: Posterior,
    points: Points,
    before: Sequence[tuple[Array, Solution]],
    strain: float,
) -> Parts[list[Solution]]:
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
                found.append((yield from posterior.tracked_in_parts(points, one, solution)))
    return found


def _weighed(
    posterior: Posterior, points: Points, found: Sequence[Solution], strain: float
) -> Parts[Modes]:
    """Return the modes that are apart, weighed by their evidence under the same errors."""
    found = _different(sorted(found, key=lambda s: -s.log_evidence))
    if len(found) == 1:
        return Modes((found[0],))
    errors = found[0].maximum.errors
    evidence = np.empty(len(found))
    for k, one in enumerate(found):
        evidence[k] = evidence_under(posterior, points, one, errors, posterior.grid)
        yield cost_of(points, posterior.grid)
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
    return Modes(solutions, kept[0][0] / total, others, math.log(total / kept[0][0]))


def _completed(posterior: Posterior, points: Points, modes: Modes, strain: float) -> Parts[Modes]:
    """Return the modes with those that have no maximum."""
    modes = yield from _with_hidden_origin(posterior, points, modes, strain)
    return (yield from _with_linear(posterior, points, modes, strain))


def _boundary(strain: float) -> float:
    """Return ln Gn of a law that is just linear up to a largest strain [1]."""
    return -math.log(strain) if strain > 0.0 else math.inf


def _different(found: Sequence[Solution]) -> list[Solution]:
    """Return the solutions without those about the maximum of one before them.

    To weigh one takes as long as five steps.
    """
    result: list[Solution] = []
    for one in found:
        if all(_are_apart(one, other) for other in result):
            result.append(one)
    return result


def _are_apart(one: Solution, other: Solution) -> bool:
    law = slice(0, len(LAW))
    sd = np.sqrt(np.maximum(other.covariance.diagonal()[law], 1e-300))
    return bool(np.max(np.abs(one.mean - other.mean)[law] / sd) > _SAME)


def _with_hidden_origin(
    posterior: Posterior, points: Points, modes: Modes, strain: float
) -> Parts[Modes]:
    """Return the modes with the ridge of an origin that noise hides."""
    best, model = modes.best, posterior.model
    if posterior.is_known(ORIGIN) or strain <= 0.0:
        return modes
    slope = model.geometry.strain_slope(model.geometry.compression(strain))
    # So far from node to node that G is e times as large; in units of the origin's deviation.
    growth = math.exp(float(best.mean[LOG_GN])) * slope * model.unknowns[ORIGIN].sd
    if growth == 0.0:
        return modes
    step = 1.0 / growth
    if math.sqrt(float(posterior.belief.variances()[ORIGIN])) < _SEEN * step:
        return modes
    there = posterior.evidence(points, replace(best.maximum, scales=best.best_scales))
    width = step / math.sqrt(2.0 * math.pi)
    found = []
    for way in (-step, step):
        nodes = yield from _nodes(posterior, points, best, way, there)
        for evidence, node in nodes:
            taken = _share_near(modes, float(node.mean[ORIGIN]), step) / modes.weight
            left_out = width * math.exp(min(evidence - there, NEGLIGIBLE)) - taken
            if left_out > 0.0:
                found.append(node._replace(weight=left_out))
    ridge = sum(node.weight for node in found)
    if ridge * modes.weight < _TAIL:
        return modes
    total = 1.0 / modes.weight + ridge
    others = [m._replace(weight=m.weight / modes.weight / total) for m in modes.others]
    others += [node._replace(weight=node.weight / total) for node in found]
    return Modes(modes.solutions, 1.0 / total, tuple(others), math.log(total))


def _nodes(
    posterior: Posterior, points: Points, best: Solution, way: float, there: float
) -> Parts[list[tuple[float, Member]]]:
    """Return the likely nodes of the ridge on one side of a maximum, with their log evidence.

    `there`: that of the maximum. The ridge ends at the first node that is negligible beside it.
    """
    state, before, highest = best.maximum.state, best.mean, there
    found: list[tuple[float, Member]] = []
    for _ in range(_NODES):
        if posterior.limit.is_reached:
            break
        state = state.copy()
        state[ORIGIN] += way
        state[LOG_G] += math.copysign(1.0, way)
        try:
            scales = best.best_scales
            node = yield from posterior.given(ORIGIN, points, state, scales, _NODE_STEPS)
            evidence = _under(posterior, points, node, best, ORIGIN)
        except UNSOLVABLE:
            break
        highest = max(highest, evidence)
        if evidence < highest - NEGLIGIBLE:
            break
        moved = node.mean[ORIGIN] - before[ORIGIN]
        if not moved:
            break
        along = (node.mean - before) * (way / moved)
        covariance = node.covariance + np.outer(along, along) / 12.0
        found.append((evidence, Member(1.0, node.mean, covariance)))
        state, before = node.maximum.state, node.mean
    return found


def _share_near(modes: Modes, origin: float, width: float) -> float:
    """Return the probability that modes give to origins about one, so wide."""
    share = 0.0
    for mode in modes.members(modes.best.mean, modes.best.covariance):
        sd = math.sqrt(max(float(mode.covariance[ORIGIN, ORIGIN]), 1e-300))
        places = (origin - float(mode.mean[ORIGIN]) + np.array([-0.5, 0.5]) * width) / sd
        share += mode.weight * float(np.diff(ndtr(places))[0])
    return share


def _with_linear(
    posterior: Posterior, points: Points, modes: Modes, strain: float
) -> Parts[Modes]:
    """Return the modes with that of a law that is linear over the record."""
    best = modes.best
    sd = math.sqrt(max(float(best.covariance[LOG_GN, LOG_GN]), 0.0))
    if strain <= 0.0 or sd == 0.0:
        return modes
    boundary = _boundary(strain)
    beyond = (float(best.mean[LOG_GN]) - boundary) / sd
    state = best.maximum.state
    known: Evaluation | None = best.maximum.evaluation
    if state[LOG_GN] > boundary:
        state, known = state.copy(), None
        state[LOG_GN] = boundary
    scales = best.best_scales
    linear = yield from posterior.given(LOG_GN, points, state, scales, _FIRST_STEPS, known)
    if not linear.is_solved:
        if _under(posterior, points, linear, best, LOG_GN) < best.log_evidence - _HOPELESS:
            return modes
        begun = linear.maximum
        known = begun.evaluation
        linear = yield from posterior.given(LOG_GN, points, begun.state, scales, known=known)
    if best.maximum.state[LOG_GN] < boundary and linear.is_solved:
        # A linear law does not meet ln Gn: that it wants to go on in it holds nothing up.
        best = replace(best, maximum=replace(best.maximum, is_solved=True))
        modes = replace(modes, solutions=(best, *modes.solutions[1:]))
    mean = float(posterior.belief.mean[LOG_GN])
    # Whatever the others are: after an earlier press they are known together.
    width = math.sqrt(float(posterior.belief.variances()[LOG_GN]))
    place = (boundary - mean) / width
    there = posterior.evidence(points, replace(best.maximum, scales=scales))
    here = _under(posterior, points, linear, best, LOG_GN)
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


def _under(
    posterior: Posterior, points: Points, given: Solution, best: Solution, place: int
) -> float:
    """Return the log evidence, given the unknown at a place, under the errors of the best."""
    maximum = replace(given.maximum, errors=best.maximum.errors)
    return evidence_at(posterior, points, maximum, place)
