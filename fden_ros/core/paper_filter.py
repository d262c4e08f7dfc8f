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
or the outermost do. The blocks of the contact, of which a bounded number is kept, are filtered
again on it.

**Memory.** The relaxation kernel is a sum of exponentials (:mod:`fden_ros.core.law.relaxation`):
the past of a node is one number a rate.

Law errors, compliance and delay are not modelled. They raise chi squared, and above
:data:`MOST_CHI_SQUARED` nothing is claimed. Errors below the noise do not show, so a claim also
requires that law and rig are stated to be exact, except for the thickness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import InformationFilter

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import (
    NOTHING_UNKNOWN,
    CellInnovation,
    Estimate,
    Estimator,
    Evidence,
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

#: Chi squared per block [1] above which law, rig or noise differ from the filter's model.
MOST_CHI_SQUARED = 1.5
#: Nodes on each side of the middle of an axis, and the step of a new grid in deviations of the
#: posterior [1]: it covers 3.2 of them, and serves until they have shrunk to `_NARROW` steps.
_SIDE, _STEP, _NARROW = 4, 0.8, 0.6
#: Nodes that must count, 1 / sum w^2, and the most weight of the outermost [1].
_COUNTING, _EDGE = 4.0, 0.03
#: Variance of the posterior in squared steps, clipped: least, and most where the grid is to become
#: narrower, or wider.
_LEAST, _NARROWER, _WIDER = 0.05, (0.5 / _STEP) ** 2, (1.7 / _STEP) ** 2
#: Furthest centre of a grid from the prior's, in deviations of it [1].
_FURTHEST = 3.5
_ROUNDS = 12  #: new grids at one time at most
_RESTART = 0.5  #: share of the blocks that must come before a lost grid is laid anew [1]
_RUN = 16  #: blocks of a run
#: Standard deviations of the chi squared of runs above its mean above which nothing is claimed.
_MOST_RUNS = 4.0
_EVERY = 5  #: blocks after which the grid is looked at
_LEAST_BIAS = 1e-6  #: variance of a known bias over that of the noise [1]
_CAPACITY = 600  #: blocks that are kept of a contact; after them the grid stays
_OUTSIDE = 5.0  #: deviations before the contact point at which the approach begins [1]
_WAY = 12  #: most points of the approach
_POINTS = 4  #: points of the motion in a block at most
_SHALLOW = 1e-3  #: least compression at which the noise of the motion counts [1]
#: Relative deviation of the model error of a block's response [1].
_ERROR = 2e-4


class _Step(NamedTuple):
    """The exponential memory over one block of piecewise linear motion, the same for all nodes.

    Of c points, with shares of the block's samples.
    """

    compressions: Array  #: of the points [1], shape (c,)
    shares: Array  #: of the samples, shape (c,)
    by_memory: Array  #: of the mean response, by memory before, shape (RATE_COUNT,)
    by_rise: Array  #: and by the rise of p up to each point, shape (c, RATE_COUNT)
    by_rate: Array  #: and by that over the time it took [1/s], shape (c,)
    left: Array  #: of the memory after the block, shape (RATE_COUNT,)
    gained: Array  #: by it from each rise, shape (c, RATE_COUNT)


def _step(steps: Array, compressions: Array, shares: Array) -> _Step:
    """Return a block whose points come after times [s]."""
    times = np.cumsum(steps)
    decay = np.exp(-RATES * np.maximum(np.subtract.outer(times, times), 0.0)[..., None])
    decay *= np.tri(times.size)[..., None]
    y = RATES * steps[:, None]
    gain = -np.expm1(-y) / y
    passed = np.exp(-RATES * times[:, None])
    by_rise = np.tensordot(shares, decay, 1) * gain
    gained = decay[-1] * gain
    return _Step(
        compressions, shares, shares @ passed, by_rise, shares / steps, passed[-1], gained
    )


class _Bank(InformationFilter):
    """filterpy's InformationFilter of (G, b) for all nodes at once: P_inv = ((a, c), (c, q))."""

    def __init__(self, size: int, information: tuple[float, float]) -> None:
        super().__init__(dim_x=2, dim_z=1)
        self._g, self._gf = np.full(size, information[0]), np.zeros(size)
        self._gb = np.zeros(size)
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

    def solve(self) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Return G, b, their variances, chi squared and the log likelihood of each node."""
        det = self._g * self._b - self._gb**2
        g = (self._b * self._gf - self._gb * self._bf) / det
        b = (self._g * self._bf - self._gb * self._gf) / det
        chi2 = self._square - g * self._gf - b * self._bf
        return g, b, self._b / det, self._g / det, chi2, -0.5 * (chi2 + np.log(det))

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
        self._gn = np.exp(self.theta[:, 1])
        self.slices = places[0].size
        orders = self.theta[:: len(self.z) // self.slices, 0]
        self.is_possible = (self.theta[:, 0] >= LOWEST_ORDER) & (self.theta[:, 0] <= HIGHEST_ORDER)
        kernels = [relaxation_weights(a) for a in np.clip(orders, LOWEST_ORDER, HIGHEST_ORDER)]
        self._kernels = np.array(kernels)
        self._memory = np.zeros((len(self.z), RATE_COUNT))
        self._p = np.zeros(len(self.z))
        self.bank = _Bank(len(self.z), information)
        #: The same of means over runs of blocks, where a smooth misfit shows below the noise.
        self.runs = _Bank(len(self.z), (0.0, 0.0))
        self._run: list[Any] = [0.0] * 3
        width = np.abs(self.z).max(axis=0)
        self.is_outer = ((np.abs(self.z) == width) & (width > 0.0)).any(axis=1)

    def observe(self, stress: float, noise: float, response: Array) -> None:
        """Add the mean stress of a block [Pa], its variance and the response of each node."""
        self.bank.update(stress, noise, response)
        new: tuple[Any, ...] = 1.0, stress, response
        self._run = [one + own / noise for one, own in zip(self._run, new, strict=True)]
        if self.bank.count % _RUN == 0:
            weight, whole, own = self._run
            self.runs.update(whole / weight, 1.0 / weight, own / weight)
            self._run = [0.0] * 3

    def responses(self, compressions: Array) -> Array:
        """Return p = phi / G at points, shape (..., nodes)."""
        return phi(self.strains(compressions), 1.0, self._gn)

    def strains(self, compressions: Array) -> Array:
        """Return the strains of points, shape (..., nodes)."""
        sizes = compressions[..., None] - self.theta[:, 2]
        if self._geometry.is_one_sided:
            sizes = np.maximum(sizes, 0.0)
        return sizes if self._geometry.exponent == 1.0 else self._geometry.strains(sizes).values

    def begin(self, compression: float) -> None:
        """Begin at rest there."""
        self._p = self.responses(np.array(compression))

    def respond(self, step: _Step, p: Array) -> Array:
        """Add a block, with p (c, nodes) at its points; return the mean response r of each."""
        rises = p - np.concatenate([self._p[None], p[:-1]])
        kernels, count = self._kernels, self.slices
        memory = self._memory.reshape(count, -1, RATE_COUNT)
        found = memory @ (kernels[:, :RATE_COUNT] * step.by_memory)[..., None]
        by_rise = kernels[:, :RATE_COUNT] @ step.by_rise.T + kernels[:, -1:] * step.by_rate
        by_slice = rises.reshape(len(rises), count, -1)
        response = found[..., 0] + np.einsum("sc,csq->sq", by_rise, by_slice)
        response += kernels[:, -2:-1] * (step.shares @ p).reshape(count, -1)
        self._memory *= step.left
        self._memory += rises.T @ step.gained
        self._p = p[-1]
        return response.ravel()


class _Weighed(NamedTuple):
    """The results of a grid's nodes, each of shape (nodes,)."""

    weights: Array  #: they add up to 1
    log_weights: Array
    log_g: Array  #: mean of ln G
    log_g_variance: Array
    bias: Array  #: mean of b [Pa]
    bias_variance: Array  #: [Pa^2]
    chi_squared: Array  #: of all blocks


class PaperFilter(Estimator):
    """The paper's filter of one site: of its first contact, up to the lift-off.

    It claims nothing of a later contact, which meets tissue that still recovers.
    """

    def __init__(self, setting: Setting) -> None:
        config, geometry, noise_sd, origin_sd, path_variance = setting
        prior = config.prior
        self._is_exact = replace(config.uncertainty, thickness_sd=0.0) == NOTHING_UNKNOWN
        self._config, self._geometry = config, geometry
        self._noise_variance, self._path_variance = noise_sd**2, path_variance
        log_g, log_gn, order = prior.mean.tolist()
        log_g_sd, log_gn_sd, order_sd = prior.deviations.tolist()
        self._mean = np.array([order, log_gn, 0.0])
        self._sd = np.array([order_sd, log_gn_sd, origin_sd])
        self._log_g, self._log_g_sd = log_g, log_g_sd
        self._wide = np.flatnonzero(self._sd > 0.0)
        #: Of (G, b) before the touch: G is all but unknown, as its own prior counts later.
        self._information = math.exp(-2.0 * (log_g + 3.0 * log_g_sd)), 1.0
        self._contact_count = self._sample_count = 0
        self._is_over, self._is_settled, self._is_refused = False, True, False
        self._blocks: list[tuple[_Step, float, float]] = []
        self._weighed: _Weighed
        self.innovation: CellInnovation | None = None
        self._time = self._deepest = 0.0
        self._next_look = self._restart = 0  #: at the grid, and from the prior's: counts of blocks
        self._point = -SHORTEST_STEP  #: time of the newest point of the motion [s]
        self._start = -math.inf  #: compression at which it begins, in the air [1]
        self._lay(self._mean, np.diag(_STEP * self._sd))

    @property
    def is_mismatch(self) -> bool:
        """Whether law, rig or noise are not as the filter has them, by the newest grid."""
        return self._is_refused

    @property
    def _is_contradicted(self) -> bool:
        """Whether chi squared is too large for the noise."""
        grid, found = self._grid, self._weighed
        best, runs = int(found.weights.argmax()), grid.runs
        if found.chi_squared[best] > MOST_CHI_SQUARED * grid.bank.count:
            return True
        misfit = runs.misfit(math.exp(found.log_g[best]), found.bias[best], best)
        return misfit > runs.count + _MOST_RUNS * math.sqrt(2.0 * runs.count)

    # Samples

    def touch(self, onset: Touch, pause: float) -> None:
        """Begin with the approach, as far back as the touch may have been."""
        self._contact_count += 1
        self._is_over = self._contact_count > 1
        self.innovation = None
        if self._is_over:
            return
        least = _LEAST_BIAS * self._noise_variance
        self._information = self._information[0], 1.0 / max(onset.bias_sd**2, least)
        way = onset.approach
        outside = np.flatnonzero(way[1] < -_OUTSIDE * self._sd[2])
        own = way[:, outside[-1] if outside.size else 0 :]
        if own.size:
            own = own[:, own[1].argmin() :]
            self._point, self._start = own[:2, 0].tolist()
        self._lay(self._mean, np.diag(_STEP * self._sd))
        for part in np.array_split(own[:, 1:], min(_WAY, max(own.shape[1] - 1, 1)), axis=1):
            if part.size:
                self._pass(part[0], part[1], float(part[2].mean()))

    def add(
        self,
        times: Sequence[float],
        indentation: Sequence[float],
        stress: Sequence[float],
        on_tissue: Sequence[bool],
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

    def _pass(self, times: Array, places: Array, stress: float) -> CellInnovation:
        """Add the motion of a block and its mean stress [Pa]."""
        grid, before = self._grid, self._weighed
        step = self._step_of(times, places)
        p = grid.responses(step.compressions)
        response = grid.respond(step, p)
        noise = self._noise_variance / times.size + self._missed(times, places, stress)
        grid.observe(stress, noise, response)
        self._weighed = self._weigh()
        if len(self._blocks) < _CAPACITY:
            self._blocks.append((step, stress, noise))
            # In the air, before the first sample of the contact, all nodes behind the probe are as
            # likely: a grid that follows them loses the touch.
            is_coarse = self._is_settled and not self._resolves
            if self._sample_count and (is_coarse or len(self._blocks) >= self._next_look):
                self._follow()
                later = _EVERY if self._is_settled else _RESTART * len(self._blocks)
                self._next_look = len(self._blocks) + math.ceil(later)
                self._is_refused = self._is_contradicted
        g = np.exp(before.log_g)
        stresses = g * response + before.bias
        predicted = float(before.weights @ stresses)
        spread = before.log_g_variance * (g * response) ** 2 + (stresses - predicted) ** 2
        variance = noise + float(before.weights @ spread)
        return CellInnovation(predicted, stress - predicted, variance)

    def _missed(self, times: Array, places: Array, stress: float) -> float:
        """Return the variance of a block's stress by the noise of the motion and the response.

        The stress follows the motion by the larger of Gn and 1 / x, and fast motion has relaxed
        less.
        """
        order, log_gn, origin = self._weighed.weights @ self._grid.theta
        depth = max(float(places.mean() - origin), _SHALLOW)
        slope = self._geometry.strain_slope(depth)
        by_motion = slope * max(math.exp(log_gn), 1.0 / self._geometry.strain(depth))
        lasted = max(float(times[-1] - times[0]), SHORTEST_STEP) * times.size / (times.size - 0.9)
        age = max(self._time, lasted)
        noise = self._path_variance / lasted * (age / lasted) ** (2.0 * order)
        return float(stress**2 * (_ERROR**2 + by_motion**2 * noise))

    def _step_of(self, times: Array, places: Array) -> _Step:
        """Return the motion of a block, by means over a few parts of it."""
        bounds = np.arange(min(_POINTS, times.size)) * times.size // min(_POINTS, times.size)
        sizes = np.diff(bounds, append=times.size)
        ends, points = (np.add.reduceat(values, bounds) / sizes for values in (times, places))
        steps = np.maximum(np.diff(ends, prepend=self._point), SHORTEST_STEP)
        self._point = float(ends[-1])
        return _step(steps, points, sizes / times.size)

    # Nodes

    def _lay(self, centre: Array, axes: Array) -> None:
        """Lay a grid, and filter the blocks so far on it."""
        grid = self._grid = _Grid(centre, axes, self._geometry, self._information)
        off = (grid.theta - self._mean)[:, self._wide] / self._sd[self._wide]
        is_possible = grid.is_possible & (grid.theta[:, 2] >= self._start)
        self._log_prior = np.where(is_possible, -0.5 * (off**2).sum(axis=1), -math.inf)
        grid.begin(self._start)
        if self._blocks:
            points = [step.compressions for step, _, _ in self._blocks]
            ends = np.cumsum([own.size for own in points])
            parts = np.split(grid.responses(np.concatenate(points)), ends[:-1])
            for p, (step, stress, noise) in zip(parts, self._blocks, strict=True):
                grid.observe(stress, noise, grid.respond(step, p))
        self._weighed = self._weigh()

    def _weigh(self) -> _Weighed:
        """Return the nodes' results, with the prior of ln G."""
        grid = self._grid
        g, bias, g_variance, bias_variance, chi2, log_weights = grid.bank.solve()
        # While G is unknown, the prior decides.
        at = np.maximum(g, np.sqrt(g_variance))
        mean, variance, prior_variance = np.log(at), g_variance / at**2, self._log_g_sd**2
        total, off = variance + prior_variance, self._log_g - mean
        log_weights += self._log_prior - mean - 0.5 * (off**2 / total + np.log(total))
        log_weights -= log_weights.max()
        return _Weighed(
            normalized(log_weights),
            log_weights,
            mean + variance / total * off,
            variance / total * prior_variance,
            bias,
            bias_variance,
            chi2,
        )

    @property
    def _resolves(self) -> bool:
        """Whether enough nodes count, along each axis, and the outermost do not."""
        weights, z = self._weighed.weights, self._grid.z[:, self._wide]
        off = z - weights @ z
        narrowest = np.linalg.eigvalsh((off * weights[:, None]).T @ off)[0]
        is_inside = weights @ self._grid.is_outer <= _EDGE
        return bool(_count(weights) >= _COUNTING and narrowest >= _NARROW**2 and is_inside)

    def _follow(self) -> None:
        """Lay new grids until enough nodes count and the outermost do not."""
        wide = np.ix_(self._wide, self._wide)
        if self._is_contradicted and len(self._blocks) >= self._restart:
            self._restart = math.ceil((1.0 + _RESTART) * len(self._blocks))
            self._lay(self._mean, np.diag(_STEP * self._sd))
        for _ in range(_ROUNDS):
            grid, logs = self._grid, self._weigh().log_weights
            weights, is_few = normalized(logs), False
            while _count(weights) < _COUNTING:
                is_few, logs = True, 0.5 * logs
                weights = normalized(logs)
            best = int(logs.argmax())
            middle = grid.z[best] if is_few else weights @ grid.z
            off = grid.z - middle
            values, vectors = np.linalg.eigh(((off * weights[:, None]).T @ off)[wide])
            self._is_settled = (
                not is_few and values[0] >= _NARROW**2 and weights @ grid.is_outer <= _EDGE
            )
            if self._is_settled:
                return
            # Around a single node that counts: narrower each time, unless it lies at the edge.
            most = _NARROWER if is_few and not grid.is_outer[best] else _WIDER
            root = np.zeros((3, 3))
            root[wide] = np.linalg.cholesky((vectors * np.clip(values, _LEAST, most)) @ vectors.T)
            reach, centre = _FURTHEST * self._sd, grid.centre + grid.axes @ middle
            centre = np.clip(centre, self._mean - reach, self._mean + reach)
            self._lay(centre, _STEP * grid.axes @ root)
        self._lay(self._mean, np.diag(_STEP * self._sd))

    # Result

    def estimate(self) -> Estimate:
        """Return the moments of the weighted nodes, and what may be claimed of them."""
        config, found, grid = self._config, self._weighed, self._grid
        values = np.column_stack([found.log_g, grid.theta[:, [1, 0, 2]]])
        mean = found.weights @ values
        off = values - mean
        covariance = (off * found.weights[:, None]).T @ off
        covariance = 0.5 * (covariance + covariance.T)
        covariance[0, 0] += found.weights @ found.log_g_variance
        covariance[:2, :2] += config.uncertainty.thickness_sd**2
        deviations = np.sqrt(covariance.diagonal())
        strains = grid.strains(np.array(self._deepest))
        beyond = float(found.weights @ (strains * np.exp(grid.theta[:, 1]) > 1.0))
        is_first = self._contact_count < 2
        is_settled = self._is_settled and self._resolves
        is_sound = self._is_exact and is_settled and is_first and not self._is_refused
        claims = claims_of(config, Evidence(mean[:3], deviations[:3], beyond, is_sound))
        return Estimate(
            log_linear_stiffness=float(mean[0]),
            log_nonlinear_stiffness=float(mean[1]),
            fractional_order=float(mean[2]),
            covariance=covariance[:3, :3],
            contact_point=float(mean[3]),
            contact_point_sd=float(deviations[3]),
            probability_beyond_boundary=beyond,
            observable=claims.observable,
            known=claims.known,
            at_edge=claims.at_edge,
            sample_count=self._sample_count,
            with_origin=tuple(covariance[3, :3].tolist()),
        )


def normalized(log_weights: Array) -> Array:
    """Return weights that add up to 1."""
    weights: Array = np.exp(log_weights)
    return weights / weights.sum()


def _count(weights: Array) -> float:
    """Return how many nodes count."""
    return 1.0 / float(weights @ weights)
