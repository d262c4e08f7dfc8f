# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""What is not known of a press: one object an unknown, with its prior, lifetime and column.

The stress of a press is

.. math::
    f(t) = \int E(t-s)\,d\max(\psi(u(s)) - F(s), 0) + \text{stresses} + w(t) + v, \qquad
    u = d/L - o + \tau \dot d/L - C f,

with :math:`E = t^{-\alpha}/\Gamma(1-\alpha)\; e^{\delta(\ln t)}`, :math:`\psi = \varphi\,
e^{\epsilon(x)}` and F the free surface that earlier presses have left. To add an unknown, add an
:class:`Unknown` to :func:`unknowns_of`: a column of compressions or of stresses per standard
deviation. What changes with time is a process of :mod:`fden_ros.core.estimation.error_model`.
"""

from __future__ import annotations

import enum
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.loops import BY_COMPLIANCE, BY_LOG_G, BY_LOG_GN, NEAR
from fden_ros.core.estimation.record import Points
from fden_ros.core.law import (
    HIGHEST_ORDER,
    LOWEST_ORDER,
    RATES,
    Geometry,
    left_after,
    phi,
    relaxation_weights,
)

#: Delays with a wider prior than this shift the motion by interpolation [s]: a block. The column
#: delay * speed is wrong where the speed jumps: by 50 ms G is five deviations off.
LINEAR_DELAY = 0.01
#: Speed at which friction has half its full square [m/s]: slower is a hold.
FRICTION_SPEED = 5e-4


class Lifetime(enum.Enum):
    """For how long an unknown is one and the same."""

    CONTACT = enum.auto()
    SITE = enum.auto()
    RIG = enum.auto()


@dataclass(frozen=True)
class Unknown:
    """One number that is not known."""

    name: str
    #: Its prior. An unknown counts in standard deviations, except for the law's own parameters.
    mean: float
    sd: float
    lifetime: Lifetime
    kind: int = 0  #: what of the law it is, one of the ``BY_...`` of the loops
    #: Points to the change of their compressions by one standard deviation, (n,).
    motion: Callable[[Points], Array] | None = None
    #: Points to the stress at their blocks by one standard deviation, (m,) [Pa].
    stress: Callable[[Points], Array] | None = None
    #: It is a change of the stiffness at this time [s], relative to the first stiffness.
    since: float | None = None
    #: It may be exactly 0: the logarithm of these odds [1]; None: it is not.
    log_odds_of_zero: float | None = None
    #: By what one standard deviation of it changes (ln G, ln Gn, alpha) since the last press [1].
    of_law: tuple[float, float, float] | None = None
    #: It is a delay that shifts the motion by interpolation, about a touch at this speed [1/s].
    touch_speed: float | None = None

    @property
    def unit(self) -> float:
        """The prior's standard deviation in the unknown's unit."""
        return self.sd if self.name in LAW else 1.0


#: The law's parameters, in the order of a state.
LAW = ("log_g", "log_gn", "order")
#: The first places of a state.
LOG_G, LOG_GN, ORDER, ORIGIN = range(4)


def order_of(state: Array) -> float:
    """Return the order of a state, in the range for which the relaxation is known [1]."""
    return float(np.clip(state[ORDER], LOWEST_ORDER, HIGHEST_ORDER))


# The law's errors: knots, and how they are correlated.

#: Knots of the kernel's error delta: one a decade of ln t [ln s].
KERNEL_KNOTS: Array = math.log(10.0) * np.arange(-4.0, 7.0)
#: Correlation length of the kernel's error in ln t: two decades, by the evidence of measured beef.
KERNEL_LENGTH = 2.0 * math.log(10.0)
#: Knots of the characteristic's error epsilon [1]; fewer predict holds of beef worse.
CHARACTERISTIC_KNOTS = 22
#: Correlation length of the characteristic's error in ln phi [1].
CHARACTERISTIC_LENGTH = 2.0
#: Strain below which ln phi counts as if there was no motion [1]; at this compression half of the
#: friction acts: with 0.01 friction six times its deviation was taken for motion of the surface in
#: 3 of 15 presses, unflagged; with 0.001 it is no better.
STRAIN_FLOOR = 3e-3
#: By definition the law's error is 0 at this strain [1], and after this time [s]: there G and Gn
#: are those of the tissue. The sum of the relaxation is that of its order, up to this one [1]:
#: beyond, holds of beef were predicted to 0.61 % of the peak in place of 0.52 %.
REFERENCE_STRAIN, REFERENCE_TIME, MOST_REFERENCE_ORDER = 0.1, 1.0, 0.3
#: What is left of the variance of an error where it is 0 by definition [1].
_CONSTRAINED = 1e-6
#: The last knot of strain [1] is the least of 0.02 * 1.25^k above the largest strain.
_LEAST_RANGE, _RANGE_RATIO, _RANGE_MARGIN = 0.02, 1.25, 1.05


def hats(places: Array, knots: Array) -> Array:
    """Return the hat functions of evenly spaced knots at places, shape (places, knots)."""
    at = np.clip((places - knots[0]) / (knots[1] - knots[0]), 0.0, knots.size - 1.0)
    result: Array = np.maximum(1.0 - np.abs(at[:, None] - np.arange(knots.size)), 0.0)
    return result


#: Weight of each knot of the kernel's error at each rate, then at slower and faster ones.
KERNEL_HATS = hats(-np.log(np.concatenate([RATES, RATES[[0, -1]]])), KERNEL_KNOTS)


def strain_range(largest: float) -> float:
    """Return the strain of the last knot for a largest strain [1]."""
    ratio = max(largest * _RANGE_MARGIN, _LEAST_RANGE) / _LEAST_RANGE
    return _LEAST_RANGE * _RANGE_RATIO ** math.ceil(math.log(ratio) / math.log(_RANGE_RATIO))


def characteristic_knots(last: float) -> Array:
    """Return the strains about which the splines of the characteristic's error lie [1]."""
    cells = CHARACTERISTIC_KNOTS - 2
    middles = np.clip((np.arange(CHARACTERISTIC_KNOTS) - 0.5) / cells, 0.0, 1.0)
    result: Array = NEAR * last * np.expm1(middles * math.log1p(1.0 / NEAR))
    return result


