# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the way of a probe before a touch tells: whether it came through the air, and how."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.contact.air import CHUNK_NS
from fden_ros.core.contact.surface import Surface, clear_way
from fden_ros.core.streams import NANOSECONDS

#: After a release a probe that has not advanced touches nothing. It has by more than 6 usual
#: second differences, 10 deviations of white noise, whose range in 10,000 samples is 8, and than
#: 2 of the smallest steps of its encoder.
_ADVANCE_NOISE, _ADVANCE_STEPS = 6.0, 2.0
#: How the force swings while the probe moves is known after 0.2 s in which it moved at 0.3 of its
#: present speed; before that a rise must last for 0.15 s from a tenth of its depth on: then one
#: half of a vibration of 5 Hz is over.
_MOTION_TIME, _MOTION_SHARE = 0.2, 0.3
LASTING_TIME, _SHALLOW = 0.15, 0.1
#: The force rises by itself where a line in time explains it better than one in the way does, by
#: this chi-squared.
_BY_ITSELF = 4.0


class Approach(NamedTuple):
    """The samples of the lookback, and the surface that explains the newest."""

    time: Array  #: [s]
    force: Array  #: less bias and drift [N]
    displacement: Array  #: compliance removed [m]
    surface: Surface

    def came_through_air(self) -> bool:
        """Whether the probe came to the surface through the air."""
        before = self.displacement[: self.surface.first]
        if before.size < 2:
            return False
        way = self.surface.displacement - float(before.min())
        return way > clear_way(self.surface.displacement_sd, before)

    def has_advanced(self) -> bool:
        """Whether the probe has moved in since the release, by more than the displacement's noise.

        What moves evenly has no second differences; of noise they are 1.65 deviations.
        """
        way = self.displacement
        steps = np.abs(np.diff(way))
        noise = float(np.median(np.abs(np.diff(way, n=2)))) if way.size > 2 else 0.0
        step = float(steps[steps > 0.0].min(initial=math.inf))
        advance = float(np.max(way - np.minimum.accumulate(way)))
        return advance > max(_ADVANCE_NOISE * noise, _ADVANCE_STEPS * step)

    def rises_by_itself(self, drift: float, noise: float) -> bool:
        """Whether time explains the force before the touch, and not the way of the probe.

        Tissue that was pressed already would push more as the probe advances, and less at rest.
        `drift` [N/s] was taken off the force, whose noise per sample is `noise` [N].
        """
        time, way = (values[: self.surface.first] for values in (self.time, self.displacement))
        force = self.force[: self.surface.first] + drift * time
        if way.size < 3 or np.ptp(way) == 0.0:
            return False
        explained = [np.corrcoef(force, by)[0, 1] ** 2 for by in (time, way)]
        better = float(explained[0] - explained[1]) * force.size * float(np.var(force))
        return better > _BY_ITSELF * noise**2

    def began_in_air(self, threshold: float, rest: float) -> bool:
        """Whether no force was there [N] when the data began, or none for `rest` [s] since."""
        if self.force[0] < threshold:
            return True
        first = min(self.surface.first, self.time.size - 1)
        pressed = np.flatnonzero(self.force[:first] >= threshold)
        return bool(pressed.size) and float(self.time[first] - self.time[pressed[-1]]) > rest

    @property
    def lasting(self) -> float:
        """Since when the probe is behind the surface [s]."""
        return float(self.time[-1] - self.time[min(self.surface.first, self.time.size - 1)])

    def is_established(self, *, is_clear: bool) -> bool:
        """Whether the present rise can be no swing of a force that is shaken by the motion.

        It has lasted, or the probe has moved as fast before and the force's swing is known.
        """
        time, first = self.time, min(self.surface.first, self.time.size - 1)
        depth = self.displacement - self.surface.displacement
        # Where the probe rested, the surface may have been found anywhere in that time.
        shallow = np.flatnonzero(depth[first:] < _SHALLOW * depth[-1])
        if shallow.size:
            first += int(shallow[-1])
        lasting = float(time[-1] - time[first])
        if lasting > LASTING_TIME or not is_clear:
            return lasting > LASTING_TIME
        instants = np.arange(time[first], time[0], -CHUNK_NS / NANOSECONDS)
        places = np.interp(instants, time, self.displacement)
        speed = abs(float(depth[-1] - depth[first])) / max(lasting, CHUNK_NS / NANOSECONDS)
        moved = np.abs(np.diff(places)) * NANOSECONDS / CHUNK_NS
        moving = np.count_nonzero(moved >= _MOTION_SHARE * speed)
        return bool(moving * CHUNK_NS > _MOTION_TIME * NANOSECONDS)
