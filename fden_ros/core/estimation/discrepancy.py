# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The law's own errors: smooth functions at knots, zero by definition where G and Gn are defined.

Delta is the relative error of the relaxation over ln t, epsilon that of the stress-strain curve
over the strain. A state holds epsilon at its knots, delta at its knots, then the rig's nuisances.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from fden_ros.core.arrays import Array, Indices
from fden_ros.core.law import RATES, left_after, phi, relaxation_weights

#: Knots of epsilon [1], and of delta: one a decade of ln t [ln s].
CURVE_KNOTS = 22
KERNEL_KNOTS: Array = math.log(10.0) * np.arange(-4.0, 7.0)
#: Their places in a state, and where the rig's begin.
CURVE = slice(0, CURVE_KNOTS)
KERNEL = slice(CURVE_KNOTS, CURVE_KNOTS + KERNEL_KNOTS.size)
RIG = KERNEL.stop
#: Correlation lengths, in ln t and in ln phi, by the evidence of measured beef.
_KERNEL_LENGTH, _CURVE_LENGTH = 2.0 * math.log(10.0), 2.0
#: Strain at which epsilon is 0 [1]; delta is 0 after 1 s.
_REFERENCE_STRAIN = 0.1
#: Strain below which ln phi counts as if there was no motion [1].
STRAIN_FLOOR = 3e-3
#: The splines of epsilon lie evenly in ln(1 + x / (_NEAR x_last)).
_NEAR = 0.1
#: Of a covariance, eigenvalues below this part of the largest are left out [1].
_NEGLIGIBLE = 1e-6


def _hats(places: Array, knots: Array) -> Array:
    """Return the hat functions of evenly spaced knots at places, (places, knots)."""
    at = np.clip((places - knots[0]) / (knots[1] - knots[0]), 0.0, knots.size - 1.0)
    return np.maximum(1.0 - np.abs(at[:, None] - np.arange(knots.size)), 0.0)


_LOG_RATES = np.log(np.concatenate([RATES, RATES[[0, -1]]]))
#: Weight of each knot of delta at each rate, then at slower and faster ones, (34, knots).
KERNEL_HATS = _hats(-_LOG_RATES, KERNEL_KNOTS)
_DECADE = math.log(10.0)  #: the distance of two knots
#: The slopes of delta over ln t at each rate of the creep, by its knots, (33, knots).
KERNEL_SLOPES: Array = (
    _hats(0.5 * _DECADE - _LOG_RATES[:-1], KERNEL_KNOTS)
    - _hats(-0.5 * _DECADE - _LOG_RATES[:-1], KERNEL_KNOTS)
) / _DECADE


def between_rates(log_rates: Array) -> Array:
    """Return the weights of single rates, linear between those there are, (32, n)."""
    return _hats(log_rates, _LOG_RATES[:-2]).T


def last_knot(deepest: float) -> float:
    """Return the strain of the last knot [1]: the least of 0.02 * 1.25^k above a largest one."""
    ratio = max(deepest * 1.05, 0.02) / 0.02
    return 0.02 * 1.25 ** math.ceil(math.log(ratio) / math.log(1.25))


def splines(strain: Array, last: float) -> Array:
    """Return the quadratic splines of epsilon at strains (n,), straight beyond `last`, (n, 22)."""
    at, parts, _ = spline_parts(strain, last)
    found = np.zeros((strain.size, CURVE_KNOTS))
    np.put_along_axis(found, at.T, parts.T, axis=1)
    return found


def spline_parts(strain: Array, last: float) -> tuple[Indices, Array, Array]:
    """Return the three splines that are not 0 at strains (n,), and their slopes, (3, n) each."""
    cells, scale = CURVE_KNOTS - 2, _NEAR * last
    size = np.abs(strain)
    place = cells / math.log1p(1.0 / _NEAR) * np.log1p(size / scale)
    cell = np.minimum(place.astype(np.intp), cells - 1)
    p, inside = place - cell, place < cells
    before = np.where(inside, 0.5 * (1.0 - p) ** 2, 0.0)
    middle = np.where(inside, 0.5 + p - p**2, 1.5 - p)
    by_strain = cells / math.log1p(1.0 / _NEAR) / (scale + size)
    first, second = np.where(inside, p - 1.0, 0.0), np.where(inside, 1.0 - 2.0 * p, -1.0)
    slopes = np.array([first, second, -first - second]) * by_strain
    at = cell + np.arange(3)[:, None]
    return at, np.array([before, middle, 1.0 - before - middle]), slopes


def spline_places(last: float) -> Array:
    """Return the strains about which the splines lie, (22,)."""
    middles = np.clip((np.arange(CURVE_KNOTS) - 0.5) / (CURVE_KNOTS - 2), 0.0, 1.0)
    return _NEAR * last * np.expm1(middles * math.log1p(1.0 / _NEAR))


def _root(whole: Array, zero: Array) -> Array:
    """Return R of a covariance R R^T of values at knots, given that zero @ these is 0."""
    with_zero = whole @ zero
    whole = whole - np.outer(with_zero, with_zero) / float(zero @ with_zero)
    values, vectors = np.linalg.eigh(whole)
    kept = values > _NEGLIGIBLE * values[-1]
    root: Array = vectors[:, kept] * np.sqrt(values[kept])
    return root


@functools.lru_cache(maxsize=16)
def kernel_root(order: float) -> Array:
    """Return a root of delta's covariance at a standard deviation of 1, (11, r)."""
    # Beyond an order of 0.3 holds of beef were predicted to 0.61 % of the peak in place of 0.52 %.
    weights = relaxation_weights(min(order, 0.3))
    zero = (weights * left_after(1.0)) @ KERNEL_HATS
    apart = np.abs(KERNEL_KNOTS[:, None] - KERNEL_KNOTS) / _KERNEL_LENGTH
    return _root(np.exp(-apart), zero / zero.sum())


@functools.lru_cache(maxsize=16)
def curve_root(nonlinear_stiffness: float, last: float) -> Array:
    """Return a root of epsilon's covariance at a standard deviation of 1, (22, r)."""
    places = np.log(phi(spline_places(last), 1.0, nonlinear_stiffness) + STRAIN_FLOOR)
    at_zero = splines(np.array([_REFERENCE_STRAIN]), last)[0]
    # Smooth (Matern 3/2): the roughness is an error of its own. With exp(-apart) a ramp of
    # beef seemed to know alpha to 0.02, and wrong.
    apart = math.sqrt(3.0) * np.abs(places[:, None] - places) / _CURVE_LENGTH
    return _root((1.0 + apart) * np.exp(-apart), at_zero)


def kernel_change(kernel_sd: float, way: float) -> float:
    """Return the variance by which the kernel's error changes over a way of ln t [1].

    `kernel_sd`: the relative standard deviation of the kernel [1].
    """
    return 2.0 * kernel_sd**2 * -math.expm1(-way / _KERNEL_LENGTH)