class LocalSplines(NamedTuple):
    """The three splines of the characteristic that are not 0 at each of n strains."""

    cell: NDArray[np.intp]  #: place of the first of them, (n,)
    values: Array  #: shape (n, 3)
    slopes: Array  #: by the strain, shape (n, 3)
    curvatures: Array  #: second derivatives by the strain, shape (n, 3)


def local_splines(strain: Array, last_knot: float, knots: int) -> LocalSplines:
    """Return the characteristic's splines at strains from 0 on, of shape (n,).

    They are quadratic, evenly spaced in ln(1 + x / x0), and straight beyond the last knot, where a
    kink would hold a solution up: so they can follow the law's own bend at 1/Gn. With hat
    functions ln Gn has false maxima 0.15 apart.
    """
    near, cells = NEAR * last_knot, knots - 2
    per_place = cells / np.log1p(1.0 / NEAR)
    place = per_place * np.log1p(strain / near)
    is_inside = place < cells
    cell = np.where(is_inside, place, cells - 1).astype(np.intp)
    p = place - cell
    curved = 0.5 * (1.0 - p) ** 2, 0.5 + p * (1.0 - p), 0.5 * p**2
    straight = np.zeros_like(p), 1.5 - p, p - 0.5
    values = np.where(is_inside, curved, straight).T
    tilt, q = per_place / (near + strain), np.where(is_inside, p, 1.0)
    by_place = np.array([q - 1.0, 1.0 - 2.0 * q, q])
    bent = np.multiply.outer([1.0, -2.0, 1.0], is_inside * tilt**2)
    curvatures = bent - by_place * (tilt / (near + strain))
    return LocalSplines(cell, values, (tilt * by_place).T, curvatures.T)


def splines(strain: Array, last_knot: float, knots: int) -> tuple[Array, Array]:
    """Return the values of all splines of :func:`local_splines`, and their slopes.

    Each of shape (strains, knots).
    """
    values, slopes = np.zeros((strain.size, knots)), np.zeros((strain.size, knots))
    if knots:
        found = local_splines(strain, last_knot, knots)
        at = np.arange(strain.size)[:, None], found.cell[:, None] + np.arange(3)
        values[at], slopes[at] = found.values, found.slopes
    return values, slopes


@dataclass(frozen=True)
class FieldPrior:
    """Prior of an error at its knots, at a standard deviation of 1."""

    precision: Array
    log_determinant: float


def _constrained(places: Array, length: float, zero: Array) -> FieldPrior:
    """Return the prior of values at rising places, of which `zero @ values` is 0 by definition.

    They are correlated as exp(-distance / length), whose inverse has three diagonals; that of
    a covariance less part of what the sum shares in follows from the sum's variance alone.
    """
    apart = np.diff(places) / length
    own, beside = -np.expm1(-2.0 * apart), np.exp(-apart)
    # The few places that the sum has: their covariance.
    some = np.flatnonzero(zero)
    at = places[some] / length
    variance = float(zero[some] @ np.exp(-np.abs(at[:, None] - at)) @ zero[some])
    precision = (1.0 - _CONSTRAINED) / (_CONSTRAINED * variance) * np.outer(zero, zero)
    diagonals = precision.reshape(-1)
    step = places.size + 1
    diagonals[1::step] -= beside / own
    diagonals[places.size :: step] -= beside / own
    main = diagonals[::step]
    main[0] += 1.0
    main[1:] += 1.0 / own
    main[:-1] += beside**2 / own
    determinant = -math.log(_CONSTRAINED) - float(np.log(own).sum())
    return FieldPrior(precision, determinant)


@functools.lru_cache(maxsize=16)
def kernel_prior(order: float) -> FieldPrior:
    """Return the prior of the kernel's error; the relaxation after 1 s is the law's.

    Of a body that hardly relaxes that is all but the slowest rate's part: with the sum of another
    order its level was left open, and G of an elastic body to a quarter.
    """
    weights = relaxation_weights(min(order, MOST_REFERENCE_ORDER))
    zero = (weights * left_after(REFERENCE_TIME)) @ KERNEL_HATS
    return _constrained(KERNEL_KNOTS, KERNEL_LENGTH, zero / zero.sum())


