# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A hypothesis about one press: what it assumes, its solutions, and their filters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.error_model import Errors
from fden_ros.core.estimation.filter import PressFilter, Update
from fden_ros.core.estimation.mixture import Component, merged, weights_of
from fden_ros.core.estimation.press_setting import PressSetting
from fden_ros.core.estimation.search import Care, Search, Solved
from fden_ros.core.estimation.unknowns import LAW_PLACES, LOG_G, LOG_GN, ORIGIN
from fden_ros.core.law import StressMoments, elastic_response

#: A hypothesis that is less likely than this does not decide what is claimed [1].
LEAST_WEIGHT = 0.01
#: Probability of another law beyond which it is said [1].
MISMATCH = 0.95


@dataclass
class Past:
    """One past that the tissue under the probe may have had."""

    setting: PressSetting  #: what is known before a press, without what is its own
    shift: float = 0.0  #: by which its compressions are larger than those that are given [1]
    log_odds: float = 0.0  #: logarithm of its probability before the present press [1]
    deepest: float = 0.0  #: largest compression of earlier presses [1]
    sample_count: int = 0
    mismatch_probability: float = math.nan  #: of another law; NaN: not known
    memory: StressMoments = field(default_factory=StressMoments)
    #: Logarithm of the odds that the tissue is another, by mean and covariance of what the press
    #: tells of (ln G, ln Gn, alpha); None: it is the one that was touched before.
    other: Callable[[Array, Array], float] | None = None


