# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Other laws than this one, as rivals in the mixture: whether the law describes the tissue.

A rival has no G, Gn or alpha: it counts in the probability of a mismatch,

.. math:: 1 - p(\text{law} \mid y) = \frac{\sum_k e^{o_k}}{1 + \sum_k e^{o_k}}

with o the logarithm of its evidence over the law's, and in what is predicted. Before the data
each is as likely as the law. All are held to the same rig, errors and limit of work.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.estimate import OtherLaw, OtherLawKind
from fden_ros.core.estimation.mixture import Component
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.proposals import functions
from fden_ros.core.estimation.scales import Scales
from fden_ros.core.estimation.solution import Solution, cost_of, evidence_under
from fden_ros.core.estimation.unknowns import LAW, LOG_G, ORDER, Lifetime, order_of

#: Prior of what takes alpha's place in a rival, and of the law's alpha: mean and standard
#: deviation [1]. That of ln G is as wide as this for both, about what the record says [1]: what is
#: stated of a tissue must not decide between two laws.
PART, _PART_SD, _LOG_G_SD = 0.5, 0.3, 1.0
#: Standard deviation with which the rig is held [1].
_HELD_SD = 1e-3


class Rival(NamedTuple):
    """Another law, against the law."""

    name: str
    log_odds: float  #: logarithm of its evidence over the law's [1]
    model: PressModel
    component: Component  #: its posterior
    deepest: float  #: largest compression of its record [1]
    published: OtherLaw | None = None  #: as listeners predict by it; None: they cannot


class Rivals(NamedTuple):
    """Other laws; none: the law alone has a solution."""

    all: tuple[Rival, ...] = ()

    @property
    def probability(self) -> float:
        """That the tissue has one of these laws, and not the law [1]."""
        others = float(np.logaddexp.reduce([one.log_odds for one in self.all], initial=-math.inf))
        return float(expit(others))

    @property
    def likeliest(self) -> Rival | None:
        """The likeliest; None: there is none."""
        return max(self.all, key=lambda one: one.log_odds, default=None)


@dataclass(frozen=True)
class Question:
    """Whether another law describes a record: what the answer is made of."""

    points: Points
    solution: Solution  #: of the record
    posterior: Posterior  #: of which that is a solution
    made: Callable[[type[PressModel]], Posterior]  #: the posterior with a model of another class
    at_once: bool  #: only whether the relaxation is over at once: a ramp hardly shows another

    @property
    def is_over(self) -> bool:
        """Whether the answer has cost as much as it may."""
        return self.posterior.limit.is_reached

    @property
    def elapsed(self) -> float:
        """Time of the record [s]."""
        return float(self.points.times[-1] - self.points.times[0])

    @property
    def start(self) -> Array:
        """The solution's state without the errors of the kernel, a copy."""
        state = self.solution.maximum.state.copy()
        state[self.posterior.model.kernel] = 0.0
        return state

    def held(self, kind: type[PressModel], state: Array) -> Posterior:
        """Return the posterior with a model of a class, on the rig of a state.

        With a rig of its own a rival could stand for any relaxation: by a delay of 38 of the
        stated standard deviations it explained one of the law itself.
        """
        posterior = self.made(kind)
        posterior.limit = self.posterior.limit
        set_prior(posterior, LOG_G, float(state[LOG_G]), _LOG_G_SD)
        set_prior(posterior, ORDER, PART, _PART_SD)
        for k, unknown in enumerate(posterior.model.unknowns):
            if unknown.lifetime is Lifetime.RIG:
                set_prior(posterior, k, float(state[k]), _HELD_SD)
        return posterior

    def straight(self, kind: type[PressModel], state: Array) -> Posterior:
        """Return the same, whose kernel has no error of its own."""
        posterior = self.held(kind, state)
        least = min(weighed.scales.kernel for weighed in posterior.grid)
        posterior.grid = [w for w in posterior.grid if w.scales.kernel == least]
        return posterior

    def solved(self, posterior: Posterior, start: Array, scales: Scales) -> Parts[Solution | None]:
        """Return the solution about the maximum near a start; None: there is none."""
        try:
            found = yield from posterior.solutions_in_parts(self.points, [start], scales)
            return found[0]
        except UNSOLVABLE:
            return None


