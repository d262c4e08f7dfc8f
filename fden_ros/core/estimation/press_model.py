# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The stress of a press as a function of its unknowns, with all derivatives.

It is that of the elastic response in excess of the tissue's free surface, which earlier presses
have left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.loops import By, Columns, Evaluation, LawState, ResponseState, Steps
from fden_ros.core.estimation.smooth_errors import (
    CHARACTERISTIC_KNOTS,
    KERNEL_HATS,
    KERNEL_KNOTS,
    splines,
)
from fden_ros.core.estimation.unknowns import LOG_G, LOG_GN, ORDER, PressMotion, Unknown, order_of
from fden_ros.core.law import (
    MAX_EXPONENT,
    RATES,
    Geometry,
    StressMoments,
    creep_slopes,
    creep_weights,
    elastic_responses,
    phi,
    relaxation_after,
    relaxation_slopes,
    relaxation_weights,
)


@dataclass(frozen=True)
class FreeSurface:
    """What earlier presses have left of the tissue: the creep of their stress."""

    moments: StressMoments  #: at `time`
    time: float  #: [s], of the clock of the records

    def at(self, times: Array) -> Array:
        """Return the exponential moments at times, shape (n, RATES)."""
        return self.moments.after(np.maximum(times - self.time, 0.0))


