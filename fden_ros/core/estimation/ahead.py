# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The law along a motion that is given, and how what it leaves out may grow on the way.

For predictions: with the response and the clocks of the posterior's error processes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.block import BLOCK_TIME
from fden_ros.core.estimation.error_model import SURFACE_TIME
from fden_ros.core.estimation.loops import LawState, ResponseState, Steps
from fden_ros.core.estimation.smooth_errors import KERNEL_LENGTH, STRAIN_FLOOR
from fden_ros.core.law import (
    HIGHEST_ORDER,
    LOWEST_ORDER,
    Geometry,
    apparent_stiffness_factor,
    relaxation_weights,
)


class LawAlong:
    """The law's stress along a motion, of which one part goes on from the last.

    Parameters
    ----------
    geometry : Geometry
    logs : ndarray, shape (2,)
        ln G and ln Gn.
    order : float
        alpha [1].
    """

    def __init__(self, geometry: Geometry, logs: Array, order: float) -> None:
        g, gn = np.exp(logs).tolist()
        self._law = LawState(
            linear_stiffness=g,
            nonlinear_stiffness=gn,
            exponent=geometry.exponent,
            is_one_sided=geometry.is_one_sided,
            compliance=0.0,
            weights=relaxation_weights(float(np.clip(order, LOWEST_ORDER, HIGHEST_ORDER))),
            bend=np.zeros(0),
            last_knot=1.0,
            series=geometry.series,
        )
        self._state = ResponseState(0)

    def stress(self, steps: Array, compressions: Array, surface: Array) -> Array:
        """Return the stress [Pa] at the ends of steps [s], shape (n,) each.

        Parameters
        ----------
        steps, compressions : ndarray, shape (n,)
            The compressions are those at the ends [1].
        surface : ndarray, shape (n,)
            The tissue's free surface there, in the unit of the elastic response.
        """
        own, motion = Steps.of(steps), np.ascontiguousarray(compressions)
        return loops.respond(self._law, own, motion, surface, None, self._state).stress


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


def surface_factor(order: float) -> float:
    """Return the stiffness that the motion of the surface meets, by G and at phi' = 1."""
    return apparent_stiffness_factor(order, SURFACE_TIME)


def kernel_change(kernel_sd: float, way: float) -> float:
    """Return the variance by which the kernel's error changes over a way of ln t [1].

    `kernel_sd`: the relative deviation of the kernel [1].
    """
    return 2.0 * kernel_sd**2 * -math.expm1(-way / KERNEL_LENGTH)
