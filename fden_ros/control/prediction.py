r"""Force of a planned motion, and motion for a planned force, with their intervals.

From the law :math:`\varphi(x) = D^{-\alpha} f`, at a time t after the present:

.. math:: \varphi(x(t)) + c = M(t) + \frac{1}{\Gamma(\alpha)} \int_0^t (t-s)^{\alpha-1} f(s)\,ds

M is what the past force still says, one exponential sum of the memory; the integral is over what
is to come. With f linear between the points of the plan this is one lower triangular system:
solved for f it gives the force, multiplied out the motion. The constant c makes the plan begin at
what is measured now, so it takes up the origin's and the sensor's error.

Where the tissue is not exactly that of the law, c is the fractional stress of a stress that the
law leaves out and that stays as it is: it grows as :math:`((A + t)/A)^\alpha`, with A the age of
the loading.

The interval is first-order: derivatives by (ln G, ln Gn, alpha, c) under the estimate's covariance
and the variance of the last innovation; to it comes the error of the relaxation, which grows with
ln A (:mod:`fden_ros.core.estimation.unmodelled`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from fden_ros.core.estimation.estimate import Estimate, StateIndex
from fden_ros.core.estimation.unmodelled import KERNEL_SHARE, kernel_error_variance
from fden_ros.core.law.characteristic import phi, strain_of_phi
from fden_ros.core.law.fractional_integral import FractionalIntegral
from fden_ros.core.law.geometry import Geometry, Sphere
from fden_ros.core.law.kernel import integral_weights, order_interpolation
from fden_ros.errors import InputError

Array = NDArray[np.float64]

#: Model error [1] below which the tissue is taken for that of the law.
_LEAST_MODEL_ERROR = 0.01
#: Points of a plan are this close at most, as a share of its length.
_FINEST_SHARE = 40
_DERIVATIVE_STEP = 1e-4
_ORDER_STEP = 0.005


class StressMemory(FractionalIntegral):
    """The whole past of the stress at one site, for every order at once."""

    def __init__(self) -> None:
        super().__init__([0.131])

    def copy(self) -> StressMemory:
        """Return the memory as it is now."""
        other = StressMemory()
        other._memory = self._memory.copy()
        other.last_value = self.last_value
        return other

    def remembered(self, elapsed: Array, order: float) -> Array:
        """Return D^-order of the past alone, shape of `elapsed` (n,), so many seconds from now."""
        # Interpolated over the orders: their weights are found once, and alpha may be learned.
        weights = order_interpolation()(order)[0] @ integral_weights()
        result: Array = np.exp(-np.outer(elapsed, self._rates)) @ (weights * self._memory)
        return result


@dataclass(frozen=True)
class Prediction:
    """What will happen, with its deviation."""

    times: Array  #: [s] from the present, shape (n,)
    value: Array  #: force [N] or change of displacement [m], shape (n,)
    sd: Array  #: its standard deviation, shape (n,)

    def interval(self, deviations: float = 2.0) -> tuple[Array, Array]:
        """Return lower and upper bound at so many standard deviations, each of shape (n,)."""
        return self.value - deviations * self.sd, self.value + deviations * self.sd


@dataclass(frozen=True)
class Predictor:
    """The tissue as it is now: parameters, memory, present strain and stress.

    Parameters
    ----------
    geometry : Geometry
    estimate : Estimate
    memory : StressMemory
        The stress of the site up to now.
    strain, stress : float
        Present values [1], [Pa].
    innovation_variance : float
        Of the stress or the fractional stress, which differ little over seconds [Pa^2].
    """

    geometry: Geometry
    estimate: Estimate
    memory: StressMemory
    strain: float
    stress: float
    innovation_variance: float = 0.0

    def force(self, times: ArrayLike, displacements: ArrayLike) -> Prediction:
        """Return the force on the tissue while the probe follows a plan.

        Parameters
        ----------
        times : array_like, shape (n,)
            Seconds from the present, positive, increasing.
        displacements : array_like, shape (n,)
            Way further into the tissue by then [m], linear in between; negative: back.

        Raises
        ------
        InputError
            If the plan has no shape, or its times do not increase from 0.
        """
        wanted, moves = _plan(times, displacements, "displacements")
        grid = _grid(wanted)
        way = np.interp(grid, np.append(0.0, wanted), np.append(0.0, moves))
        strains = self._strains(way)
        scale = 1.0 / self.geometry.stress_per_force

        def forces(logs: Array, order: float, shift: float) -> Array:
            known, gains = self._known(grid, order)
            left_out = self._left_out(logs, order, grid)
            rest = phi(strains, *np.exp(logs)) + left_out + shift - known
            stress = solve_triangular(gains, rest, lower=True)
            # Contact pushes and does not pull.
            return np.maximum(np.interp(wanted, grid, stress), 0.0) * scale

        prediction = self._with_deviation(wanted, forces)
        left_out = prediction.value**2 * self._relaxation_variance(wanted)
        return replace(prediction, sd=np.sqrt(prediction.sd**2 + left_out))

    def motion(self, times: ArrayLike, forces: ArrayLike) -> Prediction:
        """Return the way further into the tissue that makes a planned force.

        Parameters
        ----------
        times : array_like, shape (n,)
            Seconds from the present, positive, increasing.
        forces : array_like, shape (n,)
            Force on the tissue by then [N], linear in between from the present one.

        Raises
        ------
        InputError
            If the plan has no shape, or its times do not increase from 0.
        """
        wanted, planned = _plan(times, forces, "forces")
        grid = _grid(wanted)
        present = self.stress / self.geometry.stress_per_force
        stress = (
            np.interp(grid, np.append(0.0, wanted), np.append(present, planned))
            * self.geometry.stress_per_force
        )

        def moves(logs: Array, order: float, shift: float) -> Array:
            known, gains = self._known(grid, order)
            elastic = known + gains @ stress - self._left_out(logs, order, grid) - shift
            strain = strain_of_phi(np.interp(wanted, grid, elastic), *np.exp(logs))
            start = _compression(self.geometry, np.array([self.strain]))
            return (_compression(self.geometry, strain) - start) * self.geometry.length

        return self._with_deviation(wanted, moves)

    def _known(self, grid: Array, order: float) -> tuple[Array, Array]:
        """Return D^-order f of what is known (n,), and the gains of the stress to come (n, n)."""
        gains = _gains(np.append(0.0, grid), order)
        return self.memory.remembered(grid, order) + gains[:, 0] * self.stress, gains[:, 1:]

    def _left_out(self, logs: Array, order: float, times: Array) -> Array:
        """Return the fractional stress that the law leaves out at times to come, shape (n,)."""
        age = self.estimate.loading_age
        growth = ((age + times) / age) ** order if self._has_model_error else np.ones_like(times)
        result: Array = self._shift(logs, order) * growth
        return result

    @property
    def _has_model_error(self) -> bool:
        estimate = self.estimate
        return estimate.model_error > _LEAST_MODEL_ERROR and estimate.loading_age > 0.0

    def _relaxation_variance(self, times: Array) -> Array:
        """Return the relative variance of a force to come by the kernel's error, shape (n,)."""
        if not self._has_model_error:
            return np.zeros_like(times)
        age = self.estimate.loading_age
        ageing = np.log((age + times) / age)
        kernel_sd = KERNEL_SHARE * self.estimate.model_error
        return np.array([kernel_error_variance(kernel_sd, float(grown)) for grown in ageing])

    def _shift(self, logs: Array, order: float) -> float:
        """Return c: measured less modelled fractional stress at the present."""
        # The memory just after the present: the newest step holds its own error otherwise.
        measured = self.memory.remembered(np.array([1e-5]), order)[0]
        measured += 1e-5**order / math.gamma(1.0 + order) * self.stress
        return float(measured - phi(np.array([self.strain]), *np.exp(logs))[0])

    def _strains(self, way: Array) -> Array:
        start = _compression(self.geometry, np.array([self.strain]))[0]
        compressions = start + way / self.geometry.length
        return np.array([self.geometry.strain(float(u)) for u in compressions])

    def _with_deviation(
        self, times: Array, function: Callable[[Array, float, float], Array]
    ) -> Prediction:
        estimate = self.estimate
        logs = estimate.mean[: StateIndex.FRACTIONAL_ORDER]
        order = estimate.fractional_order
        value = function(logs, order, 0.0)
        step = _DERIVATIVE_STEP
        noise = math.sqrt(self.innovation_variance)
        by_g = (function(logs + np.array([step, 0.0]), order, 0.0) - value) / step
        by_gn = (function(logs + np.array([0.0, step]), order, 0.0) - value) / step
        by_order = (function(logs, order + _ORDER_STEP, 0.0) - value) / _ORDER_STEP
        by_noise = function(logs, order, noise) - value
        jacobian = np.stack([by_g, by_gn, by_order])
        variance = np.einsum("in,ij,jn->n", jacobian, estimate.covariance, jacobian)
        return Prediction(times, value, np.sqrt(np.maximum(variance, 0.0) + by_noise**2))


