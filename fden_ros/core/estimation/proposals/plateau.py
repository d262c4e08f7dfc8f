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
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import BLOCK_TIME, Points
from fden_ros.core.estimation.estimate import OtherLaw, OtherLawKind
from fden_ros.core.estimation.maxima import NEAR_BOUNDARY, boundary_of
from fden_ros.core.estimation.mixture import Component
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.rivals import PART, Law, Question, Rival, published
from fden_ros.core.estimation.solution import Solution
from fden_ros.core.estimation.unknowns import LOG_G, LOG_GN, ORDER
from fden_ros.core.law import RATES, SPACING, left_after, relaxation_weights

#: Place of the logarithm of the rate in what is published, and its standard deviation where it is
#: not found between two others, in steps of the rates [1]: it is within half a step.
_LOG_RATE, _UNKNOWN_RATE = 3, 0.3
#: Least r that has a logarithm [1].
_LEAST = 1e-6


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


class _Tried(NamedTuple):
    """The solution of one rate."""

    rate: int  #: its place
    log_evidence: float
    model: PressModel
    solution: Solution

    @property
    def published(self) -> OtherLaw:
        """Itself as messages state it, but for its rate."""
        component = Component(1.0, self.solution.mean, self.solution.covariance)
        return published(OtherLawKind.PLATEAU, component)


def rival(question: Question, law: Law) -> Parts[Rival | None]:
    """Return it against the law; None: it has no solution."""
    rates = _rates(question)
    found = yield from _weighed(question, law, rates)
    if not found:
        return None
    best = max(found, key=lambda one: one.log_evidence)
    # A rate that was not tried has none: it can only be more.
    total = float(logsumexp([one.log_evidence for one in found])) - math.log(len(rates))
    own = law.against("plateau", total, best.model, best.solution)
    component = _component(question.points, best.model, best.solution)
    own = own._replace(component=component)
    if question.at_once:
        # A ramp does not show what is to come.
        return own
    return own._replace(published=_between(found, best, component))


def _between(found: list[_Tried], best: _Tried, component: Component) -> OtherLaw:
    """Return that of the rate at which a parabola through three log evidences is highest.

    `component`: that of the best.
    """
    covariance = component.covariance.copy()
    # Deeper than the record it may bend.
    covariance[LOG_GN, LOG_GN] = best.solution.covariance[LOG_GN, LOG_GN]
    own = published(OtherLawKind.PLATEAU, component._replace(covariance=covariance))
    own.mean[_LOG_RATE] = math.log(RATES[best.rate])
    beside = {one.rate - best.rate: one for one in found if abs(one.rate - best.rate) == 1}
    shift, sd, side = 0.0, _UNKNOWN_RATE, 1
    along = np.zeros_like(own.mean)
    if beside:
        side = max(beside, key=lambda place: beside[place].log_evidence)
        # From rate to rate G and r are nearly powers of it.
        ends = (one.published.mean for one in (best, beside[side]))
        before, after = (np.append(mean[:LOG_GN], np.log(mean[ORDER] + _LEAST)) for mean in ends)
        along[[LOG_G, ORDER]] = after - before
        along[ORDER] *= own.mean[ORDER]
    if len(beside) == 2:
        below, above = (best.log_evidence - beside[place].log_evidence for place in (-1, 1))
        misfit = max(float(np.mean(best.solution.residuals**2)), 1.0)
        shift = abs(0.5 * (below - above) / (below + above))
        sd = min(math.sqrt(misfit / (below + above)), _UNKNOWN_RATE)
    along[_LOG_RATE] = side * SPACING
    return own._replace(
        mean=own.mean + shift * along, covariance=own.covariance + sd**2 * np.outer(along, along)
    )


def _component(points: Points, model: PressModel, solution: Solution) -> Component:
    """Return its posterior, without Gn where it is linear over the record.

    The record says nothing of Gn there, and its prior's mean bends within the record: N/m of a
    spring was 1.5 times too large.
    """
    mean, covariance = solution.mean.copy(), solution.covariance.copy()
    state = solution.maximum.state
    deepest = float(model.motion.compressions(points, state).max())
    boundary = boundary_of(model.geometry.strain(max(deepest, 0.0)))
    if state[LOG_GN] < boundary + NEAR_BOUNDARY:
        mean[LOG_GN] = min(state[LOG_GN], boundary)
        covariance[LOG_GN] = covariance[:, LOG_GN] = 0.0
    return Component(1.0, mean, covariance)


def _rates(question: Question) -> list[int]:
    """Return the places of the rates that a record may show."""
    elapsed = question.elapsed
    # From that of a relaxation that has just begun to that of one that is over within a block, as
    # a dashpot's is.
    wanted = np.flatnonzero((RATES * elapsed > 0.3) & (RATES * BLOCK_TIME < 10.0))
    return (wanted[-3:] if question.at_once else wanted).tolist()


def _weighed(question: Question, law: Law, rates: list[int]) -> Parts[list[_Tried]]:
    """Return the rates that have a solution."""
    at, scales = question.start, law.straight.best_scales
    order = float(at[ORDER])
    # The stress after the time seen is about the same.
    now = float(relaxation_weights(order)[:-2] @ np.exp(-RATES * question.elapsed))
    order_of_law = question.posterior.model.order(at)
    at[ORDER] = PART
    at[LOG_G] += math.log(max(now, 1e-9))
    found: list[_Tried] = []
    evidences: dict[int, float] = {}
    for rate in _coarse_to_fine(rates, evidences):
        posterior = question.straight(_Maxwell, at)
        assert isinstance(posterior.model, _Maxwell)
        posterior.model.rate, posterior.model.order_of_law = rate, order_of_law
        evidences[rate] = -math.inf
        solved = yield from question.solved(posterior, at, scales)
        if solved is not None:
            evidences[rate] = yield from law.log_evidence_of(posterior, solved)
            found.append(_Tried(rate, evidences[rate], posterior.model, solved))
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
