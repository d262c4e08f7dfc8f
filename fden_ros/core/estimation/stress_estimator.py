r"""Recursive estimation on the stress itself: relinearised at every block, in constant memory.

The observation is the mean stress of a block,

.. math::
    f_k = \bigl(D^\alpha \varphi(x(u - o); G, G_n)\bigr)_k + b + c\,(t_k - t_0) + v_k,

with white :math:`v_k`, the strain origin o, and the force's bias b and drift c as nuisances.
:mod:`fden_ros.core.law.stress_response` gives the response at nodes of ln Gn, alpha and o, so
the sum of squares of any parameters is a quadratic form in the sums at the nodes
(:mod:`fden_ros.core.estimation.normal_equations`). From it follows the maximum of the posterior by
Gauss-Newton steps, started at the last one: an iterated extended Kalman filter in information form
whose linearisation is never out of date.

While Gn is not yet observable, its posterior is not normal. Then the other parameters are solved
for at every node of ln Gn, and the nodes weighed by their evidence (Laplace's approximation at
each node): a Gaussian sum.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from fden_ros.core.estimation.estimate import (
    Block,
    Estimate,
    EstimatorConfig,
    Innovation,
    StateIndex,
)
from fden_ros.core.estimation.innovation_monitor import CHANGE_DEVIATIONS
from fden_ros.core.estimation.motion_noise import MotionNoise
from fden_ros.core.estimation.normal_equations import BlockResponse, NormalEquations
from fden_ros.core.estimation.state_prior import StatePrior
from fden_ros.core.estimation.tissue_change import Change, TissueChange
from fden_ros.core.law.characteristic import elastic_response
from fden_ros.core.law.geometry import Geometry
from fden_ros.core.law.interpolation import LOG_SPACING, LogStiffnessGrid
from fden_ros.core.law.kernel import HIGHEST_ORDER, LOWEST_ORDER, order_interpolation
from fden_ros.core.law.stress_response import StressBasis

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_LOG_G = StateIndex.LOG_LINEAR_STIFFNESS
_LOG_GN = StateIndex.LOG_NONLINEAR_STIFFNESS
_ORDER = StateIndex.FRACTIONAL_ORDER
_ORIGIN = StateIndex.STRAIN_ORIGIN
_BIAS, _DRIFT, _PULSE = StateIndex.BIAS, StateIndex.DRIFT, StateIndex.PULSE
#: Parameters that enter the stress linearly, in the order of the state: those of one contact, and
#: the pulse of a change of the tissue.
_LINEAR = ("bias", "drift", "pulse")

#: Half the range of the nodes of ln Gn: in prior standard deviations [1], and at most [1]. Beyond
#: four deviations lie 6e-5 of the prior; a factor of e^2 either way holds all tissue.
_GRID_DEVIATIONS, _WIDEST_GRID = 4.0, 2.0
#: Distance of the outer nodes of the strain origin from 0: in its standard deviations [1], and at
#: least [1]: nodes too close would make the parabola through them ill-conditioned.
_ORIGIN_REACH, _LEAST_ORIGIN_REACH = 2.0, 0.003
#: Standard deviation of ln Gn [1] below which the posterior is taken for normal, and above which
#: it no longer is: narrower than the nodes' distance their sum does not resolve it. Two values, so
#: that it does not go to and fro.
_UNIMODAL, _MULTIMODAL = 0.6 * LOG_SPACING, 0.9 * LOG_SPACING
#: Longest change of (ln G, ln Gn, alpha, o) in a step [1]: the range over which the response is
#: nearly linear in each. A linear parameter changes by no more than its reach. (A step solved for
#: all together, of which only some are cut short, is too long for the others: without a bound of
#: their own they run away.)
_LONGEST_STEP = (1.0, 0.3, 0.05, 0.02)
#: Prior deviations [1] within which the origin and the linear parameters stay: in the golden bags
#: no node of ln Gn, however unlikely, asks for more than 25.
_REACH_DEVIATIONS = 100.0
#: Steps of a solution at most [1]: of one state, and of the nodes.
_MOST_STEPS, _MOST_NODE_STEPS = 10, 3
#: Times [1] that the nodes are given these steps while they have not converged.
_MOST_ROUNDS = 4
#: Blocks [1] after which the posterior is solved for anew while it is not normal, and while it is:
#: then an extended Kalman filter goes on from the last solution in between.
_MULTIMODAL_BLOCKS, _UNIMODAL_BLOCKS = 4, 10
#: Steps end when the last one lowered minus twice the log-posterior by less than this [1]: a tenth
#: of a standard deviation.
_CLOSE = 0.01
#: A solution whose last step lowered it by more than this [1] has not converged, and is not
#: believed. (Good data end below 0.01.)
_FAR = 1.0
#: Weight [1] below which a node does not count.
_LEAST_WEIGHT = 1e-6
#: Added to a standard deviation of ln Gn [1] that may be 0, before it divides.
_TINY_DEVIATION = 1e-12
#: Eigenvalues of a scaled Hessian [1] below this are rounding.
_SINGULAR = 1e-11
#: Distance from the prior [1] at which ln G stops: a factor of 160,000 either way is no tissue.
_LOG_REACH = 12.0
#: Standard deviation of a change of ln G [1]: a lesion is up to several times stiffer than what is
#: around it.
_CHANGE_OF_LOG_G = 1.0
#: Least time [s] between a change and the block that proves it.
_SHORTEST_PULSE = 0.002
#: Deviation of the pulse of phi at a change [1], as a share of the fractional stress.
_PULSE_SHARE = 2.0


class _Steps(NamedTuple):
    """Gauss-Newton steps from m states."""

    steps: Array  #: shape (m, n); 0 where there is no solution
    inverses: Array  #: of the Hessians, shape (m, free, free)
    log_determinants: Array  #: of the Hessians, shape (m,)
    decrements: Array  #: of minus twice the log-posterior, shape (m,); infinite without a solution


class StressEstimator:
    """The posterior on the stress.

    Parameters
    ----------
    config : EstimatorConfig
    geometry : Geometry
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    origin_sd : float
        Standard deviation of the strain origin [1]; 0: known.
    motion_noise : float
        Variance of the compression's noise per sample times the time between samples [s].
    """

    def __init__(
        self,
        config: EstimatorConfig,
        geometry: Geometry,
        noise_sd: float,
        origin_sd: float = 0.0,
        motion_noise: float = 0.0,
    ) -> None:
        prior = config.prior
        self._config = config
        self._geometry = geometry
        self._noise_variance = noise_sd**2
        self._motion = MotionNoise(motion_noise)
        self._grid = LogStiffnessGrid(
            math.log(prior.nonlinear_stiffness),
            min(_GRID_DEVIATIONS * prior.nonlinear_stiffness_log_sd, _WIDEST_GRID),
        )
        reach = max(_ORIGIN_REACH * origin_sd, _LEAST_ORIGIN_REACH)
        origins: Array = np.linspace(-reach, reach, 3) if origin_sd > 0.0 else np.zeros(1)
        self._in_order = order_interpolation()
        self._basis = StressBasis(geometry, self._grid.nodes, origins)
        self._equations = NormalEquations(self._grid, origins, _LINEAR)
        nodes, linear = self._grid.nodes.size, len(_LINEAR)
        self._prior = StatePrior(
            np.concatenate([prior.mean, np.zeros(1 + linear)]),
            np.concatenate([prior.deviations, [origin_sd], np.zeros(linear)]),
        )
        self._state = self._prior.mean.copy()
        self._covariance = self._prior.covariance
        self._prior_covariance = self._covariance.copy()
        self._node_states = np.empty((nodes, self._state.size))
        self._begin_nodes()
        self._is_unimodal = False
        self._is_solved = True
        self._blocks_since_solved = 0
        deviation = prior.nonlinear_stiffness_log_sd or 1.0
        self._node_weights = np.exp(
            -0.5 * ((self._grid.nodes - self._state[_LOG_GN]) / deviation) ** 2
        )
        self._node_weights /= self._node_weights.sum()
        self._max_compression = 0.0
        self._sample_count = 0
        self._contact_start: float | None = None
        self._change = TissueChange()

    def _begin_nodes(self) -> None:
        """Let the solution at every node begin at the present state."""
        self._node_states[:] = self._state
        self._node_states[:, _LOG_GN] = self._grid.nodes

    @property
    def is_doubtful(self) -> bool:
        """Whether a surprise or a mismatch of late is not explained, or a solution not found."""
        return self._change.is_doubtful or not self._is_solved

    @property
    def is_mismatch(self) -> bool:
        """Whether the innovations are larger or slower than model and noise explain."""
        return self._change.is_mismatch

    @property
    def change_count(self) -> int:
        """Changes of the tissue under the probe that were found."""
        return self._change.count

    # Samples

    def begin_contact(self, bias_sd: float, drift_sd: float) -> None:
        """Start a contact with its own bias [Pa] and drift [Pa/s] of the stress."""
        self._motion.interrupt()
        self._change.begin_contact()
        self._contact_start = None
        for index, deviation in ((_BIAS, bias_sd), (_DRIFT, drift_sd), (_PULSE, 0.0)):
            known = float(self._prior.deviations[index])
            self._equations.marginalise(index, known**-2 if known > 0.0 else 0.0)
            self._prior.set(index, 0.0, deviation)
            self._state[index] = 0.0
            self._node_states[:, index] = 0.0
            self._covariance[index, :] = self._covariance[:, index] = 0.0
            self._covariance[index, index] = deviation**2
        self._basis.discard_block()

    def press(self, step: float, compression: float) -> None:
        """Take the motion of a sample in contact."""
        self._motion.press(step, compression)
        self._basis.press(step, compression)

    def rest(self, steps: tuple[float, ...], free_responses: Array) -> None:
        """Take steps in the air."""
        self._motion.interrupt()
        self._basis.rest(steps, free_responses)

    def skip(self) -> None:
        """Let the samples since the last block go by."""
        self._motion.skip_block()
        self._basis.discard_block()

    def update(self, block: Block) -> Innovation:
        """Take one block; return how it compared with the prediction.

        Raises
        ------
        FloatingPointError
            If the block's response is beyond floating-point numbers.
        """
        response = self._respond(block)
        noise = self._noise_variance / block.size + self._noise_of_motion(block)
        innovation, jacobian = self._innovation(response, block, noise)
        if not (noise > 0.0 and np.all(np.isfinite((noise, *innovation, *jacobian)))):
            raise FloatingPointError(
                f"the response to a compression of {block.compression:g} and a stress of "
                f"{block.stress:g} Pa is not finite"
            )
        change = self._change.watch(
            block,
            innovation,
            noise,
            self._state,
            is_unimodal=self._is_unimodal,
            is_fresh=self._is_unimodal or self._blocks_since_solved == 0,
            is_beyond_all_nodes=functools.partial(self._is_beyond_all_nodes, innovation, response),
        )
        if change is not None:
            self._start_anew(change, innovation, block)
        if self._change.is_blind(block.memory_time):
            return innovation
        self._equations.add(response, noise, block.size)
        self._max_compression = max(self._max_compression, block.compression)
        self._sample_count += block.size
        self._blocks_since_solved += 1
        # A state that takes up surprises would hide the change that they may be.
        if self._is_unimodal and not self._change.is_suspected:
            self._update_by_kalman(innovation, jacobian, noise)
        return innovation

    def _respond(self, block: Block) -> BlockResponse:
        law, free, pulse = self._basis.take_block()
        if self._contact_start is None:
            self._contact_start = block.memory_time
        in_order, _ = self._in_order(float(self._state[_ORDER]))
        elapsed = block.memory_time - self._contact_start
        linear = (1.0, elapsed, float(in_order @ pulse))
        return self._equations.respond(law, free, linear, block.stress)

    def _noise_of_motion(self, block: Block) -> float:
        """Variance that the motion gives to a block's mean stress [Pa^2]."""
        compression = block.compression - float(self._state[_ORIGIN])
        response = elastic_response(
            self._geometry.strain(compression),
            math.exp(self._state[_LOG_G]),
            math.exp(self._state[_LOG_GN]),
        )
        slope = response.by_strain * self._geometry.strain_slope(compression)
        variance, before = self._motion.take_block(
            block.duration, block.size, slope, float(self._state[_ORDER])
        )
        self._equations.widen_newest(before)
        return variance

    def _innovation(
        self, response: BlockResponse, block: Block, noise: float
    ) -> tuple[Innovation, Array]:
        residual, jacobian = self._equations.residual(response, self._state)
        variance = noise + float(jacobian @ self._covariance @ jacobian)
        strain = self._geometry.strain(block.compression - float(self._state[_ORIGIN]))
        elastic = elastic_response(
            strain, math.exp(self._state[_LOG_G]), math.exp(self._state[_LOG_GN])
        )
        innovation = Innovation(
            predicted_fractional_stress=elastic.value,
            predicted_stress=block.stress + float(residual),
            innovation=-float(residual),
            variance=variance,
        )
        return innovation, jacobian

    def _update_by_kalman(self, innovation: Innovation, jacobian: Array, noise: float) -> None:
        """Take one step of an extended Kalman filter, good until the next relinearisation."""
        gain = self._covariance @ jacobian / innovation.variance
        if self._config.fractional_order_given:
            # Schmidt's filter: alpha keeps its deviation and is not learned.
            gain[_ORDER] = 0.0
        longest = self._longest_step
        step = np.clip(gain * innovation.innovation, -longest, longest)
        # Joseph's form: positive whatever the rounding.
        kept = np.eye(gain.size) - np.outer(gain, jacobian)
        covariance = kept @ self._covariance @ kept.T + noise * np.outer(gain, gain)
        if np.all(np.isfinite(step)) and np.all(np.isfinite(covariance)):
            self._state = self._bounded(self._state + step)
            self._covariance = covariance

    # Change of the tissue

    def _is_beyond_all_nodes(self, innovation: Innovation, response: BlockResponse) -> bool:
        """Whether an innovation is a surprise for every likely ln Gn as well."""
        residuals = self._equations.node_residuals(response, self._node_states)
        mean = self._node_weights @ residuals
        spread = self._node_weights @ (residuals - mean) ** 2
        return bool(mean**2 > CHANGE_DEVIATIONS**2 * (innovation.variance + spread))

    def _start_anew(self, change: Change, innovation: Innovation, block: Block) -> None:
        """Learn a new tissue from here on; the response to the old one is kept as it was."""
        if change.state is not None:
            self._state = change.state
        late = block.memory_time + 0.5 * block.duration - change.time
        self._basis.freeze(*self._equations.law_weights(self._state), max(late, _SHORTEST_PULSE))
        self._equations.clear()
        # Origin, bias and drift are those of the contact, the tissue is another.
        prior, state = self._prior, self._state
        deviations = prior.deviations.copy()
        known = np.sqrt(self._covariance.diagonal())
        for index in (_ORIGIN, _BIAS, _DRIFT):
            deviations[index] = known[index]
        deviations[_LOG_G] = math.hypot(
            self._config.prior.linear_stiffness_log_sd, _CHANGE_OF_LOG_G
        )
        deviations[_PULSE] = _PULSE_SHARE * abs(innovation.predicted_fractional_stress)
        state[_PULSE] = 0.0
        for index in StateIndex:
            prior.set(index, float(state[index]), float(deviations[index]))
        self._covariance = prior.covariance
        self._begin_nodes()
        self._is_unimodal = False
        self._max_compression = -math.inf

    # Solution

    def relinearise(self, *, fully: bool = False) -> None:
        """Solve for the posterior anew, with all blocks so far, when that is due."""
        due = _UNIMODAL_BLOCKS if self._is_unimodal else _MULTIMODAL_BLOCKS
        if self._change.is_suspected or self._blocks_since_solved < (1 if fully else due):
            return
        self._blocks_since_solved = 0
        if not self._is_unimodal:
            self._solve_nodes()
        if self._is_unimodal:
            self._solve_state()

    @property
    def _free(self) -> Indices:
        """Indices of the parameters that are learned, shape (free,)."""
        learned = self._prior.learned
        return learned[learned != _ORDER] if self._config.fractional_order_given else learned

    def _solve_state(self) -> None:
        """Solve for the maximum of a posterior that is normal."""
        free = self._free
        state, least, remaining = self._state, math.inf, math.inf
        for _ in range(_MOST_STEPS):
            quadratic = self._equations.at_state(state)
            solved = self._step(state[None], quadratic[None], free)
            decrement = float(solved.decrements[0])
            if not math.isfinite(decrement):
                break
            misfit = float(quadratic[0, 0] + self._prior.distance(state, free))
            # Where the model is wrong the steps may run in circles: the best of them counts.
            if misfit < least:
                least, remaining = misfit, decrement
                self._state = state
                self._covariance = self._covariances(solved.inverses, quadratic[None], free)[0]
            state = self._bounded(state + solved.steps[0])
            if decrement <= _CLOSE:
                self._state = state
                break
        self._is_solved = remaining <= _FAR
        if not self._is_solved or self._covariance[_LOG_GN, _LOG_GN] > _MULTIMODAL**2:
            self._is_unimodal = False
            self._begin_nodes()

    def _solve_nodes(self) -> None:
        """Solve at every node of ln Gn, and take the moments of all."""
        free = self._free
        free = free[free != _LOG_GN]
        for _ in range(_MOST_ROUNDS):
            solved, quadratics = self._approach(free)
            weights = self._weights(solved, quadratics, free)
            likely = weights > _LEAST_WEIGHT
            remaining = weights[likely] @ solved.decrements[likely] if np.any(likely) else math.inf
            self._is_solved = bool(remaining <= _FAR)
            if self._is_solved:
                break
        if not self._is_solved:
            # The nodes go on from where they are at the next solution.
            return
        states, prior = self._node_states, self._prior
        self._node_weights = weights
        self._state = np.where(prior.deviations > 0.0, weights @ states, prior.mean)
        if self._config.fractional_order_given:
            self._state[_ORDER] = prior.mean[_ORDER]
        centred = states - self._state
        covariance = (weights[:, None] * centred).T @ centred
        own = self._covariances(solved.inverses[likely], quadratics[likely], free)
        covariance += np.tensordot(weights[likely], own, 1)
        self._covariance = covariance
        self._is_unimodal = bool(covariance[_LOG_GN, _LOG_GN] < _UNIMODAL**2)

    def _approach(self, free: Indices) -> tuple[_Steps, Array]:
        """Take steps at every node; return the last ones and the products where they led."""
        states = self._node_states
        quadratics = self._equations.at_nodes(states)
        for _ in range(_MOST_NODE_STEPS):
            solved = self._step(states, quadratics, free)
            states = self._node_states = self._bounded_nodes(states + solved.steps)
            quadratics = self._equations.at_nodes(states)
            close = solved.decrements <= _CLOSE
            if np.all(close | (self._node_weights < _LEAST_WEIGHT)):
                break
        return solved, quadratics

    def _weights(self, solved: _Steps, quadratics: Array, free: Indices) -> Array:
        """Return the nodes' weights by their evidence, shape (nodes,); 0 without a solution."""
        prior = self._prior
        log_evidence = -0.5 * (
            quadratics[:, 0, 0]
            + prior.distance(self._node_states, free)
            + solved.log_determinants
            + ((self._grid.nodes - prior.mean[_LOG_GN]) / prior.deviations[_LOG_GN]) ** 2
        )
        is_solved = np.isfinite(log_evidence) & np.isfinite(solved.decrements)
        weights: Array = np.zeros_like(log_evidence)
        if np.any(is_solved):
            weights[is_solved] = np.exp(log_evidence[is_solved] - log_evidence[is_solved].max())
            weights /= weights.sum()
        return weights

    def _step(self, states: Array, quadratics: Array, free: Indices) -> _Steps:
        """Return Gauss-Newton steps; none where the Hessian is not finite.

        Parameters
        ----------
        states : ndarray, shape (m, n)
        quadratics : ndarray, shape (m, n + 1, n + 1)
        free : ndarray, shape (free,)
        """
        precision = self._prior.precision(free)
        hessians = quadratics[:, 1 + free[:, None], 1 + free] + precision
        gradients = quadratics[:, 0, 1 + free] + (states - self._prior.mean)[:, free] @ precision
        inverses, log_determinants = _inverse(hessians, precision.diagonal())
        longest = self._longest_step[free]
        wanted = -(inverses @ gradients[:, :, None])[:, :, 0]
        is_solved = np.isfinite(log_determinants) & np.all(np.isfinite(wanted), axis=1)
        moved = np.where(is_solved[:, None], np.clip(wanted, -longest, longest), 0.0)
        steps = np.zeros_like(states)
        steps[:, free] = moved
        decrements = (moved[:, None, :] @ hessians @ moved[:, :, None])[:, 0, 0]
        decrements[~is_solved] = math.inf
        return _Steps(steps, inverses, log_determinants, decrements)

    @property
    def _reach(self) -> Array:
        """Distance from their prior at which origin and linear parameters stop, shape (n - 3,)."""
        return _REACH_DEVIATIONS * self._prior.deviations[_ORIGIN:]

    @property
    def _longest_step(self) -> Array:
        """Longest change of each parameter in a step, shape (n,)."""
        return np.concatenate([_LONGEST_STEP, self._reach[1:]])

    def _bounded(self, states: Array) -> Array:
        """Keep states, shape (..., n), where the response is known, in place."""
        around, reach = self._prior.mean, self._reach
        for index, lowest, highest in (
            (_LOG_G, around[_LOG_G] - _LOG_REACH, around[_LOG_G] + _LOG_REACH),
            (_ORDER, LOWEST_ORDER, HIGHEST_ORDER),
            (_LOG_GN, self._grid.lowest, self._grid.highest),
            (slice(_ORIGIN, None), around[_ORIGIN:] - reach, around[_ORIGIN:] + reach),
        ):
            states[..., index] = np.clip(states[..., index], lowest, highest)
        return states

    def _bounded_nodes(self, states: Array) -> Array:
        states = self._bounded(states)
        states[:, _LOG_GN] = self._grid.nodes
        return states

    def _covariances(self, inverses: Array, quadratics: Array, free: Indices) -> Array:
        """Return the covariances of all parameters.

        Parameters
        ----------
        inverses : ndarray, shape (m, free, free)
            Of the Hessians.
        quadratics : ndarray, shape (m, n + 1, n + 1)
        free : ndarray, shape (free,)

        Returns
        -------
        ndarray, shape (m, n, n)
        """
        size = self._state.size
        covariances = np.zeros((inverses.shape[0], size, size))
        covariances[:, free[:, None], free] = 0.5 * (inverses + inverses.transpose(0, 2, 1))
        if self._config.fractional_order_given:
            # The uncertainty of an alpha that is not learned counts too (consider analysis).
            deviation = self._prior.deviations[_ORDER]
            sensitivity = np.zeros((inverses.shape[0], size))
            coupling = quadratics[:, 1 + free, 1 + _ORDER]
            sensitivity[:, free] = -(inverses @ coupling[:, :, None])[:, :, 0]
            sensitivity[:, _ORDER] = deviation
            sensitivity[:, free] *= deviation
            covariances += sensitivity[:, :, None] * sensitivity[:, None, :]
        return covariances

    # Result

    def estimate(self) -> Estimate:
        """Return the present estimate."""
        config = self._config
        # Symmetric to the last bit, which products of matrices are not.
        covariance = 0.5 * self._change.inflation * (self._covariance + self._covariance.T)
        if self.is_mismatch:
            # The parameters of a wrong model are known no better than before the touch.
            covariance += self._prior_covariance
        beyond = self._probability_beyond_boundary()
        return Estimate(
            log_linear_stiffness=float(self._state[_LOG_G]),
            log_nonlinear_stiffness=float(self._state[_LOG_GN]),
            fractional_order=float(self._state[_ORDER]),
            covariance=covariance[:_ORIGIN, :_ORIGIN],
            strain_origin=float(self._state[_ORIGIN]),
            strain_origin_sd=math.sqrt(max(covariance[_ORIGIN, _ORIGIN], 0.0)),
            probability_beyond_boundary=beyond,
            converged=self._is_solved
            and beyond >= config.converged_probability
            and math.sqrt(covariance[_LOG_GN, _LOG_GN]) <= config.converged_log_sd,
            sample_count=self._sample_count,
        )

    def _probability_beyond_boundary(self) -> float:
        compression = self._max_compression - float(self._state[_ORIGIN])
        if compression <= 0.0:
            return 0.0
        strain = self._geometry.strain(compression)
        if self._is_unimodal:
            deviation = math.sqrt(self._covariance[_LOG_GN, _LOG_GN]) + _TINY_DEVIATION
            return float(ndtr((math.log(strain) + self._state[_LOG_GN]) / deviation))
        beyond = ndtr((math.log(strain) + self._grid.nodes) / (0.5 * LOG_SPACING))
        return float(min(self._node_weights @ beyond, 1.0))


