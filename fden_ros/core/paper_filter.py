# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The paper's recursion (``estimator.kind: ekf``): Kalman filters on the whitened stress.

**Whitening.** The paper observes :math:`D^{-\alpha} f = G\,p(x; G_n) + D^{-\alpha} v`, with
:math:`p = \varphi / G`. The integrated noise is correlated over the whole press. Its whitening
filter is known, causal, and is :math:`D^\alpha`. Whitened, the same observation is

.. math:: f_k = G\,r_k + b + v_k, \qquad r = D^\alpha p, \qquad v_k \sim N(0, R_k)

with b the bias of the sensor.

**Nodes.** Given :math:`\theta = (\alpha, \ln G_n, o)`, o the contact point, this is linear in
(G, b), which are constant. Each node has a Kalman filter of these two states without process
noise, so nothing is linearised far from the truth (Rao-Blackwellised point-mass filter: Bucy and
Senne 1971). The weight of a node is its prior times the likelihood of its innovations.

**Grid.** :math:`\theta = c + A z` with a product grid of z and A triangular, alpha first: nodes of
one alpha share their kernel. A new grid is laid along the posterior's axes where few nodes count
or the outermost do, and the blocks of the contact are filtered again on it.

Law errors, compliance and delay are not modelled. They raise chi squared, and where it is too
large nothing is claimed. Errors below the noise do not show, so a claim also requires that law and
rig are stated to be exact, except for the thickness.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from filterpy.kalman import InformationFilter

from fden_ros.core.arrays import CLEAR, NOT_BY_CHANCE, Array
from fden_ros.core.estimation import (
    MOST_BLOCKS,
    NOTHING_UNKNOWN,
    Estimate,
    Estimator,
    Innovation,
    Setting,
    Touch,
    claims_of,
)
from fden_ros.core.law import (
    HIGHEST_ORDER,
    LOWEST_ORDER,
    RATE_COUNT,
    RATES,
    SHORTEST_STEP,
    Geometry,
    phi,
    relaxation_weights,
)
from fden_ros.core.parameter import TINY

#: Chi squared per block [1] above which law, rig or noise differ from the filter's model.
_MOST_CHI_SQUARED = 1.5
#: Blocks of a run, over which a smooth misfit shows below the noise.
_RUN = 16
#: Nodes on each side of the middle of an axis, and the step of a new grid in deviations of the
#: posterior [1]: it covers 3.2 of them, and serves until they have shrunk to `_NARROW` steps.
_SIDE, _STEP, _NARROW = 4, 0.8, 0.6
#: Nodes that must count, 1 / sum w^2, and the most weight of the outermost [1].
_COUNTING, _EDGE = 4.0, 0.03
#: Variance of the posterior that a new grid is laid for, in squared steps: least, and most about a
#: single node.
_LEAST, _MOST = 0.05, 0.4
_ROUNDS = 12  #: new grids at one time at most
_POINTS = 6  #: points of the motion in a block at most, and blocks of the approach
_SHALLOW = 1e-3  #: least compression at which the noise of the motion counts [1]
#: Relative deviation of the model error of a block's response [1].
_ERROR = 2e-4


@dataclass(frozen=True, eq=False)
class _Block:
    """Piecewise linear motion, and the mean stress over it."""

    steps: Array  #: times between the points [s], shape (c,)
    compressions: Array  #: at the points [1], shape (c,)
    shares: Array  #: of the samples, by point, shape (c,)
    stress: float  #: [Pa]
    noise: float  #: its variance [Pa^2]

    @functools.cached_property
    def memory(self) -> tuple[Array, Array, Array]:
        """Decay of the past at the points, (c, rates), of their rises, (c, c, rates), and gain."""
        times = np.cumsum(self.steps)
        decay = np.exp(-RATES * np.maximum(np.subtract.outer(times, times), 0.0)[..., None])
        decay *= np.tri(times.size)[..., None]
        y = RATES * self.steps[:, None]
        return np.exp(-RATES * times[:, None]), decay, -np.expm1(-y) / y


