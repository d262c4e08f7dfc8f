# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Tissue that does not obey the FDEN law, in time steps.

The stress is a relaxation behind a characteristic, as in quasi-linear viscoelasticity,

.. math:: f(t) = \int_0^t g(t - s)\,\frac{d\varphi(x(s))}{ds}\,ds .

Tissue may also wear from press to press: it
softens, or its surface stays lower. Contact pushes and never pulls, as in
:mod:`fden_ros.simulation.tissue`, whose steps these are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fden_ros.simulation import Column, FdenModel, FloatArray, Relaxation, Tissue

#: Terms of the series of one-dimensional consolidation; the next is 1e-4 of the first.
_CONSOLIDATION_TERMS = 50
#: Exponentials of a box spectrum for each factor e of time: a ripple of 1e-5.
_PER_E_FOLD = 4.0


def springpot(order: float) -> Relaxation:
    """Return the relaxation of the FDEN law."""
    return Relaxation(springpots=((1.0, order),))


def standard_linear_solid(time_s: float, left: float = 0.5) -> Relaxation:
    """Return a relaxation to the fraction `left` with one time constant [s]."""
    return Relaxation(exponentials=((left, 0.0), (1.0 - left, 1.0 / time_s)))


def poroelastic(time_s: float, drop: float = 1.0) -> Relaxation:
    """Return that of a layer that drains under pressure, its slowest time `time_s` [s].

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
class Law:
    """A tissue that is not FDEN."""

    model: FdenModel  #: G, and Gn where the characteristic is that of FDEN; its alpha is not used
    relaxation: Relaxation  #:
    #: As in :class:`~fden_ros.simulation.tissue.Column`
    characteristic: Callable[[float], float] | None = None
    softening: float = 0.0  #: Share of the stiffness that each press takes
    set_strain: float = 0.0  #: By how much each press leaves the surface lower, as a strain


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
    column = Column(law.model, relaxation=law.relaxation, characteristic=law.characteristic)
    tissue = Tissue([column], step)
    stress = np.zeros(len(strains))
    presses, in_press = 0, False
    for n, strain in enumerate(np.asarray(strains, dtype=float).tolist()):
        if in_press and strain < 0.0:
            presses, in_press = presses + 1, False
            tissue.columns = (replace(column, scale=(1.0 - law.softening) ** presses),)
        stress[n] = tissue.press(strain - presses * law.set_strain)
        in_press |= stress[n] > 0.0
    return stress
