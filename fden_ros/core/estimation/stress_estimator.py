r"""Recursive estimation on the stress itself: relinearised at every block, in constant memory.

The observation is the mean stress of a block,

.. math::
    f_k = \bigl(D^\alpha \varphi(x(u - o); G, G_n)\bigr)_k + b + c\,(t_k - t_0) + v_k,

with white :math:`v_k`, the strain origin o, and the force's bias b and drift c as nuisances.
:mod:`fden_ros.core.law.stress_response` gives the response at nodes of ln Gn, alpha and o, so
the sum of squares of any parameters is a quadratic form in what was accumulated at the nodes.
From it follows the maximum of the posterior by Gauss-Newton steps, started at the last one: an
iterated extended Kalman filter in information form whose linearisation is never out of date.

While Gn is not yet observable, its posterior is not normal. Then the other parameters are solved
for at every node of ln Gn, and the nodes weighed by their evidence (Laplace's approximation at
each node): a Gaussian sum.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from fden_ros.core.estimation.estimate import Block, Estimate, EstimatorConfig, Innovation
from fden_ros.core.estimation.innovation_monitor import (
    CHANGE_DEVIATIONS,
    LONGEST_CHANGE_WINDOW,
    InnovationMonitor,
)
from fden_ros.core.estimation.motion_noise import MotionNoise
from fden_ros.core.law.characteristic import elastic_response
from fden_ros.core.law.geometry import Geometry
from fden_ros.core.law.stress_response import (
    HIGHEST_ORDER,
    LOG_SPACING,
    LOWEST_ORDER,
    STENCIL,
    Lagrange,
    LogStiffnessGrid,
    StressBasis,
    order_interpolation,
    order_nodes,
)

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Parameters, in this order everywhere.
_LOG_G, _LOG_GN, _ORDER, _ORIGIN, _BIAS, _DRIFT, _PULSE = range(7)
_SIZE = 7
#: Columns beside the law's: the free response at each order, bias, drift, the pulse of a change of
#: tissue, and the stress itself.
_ORDERS = len(order_nodes())
_BIAS_COLUMN, _DRIFT_COLUMN, _PULSE_COLUMN, _STRESS_COLUMN = range(_ORDERS, _ORDERS + 4)
_COLUMNS = _ORDERS + 4
#: Nuisances that enter the stress linearly, and their columns.
_LINEAR = ((_BIAS, _BIAS_COLUMN), (_DRIFT, _DRIFT_COLUMN), (_PULSE, _PULSE_COLUMN))

#: The nodes cover so many prior standard deviations of ln Gn.
_GRID_DEVIATIONS = 4.0
_WIDEST_GRID = 2.0
#: Nodes of the origin stand so many standard deviations from 0, and at least so far [1].
_ORIGIN_REACH, _LEAST_ORIGIN_REACH = 2.0, 0.003
#: Below this standard deviation of ln Gn the posterior is normal and narrower than the nodes'
#: distance; above the other one it is not.
_NARROW, _WIDE = 0.6 * LOG_SPACING, 0.9 * LOG_SPACING
#: A step changes ln G, ln Gn, alpha and origin by no more than this, and a nuisance by no more
#: than its reach. (A step solved for all together, of which only some are cut short, is too long
#: for the others: without a bound of their own they run away.)
_LONGEST_STEP = np.array([1.0, 0.3, 0.05, 0.02, np.inf, np.inf, np.inf])
#: Origin and nuisances stay within this many prior deviations: in the golden bags no node of ln
#: Gn, however unlikely, asks for more than 25.
_REACH_DEVIATIONS = 100.0
_MOST_STEPS, _MOST_NODE_STEPS = 10, 3
#: The nodes are given that many steps again where they have not converged.
_MOST_ROUNDS = 4
#: The posterior is solved for anew after so many blocks; when it is narrow, a plain extended
#: Kalman filter goes on from there in between.
_WIDE_BLOCKS, _NARROW_BLOCKS = 4, 10
#: Blocks that may wait to be added to the sums together, which is faster.
_MOST_PENDING = 32
#: Steps end when the last one lowered minus twice the log-posterior by less than this.
_CLOSE = 0.01
#: A solution whose last step lowered it by more than this has not converged: it is not believed.
#: (Good data end below 0.01.)
_FAR = 1.0
#: A node of less weight does not count there.
_LEAST_WEIGHT = 1e-6
_TINY_DEVIATION = 1e-12
#: Eigenvalues of a scaled Hessian below this are rounding.
_SINGULAR = 1e-11
#: ln G of a state that runs away stops so far from its prior.
_LOG_REACH = 12.0
#: Innovations count for the tests while their variance is below this many times the noise's.
_TOLD_BY_NOISE = 2.0
#: So many innovations later a mismatch is told, unless a change of the tissue explains it.
_MISMATCH_DELAY = 64
#: An innovation beyond so many deviations makes the estimate doubtful for so many blocks: by then
#: the tests have said what it was.
_SURPRISING, _DOUBTFUL_BLOCKS = 4.5, 8
#: So many blocks in a row that each are a surprise are a change.
_SURPRISES = 4
#: How much ln G may change: a lesion is up to several times stiffer than what is around it.
_CHANGE_OF_LOG_G = 1.0
#: A change is seen at least so late [s], and is so large a share of the fractional stress.
_SHORTEST_PULSE, _PULSE_SHARE = 0.002, 2.0
#: Then, so long, the pulse's shape matters too much to learn anything [s].
_BLIND_TIME = 0.1
#: A tissue that changes oftener is none that the model describes.
_MOST_CHANGES = 2


class _Steps(NamedTuple):
    """Gauss-Newton steps from n states."""

    steps: Array  #: shape (n, 7); 0 where there is no solution
    inverses: Array  #: of the Hessians, shape (n, free, free)
    log_determinants: Array  #: of the Hessians, shape (n,)
    decrements: Array  #: of minus twice the log-posterior, shape (n,); infinite without a solution


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
        self._origin_interpolation = Lagrange(origins)
        self._order_interpolation = order_interpolation()
        self._basis = StressBasis(geometry, self._grid.nodes, origins)
        nodes, inner = self._grid.nodes.size, origins.size * _ORDERS
        # Sums of products of responses: of neighbouring nodes, with the columns, of the columns.
        self._law = np.zeros((STENCIL, nodes, inner, inner))
        self._cross = np.zeros((nodes, inner, _COLUMNS))
        self._columns = np.zeros((_COLUMNS, _COLUMNS))
        self._pending: list[tuple[Array, Array, float, int]] = []
        self._mean = np.array(
            [
                math.log(prior.linear_stiffness),
                math.log(prior.nonlinear_stiffness),
                prior.fractional_order,
                0.0,
                0.0,
                0.0,
                0.0,
            ]
        )
        deviations = [
            prior.linear_stiffness_log_sd,
            prior.nonlinear_stiffness_log_sd,
            prior.fractional_order_sd,
            origin_sd,
            0.0,
            0.0,
            0.0,
        ]
        self._prior_deviations = np.array(deviations)
        self._state = self._mean.copy()
        self._covariance = np.diag(self._prior_deviations**2)
        self._prior_covariance = self._covariance.copy()
        self._node_states = np.tile(self._mean, (nodes, 1))
        self._node_states[:, _LOG_GN] = self._grid.nodes
        self._is_narrow = False
        self._is_settled = True
        self._blocks_since_solved = 0
        self._node_weights = np.exp(
            -0.5 * ((self._grid.nodes - self._mean[_LOG_GN]) / (deviations[_LOG_GN] or 1.0)) ** 2
        )
        self._node_weights /= self._node_weights.sum()
        self._max_compression = 0.0
        self._sample_count = 0
        self._contact_start: float | None = None
        self._monitor = InnovationMonitor()
        self._was_mismatch = False
        self._surprises = 0
        self._first_surprise = 0.0
        self._blind_until = -math.inf
        self._recent_states: deque[tuple[float, Array]] = deque(maxlen=LONGEST_CHANGE_WINDOW + 2)
        self.change_count = 0
        self._doubtful_blocks = 0

    @property
    def is_doubtful(self) -> bool:
        """Whether something came of late that is not explained yet."""
        return (
            self._doubtful_blocks > 0
            or not self._is_settled
            or 0 < self._monitor.mismatch_count <= _MISMATCH_DELAY
        )

    @property
    def is_mismatch(self) -> bool:
        """Whether the innovations are larger or slower than model and noise explain."""
        return self._was_mismatch or self._monitor.mismatch_count > _MISMATCH_DELAY

    # Samples

    def begin_contact(self, bias_sd: float, drift_sd: float) -> None:
        """Start a contact with its own bias [Pa] and drift [Pa/s] of the force."""
        self._motion.interrupt()
        self._forget_nuisances()
        self._was_mismatch = False
        self._contact_start = None
        for index, deviation in ((_BIAS, bias_sd), (_DRIFT, drift_sd), (_PULSE, 0.0)):
            self._mean[index] = 0.0
            self._prior_deviations[index] = deviation
            self._state[index] = 0.0
            self._node_states[:, index] = 0.0
            self._covariance[index, :] = self._covariance[:, index] = 0.0
            self._covariance[index, index] = deviation**2
        self._basis.discard_block()

    def press(self, step: float, compression: float) -> None:
        """Take a sample in contact."""
        self._motion.press(step, compression)
        self._basis.press(step, compression)

    def rest(self, steps: tuple[float, ...], free_responses: Array) -> None:
        """Take steps in the air."""
        self._motion.interrupt()
        self._basis.rest(steps, free_responses)

    def skip(self) -> None:
        """Let a block go by."""
        self._motion.skip_block()
        self._basis.discard_block()

    def update(self, block: Block) -> Innovation:
        """Take one block; return how it compared with the prediction.

        Raises
        ------
        FloatingPointError
            If the block's response is beyond floating-point numbers.
        """
        law, free, pulse = self._basis.take_block()
        if self._contact_start is None:
            self._contact_start = block.memory_time
        in_order, _ = self._order_interpolation(float(self._state[_ORDER]))
        elapsed = block.memory_time - self._contact_start
        columns = np.concatenate([free, [1.0, elapsed, float(in_order @ pulse), block.stress]])
        noise = self._noise_variance / block.size + self._noise_of_motion(block)
        innovation, jacobian = self._innovation(law, columns, block, noise)
        if not (noise > 0.0 and np.all(np.isfinite((noise, *innovation, *jacobian)))):
            raise FloatingPointError(
                f"the response to a compression of {block.compression:g} and a stress of "
                f"{block.stress:g} Pa is not finite"
            )
        self._doubtful_blocks = max(self._doubtful_blocks - 1, 0)
        if innovation.normalized_squared > _SURPRISING**2:
            self._doubtful_blocks = _DOUBTFUL_BLOCKS
        if block.memory_time >= self._blind_until:
            self._watch(innovation, noise, block, law, columns)
        if block.memory_time < self._blind_until:
            return innovation
        self._pending.append((law, columns, 1.0 / noise, block.size))
        if len(self._pending) >= _MOST_PENDING:
            self._add_up()
        self._max_compression = max(self._max_compression, block.compression)
        self._sample_count += block.size
        self._blocks_since_solved += 1
        # While every block is a surprise, the state is kept from being spoilt by a change.
        if self._is_narrow and not self._surprises:
            self._step_on(innovation, jacobian, noise)
        return innovation

    def _step_on(self, innovation: Innovation, jacobian: Array, noise: float) -> None:
        """Take one step of an extended Kalman filter, good until the next relinearisation."""
        gain = self._covariance @ jacobian / innovation.variance
        if self._config.order_given:
            # Schmidt's filter: what is not learned keeps its deviation.
            gain[_ORDER] = 0.0
        longest = self._longest_step
        step = np.clip(gain * innovation.innovation, -longest, longest)
        # Joseph's form: positive whatever the rounding.
        kept = np.eye(_SIZE) - np.outer(gain, jacobian)
        covariance = kept @ self._covariance @ kept.T + noise * np.outer(gain, gain)
        if np.all(np.isfinite(step)) and np.all(np.isfinite(covariance)):
            self._state = self._bounded(self._state + step)
            self._covariance = covariance

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
        if before > 0.0 and self._pending:
            law, columns, weight, size = self._pending[-1]
            weight = 1.0 / (1.0 / weight + before / size**2)
            self._pending[-1] = (law, columns, weight, size)
        return variance

    def _watch(
        self, innovation: Innovation, noise: float, block: Block, law: Array, columns: Array
    ) -> None:
        """Look whether the tissue has changed, or was never what the model says."""
        is_known = innovation.variance <= _TOLD_BY_NOISE * noise
        may_change = self.change_count < _MOST_CHANGES
        is_surprising = (
            innovation.normalized_squared > CHANGE_DEVIATIONS**2
            # What is not known yet cannot be surprising; but once it was, it goes on being so.
            and (is_known or not self._is_narrow or self._surprises > 0)
            and (self._is_narrow or self._is_beyond_all_nodes(innovation, law, columns))
        )
        self._surprises = self._surprises + 1 if is_surprising and may_change else 0
        if self._surprises == 1:
            self._first_surprise = block.memory_time
        if self._surprises >= _SURPRISES:
            self._start_anew(innovation, self._first_surprise, block)
            return
        is_fresh = self._is_narrow or self._blocks_since_solved == 0
        if not is_known or not is_fresh:
            # What comes from the same state twice is not independent.
            return
        monitor = self._monitor
        monitor.add(innovation.innovation / math.sqrt(innovation.variance))
        self._recent_states.append((block.memory_time, self._state.copy()))
        if monitor.change_window and may_change:
            # The newest data have spoilt the state already.
            first = max(len(self._recent_states) - monitor.change_window, 0)
            changed_at, _ = self._recent_states[first]
            _, self._state = self._recent_states[max(first - 1, 0)]
            self._start_anew(innovation, changed_at, block)

    def _is_beyond_all_nodes(self, innovation: Innovation, law: Array, columns: Array) -> bool:
        """Whether an innovation is a surprise for every ln Gn that is likely as well."""
        states = self._node_states
        in_order, by_order = self._order_interpolation(states[:, _ORDER])
        in_origin, _ = self._origin_interpolation(states[:, _ORIGIN])
        rows = np.zeros((_SIZE + 1, _COLUMNS, states.shape[0]))
        self._fill_columns(rows, states.T, in_order.T, by_order.T)
        residuals = columns @ rows[0]
        residuals += np.exp(states[:, _LOG_G]) * np.sum(law * _outer(in_origin, in_order), axis=1)
        mean = self._node_weights @ residuals
        spread = self._node_weights @ (residuals - mean) ** 2
        return bool(mean**2 > CHANGE_DEVIATIONS**2 * (innovation.variance + spread))

    def _start_anew(self, innovation: Innovation, changed_at: float, block: Block) -> None:
        """Learn a new tissue from here on; what was, is remembered as it was."""
        self._blind_until = block.memory_time + _BLIND_TIME
        first, in_gn, _ = self._grid.stencil(float(self._state[_LOG_GN]))
        in_origin, _ = self._origin_interpolation(float(self._state[_ORIGIN]))
        g = math.exp(self._state[_LOG_G])
        late = block.memory_time + 0.5 * block.duration - changed_at
        self._basis.freeze(first, g * np.outer(in_gn, in_origin), max(late, _SHORTEST_PULSE))
        self._pending.clear()
        for sums in (self._law, self._cross, self._columns):
            sums.fill(0.0)
        # Origin, bias and drift are those of the contact, the tissue is another.
        known = np.sqrt(self._covariance.diagonal())
        for index in (_ORIGIN, _BIAS, _DRIFT):
            self._mean[index] = self._state[index]
            self._prior_deviations[index] = known[index]
        for index in (_LOG_G, _LOG_GN, _ORDER):
            self._mean[index] = self._state[index]
        self._prior_deviations[_LOG_G] = math.hypot(
            self._config.prior.linear_stiffness_log_sd, _CHANGE_OF_LOG_G
        )
        self._prior_deviations[_PULSE] = _PULSE_SHARE * abs(innovation.predicted_fractional_stress)
        self._state[_PULSE] = 0.0
        self._covariance = np.diag(self._prior_deviations**2)
        self._node_states[:] = self._state
        self._node_states[:, _LOG_GN] = self._grid.nodes
        self._is_narrow = False
        self._max_compression = -math.inf
        # Nor is it one that the model describes if it did not fit before the change.
        self._was_mismatch = self.is_mismatch
        self._surprises = 0
        self._monitor = InnovationMonitor()
        self._recent_states.clear()
        self.change_count += 1

    # Solution

    def _innovation(
        self, law: Array, columns: Array, block: Block, noise: float
    ) -> tuple[Innovation, Array]:
        first, directions = self._directions(self._state)
        responses = np.concatenate([law[first : first + STENCIL].ravel(), columns])
        residual, *gradient = directions @ responses
        jacobian = np.array(gradient)
        variance = noise + float(jacobian @ self._covariance @ jacobian)
        strain = self._geometry.strain(block.compression - float(self._state[_ORIGIN]))
        response = elastic_response(
            strain, math.exp(self._state[_LOG_G]), math.exp(self._state[_LOG_GN])
        )
        innovation = Innovation(
            predicted_fractional_stress=response.value,
            predicted_stress=block.stress + float(residual),
            innovation=-float(residual),
            variance=variance,
        )
        return innovation, jacobian

    def _directions(self, state: Array) -> tuple[int, Array]:
        """Return the first node of the stencil, and rows of coefficients of stencil and columns.

        The first row gives the predicted less the observed stress, the others its derivatives by
        the parameters, shape (7, ...).
        """
        first, in_gn, by_gn = self._grid.stencil(float(state[_LOG_GN]))
        in_order, by_order = self._order_interpolation(float(state[_ORDER]))
        in_origin, by_origin = self._origin_interpolation(float(state[_ORIGIN]))
        g = math.exp(state[_LOG_G])
        inner = np.outer(in_origin, in_order).ravel()
        size = STENCIL * inner.size
        directions = np.zeros((_SIZE + 1, size + _COLUMNS))
        law, columns = directions[:, :size], directions[:, size:]
        law[0] = law[1 + _LOG_G] = np.outer(g * in_gn, inner).ravel()
        law[1 + _LOG_GN] = np.outer(g * by_gn, inner).ravel()
        law[1 + _ORDER] = np.outer(g * in_gn, np.outer(in_origin, by_order)).ravel()
        law[1 + _ORIGIN] = np.outer(g * in_gn, np.outer(by_origin, in_order)).ravel()
        self._fill_columns(columns, state, in_order, by_order)
        return first, directions

    def _stencil_products(self, first: int) -> Array:
        inner = self._cross.shape[1]
        size = STENCIL * inner
        products = np.empty((size + _COLUMNS, size + _COLUMNS))
        for i in range(STENCIL):
            rows = slice(i * inner, (i + 1) * inner)
            for j in range(i, STENCIL):
                block = self._law[j - i, first + i]
                products[rows, j * inner : (j + 1) * inner] = block
                if j > i:
                    products[j * inner : (j + 1) * inner, rows] = block.T
            cross = self._cross[first + i]
            products[rows, size:] = cross
            products[size:, rows] = cross.T
        products[size:, size:] = self._columns
        return products

    @property
    def _free(self) -> Indices:
        """Indices of the parameters that are learned."""
        learned = self._prior_deviations > 0.0
        if self._config.order_given:
            learned[_ORDER] = False
        indices: Indices = np.flatnonzero(learned)
        return indices

    def _add_up(self) -> None:
        """Add the blocks since the last time to the sums."""
        if not self._pending:
            return
        laws, columns, weights, _ = (np.array(part) for part in zip(*self._pending, strict=True))
        self._pending.clear()
        by_node = laws.transpose(1, 0, 2)
        weighted = by_node * weights[:, None]
        transposed = by_node.transpose(0, 2, 1)
        nodes = by_node.shape[0]
        for distance in range(STENCIL):
            self._law[distance, : nodes - distance] += (
                transposed[: nodes - distance] @ weighted[distance:]
            )
        self._cross += weighted.transpose(0, 2, 1) @ columns
        self._columns += (columns * weights[:, None]).T @ columns

    def settle(self, *, fully: bool = False) -> None:
        """Solve for the posterior anew, with all blocks so far, when that is due."""
        due = _NARROW_BLOCKS if self._is_narrow else _WIDE_BLOCKS
        if self._surprises or self._blocks_since_solved < (1 if fully else due):
            return
        self._blocks_since_solved = 0
        self._add_up()
        if not self._is_narrow:
            self._solve_nodes()
        if self._is_narrow:
            self._solve_narrow()

    def _solve_narrow(self) -> None:
        free = self._free
        state, least, remaining = self._state, math.inf, math.inf
        for _ in range(_MOST_STEPS):
            first, directions = self._directions(state)
            quadratic = directions @ self._stencil_products(first) @ directions.T
            solved = self._step(state[None], quadratic[None], free)
            decrement = float(solved.decrements[0])
            if not math.isfinite(decrement):
                break
            misfit = float(quadratic[0, 0] + self._distance_to_prior(state, free))
            # Where the model is wrong the steps may run in circles: the best of them counts.
            if misfit < least:
                least, remaining = misfit, decrement
                self._state = state
                self._covariance = self._covariances(solved.inverses, quadratic[None], free)[0]
            state = self._bounded(state + solved.steps[0])
            if decrement <= _CLOSE:
                self._state = state
                break
        self._is_settled = remaining <= _FAR
        if not self._is_settled or self._covariance[_LOG_GN, _LOG_GN] > _WIDE**2:
            self._is_narrow = False
            nodes = self._grid.nodes
            self._node_states[:] = self._state
            self._node_states[:, _LOG_GN] = nodes

    def _distance_to_prior(self, states: Array, free: Indices) -> Array:
        """Return the sum of squares of the free parameters' distances, shape (...)."""
        deviation = (states - self._mean)[..., free] / self._prior_deviations[free]
        distance: Array = np.sum(deviation**2, axis=-1)
        return distance

    def _step(self, states: Array, quadratics: Array, free: Indices) -> _Steps:
        """Return Gauss-Newton steps; none where the Hessian is not finite."""
        precision = self._prior_deviations[free] ** -2.0
        hessians = quadratics[:, 1 + free[:, None], 1 + free] + np.diag(precision)
        gradients = quadratics[:, 0, 1 + free] + precision * (states - self._mean)[:, free]
        inverses, log_determinants = _inverse(hessians, precision)
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
        """How far origin and nuisances may be from their prior, shape (4,)."""
        return _REACH_DEVIATIONS * self._prior_deviations[_ORIGIN:]

    @property
    def _longest_step(self) -> Array:
        longest = _LONGEST_STEP.copy()
        longest[_BIAS:] = self._reach[_BIAS - _ORIGIN :]
        return longest

    def _bounded(self, state: Array) -> Array:
        around = self._mean[_LOG_G]
        state[..., _LOG_G] = np.clip(state[..., _LOG_G], around - _LOG_REACH, around + _LOG_REACH)
        state[..., _ORDER] = np.clip(state[..., _ORDER], LOWEST_ORDER, HIGHEST_ORDER)
        state[..., _LOG_GN] = np.clip(state[..., _LOG_GN], self._grid.lowest, self._grid.highest)
        others, reach = self._mean[_ORIGIN:], self._reach
        state[..., _ORIGIN:] = np.clip(state[..., _ORIGIN:], others - reach, others + reach)
        return state

    def _covariances(self, inverses: Array, quadratics: Array, free: Indices) -> Array:
        """Return the covariances of all parameters, shape (n, 7, 7)."""
        covariances = np.zeros((inverses.shape[0], _SIZE, _SIZE))
        covariances[:, free[:, None], free] = 0.5 * (inverses + inverses.transpose(0, 2, 1))
        if self._config.order_given:
            # What the given order's own uncertainty does (consider analysis).
            sensitivity = np.zeros((inverses.shape[0], _SIZE))
            coupling = quadratics[:, 1 + free, 1 + _ORDER]
            sensitivity[:, free] = -(inverses @ coupling[:, :, None])[:, :, 0]
            sensitivity[:, _ORDER] = self._prior_deviations[_ORDER]
            sensitivity[:, free] *= self._prior_deviations[_ORDER]
            covariances += sensitivity[:, :, None] * sensitivity[:, None, :]
        return covariances

    def _solve_nodes(self) -> None:
        """Solve at every node of ln Gn, and take the moments of all."""
        free = self._free
        free = free[free != _LOG_GN]
        for _ in range(_MOST_ROUNDS):
            solved, quadratics = self._approach(free)
            weights = self._weights(solved, quadratics, free)
            likely = weights > _LEAST_WEIGHT
            remaining = weights[likely] @ solved.decrements[likely] if np.any(likely) else math.inf
            self._is_settled = bool(remaining <= _FAR)
            if self._is_settled:
                break
        if not self._is_settled:
            # The nodes go on from where they are at the next solution.
            return
        states = self._node_states
        self._node_weights = weights
        self._state = np.where(self._prior_deviations > 0.0, weights @ states, self._mean)
        if self._config.order_given:
            self._state[_ORDER] = self._mean[_ORDER]
        centred = states - self._state
        covariance = (weights[:, None] * centred).T @ centred
        own = self._covariances(solved.inverses[likely], quadratics[likely], free)
        covariance += np.tensordot(weights[likely], own, 1)
        self._covariance = covariance
        self._is_narrow = bool(covariance[_LOG_GN, _LOG_GN] < _NARROW**2)

    def _approach(self, free: Indices) -> tuple[_Steps, Array]:
        """Take a few steps at every node; return the last ones and the products where they led."""
        states = self._node_states
        quadratics = self._node_quadratics(states)
        for _ in range(_MOST_NODE_STEPS):
            solved = self._step(states, quadratics, free)
            states = self._node_states = self._bounded_nodes(states + solved.steps)
            quadratics = self._node_quadratics(states)
            close = solved.decrements <= _CLOSE
            if np.all(close | (self._node_weights < _LEAST_WEIGHT)):
                break
        return solved, quadratics

    def _weights(self, solved: _Steps, quadratics: Array, free: Indices) -> Array:
        """Return the nodes' weights by their evidence; 0 for one without a solution."""
        log_evidence = -0.5 * (
            quadratics[:, 0, 0]
            + self._distance_to_prior(self._node_states, free)
            + solved.log_determinants
            + ((self._grid.nodes - self._mean[_LOG_GN]) / self._prior_deviations[_LOG_GN]) ** 2
        )
        is_solved = np.isfinite(log_evidence) & np.isfinite(solved.decrements)
        if not np.any(is_solved):
            return np.zeros_like(log_evidence)
        weights: Array = np.zeros_like(log_evidence)
        weights[is_solved] = np.exp(log_evidence[is_solved] - log_evidence[is_solved].max())
        weights /= weights.sum()
        return weights

    def _bounded_nodes(self, states: Array) -> Array:
        states = self._bounded(states)
        states[:, _LOG_GN] = self._grid.nodes
        return states

    def _node_quadratics(self, states: Array) -> Array:
        """Products of residual and derivatives with ln Gn at a node, shape (nodes, 7, 7)."""
        inner = self._cross.shape[1]
        products = np.empty((states.shape[0], inner + _COLUMNS, inner + _COLUMNS))
        products[:, :inner, :inner] = self._law[0]
        products[:, :inner, inner:] = self._cross
        products[:, inner:, :inner] = self._cross.transpose(0, 2, 1)
        products[:, inner:, inner:] = self._columns
        in_order, by_order = self._order_interpolation(states[:, _ORDER])
        in_origin, by_origin = self._origin_interpolation(states[:, _ORIGIN])
        in_origin = np.exp(states[:, _LOG_G])[:, None] * in_origin
        by_origin = np.exp(states[:, _LOG_G])[:, None] * by_origin
        directions = np.zeros((states.shape[0], _SIZE + 1, inner + _COLUMNS))
        law, columns = directions[:, :, :inner], directions[:, :, inner:]
        law[:, 0] = law[:, 1 + _LOG_G] = _outer(in_origin, in_order)
        law[:, 1 + _ORDER] = _outer(in_origin, by_order)
        law[:, 1 + _ORIGIN] = _outer(by_origin, in_order)
        self._fill_columns(columns.transpose(1, 2, 0), states.T, in_order.T, by_order.T)
        result: Array = directions @ products @ directions.transpose(0, 2, 1)
        return result

    @staticmethod
    def _fill_columns(columns: Array, state: Array, in_order: Array, by_order: Array) -> None:
        columns[0, :_ORDERS] = in_order
        columns[0, _STRESS_COLUMN] = -1.0
        columns[1 + _ORDER, :_ORDERS] = by_order
        for index, column in _LINEAR:
            columns[0, column] = state[index]
            columns[1 + index, column] = 1.0

    def _forget_nuisances(self) -> None:
        """Take what bias and drift of the last contact explain out of the sums."""
        self._add_up()
        for index, column in _LINEAR:
            deviation = self._prior_deviations[index]
            own = self._columns[column, column] + (deviation**-2 if deviation > 0.0 else 0.0)
            if deviation > 0.0 and own > 0.0:
                by_law = self._cross[:, :, column].copy()
                by_column = self._columns[column].copy()
                for distance in range(STENCIL):
                    end = by_law.shape[0] - distance
                    self._law[distance, :end] -= (
                        by_law[:end, :, None] * by_law[distance:, None, :] / own
                    )
                self._cross -= by_law[:, :, None] * by_column / own
                self._columns -= np.outer(by_column, by_column) / own
            self._cross[:, :, column] = 0.0
            self._columns[column, :] = self._columns[:, column] = 0.0

    # Result

    def estimate(self) -> Estimate:
        """Return the present estimate."""
        config = self._config
        # Symmetric to the last bit, which products of matrices are not.
        covariance = 0.5 * self._monitor.inflation * (self._covariance + self._covariance.T)
        if self.is_mismatch:
            # The parameters of a wrong model are known no better than before the touch.
            covariance += self._prior_covariance
        beyond = self._probability_beyond_boundary()
        return Estimate(
            log_linear_stiffness=float(self._state[_LOG_G]),
            log_nonlinear_stiffness=float(self._state[_LOG_GN]),
            fractional_order=float(self._state[_ORDER]),
            covariance=covariance[:3, :3],
            strain_origin=float(self._state[_ORIGIN]),
            strain_origin_sd=math.sqrt(max(covariance[_ORIGIN, _ORIGIN], 0.0)),
            probability_beyond_boundary=beyond,
            converged=self._is_settled
            and beyond >= config.converged_probability
            and math.sqrt(covariance[_LOG_GN, _LOG_GN]) <= config.converged_log_sd,
            sample_count=self._sample_count,
        )

    def _probability_beyond_boundary(self) -> float:
        compression = self._max_compression - float(self._state[_ORIGIN])
        if compression <= 0.0:
            return 0.0
        strain = self._geometry.strain(compression)
        if self._is_narrow:
            deviation = math.sqrt(self._covariance[_LOG_GN, _LOG_GN]) + _TINY_DEVIATION
            return float(ndtr((math.log(strain) + self._state[_LOG_GN]) / deviation))
        beyond = ndtr((math.log(strain) + self._grid.nodes) / (0.5 * LOG_SPACING))
        return float(min(self._node_weights @ beyond, 1.0))


def _inverse(matrices: Array, least: Array) -> tuple[Array, Array]:
    """Return inverses and logarithms of determinants of positive definite matrices.

    Of matrices, that is, which rounding may have robbed of being so.

    Parameters
    ----------
    matrices : ndarray, shape (n, k, k)
    least : ndarray, shape (k,)
        What each diagonal element is at least, but for rounding: its scale.

    Returns
    -------
    ndarray, shape (n, k, k)
        NaN where the matrix is not finite.
    ndarray, shape (n,)
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


def _outer(a: Array, b: Array) -> Array:
    """Return the outer products of rows, flattened, shape (n, a.size * b.size)."""
    products: Array = (a[:, :, None] * b[:, None, :]).reshape(a.shape[0], -1)
    return products
