# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

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
each node): a Gaussian sum. The solver is :mod:`fden_ros.core.estimation.gauss_newton`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.edge import (
    EDGE_SHARE,
    ends_have_weight,
    log_g_is_at_end,
    log_gn_leans_on_end,
    order_is_at_end,
    weights_pile_up,
)
from fden_ros.core.estimation.estimate import ParameterSet, StateIndex
from fden_ros.core.estimation.estimator import Block
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.free_order import FreeOrder, free_order
from fden_ros.core.estimation.gauss_newton import LOG_REACH, GaussNewton, Solution
from fden_ros.core.estimation.normal_equations import BlockResponse, NormalEquations
from fden_ros.core.estimation.random_walk import RandomWalk
from fden_ros.core.estimation.rig_contradiction import StatedRig
from fden_ros.core.estimation.state_prior import StatePrior
from fden_ros.core.law.interpolation import LOG_SPACING, LogStiffnessGrid

_LOG_G = StateIndex.LOG_LINEAR_STIFFNESS
_LOG_GN = StateIndex.LOG_NONLINEAR_STIFFNESS
_ORDER = StateIndex.FRACTIONAL_ORDER
_ORIGIN = StateIndex.STRAIN_ORIGIN
_BIAS, _DRIFT, _PULSE = StateIndex.BIAS, StateIndex.DRIFT, StateIndex.PULSE
_RIG = (StateIndex.COMPLIANCE, StateIndex.DELAY, StateIndex.FRICTION)
#: Of the rig, what is carried from site to site.
_CARRIED = _RIG[1:]
_JITTER, _SHIFT = StateIndex.JITTER, StateIndex.SHIFT
_WALK = (StateIndex.WALK, StateIndex.WALK_NEXT)
#: Parameters that enter the stress linearly, in the order of the state, and those of them whose
#: columns are at G = 1.
_LINEAR = tuple(index.name.lower() for index in StateIndex if index > _ORIGIN)
_SCALED = ("compliance", "delay", "jitter")

#: Deviation of a walk before the sums hold its prior [unit]: so wide that it says nothing.
_UNKNOWN = 1e6
#: The noise of the displacement is motion to the law, but none to the tissue: its part is
#: regressed out, with a coefficient of this deviation [1].
_JITTER_SD = 1.0
#: The unit of the walk in standard deviations of a sample's noise [1].
_WALK_UNIT = 3.0

#: Standard deviation of ln Gn [1] below which the posterior is taken for normal, and above which
#: it no longer is: narrower than the nodes' distance their sum does not resolve it. Two values, so
#: that it does not go to and fro.
_UNIMODAL, _MULTIMODAL = 0.6 * LOG_SPACING, 0.9 * LOG_SPACING
#: Blocks [1] after which the posterior is solved for anew while it is not normal, and while it is:
#: then an extended Kalman filter goes on from the last solution in between.
_MULTIMODAL_BLOCKS, _UNIMODAL_BLOCKS = 4, 10
#: Added to a standard deviation of ln Gn [1] that may be 0, before it divides.
_TINY_DEVIATION = 1e-12
#: Standard deviation of a change of ln G [1]: a lesion is up to several times stiffer than what is
#: around it.
_CHANGE_OF_LOG_G = 1.0
#: Deviation of the pulse of phi at a change [1], as a share of the fractional stress: what
#: was pressed before the change is unknown, up to twice what the law makes of it. Half or twice
#: finds the same changes.
_PULSE_SHARE = 2.0


