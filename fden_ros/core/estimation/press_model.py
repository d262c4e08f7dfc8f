# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The stress of a press as a function of its unknowns, with all derivatives."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.loop_arguments import BY_KNOT, Column, LawState, ResponseState
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
from fden_ros.core.law.geometry import Geometry, Sphere, TorsionalRheometer
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


@dataclass(frozen=True)
class Evaluation:
    """The stress of a press at one state.

    Attributes
    ----------
    stress : ndarray, shape (m,)
        Of the blocks [Pa].
    jacobian : ndarray, shape (m, unknowns)
    state : ResponseState
        From which the response goes on.
    """

    stress: Array
    jacobian: Array
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
        self.exponent = 1.5 if isinstance(geometry, Sphere) else 1.0
        self.is_one_sided = not isinstance(geometry, TorsionalRheometer)
        self.kernel = slice(len(unknowns), len(unknowns) + KERNEL_KNOTS.size * is_bent)
        stop = self.kernel.stop + CHARACTERISTIC_KNOTS * is_bent
        self.characteristic = slice(self.kernel.stop, stop)
        self.size = stop
        self._compliance = next(
            (k for k, u in enumerate(unknowns) if u.name == "compliance"), None
        )

    def order(self, state: Array) -> float:
        """Return the order of the relaxation, for what the errors meet within a block [1]."""
        return _order(state)

    def relaxation(self, order: float) -> tuple[Array, Array]:
        """Return the weights of the relaxation of an order, and their derivatives by it."""
        return relaxation_weights(order), relaxation_slopes(order)

    def law(self, state: Array) -> LawState:
        """Return the law at a state."""
        weights, _ = self.relaxation(_order(state))
        if self.is_bent:
            weights = weights * np.exp(KERNEL_HATS @ state[self.kernel])
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

    @property
    def _compliance_unit(self) -> float:
        """Compression by stress of one standard deviation of the compliance [1/Pa]."""
        assert self._compliance is not None
        sd = self.unknowns[self._compliance].sd
        return sd / self.geometry.length / self.geometry.stress_per_force

    def compressions(self, points: Points, state: Array) -> Array:
        """Return the compressions from the origin at the points of a record."""
        result = points.compressions.copy()
        for value, unknown in zip(state, self.unknowns, strict=False):
            if unknown.motion is not None and value:
                result += value * unknown.motion(points)
        return result

    def touch_gradient(self, points: Points, state: Array) -> Array:
        """Return how each unknown moves the touch, as a unit vector (n,)."""
        first = int(np.argmax(self.compressions(points, state) > 0.0))
        result = np.zeros(self.size)
        for k, unknown in enumerate(self.unknowns):
            if unknown.motion is not None:
                result[k] = unknown.motion(points)[first]
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
        law = self.law(state)
        columns = self._columns(points, law, state)
        begun = going_on if going_on is not None else ResponseState(len(columns))
        response, derivatives = loops.respond(
            law,
            RATES,
            (points.elapsed, points.moments),
            self.compressions(points, state),
            self._surface(points, state)[0],
            columns,
            begun,
        )
        stress = points.mean(response)
        jacobian = np.empty((stress.size, self.size))
        by_point = points.mean(derivatives).T
        place = 0
        for k, unknown in enumerate(self.unknowns):
            if unknown.stress is not None:
                jacobian[:, k] = unknown.stress(points)
                stress = stress + state[k] * jacobian[:, k]
                continue
            jacobian[:, k] = by_point[:, place]
            if k == self._compliance:
                jacobian[:, k] *= self._compliance_unit
            place += 1
        jacobian[:, len(self.unknowns) :] = by_point[:, place:]
        return Evaluation(stress, jacobian, begun)

    def stress(self, points: Points, state: Array) -> Array:
        """Return the stress of every block."""
        compressions = self.compressions(points, state)
        surface = self._surface(points, state)[0]
        steps = (points.elapsed, points.moments)
        begun = ResponseState(0)
        response, _ = loops.respond(
            self.law(state), RATES, steps, compressions, surface, [], begun
        )
        result = points.mean(response)
        for value, unknown in zip(state, self.unknowns, strict=False):
            if unknown.stress is not None:
                result = result + value * unknown.stress(points)
        return result

    def _columns(self, points: Points, law: LawState, state: Array) -> list[Column]:
        _, slopes = self.relaxation(_order(state))
        if self.is_bent:
            slopes = slopes * np.exp(KERNEL_HATS @ state[self.kernel])
        _, by_order, by_knots = self._surface(points, state)
        added = self._added(points, state)
        found = []
        for k, unknown in enumerate(self.unknowns):
            column = unknown.column(points, slopes if k == ORDER else None)
            if column is None:
                continue
            if k == ORDER and by_order is not None:
                column = Column(surface=by_order, weights=slopes)
            if unknown.since is not None:
                after = points.times > unknown.since
                column = Column(surface=-self.elastic(points, state)[0] * after)
            elif added is not None:
                column = _with_surface(column, self._added_by(points, state, unknown))
            found.append(column)
        if self.is_bent:
            for m in range(KERNEL_KNOTS.size):
                surface = by_knots[m] if by_knots is not None else None
                found.append(Column(surface=surface, weights=law.weights * KERNEL_HATS[:, m]))
            bends = [Column(BY_KNOT, m) for m in range(CHARACTERISTIC_KNOTS)]
            if added is not None:
                splines = characteristic_splines(self._strains(points, state)[0], self.last_knot)
                bends = [
                    _with_surface(c, added * s) for c, s in zip(bends, splines.T, strict=True)
                ]
            found += bends
        return found

    def _added_by(self, points: Points, state: Array, unknown: Unknown) -> Array | None:
        """Return the derivative by an unknown of what changes add to the elastic response."""
        added = self._added(points, state)
        if added is None or unknown.name == "log_g":
            return added
        elastic, slope = self.elastic(points, state)
        ratio = np.divide(added, elastic, out=np.zeros_like(added), where=elastic > 0.0)
        if unknown.name == "log_gn":
            step = np.zeros(state.size)
            step[LOG_GN] = _LOG_STEP
            higher, lower = (self.elastic(points, state + s)[0] for s in (step, -step))
            result: Array = ratio * (higher - lower) / (2.0 * _LOG_STEP)
            return result
        return ratio * slope * unknown.motion(points) if unknown.motion is not None else None

    def _surface(
        self, points: Points, state: Array
    ) -> tuple[Array | None, Array | None, Array | None]:
        """Return the free surface at the points, and its derivatives by alpha and by delta.

        To first order the creep is less by what the relaxation is more. A change of the stiffness
        lowers the surface by what it adds to the elastic response.
        """
        added = self._added(points, state)
        if self._free is None:
            return -added if added is not None else None, None, None
        moments = self._free.at(points.times)
        order = _order(state)
        weights = creep_weights(order)
        slopes = (creep_weights(order + _ORDER_STEP) - creep_weights(order - _ORDER_STEP)) / (
            2.0 * _ORDER_STEP
        )
        if not self.is_bent:
            surface = moments @ weights
            return (surface if added is None else surface - added), moments @ slopes, None
        own = KERNEL_HATS[: RATES.size]
        bend = np.exp(-(own @ state[self.kernel]))
        weights, slopes = weights * bend, slopes * bend
        by_knots = -(own * weights[:, None]).T @ moments.T
        surface = moments @ weights
        return (surface if added is None else surface - added), moments @ slopes, by_knots

    def _added(self, points: Points, state: Array) -> Array | None:
        """Return what changes of the stiffness add to the elastic response; None: nothing."""
        result = None
        for value, unknown in zip(state, self.unknowns, strict=False):
            if unknown.since is not None and value:
                change = value * self.elastic(points, state)[0] * (points.times > unknown.since)
                result = change if result is None else result + change
        return result

    def _strains(self, points: Points, state: Array) -> tuple[Array, Array]:
        """Return the strains at the points, and their slopes by the compression."""
        compressions = self.compressions(points, state)
        if self.is_one_sided:
            compressions = np.maximum(compressions, 0.0)
        strains = np.abs(compressions)
        if self.exponent == 1.0:
            return strains, np.ones_like(strains)
        return strains**self.exponent, self.exponent * np.sqrt(strains)

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


def _with_surface(column: Column, added: Array | None) -> Column:
    """Return a column with what it adds to the elastic response, as a lower surface."""
    if added is None:
        return column
    surface = -added if column.surface is None else column.surface - added
    return replace(column, surface=surface)


def _order(state: Array) -> float:
    return float(np.clip(state[ORDER], LOWEST_ORDER, HIGHEST_ORDER))
