# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Online fractional integral in constant time and memory per sample, for arbitrary steps.

The Riemann-Liouville integral of order beta (paper, eq. FC) has the kernel :math:`k(t) =
t^{\beta-1}/\Gamma(\beta)`. As the sum of exponentials of :mod:`fden_ros.core.law.kernel` it lets
the whole past live in one number per exponential,
:math:`z_j(t) = \int_0^t e^{-s_j (t-\xi)} f(\xi)\,d\xi`, which serves every order at once.

With f linear between samples, h the step and :math:`y_j = s_j h`, the recursion is exact for any
h:

.. math::
    q_j &= e^{-y_j} z_j, \qquad
    D^{-\beta} f_n = \sum_j w_j q_j + \frac{h^\beta}{\Gamma(\beta+2)} (f_n + \beta f_{n-1}) \\
    z_j &\leftarrow q_j + h\,[f_{n-1}(\phi_1 - \phi_2) + f_n \phi_2], \qquad
    \phi_1 = (1 - e^{-y})/y,\ \phi_2 = (1 - \phi_1)/y

The newest step is integrated with the true kernel, because there the sum of exponentials does not
hold. Idea of the kernel sum: Beylkin and Monzón, Appl. Comput. Harmon. Anal. 28 (2010) 131; of the
recursion: Lubich and Schädle, SIAM J. Sci. Comput. 24 (2002) 161.
"""

from __future__ import annotations

import bisect
import functools
import math
from collections.abc import Sequence

import numpy as np
from scipy.special import gamma

from fden_ros.core.arrays import Array
from fden_ros.core.law.kernel import (
    MOST_WAITING,
    SERIES_LIMIT,
    decays_of,
    kernel_weights,
    relaxation_rates,
)

#: In place of the rate 0, by whose product with a step is divided [1/s]: e^-x is 1 to the last bit
#: for steps up to 1e13 s, and x far from where numbers are flushed to zero.
_STANDING_RATE = 1e-30


@functools.cache
def _falling_rates() -> Array:
    """Return -s_j; for the first one, whose exponential stands still, a number near 0."""
    rates = -relaxation_rates()
    rates[0] = -_STANDING_RATE
    return rates


@functools.cache
def _rate_list() -> list[float]:
    return [float(rate) for rate in relaxation_rates()]


@functools.cache
def _gain_series() -> Array:
    """Return phi_2 of each rate as coefficients of the step's powers, shape (76, 5)."""
    coefficients = np.array([1 / 2, -1 / 6, 1 / 24, -1 / 120, 1 / 720])
    series: Array = relaxation_rates()[:, None] ** np.arange(5) * coefficients
    return series


def fractional_stress(times: Array, stress: Array, fractional_order: float) -> Array:
    """Return f' = D^-alpha f [Pa s^alpha] at every sample, with f linear in between.

    Parameters
    ----------
    times, stress : ndarray, shape (n,)
        [s], increasing by at least :data:`~fden_ros.core.law.kernel.SHORTEST_STEP`; f [Pa].
    fractional_order : float
        alpha [1].

    Returns
    -------
    ndarray, shape (n,)
    """
    integral = FractionalIntegral([fractional_order])
    integral.start(float(stress[0]))
    values = np.zeros(stress.size)
    for index, step in enumerate(np.diff(times), start=1):
        values[index] = integral.advance(float(step), float(stress[index]))[0]
    return values


