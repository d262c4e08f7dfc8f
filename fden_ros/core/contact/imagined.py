# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A touch that is not made: what the detector would find on a force that is simulated."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.contact.air import CHUNK_NS, CLEAR_DEVIATIONS
from fden_ros.core.contact.approach import LASTING_TIME
from fden_ros.core.contact.detector import AMPLE_EVIDENCE, LONG_WINDOW, MIN_EVIDENCE, RETRY, Onset
from fden_ros.core.contact.surface import FIRST_WINDOW, Surface, find_surface
from fden_ros.core.streams import NANOSECONDS, Pair

_CHUNK = CHUNK_NS / NANOSECONDS


def imagined_onset(
    times: Array,
    depths: Array,
    forces: tuple[Array, Array],
    order: float,
    deviations: tuple[float, float],
    threshold: float,
) -> tuple[Onset, bool]:
    """Return the onset of a touch, and whether its evidence is that of a contact.

    Parameters
    ----------
    times, depths : ndarray, shape (n,)
        Of samples [s, m].
    forces : tuple of ndarray, shape (n,)
        Without noise, and with it [N].
    order : float
        alpha [1].
    deviations : tuple of float
        Of a sample's force, and of the force's zero [N].
    threshold : float
        Above which a force is a contact whatever its noise [N].
    """
    clean, noisy = forces
    noise, zero_sd = deviations

    def surface_of(end: int, window: float) -> Surface:
        return find_surface(times[:end], noisy[:end], depths[:end], order, 0.0, window)

    clear = max(CLEAR_DEVIATIONS * noise, threshold)
    surface, end = _detected(surface_of, times, clean, noise, clear)
    last = (Pair(0, 1, value, 0.0, None) for value in noisy[max(end - 3, 0) : end].tolist())
    onset = Onset(
        samples=tuple(last),
        way=np.empty((3, 0)),
        bias=0.0,
        bias_sd=zero_sd,
        drift=0.0,
        drift_sd=0.0,
        noise_sd=noise,
        displacement=surface.displacement,
        displacement_sd=surface.displacement_sd,
        shows_surface=surface.is_seen,
        seen=True,
        air_seen=True,
    )
    return onset, surface.evidence >= MIN_EVIDENCE


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
