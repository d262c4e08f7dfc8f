# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The force in the air after a contact, which may contradict that before it."""

from __future__ import annotations

import math
from typing import NamedTuple

from fden_ros.core.arrays import NOT_BY_CHANCE
from fden_ros.core.contact import CHUNK_SAMPLES, SLOW_NS, Onset
from fden_ros.core.streams import BRIEF_NS, NANOSECONDS, Pair


class AirChange(NamedTuple):
    """The force in the air after a contact less that before it, extrapolated by its drift."""

    change: float  #: [N]
    noise_variance: float  #: of the change, from the uncertain air before [N^2]
    drift_variance: float  #: of the drift stated for the contact [N^2]

    @property
    def deviations(self) -> float:
        """The change over its stated standard deviation [1]; below 0: the force has fallen."""
        return self.change / math.sqrt(self.noise_variance + self.drift_variance)

    @property
    def has_fallen(self) -> bool:
        """Whether the force has fallen by more than noise and drift explain."""
        return self.deviations < -NOT_BY_CHANCE

    @property
    def has_drifted(self) -> bool:
        """Whether it contradicts the stated drift."""
        return abs(self.deviations) > NOT_BY_CHANCE


class AirAfter:
    """Averages the force in the air behind the surface of a contact, from 0.25 to 0.5 s on.

    `drift_sd` is that of the force over one second in contact [N], as stated.
    """

    def __init__(self, onset: Onset, release_ns: int, drift_sd: float) -> None:
        self._onset, self._release_ns, self._drift_sd = onset, release_ns, drift_sd
        self._behind_ns: int | None = None
        self._size, self._sum = 0, 0.0
        self._is_complete = False

    @property
    def _end_ns(self) -> int:
        """When the averaging ends [ns]; 0: it has not begun."""
        return 0 if self._behind_ns is None else self._behind_ns + BRIEF_NS

    def is_due(self, stamp_ns: int) -> bool:
        """Whether the contact is to be judged at a stamp: a slow one in this air is then known."""
        return stamp_ns > (self._behind_ns or self._release_ns) + SLOW_NS

    def is_known(self, until_ns: int) -> bool:
        """Whether the averaging had ended by a stamp."""
        return self._is_complete and self._end_ns <= until_ns

    def average(self, pair: Pair) -> None:
        """Add a pair after the release."""
        if self._is_complete:
            return
        if pair.displacement >= self._onset.displacement:
            self._behind_ns, self._size, self._sum = None, 0, 0.0
            return
        if self._behind_ns is None:
            self._behind_ns = pair.stamp_ns
        elapsed_ns = pair.stamp_ns - self._behind_ns
        self._is_complete = elapsed_ns > BRIEF_NS
        # Adhesion is over by then, and a creeping sensor has hardly recovered.
        if BRIEF_NS <= 2 * elapsed_ns <= 2 * BRIEF_NS:
            self._size += 1
            self._sum += pair.force

    def change(self) -> AirChange | None:
        """Return the change in the air; None: too few samples."""
        onset = self._onset
        if not self._is_complete or self._size < CHUNK_SAMPLES:
            return None
        elapsed = (self._end_ns - onset.samples[0].stamp_ns) / NANOSECONDS
        return AirChange(
            self._sum / self._size - onset.bias - onset.drift * elapsed,
            onset.bias_sd**2 + (onset.drift_sd * elapsed) ** 2 + onset.noise_sd**2 / self._size,
            self._drift_sd**2 * elapsed,
        )
