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

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import BLOCK_TIME, Points
from fden_ros.core.estimation.maxima import NEAR_BOUNDARY, boundary_of
from fden_ros.core.estimation.mixture import Component
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.rivals import PART, Law, Question, Rival
from fden_ros.core.estimation.solution import Solution
from fden_ros.core.estimation.unknowns import LOG_G, LOG_GN, ORDER
from fden_ros.core.law import RATES, left_after, relaxation_weights


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


def rival(question: Question, law: Law) -> Parts[Rival | None]:
    """Return it against the law; None: it has no solution."""
    rates = _rates(question)
    found = yield from _weighed(question, law, rates)
    if not found:
        return None
    best, model, solution = max(found, key=lambda one: one[0])
    # A rate that was not tried has none: it can only be more.
    total = sum(math.exp(evidence - best) for evidence, _, _ in found)
    own = law.against("plateau", best + math.log(total / len(rates)), model, solution)
    return own._replace(component=_component(question.points, model, solution))


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


def _weighed(
    question: Question, law: Law, rates: list[int]
) -> Parts[list[tuple[float, PressModel, Solution]]]:
    """Return log evidence, model and solution of the rates that have one."""
    at, scales = question.start, law.straight.best_scales
    order = float(at[ORDER])
    # The stress after the time seen is about the same.
    now = float(relaxation_weights(order)[:-2] @ np.exp(-RATES * question.elapsed))
    order_of_law = question.posterior.model.order(at)
    at[ORDER] = PART
    at[LOG_G] += math.log(max(now, 1e-9))
    found: list[tuple[float, PressModel, Solution]] = []
    evidences: dict[int, float] = {}
    for rate in _coarse_to_fine(rates, evidences):
        posterior = question.straight(_Maxwell, at)
        assert isinstance(posterior.model, _Maxwell)
        posterior.model.rate, posterior.model.order_of_law = rate, order_of_law
        evidences[rate] = -math.inf
        solved = yield from question.solved(posterior, at, scales)
        if solved is not None:
            evidences[rate] = yield from law.log_evidence_of(posterior, solved)
            found.append((evidences[rate], posterior.model, solved))
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
