# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The stress that law and rig leave out, as a random walk between knots in time.

The walk enters the stress with the factor 1 and is linear in time between two knots. When the
later knot is reached, the earlier one is taken out of the sums (marginalised), the later one takes
its place, and the next begins: the whole past of the walk is accounted for in constant memory. Its
increments are Gaussian and independent; their variance is given from block to block.

References
----------
Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001),
ch. 5: nuisances as random walks.
"""

from __future__ import annotations

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.normal_equations import NormalEquations

_NOW, _NEXT = StateIndex.WALK, StateIndex.WALK_NEXT
#: Distance of the knots [s]: a heartbeat of 1.2 Hz wants 0.125 s; with 0.25 s the estimates are
#: two to three of their deviations off.
_KNOT_INTERVAL = 0.125
#: Blocks between two knots at least [1]: fewer would let the walk follow every block.
_LEAST_BLOCKS = 2.0
#: Variance of the walk at the touch [unit^2]: nothing has been left out by then.
_START_VARIANCE = 1e-4
#: Least variance of an increment [unit^2]: less would be lost by rounding beside stiffer ones.
_LEAST_VARIANCE = 1e-4
#: An interval ends early when the variance in it has grown to this many times what was planned
#: for it [1]: the motion began anew.
_EARLY = 2.0


class RandomWalk:
    """The walk's knots in the sums and in the state of one posterior.

    Parameters
    ----------
    equations : NormalEquations
        With the linear columns ``walk`` and ``walk_next``.
    unit : float
        The stress by which the walk is measured [Pa], so that its numbers are of the size of 1:
        three standard deviations of a sample's noise.
    """

    def __init__(self, equations: NormalEquations, unit: float) -> None:
        self._equations = equations
        self.unit = unit
        self.interrupt()

    def interrupt(self) -> None:
        """Let the walk begin anew at the next block."""
        self._is_begun = False
        self._knot, self._interval = 0.0, _KNOT_INTERVAL
        self._planned = self._gone = 0.0

    def take_out(self) -> None:
        """Take the walk out of the sums, at the end of a contact."""
        if not self._is_begun:
            return
        for index in (_NOW, _NEXT):
            self._equations.marginalise(index, 0.0)
        self.interrupt()

    def columns(
        self,
        time: float,
        duration: float,
        variance: float,
        states: tuple[Array, ...],
        covariance: Array,
    ) -> tuple[float, float]:
        """Return the columns of both knots for a block, after moving the knots on where due.

        Parameters
        ----------
        time, duration : float
            Of the block [s].
        variance : float
            By which the walk grows over the block [Pa^2].
        states : tuple of ndarray, shape (..., n)
            Changed in place where the knots move.
        covariance : ndarray, shape (n, n)
            Likewise.
        """
        begun = time - duration
        grown = variance / self.unit**2
        rate = grown / duration if duration > 0.0 else 0.0
        if not self._is_begun:
            self._begin(begun, duration, rate, states, covariance)
        elif time >= self._knot + self._interval or self._gone > _EARLY * self._planned:
            self._move_on(begun, duration, rate, states, covariance)
        self._gone += grown
        share = min((time - self._knot) / self._interval, 1.0)
        return (1.0 - share) * self.unit, share * self.unit

    def _begin(
        self,
        time: float,
        duration: float,
        rate: float,
        states: tuple[Array, ...],
        covariance: Array,
    ) -> None:
        self._is_begun = True
        for index in (_NOW, _NEXT):
            self._equations.forget(index)
            for state in states:
                state[..., index] = 0.0
            covariance[index, :] = covariance[:, index] = 0.0
        self._equations.bind(_NOW, None, 1.0 / _START_VARIANCE)
        covariance[_NOW, _NOW] = _START_VARIANCE
        self._plan(time, duration, rate, covariance)

    def _move_on(
        self,
        time: float,
        duration: float,
        rate: float,
        states: tuple[Array, ...],
        covariance: Array,
    ) -> None:
        self._equations.marginalise(_NOW, 0.0)
        self._equations.move(_NEXT, _NOW)
        for state in states:
            state[..., _NOW] = state[..., _NEXT]
        covariance[_NOW, :] = covariance[_NEXT, :]
        covariance[:, _NOW] = covariance[:, _NEXT]
        covariance[_NOW, _NOW] = covariance[_NEXT, _NEXT]
        self._plan(time, duration, rate, covariance)

    def _plan(self, time: float, duration: float, rate: float, covariance: Array) -> None:
        """Begin an interval: the next knot differs from the present one as planned."""
        self._knot = time
        self._interval = max(_KNOT_INTERVAL, _LEAST_BLOCKS * duration)
        self._planned = max(rate * self._interval, _LEAST_VARIANCE)
        self._gone = 0.0
        self._equations.bind(_NEXT, _NOW, 1.0 / self._planned)
        covariance[_NEXT, :] = covariance[_NOW, :]
        covariance[:, _NEXT] = covariance[:, _NOW]
        covariance[_NEXT, _NEXT] = covariance[_NOW, _NOW] + self._planned
