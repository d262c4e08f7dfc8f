r"""Online fractional integral in constant time and memory per sample, for arbitrary steps.

The Riemann-Liouville integral of order beta (paper, eq. FC) has the kernel :math:`k(t) =
t^{\beta-1}/\Gamma(\beta)`, which remembers everything. On :math:`[\delta, T]` it is a sum of
exponentials to eleven digits,
:math:`k(t) \approx \sum_j w_j e^{-s_j t}`, so that the whole past lives in one number per
exponential,
:math:`z_j(t) = \int_0^t e^{-s_j (t-\xi)} f(\xi)\,d\xi`. The rates s do not depend on beta: one
state serves every order at once.

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
import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import gamma

Array = NDArray[np.float64]

#: Shortest step [s] and longest memory [s] for which the sum of exponentials holds, to a relative
#: 3e-11.
SHORTEST_STEP = 1e-5
LONGEST_MEMORY = 1e5

_EXPONENTIALS = 76
_FIT_POINTS = 1200
#: Below this value of rate * step, phi_2 is taken from its series, where the closed form cancels.
_SERIES_LIMIT = 1e-2
#: In place of the rate 0, by whose product with a step is divided [1/s]: e^-x is 1 to the last bit
#: for steps up to 1e13 s, and x far from where numbers are flushed to zero.
_STANDING_RATE = 1e-30
#: So many samples may wait to be added together.
MOST_WAITING = 64


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
    counts : tuple of float
        1 where the end of a step is added up, 0 where it is not.

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

    def __init__(self, steps: tuple[float, ...], counts: tuple[float, ...]) -> None:
        rates = relaxation_rates()[:, None]
        self._exponent = rates * np.array(steps)
        loss = -np.expm1(-self._exponent)
        by_step = 1.0 - loss
        self.mean = np.ones_like(loss)
        np.divide(loss[1:], self._exponent[1:], out=self.mean[1:])
        left = itertools.accumulate(reversed(steps[1:]), initial=0.0)
        self.to_end: Array = np.exp(-rates * np.array([*left][::-1]))
        self.sums_after = np.zeros_like(by_step)
        for k in range(len(steps) - 1, 0, -1):
            np.add(self.sums_after[:, k], counts[k], out=self.sums_after[:, k - 1])
            self.sums_after[:, k - 1] *= by_step[:, k]
        self.whole: Array = by_step[:, 0] * self.to_end[:, 0]
        self.sum_of_start: Array = by_step[:, 0] * (counts[0] + self.sums_after[:, 0])

    def later_mean(self) -> Array:
        """Return phi_2, shape (76, n)."""
        small = np.minimum(self._exponent, _SERIES_LIMIT)
        series = 0.5 - small * (1 / 6 - small * (1 / 24 - small * (1 / 120 - small / 720)))
        large = np.maximum(self._exponent, _SERIES_LIMIT)
        result: Array = np.where(self._exponent < _SERIES_LIMIT, series, (1.0 - self.mean) / large)
        return result


#: Force and motion of the same block ask for the same.
decays_of = functools.lru_cache(maxsize=8)(Decays)


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
        pairs = np.array([(self.last_value, *values[:-1]), values])
        remembered = self._memory * self._start_share
        remembered += np.einsum("pik,pk->i", self._shares_after, pairs)
        self._sum += self._weights @ remembered
        self._sum += np.einsum("pik,pk->i", self._local, pairs)
        self._memory *= self._whole_decay
        self._memory += np.einsum("pik,pk->i", self._shares_at_end, pairs)
        self.last_value = values[-1]

    def _prepare_several(self, steps: tuple[float, ...]) -> None:
        """Set what the values before and after each step add, shapes (2, rates or orders, n)."""
        decays = decays_of(steps, (1.0,) * len(steps))
        new_gain = decays.later_mean()
        gains = np.array(steps) * np.array([decays.mean - new_gain, new_gain])
        self._shares_after = gains * decays.sums_after
        self._shares_at_end = gains * decays.to_end
        self._start_share = decays.sum_of_start
        self._whole_decay = decays.whole
        local = np.array(steps) ** self._order_array[:, None] * self._local_scale[:, None]
        self._local = np.array([local * self._order_array[:, None], local])

    def _prepare(self, step: float) -> None:
        falling, gain, mean_decay = self._scratch, self._new_gain, self._previous_gain
        np.multiply(_falling_rates(), step, out=falling)
        np.expm1(falling, out=self._decay)
        np.divide(self._decay, falling, out=mean_decay)
        self._decay += 1.0
        np.subtract(mean_decay, 1.0, out=gain)
        gain /= falling
        few = bisect.bisect_left(_rate_list(), _SERIES_LIMIT / step)
        # The closed form cancels there.
        powers = np.array([1.0, step, step**2, step**3, step**4])
        np.dot(_gain_series()[:few], powers, out=gain[:few])
        mean_decay -= gain
        mean_decay *= step
        gain *= step
        np.multiply(step**self._order_array, self._local_scale, out=self._local_new)
        np.multiply(self._local_new, self._order_array, out=self._local_previous)
        self._prepared_step = step
