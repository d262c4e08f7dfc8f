# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Sums of products of responses at the nodes of ln Gn, and their contraction at given weights.

The responses of a block are those of the law at every node, and columns that are the same at all
nodes. Summed are the products of the law at a node with itself and with the columns, of columns
with columns (all at once), and of laws at neighbouring nodes: these are most of the memory and
wanted only between nodes, so they are caught up with many blocks together.
"""

from __future__ import annotations

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.law.interpolation import STENCIL

#: Blocks [1] with which the products of neighbouring nodes may be behind: one product of matrices
#: is several times faster than 8 of fewer blocks. Half or twice gives the same but for rounding.
MOST_BEHIND = 32


class ResponseSums:
    """The sums over all blocks, each with its weight.

    Parameters
    ----------
    nodes : int
        Nodes of ln Gn.
    inner : int
        Responses of the law at each node.
    columns : int
    linear : slice
        Columns that are, but for a factor each, directions of their own.
    """

    def __init__(self, nodes: int, inner: int, columns: int, linear: slice) -> None:
        self._inner = inner
        self._linear = linear
        self.columns = np.zeros((columns, columns))
        #: Of the law at a node, with itself and with the columns.
        self._near = np.zeros((nodes, inner, inner + columns))
        #: Of the law at a node, with that at the next 7 nodes.
        self._far = np.zeros((nodes, inner, (STENCIL - 1) * inner))
        #: Laws and their weights that the products of neighbouring nodes do not hold yet.
        self._laws = np.empty((MOST_BEHIND, nodes, inner))
        self._weights = np.empty(MOST_BEHIND)
        self._behind = 0

    def clear(self) -> None:
        """Forget all blocks."""
        for sums in (self.columns, self._near, self._far):
            sums.fill(0.0)
        self._behind = 0

    # Blocks

    def add(self, laws: Array, columns: Array, weights: Array) -> None:
        """Add blocks, at most as many as may be behind.

        Parameters
        ----------
        laws : ndarray, shape (m, nodes, inner)
        columns : ndarray, shape (m, columns)
        weights : ndarray, shape (m,)
        """
        weighted = np.empty((self._near.shape[0], laws.shape[0], self._near.shape[2]))
        np.multiply(laws.transpose(1, 0, 2), weights[:, None], out=weighted[:, :, : self._inner])
        by_weight = weighted[:, :, self._inner :]
        by_weight[...] = weights[:, None] * columns
        self._near += laws.transpose(1, 2, 0) @ weighted
        self.columns += by_weight[0].T @ columns
        self._fall_behind(laws, weights)

    def _fall_behind(self, laws: Array, weights: Array) -> None:
        if self._behind + weights.size > MOST_BEHIND:
            self._catch_up()
        own = slice(self._behind, self._behind + weights.size)
        self._laws[own], self._weights[own] = laws, weights
        self._behind = own.stop

    def _catch_up(self) -> None:
        """Add what waits to the products of neighbouring nodes."""
        laws, weights = self._laws[: self._behind], self._weights[: self._behind]
        count, nodes, inner = laws.shape
        weighted = np.zeros((count, (nodes + STENCIL - 1) * inner))
        weighted[:, : nodes * inner] = (weights[:, None, None] * laws).reshape(count, -1)
        for node in range(nodes - 1):
            next_ones = slice((node + 1) * inner, (node + STENCIL) * inner)
            self._far[node] += laws[:, node].T @ weighted[:, next_ones]
        self._behind = 0

    # Columns

    def change_column(
        self, column: int, change: float, law: Array, columns: Array, weight: float
    ) -> None:
        """Change a column of one of the blocks that were added."""
        self._near[:, :, self._inner + column] += weight * change * law
        by_column = weight * change * columns
        self.columns[column, :] += by_column
        self.columns[:, column] += by_column
        self.columns[column, column] += weight * change**2

    def take_out(self, column: int, own: float) -> None:
        """Subtract the products with a column, over its own: what its parameter explains."""
        by_law = self._near[:, :, self._inner + column].copy()
        by_column = self.columns[column].copy()
        self._near[:, :, : self._inner] -= by_law[:, :, None] * (by_law[:, None, :] / own)
        self._near[:, :, self._inner :] -= by_law[:, :, None] * (by_column / own)
        self.columns -= np.outer(by_column, by_column) / own
        self._fall_behind(by_law[None], np.array([-1.0 / own]))

    def forget(self, column: int) -> None:
        """Let a column begin anew."""
        self._near[:, :, self._inner + column] = 0.0
        self.columns[column, :] = self.columns[:, column] = 0.0

    def move(self, column: int, place: int) -> None:
        """Let a column take the place of another, which was forgotten."""
        self._near[:, :, self._inner + place] = self._near[:, :, self._inner + column]
        own = self.columns[column, column]
        self.columns[place, :] = self.columns[column, :]
        self.columns[:, place] = self.columns[:, column]
        self.columns[place, place] = own
        self.forget(column)

    # Products

    def at_nodes(self, law: Array, columns: Array, factors: Array) -> Array:
        """Return the products of directions at every node.

        Parameters
        ----------
        law : ndarray, shape (nodes, k, inner)
            Coefficients of the law in the first k directions.
        columns : ndarray, shape (nodes, k, columns)
            Coefficients of the columns there.
        factors : ndarray, shape (nodes, linear)
            Those of the linear columns in the other directions.

        Returns
        -------
        ndarray, shape (nodes, k + linear, k + linear)
        """
        by_law = law @ self._near
        own = by_law[:, :, : self._inner] @ law.transpose(0, 2, 1)
        return self._together(own, by_law[:, :, self._inner :], columns, factors)

    def at_stencil(self, first: int, law: Array, columns: Array, factors: Array) -> Array:
        """Return the products of directions between nodes.

        Parameters
        ----------
        first : int
            First of the 8 nodes.
        law : ndarray, shape (8, k, inner)
            Coefficients of the law at them in the first k directions.
        columns : ndarray, shape (k, columns)
        factors : ndarray, shape (linear,)

        Returns
        -------
        ndarray, shape (k + linear, k + linear)
        """
        by_law = law @ self._near[first : first + STENCIL]
        transposed = law.transpose(0, 2, 1)
        own = np.sum(by_law[:, :, : self._inner] @ transposed, axis=0)
        flat = law.transpose(1, 0, 2).reshape(law.shape[1], -1)
        beside = np.zeros_like(own)
        for k in range(STENCIL - 1):
            next_ones = flat[:, (k + 1) * self._inner :]
            beside += law[k] @ self._far[first + k, :, : next_ones.shape[1]] @ next_ones.T
        if self._behind:
            laws = self._laws[: self._behind, first : first + STENCIL].transpose(1, 0, 2)
            weights = self._weights[: self._behind, None]
            each = laws @ transposed
            whole = each.sum(axis=0)
            own += whole.T @ (weights * whole)
            own -= np.sum(each.transpose(0, 2, 1) @ (weights * each), axis=0)
        crossed = np.sum(by_law[:, :, self._inner :], axis=0)
        return self._together(own + beside + beside.T, crossed, columns, factors)

    def _together(self, own: Array, crossed: Array, columns: Array, factors: Array) -> Array:
        """Return all products, from those of the law, with the columns, and of the columns."""
        transposed = np.swapaxes(columns, -1, -2)
        flat = columns.reshape(-1, columns.shape[-1])
        by_columns = (flat @ self.columns).reshape(columns.shape)
        mixed = crossed @ transposed
        beside = (by_columns + crossed)[..., self._linear] * factors[..., None, :]
        count = own.shape[-1]
        size = count + factors.shape[-1]
        products = np.empty((*own.shape[:-2], size, size))
        first = products[..., :count, :count]
        np.add(own, by_columns @ transposed, out=first)
        first += mixed
        first += np.swapaxes(mixed, -1, -2)
        products[..., :count, count:] = beside
        products[..., count:, :count] = np.swapaxes(beside, -1, -2)
        both = factors[..., :, None] * factors[..., None, :]
        products[..., count:, count:] = self.columns[self._linear, self._linear] * both
        return products
