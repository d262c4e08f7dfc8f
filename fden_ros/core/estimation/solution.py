# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""A solution: Laplace covariance and evidence about a maximum, averaged over the scales.

.. math::
    -2 \ln p(\theta \mid y) = r^T S^{-1} r + \ln|S| + (\theta - m)^T \Lambda\,(\theta - m) + \dots

with r = y - f(theta).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.density import EVALUATION_COST, Density, Linear, Maximum
from fden_ros.core.estimation.error_model import Errors
from fden_ros.core.estimation.loops import WalkState
from fden_ros.core.estimation.mixture import NEGLIGIBLE
from fden_ros.core.estimation.scales import Scales, WeighedScales
from fden_ros.core.estimation.unknowns import ORDER


@dataclass(frozen=True)
class Solution:
    """The posterior given a record."""

    maximum: Maximum  #: about which everything is linear
    #: Of the mixture over the scales, (n,), (n, n).
    mean: Array
    covariance: Array
    scales: dict[Scales, float]  #: probabilities of the scales
    log_evidence: float
    #: Of the maximum, whitened: independent and of variance 1 where the model is right, (m,).
    residuals: Array
    #: The walks at the end of the record: their means, for the residuals at the maximum and for
    #: the unknowns' columns, and their covariance, at the best scales.
    walk: WalkState
    #: What the uncertainty of an order that is not learned adds to the covariance, (n, n).
    considered: Array | None = None
    #: Standard deviations by which alpha wants beyond an end of what there is [1].
    beyond_bound: float = 0.0
    #: Place of an unknown that is held; None: it is about a maximum.
    held: int | None = None

    @property
    def is_solved(self) -> bool:
        """Whether the maximum wants no further step."""
        return self.maximum.is_solved

    @property
    def best_scales(self) -> Scales:
        """The likeliest scales."""
        return max(self.scales, key=lambda s: self.scales[s])


class _Group(NamedTuple):
    """Places of a grid that have roughness and motion in common."""

    about: Linear
    equations: loops.Scaled
    places: list[Scales]
    scales: Array  #: inverse squares of those of kernel and characteristic, (places, 2)
    evidence: Array  #: logarithms, (places,)


def cost_of(points: Points, grid: Sequence[WeighedScales]) -> int:
    """Return what a mixture over a grid costs, in points evaluated."""
    # A place of the grid costs as much as 10 points.
    return EVALUATION_COST + points.times.size + 10 * len(grid)


def averaged(
    density: Density,
    points: Points,
    maximum: Maximum,
    grid: Sequence[WeighedScales],
    held: int | None = None,
) -> Solution:
    """Return the mixture over the scales of a grid, from one linearisation.

    Parameters
    ----------
    held : int or None
        Place of an unknown that is as it is at the maximum.

    Raises
    ------
    FloatingPointError
        If no scale has a finite evidence.
    """
    groups, best = _weighed(density, points, maximum, grid, held)
    found = _mixture(density, maximum, groups, best)
    if held is not None:
        found.covariance[held], found.covariance[:, held] = 0.0, 0.0
        found = replace(found, held=held)
    return _from_bound(density, found, groups, held) if maximum.is_at_bound else found


def _weighed(
    density: Density,
    points: Points,
    maximum: Maximum,
    grid: Sequence[WeighedScales],
    held: int | None,
) -> tuple[list[_Group], float]:
    """Return the places of a grid with their log evidence, and the highest of all.

    An order at a bound stays there.
    """
    stays = {held} if held is not None else set()
    if maximum.is_at_bound:
        stays.add(ORDER)
    priors = density.priors(maximum.state)
    off = density.belief.mean - maximum.state
    tails = density.tails(maximum.state)
    by_walks: dict[tuple[float, float], list[WeighedScales]] = {}
    for weighed in grid:
        by_walks.setdefault(weighed.scales[2:], []).append(weighed)
    groups = []
    for walks, own in by_walks.items():
        about = density.linear(points, maximum.evaluation, maximum.errors, *walks)
        equations = priors.equations(about, off, stays)
        places = [weighed.scales for weighed in own]
        scales = priors.inverse_squares(places)
        evidence = loops.weigh(equations, scales)
        evidence += [w.log_prior + 0.5 * priors.log_determinant(w.scales) for w in own]
        evidence -= 0.5 * (about.square + about.log_determinant + tails)
        groups.append(_Group(about, equations, places, scales, evidence))
    if maximum.is_at_bound:
        share = _beside_bound(density, maximum, groups[0].about, maximum.scales, held).log_share
        for group in groups:
            np.add(group.evidence, share, out=group.evidence)
    best = max(float(np.fmax.reduce(group.evidence)) for group in groups)
    if not math.isfinite(best):
        raise FloatingPointError("no scale of the errors has a finite evidence")
    return groups, best


