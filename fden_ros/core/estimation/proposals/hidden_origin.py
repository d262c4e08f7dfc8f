# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""A strain origin that noise hides: nodes along a ridge, each with the origin held.

Beyond the boundary strain the stress grows as :math:`e^{G_n x}`. Where noise hides what comes
before, the data tell of the strain origin o and G only :math:`G e^{-G_n o}`, as far as the prior
of both goes. Along that ridge there are nodes; of each counts what the maxima leave out there.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.maxima import Proposed, Solutions, boundary_of
from fden_ros.core.estimation.mixture import NEGLIGIBLE, Component, moments
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.solution import Solution
from fden_ros.core.estimation.unknowns import LOG_G, LOG_GN, ORIGIN


def propose(
    posterior: Posterior, points: Points, found: Solutions, strain: float
) -> Parts[Proposed]:
    """Return the solutions of the ridge on each side of the best maximum."""
    best, model = found.best, posterior.model
    if posterior.is_known(ORIGIN) or strain <= 0.0:
        return Proposed()
    if best.maximum.state[LOG_GN] < boundary_of(strain):
        # The ridge is that of a bend.
        return Proposed()
    slope = model.geometry.strain_slope(model.geometry.compression(strain))
    # So far from node to node that G is e times as large; in units of the origin's deviation.
    growth = math.exp(float(best.mean[LOG_GN])) * slope * model.unknowns[ORIGIN].sd
    if growth == 0.0:
        return Proposed()
    step = 1.0 / growth
    # An origin that is known to half the distance of two nodes is not hidden.
    if math.sqrt(float(posterior.belief.variances()[ORIGIN])) < 0.5 * step:
        return Proposed()
    there = posterior.evidence(points, replace(best.maximum, scales=best.best_scales))
    width = step / math.sqrt(2.0 * math.pi)
    sides: list[tuple[float, Solution]] = []
    for way in (-step, step):
        nodes = yield from _nodes(posterior, points, best, way, there)
        left_out = []
        for evidence, node in nodes:
            taken = _share_near(found, float(node.mean[ORIGIN]), step)
            share = width * math.exp(min(evidence - there, NEGLIGIBLE)) - taken
            if share > 0.0:
                left_out.append((share, node))
        if left_out:
            sides.append(_together(left_out))
    maxima = sum(math.exp(e - found.log_evidence[0]) for e in found.log_evidence)
    # The variance of a less likely ridge would widen an interval of which it is no part: of the
    # example's first press by a third.
    if sum(share for share, _ in sides) < 0.01 * maxima:
        return Proposed()
    return Proposed(tuple((found.log_evidence[0] + math.log(w), node) for w, node in sides))


def _nodes(
    posterior: Posterior, points: Points, best: Solution, way: float, there: float
) -> Parts[list[tuple[float, Solution]]]:
    """Return the likely nodes of the ridge on one side of a maximum, with their log evidence.

    `there`: that of the maximum. The ridge ends at the first node that is negligible beside it.
    """
    state, before, highest = best.maximum.state, best.mean, there
    found: list[tuple[float, Solution]] = []
    # So that a solution has a longest time: 12 nodes, of 3 steps each.
    for _ in range(12):
        if posterior.limit.is_reached:
            break
        state = state.copy()
        state[ORIGIN] += way
        state[LOG_G] += math.copysign(1.0, way)
        try:
            scales = best.best_scales
            node = yield from posterior.given(ORIGIN, points, state, scales, 3)
            evidence = posterior.evidence_beside(points, node, best)
        except UNSOLVABLE:
            break
        highest = max(highest, evidence)
        if evidence < highest - NEGLIGIBLE:
            break
        # Each stands for all origins half way to the next.
        along = (node.mean - before) * (way / (node.mean[ORIGIN] - before[ORIGIN]))
        covariance = node.covariance + np.outer(along, along) / 12.0
        found.append((evidence, replace(node, covariance=covariance)))
        state, before = node.maximum.state, node.mean
    return found


def _together(nodes: list[tuple[float, Solution]]) -> tuple[float, Solution]:
    """Return the share of some nodes, and the likeliest of them with the moments of all."""
    total = sum(share for share, _ in nodes)
    mean, covariance = moments([Component(w / total, s.mean, s.covariance) for w, s in nodes])
    _, likeliest = max(nodes, key=lambda node: node[0])
    return total, replace(likeliest, mean=mean, covariance=covariance)


def _share_near(found: Solutions, origin: float, width: float) -> float:
    """Return what maxima have at origins about one, so wide, over what the first has in all."""
    share = 0.0
    for evidence, one in zip(found.log_evidence, found.maxima, strict=True):
        sd = math.sqrt(max(float(one.covariance[ORIGIN, ORIGIN]), 1e-300))
        places = (origin - float(one.mean[ORIGIN]) + np.array([-0.5, 0.5]) * width) / sd
        share += math.exp(evidence - found.log_evidence[0]) * float(np.diff(ndtr(places))[0])
    return share
