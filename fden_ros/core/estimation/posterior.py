# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The posterior of a press: its solutions, from starts or from those of a shorter record."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.density import Density, Maximum
from fden_ros.core.estimation.loops import Evaluation
from fden_ros.core.estimation.maximum import MOST_STEPS, MaximumSearch
from fden_ros.core.estimation.mixture import NEGLIGIBLE
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.scales import Scales, WeighedScales, beside
from fden_ros.core.estimation.solution import Solution, averaged, cost_of, log_evidence
from fden_ros.core.estimation.unknowns import LAW, ORDER

#: What numbers do where a state is beyond them: whatever evaluates or solves may raise these.
UNSOLVABLE = (ArithmeticError, np.linalg.LinAlgError)


@dataclass(eq=False)
class Posterior(Density):
    """The posterior of a press given a record."""

    grid: Sequence[WeighedScales]
    #: Standard deviation of an order that is not learned [1]; it counts in the others'.
    order_sd: float = field(default=0.0, kw_only=True)

    def maximum(
        self,
        points: Points,
        start: Array,
        scales: Scales,
        most: int = MOST_STEPS,
        held: int | None = None,
        known: Evaluation | None = None,
    ) -> Parts[Maximum]:
        """Return the maximum that a start leads to: see :class:`MaximumSearch`."""
        search = MaximumSearch(self, points, scales, held, most)
        # What overflows between two parts is for whoever goes on between them.
        parts = search.from_start(start, known)
        while True:
            try:
                with np.errstate(over="ignore", invalid="ignore"):
                    cost = next(parts)
            except StopIteration as end:
                return end.value
            yield cost

    def averaged(
        self, points: Points, best: Maximum, grid: Sequence[WeighedScales], held: int | None = None
    ) -> Parts[Solution]:
        """Return the mixture over a grid of scales: see :func:`averaged`."""
        with np.errstate(over="ignore", invalid="ignore"):
            found = averaged(self, points, best, grid, held)
        yield cost_of(points, grid)
        return found

    def solutions_in_parts(
        self, points: Points, starts: Sequence[Array], scales: Scales
    ) -> Parts[list[Solution]]:
        """Return the posterior about each maximum that the starts lead to, the best first."""
        found: list[Solution] = []
        # Roughly: most starts lead to the same maximum, which is then refined once.
        seen: list[Maximum] = []
        maxima = yield from self._maxima(points, starts, scales)
        for maximum in maxima:
            if any(_are_one(maximum, other) for other in seen):
                continue
            seen.append(maximum)
            with contextlib.suppress(*UNSOLVABLE):
                found.append((yield from self._refined(points, maximum)))
        if not found:
            raise FloatingPointError("no start leads to a maximum with a finite evidence")
        return found

    def is_known(self, place: int) -> bool:
        """Whether the unknown at a place is none."""
        return bool(np.any(self.known == place))

    @property
    def moderate_scales(self) -> Scales:
        """The scales of the grid that are nearest to those of a moderate error, to begin with."""

        def off(scales: Scales) -> float:
            pairs = zip(scales, (0.1, 0.1, 0.06, 1.0), strict=True)
            return sum(abs(math.log((a + 1e-4) / (b + 1e-4))) for a, b in pairs)

        return min((weighed.scales for weighed in self.grid), key=off)

    @property
    def log_prior_density(self) -> float:
        """The log density of the prior at its mean, which no evidence counts.

        Without what is the same for all priors, and without that of errors with scales.
        """
        stop = len(self.model.unknowns) if self.has_field_prior else self.model.size
        open_ = np.setdiff1d(np.arange(stop), self.known)
        precision = self.belief.precision[np.ix_(open_, open_)]
        of_scales = logsumexp([weighed.log_prior for weighed in self.grid])
        return 0.5 * float(np.linalg.slogdet(precision)[1]) - float(of_scales)

    def _refined(self, points: Points, best: Maximum) -> Parts[Solution]:
        """Return the solution about a maximum, at the scales that are best where it begins."""
        found = yield from self.averaged(points, best, self.grid)
        scales = found.best_scales
        if scales != best.scales or not best.is_solved:
            best = yield from self.maximum(points, best.state, scales, known=best.evaluation)
            found = yield from self.averaged(points, best, self.grid)
        return self._considered(points, found)

    def tracked_in_parts(self, points: Points, state: Array, before: Solution) -> Parts[Solution]:
        """Return the posterior from the state of one of a shorter record, in less time.

        The maximum is nearly found, and only the scales beside the best one before are weighed;
        where another is better now, all are.
        """
        scales = before.best_scales
        # Other scales are tried after 12 steps; a growing record takes one to five.
        best = yield from self.maximum(points, state, scales, most=12)
        near = beside(self.grid, scales)
        others = before.scales.keys() - {w.scales for w in near}
        near += tuple(w for w in self.grid if w.scales in others)
        found = yield from self.averaged(points, best, near)
        if found.best_scales == scales and best.is_solved:
            return self._considered(points, found)
        # Under scales that no longer fit, steps are many and short.
        return (yield from self._refined(points, best))

    def given(
        self,
        place: int,
        points: Points,
        state: Array,
        scales: Scales,
        most: int = MOST_STEPS,
        known: Evaluation | None = None,
    ) -> Parts[Solution]:
        """Return the posterior given the unknown at a place, at one place of the grid.

        `most`: steps at most; `known`: the evaluation at the state.
        """
        best = yield from self.maximum(points, state, scales, most, place, known)
        return (yield from self.averaged(points, best, (WeighedScales(scales),), place))

    def _considered(self, points: Points, found: Solution) -> Solution:
        """Return a solution with the covariance that the order's own adds (Schmidt and Kalman)."""
        if not self.order_sd:
            return found
        maximum, scales = found.maximum, found.maximum.scales
        found_with_order = self.model.evaluate(points, maximum.state)
        about = self.linear(
            points, found_with_order, maximum.errors, scales.roughness, scales.motion
        )
        normal = about.normal.copy()
        normal[self.known], normal[:, self.known] = 0.0, 0.0
        by_order = about.normal[:, ORDER].copy()
        by_order[self.known] = 0.0
        normal += self.precision(maximum.state, scales)
        shift = -loops.solve(normal, by_order)
        shift[ORDER] = 1.0
        return replace(found, considered=self.order_sd**2 * np.outer(shift, shift))

    def _maxima(
        self, points: Points, starts: Sequence[Array], scales: Scales
    ) -> Parts[list[Maximum]]:
        """Return the maxima that are likely, best first; they are compared by the same errors."""
        maxima = []
        for start in starts:
            with contextlib.suppress(*UNSOLVABLE):
                maxima.append((yield from self.maximum(points, start, scales)))
        for _ in range(len(maxima) if len(maxima) > 1 else 0):
            best = maxima[0]
            compared = [replace(m, errors=best.errors) for m in maxima]
            evidence = np.array([self.evidence(points, m) for m in compared])
            maxima = [maxima[k] for k in np.argsort(-evidence)]
            if maxima[0] is best:
                return maxima[: np.count_nonzero(evidence > evidence.max() - NEGLIGIBLE)]
        return maxima

    def evidence_beside(self, points: Points, given: Solution, best: Solution) -> float:
        """Return the log evidence of what holds an unknown, under the errors of the best."""
        maximum = replace(given.maximum, errors=best.maximum.errors)
        return log_evidence(self, points, maximum, (WeighedScales(maximum.scales),), given.held)

    def evidence(self, points: Points, maximum: Maximum) -> float:
        """Return the log evidence at the scales of a maximum, from the linearisation there."""
        try:
            return log_evidence(self, points, maximum, (WeighedScales(maximum.scales),))
        except UNSOLVABLE:
            return -math.inf


def _are_one(maximum: Maximum, other: Maximum) -> bool:
    """Whether two maxima are one: ln G, ln Gn and alpha are all within 0.03."""
    return bool(np.max(np.abs(maximum.state - other.state)[: len(LAW)]) <= 0.03)
