# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The inner loops in numpy: oracle of the compiled ones, and their stand-in without a compiler.

The equations are those of :mod:`fden_ros.core.estimation.loops`. Here one step is one linear map:
psi at the four nodes of its active part goes into the exponentials by `reach`, shape (RATES,
NODES), and into the stress by `weighs`, shape (NODES,). What the compiled loops do in another
order differs by rounding alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from fden_ros.core.arrays import Array, Indices
from fden_ros.core.estimation.loop_arguments import (
    BY_COMPLIANCE,
    BY_FIRST_KNOT,
    BY_LOG_G,
    BY_LOG_GN,
    RATES,
    Columns,
    LawState,
    Response,
    ResponseState,
    WalkState,
)

# Gauss-Lobatto nodes on [0, 1]; and the Legendre coefficients of the derivative of the cubic
# through values there.
_PLACES = np.array([0.0, 0.27639320225002106, 0.72360679774997894, 1.0])
_SLOPES = np.array(
    [
        [-0.5, 0.0, 0.0, 0.5],
        [1.25, -1.25, -1.25, 1.25],
        [-1.25, 2.795084971874737, -2.795084971874737, 1.25],
    ]
)
#: Below this half the moments are series: their closed form cancels there.
_SERIES_LIMIT = 0.7
_SERIES_TERMS = 9
#: Beyond it the exponential characteristic goes on as its tangent.
_LARGEST_EXPONENT = 60.0
_BISECTIONS = 60
_NEWTON_STEPS = 12
_SMALLEST_CHANGE = 1e-15


def moments(durations: Array, rates: Array) -> Array:
    """Return decay and moments of each step: see :func:`loops.moments`."""
    y = durations[:, None] * rates
    half = 0.5 * y
    small, large = np.minimum(half, _SERIES_LIMIT), np.maximum(half, _SERIES_LIMIT)
    by_order = np.where(half < _SERIES_LIMIT, _series_moments(small), _closed_moments(large))
    return np.stack([np.exp(-y), *by_order], axis=1)


def _series_moments(z: Array) -> list[Array]:
    """Return M_0, M_1 and M_2 at y = 2 z: modified spherical Bessel functions, by their series."""
    decay = np.exp(-z)
    factors = 2.0 * decay, 2.0 * decay * z / 3.0, 2.0 * decay * z * z / 15.0
    result = []
    for order, factor in enumerate(factors):
        term, total = np.ones_like(z), np.ones_like(z)
        for j in range(1, _SERIES_TERMS):
            term = term * (0.5 * z * z) / (j * (2.0 * j + 2.0 * order + 1.0))
            total = total + term
        result.append(factor * total)
    return result


def _closed_moments(z: Array) -> list[Array]:
    """Return M_0, M_1 and M_2 at y = 2 z, by their closed form."""
    decay = np.exp(-2.0 * z)
    plus, minus = 1.0 + decay, 1.0 - decay
    return [
        minus / z,
        (plus - minus / z) / z,
        (minus * (1.0 + 3.0 / (z * z)) - 3.0 * plus / z) / z,
    ]


# What is not finite is found at the end of each step.
@np.errstate(over="ignore", invalid="ignore")
def respond(
    law: LawState,
    rates: Array,
    steps: tuple[Array, Array],
    compressions: Array,
    surface: Array | None,
    columns: Columns,
    state: ResponseState,
) -> Response:
    """Return the stress at every point with its derivatives: see :func:`loops.respond`."""
    durations, by_step = steps
    size = compressions.size
    free = np.zeros(size) if surface is None else surface
    given = _Given.of(columns, size)
    memory = _Memory.of(state)
    stress, elastic, slope = np.empty((3, size))
    jacobian = np.empty((size, columns.count))
    for n, compression in enumerate(compressions):
        if state.is_begun:
            start = _Start(memory.last, by_step[n], float(durations[n]))
            towards = partial(_next_step, law, rates, start, float(free[n]))
        else:
            state.values[:] = 0.0
            towards = partial(_first_step, law, float(free[n]))
        step, at, stress[n] = _settled(law, towards, float(compression), memory)
        if not np.isfinite([stress[n], at]).all():
            raise FloatingPointError("the response of the law is not finite")
        now = _elastic(law, np.array([at]))
        elastic[n], slope[n] = now.value[0], now.by_compression[0] * step.is_active
        jacobian[n] = _advance(memory, step, given, n, float(stress[n]))
        memory.last[:] = at, free[n], step.is_active, stress[n]
        state.is_begun = True
    return Response(stress, jacobian, elastic, slope)


