# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The Laplace solutions of one posterior: its maxima, and what is proposed beside them.

Starts may lead to maxima that are apart. Each that is likely is kept, and followed as the record
grows. A linear law and a hidden origin have none: they hold an unknown.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.mixture import NEGLIGIBLE, Component, moments, weights_of
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.proposals import functions
from fden_ros.core.estimation.scales import Scales
from fden_ros.core.estimation.solution import Solution, cost_of, evidence_under
from fden_ros.core.estimation.unknowns import LAW, LOG_GN

#: Maxima closer than this many standard deviations are one [1].
_SAME = 0.2
#: Above the boundary by less than this a law is as good as linear, and one that bends begins so
#: far above it [1].
NEAR_BOUNDARY, _BENT = 0.05, 0.3


@dataclass(frozen=True)
class Solutions:
    """Solutions of one posterior, with the log evidence of each under the same errors."""

    maxima: tuple[Solution, ...]  #: the likeliest first
    #: One each; minus infinity: another solution stands for it.
    log_evidence: tuple[float, ...]
    #: Solutions that hold an unknown, and their log evidence.
    held: tuple[Solution, ...] = ()
    held_log_evidence: tuple[float, ...] = ()
    #: States of those of a shorter record: where to begin [1].
    earlier: tuple[Array, ...] = ()

    @property
    def best(self) -> Solution:
        """That about the likeliest maximum."""
        return self.maxima[0]

    @property
    def all(self) -> tuple[Solution, ...]:
        """Maxima, then what is held."""
        return self.maxima + self.held

    @property
    def total(self) -> float:
        """Log evidence of all."""
        return float(logsumexp(self.log_evidence + self.held_log_evidence))

    @property
    def weights(self) -> Array:
        """Weights of all, which add up to 1."""
        return weights_of(self.log_evidence + self.held_log_evidence)

    @property
    def components(self) -> tuple[Component, ...]:
        """All that have a weight, as Gaussians."""
        added = self.best.considered if self.best.considered is not None else 0.0
        pairs = zip(self.weights.tolist(), self.all, strict=True)
        return tuple(Component(w, s.mean, s.covariance + added) for w, s in pairs if w)

    @property
    def moments(self) -> tuple[Array, Array]:
        """Mean and covariance of all."""
        return moments(self.components)


class Proposed(NamedTuple):
    """What a proposal adds to the maxima of a posterior."""

    #: Solutions that hold an unknown, each with its log evidence.
    held: tuple[tuple[float, Solution], ...] = ()
    #: Logarithms of what they leave of each maximum; empty: all of it.
    log_shares: tuple[float, ...] = ()


def completed(
    posterior: Posterior, points: Points, maxima: Solutions, strain: float
) -> Parts[Solutions]:
    """Return maxima with what proposals add to them.

    Parameters
    ----------
    posterior : Posterior
    points : Points
    maxima : Solutions
    strain : float
        Largest strain of the record [1].
    """
    proposed = []
    for propose in functions("propose"):
        proposed.append((yield from propose(posterior, points, maxima, strain)))
    return combined(maxima, proposed)


def combined(maxima: Solutions, proposed: Sequence[Proposed]) -> Solutions:
    """Return maxima with what was proposed; the order of proposals does not matter."""
    shares = np.zeros(len(maxima.maxima))
    for one in proposed:
        if one.log_shares:
            shares = shares + one.log_shares
    held = [pair for one in proposed for pair in one.held]
    return Solutions(
        maxima.maxima,
        tuple((np.array(maxima.log_evidence) + shares).tolist()),
        tuple(solution for _, solution in held),
        tuple(evidence for evidence, _ in held),
    )


def boundary_of(strain: float) -> float:
    """Return ln Gn of a law that is just linear up to a largest strain [1]."""
    return -math.log(strain) if strain > 0.0 else math.inf


def find_maxima(
    posterior: Posterior,
    points: Points,
    starts: Sequence[Array],
    scales: Scales,
    before: Sequence[tuple[Array, Solution]],
    strain: float,
) -> Parts[Solutions]:
    """Return the maxima that starts lead to, and those of a shorter record.

    Parameters
    ----------
    posterior : Posterior
    points : Points
    starts : sequence of ndarray, shape (n,)
    scales : Scales
        To begin with at these.
    before : sequence of (ndarray, Solution)
        Maxima of the shorter record, with their states by now: at their own scales, which others
        would be no match for.
    strain : float
        Largest strain of the record [1].

    Raises
    ------
    FloatingPointError
        If the stress is not finite at any start.
    """
    found = yield from posterior.solutions_in_parts(points, starts, scales)
    found += yield from _followed(posterior, points, before, strain)
    return (yield from _weighed(posterior, points, found))


def follow_maxima(
    posterior: Posterior,
    points: Points,
    before: Sequence[tuple[Array, Solution]],
    strain: float,
) -> Parts[Solutions]:
    """Return the maxima that those of a shorter record, with their states by now, lead to.

    Raises
    ------
    FloatingPointError
        If the stress is not finite at any of them.
    """
    found = yield from _followed(posterior, points, before, strain)
    if not found:
        raise FloatingPointError("the stress is not finite at any maximum")
    return (yield from _weighed(posterior, points, found))


def _followed(
    posterior: Posterior,
    points: Points,
    before: Sequence[tuple[Array, Solution]],
    strain: float,
) -> Parts[list[Solution]]:
    boundary = boundary_of(strain)
    found = []
    for state, solution in before:
        begun = [state]
        if state[LOG_GN] < boundary + NEAR_BOUNDARY and not posterior.is_known(LOG_GN):
            # Of a linear law no derivative leads to a bend.
            bent = state.copy()
            bent[LOG_GN] = boundary + _BENT
            begun.append(bent)
        for one in begun:
            with contextlib.suppress(*UNSOLVABLE):
                found.append((yield from posterior.tracked_in_parts(points, one, solution)))
    return found


def _weighed(posterior: Posterior, points: Points, found: Sequence[Solution]) -> Parts[Solutions]:
    """Return the maxima that are apart, weighed by their evidence under the same errors."""
    found = _different(sorted(found, key=lambda s: -s.log_evidence))
    if len(found) == 1:
        return Solutions((found[0],), (found[0].log_evidence,))
    errors = found[0].maximum.errors
    evidence = np.empty(len(found))
    for k, one in enumerate(found):
        evidence[k] = evidence_under(posterior, points, one, errors, posterior.grid)
        yield cost_of(points, posterior.grid)
    likely = [k for k in np.argsort(-evidence) if evidence[k] >= evidence.max() - NEGLIGIBLE]
    # So that a solution has a longest time: no recording had a fourth maximum.
    kept = likely[:3]
    return Solutions(tuple(found[k] for k in kept), tuple(evidence[kept].tolist()))


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
