# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Tissue after Hunt and Crossley: it resists its speed, and remembers nothing.

.. math::
    f = \psi(x)\,(1 + \lambda\,\dot u), \qquad \psi = g\,(x/x_r)^m\,e^{\epsilon(x)}, \quad
    \lambda \ge 0

with x the strain of the geometry, so that m is 1 where the force is the geometry's own power of
the depth, and :math:`x_r` the strain at which the characteristic's error is 0. In a state g, m and
lambda stand at the places of G, Gn and alpha. A ramp of one speed does not show lambda: it is
asked for once the motion has slowed.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.estimate import OtherLawKind
from fden_ros.core.estimation.loops import Evaluation, ResponseState
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.posterior import UNSOLVABLE
from fden_ros.core.estimation.press_model import Curve, PressModel
from fden_ros.core.estimation.rivals import Law, Question, Rival, published, set_prior
from fden_ros.core.estimation.smooth_errors import REFERENCE_STRAIN, splines
from fden_ros.core.estimation.solution import cost_of
from fden_ros.core.estimation.unknowns import LOG_G, LOG_GN, ORDER
from fden_ros.core.law import RATES

#: Least strain that has a logarithm [1].
_LEAST = 1e-9


class _Elastic(NamedTuple):
    """The elastic response at points (n,)."""

    curve: Curve  #: with its error
    by_compression: Array  #: slope [Pa]
    of_knots: Array  #: splines of the error, (n, knots)
    is_met: NDArray[np.bool_]  #: the tissue is


class _HuntCrossley(PressModel):
    """The model of a press; lambda is the odds of `order`, squared, over the fastest speed."""

    fastest = 1.0  #: largest speed of the compression in the record [1/s]
    order_of_law = 0.3

    def order(self, state: Array) -> float:
        """Return that of the law, so that both are held to the same errors."""
        return self.order_of_law

    def curve(self, strains: Array, states: Array) -> Curve:
        """Return the power of the strain."""
        strains = np.maximum(strains, _LEAST)
        power = np.exp(states[..., LOG_GN])
        place = np.log(strains / REFERENCE_STRAIN)
        values = np.exp(states[..., LOG_G] + power * place)
        slopes = power * values / strains
        by_power = power * place
        bends = (power - 1.0) * slopes / strains
        return Curve(values, slopes, bends, values * by_power, slopes * (1.0 + by_power))

    def relaxation_after(self, orders: Array, time: float) -> tuple[Array, Array]:
        """Return that at rest the stress stays."""
        weights = np.zeros((orders.size, RATES.size + 1))
        weights[:, -1] = 1.0
        return weights, np.zeros_like(weights)

    def evaluate(
        self, points: Points, state: Array, going_on: ResponseState | None = None
    ) -> Evaluation:
        """Return the stress of every block with its derivatives."""
        points = self.motion.moved(points, state)
        design, moved = self.motion.design(points), len(self.unknowns)
        at = self._elastic(points, state)
        odds = float(state[ORDER]) / (1.0 - float(state[ORDER]))
        speeds = points.speeds if points.rates is None else points.rates
        rates = at.is_met * speeds / self.fastest
        # Contact pushes and does not pull.
        factor = at.is_met * np.maximum(1.0 + odds**2 * rates, 0.0)
        changes = [(k, u.since) for k, u in enumerate(self.unknowns) if u.since is not None]
        left = 1.0 + sum(float(state[k]) * (points.times > since) for k, since in changes)
        resisting = factor * left
        by_state = np.zeros((state.size, points.times.size))
        by_state[:moved] = at.by_compression * resisting * design.motions
        by_state[LOG_G] += at.curve.values * resisting
        by_state[LOG_GN] += at.curve.values_by_log_gn * resisting
        by_odds = 2.0 * odds / (1.0 - float(state[ORDER])) ** 2
        by_state[ORDER] += at.curve.values * by_odds * rates * (factor > 0.0) * left
        for k, since in changes:
            by_state[k] += at.curve.values * factor * (points.times > since)
        by_state[self.characteristic] = at.curve.values * resisting * at.of_knots.T
        jacobian = np.ascontiguousarray(points.mean(by_state).T)
        jacobian[:, :moved] += design.stresses.T
        stress = points.mean(at.curve.values * resisting) + self.motion.added_stress(points, state)
        if not np.isfinite(stress).all():
            raise FloatingPointError("the stress is not finite")
        elastic, slope = at.is_met * at.curve.values, at.is_met * at.by_compression
        return Evaluation(stress, jacobian, elastic, slope, ResponseState(0))

    def response(self, points: Points, state: Array) -> Evaluation:
        """Return the same."""
        return self.evaluate(points, state)

    def _elastic(self, points: Points, state: Array) -> _Elastic:
        """Return the elastic response at the points of a moved record."""
        compressions = self.motion.compressions(points, state)
        # The tool yields under the stress that was measured: the rig is held.
        yields = float(self.bending @ state)
        if yields:
            compressions = compressions + yields * np.interp(
                points.times, points.middles, points.stresses
            )
        strains, per_compression, _ = self.geometry.strains(np.maximum(compressions, 0.0))
        knots = self.characteristic.stop - self.characteristic.start
        of_knots, tilts = splines(strains, self.last_knot, knots)
        errors = state[self.characteristic]
        bend = np.exp(of_knots @ errors)
        curve = Curve(*(part * bend for part in self.curve(strains, state)))
        slope = (curve.slopes + curve.values * (tilts @ errors)) * per_compression
        return _Elastic(curve, slope, of_knots, strains > 0.0)


