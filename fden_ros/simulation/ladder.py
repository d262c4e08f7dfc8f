# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

r"""Springs and dashpots in recursive ladders: a springpot that one could build.

The paper's Fig. 6 (after Kelly and McGough, J. Acoust. Soc. Am. 126 (2009) 2072). One rung is a
spring E in series with a dashpot eta that stands parallel to the rest of the ladder, so that the
modulus of n rungs follows from that of n - 1,

.. math:: \frac{1}{K_n} = \frac{1}{E} + \frac{1}{d + K_{n-1}}, \qquad d = \eta s ,

and that of endlessly many from :math:`K^2 + dK - Ed = 0`: where :math:`d \ll E`,
:math:`K \approx \sqrt{E d}`, the order 1/2. A ladder in place of each *dashpot* halves the order
again: 1/4, 1/8 (the paper says springs for the step to 1/8, which would raise it). With
:math:`\tau = \eta/E` the ladder of order alpha approaches the springpot
:math:`E (s\tau)^\alpha`; what is left is a relative :math:`\tfrac12 (s\tau)^{\alpha}`, plus what
the finite number of rungs costs at low frequency. At order 1/8 that fades slowly: the slope is
within 0.005 of 1/8 for :math:`\omega\tau \le 10^{-9}`.

All of it is linear algebra: n rungs are the n-th power of a 2 by 2 matrix, found by squaring. Over
time the response is a sum of exponentials; here it comes from the inverse Laplace transform on
Talbot's contour (Abate and Valkó, Int. J. Numer. Meth. Eng. 60 (2004) 979), to 1e-9.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import fftconvolve

from fden_ros.errors import InputError
from fden_ros.simulation.closed_form import FdenModel, FloatArray

ComplexArray = NDArray[np.complex128]

_TALBOT_NODES = 24
#: Cuts of a motion for each step of the samples.
_CUTS = 8


@dataclass(frozen=True)
class Ladder:
    """A recursive ladder of springs and dashpots.

    Parameters
    ----------
    levels : int
        1, 2 or 3 for the orders 1/2, 1/4, 1/8.
    stiffness : float
        E of each spring [Pa].
    time_constant : float
        tau = eta/E [s]: the ladder is a springpot for times much longer.
    rungs : int
        Rungs of each ladder: a springpot for times up to about ``time_constant * rungs**2``.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    levels: int
    stiffness: float
    time_constant: float
    rungs: int = 1 << 24

    def __post_init__(self) -> None:
        if self.levels < 1 or self.rungs < 1:
            raise InputError("a ladder has at least one level and one rung")
        if not (self.stiffness > 0.0 and self.time_constant > 0.0):
            raise InputError("a ladder's stiffness and time constant must be positive")

    @classmethod
    def like_springpot(
        cls, levels: int, linear_stiffness: float, time_constant: float, rungs: int = 1 << 24
    ) -> Ladder:
        """Return the ladder that approaches ``G s^alpha``: E = G tau^-alpha."""
        order = 0.5**levels
        return cls(levels, linear_stiffness * time_constant**-order, time_constant, rungs)

    @property
    def fractional_order(self) -> float:
        """Order of the springpot that the ladder approaches."""
        return float(0.5**self.levels)

    @property
    def linear_stiffness(self) -> float:
        """G of that springpot [Pa s^alpha]."""
        return self.stiffness * self.time_constant**self.fractional_order

    def modulus(self, laplace: ArrayLike) -> ComplexArray:
        """Return stress per strain [Pa] at Laplace variables s [1/s], any shape.

        At s = j omega this is the complex modulus.
        """
        s = np.asarray(laplace, dtype=complex)
        shunt = np.asarray(s * self.time_constant, dtype=complex)
        for _ in range(self.levels):
            shunt = _ladder(shunt, self.rungs)
        return np.asarray(self.stiffness * shunt, dtype=complex)

    def relaxation(self, times: ArrayLike) -> FloatArray:
        """Return the stress per strain [Pa] at `times` [s] after a unit step of strain."""
        return _inverse_laplace(lambda s: self.modulus(s) / s, times)

    def creep(self, times: ArrayLike) -> FloatArray:
        """Return the strain per stress [1/Pa] at `times` [s] after a unit step of stress."""
        return _inverse_laplace(lambda s: 1.0 / (s * self.modulus(s)), times)

    def ramp_response(self, times: ArrayLike) -> FloatArray:
        """Return the stress [Pa] at `times` [s] of a strain that grows by 1 per second."""
        return _inverse_laplace(lambda s: self.modulus(s) / s**2, times)