@dataclass(frozen=True)
class _Given:
    """The derivatives that are asked for; zeros where a column has none.

    `motion` and `surface` have shape (columns, points), `weights` (columns, RATES + 2), and
    `of_law` is each column's row in :meth:`_Elastic.derivatives`.
    """

    is_by_compliance: Array
    of_law: Indices
    motion: Array
    surface: Array
    weights: Array

    @classmethod
    def of(cls, columns: Columns, points: int) -> _Given:
        rows = {BY_LOG_G: 1, BY_LOG_GN: 2}
        first_knot = BY_FIRST_KNOT
        motion, weights = np.zeros((columns.count, points)), np.zeros((columns.count, RATES + 2))
        motion[: columns.motions.shape[0]] = columns.motions
        has_weights = columns.weight_of >= 0
        weights[has_weights] = columns.weights[columns.weight_of[has_weights]]
        return cls(
            (columns.kinds == BY_COMPLIANCE).astype(float),
            np.array(
                [
                    3 + kind - first_knot if kind >= first_knot else rows.get(kind, 0)
                    for kind in columns.kinds.tolist()
                ],
                dtype=np.intp,
            ),
            motion,
            np.zeros_like(motion) if columns.surfaces is None else columns.surfaces,
            weights,
        )


@dataclass(frozen=True)
class _Memory:
    """What goes on from point to point; views of a :class:`ResponseState`.

    Row 0 is of the response itself, the others are of its derivatives.

    Attributes
    ----------
    kept : ndarray, shape (columns + 1, RATES)
        The exponentials.
    totals : ndarray, shape (columns + 1,)
        The elastic response in excess of the free surface.
    moved, lifted : ndarray, shape (columns + 1,)
        Derivatives of the compression and of the free surface; 0 in row 0.
    last : ndarray, shape (4,)
        Compression, free surface, whether the law is active, stress.
    """

    kept: Array
    totals: Array
    moved: Array
    lifted: Array
    last: Array

    @classmethod
    def of(cls, state: ResponseState) -> _Memory:
        kept, others, last = np.split(state.values, [(state.columns + 1) * RATES, -4])
        totals, moved, lifted = others.reshape(3, -1)
        return cls(kept.reshape(-1, RATES), totals, moved, lifted, last)


@dataclass(frozen=True)
class _Elastic:
    """The elastic response at compressions of shape (n,), with its derivatives.

    `of_knots`, shape (n, knots), are the weights of the knots of the characteristic's error.
    """

    value: Array
    by_compression: Array
    by_log_gn: Array
    of_knots: Array

    def derivatives(self) -> Array:
        """Return those by nothing, ln G, ln Gn and each knot, shape (3 + knots, n)."""
        by_knots = self.value * self.of_knots.T
        return np.vstack([np.zeros_like(self.value), self.value, self.by_log_gn, by_knots])


