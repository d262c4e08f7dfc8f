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
    elapsed = float(points.times[-1] - points.times[0])
    start = solution.maximum.state.copy()
    start[posterior.model.kernel] = 0.0
    first = solution.best_scales._replace(kernel=_least_kernel(posterior))
    straight = _straight(_held(made(PressModel), start))
    straight.limit = posterior.limit
    law = yield from _solution(straight, points, start, first)
    likeliest = Plateau(
        -math.inf, posterior.model, Component(1.0, solution.mean, solution.covariance)
    )
    if law is None:
        return likeliest
    # Or with the errors of its kernel: on beef no law without them explains a hold.
    bent = _held(made(PressModel), solution.maximum.state)
    bent.limit = posterior.limit
    whole = yield from _solution(bent, points, solution.maximum.state, solution.best_scales)
    wanted = np.flatnonzero((RATES * elapsed > _SLOWEST) & (RATES * BLOCK_TIME < _FASTEST))
    if at_once:
        wanted = wanted[-_AT_ONCE:]
    errors = law.maximum.errors
    # The stress after the time seen is about the same.
    now = float(relaxation_weights(float(start[ORDER]))[:-2] @ np.exp(-RATES * elapsed))
    at, scales = start.copy(), law.best_scales
    at[ORDER] = _PART
    at[LOG_G] += math.log(max(now, 1e-9))
    evidences: dict[int, float] = {}
    rival_solution = solution
    for rate in _coarse_to_fine(wanted.tolist(), evidences):
        rival = _straight(_held(made(_Maxwell), at))
        rival.limit = posterior.limit
        assert isinstance(rival.model, _Maxwell)
        rival.model.rate, rival.model.order_of_law = rate, posterior.model.order(start)
        evidences[rate] = -math.inf
        found = yield from _solution(rival, points, at, scales)
        if found is not None:
            evidences[rate] = evidence_under(rival, points, found, errors, rival.grid)
            yield cost_of(points, rival.grid)
            if evidences[rate] > likeliest.log_odds:
                own = Component(1.0, found.mean, found.covariance)
                likeliest, rival_solution = Plateau(evidences[rate], rival.model, own), found
            at, scales = found.maximum.state, found.best_scales
        if posterior.limit.is_reached:
            break
    best = likeliest.log_odds
    if not math.isfinite(best):
        return None if posterior.limit.is_reached else likeliest
    # A rate that was not tried has none: it can only be more.
    gain = best + math.log(sum(math.exp(e - best) for e in evidences.values()) / wanted.size)
    of_law = law.log_evidence
    if whole is not None:
        of_law = max(of_law, evidence_under(bent, points, whole, errors, bent.grid))
    gain -= of_law
    if gain < 0.0 and posterior.limit.is_reached:
        return None
    # Noise that is larger or slower than stated, as hum is, makes all evidence too sharp.
    misfit = min(float(np.mean(one.residuals**2)) for one in (solution, rival_solution))
    return likeliest._replace(log_odds=gain / max(misfit, 1.0))


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
