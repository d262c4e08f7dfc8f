# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is not known of the rig: one object an unknown, with its column, prior and source.

To add one, add its standard deviation to the configuration and an object to :func:`rig_of`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.discrepancy import STRAIN_FLOOR
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.law import Geometry
from fden_ros.core.parameter import TINY

#: Speed at which friction has half of its square [m/s]: below is a hold.
_FRICTION_SPEED = 5e-4
#: Relative standard deviation of G between two spots of one tissue [1].
_SPOT = 0.3
#: Data that say less than this variance of an unknown say nothing, and largest variance of its
#: prior, in its standard deviations [1].
_SAYS_NOTHING, _WIDEST = 100.0, 64.0
#: Shares of a Gaussian below one standard deviation on each side of its mean [1].
_ONE_SD = 0.1587, 0.8413
#: Places of the data's Gaussian at which Student's prior is weighed [1].
_PLACES = np.linspace(-6.0, 6.0, 401)


class Motion(NamedTuple):
    """What columns depend on, at points of the motion or in the mean over cells, (k,) each."""

    elapsed: Array  #: since the first point of the press [s]
    indentations: Array  #: [1]
    speeds: Array  #: as far as they are above their noise [1/s]
    stresses: Array  #: by the model [Pa]
    earlier: Array = np.zeros(0)  #: indentations at the points of the press before these [1]
    size: float = 1.0  #: of the unknown, about which the column is taken [1]


@dataclass(frozen=True)
class Nuisance:
    """One number that is not known; it counts in its standard deviations.

    Attributes
    ----------
    sd : float
        In the unit of the column's cause.
    column : callable
        Motion to what one standard deviation changes, (k,): the indentations at the points [1]
        where `moves`, or the stresses of the cells [Pa].
    mean : float
        Of its prior, in standard deviations [1].
    has_tails : bool
        Its prior is Student's with two degrees of freedom: rigs are off by more than is stated.
    is_per_press : bool
        It is another number in each press.
    source : str
        Under which its part of the variance is stated.
    """

    name: str
    sd: float
    column: Callable[[Motion], Array]
    moves: bool
    source: str
    mean: float = 0.0
    has_tails: bool = False
    is_per_press: bool = False


class Rig(NamedTuple):
    """All that is not known of the rig, and of other spots of a place by their number."""

    nuisances: tuple[Nuisance, ...]
    zero_sd: float  #: of the stress's zero at the touch [Pa]
    force_walk_sd: float  #: of the walk of this zero in one second [Pa]
    surface_walk_sd: float  #: of that of the surface, against its stiffness [1]
    spots: Mapping[int, tuple[Nuisance, ...]] = MappingProxyType({})


def _compliance(sd: float, motion: Motion) -> Array:
    return -sd * motion.stresses


def _delay(sd: float, motion: Motion) -> Array:
    return sd * motion.speeds


def _backlash(sd: float, motion: Motion) -> Array:
    # The tip is where the drive is while this pushes, and stays until the play is taken up.
    path = np.concatenate([motion.earlier, motion.indentations])
    tip, at, size = np.empty_like(path), float(path[0]), max(motion.size, 1.0)
    for k, place in enumerate(path.tolist()):
        at = min(max(at, place), place + size * sd)
        tip[k] = at
    return (tip - path)[motion.earlier.size :] / size


def _stiffness(sd: float, motion: Motion) -> Array:
    return sd * motion.stresses


def _contact_point(sd: float, motion: Motion) -> Array:
    return np.full(motion.indentations.shape, -sd)


def spot_of(contact_point_sd: float) -> tuple[Nuisance, ...]:
    """Return what is not known of another spot of the same tissue: its contact point, and G."""
    stiffness, point = partial(_stiffness, _SPOT), partial(_contact_point, contact_point_sd)
    return (
        Nuisance("stiffness", _SPOT, stiffness, False, "law"),
        Nuisance("contact point", contact_point_sd, point, True, "surface"),
    )


def _friction(sd: float, length: float, motion: Motion) -> Array:
    speed = length * motion.speeds
    # In the air there is none, or it is in the bias.
    pressed = np.maximum(motion.indentations, 0.0) ** 2
    return sd * pressed / (pressed + STRAIN_FLOOR**2) * speed / np.hypot(speed, _FRICTION_SPEED)


def _drift(sd: float, motion: Motion) -> Array:
    return sd * motion.elapsed


def with_tails(mean: float, variance: float, before: float) -> float:
    """Return the variance of the Gaussian that stands for a prior with tails.

    With it the data leave an interval of 68 % as wide as they leave of Student's prior with two
    degrees of freedom, and no narrower than of a Gaussian of standard deviation 1. Where they say
    nothing it is 1.3 times as wide as that.

    Parameters
    ----------
    mean, variance, before : float
        Of the unknown given the data, and its variance before, as a Gaussian; in its standard
        deviations [1].
    """
    told = 1.0 / min(max(1.0 / variance - 1.0 / before, 1.0 / _SAYS_NOTHING), 1.0 / TINY)
    by_data = mean / variance * told
    places = by_data + math.sqrt(told) * _PLACES
    weights = np.exp(-0.5 * _PLACES**2) * (1.0 + 0.5 * places**2) ** -1.5
    total = np.cumsum(weights)
    low, high = np.interp(_ONE_SD, total / total[-1], places)
    left = (2.0 / (high - low)) ** 2 - 1.0 / told
    return min(max(1.0 / max(left, 1.0 / _WIDEST), 1.0), _WIDEST)


def rig_of(config: EstimatorConfig, geometry: Geometry, zero_sd: float, drift_sd: float) -> Rig:
    """Return what is not known of the rig.

    Parameters
    ----------
    zero_sd, drift_sd : float
        Of the stress's zero at the touch [Pa] and of its drift [Pa/s].
    """
    unsure, length, scale = config.uncertainty, geometry.length, geometry.stress_per_force
    friction = scale * unsure.friction_sd
    mean = config.friction / unsure.friction_sd if unsure.friction_sd else 0.0
    compliance = unsure.compliance_sd / length / scale
    delay, backlash = unsure.delay_sd, unsure.backlash_sd / length
    nuisances = (
        Nuisance("compliance", compliance, partial(_compliance, compliance), True, "compliance",
                 has_tails=True),
        Nuisance("delay", delay, partial(_delay, delay), True, "delay", has_tails=True),
        Nuisance("backlash", backlash, partial(_backlash, backlash), True, "backlash",
                 has_tails=True),
        Nuisance("friction", friction, partial(_friction, friction, length), False, "friction",
                 mean, has_tails=True),
        Nuisance("drift", drift_sd, partial(_drift, drift_sd), False, "drift", is_per_press=True),
    )  # fmt: skip
    known = tuple(one for one in nuisances if one.sd > 0.0)
    force_walk, surface_walk = scale * unsure.force_drift_sd, unsure.surface_motion_sd / length
    return Rig(known, zero_sd, force_walk, surface_walk)
