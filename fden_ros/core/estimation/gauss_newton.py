# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The maximum of the posterior by Gauss-Newton steps, at one state or at every node of ln Gn.

A step minimises the misfit of all blocks and of the prior, both quadratic in the state about the
present one. Where the posterior is normal its maximum and the inverse Hessian there are all of it.
Where it is not, the other parameters are solved for at every node of ln Gn, the nodes are weighed
by their evidence (Laplace's approximation at each), and the moments are those of all of them.

Steps are bounded, and a solution that has not converged says so: it is not to be believed.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array, Indices
from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.normal_equations import NormalEquations
from fden_ros.core.estimation.state_prior import StatePrior
from fden_ros.core.law.interpolation import LOG_SPACING, LogStiffnessGrid
from fden_ros.core.law.kernel import HIGHEST_ORDER, LOWEST_ORDER

_LOG_G = StateIndex.LOG_LINEAR_STIFFNESS
_LOG_GN = StateIndex.LOG_NONLINEAR_STIFFNESS
_ORDER = StateIndex.FRACTIONAL_ORDER
_ORIGIN = StateIndex.STRAIN_ORIGIN

#: Longest change of (ln G, ln Gn, alpha, o) in a step [1]: the range over which the response is
#: nearly linear in each. A linear parameter changes by no more than its reach. (A step solved for
#: all together, of which only some are cut short, is too long for the others: without a bound of
#: their own they run away.)
_LONGEST_STEP = (1.0, 0.3, 0.05, 0.02)
#: Prior deviations [1] within which the origin and the linear parameters stay: in the golden bags
#: no node of ln Gn, however unlikely, asks for more than 25. Half or twice gives the same bits.
_REACH_DEVIATIONS = 100.0
#: Prior deviations [1] by which the tissue may begin before the surface found, even where that is
#: beyond the strains at which its response is interpolated well.
_BEFORE_DEVIATIONS = 5.0
#: Steps of a solution at most [1]: of one state, and of the nodes; what has not converged by then
#: goes on at the next solution.
_MOST_STEPS, _MOST_NODE_STEPS = 10, 3
#: Times [1] that the nodes are given these steps while they have not converged.
_MOST_ROUNDS = 4
#: Steps end when the last one lowered minus twice the log-posterior by less than this [1]: a tenth
#: of a standard deviation.
_CLOSE = 0.01
#: A solution whose last step lowered it by more than this [1] has not converged, and is not
#: believed. (Good data end below 0.01.)
_FAR = 1.0
#: Weight [1] below which a node does not count.
_LEAST_WEIGHT = 1e-6
#: Eigenvalues of a scaled Hessian [1] below this are rounding: its elements are 1, and known to
#: 2e-16 times their number and the growth of the sums.
_SINGULAR = 1e-11
#: Of the integral over ln Gn as a sum over nodes, beside that of a normal posterior [1].
_LOG_NODE_WIDTH = math.log(LOG_SPACING / math.sqrt(2.0 * math.pi))
#: Distance from the prior [1] at which ln G stops: a factor of 160,000 either way is no tissue.
LOG_REACH = 12.0


class Solution(NamedTuple):
    """The maximum of a normal posterior."""

    state: Array  #: shape (n,)
    covariance: Array  #: shape (n, n)
    is_converged: bool
    #: Logarithm of the evidence by Laplace's approximation [1], but for the determinant of the
    #: prior and the noise of the blocks; None where no step was solved for.
    log_evidence: float | None = None


class NodeSolution(NamedTuple):
    """The maxima at the nodes of ln Gn, and the moments of all."""

    states: Array  #: shape (nodes, n)
    weights: Array  #: shape (nodes,); 0 without a solution
    moments: Solution | None  #: None where the nodes that count have not converged


class _Steps(NamedTuple):
    """Gauss-Newton steps from m states."""

    steps: Array  #: shape (m, n); 0 where there is no solution
    roots: Array  #: R of the Hessians' inverses R^T R, shape (m, free, free)
    log_determinants: Array  #: of the Hessians, shape (m,)
    decrements: Array  #: of minus twice the log-posterior, shape (m,); infinite without a solution


class _Problem(NamedTuple):
    """What stays the same during a solution."""

    free: Indices  #: of the parameters that are solved for, shape (free,)
    precision: Array  #: of their prior, shape (free, free)
    longest: Array  #: their longest changes in a step, shape (free,)
    bounds: tuple[Array, Array]  #: lowest and highest state, shape (n,) each


class GaussNewton:
    """The solver of one posterior.

    Parameters
    ----------
    equations : NormalEquations
        The sums over all blocks.
    prior : StatePrior
    grid : LogStiffnessGrid
        Nodes of ln Gn.
    is_order_learned : bool
        Otherwise alpha stays where it is, and its deviation counts all the same.
    """

    def __init__(
        self,
        equations: NormalEquations,
        prior: StatePrior,
        grid: LogStiffnessGrid,
        *,
        is_order_learned: bool,
    ) -> None:
        self._equations = equations
        self._prior = prior
        self._grid = grid
        self._is_order_learned = is_order_learned

    # Bounds

    @property
    def _reach(self) -> Array:
        """Distance from their prior at which origin and linear parameters stop, shape (n - 3,)."""
        return _REACH_DEVIATIONS * self._prior.deviations[_ORIGIN:]

    @property
    def longest_step(self) -> Array:
        """Longest change of each parameter in a step, shape (n,)."""
        return np.concatenate([_LONGEST_STEP, self._reach[1:]])

    @property
    def _bounds(self) -> tuple[Array, Array]:
        """Lowest and highest state, shape (n,) each."""
        around, reach = self._prior.mean, self._reach
        lowest, highest = around - LOG_REACH, around + LOG_REACH
        lowest[_LOG_GN], highest[_LOG_GN] = self._grid.lowest, self._grid.highest
        lowest[_ORDER], highest[_ORDER] = LOWEST_ORDER, HIGHEST_ORDER
        lowest[_ORIGIN:], highest[_ORIGIN:] = around[_ORIGIN:] - reach, around[_ORIGIN:] + reach
        widest = self._grid.widest_origin
        before = max(_BEFORE_DEVIATIONS * self._prior.deviations[_ORIGIN], widest)
        lowest[_ORIGIN] = max(lowest[_ORIGIN], -before)
        highest[_ORIGIN] = min(highest[_ORIGIN], widest)
        return lowest, highest

    def bounded(self, states: Array) -> Array:
        """Keep states, shape (..., n), where the response is known, in place."""
        return _between(states, self._bounds)

    # Solutions

    @property
    def _free(self) -> Indices:
        """Indices of the parameters that are learned, shape (free,)."""
        learned = self._prior.learned
        return learned if self._is_order_learned else learned[learned != _ORDER]

    def _problem(self, free: Indices) -> _Problem:
        return _Problem(free, self._prior.precision(free), self.longest_step[free], self._bounds)

    def solve(self, state: Array, covariance: Array) -> Generator[None, None, Solution]:
        """Return the maximum near a state, or the state where there is no step to take.

        A generator, which yields after every step: they need not be taken at once.

        Parameters
        ----------
        state : ndarray, shape (n,)
        covariance : ndarray, shape (n, n)
        """
        problem = self._problem(self._free)
        free = problem.free
        best = Solution(state, covariance, is_converged=False)
        least, remaining = math.inf, math.inf
        for _ in range(_MOST_STEPS):
            quadratic = self._equations.at_state(state)
            solved = self._step(state[None], quadratic[None], problem)
            decrement = float(solved.decrements[0])
            if not math.isfinite(decrement):
                break
            misfit = float(quadratic[0, 0] + self._prior.distance(state, free))
            # Where the model is wrong the steps may run in circles: the best of them counts.
            if misfit < least:
                least, remaining = misfit, decrement
                covariance = self._covariances(solved.roots, quadratic[None], free)[0]
                evidence = -0.5 * (misfit + float(solved.log_determinants[0]))
                evidence += self._equations.log_normalisation
                best = Solution(state, covariance, is_converged=False, log_evidence=evidence)
            state = _between(state + solved.steps[0], problem.bounds)
            if decrement <= _CLOSE:
                best = best._replace(state=state)
                break
            yield
        return best._replace(is_converged=remaining <= _FAR)

    def solve_at_nodes(self, states: Array, weights: Array) -> Generator[None, None, NodeSolution]:
        """Return the maxima at every node of ln Gn, and the moments of all.

        A generator, which yields after every step.

        Parameters
        ----------
        states : ndarray, shape (nodes, n)
            Where the steps begin.
        weights : ndarray, shape (nodes,)
            Of the nodes so far: those of no weight need not converge.
        """
        learned = self._free
        problem = self._problem(learned[learned != _LOG_GN])
        free, before = problem.free, weights
        quadratics = self._equations.at_nodes(states)
        for _ in range(_MOST_ROUNDS):
            states, solved, quadratics = yield from self._approach(
                states, quadratics, before, problem
            )
            weights, evidence = self._weights(states, solved, quadratics, free)
            likely = weights > _LEAST_WEIGHT
            remaining = weights[likely] @ solved.decrements[likely] if np.any(likely) else math.inf
            if remaining <= _FAR:
                own = self._covariances(solved.roots[likely], quadratics[likely], free)
                moments = self._moments(states, weights, own)
                evidence += self._equations.log_normalisation
                return NodeSolution(states, weights, moments._replace(log_evidence=evidence))
        return NodeSolution(states, weights, None)

    def _moments(self, states: Array, weights: Array, own: Array) -> Solution:
        """Return mean and covariance over the nodes.

        Parameters
        ----------
        states : ndarray, shape (nodes, n)
        weights : ndarray, shape (nodes,)
        own : ndarray, shape (likely, n, n)
            Covariances at the nodes that count.
        """
        prior = self._prior
        mean = np.where(prior.deviations > 0.0, weights @ states, prior.mean)
        if not self._is_order_learned:
            mean[_ORDER] = prior.mean[_ORDER]
        centred = states - mean
        covariance = (weights[:, None] * centred).T @ centred
        covariance += np.tensordot(weights[weights > _LEAST_WEIGHT], own, 1)
        return Solution(mean, covariance, is_converged=True)

    def _approach(
        self, states: Array, quadratics: Array, weights: Array, problem: _Problem
    ) -> Generator[None, None, tuple[Array, _Steps, Array]]:
        """Take steps at every node; return where they lead, the last ones, the products there."""
        for _ in range(_MOST_NODE_STEPS):
            yield
            solved = self._step(states, quadratics, problem)
            states = _between(states + solved.steps, problem.bounds)
            states[:, _LOG_GN] = self._grid.nodes
            quadratics = self._equations.at_nodes(states)
            close = solved.decrements <= _CLOSE
            if (close | (weights < _LEAST_WEIGHT)).all():
                break
        return states, solved, quadratics

    def _weights(
        self, states: Array, solved: _Steps, quadratics: Array, free: Indices
    ) -> tuple[Array, float]:
        """Return the nodes' weights by their evidence (nodes,), and the evidence of all.

        The weight is 0 without a solution.
        """
        prior = self._prior
        log_evidence = -0.5 * (
            quadratics[:, 0, 0]
            + prior.distance(states, free)
            + solved.log_determinants
            + ((self._grid.nodes - prior.mean[_LOG_GN]) / prior.deviations[_LOG_GN]) ** 2
        )
        is_solved = np.isfinite(log_evidence) & np.isfinite(solved.decrements)
        weights: Array = np.zeros_like(log_evidence)
        if not np.any(is_solved):
            return weights, -math.inf
        highest = float(log_evidence[is_solved].max())
        weights[is_solved] = np.exp(log_evidence[is_solved] - highest)
        total = float(weights.sum())
        return weights / total, highest + math.log(total) + _LOG_NODE_WIDTH

    def _step(self, states: Array, quadratics: Array, problem: _Problem) -> _Steps:
        """Return Gauss-Newton steps; none where the Hessian is not finite.

        Parameters
        ----------
        states : ndarray, shape (m, n)
        quadratics : ndarray, shape (m, n + 1, n + 1)
        problem : _Problem
        """
        free, precision, longest, _ = problem
        hessians = quadratics[:, 1 + free[:, None], 1 + free] + precision
        gradients = quadratics[:, 0, 1 + free] + (states - self._prior.mean)[:, free] @ precision
        roots, log_determinants = _inverse_roots(hessians, precision.diagonal())
        wanted = -(roots.transpose(0, 2, 1) @ (roots @ gradients[:, :, None]))[:, :, 0]
        is_solved = np.isfinite(log_determinants) & np.isfinite(wanted).all(axis=1)
        moved = np.where(
            is_solved[:, None], np.minimum(np.maximum(wanted, -longest), longest), 0.0
        )
        steps = np.zeros_like(states)
        steps[:, free] = moved
        decrements = (moved[:, None, :] @ hessians @ moved[:, :, None])[:, 0, 0]
        decrements[~is_solved] = math.inf
        return _Steps(steps, roots, log_determinants, decrements)

    def _covariances(self, roots: Array, quadratics: Array, free: Indices) -> Array:
        """Return the covariances of all parameters.

        Parameters
        ----------
        roots : ndarray, shape (m, free, free)
            R of the Hessians' inverses R^T R.
        quadratics : ndarray, shape (m, n + 1, n + 1)
        free : ndarray, shape (free,)

        Returns
        -------
        ndarray, shape (m, n, n)
        """
        size = self._prior.mean.size
        inverses = roots.transpose(0, 2, 1) @ roots
        covariances = np.zeros((inverses.shape[0], size, size))
        covariances[:, free[:, None], free] = 0.5 * (inverses + inverses.transpose(0, 2, 1))
        if not self._is_order_learned:
            # The uncertainty of an alpha that is not learned counts too (consider analysis).
            deviation = self._prior.deviations[_ORDER]
            sensitivity = np.zeros((inverses.shape[0], size))
            coupling = quadratics[:, 1 + free, 1 + _ORDER]
            sensitivity[:, free] = -(inverses @ coupling[:, :, None])[:, :, 0]
            sensitivity[:, _ORDER] = deviation
            sensitivity[:, free] *= deviation
            covariances += sensitivity[:, :, None] * sensitivity[:, None, :]
        return covariances


def _between(states: Array, bounds: tuple[Array, Array]) -> Array:
    """Keep states, shape (..., n), between bounds, shape (n,) each, in place."""
    lowest, highest = bounds
    np.maximum(states, lowest, out=states)
    bounded: Array = np.minimum(states, highest, out=states)
    return bounded


def _inverse_roots(matrices: Array, least: Array) -> tuple[Array, Array]:
    """Return roots of the inverses of positive definite matrices, and their log-determinants.

    Rounding may have robbed the matrices of being so.

    Parameters
    ----------
    matrices : ndarray, shape (m, free, free)
    least : ndarray, shape (free,)
        Lower bound of each diagonal element, but for rounding: its scale.

    Returns
    -------
    roots : ndarray, shape (m, free, free)
        R of R^T R; NaN where the matrix is not finite.
    log_determinants : ndarray, shape (m,)
        Of the matrices; NaN there too.
    """
    diagonal = np.maximum(matrices.diagonal(axis1=1, axis2=2), least)
    scale = 1.0 / np.sqrt(diagonal)
    scaled = matrices * scale[:, :, None] * scale[:, None, :]
    roots, log_determinants = _scaled_inverse_roots(scaled)
    roots *= scale[:, None, :]
    log_determinants += np.log(diagonal).sum(axis=1)
    return roots, log_determinants


def _scaled_inverse_roots(matrices: Array) -> tuple[Array, Array]:
    """Do so for matrices whose diagonals are about 1, by Cholesky's factors.

    The sum of the reciprocal eigenvalues is more than the largest of them: where it shows that
    none is rounding, the factors serve; elsewhere the eigenvalues are bounded.
    """
    try:
        factors = np.asarray(np.linalg.cholesky(matrices), dtype=np.float64)
    except np.linalg.LinAlgError:
        return _roots_by_eigenvalues(matrices)
    roots = _inverse_of_lower(factors)
    log_determinants: Array = -2.0 * np.log(roots.diagonal(axis1=1, axis2=2)).sum(axis=1)
    is_rounding = ~(np.einsum("ijk,ijk->i", roots, roots) < 1.0 / _SINGULAR)
    if is_rounding.any():
        own = _roots_by_eigenvalues(matrices[is_rounding])
        roots[is_rounding], log_determinants[is_rounding] = own
    return roots, log_determinants


def _inverse_of_lower(factors: Array) -> Array:
    """Return the inverses of lower triangular matrices, by forward substitution."""
    reciprocals = 1.0 / factors.diagonal(axis1=1, axis2=2)
    scaled = -reciprocals[:, :, None] * factors
    inverses = np.zeros(factors.shape)
    for row in range(factors.shape[1]):
        own = inverses[:, row : row + 1, :row]
        np.matmul(scaled[:, row : row + 1, :row], inverses[:, :row, :row], out=own)
        inverses[:, row, row] = reciprocals[:, row]
    return inverses


def _roots_by_eigenvalues(matrices: Array) -> tuple[Array, Array]:
    is_finite = np.all(np.isfinite(matrices), axis=(1, 2))
    values, vectors = np.linalg.eigh(
        np.where(is_finite[:, None, None], matrices, np.eye(matrices.shape[1]))
    )
    values = np.where(is_finite[:, None], np.maximum(values, _SINGULAR), math.nan)
    roots: Array = vectors.transpose(0, 2, 1) / np.sqrt(values)[:, :, None]
    log_determinants: Array = np.sum(np.log(values), axis=1)
    return roots, log_determinants
