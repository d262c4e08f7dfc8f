# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The kernel of the fractional operators as a sum of exponentials.

The kernel of order beta, :math:`k(t) = t^{\beta-1}/\Gamma(\beta)`, remembers everything. On
:math:`[\delta, T]` it is, to a relative 3e-11, the sum
:math:`k(t) \approx \sum_j w_j(\beta)\, e^{-s_j t}`. The rates s do not depend on beta: one state
per exponential serves every order, and what depends on the order is weights alone. They are kept
at Chebyshev nodes of alpha, between which responses are interpolated.
"""

from __future__ import annotations

import functools
import itertools

import numpy as np
from numpy.polynomial import chebyshev
from scipy.special import gamma

from fden_ros.core.arrays import Array

#: Shortest step [s] and longest memory [s] for which the sum of exponentials holds, to a relative
#: 3e-11: samples at up to 100 kHz, and a site of a day.
SHORTEST_STEP = 1e-5
LONGEST_MEMORY = 1e5

#: Exponentials [1]: 76 err by 2e-11 at most (orders from 0.02 to 0.87), 70 by 2e-10, 38 by 2e-5.
_EXPONENTIALS = 76
#: Times at which the weights are fitted [1]: half or twice as many give the same error.
_FIT_POINTS = 1200
#: Below this value of rate times step [1], phi_2 is taken from its series: there both its five
#: terms and the cancellation in the closed form err by 4e-14.
SERIES_LIMIT = 1e-2
#: Samples that may wait to be added together [1]: a block of 10 ms at 6.4 kHz. It bounds memory
#: and the time that one sample may take; the sums are the same but for rounding.
MOST_WAITING = 64
#: Orders alpha [1] between which the response can be interpolated, wider than the range 0.02 to
#: 0.6 that an alpha may be given in.
LOWEST_ORDER, HIGHEST_ORDER = 0.01, 0.65
#: Nodes of alpha [1]: they interpolate t^-alpha to 1e-5 for times from 1 ms to 30 s
#: (test_core_stress_basis).
_ORDER_NODES = 11


@functools.cache
def relaxation_rates() -> Array:
    """Return the rates s_j of the exponentials [1/s], shape (76,), the first one 0."""
    slowest, fastest = 10**-0.25 / LONGEST_MEMORY, 10**1.25 / SHORTEST_STEP
    rates = np.concatenate([[0.0], np.geomspace(slowest, fastest, _EXPONENTIALS - 1)])
    rates.flags.writeable = False
    return rates


@functools.lru_cache(maxsize=256)
def kernel_weights(order: float) -> Array:
    """Return the weights w_j, shape (76,), that turn the exponentials into the kernel of `order`.

    Column-scaled least squares on the relative error at log-spaced times.

    Raises
    ------
    ValueError
        If `order` is not in (0, 1].
    """
    if not 0.0 < order <= 1.0:
        raise ValueError(f"order of integration is {order}, must be in (0, 1]")
    times = np.logspace(np.log10(SHORTEST_STEP), np.log10(LONGEST_MEMORY), _FIT_POINTS)
    kernel = times ** (order - 1.0) / gamma(order)
    design = np.exp(-np.outer(times, relaxation_rates())) / kernel[:, None]
    scale = np.sqrt(np.sum(design**2, axis=0))
    solution = np.linalg.lstsq(design / scale, np.ones(_FIT_POINTS), rcond=1e-16)[0]
    weights: Array = solution / scale
    weights.flags.writeable = False
    return weights


class Decays:
    """How much the exponentials have decayed over several steps.

    Parameters
    ----------
    steps : tuple of float
        [s].

    Attributes
    ----------
    mean : ndarray, shape (76, n)
        phi_1: the mean decay within each step.
    to_end : ndarray, shape (76, n)
        From the end of each step to the end of the last.
    sums_after : ndarray, shape (76, n)
        From the end of each step to that of every later one, added up.
    whole : ndarray, shape (76,)
        From the beginning to the end of the last step.
    sum_of_start : ndarray, shape (76,)
        From the beginning to the end of every step, added up.
    """

    def __init__(self, steps: tuple[float, ...]) -> None:
        rates = relaxation_rates()[:, None]
        self._exponent = rates * np.array(steps)
        loss = -np.expm1(-self._exponent)
        by_step = 1.0 - loss
        self.mean = np.ones_like(loss)
        np.divide(loss[1:], self._exponent[1:], out=self.mean[1:])
        left = itertools.accumulate(reversed(steps[1:]), initial=0.0)
        self.to_end: Array = np.exp(-rates * np.array([*left][::-1]))
        self.sums_after = np.zeros_like(by_step)
        later = np.zeros(rates.size)
        for k, decay in zip(range(len(steps) - 1, 0, -1), by_step.T[:0:-1].copy(), strict=True):
            later = (later + 1.0) * decay
            self.sums_after[:, k - 1] = later
        self.whole: Array = by_step[:, 0] * self.to_end[:, 0]
        self.sum_of_start: Array = by_step[:, 0] * (1.0 + self.sums_after[:, 0])

    def later_mean(self) -> Array:
        """Return phi_2, shape (76, n)."""
        small = np.minimum(self._exponent, SERIES_LIMIT)
        series = 0.5 - small * (1 / 6 - small * (1 / 24 - small * (1 / 120 - small / 720)))
        large = np.maximum(self._exponent, SERIES_LIMIT)
        result: Array = np.where(self._exponent < SERIES_LIMIT, series, (1.0 - self.mean) / large)
        return result


#: Blocks have the same steps again and again.
decays_of = functools.lru_cache(maxsize=8)(Decays)


@functools.cache
def order_nodes() -> tuple[float, ...]:
    """Return the Chebyshev nodes of alpha, ascending."""
    points = np.sort(chebyshev.chebpts1(_ORDER_NODES))
    middle, half = 0.5 * (LOWEST_ORDER + HIGHEST_ORDER), 0.5 * (HIGHEST_ORDER - LOWEST_ORDER)
    return tuple(float(middle + half * point) for point in points)


@functools.lru_cache(maxsize=8)
def order_weights(order: float) -> Array:
    """Return the weights, shape (11,), by which a polynomial through the nodes gives an order."""
    nodes = order_nodes()
    middle, half = 0.5 * (nodes[0] + nodes[-1]), 0.5 * (nodes[-1] - nodes[0])
    powers = np.full(len(nodes), (order - middle) / half)
    powers[0] = 1.0
    weights: Array = np.multiply.accumulate(powers) @ _node_polynomials()
    weights.flags.writeable = False
    return weights


@functools.cache
def _node_polynomials() -> Array:
    """Return the polynomials that are 1 at one node and 0 at the others, by the powers."""
    nodes = np.array(order_nodes())
    middle, half = 0.5 * (nodes[0] + nodes[-1]), 0.5 * (nodes[-1] - nodes[0])
    cardinal = np.linalg.inv(chebyshev.chebvander((nodes - middle) / half, nodes.size - 1))
    powers = [chebyshev.cheb2poly(row) for row in np.eye(nodes.size)]
    of_powers = np.array([np.pad(row, (0, nodes.size - row.size)) for row in powers]).T
    result: Array = of_powers @ cardinal
    return result
