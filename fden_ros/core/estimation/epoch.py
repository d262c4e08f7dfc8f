# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""All hypotheses solved of one record, and weighed under the same errors."""

from __future__ import annotations

import math
from collections.abc import Sequence

from scipy.special import logsumexp

from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.hypothesis import Hypothesis
from fden_ros.core.estimation.mixture import NEGLIGIBLE
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.posterior import UNSOLVABLE
from fden_ros.core.estimation.search import Search, Solved
from fden_ros.core.estimation.solution import cost_of, evidence_under

#: A solution with its log evidence; None: it was not found.
Weighed = tuple[Solved, float] | None


def solved_together(searches: Sequence[Search]) -> Parts[list[Weighed]]:
    """Return the solutions of all hypotheses, of one record, in parts.

    Each has its log evidence, under the same errors; None: there is none.

    Raises
    ------
    FloatingPointError
        If there is none of any.
    """
    found: list[Solved | None] = []
    for search in searches:
        try:
            found.append((yield from search.in_parts()))
        except UNSOLVABLE:
            found.append(None)
    solved = [one for one in found if one is not None]
    if not solved:
        raise FloatingPointError("no hypothesis has a solution")
    best = max(solved, key=lambda one: one.log_evidence)
    result: list[Weighed] = []
    for search, one in zip(searches, found, strict=True):
        if one is None:
            result.append(None)
            continue
        evidence = one.log_evidence
        if one is not best:
            yield cost_of(search.points, one.posterior.grid)
            evidence += _under(search.points, one, best) - one.best.log_evidence
        result.append((one, evidence) if math.isfinite(evidence) else None)
    return result


def _under(points: Points, one: Solved, best: Solved) -> float:
    """Return the log evidence of the best maximum under the errors of another solution."""
    try:
        grid = one.posterior.grid
        return evidence_under(one.posterior, points, one.best, best.best.maximum.errors, grid)
    except UNSOLVABLE:
        return -math.inf


def taken_over(
    hypotheses: Sequence[Hypothesis], found: Sequence[Weighed]
) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """Let hypotheses go on from their solutions; return those that have one, and those without."""
    solved, missed = [], []
    for one, result in zip(hypotheses, found, strict=True):
        if result is None:
            one.misses += 1
            missed.append(one)
        else:
            one.take_over(*result)
            solved.append(one)
    return solved, missed


def keep_shares(
    before: Sequence[tuple[float, Hypothesis]],
    missed: Sequence[Hypothesis],
    solved: Sequence[Hypothesis],
) -> None:
    """Let hypotheses whose solution was not found keep their weights, which are in `before`.

    All have taken the same blocks.
    """
    shares = [(weight, one) for weight, one in before if one in missed]
    rest = 1.0 - sum(weight for weight, _ in shares)
    total = float(logsumexp([one.log_weight for one in solved]))
    for weight, one in shares:
        one.shift_weight(total + math.log(weight / max(rest, 1e-300)) - one.log_weight)


def kept(solved: Sequence[Hypothesis], missed: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the hypotheses that are not ruled out: by their evidence, or lost twice in a row."""
    most = max(one.log_weight for one in solved)
    return [
        *(one for one in solved if one.log_weight >= most - NEGLIGIBLE),
        *(one for one in missed if one.misses < 2),
    ]
