# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The response of the law in numpy: the oracle of the compiled one.

The equations are those of :mod:`fden_ros.core.estimation.loops`. Here one step is one linear map:
psi at the four nodes of its active part goes into the exponentials by `reach`, shape (RATES,
NODES), and into the stress by `weighs`, shape (NODES,). What the compiled loops do in another
order differs by rounding alone. Derivatives are held against differences in place of these.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy.special import ive

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.loops import LawState
from fden_ros.core.estimation.smooth_errors import splines
from fden_ros.core.law import MAX_EXPONENT
from fden_ros.core.law import RATE_COUNT as RATES
from fden_ros.core.law import RATES as RATE_VALUES

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
#: Newton's method ends after so many steps [1], or with a change of the compression below this.
_NEWTON_STEPS, _SMALLEST_CHANGE = 12, 1e-15


def moments(durations: Array, rates: Array) -> Array:
    """Return decay and moments of each step: see :func:`loops.moments`."""
    y = durations[:, None] * rates
    z = 0.5 * y
    # Modified spherical Bessel functions. From 1e9 on, where scipy has none, nothing is left.
    with np.errstate(divide="ignore", invalid="ignore"):
        by_order = np.nan_to_num(
            [ive(order + 0.5, z) * np.sqrt(2.0 * np.pi / z) for order in range(3)]
        )
    by_order[0][z == 0.0] = 2.0
    return np.stack([np.exp(-y), *by_order], axis=1)


def respond(law: LawState, durations: Array, compressions: Array, free: Array) -> Array:
    """Return stress, elastic response and its slope at every point, shape (3, points)."""
    by_step = moments(durations, RATE_VALUES)
    kept, last = np.zeros(RATES), _Last(0.0, 0.0, False, 0.0)
    found = np.empty((3, compressions.size))
    for n, target in enumerate(compressions.tolist()):
        if n:
            start = _Start(last, by_step[n], float(durations[n]))
            towards = partial(_next_step, law, RATE_VALUES, start, float(free[n]))
        else:
            towards = partial(_first_step, law, float(free[n]))
        # The stress takes off from the compression: by Newton's method.
        at = target - law.compliance * last.stress
        for _ in range(_NEWTON_STEPS):
            step = towards(at)
            left = law.weights[:RATES] @ (step.decay * kept)
            stress = float(left + step.weighs @ step.excess)
            change = (at - target + law.compliance * stress) / step.softening
            at -= change
            if abs(change) < _SMALLEST_CHANGE:
                break
        kept = step.decay * kept + step.reach @ step.excess
        now = _elastic(law, np.array([at]))
        found[:, n] = stress, now.value[0], now.by_compression[0] * step.is_active
        last = _Last(at, float(free[n]), step.is_active, stress)
    return found


class _Last(NamedTuple):
    """The point before."""

    compression: float
    free: float  #: the free surface
    is_active: bool
    stress: float


class _Elastic(NamedTuple):
    """The elastic response at compressions, and its derivative by them, shape (n,)."""

    value: Array
    by_compression: Array


def _elastic(law: LawState, compression: Array) -> _Elastic:
    """Return the law's elastic response; pulled, a one-sided law has none."""
    size = np.abs(compression)
    powers = law.exponent + 0.5 * np.arange(len(law.series) + 1)
    terms = np.array([1.0, *law.series])
    strain = size[:, None] ** powers @ terms
    by_size = size[:, None] ** (powers - 1.0) @ (powers * terms)
    scaled = law.nonlinear_stiffness * strain
    beyond = np.clip(scaled - 1.0, 0.0, MAX_EXPONENT)
    growth = np.exp(beyond)
    ratio = growth * (scaled - beyond)
    of_knots, slopes = splines(strain, law.last_knot, law.bend.size)
    tilt = slopes @ law.bend
    unit = law.linear_stiffness / law.nonlinear_stiffness * np.exp(of_knots @ law.bend)
    if law.is_one_sided:
        unit = np.where(compression < 0.0, 0.0, unit)
    signed = np.where(compression < 0.0, -unit, unit)
    slope = unit * (law.nonlinear_stiffness * growth + tilt * ratio) * by_size
    return _Elastic(signed * ratio, slope)


@dataclass(frozen=True)
class _Step:
    """One step to a compression at its end."""

    law: LawState
    is_active: bool  #: the probe presses on the tissue at the end
    decay: Array  #: of the exponentials, (RATES,)
    parts: Array  #: where the nodes are, from 0 at the beginning to 1 at the end, (NODES,)
    nodes: _Elastic  #: the elastic response there
    excess: Array  #: psi there, (NODES,)
    reach: Array  #: what psi there adds to the exponentials, (RATES, NODES)
    total: Array  #: psi at the end from psi there: the last, or nothing, (NODES,)
    per_second: Array  #: the rate of psi at the end from psi there [1/s], (NODES,)

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


class _Start(NamedTuple):
    """Where a step begins, and what is known of it."""

    last: _Last
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
    was_active, is_active = start.last.is_active, _is_active(law, compression, surface)
    crosses = was_active != is_active
    motion = start.last.compression, compression
    free = start.last.free, surface
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
    while low < (at := 0.5 * (low + high)) < high:
        compression = motion[0] + at * (motion[1] - motion[0])
        value = float(_elastic(law, np.array([compression])).value[0])
        if (value > free[0] + at * (free[1] - free[0])) == rises:
            high = at
        else:
            low = at
    return at


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