def _elastic(law: LawState, compression: Array) -> _Elastic:
    """Return the law's elastic response; pulled, a one-sided law has none."""
    size = np.abs(compression)
    strain = size**law.exponent
    by_size = law.exponent * size ** (law.exponent - 1.0)
    scaled = law.nonlinear_stiffness * strain
    beyond = np.clip(scaled - 1.0, 0.0, _LARGEST_EXPONENT)
    growth = np.exp(beyond)
    ratio = growth * (scaled - beyond)
    bend, tilt, of_knots = _bend(law, strain)
    unit = law.linear_stiffness / law.nonlinear_stiffness * np.exp(bend)
    if law.is_one_sided:
        unit = np.where(compression < 0.0, 0.0, unit)
    signed = np.where(compression < 0.0, -unit, unit)
    return _Elastic(
        value=signed * ratio,
        by_compression=unit * (law.nonlinear_stiffness * growth + tilt * ratio) * by_size,
        by_log_gn=signed * (scaled * growth - ratio),
        of_knots=of_knots,
    )


def _bend(law: LawState, strain: Array) -> tuple[Array, Array, Array]:
    """Return the characteristic's error, its slope, and the weights of its knots.

    It is a quadratic spline, evenly spaced in ln(1 + strain / (last_knot / 10)), and constant
    beyond the last knot.
    """
    weights = np.zeros((strain.size, law.bend.size))
    cells = law.bend.size - 2
    if cells < 1:
        return np.zeros_like(strain), np.zeros_like(strain), weights
    near = 0.1 * law.last_knot
    per_place = cells / np.log(11.0)
    place = per_place * np.log1p(strain / near)
    is_inside = place < cells
    cell = np.where(is_inside, place, cells - 1).astype(np.intp)
    part = np.where(is_inside, place - cell, 1.0)
    three = cell[:, None] + np.arange(3)
    of_three = [0.5 * (1.0 - part) ** 2, 0.5 + part * (1.0 - part), 0.5 * part**2]
    by_part = np.transpose([part - 1.0, 1.0 - 2.0 * part, part])
    weights[np.arange(strain.size)[:, None], three] = np.transpose(of_three)
    tilt = np.where(is_inside, per_place / (near + strain), 0.0)
    return weights @ law.bend, tilt * (by_part * law.bend[three]).sum(axis=1), weights


@dataclass(frozen=True)
class _Step:
    """One step to a compression at its end.

    Attributes
    ----------
    law : LawState
    is_active : bool
        Whether the probe presses on the tissue at the end.
    decay : ndarray, shape (RATES,)
        Of the exponentials.
    parts : ndarray, shape (NODES,)
        Where in the step the nodes are: 0 at its beginning, 1 at its end.
    nodes : _Elastic
        The elastic response at the nodes.
    excess : ndarray, shape (NODES,)
        psi at the nodes.
    reach : ndarray, shape (RATES, NODES)
        What psi at the nodes adds to the exponentials.
    total : ndarray, shape (NODES,)
        psi at the end, from psi at the nodes: the last, or nothing.
    per_second : ndarray, shape (NODES,)
        The rate of psi at the end, from psi at the nodes [1/s].
    """

    law: LawState
    is_active: bool
    decay: Array
    parts: Array
    nodes: _Elastic
    excess: Array
    reach: Array
    total: Array
    per_second: Array

    @cached_property
    def weighs(self) -> Array:
        """What psi at the nodes adds to the stress, shape (NODES,)."""
        weights, (slow, fast) = self.law.weights[:RATES], self.law.weights[RATES:]
        return weights @ self.reach + slow * self.total + fast * self.per_second

    @cached_property
    def by_end(self) -> Array:
        """The derivative of psi at the nodes by the compression at the end, shape (NODES,)."""
        return self.nodes.by_compression * self.parts

    @cached_property
    def softening(self) -> float:
        """What the compression at the end moves by where the target moves by 1, inverted."""
        return 1.0 + self.law.compliance * float(self.weighs @ self.by_end)


@dataclass(frozen=True)
class _Start:
    """Where a step begins, and what is known of it: `last` of the memory, moments, duration."""

    last: Array
    moments: Array
    duration: float


