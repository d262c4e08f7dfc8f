# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The stress of a press as a function of its unknowns, with all derivatives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.loop_arguments import (
    BY_FIRST_KNOT,
    Columns,
    LawState,
    Response,
    ResponseState,
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
    characteristic_splines,
)
from fden_ros.core.law.characteristic import elastic_responses
from fden_ros.core.law.geometry import Geometry
from fden_ros.core.law.relaxation import (
    HIGHEST_ORDER,
    LOWEST_ORDER,
    RATES,
    StressMoments,
    creep_weights,
    relaxation_slopes,
    relaxation_weights,
)

_ORDER_STEP, _LOG_STEP = 1e-5, 1e-5
#: Weight of each knot of the kernel's error in each weight of the relaxation.
_OF_KNOTS = np.ascontiguousarray(KERNEL_HATS.T)


@dataclass(frozen=True)
class Evaluation:
    """The stress of a press at one state.

    Attributes
    ----------
    stress : ndarray, shape (m,)
        Of the blocks [Pa].
    jacobian : ndarray, shape (m, unknowns)
    elastic, slope : ndarray, shape (points,)
        Elastic response at the points [Pa s^alpha], and its derivative by the compression.
    state : ResponseState
        From which the response goes on.
    """

    stress: Array
    jacobian: Array
    elastic: Array
    slope: Array
    state: ResponseState


@dataclass(frozen=True)
class FreeSurface:
    """What earlier presses have left of the tissue: the creep of their stress.

    Attributes
    ----------
    moments : StressMoments
        At `time`.
    time : float
        [s], of the clock of the records.
    """

    moments: StressMoments
    time: float

    def at(self, times: Array) -> Array:
        """Return the exponential moments at times, shape (n, RATES)."""
        return self.moments.after(np.maximum(times - self.time, 0.0))


@dataclass(frozen=True)
class _Design:
    """What a record alone decides of the model.

    Attributes
    ----------
    motions : ndarray, shape (unknowns, points)
        Change of the compressions by one standard deviation of each unknown.
    stresses : ndarray, shape (unknowns, m)
        Of the stress at the blocks.
    free : ndarray or None, shape (points, RATES)
        Moments of the stress of earlier presses.
    """

    motions: Array
    stresses: Array
    free: Array | None


