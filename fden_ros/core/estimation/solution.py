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

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.density import Density, Linear
from fden_ros.core.estimation.error_model import Errors
from fden_ros.core.estimation.loop_arguments import ResponseState, WalkState
from fden_ros.core.estimation.maximum import Maximum, inverted
from fden_ros.core.estimation.record import Points
from fden_ros.core.estimation.scales import Scales, WeighedScales

#: What is less likely than the best by this logarithm does not count [1]: one in ten thousand.
NEGLIGIBLE = 9.0


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

    @property
    def is_solved(self) -> bool:
        """Whether the maximum wants no further step."""
        return self.maximum.is_solved

    @property
    def best_scales(self) -> Scales:
        """The likeliest scales."""
        return max(self.scales, key=lambda s: self.scales[s])

    @property
    def response_state(self) -> ResponseState:
        """From which the response goes on."""
        return self.maximum.evaluation.state


class _Member(NamedTuple):
    """The posterior at one place of the grid of scales."""

    log_evidence: float
    scales: Scales
    equations: Array  #: the normal equations, and the gradient behind them


#: What a place of the grid costs, in points evaluated [1].
_PLACE_COST = 10


def cost_of(points: Points, grid: Sequence[WeighedScales]) -> int:
    """Return what a mixture over a grid costs, in points evaluated."""
    return points.times.size + _PLACE_COST * len(grid)


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
    density : Density
    points : Points
    maximum : Maximum
    grid : sequence of WeighedScales
    held : int or None
        Place of an unknown that is as it is at the maximum.

    Raises
    ------
    FloatingPointError
        If no scale has a finite evidence.
    """
    priors = density.priors(maximum.state)
    off = density.belief.mean - maximum.state
    # Scales of roughness and motion have the same prior.
    fields = {w.scales[:2]: w.scales for w in grid}
    precisions = {place: priors.precision(scales) for place, scales in fields.items()}
    determinants = {place: priors.log_determinant(scales) for place, scales in fields.items()}
    groups: dict[tuple[float, float], list[WeighedScales]] = {}
    for weighed in grid:
        groups.setdefault(weighed.scales[2:], []).append(weighed)
    tails = density.tails(maximum.state)
    members: list[_Member] = []
    best, about_best = -math.inf, None
    for (roughness, motion), group in groups.items():
        about = density.linear(points, maximum.evaluation, maximum.errors, roughness, motion)
        of_group = np.array([precisions[w.scales[:2]] for w in group])
        pulls = of_group @ off
        equations = np.empty((len(group), off.size, off.size + 1))
        equations[:, :, :-1] = about.normal + of_group
        equations[:, :, -1] = about.towards + pulls
        if held is not None:
            equations[:, held], equations[:, :, held] = 0.0, 0.0
            equations[:, held, held] = 1.0
        factors = equations.copy()
        loops.eliminate(factors)
        volumes = np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)
        log_priors = [w.log_prior + 0.5 * determinants[w.scales[:2]] for w in group]
        square = float(about.residuals @ about.residuals) + about.log_determinant + tails
        evidence = log_priors - volumes
        evidence += 0.5 * (np.sum(factors[:, :, -1] ** 2, axis=1) - square - pulls @ off)
        members += map(_Member, evidence, [w.scales for w in group], equations)
        if evidence.max() > best:
            best, about_best = float(evidence.max()), about
    if about_best is None:
        raise FloatingPointError("no scale of the errors has a finite evidence")
    members = [m for m in members if m.log_evidence >= best - NEGLIGIBLE]
    return _mixture(density, maximum, members, best, about_best)


def _mixture(
    density: Density, maximum: Maximum, members: list[_Member], best: float, linear: Linear
) -> Solution:
    weights = np.exp([m.log_evidence - best for m in members])
    total = float(weights.sum())
    weights /= total
    roots, steps = inverted(np.array([m.equations for m in members]))
    about = maximum.state + steps
    mean: Array = weights @ about
    flat = (np.sqrt(weights)[:, None, None] * roots).reshape(-1, density.model.size)
    apart = np.sqrt(weights)[:, None] * (about - mean)
    covariance = flat.T @ flat + apart.T @ apart
    covariance[density.known], covariance[:, density.known] = 0.0, 0.0
    return Solution(
        maximum,
        mean,
        covariance,
        {m.scales: float(w) for w, m in zip(weights, members, strict=True)},
        best + math.log(total),
        linear.residuals,
        linear.walk,
    )


def evidence_at(
    density: Density, points: Points, maximum: Maximum, held: int | None = None
) -> float:
    """Return the log evidence at the scales of a maximum; `held` is that of `averaged`."""
    place = (WeighedScales(maximum.scales, 0.0),)
    return averaged(density, points, maximum, place, held).log_evidence


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
    return averaged(density, points, replace(solution.maximum, errors=errors), grid).log_evidence