class _Bank(InformationFilter):
    """filterpy's InformationFilter of (G, b) for all nodes at once: P_inv = ((a, c), (c, q))."""

    def __init__(self, size: int, information: tuple[float, float]) -> None:
        super().__init__(dim_x=2, dim_z=1)
        self._g, self._gb, self._gf = np.full(size, information[0]), np.zeros(size), np.zeros(size)
        self._b, self._bf, self._square = information[1], 0.0, 0.0
        self.count = 0

    def update(self, z: float, R: float, response: Array) -> None:
        """Add one block, H = (response, 1): P^-1 <- P^-1 + H'H/R, P^-1 x <- P^-1 x + H'z/R."""
        weighed = response / R
        self._g += weighed * response
        self._gb += weighed
        self._gf += weighed * z
        self._b += 1.0 / R
        self._bf += z / R
        self._square += z * z / R
        self.count += 1

    def solve(self) -> tuple[Array, Array, Array, Array, Array]:
        """Return G, b, the variance of G, chi squared and the log likelihood of each node."""
        det = self._g * self._b - self._gb**2
        g = (self._b * self._gf - self._gb * self._bf) / det
        b = (self._g * self._bf - self._gb * self._gf) / det
        chi2 = self._square - g * self._gf - b * self._bf
        return g, b, self._b / det, chi2, -0.5 * (chi2 + np.log(det))

    def misfit(self, g: float, b: float, node: int) -> float:
        """Return chi squared at a node for a given state."""
        linear = g * self._gf[node] + b * self._bf - g * b * self._gb[node]
        return float(self._square - 2.0 * linear + g * g * self._g[node] + b * b * self._b)


class _Grid:
    """Nodes of theta = (alpha, ln Gn, contact point), the memory of each, and their filters."""

    def __init__(
        self, centre: Array, axes: Array, geometry: Geometry, information: tuple[float, float]
    ) -> None:
        line = np.arange(-_SIDE, _SIDE + 1.0)
        #: Of each axis, one place where it has no width.
        places = [line if axes[i, i] > 0.0 else np.zeros(1) for i in range(3)]
        self.z = np.stack(np.meshgrid(*places, indexing="ij"), -1).reshape(-1, 3)
        self.centre, self.axes, self._geometry = centre, axes, geometry
        self.theta = centre + self.z @ axes.T
        self.gn = np.exp(self.theta[:, 1])
        self.is_outer = ((np.abs(self.z) == _SIDE) & (np.ptp(self.z, axis=0) > 0.0)).any(axis=1)
        by_order = self.theta[:, 0].reshape(places[0].size, -1)
        orders = np.clip(by_order[:, 0], LOWEST_ORDER, HIGHEST_ORDER)
        self._kernels = np.array([relaxation_weights(order) for order in orders])
        self._memory = np.zeros((*by_order.shape, RATE_COUNT))
        self._p = np.zeros(by_order.size)
        self.bank = _Bank(by_order.size, information)
        #: The same of means over runs of blocks, where a smooth misfit shows below the noise.
        self.runs = _Bank(by_order.size, (0.0, 0.0))
        self._run = np.zeros(2 + by_order.size)

    def strains(self, compressions: Array) -> Array:
        """Return the strains of points, shape (..., nodes)."""
        sizes = compressions[..., None] - self.theta[:, 2]
        if self._geometry.is_one_sided:
            sizes = np.maximum(sizes, 0.0)
        return sizes if self._geometry.exponent == 1.0 else self._geometry.strains(sizes).values

    def begin(self, compression: float) -> None:
        """Begin at rest there."""
        self._p = phi(self.strains(np.array(compression)), 1.0, self.gn)

    def add(self, block: _Block) -> Array:
        """Add a block to all nodes; return their mean responses r."""
        response = self._respond(block)
        self.bank.update(block.stress, block.noise, response)
        self._run += np.append([1.0, block.stress], response) / block.noise
        if self.bank.count % _RUN == 0:
            weight, whole, *_ = self._run
            self.runs.update(whole / weight, 1.0 / weight, self._run[2:] / weight)
            self._run[:] = 0.0
        return response

    def _respond(self, block: _Block) -> Array:
        """Return the mean responses over a block.

        The past of a node is one number per rate, because the kernel is a sum of exponentials
        (:mod:`fden_ros.core.law.relaxation`).
        """
        passed, decay, gain = block.memory
        p = phi(self.strains(block.compressions), 1.0, self.gn)
        rises, by_rate = np.diff(p, axis=0, prepend=self._p[None]), self._kernels[:, :RATE_COUNT]
        slow, fast = self._kernels[:, RATE_COUNT:, None].swapaxes(0, 1)
        count = len(by_rate)
        found = self._memory @ (by_rate * (block.shares @ passed))[..., None]
        by_rise = by_rate @ (np.tensordot(block.shares, decay, 1) * gain).T
        by_rise += fast * (block.shares / block.steps)
        response = found[..., 0] + np.einsum(
            "sc,csq->sq", by_rise, rises.reshape(len(p), count, -1)
        )
        response += slow * (block.shares @ p).reshape(count, -1)
        self._memory *= passed[-1]
        self._memory += (rises.T @ (decay[-1] * gain)).reshape(self._memory.shape)
        self._p = p[-1]
        return response.ravel()