@dataclass(eq=False)
class TissueSurface:
    """The free surface of one press, with all derivatives."""

    unknowns: tuple[Unknown, ...]  #: the first of a state
    motion: PressMotion  #: of these
    geometry: Geometry
    #: Places of the law's errors in a state, which ends with the latter.
    kernel: slice
    characteristic: slice
    last_knot: float  #: strain of the characteristic's last knot [1]
    free: FreeSurface | None  #: None: the tissue is at rest before the press
    _moments: tuple[Points, Array] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return it without what the last record has decided: that is found anew."""
        return self.__dict__ | {"_moments": None}

    def touch_gradient(self, points: Points, state: Array) -> Array:
        """Return how each unknown moves the touch, as a unit vector (n,)."""
        if self.free is None:
            result, motions = (
                np.zeros(self.characteristic.stop),
                self.motion.design(points).motions,
            )
            first = int(np.argmax(self.motion.compressions(points, state) > 0.0))
            result[: len(self.unknowns)] = motions[:, first]
        else:
            # Tissue that has not recovered is met where the elastic response passes its surface.
            elastic, by_unknowns = self._elastic(points, state)
            surface, lifted = self._creep(self.free, points, state)
            first = int(np.argmax(elastic > surface))
            result = by_unknowns[:, first] - lifted[:, first]
        size = float(np.linalg.norm(result))
        return result / size if size else result

    def at(self, points: Points, state: Array) -> tuple[Array | None, Array | None]:
        """Return it at the points of a record, and its derivatives, (size, points).

        None: it is at 0.
        """
        return self._creep(self.free, points, state) if self.free is not None else (None, None)

    def _creep(self, free: FreeSurface, points: Points, state: Array) -> tuple[Array, Array]:
        """Return the creep of earlier presses at the points, and its derivatives, (size, points).

        To first order the creep is less by what the relaxation is more.
        """
        if self._moments is None or self._moments[0] is not points:
            self._moments = points, free.at(points.times)
        moments, order = self._moments[1], order_of(state)
        own = KERNEL_HATS[: RATES.size, : self.kernel.stop - self.kernel.start]
        bend = np.exp(-(own @ state[self.kernel]))
        weights = creep_weights(order) * bend
        lifted = np.zeros((self.characteristic.stop, points.times.size))
        lifted[ORDER] = moments @ (creep_slopes(order) * bend)
        lifted[self.kernel] = -(own * weights[:, None]).T @ moments.T
        return moments @ weights, lifted

    def _elastic(self, points: Points, state: Array) -> tuple[Array, Array]:
        """Return the elastic response at the points, and its derivatives, (size, points)."""
        compressions = self.motion.compressions(points, state)
        if self.geometry.is_one_sided:
            compressions = np.maximum(compressions, 0.0)
        sizes = np.abs(compressions)
        strains, slopes, _ = self.geometry.strains(sizes)
        found = elastic_responses(strains, math.exp(state[LOG_G]), math.exp(state[LOG_GN]))
        knots = self.characteristic.stop - self.characteristic.start
        of_knots, _ = splines(strains, self.last_knot, knots)
        bend = np.exp(of_knots @ state[self.characteristic])
        elastic = found.value * bend
        slope = found.by_strain * slopes * (strains > 0.0) * bend
        by_unknowns = np.zeros((self.characteristic.stop, sizes.size))
        by_unknowns[: len(self.unknowns)] = slope * self.motion.design(points).motions
        by_unknowns[LOG_G] += elastic
        by_unknowns[LOG_GN] += found.by_log_nonlinear_stiffness * bend
        by_unknowns[self.characteristic] = elastic * of_knots.T
        return elastic, by_unknowns


class Curve(NamedTuple):
    """A stress-strain curve and its derivatives, without its error."""

    values: Array  #: [Pa s^alpha]
    slopes: Array  #: by the strain
    bends: Array  #: second derivatives by the strain
    #: Values and slopes, by ln Gn or what stands in its place.
    values_by_log_gn: Array
    slopes_by_log_gn: Array


class PressModel:
    """The model of one press.

    Parameters
    ----------
    is_bent : bool
        The law's errors are unknowns too: behind the others, kernel, then characteristic.
    last_knot : float
        Strain of the characteristic's last knot [1].
    free : FreeSurface or None
        None: the tissue is at rest before the press.

    Attributes
    ----------
    kernel, characteristic : slice
        Places of the law's errors in a state.
    size : int
        Of a state.
    """

    def __init__(
        self,
        unknowns: tuple[Unknown, ...],
        geometry: Geometry,
        *,
        is_bent: bool,
        last_knot: float,
        free: FreeSurface | None = None,
    ) -> None:
        self.unknowns, self.is_bent, self.last_knot = unknowns, is_bent, last_knot
        self.geometry = geometry
        self.kernel = slice(len(unknowns), len(unknowns) + KERNEL_KNOTS.size * is_bent)
        stop = self.kernel.stop + CHARACTERISTIC_KNOTS * is_bent
        self.characteristic = slice(self.kernel.stop, stop)
        self.size = stop
        names = [u.name for u in unknowns]
        self._compliance = names.index("compliance") if "compliance" in names else None
        self._adds_stress = np.array([u.stress is not None for u in unknowns])
        knots = By.FIRST_KNOT + np.arange(CHARACTERISTIC_KNOTS * is_bent)
        kernel = np.zeros(KERNEL_KNOTS.size * is_bent)
        kinds = np.concatenate([[u.kind for u in unknowns], kernel, knots])
        self._kinds = kinds.astype(np.int64)
        self._weight_of = np.full(self.size, -1, dtype=np.int64)
        self._weight_of[ORDER] = 0
        self._weight_of[self.kernel] = 1 + np.arange(kernel.size)
        self.motion = PressMotion(unknowns)
        self.surface = TissueSurface(
            unknowns, self.motion, geometry, self.kernel, self.characteristic, last_knot, free
        )
        self._law_at: tuple[Array, tuple[LawState, Array]] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return it without what the last state has decided: that is found anew."""
        return self.__dict__ | {"_law_at": None}

    def order(self, state: Array) -> float:
        """Return the order of the relaxation, for what the errors meet within a block [1]."""
        return order_of(state)

    def relaxation(self, order: float) -> tuple[Array, Array]:
        """Return the weights of the relaxation of an order, and their derivatives by it."""
        return relaxation_weights(order), relaxation_slopes(order)

    def relaxation_after(self, orders: Array, time: float) -> tuple[Array, Array]:
        """Return what is left of the weights after a time [s], and its derivatives by the order.

        Each of shape (n, RATE_COUNT + 1), of orders (n,).
        """
        return relaxation_after(orders, time)

    def curve(self, strains: Array, states: Array) -> Curve:
        """Return the stress-strain curve of states (modes, n) at strains (modes,)."""
        linear, nonlinear = np.exp(states[..., LOG_G]), np.exp(states[..., LOG_GN])
        reach = nonlinear * strains
        excess = np.maximum(reach - 1.0, 0.0)
        is_beyond = excess > 0.0
        slopes = linear * np.exp(np.minimum(excess, MAX_EXPONENT))
        values = phi(strains, linear, nonlinear)
        bends = slopes * nonlinear * is_beyond
        return Curve(values, slopes, bends, values * excess, slopes * reach * is_beyond)

    def evaluate(
        self, points: Points, state: Array, going_on: ResponseState | None = None
    ) -> Evaluation:
        """Return the stress of every block with its derivatives.

        `going_on`: from where the response goes on; None: the record begins at rest.
        """
        _, rows = self._law(state)
        design, (surface, lifted) = self.motion.design(points), self.surface.at(points, state)
        columns = Columns(self._kinds, design.motions, self._weight_of, rows, lifted)
        begun = going_on if going_on is not None else ResponseState(self.size)
        found = self._evaluated(points, state, surface, columns, begun)
        if self._compliance is not None:
            found.jacobian[:, self._compliance] *= self._compliance_unit
        of_unknowns = found.jacobian[:, : self._adds_stress.size]
        of_unknowns[:, self._adds_stress] = design.stresses[self._adds_stress].T
        return found

    def response(self, points: Points, state: Array) -> Evaluation:
        """Return the stress of every block without its derivatives."""
        surface, _ = self.surface.at(points, state)
        return self._evaluated(points, state, surface, None, ResponseState(0))

    def _evaluated(
        self,
        points: Points,
        state: Array,
        surface: Array | None,
        columns: Columns | None,
        begun: ResponseState,
    ) -> Evaluation:
        steps = Steps(points.elapsed, points.moments, points.first, points.last)
        compressions = self.motion.compressions(points, state)
        law, _ = self._law(state)
        found = loops.respond(law, steps, compressions, surface, columns, begun)
        return found._replace(stress=found.stress + self.motion.added_stress(points, state))

    def _law(self, state: Array) -> tuple[LawState, Array]:
        """Return the law at a state, and the derivatives of its weights, (rows, RATES + 2).

        Those of the last state are kept: a filter goes on from one.
        """
        if self._law_at is not None and np.array_equal(self._law_at[0], state):
            return self._law_at[1]
        weights, slopes = self.relaxation(order_of(state))
        rows = slopes[None]
        if self.is_bent:
            bend = np.exp(KERNEL_HATS @ state[self.kernel])
            weights = weights * bend
            rows = np.ascontiguousarray(np.vstack([slopes * bend, weights * KERNEL_HATS.T]))
        compliance = 0.0
        if self._compliance is not None:
            compliance = self._compliance_unit * float(state[self._compliance])
        law = LawState(
            linear_stiffness=math.exp(state[LOG_G]),
            nonlinear_stiffness=math.exp(state[LOG_GN]),
            exponent=self.geometry.exponent,
            is_one_sided=self.geometry.is_one_sided,
            compliance=compliance,
            weights=weights,
            bend=state[self.characteristic],
            last_knot=self.last_knot,
            series=self.geometry.series,
        )
        self._law_at = state.copy(), (law, rows)
        return law, rows

    @property
    def _compliance_unit(self) -> float:
        """Compression by stress of one standard deviation of the compliance [1/Pa]."""
        assert self._compliance is not None
        sd = self.unknowns[self._compliance].sd
        return sd / self.geometry.length / self.geometry.stress_per_force

    @property
    def bending(self) -> Array:
        """Compression by stress of one standard deviation of each unknown [1/Pa], (size,)."""
        result = np.zeros(self.size)
        if self._compliance is not None:
            result[self._compliance] = -self._compliance_unit
        return result
