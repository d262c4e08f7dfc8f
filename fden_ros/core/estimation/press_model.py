# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The stress of a press as a function of its unknowns, with all derivatives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.loops import (
    BY_FIRST_KNOT,
    Columns,
    LawState,
    ResponseState,
    Steps,
)
from fden_ros.core.estimation.smooth_errors import CHARACTERISTIC_KNOTS, KERNEL_HATS, KERNEL_KNOTS
from fden_ros.core.estimation.tissue_surface import FreeSurface, TissueSurface
from fden_ros.core.estimation.unknowns import LOG_G, LOG_GN, ORDER, PressMotion, Unknown, order_of
from fden_ros.core.law import (
    MAX_EXPONENT,
    Geometry,
    phi,
    relaxation_after,
    relaxation_slopes,
    relaxation_weights,
)


@dataclass(frozen=True)
class Evaluation:
    """The stress of a press at one state."""

    stress: Array  #: of the blocks [Pa], (m,)
    jacobian: Array  #: shape (m, unknowns)
    #: Elastic response at the points [Pa s^alpha], and its derivative by the compression,
    #: (points,).
    elastic: Array
    slope: Array
    state: ResponseState  #: from which the response goes on


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
    unknowns : tuple of Unknown
    geometry : Geometry
    is_bent : bool
        The law's errors are unknowns too: behind the others, kernel, then characteristic.
    last_knot : float
        Strain of the characteristic's last knot [1].
    free : FreeSurface or None
        None: the tissue is at rest before the press.

    Attributes
    ----------
    motion : PressMotion
    surface : TissueSurface
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
        knots = BY_FIRST_KNOT + np.arange(CHARACTERISTIC_KNOTS * is_bent)
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

        Raises
        ------
        FloatingPointError
            If the stress is beyond floating-point numbers.
        """
        points = self.motion.moved(points, state)
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
        """Return the stress of every block without its derivatives.

        Raises
        ------
        FloatingPointError
            If the stress is beyond floating-point numbers.
        """
        points = self.motion.moved(points, state)
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
        stress = found.stress + self.motion.added_stress(points, state)
        return Evaluation(stress, found.jacobian, found.elastic, found.slope, begun)

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
