# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The smooth errors of the law: their knots, their splines, and how they are correlated.

Delta is that of the relaxation kernel over ln t, epsilon that of the characteristic over strain.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array, Indices
from fden_ros.core.law import RATES, left_after, phi, relaxation_weights

#: Knots of the kernel's error delta: one a decade of ln t [ln s].
KERNEL_KNOTS: Array = math.log(10.0) * np.arange(-4.0, 7.0)
#: Correlation length of the kernel's error in ln t: two decades, by the evidence of measured beef.
KERNEL_LENGTH = 2.0 * math.log(10.0)
#: Knots of the characteristic's error epsilon [1]; fewer predict holds of beef worse.
CHARACTERISTIC_KNOTS = 22
#: Strain about which the splines of the characteristic's error become wider, over that of their
#: last knot [1]; in `compiled/response.c` too.
NEAR = 0.1
#: Strain below which ln phi counts as if there was no motion [1]; at this compression half of the
#: friction acts: with 0.01 friction six times its deviation was taken for motion of the surface in
#: 3 of 15 presses, unflagged; with 0.001 it is no better.
STRAIN_FLOOR = 3e-3
#: By definition the law's errors are 0 at this strain [1] and after 1 s: there G and Gn are those
#: of the tissue.
REFERENCE_STRAIN = 0.1


def hats(places: Array, knots: Array) -> Array:
    """Return the hat functions of evenly spaced knots at places, shape (places, knots)."""
    at = np.clip((places - knots[0]) / (knots[1] - knots[0]), 0.0, knots.size - 1.0)
    return np.maximum(1.0 - np.abs(at[:, None] - np.arange(knots.size)), 0.0)


#: Weight of each knot of the kernel's error at each rate, then at slower and faster ones.
KERNEL_HATS = hats(-np.log(np.concatenate([RATES, RATES[[0, -1]]])), KERNEL_KNOTS)


def strain_range(largest: float) -> float:
    """Return the strain of the last knot [1]: the least of 0.02 * 1.25^k above a largest one."""
    ratio = max(largest * 1.05, 0.02) / 0.02
    return 0.02 * 1.25 ** math.ceil(math.log(ratio) / math.log(1.25))


class LocalSplines(NamedTuple):
    """The three splines of the characteristic that are not 0 at each of n strains."""

    cell: Indices  #: place of the first of them, (n,)
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
    left = 1e-6  # of the variance of an error where it is 0 by definition
    precision = (1.0 - left) / (left * variance) * np.outer(zero, zero)
    diagonals = precision.reshape(-1)
    step = places.size + 1
    diagonals[1::step] -= beside / own
    diagonals[places.size :: step] -= beside / own
    main = diagonals[::step]
    main[0] += 1.0
    main[1:] += 1.0 / own
    main[:-1] += beside**2 / own
    determinant = -math.log(left) - float(np.log(own).sum())
    return FieldPrior(precision, determinant)


@functools.lru_cache(maxsize=16)
def kernel_prior(order: float) -> FieldPrior:
    """Return the prior of the kernel's error; the relaxation after 1 s is the law's.

    Of a body that hardly relaxes that is all but the slowest rate's part: with the sum of another
    order its level was left open, and G of an elastic body to a quarter.
    """
    # Up to an order of 0.3: beyond, holds of beef were predicted to 0.61 % of the peak in place of
    # 0.52 %.
    weights = relaxation_weights(min(order, 0.3))
    zero = (weights * left_after(1.0)) @ KERNEL_HATS
    return _constrained(KERNEL_KNOTS, KERNEL_LENGTH, zero / zero.sum())


@functools.lru_cache(maxsize=16)
def characteristic_prior(nonlinear_stiffness: float, last: float) -> FieldPrior:
    """Return the prior of the characteristic's error; at the strain 0.1 it is 0."""
    knots, zero = _characteristic(last)
    place = np.log(phi(knots, 1.0, nonlinear_stiffness) + STRAIN_FLOOR)
    # Its correlation length in ln phi is 2.
    return _constrained(place, 2.0, zero)


@functools.lru_cache(maxsize=16)
def _characteristic(last: float) -> tuple[Array, Array]:
    """Return the strains about which the characteristic's splines lie, and these at 0.1 [1]."""
    middles = (np.arange(CHARACTERISTIC_KNOTS) - 0.5) / (CHARACTERISTIC_KNOTS - 2)
    knots = NEAR * last * np.expm1(np.clip(middles, 0.0, 1.0) * math.log1p(1.0 / NEAR))
    zero, _ = splines(np.array([REFERENCE_STRAIN]), last, CHARACTERISTIC_KNOTS)
    return knots, zero[0]


def kernel_change(kernel_sd: float, way: float) -> float:
    """Return the variance by which the kernel's error changes over a way of ln t [1].

    `kernel_sd`: the relative deviation of the kernel [1].
    """
    return 2.0 * kernel_sd**2 * -math.expm1(-way / KERNEL_LENGTH)
