# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The samples behind one estimate: their sums, and what the probe does."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from fden_ros.core.contact import SLIGHT
from fden_ros.core.outputs import Phase
from fden_ros.core.streams import NANOSECONDS

#: The probe holds while the compression changes by less than this per second [1/s].
_HOLDING_RATE = 0.005


class ContactSample(NamedTuple):
    """A sample of a contact, on the tissue."""

    stamp_ns: int
    step: float  #: since the last sample in contact [s]
    force: float  #: of the contact [N]
    compression: float  #: from the nominal origin [1]
    stress: float  #: [Pa]
    is_free: bool  #: the tissue is not on the probe


class Means(NamedTuple):
    """Means over the samples of a block."""

    start_ns: int
    end_ns: int
    size: int
    duration: float  #: from the first sample to the last and one step more [s]
    compression: float  #: [1]
    stress: float  #: [Pa]
    force: float  #: [N]
    has_free: bool  #: the tissue was free of the probe for part of it


class BlockSums:
    """Sums over the samples of a block, and when it is complete.

    A block is complete after a `duration` [s], or when the `compression` [1] within it has
    changed by more.
    """

    def __init__(self, duration: float, compression: float) -> None:
        # A block is complete a little earlier, so that jitter adds no sample.
        self._duration_ns = round((1.0 - SLIGHT) * duration * NANOSECONDS)
        self._most_compression = compression
        self.forget()

    def forget(self) -> None:
        """Drop all samples, and number the blocks anew."""
        self.number = 0  #: of the last complete block
        self.restart(0)

    def clear(self) -> None:
        """Drop the samples of the block that is not complete."""
        self._count = 0
        self._has_free = False
        self._compression = self._stress = self._force = 0.0

    def restart(self, stamp_ns: int) -> None:
        """Begin a block at `stamp_ns`."""
        self.clear()
        self._end_ns = stamp_ns

    def passes(self, stamp_ns: int) -> bool:
        """Whether a block's duration has passed without samples; if so the next begins."""
        if stamp_ns - self._end_ns < self._duration_ns:
            return False
        self._end_ns = stamp_ns
        return True

    def take(self, sample: ContactSample) -> bool:
        """Add a sample; return whether the block is complete."""
        if self._count == 0:
            self._start_ns, self._start_compression = sample.stamp_ns, sample.compression
            self._first_step = sample.step
        self._has_free |= sample.is_free
        self._count += 1
        self._compression += sample.compression
        self._stress += sample.stress
        self._force += sample.force
        return (
            sample.stamp_ns - self._end_ns >= self._duration_ns
            or abs(sample.compression - self._start_compression) > self._most_compression
        )

    def close(self, stamp_ns: int) -> Means:
        """Return the means of the block, which ends at `stamp_ns`, and begin the next."""
        count = self._count
        self.number += 1
        means = Means(
            start_ns=self._start_ns,
            end_ns=stamp_ns,
            size=count,
            duration=(stamp_ns - self._start_ns) / NANOSECONDS + self._first_step,
            compression=self._compression / count,
            stress=self._stress / count,
            force=self._force / count,
            has_free=self._has_free,
        )
        self.restart(stamp_ns)
        return means


class PhaseMeter:
    """What the probe does, from the compression of the last 10 blocks."""

    def __init__(self) -> None:
        self._recent: deque[tuple[int, float]] = deque(maxlen=10)

    def add(self, stamp_ns: int, compression: float) -> Phase:
        """Add the mean compression of a block that ended at `stamp_ns`; return the phase."""
        recent = self._recent
        recent.append((stamp_ns, compression))
        elapsed_ns = stamp_ns - recent[0][0]
        if elapsed_ns == 0:
            return Phase.LOADING
        rate = (compression - recent[0][1]) * NANOSECONDS / elapsed_ns
        if abs(rate) < _HOLDING_RATE:
            return Phase.HOLDING
        return Phase.LOADING if rate > 0.0 else Phase.UNLOADING
