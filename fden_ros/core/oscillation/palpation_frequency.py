# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""At which frequency a probe palpates, found from its displacement."""

from __future__ import annotations

import math

import numpy as np

#: The displacement is resampled at this rate [Hz].
_RATE = 32
#: Palpation is at most this fast [Hz], and has lasted for 3 periods, and 3 s.
_FASTEST, _PERIODS = 5.0, 3.0
#: Another frequency is taken when it differs by this share.
_CHANGE = 0.04


class PalpationFrequency:
    """Finds the frequency of an oscillation that dominates the velocity."""

    def __init__(self) -> None:
        self.value: float | None = None  #: the frequency [Hz]; None while nothing oscillates
        self._ring = np.zeros(8 * _RATE)  # the last 8 s
        self._count = self._samples = 0
        self._start: float | None = None
        self._time = self._displacement = 0.0

    def add(self, time: float, displacement: float) -> None:
        """Add a sample at a time [s]; times increase."""
        if self._start is None or time - self._time > self._ring.size / _RATE:
            # No stored sample lies within the window before it.
            self.value, self._count, self._samples, self._start = None, 0, 0, time
        self._samples += 1
        while (instant := self._start + self._count / _RATE) <= time:
            share = (instant - self._time) / (time - self._time) if self._count else 1.0
            step = displacement - self._displacement
            self._ring[self._count % self._ring.size] = self._displacement + share * step
            self._count += 1
            if self._count >= _PERIODS * _RATE and self._count % (_RATE // 2) == 0:
                self._look()
        self._time, self._displacement = time, displacement

    @property
    def rate(self) -> float:
        """Samples a second so far [Hz]."""
        return self._samples * _RATE / max(self._count, 1)

    def _look(self) -> None:
        found, present = self._dominant(), self.value
        if found is None or present is None or abs(found / present - 1.0) > _CHANGE:
            self.value = found

    def _dominant(self) -> float | None:
        """Return the frequency [Hz] that dominates the velocity; None: there is none."""
        velocity = np.diff(np.roll(self._ring, -(self._count % self._ring.size))[-self._count :])
        velocity -= velocity.mean()
        points = 8 * self._ring.size  # with zeros: in steps of 1/64 Hz
        power = np.abs(np.fft.rfft(velocity * np.hanning(velocity.size), points)) ** 2
        step, own = _RATE / points, points / velocity.size
        # The peak of a Hann window is 4 steps of its length wide.
        width, lowest = round(2.0 * own), math.ceil(_PERIODS * own)
        highest = math.floor(_FASTEST / step)
        peak = lowest + int(np.argmax(power[lowest : highest + 1]))
        near = power[max(peak - width, 0) : peak + width + 1].sum()
        # A palpation has more than half of the power in one peak.
        if not near > 0.5 * power.sum() or peak in (lowest, highest):
            return None
        below, top, above = power[peak - 1 : peak + 2]
        return float(step * (peak + 0.5 * (below - above) / (below - 2.0 * top + above)))
