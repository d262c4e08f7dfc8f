# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""A relaxation that ends, at a plateau: whether predictions of a hold will hold.

The rival of the power law is a spring beside one Maxwell element,

.. math::
    E(t) = 1 + \left(\frac{o}{1 - o}\right)^2 e^{-t/\tau} ,

with the same characteristic and walk: for a short tau a spring and a dashpot. Their evidence
decides; 1/tau is a rate of the kernel, averaged over those that the record can show.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.maximum import NEARLY_FOUND
from fden_ros.core.estimation.mixture import Component
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.record import BLOCK_TIME, Points
from fden_ros.core.estimation.scales import Scales
from fden_ros.core.estimation.solution import Solution, cost_of, evidence_under
from fden_ros.core.estimation.unknowns import LOG_G, ORDER, Lifetime
from fden_ros.core.law import RATES, left_after, relaxation_weights

#: Rates of the rival: times the time since the touch of one that has just begun, and times that of
#: a block of one that is over at once, as a dashpot's is [1].
_SLOWEST, _FASTEST = 0.3, 10.0
#: Prior of o, which says how much relaxes, and of the law's order: mean and standard deviation
#: [1]. That of ln G is as wide as this for both, about what the record says [1]: what is stated of
#: a tissue must not decide between two laws.
_PART, _PART_SD, _LOG_G_SD = 0.5, 0.3, 1.0
#: The fastest rates that are tried of a relaxation that is over at once [1].
_AT_ONCE = 3
#: Precision with which the rig is held [1].
_HELD = 1e6


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

    def relaxation_after(self, orders: Array, time: float) -> tuple[Array, Array]:
        """Return what is left of the weights after a time [s], and its derivatives by o."""
        both = np.array([self.relaxation(order) for order in orders])
        weights, slopes = np.moveaxis(both[..., :-1] * left_after(time)[:-1], 1, 0)
        return weights, slopes


class Plateau(NamedTuple):
    """A relaxation that ends, against the law."""

    log_odds: float  #: logarithm of its evidence over the law's [1]
    model: PressModel  #: of the likeliest rate
    component: Component  #: its posterior

    @property
    def probability(self) -> float:
        """Where both are as likely before the data [1]."""
        return 1.0 / (1.0 + math.exp(min(-self.log_odds, 700.0)))


def plateau_of(
    points: Points,
    solution: Solution,
    posterior: Posterior,
    made: Callable[[type[PressModel]], Posterior],
    *,
    at_once: bool = False,
) -> Parts[Plateau | None]:
    """Return the rival against the power law; None: it cost too much.

    Parameters
    ----------
    points : Points
    solution : Solution
        Of the record.
    posterior : Posterior
        Of which that is a solution.
    made : callable
        Returns the posterior with a model of another class.
    at_once : bool
        Only whether the relaxation is over at once: a ramp hardly shows another.
    """
    law = yield from _of_law(points, solution, posterior, made)
    if law is None:
        return _no_plateau(solution, posterior)
    rates = _rates(points, at_once=at_once)
    rivals = yield from _rivals(points, solution, posterior, made, law.straight, rates)
    if not rivals:
        return None if posterior.limit.is_reached else _no_plateau(solution, posterior)
    best = max(rivals, key=lambda one: one.log_evidence)
    # A rate that was not tried has none: it can only be more.
    total = sum(math.exp(one.log_evidence - best.log_evidence) for one in rivals)
    gain = best.log_evidence + math.log(total / len(rates)) - law.log_evidence
    if gain < 0.0 and posterior.limit.is_reached:
        return None
    # Noise that is larger or slower than stated, as hum is, makes all evidence too sharp.
    misfit = min(float(np.mean(one.residuals**2)) for one in (solution, best.solution))
    component = Component(1.0, best.solution.mean, best.solution.covariance)
    return Plateau(gain / max(misfit, 1.0), best.model, component)


def _no_plateau(solution: Solution, posterior: Posterior) -> Plateau:
    """Return that there is none, with the law's model and posterior."""
    component = Component(1.0, solution.mean, solution.covariance)
    return Plateau(-math.inf, posterior.model, component)


class _Law(NamedTuple):
    """The law, on the rig that is held."""

    straight: Solution  #: without errors of its kernel
    log_evidence: float  #: the larger of with and without


class _Rival(NamedTuple):
    """A plateau, of one rate."""

    log_evidence: float
    model: PressModel
    solution: Solution


