# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Laws along a motion that is given, and how what they leave out may grow on the way.

For predictions: the law with the response of the posterior, the other laws that stand beside it,
and the clocks of the posterior's error processes.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.block import BLOCK_TIME
from fden_ros.core.estimation.error_model import SURFACE_TIME
from fden_ros.core.estimation.estimate import OtherLaw, OtherLawKind
from fden_ros.core.estimation.loops import LawState, ResponseState, Steps
from fden_ros.core.estimation.smooth_errors import KERNEL_LENGTH, REFERENCE_STRAIN, STRAIN_FLOOR
from fden_ros.core.law import (
    HIGHEST_ORDER,
    LOWEST_ORDER,
    Geometry,
    apparent_stiffness_factor,
    creep_weights,
    elastic_responses,
    phi,
    relaxation_weights,
)

#: Least strain, step or age that others are divided by [1 or s].
_LEAST = 1e-9


class Elastic(NamedTuple):
    """The elastic response at strains (n,), each of shape (n,)."""

    values: Array  #: by its slope at small strain [1]
    stiffness: Array  #: slope of the stress, relaxed over the time of the surface's motion [Pa]


class Along(Protocol):
    """A law at given parameters."""

    def stress(self, steps: Array, compressions: Array, moments: Array) -> Array:
        """Return the stress [Pa] at the ends of steps [s] of a motion from rest, shape (n,) each.

        Parameters
        ----------
        steps, compressions : ndarray, shape (n,)
            The compressions are those at the ends [1].
        moments : ndarray, shape (n, RATE_COUNT)
            Of the stress before the motion, there [Pa s].
        """
        ...

    def elastic(self, strains: Array) -> Elastic:
        """Return the elastic response at strains [1], shape (n,)."""
        ...

    def relaxation(self, time: float) -> float:
        """Return the stress a time [s] after a step, by the elastic response."""
        ...


class LawAlong:
    """The law.

    Parameters
    ----------
    geometry : Geometry
    parameters : ndarray, shape (3,)
        ln G, ln Gn and alpha.
    """

    def __init__(self, geometry: Geometry, parameters: Array) -> None:
        self._geometry = geometry
        self._linear, self._nonlinear = np.exp(parameters[:2]).tolist()
        order = float(np.clip(parameters[2], LOWEST_ORDER, HIGHEST_ORDER))
        self._weights, self._creep = relaxation_weights(order), creep_weights(order)
        self._order = order

    def stress(self, steps: Array, compressions: Array, moments: Array) -> Array:
        """Return the stress."""
        law = LawState(
            linear_stiffness=self._linear,
            nonlinear_stiffness=self._nonlinear,
            exponent=self._geometry.exponent,
            is_one_sided=self._geometry.is_one_sided,
            compliance=0.0,
            weights=self._weights,
            bend=np.zeros(0),
            last_knot=1.0,
            series=self._geometry.series,
        )
        surface = moments @ self._creep
        motion = np.ascontiguousarray(compressions)
        found = loops.respond(law, Steps.of(steps), motion, surface, None, ResponseState(0))
        return found.stress

    def elastic(self, strains: Array) -> Elastic:
        """Return the elastic response."""
        relaxed = self._linear * self.relaxation(SURFACE_TIME)
        return _elastic(strains, self._nonlinear, relaxed)

    def relaxation(self, time: float) -> float:
        """Return the relaxation."""
        return apparent_stiffness_factor(self._order, time)


class PlateauAlong:
    """A relaxation with a plateau: of ln G, ln Gn, r and the logarithm of its rate.

    Of presses before it remembers nothing: it recovers as fast as it relaxes.
    """

    def __init__(self, geometry: Geometry, parameters: Array) -> None:
        self._geometry = geometry
        self._linear, self._nonlinear, self._rate = np.exp(parameters[[0, 1, 3]]).tolist()
        self._ratio = max(float(parameters[2]), 0.0)

    def stress(self, steps: Array, compressions: Array, moments: Array) -> Array:
        """Return the stress."""
        strains = self._geometry.strains(np.maximum(compressions, 0.0)).values
        lasting = phi(strains, self._linear, self._nonlinear)
        # What is left of a change at an even speed, at the end of its step.
        ages = np.maximum(self._rate * steps, _LEAST)
        left, gains = np.exp(-ages), -np.expm1(-ages) / ages * np.diff(lasting, prepend=0.0)
        part, passing = 0.0, np.empty_like(lasting)
        for k, (kept, gain) in enumerate(zip(left.tolist(), gains.tolist(), strict=True)):
            part = kept * part + gain
            passing[k] = part
        return np.asarray(lasting + self._ratio * passing)

    def elastic(self, strains: Array) -> Elastic:
        """Return the elastic response."""
        relaxed = self._linear * self.relaxation(SURFACE_TIME)
        return _elastic(strains, self._nonlinear, relaxed)

    def relaxation(self, time: float) -> float:
        """Return the relaxation."""
        return 1.0 + self._ratio * math.exp(-self._rate * time)