@dataclass(frozen=True)
class Law:
    """The law, on the rig that is held: what rivals are held against."""

    question: Question
    straight: Solution  #: without errors of its kernel
    log_evidence: float  #: the larger of with and without

    def log_evidence_of(self, posterior: Posterior, solution: Solution) -> Parts[float]:
        """Return the log evidence of a rival's solution, under the errors of the law."""
        points, errors = self.question.points, self.straight.maximum.errors
        found = evidence_under(posterior, points, solution, errors, posterior.grid)
        yield cost_of(points, posterior.grid)
        return found

    def against(
        self, name: str, log_evidence: float, model: PressModel, solution: Solution
    ) -> Rival:
        """Return a rival of an evidence, with the likeliest of its models and its solution."""
        # Noise that is larger or slower than stated, as hum is, makes all evidence too sharp.
        both = self.question.solution, solution
        misfit = min(float(np.mean(one.residuals**2)) for one in both)
        gain = (log_evidence - self.log_evidence) / max(misfit, 1.0)
        component = Component(1.0, solution.mean, solution.covariance)
        deepest = float(self.question.points.compressions.max())
        return Rival(name, gain, model, component, deepest)


def rivals_of(question: Question) -> Parts[Rivals | None]:
    """Return all rivals of the law; None: the answer costs too much."""
    law = yield from _law(question)
    if law is None:
        return Rivals()
    found: list[Rival] = []
    for rival in functions("rival"):
        one: Rival | None = yield from rival(question, law)
        if one is not None:
            found.append(one)
    rivals = Rivals(tuple(found))
    # What has not been asked can only make another law likelier.
    is_open = question.is_over and all(one.log_odds < 0.0 for one in found)
    return None if is_open else rivals


def published(kind: OtherLawKind, component: Component, by_odds: float = 1.0) -> OtherLaw:
    """Return a rival as messages state it, without a rate: by the squared odds of its `order`.

    Parameters
    ----------
    kind : OtherLawKind
    component : Component
        Of the whole state.
    by_odds : float
        The third parameter that is published, by the squared odds.
    """
    mean, covariance = np.zeros(len(LAW) + 1), np.zeros((len(LAW) + 1, len(LAW) + 1))
    part = order_of(component.mean)
    factors = np.ones(len(LAW))
    factors[ORDER] = 2.0 * by_odds * part / (1.0 - part) ** 3
    mean[:-1] = component.mean[: len(LAW)]
    mean[ORDER] = by_odds * (part / (1.0 - part)) ** 2
    own = component.covariance[: len(LAW), : len(LAW)]
    covariance[:-1, :-1] = own * np.outer(factors, factors)
    return OtherLaw(kind, mean, covariance)


def set_prior(posterior: Posterior, place: int, mean: float, sd: float) -> None:
    """Let an unknown have a prior of its own."""
    belief = posterior.belief
    belief.precision[place], belief.precision[:, place] = 0.0, 0.0
    belief.precision[place, place], belief.mean[place] = sd**-2, mean


def _law(question: Question) -> Parts[Law | None]:
    """Return what the law is worth; None: it has no solution."""
    points, solution = question.points, question.solution
    straight = question.straight(PressModel, question.start)
    least = straight.grid[0].scales.kernel
    scales = solution.best_scales._replace(kernel=least)
    law = yield from question.solved(straight, question.start, scales)
    if law is None:
        return None
    # Or with the errors of its kernel: on beef no law without them explains a hold.
    state = solution.maximum.state
    bent = question.held(PressModel, state)
    whole = yield from question.solved(bent, state, solution.best_scales)
    evidence = law.log_evidence
    if whole is not None:
        errors = law.maximum.errors
        evidence = max(evidence, evidence_under(bent, points, whole, errors, bent.grid))
    return Law(question, law, evidence)