def _of_law(
    points: Points,
    solution: Solution,
    posterior: Posterior,
    made: Callable[[type[PressModel]], Posterior],
) -> Parts[_Law | None]:
    """Return what the law is worth; None: it has no solution."""
    start = _without_errors(solution, posterior)
    scales = solution.best_scales._replace(kernel=_least_kernel(posterior))
    straight = _straight(_held(made(PressModel), start))
    straight.limit = posterior.limit
    law = yield from _solution(straight, points, start, scales)
    if law is None:
        return None
    # Or with the errors of its kernel: on beef no law without them explains a hold.
    bent = _held(made(PressModel), solution.maximum.state)
    bent.limit = posterior.limit
    whole = yield from _solution(bent, points, solution.maximum.state, solution.best_scales)
    evidence = law.log_evidence
    if whole is not None:
        errors = law.maximum.errors
        evidence = max(evidence, evidence_under(bent, points, whole, errors, bent.grid))
    return _Law(law, evidence)


def _rates(points: Points, *, at_once: bool) -> list[int]:
    """Return the places of the rates that a record may show."""
    elapsed = float(points.times[-1] - points.times[0])
    wanted = np.flatnonzero((RATES * elapsed > _SLOWEST) & (RATES * BLOCK_TIME < _FASTEST))
    found: list[int] = (wanted[-_AT_ONCE:] if at_once else wanted).tolist()
    return found


def _rivals(
    points: Points,
    solution: Solution,
    posterior: Posterior,
    made: Callable[[type[PressModel]], Posterior],
    law: Solution,
    rates: list[int],
) -> Parts[list[_Rival]]:
    """Return the rivals that have a solution, weighed under the errors of the law."""
    at, scales = _without_errors(solution, posterior), law.best_scales
    order = float(at[ORDER])
    # The stress after the time seen is about the same.
    elapsed = float(points.times[-1] - points.times[0])
    now = float(relaxation_weights(order)[:-2] @ np.exp(-RATES * elapsed))
    order_of_law = posterior.model.order(at)
    at[ORDER] = _PART
    at[LOG_G] += math.log(max(now, 1e-9))
    found: list[_Rival] = []
    evidences: dict[int, float] = {}
    for rate in _coarse_to_fine(rates, evidences):
        rival = _straight(_held(made(_Maxwell), at))
        rival.limit = posterior.limit
        assert isinstance(rival.model, _Maxwell)
        rival.model.rate, rival.model.order_of_law = rate, order_of_law
        evidences[rate] = -math.inf
        solved = yield from _solution(rival, points, at, scales)
        if solved is not None:
            evidences[rate] = evidence_under(rival, points, solved, law.maximum.errors, rival.grid)
            yield cost_of(points, rival.grid)
            if math.isfinite(evidences[rate]):
                found.append(_Rival(evidences[rate], rival.model, solved))
            at, scales = solved.maximum.state, solved.best_scales
        if posterior.limit.is_reached:
            break
    return found


def _without_errors(solution: Solution, posterior: Posterior) -> Array:
    """Return the state of a solution without the errors of the kernel."""
    state = solution.maximum.state.copy()
    state[posterior.model.kernel] = 0.0
    return state


def _coarse_to_fine(rates: list[int], evidences: Mapping[int, float]) -> Iterator[int]:
    """Return every other rate, from the fastest on, and then the neighbours of the likeliest.

    `evidences`: of those that have been returned.
    """
    yield from rates[::-2]
    likeliest = max(evidences, key=lambda rate: evidences[rate], default=0)
    yield from (rate for rate in rates if abs(rate - likeliest) == 1)


def _held(posterior: Posterior, state: Array) -> Posterior:
    """Return a posterior on the rig of a state.

    With a rig of its own a rival could stand for any relaxation: by a delay of 38 of the stated
    standard deviations it explained one of the law itself.
    """
    belief = posterior.belief
    known = {LOG_G: (state[LOG_G], _LOG_G_SD**-2), ORDER: (_PART, _PART_SD**-2)}
    for k, unknown in enumerate(posterior.model.unknowns):
        if unknown.lifetime is Lifetime.RIG:
            known[k] = state[k], _HELD
    for k, (mean, precision) in known.items():
        belief.precision[k], belief.precision[:, k] = 0.0, 0.0
        belief.precision[k, k], belief.mean[k] = precision, mean
    return posterior


def _straight(posterior: Posterior) -> Posterior:
    """Return a posterior whose kernel has no error of its own."""
    least = _least_kernel(posterior)
    posterior.grid = [w for w in posterior.grid if w.scales.kernel == least]
    return posterior


def _least_kernel(posterior: Posterior) -> float:
    return min(weighed.scales.kernel for weighed in posterior.grid)


def _solution(
    posterior: Posterior, points: Points, start: Array, scales: Scales
) -> Parts[Solution | None]:
    """Return the posterior about the maximum near a start; None: there is none."""
    try:
        found = yield from posterior.solutions_in_parts(points, [start], scales, NEARLY_FOUND)
        return found[0]
    except UNSOLVABLE:
        return None