class FractionalIntegral:
    """D^-beta f of one sampled signal for several orders beta at once.

    Parameters
    ----------
    orders : sequence of float
        Orders of integration [1], each in (0, 1].

    Examples
    --------
    The integral of order 1/2 of f(t) = t is t^1.5 / Gamma(2.5), whatever the steps:

    >>> integral = FractionalIntegral([0.5])
    >>> _ = integral.start(0.0)
    >>> for step in (0.1, 0.5, 0.4):
    ...     value = integral.advance(step, integral.last_value + step)
    >>> round(float(value[0]), 9)
    0.752252778
    """

    def __init__(self, orders: Sequence[float]) -> None:
        self.orders = tuple(float(order) for order in orders)
        self._weights = np.vstack([kernel_weights(order) for order in self.orders])
        self._order_array = np.array(self.orders)
        self._local_scale = 1.0 / gamma(self._order_array + 2.0)
        self._rates = relaxation_rates()
        size = self._rates.size
        self._memory = np.zeros(size)
        self._decayed = np.empty(size)
        self._scratch = np.empty(size)
        self._decay = np.empty(size)
        self._previous_gain = np.empty(size)
        self._new_gain = np.empty(size)
        self._local_new = np.empty(self._order_array.size)
        self._local_previous = np.empty(self._order_array.size)
        self._prepared_step = math.nan
        self._prepared_steps: tuple[float, ...] = ()
        self._waiting: list[tuple[float, float]] = []
        self._sum = np.zeros(self._order_array.size)
        self.last_value = 0.0

    def start(self, value: float) -> Array:
        """Forget everything and begin at `value`; return the integral, 0, shape (orders,)."""
        self._memory.fill(0.0)
        self._waiting.clear()
        self._sum.fill(0.0)
        self.last_value = value
        return np.zeros(self._order_array.size)

    def advance(self, step: float, value: float) -> Array:
        """Add a sample `step` seconds after the last; return D^-beta f there, shape (orders,).

        Steps shorter than :data:`SHORTEST_STEP` are outside the kernel's range: the caller merges
        or drops them.
        """
        self._catch_up()
        if step != self._prepared_step:
            self._prepare(step)
        np.multiply(self._decay, self._memory, out=self._decayed)
        result: Array = self._weights @ self._decayed
        result += self._local_new * value
        result += self._local_previous * self.last_value
        np.multiply(self._previous_gain, self.last_value, out=self._memory)
        np.multiply(self._new_gain, value, out=self._scratch)
        self._memory += self._scratch
        self._memory += self._decayed
        self.last_value = value
        self._sum += result
        return result

    def ahead(self, step: float) -> Array:
        """Return D^-beta f at `step` seconds after the last sample if f is 0 by then."""
        self._catch_up()
        if step != self._prepared_step:
            self._prepare(step)
        result: Array = self._weights @ (self._decay * self._memory)
        result += self._local_previous * self.last_value
        return result

    def relax(self, steps: tuple[float, ...]) -> Array:
        """Let f fall to 0 in the first of some steps; return D^-beta f at the end of each.

        Parameters
        ----------
        steps : tuple of float
            [s].

        Returns
        -------
        ndarray, shape (steps, orders)
        """
        first = self.advance(steps[0], 0.0)
        elapsed = np.cumsum(steps[1:])
        decayed = np.exp(-self._rates[:, None] * elapsed) * self._memory[:, None]
        if elapsed.size:
            self._memory[:] = decayed[:, -1]
        return np.vstack([first, (self._weights @ decayed).T])

    def add(self, step: float, value: float) -> None:
        """Add a sample as :meth:`advance` does, where only the sum of the integrals is wanted."""
        self._waiting.append((step, value))
        if len(self._waiting) >= MOST_WAITING:
            self._catch_up()

    def take_sum(self) -> Array:
        """Return the sum of D^-beta f at all samples since the last call, shape (orders,)."""
        self._catch_up()
        total = self._sum
        self._sum = np.zeros_like(total)
        return total

    def _catch_up(self) -> None:
        """Add the samples that wait, all at once: several times faster than one by one."""
        if not self._waiting:
            return
        steps, values = zip(*self._waiting, strict=True)
        self._waiting.clear()
        if steps != self._prepared_steps:
            self._prepare_several(steps)
            self._prepared_steps = steps
        added = self._shares @ np.array([self.last_value, *values[:-1], *values])
        size = self._memory.size
        self._sum += self._start_weights @ self._memory
        self._sum += added[size:]
        self._memory *= self._whole_decay
        self._memory += added[:size]
        self.last_value = values[-1]

    def _prepare_several(self, steps: tuple[float, ...]) -> None:
        """Set what the values before all steps and those after add to memory and sum."""
        decays = decays_of(steps)
        new_gain = decays.later_mean()
        gains = np.array(steps) * np.array([decays.mean - new_gain, new_gain])
        self._start_weights = self._weights * decays.sum_of_start
        self._whole_decay = decays.whole
        local = np.array(steps) ** self._order_array[:, None] * self._local_scale[:, None]
        after = self._weights @ (gains * decays.sums_after)
        after += np.array([local * self._order_array[:, None], local])
        shares = np.concatenate([gains * decays.to_end, after], axis=1)
        #: Shape (rates + orders, 2 n).
        self._shares = np.concatenate(list(shares), axis=1)

    def _prepare(self, step: float) -> None:
        falling, gain, mean_decay = self._scratch, self._new_gain, self._previous_gain
        np.multiply(_falling_rates(), step, out=falling)
        np.expm1(falling, out=self._decay)
        np.divide(self._decay, falling, out=mean_decay)
        self._decay += 1.0
        np.subtract(mean_decay, 1.0, out=gain)
        gain /= falling
        few = bisect.bisect_left(_rate_list(), SERIES_LIMIT / step)
        # The closed form cancels there.
        powers = np.array([1.0, step, step**2, step**3, step**4])
        np.dot(_gain_series()[:few], powers, out=gain[:few])
        mean_decay -= gain
        mean_decay *= step
        gain *= step
        np.multiply(step**self._order_array, self._local_scale, out=self._local_new)
        np.multiply(self._local_new, self._order_array, out=self._local_previous)
        self._prepared_step = step