class Hypothesis:
    """One explanation of a press.

    Parameters
    ----------
    setting : PressSetting
        What is known before the first sample.

    Attributes
    ----------
    solved : Solved or None
        The newest solution; None: there is none yet.
    misses : int
        Newest solutions that were not found.
    log_weight : float
        Logarithm of its weight, beside those of the same epoch [1].
    tissue_when_solved : tuple of Component
        Those of `tissue_now`, without what filters have learned since the newest solution.
    """

    def __init__(self, past: Past, setting: PressSetting) -> None:
        self.past, self.setting = past, setting
        self.solved: Solved | None = None
        self.plateau_odds: float | None = None  #: as they were asked for last
        self.misses, self.log_weight = 0, -math.inf
        self.tissue_when_solved: tuple[Component, ...] = ()
        self._filters: list[PressFilter] = []
        # Log evidence of each solution, with the likelihood of what came since.
        self._logs: Array = np.empty(0)
        self._logs_when_solved = self._logs

    @property
    def is_solved(self) -> bool:
        """Whether its newest solution was found, and wants no further step."""
        return self.solved is not None and self.solved.best.is_solved and not self.misses

    @property
    def share(self) -> float:
        """Its probability before the press, where its past is true [1]."""
        carried = self.setting.carried
        return carried.weight if carried is not None else 1.0

    def _log_prior(self, solved: Solved) -> float:
        """Return the logarithm of its probability before the record [1]."""
        log_prior = self.past.log_odds + math.log(self.share)
        if self.past.other is None:
            return log_prior
        mean, covariance = solved.solutions.moments
        told = covariance[LAW_PLACES, LAW_PLACES]
        return log_prior + self.past.other(mean[LAW_PLACES], told)

    def deepest(self, compression: float) -> float:
        """Return the largest compression of the site, after one as it is given [1]."""
        return max(self.past.deepest, compression + self.past.shift)

    def points(self, points: Points) -> Points:
        """Return a record in its own compressions."""
        shift = self.past.shift
        if not shift:
            return points
        return replace(points, compressions=points.compressions + shift)

    def search(
        self, points: Points, elapsed: float, compression: float, compression_sd: float, care: Care
    ) -> Search:
        """Return the search for its solution, given a record as it is given."""
        deepest = self.deepest(compression)
        return Search(
            self.setting,
            compression_sd,
            self.points(points),
            self.solved,
            elapsed,
            deepest,
            care,
        )

    # Between two solutions

    def take_over(self, solved: Solved, log_evidence: float) -> None:
        """Go on from a solution.

        `log_evidence`: of all of it, for what was known before the record.
        """
        self.solved, self.misses = solved, 0
        if solved.plateau_odds is not None:
            self.plateau_odds = solved.plateau_odds
        log_evidence += self._log_prior(solved)
        found = solved.solutions
        logs = np.array(found.log_evidence + found.held_log_evidence)
        is_likely = weights_of(logs) > 0.0
        model, errors = solved.model, solved.posterior.error_model
        pairs = zip(found.all, is_likely.tolist(), strict=True)
        self._filters = [PressFilter(s, model, errors) for s, likely in pairs if likely]
        self._set_logs(logs[is_likely] + (log_evidence - found.total))
        self._logs_when_solved = self._logs
        self.tissue_when_solved = tuple(part for part in found.components if part.weight)

    def shift_weight(self, logarithm: float) -> None:
        """Multiply its weight."""
        self._set_logs(self._logs + logarithm)

    def _set_logs(self, logs: Array) -> None:
        self._logs, largest = logs, float(logs.max())
        self.log_weight = largest + math.log(float(np.exp(logs - largest).sum()))

    def step(self, points: Points, under: Errors | None = None) -> Update | None:
        """Let all filters take blocks; return how the likeliest predicted them; None: none can.

        Each weight is multiplied by the likelihood, under the same errors; None: its likeliest's.
        """
        if not self._filters:
            return None
        likeliest, found = int(np.argmax(self._logs)), None
        own, logs = self.points(points), self._logs.copy()
        for k in np.argsort(-logs, kind="stable").tolist():
            one = self._filters[k]
            try:
                update = one.step(own, under)
            except (FloatingPointError, OverflowError):
                logs[k] = -math.inf
                continue
            under = under or update.errors
            # Where it is not linear its likelihood is none.
            logs[k] += update.log_likelihood if one.is_near else -math.inf
            if k == likeliest:
                found = update
        if np.isfinite(logs).any():
            self._set_logs(logs)
        return found

    def elastic_response(self, compression: float) -> float | None:
        """Return the elastic response at a given compression [Pa]; None: it is no number."""
        if self.filter is None:
            return None
        mean, geometry = self.filter.mean, self.setting.geometry
        strain = geometry.strain(compression + self.past.shift - self.setting.origin(mean))
        try:
            found = elastic_response(strain, math.exp(mean[LOG_G]), math.exp(mean[LOG_GN]))
        except (FloatingPointError, OverflowError):
            return None
        return float(found.value)

    @property
    def has_turned(self) -> bool:
        """Whether its likeliest solution was hardly likely when it was solved.

        The likelihoods of a few blocks that none explains are no evidence.
        """
        if self._logs.size < 2:
            return False
        before = self._logs_when_solved
        likeliest = before[int(np.argmax(self._logs))]
        return bool(likeliest < before.max() + math.log(LEAST_WEIGHT))

    @property
    def filter(self) -> PressFilter | None:
        """The likeliest filter; None: there is no solution yet."""
        return self._filters[int(np.argmax(self._logs))] if self._filters else None

    @property
    def components(self) -> tuple[Component, ...]:
        """The Gaussians of its state by now, of weights that add up to 1."""
        return tuple(part for _, parts in self._parts() for part in parts)

    def _parts(self) -> list[tuple[PressFilter, list[Component]]]:
        """Return those of each filter."""
        if self.solved is None:
            return []
        considered = self.solved.best.considered
        found = []
        for weight, one in zip(weights_of(self._logs).tolist(), self._filters, strict=True):
            if not weight:
                continue
            covariance = one.covariance if considered is None else one.covariance + considered
            found.append((one, [Component(weight, one.mean, covariance)]))
        return found

    @property
    def tissue_now(self) -> tuple[Component, ...]:
        """The components with ln G of the tissue that is under the probe now."""
        return self.components

    @property
    def modes_now(self) -> tuple[Component, ...]:
        """Those of the tissue, where a ridge and its maximum are one Gaussian.

        There is tissue between them, too, which each by itself would rule out: at the second of
        three presses with an arm's errors ln G was 2.4 deviations off.
        """
        return tuple(_with_ridges_merged(self._parts()))


def _with_ridges_merged(found: Sequence[tuple[PressFilter, list[Component]]]) -> list[Component]:
    """Return components, those of held origins in one Gaussian with the likeliest others."""
    ridge = [part for one, parts in found if one.held == ORIGIN for part in parts]
    others = [parts for one, parts in found if one.held != ORIGIN]
    if ridge:
        others.sort(key=lambda parts: sum(part.weight for part in parts))
        others.append([merged([*ridge, *(others.pop() if others else ())])])
    return [part for parts in others for part in parts]