def _inverse(matrices: Array, least: Array) -> tuple[Array, Array]:
    """Return inverses and logarithms of determinants of positive definite matrices.

    Rounding may have robbed the matrices of being so.

    Parameters
    ----------
    matrices : ndarray, shape (m, free, free)
    least : ndarray, shape (free,)
        Lower bound of each diagonal element, but for rounding: its scale.

    Returns
    -------
    inverses : ndarray, shape (m, free, free)
        NaN where the matrix is not finite.
    log_determinants : ndarray, shape (m,)
        NaN there too.
    """
    diagonal = np.maximum(np.diagonal(matrices, axis1=1, axis2=2), least)
    scale = diagonal**-0.5
    scaled = matrices * scale[:, :, None] * scale[:, None, :]
    is_finite = np.all(np.isfinite(scaled), axis=(1, 2))
    if not np.all(is_finite):
        scaled[~is_finite] = np.eye(least.size)
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, _SINGULAR)
    vectors *= scale[:, :, None]
    inverses: Array = (vectors / values[:, None, :]) @ vectors.transpose(0, 2, 1)
    log_determinants: Array = np.sum(np.log(values) + np.log(diagonal), axis=1)
    inverses[~is_finite] = math.nan
    log_determinants[~is_finite] = math.nan
    return inverses, log_determinants