def _first_step(law: LawState, surface: float, compression: float) -> _Step:
    """Return the step onto the first point: a record that begins in contact begins with a jump."""
    nodes = _elastic(law, np.full(_PLACES.size, compression))
    is_active = _is_active(law, compression, surface)
    jump = np.array([0.0, 0.0, 0.0, float(is_active)])
    return _Step(
        law=law,
        is_active=is_active,
        decay=np.ones(RATES),
        parts=np.ones(_PLACES.size),
        nodes=nodes,
        excess=nodes.value - surface,
        reach=np.tile(jump, (RATES, 1)),
        total=jump,
        per_second=np.zeros(_PLACES.size),
    )


def _next_step(
    law: LawState, rates: Array, start: _Start, surface: float, compression: float
) -> _Step:
    """Return the step from the last point to one with a given free surface."""
    was_active, is_active = bool(start.last[2]), _is_active(law, compression, surface)
    crosses = was_active != is_active
    motion = float(start.last[0]), compression
    free = float(start.last[1]), surface
    crossing = _crossing(law, motion, free, is_active) if crosses else 0.0
    begin = crossing if is_active else 0.0
    end = 1.0 if is_active or not crosses else crossing
    parts = begin + _PLACES * (end - begin)
    at = motion[0] + parts * (motion[1] - motion[0])
    # At touch and release rounding must not take the slope away.
    nodes = _elastic(law, np.maximum(at, 0.0) if crosses else at)
    excess = nodes.value - (free[0] + parts * (free[1] - free[0]))
    if crosses:
        excess[0 if is_active else -1] = 0.0
    if was_active or is_active:
        reach = _reach(rates, start, (begin, end), was_active, is_active)
    else:
        reach = np.zeros((RATES, _PLACES.size))
    active = (end - begin) * start.duration
    has_rate = is_active and active > 0.0
    return _Step(
        law=law,
        is_active=is_active,
        decay=start.moments[0],
        parts=parts,
        nodes=nodes,
        excess=excess,
        reach=reach,
        total=np.array([0.0, 0.0, 0.0, float(is_active)]),
        per_second=2.0 / active * _SLOPES.sum(axis=0) if has_rate else np.zeros(_PLACES.size),
    )


def _reach(
    rates: Array,
    start: _Start,
    active: tuple[float, float],
    was_active: bool,
    is_active: bool,
) -> Array:
    """Return what psi at the nodes of a step's active part adds to the exponentials.

    Before a touch and after a release psi is 0: a derivative that is not jumps there.
    """
    if was_active and is_active:
        return start.moments[1:].T @ _SLOPES
    begin, end = active
    from_begin = np.exp(-rates * ((1.0 - begin) * start.duration))
    from_end = np.exp(-rates * ((1.0 - end) * start.duration))
    own = moments(np.array([(end - begin) * start.duration]), rates)[0, 1:]
    result: Array = (own * from_end).T @ _SLOPES
    if is_active:
        result[:, 0] += from_begin
    else:
        result[:, -1] -= from_end
    return result


def _is_active(law: LawState, compression: float, surface: float) -> bool:
    """Whether the probe presses on the tissue; also where that is not a number."""
    if not law.is_one_sided:
        return True
    value = float(_elastic(law, np.array([compression])).value[0])
    return compression > 0.0 and not value <= surface


def _crossing(
    law: LawState, motion: tuple[float, float], free: tuple[float, float], rises: bool
) -> float:
    """Return where in a step the elastic response begins or ceases to exceed the free surface."""
    if free == (0.0, 0.0):
        return min(max(-motion[0] / (motion[1] - motion[0]), 0.0), 1.0)
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        at = 0.5 * (low + high)
        compression = motion[0] + at * (motion[1] - motion[0])
        value = float(_elastic(law, np.array([compression])).value[0])
        if (value > free[0] + at * (free[1] - free[0])) == rises:
            high = at
        else:
            low = at
    return 0.5 * (low + high)


