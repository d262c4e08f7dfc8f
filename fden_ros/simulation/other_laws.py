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

r"""Tissue that does not obey the FDEN law, in time steps.

The stress is a relaxation behind a characteristic, as in quasi-linear viscoelasticity,

.. math:: f(t) = \int_0^t g(t - s)\,\frac{d\varphi(x(s))}{ds}\,ds ,

with g a sum of springpots :math:`w\,t^{-\alpha}/\Gamma(1-\alpha)` and exponentials
:math:`w\,e^{-rt}`, and with any characteristic. Tissue may also wear from press to press: it
softens, or its surface stays lower. Contact pushes and never pulls, as in
:mod:`fden_ros.simulation.tissue`, whose steps these are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fden_ros.errors import InputError
from fden_ros.simulation.closed_form import FdenModel, FloatArray
from fden_ros.simulation.tissue import Column, Tissue, springpot_exponentials

#: Terms of the series of one-dimensional consolidation; the next is 1e-4 of the first.
_CONSOLIDATION_TERMS = 50
#: Exponentials of a box spectrum for each factor e of time: a ripple of 1e-5.
_PER_E_FOLD = 4.0


@dataclass(frozen=True)
class Relaxation:
    """The stress that a unit step of the elastic response leaves, over time.

    Parameters
    ----------
    springpots : tuple
        (weight, order) of each: weight t^-order / Gamma(1 - order), t in s.
    exponentials : tuple
        (weight, rate [1/s]) of each: weight exp(-rate t); rate 0 is a spring.
    """

    springpots: tuple[tuple[float, float], ...] = ()
    exponentials: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if not (self.springpots or self.exponentials):
            raise InputError("relaxation: there is neither a springpot nor an exponential")

    def at(self, times: FloatArray) -> FloatArray:
        """Return the relaxation at positive `times` [s], (n,)."""
        value = np.zeros_like(times)
        for weight, order in self.springpots:
            value += weight * times**-order / math.gamma(1.0 - order)
        for weight, rate in self.exponentials:
            value += weight * np.exp(-rate * times)
        return value


def springpot(order: float) -> Relaxation:
    """Return the relaxation of the FDEN law."""
    return Relaxation(springpots=((1.0, order),))


def standard_linear_solid(time_s: float, left: float = 0.5) -> Relaxation:
    """Return a relaxation to the share `left` with one time constant [s]."""
    return Relaxation(exponentials=((left, 0.0), (1.0 - left, 1.0 / time_s)))


def poroelastic(time_s: float, drop: float = 1.0) -> Relaxation:
    """Return that of a layer from which the fluid is pressed out, its slowest time `time_s` [s].

    Terzaghi's one-dimensional consolidation: 1 in the end and 1 + `drop` at first.
    """
    odd = 2.0 * np.arange(_CONSOLIDATION_TERMS) + 1.0
    weights = drop * 8.0 / (math.pi * odd) ** 2
    series = zip(weights.tolist(), (odd**2 / time_s).tolist(), strict=True)
    return Relaxation(exponentials=((1.0, 0.0), *series))


def quasi_linear(strength: float, shortest_s: float, longest_s: float) -> Relaxation:
    """Return Fung's relaxation: a spectrum `strength`/tau between two times [s]."""
    span = math.log(longest_s / shortest_s)
    count = math.ceil(_PER_E_FOLD * span)
    # Midpoints in ln(tau).
    times = shortest_s * np.exp(span * (np.arange(count) + 0.5) / count)
    scale = 1.0 / (1.0 + strength * span)
    weight = scale * strength * span / count
    return Relaxation(exponentials=((scale, 0.0), *((weight, 1.0 / t) for t in times.tolist())))


@dataclass(frozen=True)
class OtherColumn(Column):
    """A column with a characteristic of its own.

    Parameters
    ----------
    characteristic : callable or None
        phi/G of a strain that is not negative, increasing from 0; None: that of FDEN.
    scale : float
        By which phi is larger than that of the model.
    """

    characteristic: Callable[[float], float] | None = None
    scale: float = 1.0

    def phi(self, strain: float) -> float:
        """Return the elastic characteristic [Pa]."""
        if self.characteristic is None:
            return self.scale * super().phi(strain)
        value = self.characteristic(abs(strain))
        return math.copysign(self.scale * self.model.linear_stiffness * value, strain)


@dataclass(frozen=True)
class Law:
    """A tissue that is not FDEN.

    Parameters
    ----------
    model : FdenModel
        G, and Gn where the characteristic is that of FDEN; its alpha is not used.
    relaxation : Relaxation
    characteristic : callable or None
        As in :class:`OtherColumn`.
    softening : float
        Share of the stiffness that each press takes.
    set_strain : float
        By how much each press leaves the surface lower, as a strain.
    """

    model: FdenModel
    relaxation: Relaxation
    characteristic: Callable[[float], float] | None = None
    softening: float = 0.0
    set_strain: float = 0.0


class _OtherTissue(Tissue):
    """One column with any relaxation."""

    def __init__(self, column: OtherColumn, relaxation: Relaxation, step: float) -> None:
        self._relaxation = relaxation
        super().__init__([column], step)

    def _exponentials(self) -> tuple[FloatArray, FloatArray]:
        rates, weights = [np.zeros(1)], [np.zeros(1)]
        for weight, order in self._relaxation.springpots:
            own_rates, own_weights = springpot_exponentials([order], self.step)
            rates.append(own_rates[1:])
            weights.append(weight * own_weights[0, 1:])
            weights[0] = weights[0] + weight * own_weights[0, :1]
        for weight, rate in self._relaxation.exponentials:
            if rate > 0.0:
                rates.append(np.array([rate]))
                weights.append(np.array([weight]))
            else:
                weights[0] = weights[0] + weight
        return np.concatenate(rates), np.concatenate(weights)[None]

    def _mean_kernel(self, duration: float) -> FloatArray:
        mean = 0.0
        for weight, order in self._relaxation.springpots:
            mean += weight * duration**-order / math.gamma(2.0 - order)
        for weight, rate in self._relaxation.exponentials:
            reach = rate * duration
            mean += weight * (-math.expm1(-reach) / reach if reach > 0.0 else 1.0)
        return np.array([mean])


def stress_of_law(law: Law, strains: Sequence[float] | FloatArray, step: float) -> FloatArray:
    """Return the stress under a prescribed motion from rest.

    Parameters
    ----------
    law : Law
    strains : array_like, shape (n,)
        Of the probe at the end of each step, negative in the air; linear in between.
    step : float
        [s].

    Returns
    -------
    ndarray, shape (n,)
        Stress [Pa], 0 out of contact. A press is over, and has worn the tissue, where the probe
        is above the undisturbed surface again.
    """
    tissue = _OtherTissue(
        OtherColumn(law.model, characteristic=law.characteristic), law.relaxation, step
    )
    stress = np.zeros(len(strains))
    presses, in_press = 0, False
    for n, strain in enumerate(np.asarray(strains, dtype=float).tolist()):
        if in_press and strain < 0.0:
            presses, in_press = presses + 1, False
            tissue.columns = (
                OtherColumn(
                    law.model,
                    characteristic=law.characteristic,
                    scale=(1.0 - law.softening) ** presses,
                ),
            )
        stress[n] = tissue.press(strain - presses * law.set_strain)
        in_press |= stress[n] > 0.0
    return stress
