# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a touch will show of the surface: the detector's own fit, on a force that is simulated."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact import imagined_onset
from fden_ros.core.origin import origin_of
from fden_ros.planning.motion import Motion, Sensors

#: Seconds in the air before the touch that its fit sees, and that tell the force's zero.
_AIR = 3.0


class Touch(NamedTuple):
    """What a touch shows."""

    origin_sd: float  #: of the strain origin with which the estimator begins [1]
    is_told: bool  #: there is a contact
    is_hidden: bool  #: by noise is where the force begins


def zero_sd(sensors: Sensors) -> float:
    """Return the standard deviation of the force's zero, as the air has told it [N]."""
    return sensors.force_sd / math.sqrt(_AIR * sensors.rate)


def touch_of(
    config: PipelineConfig,
    sensors: Sensors,
    motion: Motion,
    course: tuple[Array, Array],
    seed: int,
) -> Touch:
    """Return what the touch of a motion shows, of seeded noise.

    Parameters
    ----------
    config : PipelineConfig
    sensors : Sensors
    motion : Motion
    course : tuple of ndarray, shape (n,)
        Times from the touch [s] and forces without noise [N].
    seed : int
    """
    if config.contact_point is not None:
        return Touch(0.0, True, False)
    noise, threshold = sensors.force_sd, config.contact.force_threshold
    seen = np.arange(-_AIR, motion.held[1], 1.0 / sensors.rate)
    clean = np.interp(seen, *course) * (seen > 0.0)
    forces = clean + noise * np.random.default_rng(seed).standard_normal(seen.size)
    depths, order = motion.depths(seen), config.estimator.prior.fractional_order
    onset, is_told = imagined_onset(
        seen, depths, (clean, forces), order, (noise, zero_sd(sensors)), threshold
    )
    _, origin_sd = origin_of(onset, config)
    return Touch(origin_sd, is_told, not onset.shows_surface)
