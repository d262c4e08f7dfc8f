# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Whether the relaxation reaches a plateau: the test of the law against a standard linear solid.

The power law is compared with a spring beside one Maxwell element,

.. math::
    E(t) = 1 + \left(\frac{o}{1 - o}\right)^2 e^{-t/\tau} ,

with the same characteristic and walk: for a short tau a spring and a dashpot. Their evidence
decides; 1/tau is a rate of the kernel, averaged over those that the record can show. Before the
data each is as likely as the other. Both are held to the same rig, errors and limit of work.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import BLOCK_TIME, Points
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.scales import Scales
from fden_ros.core.estimation.solution import Solution, cost_of, evidence_under
from fden_ros.core.estimation.unknowns import LOG_G, ORDER, Lifetime
from fden_ros.core.law import RATES, relaxation_weights

#: Prior of o, and of the law's alpha: mean and standard deviation [1]. That of ln G is as wide as
#: this for both, about what the record says [1]: what is stated of a tissue must not decide.
_PART, _PART_SD, _LOG_G_SD = 0.5, 0.3, 1.0
#: Standard deviation with which the rig is held [1].
_HELD_SD = 1e-3


class _Maxwell(PressModel):
    """The model of a press on a spring beside a Maxwell element; `order` is o."""

    rate = 0
    order_of_law = 0.3

    def order(self, state: Array) -> float:
        """Return that of the law, so that both are held to the same errors."""
        return self.order_of_law

    def relaxation(self, order: float) -> tuple[Array, Array]:
        """Return the weights and their derivatives by o."""
        weights, slopes = np.zeros(RATES.size + 2), np.zeros(RATES.size + 2)
        odds = order / (1.0 - order)
        weights[self.rate], weights[RATES.size] = odds**2, 1.0
        slopes[self.rate] = 2.0 * odds / (1.0 - order) ** 2
        return weights, slopes


@dataclass(frozen=True)
class Question:
    """Whether a plateau describes a record: what the answer is made of."""

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

        With a rig of its own a plateau could stand for any relaxation: by a delay of 38 of the
        stated standard deviations it explained one of the law itself.
        """
        posterior = self.made(kind)
        posterior.limit = self.posterior.limit
        _set_prior(posterior, LOG_G, float(state[LOG_G]), _LOG_G_SD)
        _set_prior(posterior, ORDER, _PART, _PART_SD)
        for k, unknown in enumerate(posterior.model.unknowns):
            if unknown.lifetime is Lifetime.RIG:
                _set_prior(posterior, k, float(state[k]), _HELD_SD)
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


def log_odds(question: Question) -> Parts[float | None]:
    """Return the logarithm of the plateau's evidence over the law's; None: it costs too much.

    -inf: one of both has no solution.
    """
    law = yield from _law(question)
    if law is None:
        return -math.inf
    straight, by_law = law
    rates = _rates(question)
    found = yield from _weighed(question, straight, rates)
    odds = -math.inf
    if found:
        # A rate that was not tried has no evidence: it can only be more.
        total = float(logsumexp([evidence for evidence, _ in found])) - math.log(len(rates))
        best = max(found, key=lambda pair: pair[0])[1]
        # Noise that is larger or slower than stated, as hum is, makes all evidence too sharp.
        misfit = min(float(np.mean(one.residuals**2)) for one in (question.solution, best))
        odds = (total - by_law) / max(misfit, 1.0)
    # What has not been tried can only make the plateau likelier.
    return None if question.is_over and odds < 0.0 else odds


def _set_prior(posterior: Posterior, place: int, mean: float, sd: float) -> None:
    """Let an unknown have a prior of its own."""
    belief = posterior.belief
    belief.precision[place], belief.precision[:, place] = 0.0, 0.0
    belief.precision[place, place], belief.mean[place] = sd**-2, mean


def _law(question: Question) -> Parts[tuple[Solution, float] | None]:
    """Return the law's solution without errors of its kernel, and its log evidence; None: none."""
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
    return law, evidence


def _rates(question: Question) -> list[int]:
    """Return the places of the rates that a record may show."""
    elapsed = question.elapsed
    # From that of a relaxation that has just begun to that of one that is over within a block, as
    # a dashpot's is.
    wanted = np.flatnonzero((RATES * elapsed > 0.3) & (RATES * BLOCK_TIME < 10.0))
    return (wanted[-3:] if question.at_once else wanted).tolist()


def _weighed(
    question: Question, law: Solution, rates: list[int]
) -> Parts[list[tuple[float, Solution]]]:
    """Return the rates that have a solution: its log evidence under the errors of the law."""
    at, scales = question.start, law.best_scales
    points, errors = question.points, law.maximum.errors
    order = float(at[ORDER])
    # The stress after the time seen is about the same.
    now = float(relaxation_weights(order)[:-2] @ np.exp(-RATES * question.elapsed))
    order_of_law = question.posterior.model.order(at)
    at[ORDER] = _PART
    at[LOG_G] += math.log(max(now, 1e-9))
    found: list[tuple[float, Solution]] = []
    evidences: dict[int, float] = {}
    for rate in _coarse_to_fine(rates, evidences):
        posterior = question.straight(_Maxwell, at)
        assert isinstance(posterior.model, _Maxwell)
        posterior.model.rate, posterior.model.order_of_law = rate, order_of_law
        evidences[rate] = -math.inf
        solved = yield from question.solved(posterior, at, scales)
        if solved is not None:
            evidences[rate] = evidence_under(posterior, points, solved, errors, posterior.grid)
            yield cost_of(points, posterior.grid)
            found.append((evidences[rate], solved))
            at, scales = solved.maximum.state, solved.best_scales
        if question.is_over:
            break
    return found


def _coarse_to_fine(rates: list[int], evidences: Mapping[int, float]) -> Iterator[int]:
    """Return every other rate, from the fastest on, and then the neighbours of the likeliest.

    `evidences`: of those that have been returned.
    """
    yield from rates[::-2]
    likeliest = max(evidences, key=lambda rate: evidences[rate], default=0)
    yield from (rate for rate in rates if abs(rate - likeliest) == 1)