def contact_stress(
    ladder: Ladder, nonlinear_stiffness: float, time: FloatArray, strain: FloatArray
) -> FloatArray:
    """Return the stress of tissue whose memory is a ladder, pressed from rest.

    The ladder takes the place of G D^alpha behind the exponential characteristic: the stress is
    its response to ``phi(x)/G``.

    Parameters
    ----------
    ladder : Ladder
    nonlinear_stiffness : float
        Gn [1].
    time : ndarray, shape (n,)
        Evenly spaced from 0 [s].
    strain : ndarray, shape (n,)
        Strain [1], linear in between, 0 at first.

    Returns
    -------
    ndarray, shape (n,)
        Stress [Pa].
    """
    steps = np.diff(time)
    if strain[0] != 0.0 or np.ptp(steps) > 1e-6 * steps[0]:
        raise InputError("a contact with a ladder needs even steps of time, from strain 0")
    fine = np.arange((time.size - 1) * _CUTS + 1) * (steps[0] / _CUTS)
    unit = FdenModel(1.0, nonlinear_stiffness, 0.5)
    rates = np.diff(unit.phi(np.interp(fine, time, strain))) / fine[1]
    response = np.append(0.0, ladder.ramp_response(fine[1:]))
    stress = fftconvolve(rates, np.diff(response))[: rates.size]
    return np.append(0.0, stress[_CUTS - 1 :: _CUTS])


def _ladder(shunt: ComplexArray, rungs: int) -> ComplexArray:
    """Return the modulus of a ladder with springs 1 and the given shunts; its end is free."""
    # K -> (d + K)/(1 + d + K) is the matrix [[1, d], [1, 1 + d]]; rungs compose as a product.
    one = np.ones_like(shunt)
    power: tuple[ComplexArray, ...] = (one, shunt, one, 1.0 + shunt)
    total: tuple[ComplexArray, ...] = (one, 0.0 * one, 0.0 * one, one)
    while rungs:
        if rungs & 1:
            total = _product(total, power)
        power = _product(power, power)
        rungs >>= 1
    # The free end has modulus 0: the second column is what is left.
    result: ComplexArray = total[1] / total[3]
    return result


def _product(
    first: tuple[ComplexArray, ...], second: tuple[ComplexArray, ...]
) -> tuple[ComplexArray, ...]:
    a, b, c, d = first
    p, q, r, s = second
    entries = (a * p + b * r, a * q + b * s, c * p + d * r, c * q + d * s)
    # Only ratios count; unscaled, the entries overflow.
    size = np.max(np.abs(np.stack(entries)), axis=0)
    return tuple(entry / size for entry in entries)


def _inverse_laplace(transform, times: ArrayLike) -> FloatArray:  # type: ignore[no-untyped-def]
    """Return the original of `transform` at positive `times`, by the fixed Talbot contour."""
    instants = np.asarray(times, dtype=float)
    if not (instants > 0.0).all():
        raise InputError("times must be positive")
    angles = np.arange(1, _TALBOT_NODES) * math.pi / _TALBOT_NODES
    cotangents = 1.0 / np.tan(angles)
    radius = 0.4 * _TALBOT_NODES
    nodes = radius * angles * (cotangents + 1j)
    weights = np.exp(nodes) * (1.0 + 1j * angles * (1.0 + cotangents**2) - 1j * cotangents)
    nodes, weights = np.append(radius, nodes), np.append(0.5 * math.exp(radius), weights)
    values = transform(nodes / instants[..., None])
    result: FloatArray = 0.4 / instants * (values @ weights).real
    return result
