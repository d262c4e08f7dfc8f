# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether a probe palpates without lifting clear of the tissue: its strokes are not presses."""

from __future__ import annotations

from fden_ros.core.contact import Onset
from fden_ros.core.oscillation import PalpationFrequency
from fden_ros.core.streams import NANOSECONDS, Pair

#: A probe has lifted where it was off the surface by this part of its last depth. The surface of a
#: stroke that never lifts is found where the stroke turns: within 1 % of the depth on silicone
#: (2 Hz, 0.05 N of noise), 4 % of simulated linear tissue, and 12 % (20 %) of exponential tissue
#: with 2 % (10 %) of its force as noise.
_LIFTED = 0.25
#: This many consecutive touches without a lift are strokes; one or two are repeated presses. So
#: are as many periods in one contact whose touch was not seen.
_LEAST_STROKES = 5
#: Samples per period that :attr:`REMEDY` needs: with fewer, noise on a slow press may look like a
#: palpation.
_SAMPLES_PER_PERIOD = 16
#: The setting for the parameter file.
REMEDY = "contact: {mode: continuous}"


class Strokes:
    """Watches for a probe that palpates and never lifts."""

    def __init__(self) -> None:
        self.frequency: float | None = None  #: of the palpation, once it is detected [Hz]
        self._rate = 0.0  # of the samples then [Hz]
        self._strokes = self._lifts = 0
        self.forget()

    def forget(self) -> None:
        """Drop the motion so far, but not the detection."""
        self._finder = PalpationFrequency()
        self._start_ns: int | None = None
        self._lowest = self._deepest = 0.0
        self._surface: float | None = None  # of the present contact, or the last
        self._count = 0
        self._unseen_ns: int | None = None  # beginning of a contact whose touch was not seen

    @property
    def prevails(self) -> bool:
        """Whether it is detected, and no more touches came after a lift than without one."""
        return self.frequency is not None and self._lifts <= self._strokes

    @property
    def warning(self) -> str:
        """What to do, in words; empty before a detection."""
        if self.frequency is None:
            return ""
        needed = _SAMPLES_PER_PERIOD * self.frequency
        if self._rate < needed:
            return (
                f"at {self._rate:.2g} samples a second, presses cannot be told from the strokes "
                f"of a probe that palpates: record at {needed:.2g} Hz or more"
            )
        return (
            f"the probe palpates at {self.frequency:.2g} Hz and never lifts clear of the tissue, "
            f"so its strokes are not presses: write {REMEDY} into the parameter file for the "
            "stiffness in N/m"
        )

    def add(self, pair: Pair, *, in_contact: bool) -> None:
        """Add a sample."""
        if self._start_ns is None:
            self._start_ns, self._lowest = pair.stamp_ns, pair.displacement
        self._finder.add((pair.stamp_ns - self._start_ns) / NANOSECONDS, pair.displacement)
        if in_contact:
            self._deepest = max(self._deepest, pair.displacement)
        else:
            self._lowest = min(self._lowest, pair.displacement)
        frequency, unseen_ns = self._finder.value, self._unseen_ns
        if frequency is None or unseen_ns is None:
            return
        if (pair.stamp_ns - unseen_ns) / NANOSECONDS * frequency > _LEAST_STROKES:
            self._detect()

    def touch(self, onset: Onset) -> None:
        """Add the beginning of a contact."""
        lowest = min(self._lowest, float(onset.way[1].min(initial=self._lowest)))
        before = self._surface
        depth = self._deepest - (onset.displacement if before is None else before)
        clearance = onset.displacement - lowest
        is_stroke = before is not None and clearance < _LIFTED * depth
        self._count = self._count + 1 if is_stroke else 0
        self._strokes += is_stroke
        self._lifts += before is not None and not is_stroke
        self._unseen_ns = None if onset.seen else onset.samples[0].stamp_ns
        self._surface = onset.displacement
        self._deepest = onset.samples[-1].displacement
        if self._count >= _LEAST_STROKES:
            self._detect()

    def release(self) -> None:
        """Add the end of a contact."""
        self._unseen_ns = None
        self._lowest = self._deepest

    def _detect(self) -> None:
        if self.frequency is None:
            self.frequency, self._rate = self._finder.value, self._finder.rate