class _Weighed(NamedTuple):
    """The results of a grid's nodes, each of shape (nodes,)."""

    weights: Array  #: they add up to 1
    log_weights: Array
    log_g: Array  #: mean of ln G
    log_g_variance: Array
    bias: Array  #: mean of b [Pa]
    chi_squared: Array  #: of all blocks


class PaperFilter(Estimator):
    """The paper's filter of one site: of its first contact, up to the lift-off.

    It claims nothing of a later contact, which meets tissue that still recovers.
    """

    #: Whether law, rig or noise are not as the filter has them, by the newest grid.
    is_mismatch = False

    def __init__(self, setting: Setting) -> None:
        self._setting, prior = setting, setting.config.prior
        self._is_exact = replace(setting.config.uncertainty, thickness_sd=0.0) == NOTHING_UNKNOWN
        self._log_g, log_gn, order = prior.mean.tolist()
        self._log_g_sd, log_gn_sd, order_sd = prior.deviations.tolist()
        self._mean = np.array([order, log_gn, 0.0])
        self._sd = np.array([order_sd, log_gn_sd, setting.contact_point_sd])
        self._wide = np.flatnonzero(self._sd > 0.0)
        self._contact_count, self._is_over, self._is_settled = 0, False, True
        self._blocks: list[_Block] = []
        self._grid: _Grid  # from the touch on
        self._weighed: _Weighed
        self._time = self._deepest = 0.0
        self._sample_count = self._next_look = 0  # a count of blocks: then the grid is looked at
        self._point = -SHORTEST_STEP  # time of the newest point of the motion [s]
        self._start = -math.inf  # compression at which it begins, in the air [1]

    # Samples

    def touch(self, onset: Touch, pause: float) -> None:
        """Begin with the approach, as far back as the touch may have been."""
        self.innovation = None
        self._contact_count += 1
        self._is_over = self._contact_count > 1
        if self._is_over:
            return
        # G is all but unknown, as its own prior counts later.
        least = math.exp(-2.0 * (self._log_g + 3.0 * self._log_g_sd))
        self._information = least, max(onset.bias_sd, TINY) ** -2
        way = onset.approach
        outside = np.flatnonzero(way[1] < -NOT_BY_CHANCE * self._sd[2])
        own = way[:, outside[-1] if outside.size else 0 :]
        if own.size:
            own = own[:, own[1].argmin() :]
            self._point, self._start = own[:2, 0].tolist()
        self._restart()
        for part in np.array_split(own[:, 1:], min(_POINTS, max(own.shape[1] - 1, 1)), axis=1):
            if part.size:
                self._pass(part[0], part[1], float(part[2].mean()))

    def add(
        self,
        times: Sequence[float],
        indentation: Sequence[float],
        stress: Sequence[float],
        on_tissue: Sequence[bool],
        *,
        is_behind: bool = False,
    ) -> Estimate:
        """Add a block up to the lift-off; see :meth:`~.estimation.Estimator.add`."""
        self._is_over |= not all(on_tissue)
        self.innovation = None
        if not self._is_over:
            self._time = times[-1]
            self._sample_count += len(times)
            places = np.array(indentation)
            self._deepest = max(self._deepest, float(places.mean()))
            self.innovation = self._pass(np.array(times), places, float(np.mean(stress)))
        return self.estimate()

    def release(self) -> Estimate:
        """End the contact."""
        self._is_over = True
        return self.estimate()

    def _pass(self, times: Array, places: Array, stress: float) -> Innovation:
        """Add the motion of a block and its mean stress [Pa]."""
        before, block = self._weighed, self._block_of(times, places, stress)
        response = self._grid.add(block)
        self._weighed = self._weigh()
        if len(self._blocks) < MOST_BLOCKS:
            self._blocks.append(block)
            # In the air, before the first sample of the contact, all nodes behind the probe are as
            # likely: a grid that follows them loses the touch.
            if self._sample_count and len(self._blocks) >= self._next_look:
                self._follow()
                self._next_look = len(self._blocks) * (1 if self._is_settled else 2)
                self.is_mismatch = self._is_contradicted()
        stresses = np.exp(before.log_g) * response
        spread = before.log_g_variance * stresses**2
        stresses += before.bias
        predicted = float(before.weights @ stresses)
        variance = block.noise + float(before.weights @ (spread + (stresses - predicted) ** 2))
        return Innovation(predicted, stress - predicted, variance)

    def _block_of(self, times: Array, places: Array, stress: float) -> _Block:
        """Return a block with the motion by means over a few parts of it."""
        bounds = np.arange(min(_POINTS, times.size)) * times.size // min(_POINTS, times.size)
        sizes = np.diff(bounds, append=times.size)
        ends, points = (np.add.reduceat(values, bounds) / sizes for values in (times, places))
        steps = np.maximum(np.diff(ends, prepend=self._point), SHORTEST_STEP)
        self._point = float(ends[-1])
        noise = self._setting.noise_sd**2 / times.size + self._missed(times, places, stress)
        return _Block(steps, points, sizes / times.size, stress, noise)

    def _missed(self, times: Array, places: Array, stress: float) -> float:
        """Return the variance of a block's stress by the noise of the motion and the response.

        The stress follows the motion by the larger of Gn and 1 / x, and fast motion has relaxed
        less.
        """
        geometry = self._setting.geometry
        order, log_gn, origin = self._weighed.weights @ self._grid.theta
        depth = max(float(places.mean() - origin), _SHALLOW)
        by_motion = max(math.exp(log_gn), 1.0 / geometry.strain(depth))
        by_motion *= geometry.strain_slope(depth)
        lasted = max(float(times[-1] - times[0]), SHORTEST_STEP) * times.size / (times.size - 0.9)
        age = max(self._time, lasted)
        noise = self._setting.path_variance / lasted * (age / lasted) ** (2.0 * order)
        return float(stress**2 * (_ERROR**2 + by_motion**2 * noise))

    def _is_contradicted(self) -> bool:
        """Return whether chi squared is too large for the noise."""
        found, runs = self._weighed, self._grid.runs
        best = int(found.weights.argmax())
        misfit = runs.misfit(math.exp(found.log_g[best]), found.bias[best], best)
        most = runs.count + NOT_BY_CHANCE * math.sqrt(2.0 * runs.count)
        is_loud = found.chi_squared[best] > _MOST_CHI_SQUARED * self._grid.bank.count
        return bool(is_loud or misfit > most)

    # Nodes

    def _restart(self) -> None:
        """Lay a grid over the prior."""
        self._lay(self._mean, np.diag(_STEP * self._sd))

    def _lay(self, centre: Array, axes: Array) -> None:
        """Lay a grid, and filter the blocks so far on it."""
        grid = self._grid = _Grid(centre, axes, self._setting.geometry, self._information)
        off = (grid.theta - self._mean)[:, self._wide] / self._sd[self._wide]
        # The contact point lies in the motion.
        low, high = [LOWEST_ORDER, -math.inf, self._start], [HIGHEST_ORDER, math.inf, math.inf]
        is_possible = ((grid.theta >= low) & (grid.theta <= high)).all(axis=1)
        self._log_prior = np.where(is_possible, -0.5 * (off**2).sum(axis=1), -math.inf)
        if math.isfinite(self._start):  # else from rest, without a load
            grid.begin(self._start)
        for block in self._blocks:
            grid.add(block)
        self._weighed = self._weigh()

    def _weigh(self) -> _Weighed:
        """Return the nodes' results, with the prior of ln G."""
        grid = self._grid
        g, bias, g_variance, chi2, log_weights = grid.bank.solve()
        # While G is unknown, the prior decides.
        at = np.maximum(g, np.sqrt(g_variance))
        mean, variance, prior_variance = np.log(at), g_variance / at**2, self._log_g_sd**2
        total, off = variance + prior_variance, self._log_g - mean
        log_weights += self._log_prior - mean - 0.5 * (off**2 / total + np.log(total))
        log_weights -= log_weights.max()
        share, weights = variance / total, _normalized(log_weights)
        return _Weighed(
            weights, log_weights, mean + share * off, share * prior_variance, bias, chi2
        )

    def _follow(self) -> None:
        """Lay new grids until enough nodes count, along each axis, and the outermost do not."""
        wide = np.ix_(self._wide, self._wide)
        for _ in range(_ROUNDS):
            grid, logs = self._grid, self._weighed.log_weights
            weights, is_few = _normalized(logs), False
            while 1.0 / float(weights @ weights) < _COUNTING:
                is_few, logs = True, 0.5 * logs
                weights = _normalized(logs)
            best = int(logs.argmax())
            middle = grid.z[best] if is_few else weights @ grid.z
            off = grid.z - middle
            values, vectors = np.linalg.eigh(((off * weights[:, None]).T @ off)[wide])
            is_inside = weights @ grid.is_outer <= _EDGE
            self._is_settled = bool(not is_few and values[0] >= _NARROW**2 and is_inside)
            if self._is_settled:
                return
            # Narrower each time about a single node that counts, unless it lies at the edge.
            most = _MOST if is_few and not grid.is_outer[best] else math.inf
            root = np.zeros((3, 3))
            root[wide] = np.linalg.cholesky((vectors * np.clip(values, _LEAST, most)) @ vectors.T)
            reach, centre = CLEAR * self._sd, grid.centre + grid.axes @ middle
            centre = np.clip(centre, self._mean - reach, self._mean + reach)
            self._lay(centre, _STEP * grid.axes @ root)
        self._restart()

    # Result

    def estimate(self) -> Estimate:
        """Return the moments of the weighted nodes, and what may be claimed of them."""
        config, found, grid = self._setting.config, self._weighed, self._grid
        values = np.column_stack([found.log_g, grid.theta[:, [1, 0, 2]]])
        mean = found.weights @ values
        off = values - mean
        covariance = (off * found.weights[:, None]).T @ off
        covariance = 0.5 * (covariance + covariance.T)
        covariance[0, 0] += found.weights @ found.log_g_variance
        covariance[:2, :2] += config.uncertainty.thickness_sd**2
        deviations = np.sqrt(covariance.diagonal())
        beyond = float(found.weights @ (grid.strains(np.array(self._deepest)) * grid.gn > 1.0))
        is_sound = self._is_exact and self._is_settled and not self.is_mismatch
        is_sound &= self._contact_count < 2
        claims = claims_of(config, mean[:3], deviations[:3], beyond, is_solved=is_sound)
        return Estimate(
            log_linear_stiffness=float(mean[0]),
            log_nonlinear_stiffness=float(mean[1]),
            fractional_order=float(mean[2]),
            covariance=covariance[:3, :3],
            contact_point=float(mean[3]),
            contact_point_sd=float(deviations[3]),
            probability_beyond_boundary=beyond,
            **claims._asdict(),
            sample_count=self._sample_count,
            with_origin=tuple(covariance[3, :3].tolist()),
            is_settled=is_sound,
        )


def _normalized(log_weights: Array) -> Array:
    """Return weights that add up to 1."""
    weights: Array = np.exp(log_weights)
    return weights / weights.sum()
