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
from fden_ros.core.estimation.loops import (
    BY_FIRST_KNOT,
    Columns,
    LawState,
    ResponseState,
    Steps,
)
from fden_ros.core.estimation.record import Points
from fden_ros.core.estimation.unknowns import (
    CHARACTERISTIC_KNOTS,
    KERNEL_HATS,
    KERNEL_KNOTS,
    LOG_G,
    LOG_GN,
    ORDER,
    Unknown,
    splines,
)
from fden_ros.core.law import (
    HIGHEST_ORDER,
    LOWEST_ORDER,
    RATES,
    Geometry,
    StressMoments,
    creep_slopes,
    creep_weights,
    elastic_responses,
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


@dataclass(frozen=True)
class FreeSurface:
    """What earlier presses have left of the tissue: the creep of their stress."""

    moments: StressMoments  #: at `time`
    time: float  #: [s], of the clock of the records

    def at(self, times: Array) -> Array:
        """Return the exponential moments at times, shape (n, RATES)."""
        return self.moments.after(np.maximum(times - self.time, 0.0))


class _Design(NamedTuple):
    """What a record alone decides of the model."""

    motions: Array  #: compressions by one standard deviation of each unknown, (unknowns, points)
    stresses: Array  #: of the stress at the blocks, (unknowns, m)
    free: Array | None  #: moments of the stress of earlier presses, (points, RATES)


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
        self.geometry, self._free = geometry, free
        self.kernel = slice(len(unknowns), len(unknowns) + KERNEL_KNOTS.size * is_bent)
        stop = self.kernel.stop + CHARACTERISTIC_KNOTS * is_bent
        self.characteristic = slice(self.kernel.stop, stop)
        self.size = stop
        names = [u.name for u in unknowns]
        self._compliance = names.index("compliance") if "compliance" in names else None
        late = [k for k, u in enumerate(unknowns) if u.touch_speed is not None]
        self._late = late[0] if late else None  # the delay that shifts the motion
        self._moved: tuple[Points, float, Points] | None = None
        self._adds_stress = np.array([u.stress is not None for u in unknowns])
        knots = BY_FIRST_KNOT + np.arange(CHARACTERISTIC_KNOTS * is_bent)
        kernel = np.zeros(KERNEL_KNOTS.size * is_bent)
        kinds = np.concatenate([[u.kind for u in unknowns], kernel, knots])
        self._kinds = kinds.astype(np.int64)
        self._weight_of = np.full(self.size, -1, dtype=np.int64)
        self._weight_of[ORDER] = 0
        self._weight_of[self.kernel] = 1 + np.arange(kernel.size)
        # By what unknowns change ln G since the last press, which has left less or more by that.
        self.by_softening = np.zeros(self.size)
        self.by_softening[: len(unknowns)] = [
            u.of_law[LOG_G] if u.of_law else 0.0 for u in unknowns
        ]
        self._designed: tuple[Points, _Design] | None = None
        self._law_at: tuple[Array, tuple[LawState, Array]] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return it without what the last record and state have decided: that is found anew."""
        return self.__dict__ | {"_designed": None, "_law_at": None, "_moved": None}

    def order(self, state: Array) -> float:
        """Return the order of the relaxation, for what the errors meet within a block [1]."""
        return _order(state)

    def relaxation(self, order: float) -> tuple[Array, Array]:
        """Return the weights of the relaxation of an order, and their derivatives by it."""
        return relaxation_weights(order), relaxation_slopes(order)

    def relaxation_after(self, orders: Array, time: float) -> tuple[Array, Array]:
        """Return what is left of the weights after a time [s], and its derivatives by the order.

        Each of shape (n, RATE_COUNT + 1), of orders (n,).
        """
        return relaxation_after(orders, time)

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
        points = self.moved(points, state)
        _, rows = self._law(state)
        design, (surface, lifted) = self._design(points), self._surface(points, state)
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
        points = self.moved(points, state)
        surface, _ = self._surface(points, state)
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
        compressions = self._compressions(points, state)
        law, _ = self._law(state)
        found = loops.respond(law, steps, compressions, surface, columns, begun)
        stress = found.stress + self._of_unknowns(state) @ self._design(points).stresses
        return Evaluation(stress, found.jacobian, found.elastic, found.slope, begun)

    def _law(self, state: Array) -> tuple[LawState, Array]:
        """Return the law at a state, and the derivatives of its weights, (rows, RATES + 2).

        Those of the last state are kept: a filter goes on from one.
        """
        if self._law_at is not None and np.array_equal(self._law_at[0], state):
            return self._law_at[1]
        weights, slopes = self.relaxation(_order(state))
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

    def _design(self, points: Points) -> _Design:
        """Return the design of a record; that of the last one is kept."""
        if self._designed is None or self._designed[0] is not points:
            motions = np.zeros((len(self.unknowns), points.times.size))
            stresses = np.zeros((len(self.unknowns), points.stresses.size))
            for k, unknown in enumerate(self.unknowns):
                if unknown.motion is not None:
                    motions[k] = unknown.motion(points)
                if unknown.stress is not None:
                    stresses[k] = unknown.stress(points)
            free = self._free.at(points.times) if self._free is not None else None
            self._designed = points, _Design(motions, stresses, free)
        return self._designed[1]

    def moved(self, points: Points, state: Array) -> Points:
        """Return a record with its motion as early as a long delay says; that of the last is kept.

        What follows from the record at a state takes this one.
        """
        if self._late is None:
            return points
        unknown = self.unknowns[self._late]
        assert unknown.touch_speed is not None
        delay = unknown.sd * float(state[self._late])
        if self._moved is None or self._moved[0] is not points or self._moved[1] != delay:
            self._moved = points, delay, points.earlier(delay, unknown.touch_speed)
        return self._moved[2]

    def _compressions(self, points: Points, state: Array) -> Array:
        """Return the compressions from the origin at the points of a record that is moved."""
        own = self._of_unknowns(state)
        if self._late is not None:
            own = own.copy()
            own[self._late] = 0.0  # it has moved the record
        result: Array = points.compressions + own @ self._design(points).motions
        return result

    def ends(self, points: Points, state: Array) -> tuple[Array, Array]:
        """Return the compressions from the origin at the ends of blocks [1], (m,).

        And their derivatives by the state, (m, size).
        """
        points = self.moved(points, state)
        last = points.last
        by_state = np.zeros((last.size, self.size))
        by_state[:, : len(self.unknowns)] = self._design(points).motions[:, last].T
        return self._compressions(points, state)[last], by_state

    def _of_unknowns(self, state: Array) -> Array:
        """Return the state without the law's errors."""
        return state[: len(self.unknowns)]

    # The free surface: what earlier presses have left. A change of the stiffness lowers it by what
    # it adds to the elastic response.

    def touch_gradient(self, points: Points, state: Array) -> Array:
        """Return how each unknown moves the touch, as a unit vector (n,)."""
        points = self.moved(points, state)
        if self._free is None:
            result, motions = np.zeros(self.size), self._design(points).motions
            first = int(np.argmax(self._compressions(points, state) > 0.0))
            result[: len(self.unknowns)] = motions[:, first]
        else:
            # Tissue that has not recovered is met where the elastic response passes its surface.
            elastic, by_unknowns = self._elastic(points, state)
            surface, lifted = self._creep(points, state)
            first = int(np.argmax(elastic > surface))
            result = by_unknowns[:, first] - lifted[:, first]
        size = float(np.linalg.norm(result))
        return result / size if size else result

    def _surface(self, points: Points, state: Array) -> tuple[Array | None, Array | None]:
        """Return the free surface at the points, and its derivatives, (size, points).

        None: it is at 0.
        """
        surface, lifted = (None, None) if self._free is None else self._creep(points, state)
        ratio = self._change(points, state)
        if ratio is None:
            return surface, lifted
        elastic, by_unknowns = self._elastic(points, state)
        added = ratio * elastic
        surface = -added if surface is None else surface - added
        lifted = -ratio * by_unknowns if lifted is None else lifted - ratio * by_unknowns
        for k, unknown in enumerate(self.unknowns):
            if unknown.since is not None:
                lifted[k] -= elastic * (points.times > unknown.since)
        return surface, lifted

    def _creep(self, points: Points, state: Array) -> tuple[Array, Array]:
        """Return the creep of earlier presses at the points, and its derivatives, (size, points).

        To first order the creep is less by what the relaxation is more.
        """
        moments, order = self._design(points).free, _order(state)
        assert moments is not None
        own = KERNEL_HATS[: RATES.size, : self.kernel.stop - self.kernel.start]
        bend = np.exp(-(own @ state[self.kernel]))
        factor = self.softening(state)
        weights = factor * creep_weights(order) * bend
        lifted = np.zeros((self.size, points.times.size))
        lifted[ORDER] = factor * moments @ (creep_slopes(order) * bend)
        lifted[self.kernel] = -(own * weights[:, None]).T @ moments.T
        surface = moments @ weights
        lifted += np.outer(self.by_softening, surface)
        return surface, lifted

    def softening(self, state: Array) -> float:
        """Return the factor of the stiffness since the last press [1]."""
        return math.exp(float(self.by_softening @ state))

    def changes(self, state: Array) -> tuple[Array, Array]:
        """Return the sizes of the changes [1] and their times [s]."""
        found = [
            (value, u.since)
            for value, u in zip(state, self.unknowns, strict=False)
            if u.since is not None
        ]
        sizes, times = np.array(found, dtype=float).reshape(-1, 2).T
        return np.ascontiguousarray(sizes), np.ascontiguousarray(times)

    def _change(self, points: Points, state: Array) -> Array | None:
        """Return the part of the elastic response that changes add; None: there are none."""
        if all(unknown.since is None for unknown in self.unknowns):
            return None
        ratio = np.zeros(points.times.size)
        for value, unknown in zip(state, self.unknowns, strict=False):
            if unknown.since is not None:
                ratio += value * (points.times > unknown.since)
        return ratio

    def _elastic(self, points: Points, state: Array) -> tuple[Array, Array]:
        """Return the elastic response at the points, and its derivatives, (size, points)."""
        compressions = self._compressions(points, state)
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
        by_unknowns = np.zeros((self.size, sizes.size))
        by_unknowns[: len(self.unknowns)] = slope * self._design(points).motions
        by_unknowns[LOG_G] += elastic
        by_unknowns[LOG_GN] += found.by_log_nonlinear_stiffness * bend
        by_unknowns[self.characteristic] = elastic * of_knots.T
        return elastic, by_unknowns


def _order(state: Array) -> float:
    return float(np.clip(state[ORDER], LOWEST_ORDER, HIGHEST_ORDER))