@dataclass(frozen=True)
class _Change:
    """What changes of the stiffness add to the elastic response.

    Attributes
    ----------
    ratio : ndarray, shape (points,)
        The part that is added [1].
    elastic, slope : ndarray, shape (points,)
        Elastic response without it, and its derivative by the compression.
    """

    ratio: Array
    elastic: Array
    slope: Array

    @property
    def added(self) -> Array:
        """What is added."""
        return self.ratio * self.elastic


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
        self.exponent, self.is_one_sided = geometry.exponent, geometry.is_one_sided
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
        self._kinds = kinds.astype(np.int32)
        self._weight_of = np.full(self.size, -1, dtype=np.int32)
        self._weight_of[ORDER] = 0
        self._weight_of[self.kernel] = 1 + np.arange(kernel.size)
        self._designed: tuple[Points, _Design] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return it without what the last record has decided: that is found anew."""
        return self.__dict__ | {"_designed": None}

    def order(self, state: Array) -> float:
        """Return the order of the relaxation, for what the errors meet within a block [1]."""
        return _order(state)

    def relaxation(self, order: float) -> tuple[Array, Array]:
        """Return the weights of the relaxation of an order, and their derivatives by it."""
        return relaxation_weights(order), relaxation_slopes(order)

    def _law(self, state: Array, weights: Array) -> LawState:
        """Return the law at a state, with the weights of its relaxation."""
        compliance = 0.0
        if self._compliance is not None:
            compliance = self._compliance_unit * float(state[self._compliance])
        return LawState(
            linear_stiffness=math.exp(state[LOG_G]),
            nonlinear_stiffness=math.exp(state[LOG_GN]),
            exponent=self.exponent,
            is_one_sided=self.is_one_sided,
            compliance=compliance,
            weights=weights,
            bend=state[self.characteristic],
            last_knot=self.last_knot,
        )

    def _bent_relaxation(self, state: Array) -> tuple[Array, Array]:
        """Return the weights of the relaxation with its error, and their derivatives by alpha."""
        weights, slopes = self.relaxation(_order(state))
        if not self.is_bent:
            return weights, slopes
        bend = np.exp(KERNEL_HATS @ state[self.kernel])
        return weights * bend, slopes * bend

    @property
    def _compliance_unit(self) -> float:
        """Compression by stress of one standard deviation of the compliance [1/Pa]."""
        assert self._compliance is not None
        sd = self.unknowns[self._compliance].sd
        return sd / self.geometry.length / self.geometry.stress_per_force

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

    def compressions(self, points: Points, state: Array) -> Array:
        """Return the compressions from the origin at the points of a record."""
        moved = self._of_unknowns(state) @ self._design(points).motions
        result: Array = points.compressions + moved
        return result

    def _of_unknowns(self, state: Array) -> Array:
        """Return the state without the law's errors."""
        return state[: len(self.unknowns)]

    def touch_gradient(self, points: Points, state: Array) -> Array:
        """Return how each unknown moves the touch, as a unit vector (n,)."""
        result, motions = np.zeros(self.size), self._design(points).motions
        surface, by_order, by_knots = self._surface(points, state, None)
        if surface is None or by_order is None:
            first = int(np.argmax(self.compressions(points, state) > 0.0))
            result[: len(self.unknowns)] = motions[:, first]
        else:
            # Tissue that has not recovered is met where the elastic response passes its surface.
            elastic, slope = self.elastic(points, state)
            first = int(np.argmax(elastic > surface))
            result[: len(self.unknowns)] = slope[first] * motions[:, first]
            result[LOG_G] += elastic[first]
            result[LOG_GN] += self._rise_by_log_gn(points, state)[first] / (2.0 * _LOG_STEP)
            result[ORDER] -= by_order[first]
            if by_knots is not None:
                strain = self._strains(points, state)[0][first : first + 1]
                splines = characteristic_splines(strain, self.last_knot)[0]
                result[self.kernel] = -by_knots[:, first]
                result[self.characteristic] = elastic[first] * splines
        size = float(np.linalg.norm(result))
        return result / size if size else result

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
        design = self._design(points)
        relaxation = self._bent_relaxation(state)
        law, asked = self._law(state, relaxation[0]), self._columns(points, state, relaxation)
        begun = going_on if going_on is not None else ResponseState(self.size)
        found = self._response(points, state, law, asked, begun)
        by_block = found.jacobian[points.first] + found.jacobian[points.last]
        by_block *= 0.5
        if self._compliance is not None:
            by_block[:, self._compliance] *= self._compliance_unit
        of_unknowns = by_block[:, : self._adds_stress.size]
        of_unknowns[:, self._adds_stress] = design.stresses[self._adds_stress].T
        stress = points.mean(found.stress) + self._of_unknowns(state) @ design.stresses
        return Evaluation(stress, by_block, found.elastic, found.slope, begun)

    def response(self, points: Points, state: Array) -> Evaluation:
        """Return the stress of every block without its derivatives.

        Raises
        ------
        FloatingPointError
            If the stress is beyond floating-point numbers.
        """
        begun = ResponseState(0)
        surface = self._surface(points, state, self._change(points, state))[0]
        law = self._law(state, self._bent_relaxation(state)[0])
        asked = surface, Columns.none(points.times.size)
        found = self._response(points, state, law, asked, begun)
        stress = points.mean(found.stress)
        stress += self._of_unknowns(state) @ self._design(points).stresses
        return Evaluation(stress, np.zeros((stress.size, 0)), found.elastic, found.slope, begun)

    def _response(
        self,
        points: Points,
        state: Array,
        law: LawState,
        asked: tuple[Array | None, Columns],
        begun: ResponseState,
    ) -> Response:
        compressions = self.compressions(points, state)
        steps = points.elapsed, points.moments
        return loops.respond(law, RATES, steps, compressions, *asked, begun)

    def _columns(
        self, points: Points, state: Array, relaxation: tuple[Array, Array]
    ) -> tuple[Array | None, Columns]:
        """Return the free surface, and what the response is derived by."""
        weights, slopes = relaxation
        rows = slopes[None]
        if self.is_bent:
            rows = np.vstack([slopes, weights * _OF_KNOTS])
        change = self._change(points, state)
        surface, by_order, by_knots = self._surface(points, state, change)
        lifted = None
        if surface is not None:
            lifted = np.zeros((self.size, points.times.size))
            if by_order is not None:
                lifted[ORDER] = by_order
            if by_knots is not None:
                lifted[self.kernel] = by_knots
            if change is not None:
                self._lower(lifted, points, state, change)
        motions = self._design(points).motions
        return surface, Columns(self._kinds, motions, self._weight_of, rows, lifted)

    def _lower(self, lifted: Array, points: Points, state: Array, change: _Change) -> None:
        """Lower the surface's derivatives by what changes add to the elastic response."""
        motions = self._design(points).motions
        lifted[: len(self.unknowns)] -= change.ratio * change.slope * motions
        lifted[LOG_G] -= change.added
        rise = self._rise_by_log_gn(points, state)
        lifted[LOG_GN] -= change.ratio * rise / (2.0 * _LOG_STEP)
        for k, unknown in enumerate(self.unknowns):
            if unknown.since is not None:
                lifted[k] -= change.elastic * (points.times > unknown.since)
        if self.is_bent:
            splines = characteristic_splines(self._strains(points, state)[0], self.last_knot)
            lifted[self.characteristic] -= change.added * splines.T

    def _rise_by_log_gn(self, points: Points, state: Array) -> Array:
        """Return how the elastic response rises from a step below ln Gn to one above it."""
        step = np.zeros(state.size)
        step[LOG_GN] = _LOG_STEP
        higher, lower = (self.elastic(points, state + s)[0] for s in (step, -step))
        result: Array = higher - lower
        return result

    def _surface(
        self, points: Points, state: Array, change: _Change | None
    ) -> tuple[Array | None, Array | None, Array | None]:
        """Return the free surface at the points, and its derivatives by alpha and by delta.

        To first order the creep is less by what the relaxation is more. A change of the stiffness
        lowers the surface by what it adds to the elastic response.
        """
        added = 0.0 if change is None else change.added
        if self._free is None:
            return None if change is None else -change.added, None, None
        moments = self._design(points).free
        assert moments is not None
        order = _order(state)
        weights = creep_weights(order)
        slopes = (creep_weights(order + _ORDER_STEP) - creep_weights(order - _ORDER_STEP)) / (
            2.0 * _ORDER_STEP
        )
        if not self.is_bent:
            return moments @ weights - added, moments @ slopes, None
        own = KERNEL_HATS[: RATES.size]
        bend = np.exp(-(own @ state[self.kernel]))
        weights, slopes = weights * bend, slopes * bend
        by_knots = -(own * weights[:, None]).T @ moments.T
        return moments @ weights - added, moments @ slopes, by_knots

    def _change(self, points: Points, state: Array) -> _Change | None:
        """Return what changes of the stiffness add; None: there are none."""
        if all(unknown.since is None for unknown in self.unknowns):
            return None
        ratio = np.zeros(points.times.size)
        for value, unknown in zip(state, self.unknowns, strict=False):
            if unknown.since is not None:
                ratio += value * (points.times > unknown.since)
        return _Change(ratio, *self.elastic(points, state))

    def _strains(self, points: Points, state: Array) -> tuple[Array, Array]:
        """Return the strains at the points, and their slopes by the compression."""
        compressions = self.compressions(points, state)
        if self.is_one_sided:
            compressions = np.maximum(compressions, 0.0)
        strains = np.abs(compressions)
        if self.exponent == 1.0:
            return strains, np.ones_like(strains)
        return strains**self.exponent, self.exponent * strains ** (self.exponent - 1.0)

    def elastic(self, points: Points, state: Array) -> tuple[Array, Array]:
        """Return the elastic response at the points and its slope by the compression."""
        strains, by_compression = self._strains(points, state)
        found = elastic_responses(strains, math.exp(state[LOG_G]), math.exp(state[LOG_GN]))
        slope = found.by_strain * by_compression * (strains > 0.0)
        if not self.is_bent:
            return found.value, slope
        splines = characteristic_splines(strains, self.last_knot)
        bend = np.exp(splines @ state[self.characteristic])
        return found.value * bend, slope * bend


def _order(state: Array) -> float:
    return float(np.clip(state[ORDER], LOWEST_ORDER, HIGHEST_ORDER))
