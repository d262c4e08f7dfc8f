# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Sums of products over the whole past, from which any parameters' misfit follows.

The predicted less the observed mean stress of a block is

.. math::
    r = G \sum_{nodes} w(\ln G_n)\,w(\alpha)\,w(o)\, L + \sum_{orders} w(\alpha)\, F
    + \sum_k \theta_k C_k - f,

with L the law's responses at the nodes of ln Gn, alpha and the strain origin o, F the response to
what was in the air before at the order nodes, and :math:`C_k` one *linear column* for each
parameter :math:`\theta_k` that enters the stress linearly. So the sum of squares of r and of its
derivatives, over all blocks and weighed by their variances, is a quadratic form in the products of
responses. Only these are kept (:mod:`fden_ros.core.estimation.response_sums`).

A linear column needs no more than a name: :class:`NormalEquations` sums it, differentiates by its
parameter, and takes it out (:meth:`NormalEquations.marginalise`) when its parameter ends, as bias
and drift do with their contact.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.response_sums import MOST_BEHIND, ResponseSums
from fden_ros.core.law.interpolation import (
    STENCIL,
    Lagrange,
    LogStiffnessGrid,
    OriginInterpolation,
)
from fden_ros.core.law.kernel import order_interpolation, order_nodes

_LOG_G = StateIndex.LOG_LINEAR_STIFFNESS
_LOG_GN = StateIndex.LOG_NONLINEAR_STIFFNESS
_ORDER = StateIndex.FRACTIONAL_ORDER
_ORIGIN = StateIndex.STRAIN_ORIGIN
#: Parameters before those of the linear columns: the law's stress depends on these alone.
_NONLINEAR = 4
_ORDERS = len(order_nodes())


class BlockResponse(NamedTuple):
    """Mean responses of a block at all nodes, and what was observed."""

    law: Array  #: D^alpha phi at G = 1 [1], shape (nodes, origins * orders)
    columns: Array  #: F (orders), linear columns, and the stress [Pa], shape (columns,)


class _Pending(NamedTuple):
    response: BlockResponse
    weight: float  #: 1 over the variance of the block's mean stress [1/Pa^2]
    size: int  #: samples in the block


