# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One motion of a press, and the record that it leaves without a force."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import TOUCH_TIME, Points, imagined_record
from fden_ros.core.law import Geometry

#: Frequency of an oscillation [Hz]: slow enough for any arm.
FREQUENCY = 1.5
#: Step of the samples that stand for those of the sensors [s], two in a block in motion. Half of
#: it changes no deviation by 2 %.
_STEP = 5e-3
#: Samples in a second that are simulated at most [Hz].
_MOST_RATE = 1000.0


@dataclass(frozen=True)
class Sensors:
    """What is measured, and how well.

    Attributes
    ----------
    rate : float
        Of the force [Hz].
    force_sd : float
        Noise of the force per sample [N]; where it is coloured, that of the white noise with the
        same mean over a second.
    displacement_sd : float
        Noise of the displacement per sample [m].
    """

    rate: float
    force_sd: float
    displacement_sd: float = 0.0

    def slower(self) -> Sensors:
        """Return sensors of at most 1 kHz that tell as much."""
        part = min(_MOST_RATE / self.rate, 1.0)
        noises = (math.sqrt(part) * sd for sd in (self.force_sd, self.displacement_sd))
        return Sensors(part * self.rate, *noises)


@dataclass(frozen=True)
class Motion:
    """A ramp, a hold, perhaps an oscillation about the same depth, and the way out.

    Attributes
    ----------
    depth : float
        Of ramp and hold [m].
    speed, release : float
        On the way in and out [m/s].
    hold : float
        Time at rest [s].
    amplitude : float
        Of the oscillation behind the hold [m].
    cycles : int
        Of the oscillation, whole ones.
    """

    depth: float
    speed: float
    hold: float
    release: float
    amplitude: float = 0.0
    cycles: int = 0

    @property
    def held(self) -> tuple[float, float]:
        """Times from the touch to the end of the ramp and to the beginning of the release [s]."""
        ramp = self.depth / self.speed
        return ramp, ramp + self.hold + self.cycles / FREQUENCY

    @property
    def seconds(self) -> float:
        """Time from the touch until the probe is back at the surface [s]."""
        return self.held[1] + self.depth / self.release

    @property
    def deepest(self) -> float:
        """Largest depth [m]."""
        return self.depth + self.amplitude * (self.cycles > 0)

    def depths(self, times: Array) -> Array:
        """Return the depths [m] at times from the touch [s], negative in the air."""
        ramp, held = self.held
        corners = [-1.0, ramp, held, self.seconds]
        depths = np.interp(times, corners, [-self.speed, self.depth, self.depth, 0.0])
        if self.cycles:
            phase = 2.0 * math.pi * FREQUENCY * (times - ramp - self.hold)
            is_on = (phase > 0.0) & (times < held)
            depths += self.amplitude * np.sin(phase) * is_on
        return depths

    def times(self, sensors: Sensors) -> Array:
        """Return the times of samples from just before the touch to the end [s].

        Fewer than the sensors give, for a record of the same blocks in less time.
        """
        own = 1.0 / sensors.rate
        step = max(_STEP, own)
        touch = np.arange(-2.0 * own, min(TOUCH_TIME, self.held[0]), own)
        return np.concatenate([touch, np.arange(touch[-1] + step, self.seconds, step)])


def record(motion: Motion, geometry: Geometry, sensors: Sensors, reach: float) -> Points:
    """Return the record of a motion, of which the stresses are 0.

    `reach`: how far before its nominal place the touch may be, as compression [1].
    """
    times = motion.times(sensors)
    compressions, noise = motion.depths(times) / geometry.length, sensors.displacement_sd
    points = imagined_record(times, compressions, noise / geometry.length, reach)
    steps = np.interp(points.middles, times[1:], np.diff(times))
    return replace(points, counts=points.counts * np.maximum(steps * sensors.rate, 1.0))
