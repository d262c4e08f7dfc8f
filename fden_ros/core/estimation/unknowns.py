# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""What is not known of a press: one object an unknown, with its prior, lifetime and column.

:class:`PressMotion` has what all make of the motion and of the stress that were measured.

The stress of a press is

.. math::
    f(t) = \int E(t-s)\,d\max(\psi(u(s)) - F(s), 0) + \text{stresses} + w(t) + v, \qquad
    u = d/L - o + \tau \dot d/L - C f,

with :math:`E = t^{-\alpha}/\Gamma(1-\alpha)\; e^{\delta(\ln t)}`, :math:`\psi = \varphi\,
e^{\epsilon(x)}` and F the free surface that earlier presses have left. To add an unknown, add an
:class:`Unknown` to :func:`unknowns_of`: a column of compressions or of stresses per standard
deviation. What changes with time is a process of :mod:`fden_ros.core.estimation.error_model`.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.loops import By
from fden_ros.core.estimation.smooth_errors import STRAIN_FLOOR
from fden_ros.core.law import HIGHEST_ORDER, LOWEST_ORDER, Geometry


class Lifetime(enum.Enum):
    """For how long an unknown is one and the same."""

    CONTACT = enum.auto()
    SITE = enum.auto()
    RIG = enum.auto()


@dataclass(frozen=True)
class Unknown:
    """One number that is not known."""

    name: str
    #: Its prior. An unknown counts in standard deviations, except for the law's own parameters.
    mean: float
    sd: float
    lifetime: Lifetime
    kind: By = By.NOTHING  #: what of the law it is
    #: Points to the change of their compressions by one standard deviation, (n,).
    motion: Callable[[Points], Array] | None = None
    #: Points to the stress at their blocks by one standard deviation, (m,) [Pa].
    stress: Callable[[Points], Array] | None = None

    @property
    def unit(self) -> float:
        """The prior's standard deviation in the unknown's unit."""
        return self.sd if self.name in LAW else 1.0


#: The law's parameters, in the order of a state.
LAW = ("log_g", "log_gn", "order")
LAW_PLACES = slice(0, len(LAW))
#: The first places of a state.
LOG_G, LOG_GN, ORDER, ORIGIN = range(4)


def order_of(state: Array) -> float:
    """Return the order of a state, in the range for which the relaxation is known [1]."""
    return float(np.clip(state[ORDER], LOWEST_ORDER, HIGHEST_ORDER))


# Columns: the change by one standard deviation.


def _shift(size: float, points: Points) -> Array:
    return np.full(points.times.size, size)


def _late(delay: float, points: Points) -> Array:
    return delay * points.speeds


def _friction(stress: float, length: float, points: Points) -> Array:
    speed = length * points.mean(points.speeds)
    # In the air there is none, or it is in the zero.
    pressed = np.maximum(points.mean(points.compressions), 0.0)
    in_contact = pressed**2 / (pressed**2 + STRAIN_FLOOR**2)
    # Below 5e-4 m/s, where friction has half its full square, is a hold.
    return stress * in_contact * speed / np.hypot(speed, 5e-4)


def _drift(slope: float, points: Points) -> Array:
    return slope * (points.middles - points.times[0])


def unknowns_of(
    config: EstimatorConfig,
    geometry: Geometry,
    origin_sd: float,
    drift_sd: float,
) -> tuple[Unknown, ...]:
    """Return the unknowns of a press but for the law's errors.

    Parameters
    ----------
    origin_sd : float
        Standard deviation of the strain origin, as compression [1]; 0: known.
    drift_sd : float
        Of the slope of the force's zero, as stress [Pa/s].
    """
    prior, unsure = config.prior, config.uncertainty
    length, per_force = geometry.length, geometry.stress_per_force
    order_sd = prior.fractional_order_sd if config.learns_fractional_order else 0.0
    site, rig = Lifetime.SITE, Lifetime.RIG
    late = partial(_late, unsure.delay_sd)
    found = (
        Unknown("log_g", prior.mean[0], prior.linear_stiffness_log_sd, site, By.LOG_G),
        Unknown("log_gn", prior.mean[1], prior.nonlinear_stiffness_log_sd, site, By.LOG_GN),
        Unknown("order", prior.fractional_order, order_sd, site),
        Unknown("origin", 0.0, origin_sd, site, motion=partial(_shift, -origin_sd)),
        Unknown("compliance", 0.0, unsure.compliance_sd, rig, By.COMPLIANCE),
        Unknown("delay", 0.0, unsure.delay_sd, rig, motion=late),
        Unknown(
            "friction",
            config.friction / unsure.friction_sd if unsure.friction_sd else 0.0,
            unsure.friction_sd,
            rig,
            stress=partial(_friction, per_force * unsure.friction_sd, length),
        ),
        Unknown("drift", 0.0, drift_sd, Lifetime.CONTACT, stress=partial(_drift, drift_sd)),
    )
    # The first four are always there, so that they have a place; what has no prior is known.
    return tuple(u for k, u in enumerate(found) if k <= ORIGIN or u.sd > 0.0)


class Design(NamedTuple):
    """What one standard deviation of each unknown changes of a record."""

    motions: Array  #: compressions at the points, (unknowns, points)
    stresses: Array  #: stress of the blocks, (unknowns, m)


class PressMotion:
    """The motion of one press.

    `unknowns`: the first of a state.
    """

    def __init__(self, unknowns: tuple[Unknown, ...]) -> None:
        self._unknowns = unknowns
        self._design: tuple[Points, Design] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return it without what the last record has decided: that is found anew."""
        return self.__dict__ | {"_design": None}

    def design(self, points: Points) -> Design:
        """Return the design of a record; that of the last one is kept."""
        if self._design is None or self._design[0] is not points:
            motions = np.zeros((len(self._unknowns), points.times.size))
            stresses = np.zeros((len(self._unknowns), points.stresses.size))
            for k, unknown in enumerate(self._unknowns):
                if unknown.motion is not None:
                    motions[k] = unknown.motion(points)
                if unknown.stress is not None:
                    stresses[k] = unknown.stress(points)
            self._design = points, Design(motions, stresses)
        return self._design[1]

    def compressions(self, points: Points, state: Array) -> Array:
        """Return the compressions from the origin at the points of a record."""
        return points.compressions + self._of_unknowns(state) @ self.design(points).motions

    def ends(self, points: Points, state: Array) -> tuple[Array, Array]:
        """Return the compressions from the origin at the ends of blocks [1], (m,).

        And their derivatives by the state, (m, size of it).
        """
        last = points.last
        by_state = np.zeros((last.size, state.size))
        by_state[:, : len(self._unknowns)] = self.design(points).motions[:, last].T
        return self.compressions(points, state)[last], by_state

    def added_stress(self, points: Points, state: Array) -> Array:
        """Return what the unknowns add to the stress of the blocks [Pa], (m,)."""
        return self._of_unknowns(state) @ self.design(points).stresses

    def _of_unknowns(self, state: Array) -> Array:
        """Return the state without the law's errors."""
        return state[: len(self._unknowns)]
