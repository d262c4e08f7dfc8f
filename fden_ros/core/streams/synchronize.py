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

"""Two streams of stamped samples into pairs: displacement interpolated to the stamps of the force.

Every decision rests on stamps and on the order of samples within their own stream, never on when
samples of the two streams arrive relative to each other. So live, replayed and batched data give
the same pairs.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fden_ros.core.streams.guard import StreamGuard
from fden_ros.core.streams.samples import NANOSECONDS, Pair, Position, Reason, Sample

#: The displacement's noise is measured over its last 256 samples by the median of its magnitude,
#: which is 0.6745 standard deviations of a normal variable.
_NOISE_SAMPLES = 256
_MEDIAN_OF_NORMAL = 0.6745
#: In a slow stream displacements up to 2 usual steps of the force apart are interpolated between,
#: and a sample waits for up to 4 usual steps of its stream.
_GAP_STEPS, _WINDOW_STEPS = 2.0, 4.0


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
    """

    displacement_delay: float = 0.0
    max_gap: float = 0.25
    pairing_window: float = 5.0
    force_limit: float = 1e5
    displacement_limit: float = 10.0


class Synchronizer:
    """Pair force with displacement by stamp.

    Parameters
    ----------
    config : SynchronizeConfig
    on_pair : callable
        Called with each :class:`Pair`, in order.
    rejected : collections.Counter
        Counts of rejected samples, keyed ``"force.<reason>"`` or ``"displacement.<reason>"``;
        added to.
    """

    def __init__(
        self, config: SynchronizeConfig, on_pair: Callable[[Pair], None], rejected: Counter[str]
    ) -> None:
        self._config = config
        self._on_pair = on_pair
        self._delay_ns = round(config.displacement_delay * NANOSECONDS)
        self._max_gap_ns = round(config.max_gap * NANOSECONDS)
        self._window_ns = round(config.pairing_window * NANOSECONDS)
        self.force_guard = StreamGuard(config.force_limit, rejected, "force")
        self.displacement_guard = StreamGuard(config.displacement_limit, rejected, "displacement")
        self._forces: deque[Sample] = deque()
        self._displacements: deque[Sample] = deque()
        self._passed: deque[Sample] = deque(maxlen=_NOISE_SAMPLES)
        self._behind_since_ns: int | None = None

    def motion_noise(self) -> float:
        """Variance of the displacement's noise per sample times the time between samples [m^2 s].

        From the distances of the last 256 samples from the lines between their neighbours; 0 while
        there are fewer than 32.
        """
        if len(self._passed) < _NOISE_SAMPLES // 8:
            return 0.0
        time = np.array([sample.stamp_ns - self._passed[0].stamp_ns for sample in self._passed])
        value = np.array([sample.value for sample in self._passed])
        step = np.diff(time) / NANOSECONDS
        share = step[:-1] / (step[:-1] + step[1:])
        apart = value[1:-1] - (1.0 - share) * value[:-2] - share * value[2:]
        scale = np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
        deviation = float(np.median(np.abs(apart / scale))) / _MEDIAN_OF_NORMAL
        return deviation**2 * float(np.median(step))

    def add_force(self, stamp_ns: int, force: float) -> None:
        """Add a force sample [N]."""
        for sample in self.force_guard.accept(stamp_ns, force):
            self._forces.append(sample)
            self._bound_memory(self._forces, self.force_guard)
            self._pair()

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
        for sample in self.displacement_guard.accept(stamp_ns, displacement, position, load):
            if self._delay_ns:
                sample = sample._replace(stamp_ns=sample.stamp_ns - self._delay_ns)
            self._displacements.append(sample)
            self._pair()
            self._bound_memory(self._displacements, self.displacement_guard)

    def _pair(self) -> None:
        forces, displacements = self._forces, self._displacements
        while forces and displacements:
            force = forces[0]
            key = (force.epoch, force.stamp_ns)
            while len(displacements) > 1 and displacements[1][:2] <= key:
                self._passed.append(displacements.popleft())
            before = displacements[0]
            if before[:2] > key:
                self._reject_oldest_force(Reason.UNPAIRED)
                self._follow_displacement(force, before)
            elif before[:2] == key:
                forces.popleft()
                net = force.value - before.load
                self._on_pair(Pair(*key, net, before.value, before.position))
            elif len(displacements) == 1:
                return
            else:
                self._interpolate(force, before, displacements[1])

    def _interpolate(self, force: Sample, before: Sample, after: Sample) -> None:
        if before.epoch != force.epoch or after.epoch != force.epoch:
            self._reject_oldest_force(Reason.UNPAIRED)
            return
        gap_ns = after.stamp_ns - before.stamp_ns
        if gap_ns > max(self._max_gap_ns, _GAP_STEPS * force.usual_ns):
            self._reject_oldest_force(Reason.DISPLACEMENT_GAP)
            return
        share = (force.stamp_ns - before.stamp_ns) / gap_ns
        displacement = before.value + share * (after.value - before.value)
        position = None
        if before.position is not None and after.position is not None:
            (x0, y0, z0), (x1, y1, z1) = before.position, after.position
            position = (x0 + share * (x1 - x0), y0 + share * (y1 - y0), z0 + share * (z1 - z0))
        self._forces.popleft()
        net = force.value - (before.load + share * (after.load - before.load))
        self._on_pair(Pair(force.epoch, force.stamp_ns, net, displacement, position))

    def _follow_displacement(self, force: Sample, displacement: Sample) -> None:
        """Let the force join an epoch that only the displacement entered, after a window."""
        if displacement.epoch <= self.force_guard.epoch:
            self._behind_since_ns = None
        elif self._behind_since_ns is None:
            self._behind_since_ns = force.stamp_ns
        elif force.stamp_ns - self._behind_since_ns > self._window_ns:
            self.force_guard.join_epoch(displacement.epoch, force.stamp_ns)
            self._behind_since_ns = None

    def _reject_oldest_force(self, reason: str) -> None:
        self._forces.popleft()
        self.force_guard.reject(reason)

    def _bound_memory(self, samples: deque[Sample], guard: StreamGuard) -> None:
        """Drop samples that have waited for longer than the pairing window.

        If a force was dropped after its clock jumped back, the other stream's clock did not jump:
        that stream is then taken to be in the same epoch.
        """
        newest = samples[-1]
        window_ns = max(self._window_ns, _WINDOW_STEPS * newest.usual_ns)
        while self._waited_ns(samples[0], newest, guard) > window_ns:
            samples.popleft()
            if guard is self.force_guard:
                guard.reject(Reason.UNPAIRED)
                if self.displacement_guard.epoch < newest.epoch:
                    self.displacement_guard.join_epoch(newest.epoch, newest.stamp_ns)

    @staticmethod
    def _waited_ns(oldest: Sample, newest: Sample, guard: StreamGuard) -> int:
        if oldest.epoch == newest.epoch:
            return newest.stamp_ns - oldest.stamp_ns
        return newest.stamp_ns - guard.epoch_start_ns