def _mixture(
    density: Density, maximum: Maximum, groups: Sequence[_Group], best: float
) -> Solution:
    """Return the mixture of all places: their weights are their evidence over the sum of all."""
    likeliest = max(groups, key=lambda group: float(np.fmax.reduce(group.evidence)))
    n = density.model.size
    step, second = np.zeros(n), np.zeros((n, n))
    found: dict[Scales, float] = {}
    for group in groups:
        is_likely = group.evidence >= best - NEGLIGIBLE
        if not is_likely.any():
            continue
        weights = np.exp(group.evidence[is_likely] - best)
        loops.mix(group.equations, group.scales[is_likely], weights, step, second)
        places = (place for place, likely in zip(group.places, is_likely, strict=True) if likely)
        found |= zip(places, weights.tolist(), strict=True)
    total = sum(found.values())
    step /= total
    covariance = second / total - np.outer(step, step)
    covariance[density.known], covariance[:, density.known] = 0.0, 0.0
    return Solution(
        maximum,
        maximum.state + step,
        covariance,
        {scales: weight / total for scales, weight in found.items()},
        best + math.log(total),
        likeliest.about.residuals,
        likeliest.about.walk,
    )


class _BesideBound(NamedTuple):
    """The part of a Gaussian that lies on the side of a bound where there is an order."""

    mean: float  #: of the order, from the bound [1]
    variance: float  #: [1]
    shift: Array  #: of all unknowns by the order, (n,)
    log_share: float  #: of its integral, over the square root of two pi [1]
    beyond: float  #: standard deviations by which the Gaussian's mean is beyond the bound [1]


def _beside_bound(
    density: Density, maximum: Maximum, about: Linear, scales: Scales, held: int | None
) -> _BesideBound:
    """Return the posterior of an order that is at a bound and wants beyond.

    `held`: place of another unknown that stays.
    """
    precision = density.precision(maximum.state, scales)
    normal = about.normal + precision
    towards = about.towards + precision @ (density.belief.mean - maximum.state)
    by_order = normal[:, ORDER].copy()
    curvature, side = by_order[ORDER], towards[ORDER]
    for stays in (ORDER,) if held is None else (ORDER, held):
        normal[stays], normal[:, stays], normal[stays, stays] = 0.0, 0.0, 1.0
        by_order[stays] = towards[stays] = 0.0
    shift = -loops.solve(normal, by_order)
    curvature += float(shift @ by_order)
    pull = float(side + shift @ towards)
    shift[ORDER] = 1.0
    # Rounding may leave no curvature by the order.
    sd = 1.0 / math.sqrt(max(float(curvature), 1e-6))
    # Of a Gaussian that is cut off at z standard deviations above its mean.
    z = abs(pull) * sd
    log_root_two_pi = 0.5 * math.log(2.0 * math.pi)
    # So far out the tail of a Gaussian is an exponential.
    if z > 30.0:
        mean, variance, log_tail = sd / z, (sd / z) ** 2, -math.log(z) - log_root_two_pi
    else:
        log_tail = float(log_ndtr(-z)) + 0.5 * z**2
        hazard = math.exp(-log_tail - log_root_two_pi)
        mean, variance = sd * (hazard - z), sd**2 * (1.0 - hazard * (hazard - z))
    log_share = math.log(sd) + log_tail
    return _BesideBound(math.copysign(mean, -pull), variance, shift, log_share, z)


def _from_bound(
    density: Density, found: Solution, groups: Sequence[_Group], held: int | None
) -> Solution:
    """Return a solution with what is known of an order at a bound."""
    scales = found.best_scales
    about = next(group.about for group in groups if scales in group.places)
    order = _beside_bound(density, found.maximum, about, scales, held)
    moved = found.mean + order.mean * order.shift
    spread = order.variance * np.outer(order.shift, order.shift)
    covariance = found.covariance.copy()
    covariance[ORDER], covariance[:, ORDER] = 0.0, 0.0
    return replace(found, mean=moved, covariance=covariance + spread, beyond_bound=order.beyond)


def log_evidence(
    density: Density,
    points: Points,
    maximum: Maximum,
    grid: Sequence[WeighedScales],
    held: int | None = None,
) -> float:
    """Return the log evidence of :func:`averaged`, which takes the same."""
    groups, best = _weighed(density, points, maximum, grid, held)
    # What is negligible counts as nothing here as there.
    likely = [g.evidence[g.evidence >= best - NEGLIGIBLE] - best for g in groups]
    return best + math.log(float(np.exp(np.concatenate(likely)).sum()))


def evidence_under(
    density: Density,
    points: Points,
    solution: Solution,
    errors: Errors,
    grid: Sequence[WeighedScales],
) -> float:
    """Return the log evidence of a solution as it is under other errors, over a grid of scales.

    Where solutions are compared the errors are the same: each has its own at its stiffness, and
    where more is stated of them than there is the softer tissue would win. Under the errors of
    another the same scales need not be best.
    """
    return log_evidence(density, points, replace(solution.maximum, errors=errors), grid)
