# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Interpolation between nodes: polynomials in alpha and ln Gn."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.polynomial import chebyshev

from fden_ros.core.arrays import Array

#: Distance of the nodes of ln Gn [1], and the number of them that serve one value [1]: between
#: the nodes the stress is interpolated to 2e-5 at strains of 0.3.
LOG_SPACING = 0.1
STENCIL = 8


class Lagrange:
    """Interpolation by the polynomial through given nodes.

    Parameters
    ----------
    nodes : ndarray, shape (n,)
        Ascending and distinct.
    """

    def __init__(self, nodes: Array) -> None:
        self._middle = 0.5 * float(nodes[0] + nodes[-1])
        self._half = 0.5 * float(nodes[-1] - nodes[0]) or 1.0
        self._size = nodes.size
        self._coefficients = _coefficients(tuple(nodes.tolist()), self._middle, self._half)
        #: The newest single value and what it gave: one estimate is asked for again and again.
        self._newest: tuple[float, tuple[Array, Array]] | None = None

    def __call__(self, value: float | Array) -> tuple[Array, Array]:
        """Return the weight of each node at `value` and its derivative, shape (..., n)."""
        if not isinstance(value, float):
            return self._weights(value)
        newest = self._newest
        if newest is None or newest[0] != value:
            newest = self._newest = value, self._weights(value)
        return newest[1]

    def _weights(self, value: float | Array) -> tuple[Array, Array]:
        x = np.asarray((value - self._middle) / self._half)
        powers = np.ones((*x.shape, self._size))
        powers[..., 1:] = x[..., None]
        np.multiply.accumulate(powers, axis=-1, out=powers)
        both = powers @ self._coefficients
        return both[..., : self._size], both[..., self._size :]


@functools.lru_cache(maxsize=64)
def _coefficients(nodes: tuple[float, ...], middle: float, half: float) -> Array:
    """Return, for the powers of a scaled value, the nodes' weights and slopes, shape (n, 2 n).

    A new contact asks for the same ones again, and must not wait for them.
    """
    scaled = (np.array(nodes) - middle) / half
    cardinal = np.linalg.inv(chebyshev.chebvander(scaled, len(nodes) - 1))
    slope = np.zeros_like(cardinal)
    slope[: max(len(nodes) - 1, 1)] = chebyshev.chebder(cardinal) / half
    coefficients: Array = _powers_of_chebyshev(len(nodes)) @ np.hstack([cardinal, slope])
    coefficients.flags.writeable = False
    return coefficients


def _powers_of_chebyshev(size: int) -> Array:
    """Return the coefficients of the powers, by row, in the first Chebyshev polynomials."""
    powers = np.eye(size)
    for degree in range(2, size):
        powers[:, degree] = -powers[:, degree - 2]
        powers[1:, degree] += 2.0 * powers[:-1, degree - 1]
    return powers


class LogStiffnessGrid:
    """Uniform nodes of ln Gn, with local interpolation between them.

    Local, because far nodes differ by orders of magnitude at large strain.

    Parameters
    ----------
    centre, half_width : float
        What values of ln Gn must be covered [1].
    """

    def __init__(self, centre: float, half_width: float) -> None:
        count = max(math.ceil(half_width / LOG_SPACING), STENCIL // 2)
        offsets: Array = np.arange(-float(count), count + 1.0)
        self.nodes = centre + LOG_SPACING * offsets
        self._interpolation = Lagrange(np.arange(float(STENCIL)))

    @property
    def lowest(self) -> float:
        """Smallest node."""
        return float(self.nodes[0])

    @property
    def highest(self) -> float:
        """Largest node."""
        return float(self.nodes[-1])

    def stencil(self, value: float) -> tuple[int, Array, Array]:
        """Return the first node used at `value`, the weights and their slopes, shape (8,)."""
        position = (value - self.lowest) / LOG_SPACING
        first = min(max(math.floor(position) - STENCIL // 2 + 1, 0), self.nodes.size - STENCIL)
        weights, slopes = self._interpolation(position - first)
        return first, weights, slopes / LOG_SPACING