def _settled(
    law: LawState, towards: Callable[[float], _Step], target: float, memory: _Memory
) -> tuple[_Step, float, float]:
    """Return the step to a target less what the stress takes off, its end and the stress there.

    By Newton's method where there is a compliance.
    """
    at = target - law.compliance * float(memory.last[3])
    for _ in range(_NEWTON_STEPS):
        step = towards(at)
        left = law.weights[:RATES] @ (step.decay * memory.kept[0])
        stress = float(left + step.weighs @ step.excess)
        change = (at - target + law.compliance * stress) / step.softening
        at -= change
        if abs(change) < _SMALLEST_CHANGE:
            break
    return step, at, stress


def _advance(memory: _Memory, step: _Step, columns: _Given, n: int, stress: float) -> Array:
    """Bring the memory to the end of a step; return the derivatives of the stress there."""
    weights, compliance = step.law.weights[:RATES], step.law.compliance
    memory.kept[:] *= step.decay
    memory.kept[0] += step.reach @ step.excess
    memory.totals[0] = step.total @ step.excess
    moved = columns.motion[:, n] - columns.is_by_compliance * stress
    lifted = columns.surface[:, n]
    psi = step.nodes.derivatives()[columns.of_law]
    psi += step.nodes.by_compression * _between(memory.moved[1:], moved, step.parts)
    psi -= _between(memory.lifted[1:], lifted, step.parts)
    own = np.array([*memory.kept[0], memory.totals[0], step.per_second @ step.excess])
    derivatives = memory.kept[1:] @ weights + psi @ step.weighs + columns.weights @ own
    # The stress takes off from the compression, and with it from itself.
    derivatives /= step.softening
    psi -= np.outer(compliance * derivatives, step.by_end)
    memory.kept[1:] += psi @ step.reach.T
    memory.totals[1:] = psi @ step.total
    memory.moved[1:] = moved - compliance * derivatives
    memory.lifted[1:] = lifted
    return derivatives


def _between(before: Array, after: Array, parts: Array) -> Array:
    """Return what goes linearly from (columns,) to (columns,), at parts: (columns, NODES)."""
    result: Array = before[:, None] + np.outer(after - before, parts)
    return result


def clock(loaded: Array, seconds: Array, floor: float, state: Array) -> Array:
    """Return how far loading and its age go in each block: see :func:`loops.clock`."""
    ages = np.empty_like(loaded)
    before = state.copy()
    for n, (now, step) in enumerate(zip(loaded.tolist(), seconds.tolist(), strict=True)):
        last, age = state
        ages[n] = max((age + step) * min(last / now, 1.0), 0.5 * step)
        state[:] = now, ages[n]
    grown = np.diff(np.log(loaded), prepend=np.log(before[0]))
    aged = np.diff(np.log(ages + floor), prepend=np.log(before[1] + floor))
    result: Array = np.abs(grown) + np.abs(aged)
    return result


def whiten(
    rows: Array, noise: Array, gain: Array, walks: tuple[Array, Array], state: WalkState
) -> float:
    """Whiten rows in place by a Kalman filter: see :func:`loops.whiten`."""
    stress, both, surface = state.covariance
    log_determinant = 0.0
    for n, h in enumerate(gain):
        stress += walks[0][n]
        surface += walks[1][n]
        # P h, for h = (1, gain).
        by_stress, by_surface = stress + h * both, both + h * surface
        variance = by_stress + h * by_surface + noise[n]
        innovation = rows[n] - state.means[0] - h * state.means[1]
        state.means += np.outer((by_stress / variance, by_surface / variance), innovation)
        rows[n] = innovation / np.sqrt(variance)
        stress -= by_stress**2 / variance
        both -= by_stress * by_surface / variance
        surface -= by_surface**2 / variance
        log_determinant += float(np.log(variance))
    state.covariance[:] = stress, both, surface
    return log_determinant


def eliminate(systems: Array) -> None:
    """Turn each [A, B] into [U, U^-T B] in place: see :func:`loops.eliminate`."""
    n = systems.shape[1]
    factors = np.linalg.cholesky(systems[:, :, :n])
    systems[:, :, n:] = np.linalg.solve(factors, systems[:, :, n:])
    systems[:, :, :n] = factors.transpose(0, 2, 1)