class NormalEquations:
    """The sums, and the quadratic form of any state.

    The state is (ln G, ln Gn, alpha, o) and one parameter for each linear column: shape (n,).

    Parameters
    ----------
    grid : LogStiffnessGrid
        Nodes of ln Gn.
    origins : ndarray, shape (origins,)
        Nodes of the strain origin [1].
    linear : sequence of str
        Names of the linear columns.
    scaled : sequence of str
        Those of them that are given at G = 1 and multiplied by G.
    given_order : float, optional
        The alpha of every state [1], where it is given: then the responses there and their slopes
        by alpha are all that is summed.
    """

    def __init__(
        self,
        grid: LogStiffnessGrid,
        origins: Array,
        linear: Sequence[str],
        scaled: Sequence[str] = (),
        given_order: float | None = None,
    ) -> None:
        self.linear = tuple(linear)
        self._scaled = np.array([name in scaled for name in linear])
        #: Length n of the state.
        self.size = _NONLINEAR + len(self.linear)
        self._grid = grid
        self._in_origin = OriginInterpolation(origins, grid.nodes)
        self._in_order = self._in_all_orders = order_interpolation()
        self._orders = orders = _ORDERS if given_order is None else 2
        #: From the responses at the order nodes to the two that are summed, shape (11, 2).
        self._to_given: Array | None = None
        if given_order is not None:
            # The tangent, at alpha and at alpha + 1.
            weights, slopes = self._in_all_orders(given_order)
            self._to_given = np.stack([weights, weights + slopes], axis=1)
            self._in_order = Lagrange(given_order + np.arange(2.0))
        self._column_count = orders + len(self.linear) + 1
        self._sums = ResponseSums(
            grid.nodes.size, origins.size * orders, self._column_count, slice(orders, -1)
        )
        self._pending: list[_Pending] = []
        self._deferred: list[Callable[[], None]] = []
        #: Added to the sums last; None: these have changed since, or will.
        self._newest: _Pending | None = None
        self._log_normalisation = 0.0

    def index(self, name: str) -> int:
        """Return the place in the state of a linear column's parameter."""
        return _NONLINEAR + self.linear.index(name)

    # Sums

    def respond(
        self, law: Array, free: Array, linear: Sequence[float] | Array, stress: float
    ) -> BlockResponse:
        """Return the responses of a block.

        Parameters
        ----------
        law : ndarray, shape (nodes, origins * 11)
            D^alpha phi at G = 1 [1].
        free : ndarray, shape (11,)
            D^alpha of phi in the air before [Pa].
        linear : sequence of float
            The linear columns, in the order of their names.
        stress : float
            Observed [Pa].
        """
        if self._to_given is not None:
            law = (law.reshape(-1, _ORDERS) @ self._to_given).reshape(law.shape[0], -1)
            free = free @ self._to_given
        return BlockResponse(law, np.concatenate([free, linear, [stress]]))

    def add(self, response: BlockResponse, noise: float, size: int) -> None:
        """Take a block whose mean stress of `size` samples has the variance `noise` [Pa^2]."""
        self._pending.append(_Pending(response, 1.0 / noise, size))
        if len(self._pending) >= MOST_BEHIND:
            self._add_up()

    def amend_newest(self, variance: float, index: int, change: float) -> None:
        """Correct the newest block by what the one after it tells.

        Parameters
        ----------
        variance : float
            By which one of its samples is further off [Pa^2]; too late for a block that has been
            added to the sums already.
        index : int
            Place in the state of a linear column's parameter.
        change : float
            Added to that column.
        """
        if self._pending and (variance > 0.0 or change):
            (law, columns), weight, size = self._pending[-1]
            columns = columns.copy()
            columns[self._column(index)] += change
            weight = 1.0 / (1.0 / weight + variance / size**2)
            self._pending[-1] = _Pending(BlockResponse(law, columns), weight, size)
        elif self._newest is not None and change:
            (law, columns), weight, _ = self._newest
            self._sums.change_column(self._column(index), change, law, columns, weight)

    def work_ahead(self) -> bool:
        """Bring the sums up to date if many blocks wait, while nobody waits for an estimate.

        Return whether they do.
        """
        if len(self._pending) < MOST_BEHIND // 2:
            return False
        self._add_up()
        return True

    def clear(self) -> None:
        """Forget all blocks."""
        self._pending.clear()
        self._deferred.clear()
        self._newest = None
        self._log_normalisation = 0.0
        self._sums.clear()

    def _defer(self, operation: Callable[[], None]) -> None:
        """Change the sums before they are used the next time, after the blocks so far.

        What takes long is not done while somebody waits for the estimate of a block.
        """
        if self._pending:
            self._deferred.append(functools.partial(self._add_blocks, self._pending))
            self._pending = []
        self._newest = None
        self._deferred.append(operation)

    @property
    def log_normalisation(self) -> float:
        """What bound and marginalised parameters add to the logarithm of the evidence [1].

        Half the logarithms of the precisions that were bound, less half of those of the Hessian
        that were marginalised.
        """
        self._add_up()
        return self._log_normalisation

    def _add_up(self) -> None:
        """Bring the sums up to date: what was deferred, then the newest blocks."""
        if not (self._pending or self._deferred):
            return
        for operation in self._deferred:
            operation()
        self._deferred.clear()
        if self._pending:
            self._add_blocks(self._pending)
            self._newest = self._pending[-1]
            self._pending = []

    def _add_blocks(self, blocks: list[_Pending]) -> None:
        """Add blocks to the sums together."""
        self._sums.add(
            np.array([block.response.law for block in blocks]),
            np.array([block.response.columns for block in blocks]),
            np.array([block.weight for block in blocks]),
        )

    def marginalise(self, index: int, precision: float) -> None:
        """Take out of the sums what the parameter of a linear column explains.

        Its column begins anew at 0, for another parameter in the same place.

        Parameters
        ----------
        index : int
            Place of the parameter in the state.
        precision : float
            1 over its prior variance; 0 where its prior is in the sums (:meth:`bind`).
        """
        self._defer(functools.partial(self._marginalise, self._column(index), precision))

    def _marginalise(self, column: int, precision: float) -> None:
        own = float(self._sums.columns[column, column]) + precision
        if own > 0.0:
            self._log_normalisation -= 0.5 * math.log(own)
            self._sums.take_out(column, own)
        self._sums.forget(column)

    def forget(self, index: int) -> None:
        """Let the column of a parameter that is known to be 0 begin anew."""
        self._defer(functools.partial(self._sums.forget, self._column(index)))

    def bind(self, index: int, other: int | None, precision: float) -> None:
        """Add to the sums that two linear parameters, or one and 0, differ little.

        Parameters
        ----------
        index : int
        other : int or None
            None: 0.
        precision : float
            1 over the variance of the difference.
        """
        partner = None if other is None else self._column(other)
        self._defer(functools.partial(self._bind, self._column(index), partner, precision))

    def _bind(self, column: int, partner: int | None, precision: float) -> None:
        self._log_normalisation += 0.5 * math.log(precision)
        columns = self._sums.columns
        columns[column, column] += precision
        if partner is None:
            return
        columns[partner, partner] += precision
        columns[column, partner] -= precision
        columns[partner, column] -= precision

    def move(self, index: int, target: int) -> None:
        """Let a linear parameter take the place of another, whose column was forgotten."""
        self._defer(functools.partial(self._sums.move, self._column(index), self._column(target)))

    def _column(self, index: int) -> int:
        return index - _NONLINEAR + self._orders

    # One block

    def residual(self, response: BlockResponse, state: Array) -> tuple[float, Array]:
        """Return predicted less observed stress [Pa], and its derivatives by the state (n,)."""
        g = math.exp(state[_LOG_G])
        first, in_gn, by_gn = self._grid.stencil(float(state[_LOG_GN]))
        in_order, by_order = self._in_order(float(state[_ORDER]))
        used = slice(first, first + STENCIL)
        in_origin, by_origin = self._in_origin(float(state[_ORIGIN]), used)
        # At the nodes of ln Gn, by the origins: (8, orders, origins).
        law = response.law[used].reshape(STENCIL, -1, self._orders).transpose(0, 2, 1)
        at_origin = g * (law @ in_origin[:, :, None])[:, :, 0]
        by_law = in_gn @ at_origin
        free = response.columns[: self._orders]
        columns = response.columns[self._orders : -1] * self._factors(g)
        stresses = columns * state[_NONLINEAR:]
        stress = by_law @ in_order
        gradient = np.empty(self.size)
        gradient[_LOG_G] = stress + stresses @ self._scaled
        gradient[_LOG_GN] = by_gn @ at_origin @ in_order
        gradient[_ORDER] = by_law @ by_order + by_order @ free
        gradient[_ORIGIN] = g * (in_gn @ (law @ by_origin[:, :, None])[:, :, 0] @ in_order)
        gradient[_NONLINEAR:] = columns
        residual = stress + in_order @ free + stresses.sum() - response.columns[-1]
        return float(residual), gradient

    def _factors(self, g: float | Array) -> Array:
        """Return by how much the stress grows with each linear parameter's column."""
        factors: Array = np.where(self._scaled, g, 1.0)
        return factors

    def node_residuals(self, response: BlockResponse, states: Array) -> Array:
        """Return predicted less observed stress [Pa] with each ln Gn at its node.

        Parameters
        ----------
        response : BlockResponse
        states : ndarray, shape (nodes, n)

        Returns
        -------
        ndarray, shape (nodes,)
        """
        in_order, by_order = self._in_order(states[:, _ORDER])
        in_origin, _ = self._in_origin(states[:, _ORIGIN])
        columns, _ = self._columns_at(states, in_order, by_order)
        residuals: Array = columns[:, 0] @ response.columns
        residuals += np.exp(states[:, _LOG_G]) * np.sum(
            response.law * _outer(in_origin, in_order), axis=1
        )
        return residuals

    def law_weights(self, state: Array) -> tuple[int, Array]:
        """Return the first node of ln Gn used at a state, and the weights, G included.

        Returns
        -------
        int
        ndarray, shape (8, origins)
        """
        first, in_gn, _ = self._grid.stencil(float(state[_LOG_GN]))
        in_origin, _ = self._in_origin(float(state[_ORIGIN]), slice(first, first + STENCIL))
        return first, math.exp(state[_LOG_G]) * in_gn[:, None] * in_origin

    def law_step(self, before: BlockResponse, response: BlockResponse, state: Array) -> float:
        """Return by how much the stress changes by the law alone, without linear columns [Pa].

        Of both responses at all order nodes, F is all that counts of the columns.
        """
        first, weights = self.law_weights(state)
        in_order, _ = self._in_all_orders(float(state[_ORDER]))
        used, free = slice(first, first + STENCIL), slice(0, _ORDERS)
        change = response.law[used] - before.law[used]
        by_order = weights.ravel() @ change.reshape(weights.size, _ORDERS)
        by_order += response.columns[free] - before.columns[free]
        return float(in_order @ by_order)

    # Quadratic forms

    def at_state(self, state: Array) -> Array:
        """Return the products of residual and derivatives, summed over all blocks.

        Parameters
        ----------
        state : ndarray, shape (n,)

        Returns
        -------
        ndarray, shape (n + 1, n + 1)
            The residual stands first; each product over the variance of its block.
        """
        self._add_up()
        first, *in_gn = self._grid.stencil(float(state[_LOG_GN]))
        g = math.exp(state[_LOG_G])
        weights, by_gn = (g * each[:, None] for each in in_gn)
        in_order, by_order = self._in_order(float(state[_ORDER]))
        used = slice(first, first + STENCIL)
        in_origin, by_origin = self._in_origin(float(state[_ORIGIN]), used)
        inner = _outer(in_origin, in_order[None])
        law = np.empty((STENCIL, 1 + _NONLINEAR, inner.shape[1]))
        law[:, 0] = law[:, 1 + _LOG_G] = weights * inner
        law[:, 1 + _LOG_GN] = by_gn * inner
        law[:, 1 + _ORDER] = weights * _outer(in_origin, by_order[None])
        law[:, 1 + _ORIGIN] = weights * _outer(by_origin, in_order[None])
        columns, factors = self._columns_at(state, in_order, by_order)
        return self._sums.at_stencil(first, law, columns, factors)

    def at_nodes(self, states: Array) -> Array:
        """Return what :meth:`at_state` does with each ln Gn at its node.

        Parameters
        ----------
        states : ndarray, shape (nodes, n)

        Returns
        -------
        ndarray, shape (nodes, n + 1, n + 1)
            The derivatives by ln Gn are 0.
        """
        self._add_up()
        in_order, by_order = self._in_order(states[:, _ORDER])
        in_origin, by_origin = self._in_origin(states[:, _ORIGIN])
        g = np.exp(states[:, _LOG_G])[:, None]
        in_origin, by_origin = g * in_origin, g * by_origin
        nodes, inner = states.shape[0], in_origin.shape[1] * self._orders
        law = np.zeros((nodes, 1 + _NONLINEAR, inner))
        law[:, 0] = law[:, 1 + _LOG_G] = _outer(in_origin, in_order)
        law[:, 1 + _ORDER] = _outer(in_origin, by_order)
        law[:, 1 + _ORIGIN] = _outer(by_origin, in_order)
        columns, factors = self._columns_at(states, in_order, by_order)
        return self._sums.at_nodes(law, columns, factors)

    def _columns_at(self, states: Array, in_order: Array, by_order: Array) -> tuple[Array, Array]:
        """Return the columns' coefficients in residual and derivatives by the law's parameters.

        Parameters
        ----------
        states : ndarray, shape (..., n)
        in_order, by_order : ndarray, shape (..., orders)

        Returns
        -------
        columns : ndarray, shape (..., 5, columns)
        factors : ndarray, shape (..., linear)
            Of its own column in the derivative by each linear parameter.
        """
        columns = np.zeros((*states.shape[:-1], 1 + _NONLINEAR, self._column_count))
        columns[..., 0, : self._orders] = in_order
        columns[..., 0, -1] = -1.0
        columns[..., 1 + _ORDER, : self._orders] = by_order
        factors = self._factors(np.exp(states[..., _LOG_G])[..., None])
        linear = factors * states[..., _NONLINEAR:]
        columns[..., 0, self._orders : -1] = linear
        columns[..., 1 + _LOG_G, self._orders : -1] = np.where(self._scaled, linear, 0.0)
        return columns, factors


def _outer(a: Array, b: Array) -> Array:
    """Return the outer products of rows, flattened, shape (n, a.size * b.size)."""
    products: Array = (a[:, :, None] * b[:, None, :]).reshape(a.shape[0], -1)
    return products
