# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""A rigid probe on an elastic layer over a rigid base, which holds the layer or lets it slip.

The contact obeys an integral equation for t, over the contact's radius a (Lebedev and Ufliand, J.
Appl. Math. Mech. 22 (1958) 442),

.. math::
    \varphi(t) - \tfrac1\pi \tfrac{a}{h} \int_0^1 [M(t-s) + M(t+s)]\,\varphi(s)\,ds = g(t), \qquad
    M(t) = \int_0^\infty (1-L(u)) \cos(u t a/h)\,du ,

with L the layer's compliance relative to a half-space, and g of the probe's shape: 1 of a flat
punch, t^2 of a paraboloid. The force is :math:`2 a E^* \int_0^1 \varphi`. Strains are small.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np

from fden_ros.core.arrays import Array


def _gauss(stop: float, count: int) -> tuple[Array, Array]:
    """Return places and weights of Gauss' rule from 0 on."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * stop * (nodes + 1.0), 0.5 * stop * weights


_PLACES, _WEIGHTS = _gauss(1.0, 48)
#: L is 1 beyond a wave of 30 [1].
_WAVES, _WAVE_WEIGHTS = _gauss(30.0, 240)
#: Contact radii over the thickness that the series is fitted to [1].
_CONTACTS = np.linspace(0.2, 3.0, 15)
#: Count of the series' terms: with one less it is 3 % off.
LAYER_TERMS = 5


@functools.lru_cache(maxsize=64)
def hayes_factor(aspect_ratio: float, poisson_ratio: float, *, is_bonded: bool = True) -> float:
    r"""Return Hayes' factor kappa of a rigid flat punch on an elastic layer.

    :math:`F = 2 a \kappa E d / (1 - \nu^2)`; kappa is 1 for a half-space (Hayes, Keer, Herrmann
    and Mockros, J. Biomech. 5 (1972) 541).

    Parameters
    ----------
    aspect_ratio : float
        Probe radius over thickness a/h [1], positive; meant for up to about 4.
    poisson_ratio : float
        Poisson's ratio nu [1], 0 to 0.5.
    is_bonded : bool
        The base holds the layer; otherwise the layer slips on it.
    """
    kernel = _Kernel(aspect_ratio, poisson_ratio, is_bonded=is_bonded)
    return kernel.integral(np.ones_like)[0]


@functools.lru_cache(maxsize=64)
def sphere_series(poisson_ratio: float, *, is_bonded: bool = True) -> tuple[float, ...]:
    r"""Return c of the factor :math:`1 + \sum_{k=1}^5 c_k \chi^k` of a sphere on a layer.

    It is the force over that of Hertz, at :math:`\chi = \sqrt{R d}/h`. The first term is exact.
    The others are fitted to the integral equation of a paraboloid to 0.5 %, up to a contact whose
    radius is three times the layer's thickness, where chi is 2. The published series agree where
    they hold: for a bonded, incompressible layer 1 + 1.133 chi + 1.497 chi^2 + 1.469 chi^3 +
    0.755 chi^4 up to chi = 0.5 (Garcia and Garcia, Biophys. J. 114 (2018) 2923). That of
    Dimitriadis et al. (Biophys. J. 82 (2002) 2798) is lower from chi = 0.3 on, by 8 % at 0.5.

    Parameters
    ----------
    poisson_ratio : float
        Poisson's ratio nu [1], 0 to 0.5; without effect on a layer that slips.
        is_bonded : bool
            The base holds the layer; otherwise the layer slips on it.
    """
    found = [_of_sphere(contact, poisson_ratio, is_bonded=is_bonded) for contact in _CONTACTS]
    ratios, factors = np.array(found).T
    first = 2.0 / math.pi * float(_softer(poisson_ratio, is_bonded=is_bonded).sum())
    powers = ratios[:, None] ** np.arange(2, LAYER_TERMS + 1) / factors[:, None]
    rest = np.linalg.lstsq(powers, (factors - 1.0 - first * ratios) / factors, rcond=None)[0]
    return (first, *rest.tolist())


def _of_sphere(contact: float, poisson_ratio: float, *, is_bonded: bool) -> tuple[float, float]:
    """Return chi and the factor at a contact radius over the thickness."""
    kernel = _Kernel(contact, poisson_ratio, is_bonded=is_bonded)
    by_depth, depth_edge = kernel.integral(np.ones_like)
    by_shape, shape_edge = kernel.integral(np.square)
    # In a^2/R; there the pressure ends at the edge.
    depth = shape_edge / depth_edge
    force = 2.0 * (depth * by_depth - by_shape)
    return contact * math.sqrt(depth), force / (4.0 / 3.0 * depth**1.5)


def _compliance(wave: Array, poisson_ratio: float, *, is_bonded: bool) -> Array:
    """Return how far the layer sinks under a wave u, relative to a half-space."""
    # Divided by e^(2u) throughout, so that nothing overflows.
    decay, decay2 = np.exp(-2.0 * wave), np.exp(-4.0 * wave)
    if not is_bonded:
        slips: Array = (1.0 - decay) ** 2 / (1.0 - decay2 + 4.0 * wave * decay)
        return slips
    kolosov = 3.0 - 4.0 * poisson_ratio
    held: Array = (kolosov * (1.0 - decay2) - 4.0 * wave * decay) / (
        kolosov * (1.0 + decay2) + (4.0 * wave**2 + 1.0 + kolosov**2) * decay
    )
    return held


def _softer(poisson_ratio: float, *, is_bonded: bool) -> Array:
    return (1.0 - _compliance(_WAVES, poisson_ratio, is_bonded=is_bonded)) * _WAVE_WEIGHTS


class _Kernel:
    """The integral equation at one contact radius."""

    def __init__(self, contact: float, poisson_ratio: float, *, is_bonded: bool) -> None:
        softer = _softer(poisson_ratio, is_bonded=is_bonded)
        at = np.append(_PLACES, 1.0)[:, None]
        apart = np.stack([at - _PLACES, at + _PLACES])
        both = (np.cos(contact * apart[..., None] * _WAVES) @ softer).sum(axis=0)
        own = contact / math.pi * both * _WEIGHTS
        self._system, self._edge = np.eye(_PLACES.size) - own[:-1], own[-1]

    def integral(self, shape: Callable[[Array], Array]) -> tuple[float, float]:
        """Return the integral of the solution for a shape, and its value at the edge."""
        found = np.linalg.solve(self._system, shape(_PLACES))
        return float(_WEIGHTS @ found), float(shape(np.ones(1))[0] + self._edge @ found)
