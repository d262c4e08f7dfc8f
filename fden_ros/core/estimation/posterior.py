r"""The posterior of the state given all blocks so far, at one scale of the model's error.

The observation is the mean stress of a block,

.. math::
    f_k = \bigl(D^\alpha \varphi(x(u - o); G, G_n)\bigr)_k + b + c\,(t_k - t_0) + w_k
    + G\,(C\,c_k + \tau\,d_k) + F\,e_k + v_k,

with white :math:`v_k`. Nuisances beside the law: the strain origin o, the force's bias b and drift
c, a random walk w of the stress that law and rig leave out
(:mod:`fden_ros.core.estimation.random_walk`), and of the rig its compliance C, the delay tau and
the friction F, with their columns at a running linearisation. Since the responses at the nodes of
ln Gn, alpha and o are summed up (:mod:`fden_ros.core.estimation.normal_equations`), the maximum of
the posterior follows by Gauss-Newton steps, started at the last one: an iterated extended Kalman
filter in information form whose linearisation is never out of date.

While Gn is not yet observable, its posterior is not normal. Then the other parameters are solved
for at every node of ln Gn, and the nodes weighed by their evidence (Laplace's approximation at
each node): a Gaussian sum.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from fden_ros.core.estimation.estimate import Block, EstimatorConfig, StateIndex
from fden_ros.core.estimation.innovation_monitor import CHANGE_DEVIATIONS
from fden_ros.core.estimation.normal_equations import BlockResponse, NormalEquations
from fden_ros.core.estimation.random_walk import RandomWalk
from fden_ros.core.estimation.state_prior import StatePrior
from fden_ros.core.law.interpolation import LOG_SPACING, LogStiffnessGrid
from fden_ros.core.law.kernel import HIGHEST_ORDER, LOWEST_ORDER

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_LOG_G = StateIndex.LOG_LINEAR_STIFFNESS
_LOG_GN = StateIndex.LOG_NONLINEAR_STIFFNESS
_ORDER = StateIndex.FRACTIONAL_ORDER
_ORIGIN = StateIndex.STRAIN_ORIGIN
_BIAS, _DRIFT, _PULSE = StateIndex.BIAS, StateIndex.DRIFT, StateIndex.PULSE
_RIG = (StateIndex.COMPLIANCE, StateIndex.DELAY, StateIndex.FRICTION)
_WALK = (StateIndex.WALK, StateIndex.WALK_NEXT)
#: Parameters that enter the stress linearly, in the order of the state, and those of them whose
#: columns are at G = 1.
_LINEAR = tuple(index.name.lower() for index in StateIndex if index > _ORIGIN)
_SCALED = ("compliance", "delay")

#: Deviation of a walk before the sums hold its prior [unit]: so wide that it says nothing.
_UNKNOWN = 1e6
#: The unit of the walk in standard deviations of a sample's noise [1].
_WALK_UNIT = 3.0

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
#: Deviation of the pulse of phi at a change [1], as a share of the fractional stress.
_PULSE_SHARE = 2.0


class _Steps(NamedTuple):
    """Gauss-Newton steps from m states."""

    steps: Array  #: shape (m, n); 0 where there is no solution
    inverses: Array  #: of the Hessians, shape (m, free, free)
    log_determinants: Array  #: of the Hessians, shape (m,)
    decrements: Array  #: of minus twice the log-posterior, shape (m,); infinite without a solution


class StressPosterior:
    """The posterior at one scale of the model's error.

    Parameters
    ----------
    config : EstimatorConfig
        Its uncertainty at this scale.
    grid : LogStiffnessGrid
        Nodes of ln Gn.
    origins : ndarray, shape (m,)
        Nodes of the strain origin [1].
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    origin_sd : float
        Standard deviation of the strain origin [1]; 0: known.
    """

    def __init__(
        self,
        config: EstimatorConfig,
        grid: LogStiffnessGrid,
        origins: Array,
        noise_sd: float,
        origin_sd: float,
    ) -> None:
        prior, uncertainty = config.prior, config.uncertainty
        self.uncertainty = uncertainty
        self._config = config
        self._grid = grid
        self._equations = NormalEquations(grid, origins, _LINEAR, _SCALED)
        mean, deviations = np.zeros(len(StateIndex)), np.zeros(len(StateIndex))
        mean[:_ORIGIN], deviations[:_ORIGIN] = prior.mean, prior.deviations
        deviations[_ORIGIN] = origin_sd
        rig = (uncertainty.compliance_sd, uncertainty.delay_sd, uncertainty.friction_sd)
        deviations[list(_RIG)] = np.sign(rig)
        self._has_walk = uncertainty.walks
        if self._has_walk:
            deviations[list(_WALK)] = _UNKNOWN
        self._prior = StatePrior(mean, deviations)
        self._walk = RandomWalk(self._equations, _WALK_UNIT * noise_sd)
        self.state = self._prior.mean.copy()
        self.covariance = self._prior.covariance
        self._node_states = np.empty((grid.nodes.size, self.state.size))
        self._begin_nodes()
        #: Whether the posterior of ln Gn is normal.
        self.is_unimodal = False
        #: Whether the last solution converged.
        self.is_solved = True
        #: Blocks since the last solution.
        self.blocks_since_solved = 0
        #: Logarithm of the evidence of all blocks, by their innovations, but for a constant.
        self.log_evidence = 0.0
        deviation = prior.nonlinear_stiffness_log_sd or 1.0
        self._node_weights = np.exp(-0.5 * ((grid.nodes - self.state[_LOG_GN]) / deviation) ** 2)
        self._node_weights /= self._node_weights.sum()

    def _begin_nodes(self) -> None:
        """Let the solution at every node begin at the present state."""
        self._node_states[:] = self.state
        self._node_states[:, _LOG_GN] = self._grid.nodes

    # Blocks

    def begin_contact(self, bias_sd: float, drift_sd: float) -> None:
        """Start a contact with its own bias [Pa] and drift [Pa/s] of the stress."""
        self._walk.take_out()
        for index, deviation in ((_BIAS, bias_sd), (_DRIFT, drift_sd), (_PULSE, 0.0)):
            known = float(self._prior.deviations[index])
            if known > 0.0:
                self._equations.marginalise(index, known**-2)
            else:
                self._equations.forget(index)
            self._prior.set(index, 0.0, deviation)
            self.state[index] = 0.0
            self._node_states[:, index] = 0.0
            self.covariance[index, :] = self.covariance[:, index] = 0.0
            self.covariance[index, index] = deviation**2

    def respond(
        self,
        law: Array,
        free: Array,
        linear: dict[StateIndex, float],
        block: Block,
        walk_variance: float,
    ) -> BlockResponse:
        """Return the responses of a block.

        Parameters
        ----------
        law : ndarray, shape (nodes, origins * orders)
        free : ndarray, shape (orders,)
        linear : dict of StateIndex to float
            Columns of the linear parameters but the walk's.
        block : Block
        walk_variance : float
            By which the walk grows over the block [Pa^2].
        """
        columns = np.zeros(len(StateIndex))
        for index, column in linear.items():
            columns[index] = column
        if self._has_walk:
            columns[list(_WALK)] = self._walk.columns(
                block.memory_time,
                block.duration,
                walk_variance,
                (self.state, self._node_states),
                self.covariance,
            )
        return self._equations.respond(law, free, columns[_ORIGIN + 1 :], block.stress)

    def predict(self, response: BlockResponse) -> tuple[float, Array, float]:
        """Return predicted less observed stress, its derivatives (n,) and its variance."""
        residual, jacobian = self._equations.residual(response, self.state)
        return residual, jacobian, float(jacobian @ self.covariance @ jacobian)

    def walk_share(self, jacobian: Array) -> float:
        """Return the walk's own part of a prediction's variance [Pa^2]."""
        walk = list(_WALK)
        return float(jacobian[walk] @ self.covariance[np.ix_(walk, walk)] @ jacobian[walk])

    def add(
        self, response: BlockResponse, residual: float, spread: float, noise: float, size: int
    ) -> None:
        """Take a block.

        Parameters
        ----------
        response : BlockResponse
        residual, spread : float
            Predicted less observed [Pa], and the prediction's variance [Pa^2].
        noise : float
            Variance of the block's mean stress [Pa^2].
        size : int
            Samples in the block.
        """
        variance = noise + spread
        self.log_evidence -= 0.5 * (residual**2 / variance + math.log(variance))
        self._equations.add(response, noise, size)
        self.blocks_since_solved += 1

    def widen_newest(self, variance: float) -> None:
        """Add to the variance of the newest block what one of its samples is further off."""
        self._equations.widen_newest(variance)

    def update(self, residual: float, jacobian: Array, variance: float, noise: float) -> None:
        """Take one step of an extended Kalman filter, good until the next relinearisation.

        Parameters
        ----------
        residual : float
            Predicted less observed [Pa].
        jacobian : ndarray, shape (n,)
        variance, noise : float
            Of the innovation, and of the observation [Pa^2].
        """
        gain = self.covariance @ jacobian / variance
        if self._config.fractional_order_given:
            # Schmidt's filter: alpha keeps its deviation and is not learned.
            gain[_ORDER] = 0.0
        longest = self._longest_step
        step = np.clip(-gain * residual, -longest, longest)
        # Joseph's form: positive whatever the rounding.
        kept = np.eye(gain.size) - np.outer(gain, jacobian)
        covariance = kept @ self.covariance @ kept.T + noise * np.outer(gain, gain)
        if np.all(np.isfinite(step)) and np.all(np.isfinite(covariance)):
            self.state = self._bounded(self.state + step)
            self.covariance = covariance

    def is_beyond_all_nodes(self, response: BlockResponse, variance: float) -> bool:
        """Whether an innovation is a surprise for every likely ln Gn as well."""
        residuals = self._equations.node_residuals(response, self._node_states)
        mean = self._node_weights @ residuals
        spread = self._node_weights @ (residuals - mean) ** 2
        return bool(mean**2 > CHANGE_DEVIATIONS**2 * (variance + spread))

    def law_weights(self) -> tuple[int, Array]:
        """Return the first node of ln Gn used at the state, and the weights (8, origins)."""
        return self._equations.law_weights(self.state)

    def start_anew(self, predicted_fractional_stress: float) -> None:
        """Learn a new tissue from here on: origin, bias, drift and rig stay."""
        self._equations.clear()
        self._walk.interrupt()
        prior, state = self._prior, self.state
        deviations = prior.deviations.copy()
        known = np.sqrt(self.covariance.diagonal())
        for index in (_ORIGIN, _BIAS, _DRIFT, *_RIG):
            deviations[index] = known[index]
        deviations[_LOG_G] = math.hypot(
            self._config.prior.linear_stiffness_log_sd, _CHANGE_OF_LOG_G
        )
        deviations[_PULSE] = _PULSE_SHARE * abs(predicted_fractional_stress)
        state[[_PULSE, *_WALK]] = 0.0
        for index in StateIndex:
            prior.set(index, float(state[index]), float(deviations[index]))
        self.covariance = prior.covariance
        self._begin_nodes()
        self.is_unimodal = False
        self.log_evidence = 0.0

    # Solution

    def is_due(self) -> bool:
        """Whether enough blocks came since the last solution."""
        due = _UNIMODAL_BLOCKS if self.is_unimodal else _MULTIMODAL_BLOCKS
        return self.blocks_since_solved >= due

    def relinearise(self) -> None:
        """Solve for the posterior anew, with all blocks so far."""
        self.blocks_since_solved = 0
        if not self.is_unimodal:
            self._solve_nodes()
        if self.is_unimodal:
            self._solve_state()

    @property
    def _free(self) -> Indices:
        """Indices of the parameters that are learned, shape (free,)."""
        learned = self._prior.learned
        return learned[learned != _ORDER] if self._config.fractional_order_given else learned

    def _solve_state(self) -> None:
        """Solve for the maximum of a posterior that is normal."""
        free = self._free
        state, least, remaining = self.state, math.inf, math.inf
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
                self.state = state
                self.covariance = self._covariances(solved.inverses, quadratic[None], free)[0]
            state = self._bounded(state + solved.steps[0])
            if decrement <= _CLOSE:
                self.state = state
                break
        self.is_solved = remaining <= _FAR
        if not self.is_solved or self.covariance[_LOG_GN, _LOG_GN] > _MULTIMODAL**2:
            self.is_unimodal = False
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
            self.is_solved = bool(remaining <= _FAR)
            if self.is_solved:
                break
        if not self.is_solved:
            # The nodes go on from where they are at the next solution.
            return
        states, prior = self._node_states, self._prior
        self._node_weights = weights
        self.state = np.where(prior.deviations > 0.0, weights @ states, prior.mean)
        if self._config.fractional_order_given:
            self.state[_ORDER] = prior.mean[_ORDER]
        centred = states - self.state
        covariance = (weights[:, None] * centred).T @ centred
        own = self._covariances(solved.inverses[likely], quadratics[likely], free)
        covariance += np.tensordot(weights[likely], own, 1)
        self.covariance = covariance
        self.is_unimodal = bool(covariance[_LOG_GN, _LOG_GN] < _UNIMODAL**2)

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
        size = self.state.size
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

    def probability_beyond_boundary(self, strain: float) -> float:
        """Return P(strain > 1/Gn) [1], for a positive strain."""
        if self.is_unimodal:
            deviation = math.sqrt(self.covariance[_LOG_GN, _LOG_GN]) + _TINY_DEVIATION
            return float(ndtr((math.log(strain) + self.state[_LOG_GN]) / deviation))
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
