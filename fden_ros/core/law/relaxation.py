# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The relaxation of the law and its inverse, the creep, as sums of exponentials.

.. math::
    \frac{t^{-\alpha}}{\Gamma(1-\alpha)} = \frac{\sin\pi\alpha}{\pi}
        \int_{-\infty}^{\infty} \lambda^\alpha e^{-\lambda t}\,d\ln\lambda, \qquad
    \frac{t^{\alpha-1}}{\Gamma(\alpha)} = \frac{\sin\pi\alpha}{\pi}
        \int_{-\infty}^{\infty} \lambda^{1-\alpha} e^{-\lambda t}\,d\ln\lambda .

The trapezoidal rule in ln lambda converges exponentially: with steps of :data:`SPACING` the error
is 5e-6 of the relaxation. Slower rates than the slowest count as a constant, faster ones than the
fastest as a weight on the last rate of change, both as geometric sums.

The moments :math:`\int e^{-\lambda (t - s)} f(s)\,ds` of a stress hold its whole past in one
number a rate, whatever the order. With f linear over a step h and :math:`y = \lambda h` they are
exact: they decay by :math:`e^{-y}` and gain

.. math:: h\,[f_{n-1} (m_1 - m_2) + f_n m_2], \qquad m_1 = (1 - e^{-y})/y,\ m_2 = (1 - m_1)/y .

C. Lubich, A. Schädle, SIAM J. Sci. Comput. 24 (2002) 161.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.streams import MIN_STEP_NS, NANOSECONDS

#: Exponentials and their distance in ln lambda: half the distance changes a response by
#: 5e-6 of it.
RATE_COUNT, SPACING = 32, 0.77
#: Rates of the exponentials [1/s], shape (RATE_COUNT,): the slowest is the memory of eleven days.
RATES: Array = 1e-6 * np.exp(SPACING * np.arange(RATE_COUNT))
RATES.flags.writeable = False
#: Orders alpha that the weights are made for: the lowest is a spring, to 1e-4 over eleven days.
LOWEST_ORDER, HIGHEST_ORDER = 1e-5, 0.9
#: Shortest step between samples [s]: these rates do not resolve a shorter one.
SHORTEST_STEP = MIN_STEP_NS / NANOSECONDS
#: Below this value of rate times step, m_2 is taken from its series.
_SERIES_LIMIT = 1e-4


def relaxation_weights(order: float | Array) -> Array:
    """Return the weights of relaxation, shape (RATE_COUNT + 2, ...); at last slower, faster rates.

    `order`: of shape (...).
    """
    factor = SPACING * np.sin(np.pi * order) / np.pi
    slow = factor * RATES[0] ** order / np.expm1(SPACING * order)
    # A fast exponential meets a change of phi as its rate times 1 / lambda.
    fast = factor * RATES[-1] ** (order - 1.0) / np.expm1(SPACING * (1.0 - order))
    return np.concatenate([factor * np.power.outer(RATES, order), [slow, fast]])


def left_after(times: float | Array) -> Array:
    """Return the part of each weight of the relaxation that is left after times [s].

    Of those that :func:`relaxation_weights` returns, shape (..., RATE_COUNT + 2): of the slower
    rates all, of the faster ones nothing.
    """
    left = np.zeros((*np.shape(times), RATE_COUNT + 2))
    left[..., :RATE_COUNT] = np.exp(-np.multiply.outer(times, RATES))
    left[..., RATE_COUNT] = 1.0
    return left


def creep_weights(order: float) -> Array:
    """Return the weights, shape (RATE_COUNT,), that make D^-alpha of the stress of its moments."""
    factor = SPACING * math.sin(math.pi * order) / math.pi
    weights: Array = factor * RATES ** (1.0 - order)
    # The slower ones have not decayed yet: they weigh on the slowest.
    weights[0] += factor * RATES[0] ** (1.0 - order) / math.expm1(SPACING * (1.0 - order))
    return weights


@functools.lru_cache(maxsize=16)
def memory_weights(order: float) -> Array:
    """Return the weights of moments and present stress in D^-alpha, shape (RATE_COUNT + 1,)."""
    order = max(order, LOWEST_ORDER)
    factor = SPACING * math.sin(math.pi * order) / math.pi
    # Rates faster than the fastest follow the stress.
    fast = factor * RATES[-1] ** -order / math.expm1(SPACING * order)
    return np.append(creep_weights(order), fast)


def passed(
    step: float | Array, before: float | Array, after: float | Array
) -> tuple[Array, Array]:
    """Return the decay of moments over steps [s], and the gain from linear stresses [Pa].

    Parameters
    ----------
    step, before, after : float or ndarray, shape (n, 1)

    Returns
    -------
    decay, gain : ndarray, shape (..., RATE_COUNT)
    """
    y = RATES * step
    mean = -np.expm1(-y) / y
    later = np.where(y < _SERIES_LIMIT, 0.5 - y / 6.0, (1.0 - mean) / y)
    return np.exp(-y), step * (before * (mean - later) + after * later)


class StressMoments:
    """Exponential moments of a measured stress: all of it that the tissue's future depends on."""

    def __init__(self) -> None:
        #: int exp(-lambda (t - s)) f(s) ds [Pa s], shape (RATE_COUNT,).
        self.values: Array = np.zeros(RATE_COUNT)

    def add(self, step: float, before: float, after: float) -> None:
        """Add a stress [Pa] that is linear over `step` seconds."""
        decay, gain = passed(step, before, after)
        self.values = decay * self.values + gain

    def after(self, elapsed: Array) -> Array:
        """Return the moments after times without stress [s], shape (n, RATE_COUNT)."""
        result: Array = np.exp(-np.outer(elapsed, RATES)) * self.values
        return result

    def wait(self, step: float) -> None:
        """Let `step` seconds pass without stress."""
        self.values = np.exp(-RATES * step) * self.values
