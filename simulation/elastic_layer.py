# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A rigid sphere on an elastic layer, by boundary elements: the truth that shares no formula.

The pressure is constant on rings. The effect of a ring on the surface is the closed form of a
half-space, plus a Hankel integral over the difference for the layer. That follows from Love's
function, whose four constants are set by the base and the surface.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import ellipe, ellipk, j0, j1

FloatArray = NDArray[np.float64]

#: With these the force is right to 0.3 % (half-space: Hertz).
_RINGS, _WAVES, _LAST_WAVE = 60, 200, 30.0
#: Contact radius over thickness [1].
_CONTACTS = (0.02, 0.05, 0.1, 0.2, 0.35, 0.55, 0.8, 1.1, 1.5, 2.0, 2.6, 3.3)


@functools.cache
def stiffening(poisson_ratio: float, *, is_bonded: bool) -> Any:
    """Return the interpolator from sqrt(R d) / h [1] to the force over that of Hertz [1].

    Of a layer that its rigid base holds, or lets slip.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_WAVES)
    waves, weights = 0.5 * _LAST_WAVE * (nodes + 1.0), 0.5 * _LAST_WAVE * weights
    softer = np.array([_sink(k, poisson_ratio, is_bonded=is_bonded) - 1.0 for k in waves])
    found = [_pressed(contact, waves, weights * softer) for contact in _CONTACTS]
    return PchipInterpolator(*np.array([(0.0, 1.0), *found]).T)


def _pressed(contact: float, waves: FloatArray, softer: FloatArray) -> tuple[float, float]:
    """Return sqrt(R d) / h and the factor, at a contact radius over h; lengths in h, E* is 1."""
    edges = np.linspace(0.0, contact, _RINGS + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])
    discs = np.zeros((_RINGS, _RINGS + 1))
    discs[:, 1:] = _half_space(middles[:, None], edges[None, 1:])
    spread = 2.0 * edges * j1(np.outer(waves, edges)) * (softer / waves)[:, None]
    discs += j0(np.outer(middles, waves)) @ spread
    rings = np.diff(discs, axis=1)
    # Of a depth of 1, and of the paraboloid r^2/2 (R = 1): at the edge the pressure ends.
    by_depth, by_shape = np.linalg.solve(rings, np.stack([np.ones(_RINGS), middles**2 / 2.0], 1)).T
    depth = by_shape[-1] / by_depth[-1]
    force = math.pi * np.diff(edges**2) @ (depth * by_depth - by_shape)
    return math.sqrt(depth), float(force) / (4.0 / 3.0 * depth**1.5)


def _half_space(radius: FloatArray, disc: FloatArray) -> FloatArray:
    """Return how far a half-space sinks at a radius under a disc of pressure 1; E* is 1."""
    inner, outer = np.minimum(radius, disc), np.maximum(radius, disc)
    square = (inner / outer) ** 2
    inside = disc * ellipe(square)
    outside = radius * (ellipe(square) - (1.0 - square) * ellipk(square))
    return 4.0 / math.pi * np.where(radius < disc, inside, outside)


def _sink(height: float, poisson_ratio: float, *, is_bonded: bool) -> float:
    """Return how far a layer sinks under a wave of each number, relative to a half-space."""
    base = _of_love(0.0, poisson_ratio)
    top = _of_love(height, poisson_ratio)
    held = base["along"] if is_bonded else base["shear"]
    scale = math.exp(height)
    system = np.array([base["sinks"], held, top["shear"] / scale, top["pressure"] / scale])
    constants = np.linalg.solve(system, [0.0, 0.0, 0.0, 1.0 / scale])
    return float(-top["sinks"] @ constants) / (2.0 * (1.0 - poisson_ratio))


def _of_love(z: float, nu: float) -> dict[str, FloatArray]:
    """Return what Love's function has at a height z above the base, each of four constants.

    It is Z(z) J0(r), with Z of e^z, z e^z, e^-z and z e^-z; 2 G is 1.
    """
    up, down = math.exp(z), math.exp(-z)
    of = [
        np.array([up, (z + n) * up, (-1.0) ** n * down, (-1.0) ** n * (z - n) * down])
        for n in range(4)
    ]
    harmonic, its_slope = of[2] - of[0], of[3] - of[1]
    return {
        "along": of[1],
        "sinks": 2.0 * (1.0 - nu) * harmonic - of[2],
        "shear": (1.0 - nu) * harmonic - of[2],
        "pressure": -((2.0 - nu) * its_slope - of[3]),
    }