def _compression(geometry: Geometry, strain: Array) -> Array:
    """Return the compression at a strain: the inverse of ``geometry.strain``."""
    if isinstance(geometry, Sphere):
        result: Array = np.maximum(strain, 0.0) ** (2.0 / 3.0)
        return result
    return strain


def _plan(times: ArrayLike, values: ArrayLike, what: str) -> tuple[Array, Array]:
    instants = np.atleast_1d(np.asarray(times, dtype=float))
    planned = np.atleast_1d(np.asarray(values, dtype=float))
    if instants.ndim != 1 or instants.shape != planned.shape or instants.size == 0:
        raise InputError(
            f"plan: {instants.shape} times and {planned.shape} {what}; give as many of each"
        )
    steps = np.diff(instants, prepend=0.0)
    if not (np.all(steps > 1e-5) and np.all(np.isfinite(planned)) and np.all(np.isfinite(steps))):
        raise InputError(
            f"plan: times must increase from 0 by more than 10 µs each, and {what} be finite"
        )
    return instants, planned


def _grid(wanted: Array) -> Array:
    """Return the plan's times with enough others in between, shape (m,)."""
    finest = wanted[-1] / _FINEST_SHARE
    parts = [
        np.linspace(start, stop, max(math.ceil((stop - start) / finest), 1) + 1)[1:]
        for start, stop in zip(np.append(0.0, wanted[:-1]), wanted, strict=True)
    ]
    return np.concatenate(parts)


def _gains(knots: Array, order: float) -> Array:
    """Return D^-order at knots[1:] by the values at the knots, linear in between: (n, n + 1)."""
    since = np.maximum(knots[1:, None] - knots[None, :], 0.0)
    powers = since**order / order
    higher = since ** (order + 1.0) / (order + 1.0)
    lengths = np.diff(knots)
    whole = powers[:, :-1] - powers[:, 1:]
    moment = higher[:, :-1] - higher[:, 1:]
    later = (since[:, :-1] * whole - moment) / lengths
    gains = np.zeros_like(since)
    gains[:, 1:] += later
    gains[:, :-1] += whole - later
    return gains / math.gamma(order)
