# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a touch will show of the surface: the detector's own fit, on a force that is simulated."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact.air import CHUNK_NS
from fden_ros.core.contact.detector import (
    AMPLE_EVIDENCE,
    CLEAR_DEVIATIONS,
    MIN_EVIDENCE,
    Onset,
)
from fden_ros.core.contact.surface import FIRST_WINDOW, find_surface
from fden_ros.core.site import hides_surface, origin_of
from fden_ros.core.streams.samples import NANOSECONDS, Pair
from fden_ros.planning.motion import Motion, Sensors

#: Seconds in the air before the touch that its fit sees, and that tell the force's zero.
_AIR, _ZERO_TIME = 1.0, 2.0
#: First windows of the fit [s], where the force is clear and where it is not.
_WINDOWS = FIRST_WINDOW, 1.0
_CHUNK = CHUNK_NS / NANOSECONDS


class Touch(NamedTuple):
    """What a touch shows."""

    origin_sd: float  #: of the strain origin with which the estimator begins [1]
    is_told: bool  #: there is a contact
    is_hidden: bool  #: noise hides the linear part, so that the surface is not seen


def zero_sd(sensors: Sensors) -> float:
    """Return the standard deviation of the force's zero, as the air has told it [N]."""
    return sensors.force_sd / math.sqrt(_ZERO_TIME * sensors.rate)


def touch_of(
    config: PipelineConfig,
    sensors: Sensors,
    motion: Motion,
    course: tuple[Array, Array],
    nonlinear_stiffness: float,
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
    nonlinear_stiffness : float
        Gn [1].
    seed : int
    """
    if config.strain_origin is not None:
        return Touch(0.0, True, False)
    times, forces = course
    seen = np.arange(-_AIR, float(times[-1]), 1.0 / sensors.rate)
    force = np.interp(seen, times, forces) * (seen > 0.0)
    threshold = max(CLEAR_DEVIATIONS * sensors.force_sd, config.contact.force_threshold)
    end, is_clear, is_told = _detection(seen, force, threshold, sensors.force_sd)
    seen, force = seen[:end], force[:end]
    force += sensors.force_sd * np.random.default_rng(seed).standard_normal(end)
    order = config.estimator.prior.fractional_order
    window = _WINDOWS[0 if is_clear else 1]
    surface = find_surface(seen, force, motion.depths(seen), order, 0.0, window)
    last = (Pair(0, 1, value, 0.0, None) for value in force[-3:].tolist())
    onset = Onset(
        samples=tuple(last),
        bias=0.0,
        bias_sd=zero_sd(sensors),
        drift=0.0,
        drift_sd=0.0,
        noise_sd=sensors.force_sd,
        displacement=surface.displacement,
        displacement_sd=surface.displacement_sd,
        rise=surface.rise,
        seen=True,
        air_seen=True,
    )
    _, origin_sd = origin_of(onset, config)
    is_hidden = hides_surface(surface.rise, config.geometry, nonlinear_stiffness)
    return Touch(origin_sd, is_told, is_hidden)


def _detection(
    times: Array, forces: Array, threshold: float, noise: float
) -> tuple[int, bool, bool]:
    """Return how many samples there are at the detection, whether it is clear, and whether told.

    The evidence is what a line in time leaves of the force, over the noise.
    """
    clear = np.flatnonzero(forces > threshold)
    count = np.arange(1.0, times.size + 1.0)
    t = times - times[0]
    st, stt = np.cumsum(t), np.cumsum(t * t)
    sf, stf, sff = np.cumsum(forces), np.cumsum(t * forces), np.cumsum(forces**2)
    spread = np.maximum(stt - st**2 / count, 1e-12)
    left = sff - sf**2 / count - (stf - st * sf / count) ** 2 / spread
    ample = np.flatnonzero(left > AMPLE_EVIDENCE * noise**2)
    found = [indices[0] for indices in (clear, ample) if indices.size]
    last = int(min(found)) if found else int(np.argmax(left))
    end = min(last + 1 + round(_CHUNK / float(times[1] - times[0])), times.size)
    return end, bool(clear.size and clear[0] == last), bool(left[last] > MIN_EVIDENCE * noise**2)