class Prediction(NamedTuple):
    """How a posterior predicts a block."""

    response: BlockResponse
    residual: float  #: predicted less observed stress [Pa]
    jacobian: Array  #: of the residual, shape (n,)
    spread: float  #: variance of the prediction [Pa^2]


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
    rig : tuple of ndarray, shape (2,), (2, 2)
        Mean and covariance of delay and friction before the first contact, in their stated
        deviations.
    regards_jitter : bool
        The noise of the motion is a parameter also where nothing else is left out.
    """

    def __init__(
        self,
        config: EstimatorConfig,
        grid: LogStiffnessGrid,
        origins: Array,
        noise_sd: float,
        origin_sd: float,
        rig: tuple[Array, Array],
        *,
        regards_jitter: bool,
    ) -> None:
        prior, uncertainty = config.prior, config.uncertainty
        self.uncertainty = uncertainty
        self._config = config
        self._grid = grid
        given_order = prior.fractional_order if config.fractional_order_given else None
        self._equations = NormalEquations(grid, origins, _LINEAR, _SCALED, given_order)
        mean, deviations = np.zeros(len(StateIndex)), np.zeros(len(StateIndex))
        mean[:_ORIGIN], deviations[:_ORIGIN] = prior.mean, prior.deviations
        deviations[_ORIGIN] = origin_sd
        self._has_walk = uncertainty.walks
        if self._has_walk:
            deviations[list(_WALK)] = _UNKNOWN
        if self._has_walk or regards_jitter:
            deviations[_JITTER] = _JITTER_SD
        deviations[_RIG[0]] = np.sign(uncertainty.compliance_sd)
        self._prior = StatePrior(mean, deviations)
        self._know(*rig)
        self._stated_rig = StatedRig(self._prior)
        self._solver = GaussNewton(
            self._equations,
            self._prior,
            grid,
            is_order_learned=not config.fractional_order_given,
        )
        self._walk = RandomWalk(self._equations, _WALK_UNIT * noise_sd)
        self.state = self._prior.mean.copy()
        self.covariance = self._prior.covariance
        self._node_states = np.empty((grid.nodes.size, self.state.size))
        self._begin_nodes()
        #: What the data say of alpha beside what is stated, before the newest surprise.
        self._free_order = FreeOrder.nothing()
        #: Whether the posterior of ln Gn is normal.
        self.is_unimodal = False
        #: Whether the last solution converged.
        self.is_solved = True
        #: Blocks since the last solution.
        self.blocks_since_solved = 0
        #: Logarithm of the evidence of all blocks, at the last solution and by the innovations
        #: since, but for what is the same at every scale [1]. (Innovations of a posterior that
        #: has not found its maximum yet say nothing against its scale.)
        self.log_evidence = 0.0
        deviation = prior.nonlinear_stiffness_log_sd or 1.0
        self._node_weights = np.exp(-0.5 * ((grid.nodes - self.state[_LOG_GN]) / deviation) ** 2)
        self._node_weights /= self._node_weights.sum()

    def _know(self, mean: Array, covariance: Array) -> None:
        """Begin with what is known of the rig."""
        is_open = covariance.diagonal() > 0.0
        own = np.array(_CARRIED)[is_open]
        if own.size:
            self._prior.set_group(own, mean[is_open], covariance[np.ix_(is_open, is_open)])

    def rig(self) -> tuple[Array, Array]:
        """Return mean (2,) and covariance (2, 2) of delay and friction, in stated deviations."""
        own = list(_CARRIED)
        return self.state[own], self.covariance[np.ix_(own, own)]

    def _begin_nodes(self) -> None:
        """Let the solution at every node begin at the present state."""
        self._node_states[:] = self.state
        self._node_states[:, _LOG_GN] = self._grid.nodes

    # Blocks

    def begin_contact(self, bias_sd: float, drift_sd: float, shift_sd: float) -> None:
        """Start a contact with its own bias [Pa] and drift [Pa/s] of the stress.

        The surface has shifted by `shift_sd` of its ways in a second since the last contact [1].
        """
        self._walk.take_out()
        own = ((_BIAS, bias_sd), (_DRIFT, drift_sd), (_PULSE, 0.0), (_SHIFT, shift_sd))
        for index, deviation in own:
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

    def predict(
        self,
        law: Array,
        free: Array,
        linear: dict[StateIndex, float],
        block: Block,
        walk_variance: float,
    ) -> Prediction:
        """Return how a block compares with its prediction.

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
        response = self._equations.respond(law, free, columns[_ORIGIN + 1 :], block.stress)
        residual, jacobian = self._equations.residual(response, self.state)
        spread = float(jacobian @ self.covariance @ jacobian)
        return Prediction(response, residual, jacobian, spread)

    def walk_share(self, prediction: Prediction) -> float:
        """Return the walk's own part of a prediction's variance [Pa^2]."""
        walk = slice(_WALK[0], _WALK[-1] + 1)
        jacobian = prediction.jacobian[walk]
        return float(jacobian @ self.covariance[walk, walk] @ jacobian)

    def add(self, prediction: Prediction, noise: float, size: int) -> None:
        """Take a block.

        Parameters
        ----------
        prediction : Prediction
        noise : float
            Variance of the block's mean stress [Pa^2].
        size : int
            Samples in the block.
        """
        variance = noise + prediction.spread
        self.log_evidence -= 0.5 * (prediction.residual**2 / variance + math.log(variance / noise))
        self._equations.add(prediction.response, noise, size)
        self.blocks_since_solved += 1

    def amend_newest(self, variance: float, delayed: float) -> None:
        """Correct the newest block by what the one after it tells.

        Parameters
        ----------
        variance : float
            By which one of its samples is further off [Pa^2].
        delayed : float
            Added to the column of the delay, at G = 1 [1].
        """
        self._equations.amend_newest(variance, StateIndex.DELAY, delayed)

    def update(self, prediction: Prediction, noise: float) -> None:
        """Take one step of an extended Kalman filter, good until the next relinearisation.

        Parameters
        ----------
        prediction : Prediction
        noise : float
            Variance of the block's mean stress [Pa^2].
        """
        jacobian = prediction.jacobian
        gain = self.covariance @ jacobian / (noise + prediction.spread)
        if self._config.fractional_order_given:
            # Schmidt's filter: alpha keeps its deviation and is not learned.
            gain[_ORDER] = 0.0
        longest = self._solver.longest_step
        step = np.minimum(np.maximum(-gain * prediction.residual, -longest), longest)
        # Joseph's form: positive whatever the rounding.
        kept = -gain[:, None] * jacobian
        kept.flat[:: gain.size + 1] += 1.0
        covariance = kept @ self.covariance @ kept.T + noise * gain[:, None] * gain
        if math.isfinite(step.sum()) and math.isfinite(covariance.sum()):
            self.state = self._solver.bounded(self.state + step)
            self.covariance = covariance

    def foreseen(self, prediction: Prediction) -> tuple[float, float]:
        """Return squared residual and variance [Pa^2] of a prediction, over the nodes of ln Gn.

        Each node has fitted the other parameters to the data: how their predictions differ is not
        what it is in first order about the mean.
        """
        if self.is_unimodal or not self.is_solved:
            return prediction.residual**2, prediction.spread
        weights, states = self._node_weights, self._node_states
        residuals = self._equations.node_residuals(prediction.response, states)
        mean = weights @ residuals
        in_first_order = (states - weights @ states) @ prediction.jacobian
        apart = float(weights @ (residuals - mean) ** 2 - weights @ in_first_order**2)
        return float(mean**2), max(prediction.spread + apart, 0.0)

    def order_variance(self, prediction: Prediction, *, is_first: bool) -> float:
        """Return the variance that a prediction gains where alpha is left to the data [Pa^2].

        `is_first`: no surprise came before; one that did would tell of alpha what it does not
        know.
        """
        if is_first:
            quadratic = self._equations.at_state(self.state)
            self._free_order = free_order(quadratic, self.state, self._prior)
        return self._free_order.added_variance(prediction.jacobian, self.covariance[:, _ORDER])

    def law_weights(self) -> tuple[int, Array]:
        """Return the first node of ln Gn used at the state, and the weights (8, origins)."""
        return self._equations.law_weights(self.state)

    def law_step(self, before: BlockResponse, response: BlockResponse) -> float:
        """Return by how much the stress changes between blocks by the law alone [Pa]."""
        return self._equations.law_step(before, response, self.state)

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

    def work_ahead(self) -> bool:
        """Do what a block would have to wait for otherwise; return whether there was any."""
        return self._equations.work_ahead()

    def relinearise(self) -> Iterator[None]:
        """Solve for the posterior anew, with all blocks so far, step by step."""
        self.blocks_since_solved = 0
        yield from self._solve_anew()
        if self.is_solved and self._stated_rig.widen(self.state, self.covariance):
            yield from self._solve_anew()

    def _solve_anew(self) -> Iterator[None]:
        if not self.is_unimodal:
            yield from self._solve_at_nodes()
        if self.is_unimodal:
            yield from self._solve()

    def _solve(self) -> Iterator[None]:
        """Solve for the maximum of a posterior that is normal."""
        solution = yield from self._solver.solve(self.state, self.covariance)
        self.state, self.covariance = solution.state, solution.covariance
        self.is_solved = solution.is_converged
        self._take_evidence(solution)
        if not self.is_solved or self.covariance[_LOG_GN, _LOG_GN] > _MULTIMODAL**2:
            self.is_unimodal = False
            self._begin_nodes()

    def _solve_at_nodes(self) -> Iterator[None]:
        """Solve at every node of ln Gn, and take the moments of all."""
        solution = yield from self._solver.solve_at_nodes(self._node_states, self._node_weights)
        # Where they have not converged, the nodes go on from where they are the next time.
        self._node_states = solution.states
        self.is_solved = solution.moments is not None
        if solution.moments is not None:
            self._node_weights = solution.weights
            self.state, self.covariance = solution.moments.state, solution.moments.covariance
            self._take_evidence(solution.moments)
            self.is_unimodal = bool(self.covariance[_LOG_GN, _LOG_GN] < _UNIMODAL**2)

    def _take_evidence(self, solution: Solution) -> None:
        if solution.log_evidence is None:
            return
        self.log_evidence = solution.log_evidence - self._stated_rig.log_widening()

    def rig_deviations(self) -> float:
        """Return how far the rig is from what is stated, in deviations [1]."""
        return self._stated_rig.deviations(self.state, self.covariance)

    def at_edge(self) -> ParameterSet:
        """Return the parameters at an end of what can be represented."""
        found, prior, state = ParameterSet.NONE, self._prior, self.state
        if log_g_is_at_end(float(state[_LOG_G] - prior.mean[_LOG_G]), LOG_REACH):
            found |= ParameterSet.LINEAR_STIFFNESS
        if prior.deviations[_LOG_GN] > 0.0 and self._log_gn_is_at_end():
            found |= ParameterSet.NONLINEAR_STIFFNESS
        if not self._config.is_order_given and self._order_is_at_end():
            found |= ParameterSet.FRACTIONAL_ORDER
        return found

    def _log_gn_is_at_end(self) -> bool:
        if self.is_unimodal:
            deviation = math.sqrt(self.covariance[_LOG_GN, _LOG_GN])
            return log_gn_leans_on_end(self._grid, float(self.state[_LOG_GN]), deviation)
        if not ends_have_weight(self._node_weights):
            return False
        mean, deviation = self._prior.mean[_LOG_GN], self._prior.deviations[_LOG_GN]
        log_prior = -0.5 * ((self._grid.nodes - mean) / deviation) ** 2
        return weights_pile_up(self._node_weights, log_prior)

    def _order_is_at_end(self) -> bool:
        deviation = math.sqrt(self.covariance[_ORDER, _ORDER])
        if self.is_unimodal:
            return bool(order_is_at_end(self.state[_ORDER], deviation))
        at_end = order_is_at_end(self._node_states[:, _ORDER], deviation)
        return bool(self._node_weights @ at_end >= EDGE_SHARE)

    def probability_beyond_boundary(self, strain: float) -> float:
        """Return P(strain > 1/Gn) [1], for a positive strain."""
        if self.is_unimodal:
            deviation = math.sqrt(self.covariance[_LOG_GN, _LOG_GN]) + _TINY_DEVIATION
            return float(ndtr((math.log(strain) + self.state[_LOG_GN]) / deviation))
        beyond = ndtr((math.log(strain) + self._grid.nodes) / (0.5 * LOG_SPACING))
        return float(min(self._node_weights @ beyond, 1.0))
