# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One solution of a press: from where its maxima are sought, and what is found."""

from __future__ import annotations

import enum
import functools
import math
from dataclasses import dataclass, replace

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.density import EVALUATION_COST
from fden_ros.core.estimation.estimate import LawError
from fden_ros.core.estimation.law_error import law_error
from fden_ros.core.estimation.maxima import (
    Solutions,
    completed,
    find_maxima,
    follow_maxima,
)
from fden_ros.core.estimation.parts import Limit, Parts
from fden_ros.core.estimation.plateau import Question, log_odds
from fden_ros.core.estimation.posterior import Posterior
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.press_setting import PressSetting
from fden_ros.core.estimation.solution import Solution
from fden_ros.core.estimation.unknowns import LOG_G, LOG_GN, Lifetime
from fden_ros.core.estimation.whiteness import contradicts

#: Evaluations of a record that a solution may cost [1]: one that converges takes up to 120.
_MOST_EVALUATIONS = 200
#: And the comparison with a plateau [1].
_MOST_OF_PLATEAU = 400


@dataclass(frozen=True)
class Solved:
    """A posterior with its solution."""

    posterior: Posterior
    solutions: Solutions
    law_error: LawError | None  #: how far the press is from the law; None: it cannot tell
    is_contradicted: bool  #: by its whitened residuals
    #: Logarithm of the odds of a plateau against the law [1]; None: they were not compared.
    plateau_odds: float | None = None

    @property
    def model(self) -> PressModel:
        """The model of the press."""
        return self.posterior.model

    @property
    def rig_misfit(self) -> float:
        """How far the press says the rig is from what is stated, in standard deviations [1]."""
        belief, best, off = self.posterior.belief, self.solutions.best, 0.0
        before = belief.variances()
        for k, unknown in enumerate(self.model.unknowns):
            if unknown.lifetime is Lifetime.RIG:
                # It tells at least this part of the variance.
                told = max(before[k] - best.covariance[k, k], 0.01 * before[k])
                off = max(off, abs(best.mean[k] - belief.mean[k]) / math.sqrt(told))
        return off

    @property
    def log_evidence(self) -> float:
        """Log evidence of the record, for what was known before it."""
        return self.solutions.total + self.posterior.log_prior_density

    @property
    def best(self) -> Solution:
        """The solution about the best maximum."""
        return self.solutions.best

    def grown(self, solution: Solution, posterior: Posterior) -> Array:
        """Return the state of a solution for a posterior that may have another last knot."""
        before, now = self.model, posterior.model
        state = solution.maximum.state.copy()
        if before.last_knot != now.last_knot:
            state[now.characteristic] = 0.0
        return state


class Care(enum.IntEnum):
    """How carefully a solution is sought; each includes those before."""

    TRACKED = enum.auto()  #: from the last maxima
    FROM_STARTS = enum.auto()  #: and from all starts
    ASKED_AT_ONCE = enum.auto()  #: and where the law is bent, whether the tissue relaxes at once
    ASKED = enum.auto()  #: and it is asked whether another law is likelier


@dataclass(frozen=True)
class Search:
    """What a solution is a function of."""

    setting: PressSetting
    compression_sd: float  #: of a sample [1]
    points: Points  #: the record
    before: Solved | None  #: the solution of a shorter record
    elapsed: float  #: from the touch to the end of the record [s]
    deepest: float  #: largest compression of the site [1]
    care: Care

    @functools.cached_property
    def posterior(self) -> Posterior:
        """The posterior, given the record."""
        return self.made(PressModel)

    def made(self, kind: type[PressModel]) -> Posterior:
        """Return the posterior with a model of some class."""
        return self.setting.posterior(self.compression_sd, self.deepest, kind)

    def in_parts(self) -> Parts[Solved]:
        """Return the solution in parts; beyond a cost no maximum is sought on.

        Raises
        ------
        FloatingPointError, OverflowError, numpy.linalg.LinAlgError
            If there is none.
        """
        limit = self.posterior.limit = self._limit(_MOST_EVALUATIONS)
        found = yield from limit.counted(self._solutions())
        limit = self.posterior.limit = self._limit(_MOST_OF_PLATEAU)
        odds = yield from limit.counted(self._plateau_odds(found.best))
        return Solved(
            self.posterior,
            found,
            self._law_error(found.best),
            contradicts(found.best.residuals),
            odds,
        )

    def _limit(self, evaluations: float) -> Limit:
        """Return that of so many evaluations of the record."""
        return Limit(evaluations * (EVALUATION_COST + self.points.times.size))

    def _solutions(self) -> Parts[Solutions]:
        maxima, strain = yield from self._maxima()
        if self.before is not None:
            held = self.before.solutions.held
            earlier = tuple(self.before.grown(one, self.posterior) for one in held)
            maxima = replace(maxima, earlier=earlier)
        return (yield from completed(self.posterior, self.points, maxima, strain))

    def _law_error(self, best: Solution) -> LawError | None:
        strain = self._strain(self.setting.origin(best.mean))
        if not self.setting.is_bent or strain <= 0.0 or self.elapsed <= 0.0:
            return None
        return law_error(best, self.posterior.model, (self.elapsed, strain))

    def _plateau_odds(self, best: Solution) -> Parts[float | None]:
        """Return the log odds of a plateau against the law; None: they are not asked for."""
        at_once = self.care is Care.ASKED_AT_ONCE
        if not (at_once or self.care is Care.ASKED) or not self.setting.can_tell_mismatch:
            return None
        if at_once and best.best_scales.kernel < self.setting.config.uncertainty.characteristic_sd:
            return None  # the law needs no other relaxation
        question = Question(self.points, best, self.posterior, self.made, at_once)
        return (yield from log_odds(question))

    def _strain(self, origin: float) -> float:
        return self.setting.largest_strain(self.deepest, origin)

    def _maxima(self) -> Parts[tuple[Solutions, float]]:
        """Return the maxima, and the largest strain of the record [1]."""
        posterior, points, before = self.posterior, self.points, self.before
        tracked: list[tuple[Array, Solution]] = []
        strain = self._strain(0.0)
        if before is not None:
            strain = self._strain(self.setting.origin(before.best.mean))
            tracked = [(before.grown(s, posterior), s) for s in before.solutions.maxima]
        if tracked and self.care < Care.FROM_STARTS:
            return (yield from follow_maxima(posterior, points, tracked, strain)), strain
        first, starts = posterior.moderate_scales, self._starts()
        found = yield from find_maxima(posterior, points, starts, first, tracked, strain)
        return found, strain

    def _starts(self) -> list[Array]:
        posterior, points = self.posterior, self.points
        if self.setting.carried is not None:
            return [posterior.belief.mean.copy()]
        found = []
        sd = posterior.model.unknowns[LOG_GN].sd
        # About the prior's mean in its standard deviations.
        for place in (-0.8, 0.8) if sd > 0.0 else (0.0,):
            start = posterior.belief.mean.copy()
            start[LOG_GN] += place * sd
            highest = float(posterior.model.response(points, start).stress.max())
            if highest > 0.0:
                start[LOG_G] += math.log(max(points.stresses.max(), 1e-9) / highest)
            found.append(start)
        return found
