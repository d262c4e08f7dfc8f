# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Streams of stamped samples into pairs: all others interpolated to the stamps of the force.

A force waits for the displacements around its stamp and then, where the tissue's surface is
measured too, for the surface around it: :class:`~fden_ros.core.streams.join.Join`.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fden_ros.core.streams.guard import StreamGuard
from fden_ros.core.streams.join import Around, Join, JoinLimits
from fden_ros.core.streams.samples import NANOSECONDS, Pair, Position, Reason, Sample

#: The displacement's noise is measured over its last 256 samples by the median of its magnitude,
#: which is 0.6745 standard deviations of a normal variable.
_NOISE_SAMPLES = 256
_MEDIAN_OF_NORMAL = 0.6745


@dataclass(frozen=True)
class SynchronizeConfig:
    """How streams are checked and paired; times in seconds.

    Parameters
    ----------
    displacement_delay : float
        The displacement's stamps lag the force's by this much [s]; may be negative.
    max_gap : float
        Displacement samples further apart than this, and than 2 usual steps of the force, are not
        interpolated between [s].
    pairing_window : float
        A sample waits at most this long, in stamps, for its partner [s]; or 4 usual steps of its
        stream, where they are longer.
    force_limit, displacement_limit : float
        Larger magnitudes are rejected as out of range [N, m].
    takes_surface : bool
        A force waits for the surface around it too, which is taken off the displacement.
    surface_delay : float
        The surface's stamps lag the force's by this much [s]; may be negative.
    """

    displacement_delay: float = 0.0
    max_gap: float = 0.25
    pairing_window: float = 5.0
    force_limit: float = 1e5
    displacement_limit: float = 10.0
    takes_surface: bool = False
    surface_delay: float = 0.0


class Synchronizer:
    """Pair force with displacement by stamp.

    Parameters
    ----------
    config : SynchronizeConfig
    on_pair : callable
        Called with each :class:`Pair`, in order.
    rejected : collections.Counter
        Counts of rejected samples, keyed ``"<stream>.<reason>"``; added to.
    """

    def __init__(
        self, config: SynchronizeConfig, on_pair: Callable[[Pair], None], rejected: Counter[str]
    ) -> None:
        self._config = config
        self._on_pair = on_pair
        self.force_guard = StreamGuard(config.force_limit, rejected, "force")
        self.displacement_guard = StreamGuard(config.displacement_limit, rejected, "displacement")
        self.surface_guard = StreamGuard(config.displacement_limit, rejected, "surface")
        self._passed: deque[Sample] = deque(maxlen=_NOISE_SAMPLES)
        self._surfaces_passed: deque[Sample] = deque(maxlen=_NOISE_SAMPLES)
        self._displacements = Join[None](
            self._limits(config.displacement_delay, Reason.UNPAIRED, Reason.DISPLACEMENT_GAP),
            self.force_guard,
            self.displacement_guard,
            self._on_displacement,
            self._passed,
        )
        self._surfaces = Join[Pair](
            self._limits(config.surface_delay, Reason.NO_SURFACE, Reason.SURFACE_GAP),
            self.force_guard,
            self.surface_guard,
            self._on_surface,
            self._surfaces_passed,
        )

    def _limits(self, delay: float, unpaired: str, gap: str) -> JoinLimits:
        return JoinLimits(
            max_gap_ns=round(self._config.max_gap * NANOSECONDS),
            window_ns=round(self._config.pairing_window * NANOSECONDS),
            delay_ns=round(delay * NANOSECONDS),
            unpaired=unpaired,
            gap=gap,
        )

    @property
    def waiting(self) -> int:
        """How many samples of all streams are kept for others to come."""
        return self._displacements.waiting + self._surfaces.waiting

    def motion_noise(self) -> float:
        """Variance of the displacement's noise per sample times the time between samples [m^2 s].

        From the distances of the last 256 samples from the lines between their neighbours; 0 while
        there are fewer than 32. That of the surface adds to it.
        """
        return _noise_of(self._passed) + _noise_of(self._surfaces_passed)

    def add_force(self, stamp_ns: int, force: float) -> None:
        """Add a force sample [N]."""
        for sample in self.force_guard.accept(stamp_ns, force):
            self._displacements.lead(sample, None)

    def add_displacement(
        self,
        stamp_ns: int,
        displacement: float,
        position: Position | None = None,
        load: float = 0.0,
    ) -> None:
        """Add a displacement sample [m], and the probe's position [m] where it is known.

        `load` [N] is what the sensor measures there without any contact.
        """
        self._displacements.follow(
            self.displacement_guard.accept(stamp_ns, displacement, position, load)
        )

    def add_surface(self, stamp_ns: int, surface: float) -> None:
        """Add a place of the tissue's surface, along the way of the displacement [m]."""
        if self._config.takes_surface:
            self._surfaces.follow(self.surface_guard.accept(stamp_ns, surface))

    def _on_displacement(self, force: Sample, _: None, around: Around) -> None:
        pair = Pair(
            force.epoch,
            force.stamp_ns,
            force.value - around.load,
            around.value,
            around.position,
        )
        if self._config.takes_surface:
            self._surfaces.lead(force, pair)
        else:
            self._on_pair(pair)

    def _on_surface(self, _: Sample, pair: Pair, around: Around) -> None:
        self._on_pair(pair._replace(displacement=pair.displacement - around.value))


def _noise_of(samples: deque[Sample]) -> float:
    if len(samples) < _NOISE_SAMPLES // 8:
        return 0.0
    time = np.array([sample.stamp_ns - samples[0].stamp_ns for sample in samples])
    value = np.array([sample.value for sample in samples])
    step = np.diff(time) / NANOSECONDS
    share = step[:-1] / (step[:-1] + step[1:])
    apart = value[1:-1] - (1.0 - share) * value[:-2] - share * value[2:]
    scale = np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
    deviation = float(np.median(np.abs(apart / scale))) / _MEDIAN_OF_NORMAL
    return deviation**2 * float(np.median(step))
