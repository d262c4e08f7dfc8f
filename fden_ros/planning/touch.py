# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a touch will show of the surface: the detector's own fit, on a force that is simulated."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact.air import CHUNK_NS, CLEAR_DEVIATIONS
from fden_ros.core.contact.approach import LASTING_TIME
from fden_ros.core.contact.detector import AMPLE_EVIDENCE, LONG_WINDOW, MIN_EVIDENCE, RETRY, Onset
from fden_ros.core.contact.surface import FIRST_WINDOW, Surface, find_surface
from fden_ros.core.origin import origin_of
from fden_ros.core.streams.samples import NANOSECONDS, Pair
from fden_ros.planning.motion import Motion, Sensors

#: Seconds in the air before the touch that its fit sees, and that tell the force's zero.
_AIR = 3.0
_CHUNK = CHUNK_NS / NANOSECONDS


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
    if config.strain_origin is not None:
        return Touch(0.0, True, False)
    noise, threshold = sensors.force_sd, config.contact.force_threshold
    seen = np.arange(-_AIR, motion.held[1], 1.0 / sensors.rate)
    clean = np.interp(seen, *course) * (seen > 0.0)
    forces = clean + noise * np.random.default_rng(seed).standard_normal(seen.size)
    depths, order = motion.depths(seen), config.estimator.prior.fractional_order

    def surface_of(end: int, window: float) -> Surface:
        return find_surface(seen[:end], forces[:end], depths[:end], order, 0.0, window)

    clear = max(CLEAR_DEVIATIONS * noise, threshold)
    surface, end = _detected(surface_of, seen, clean, noise, clear)
    last = (Pair(0, 1, value, 0.0, None) for value in forces[max(end - 3, 0) : end].tolist())
    onset = Onset(
        samples=tuple(last),
        way=np.empty((3, 0)),
        bias=0.0,
        bias_sd=zero_sd(sensors),
        drift=0.0,
        drift_sd=0.0,
        noise_sd=noise,
        displacement=surface.displacement,
        displacement_sd=surface.displacement_sd,
        shows_surface=surface.is_seen,
        seen=True,
        air_seen=True,
    )
    _, origin_sd = origin_of(onset, config)
    return Touch(origin_sd, surface.evidence >= MIN_EVIDENCE, not surface.is_seen)


def _detected(
    surface_of: Callable[[int, float], Surface],
    times: Array,
    clean: Array,
    noise: float,
    threshold: float,
) -> tuple[Surface, int]:
    """Return the surface where the contact is detected, and how many samples there are by then.

    As the detector does: where the evidence is ample, looked for again when the contact has lasted
    for a tenth longer; at the latest where the force is clear. Not looked for before the force
    without noise has as large a chi-squared.
    """
    step = float(times[1] - times[0])
    chunk = math.ceil(_CHUNK / step)
    above = np.flatnonzero(clean > threshold)
    latest = min(int(above[0]) + chunk, times.size) if above.size else times.size
    ample = (np.cumsum(clean**2) > AMPLE_EVIDENCE * noise**2) & (times > LASTING_TIME)
    end = int(np.argmax(ample)) if ample.any() else latest
    while end < latest:
        surface = surface_of(end, LONG_WINDOW)
        if surface.evidence >= AMPLE_EVIDENCE:
            return surface, end
        lasting = float(times[end - 1] - times[min(surface.first, end - 1)])
        end += max(round(RETRY * lasting / step), chunk)
    return surface_of(latest, FIRST_WINDOW if above.size else LONG_WINDOW), latest