def rival(question: Question, law: Law) -> Parts[Rival | None]:
    """Return it against the law; None: it has no solution, or is hopeless."""
    points, model = question.points, question.posterior.model
    fastest = float(points.speeds.max())
    start = None if question.at_once or not fastest > 0.0 else _start(question)
    if start is None:
        return None
    posterior = question.straight(_HuntCrossley, start)
    own = posterior.model
    assert isinstance(own, _HuntCrossley)
    own.fastest, own.order_of_law = fastest, model.order(question.start)
    # Of ln m: a half more or less than the geometry's power.
    set_prior(posterior, LOG_GN, 0.0, 0.5)
    scales, errors = law.straight.best_scales, law.straight.maximum.errors
    try:
        begun = yield from posterior.maximum(points, start, scales, most=4)
        evidence = posterior.evidence(points, replace(begun, errors=errors))
    except UNSOLVABLE:
        return None
    yield cost_of(points, ())
    # After these steps lower by 40 than that of the law without errors of its kernel: tissue that
    # goes on to relax.
    if evidence < law.straight.log_evidence - 40.0:
        return None
    found = yield from question.solved(posterior, begun.state, scales)
    if found is None:
        return None
    evidence = yield from law.log_evidence_of(posterior, found)
    own_rival = law.against("Hunt-Crossley", evidence, own, found)
    kind = OtherLawKind.HUNT_CROSSLEY
    stated = published(kind, own_rival.component, 1.0 / fastest)
    return own_rival._replace(published=stated)


def _start(question: Question) -> Array | None:
    """Return a state whose power is that of stress over strain in the record; None: none tells."""
    points, model, state = question.points, question.posterior.model, question.start
    compressions, _ = model.motion.ends(points, state)
    strains = model.geometry.strains(np.maximum(compressions, 0.0)).values
    # The power is sought from that of strains above a fifth of the largest.
    tells = (strains > 0.2 * strains.max()) & (points.stresses > 0.0)
    if not tells.any():
        return None
    place = np.log(strains[tells] / REFERENCE_STRAIN)
    off = place - place.mean()
    stresses = np.log(points.stresses[tells])
    power = float(off @ stresses / max(off @ off, _LEAST))
    state[LOG_GN] = math.log(min(max(power, 0.5), 4.0))
    state[LOG_G] = float(stresses.mean() - math.exp(state[LOG_GN]) * place.mean())
    state[ORDER], state[model.characteristic] = 0.3, 0.0
    return state