@functools.lru_cache(maxsize=16)
def characteristic_prior(nonlinear_stiffness: float, last: float) -> FieldPrior:
    """Return the prior of the characteristic's error; at the strain 0.1 it is 0."""
    knots, zero = _characteristic(last)
    place = np.log(phi(knots, 1.0, nonlinear_stiffness) + STRAIN_FLOOR)
    return _constrained(place, CHARACTERISTIC_LENGTH, zero)


@functools.lru_cache(maxsize=16)
def _characteristic(last: float) -> tuple[Array, Array]:
    """Return the knots of the characteristic's error, and their weights at the strain 0.1."""
    zero, _ = splines(np.array([REFERENCE_STRAIN]), last, CHARACTERISTIC_KNOTS)
    return characteristic_knots(last), zero[0]


def change_since(time: float) -> Unknown:
    """Return a change of the tissue's stiffness at a time [s]: by a factor of 2, more or less."""
    return Unknown(f"change_{time!r}", 0.0, 1.0, Lifetime.CONTACT, since=time)


def jerk_at(time: float, size: float) -> Unknown:
    """Return a stress [Pa] of one block alone, at a time [s], as a drive's jerk makes it."""
    stress = partial(_jerk, time, size)
    return Unknown(f"jerk_{time!r}", 0.0, 1.0, Lifetime.CONTACT, stress=stress)


# Columns: the change by one standard deviation.


def _shift(size: float, points: Points) -> Array:
    return np.full(points.times.size, size)


def _late(delay: float, touch_speed: float, points: Points) -> Array:
    rates = points.speeds if points.rates is None else points.rates
    result: Array = delay * (rates - touch_speed)
    return result


def _friction(stress: float, length: float, points: Points) -> Array:
    speed = length * points.mean(points.speeds)
    # In the air there is none, or it is in the zero.
    pressed = np.maximum(points.mean(points.compressions), 0.0)
    in_contact = pressed**2 / (pressed**2 + STRAIN_FLOOR**2)
    result: Array = stress * in_contact * speed / np.hypot(speed, FRICTION_SPEED)
    return result


def _drift(slope: float, points: Points) -> Array:
    result: Array = slope * (points.middles - points.times[0])
    return result


def _jerk(time: float, size: float, points: Points) -> Array:
    is_there = np.abs(points.middles - time) <= 0.5 * points.durations
    return np.where(is_there, size, 0.0)


def _delay(sd: float, touch_speed: float) -> Unknown:
    if sd <= LINEAR_DELAY:
        return Unknown("delay", 0.0, sd, Lifetime.RIG, motion=partial(_late, sd, 0.0))
    late = partial(_late, sd, touch_speed)
    return Unknown("delay", 0.0, sd, Lifetime.RIG, motion=late, touch_speed=touch_speed)


def unknowns_of(
    config: EstimatorConfig,
    geometry: Geometry,
    origin_sd: float,
    drift_sd: float,
    touch_speed: float = 0.0,
) -> tuple[Unknown, ...]:
    """Return the unknowns of a press but for the law's errors.

    Parameters
    ----------
    config : EstimatorConfig
    geometry : Geometry
    origin_sd : float
        Standard deviation of the strain origin, as compression [1]; 0: known.
    drift_sd : float
        Of the slope of the force's zero, as stress [Pa/s].
    touch_speed : float
        Of the compression at the touch [1/s]. Where the delay may be long it is the touch that is
        seen, so the origin counts from where the displacement seems to be then.
    """
    prior, unsure = config.prior, config.uncertainty
    length, per_force = geometry.length, geometry.stress_per_force
    order_sd = prior.fractional_order_sd if config.learns_fractional_order else 0.0
    site, rig = Lifetime.SITE, Lifetime.RIG

    found = (
        Unknown("log_g", prior.mean[0], prior.linear_stiffness_log_sd, site, BY_LOG_G),
        Unknown("log_gn", prior.mean[1], prior.nonlinear_stiffness_log_sd, site, BY_LOG_GN),
        Unknown("order", prior.fractional_order, order_sd, site),
        Unknown("origin", 0.0, origin_sd, site, motion=partial(_shift, -origin_sd)),
        Unknown("compliance", 0.0, unsure.compliance_sd, rig, BY_COMPLIANCE),
        _delay(unsure.delay_sd, touch_speed),
        Unknown(
            "friction",
            config.friction / unsure.friction_sd if unsure.friction_sd else 0.0,
            unsure.friction_sd,
            rig,
            stress=partial(_friction, per_force * unsure.friction_sd, length),
        ),
        Unknown(
            "drift",
            0.0,
            drift_sd,
            Lifetime.CONTACT,
            stress=partial(_drift, drift_sd),
        ),
    )
    # The first four are always there, so that they have a place; what has no prior is known.
    return tuple(u for k, u in enumerate(found) if k <= ORIGIN or u.sd > 0.0)