class HuntCrossleyAlong:
    """The law of Hunt and Crossley: of ln g, ln m and lambda."""

    def __init__(self, geometry: Geometry, parameters: Array) -> None:
        self._geometry = geometry
        self._stiffness, self._power = np.exp(parameters[:2]).tolist()
        self._resistance = max(float(parameters[2]), 0.0)

    def stress(self, steps: Array, compressions: Array, moments: Array) -> Array:
        """Return the stress."""
        speeds = np.diff(compressions, prepend=0.0) / np.maximum(steps, _LEAST)
        strains = self._geometry.strains(np.maximum(compressions, 0.0)).values
        # Contact pushes and does not pull.
        factor = np.maximum(1.0 + self._resistance * speeds, 0.0)
        return np.asarray(self._stiffness * self._part(strains) * factor)

    def elastic(self, strains: Array) -> Elastic:
        """Return the elastic response."""
        part, least = self._part(strains), np.maximum(strains, _LEAST)
        return Elastic(REFERENCE_STRAIN * part, self._stiffness * self._power * part / least)

    def relaxation(self, time: float) -> float:
        """Return that of a spring."""
        return 1.0

    def _part(self, strains: Array) -> Array:
        return np.asarray((np.maximum(strains, 0.0) / REFERENCE_STRAIN) ** self._power)


def _elastic(strains: Array, nonlinear_stiffness: float, relaxed: float) -> Elastic:
    """Return that of phi; `relaxed`: slope of the stress at small strain [Pa]."""
    found = elastic_responses(strains, 1.0, nonlinear_stiffness)
    return Elastic(found.value, relaxed * found.by_strain)


def other_along(geometry: Geometry, other: OtherLaw, parameters: Array) -> Along:
    """Return another law of a kind at parameters, shape (4,)."""
    own = PlateauAlong if other.kind is OtherLawKind.PLATEAU else HuntCrossleyAlong
    return own(geometry, parameters)


class LoadingAhead(NamedTuple):
    """How the loading changes along a motion, each of shape (n,)."""

    loading: Array  #: change of ln phi in each step [1]
    ageing: Array  #: of ln A from the beginning on [1]

    @classmethod
    def along(cls, elastic: Array, steps: Array, age: float) -> LoadingAhead:
        """Return it for elastic responses (n + 1,) at the ends of steps (n,) [s].

        `age`: of the loading at the beginning [s].
        """
        loaded = elastic + STRAIN_FLOOR
        state, ages = np.array([loaded[0], age]), np.empty_like(steps)
        for k in range(steps.size):
            loops.clock(loaded[k + 1 : k + 2], steps[k : k + 1], BLOCK_TIME, state)
            ages[k] = state[1]
        ageing = np.log((ages + BLOCK_TIME) / (age + BLOCK_TIME))
        return cls(np.abs(np.diff(np.log(loaded))), ageing)

    def left_out(self, stress: Array, model_discrepancy: float, relaxation_error: float) -> Array:
        """Return what each step adds to the variance of the stress that is left out [Pa^2].

        Parameters
        ----------
        stress : ndarray, shape (n,)
            [Pa].
        model_discrepancy, relaxation_error : float
            Relative deviations of the characteristic and of the relaxation [1].
        """
        aged = np.abs(np.diff(self.ageing, prepend=0.0))
        relative = model_discrepancy**2 * self.loading + relaxation_error**2 / KERNEL_LENGTH * aged
        return np.asarray(2.0 * stress**2 * relative)


def kernel_change(kernel_sd: float, way: float) -> float:
    """Return the variance by which the kernel's error changes over a way of ln t [1].

    `kernel_sd`: the relative deviation of the kernel [1].
    """
    return 2.0 * kernel_sd**2 * -math.expm1(-way / KERNEL_LENGTH)
