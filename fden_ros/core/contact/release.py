# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""When the probe leaves: by the force that detected the contact, or by its displacement."""

from __future__ import annotations

import math
from collections import deque

from fden_ros.core.contact.air import Chunk, Excess
from fden_ros.core.streams import Pair

#: The probe is no longer pressing below half the threshold.
_RELEASE_SHARE = 0.5
#: A contact ends when the mean is below that over as many chunks as told it, at least 2.
_RELEASE_CHUNKS = 2
#: The probe is off the tissue when it has retreated behind the surface by this share of its
#: deepest penetration.
_RETREAT = 0.2
#: It holds still within this share of that of its deepest place.
_HELD = 0.05


class ReleaseDetector:
    """Tells when a contact ends.

    Of the newest `samples`, those of chunks that count no more are dropped.
    """

    def __init__(self, samples: deque[Pair]) -> None:
        self._samples = samples
        self.threshold = 0.0  #: force of a sample that is not pressing [N]
        self.begin(0.0, 0.0, 0.0, Excess(0.0, 0.0, 1))

    def begin(self, bias: float, surface: float, clear: float, excess: Excess) -> None:
        """Begin a contact.

        `bias` is that of the force [N], `surface` where the probe touched [m], `clear` what a
        single chunk in contact exceeds [N]; `excess` is that by which the contact was detected.
        """
        self._bias, self._surface, self._deepest = bias, surface, surface
        self._clear = max(clear, excess.threshold)
        self.threshold = _RELEASE_SHARE * self._clear
        self._low = _RELEASE_SHARE * excess.threshold
        self._averaged = max(excess.scale, _RELEASE_CHUNKS)
        self._newest: deque[Chunk] = deque()
        self._behind_chunks = 0
        self._has_held = False
        #: The probe has left with a force that is drift of the sensor: there is no tissue.
        self.is_behind = False

    def add(self, chunk: Chunk, pair: Pair) -> int | None:
        """Take a chunk and its last pair; return since when the probe has left [ns], or None."""
        self._deepest = max(self._deepest, pair.displacement)
        if chunk.mean - self._bias > self._clear:
            # However faintly it began, single chunks have told it now.
            self._averaged, self._low = _RELEASE_CHUNKS, self.threshold
        level = self._bias + self._low
        is_low = chunk.mean < level
        retreat = self._surface - pair.displacement
        is_behind = retreat > _RETREAT * (self._deepest - self._surface)
        self._behind_chunks += is_behind
        # The chunk in which the probe leaves may still be full of contact.
        if is_behind and (is_low or self._behind_chunks > 1):
            self.is_behind = not is_low
            return chunk.start_ns
        newest = self._newest
        newest.append(chunk)
        while len(newest) > self._averaged:
            newest.popleft()
        while self._samples[0].stamp_ns < newest[0].start_ns:
            self._samples.popleft()
        mean = math.fsum(one.size * one.mean for one in newest) / sum(one.size for one in newest)
        if len(newest) < self._averaged or mean >= level or self._is_held(pair):
            return None
        return newest[0].start_ns

    def _is_held(self, pair: Pair) -> bool:
        """Whether it is the tissue's relaxation that lowers the force, and no release.

        Under a probe that holds still at its deepest it is, in the newer half of what is averaged;
        from then on until the probe moves back.
        """
        least = self._deepest - _HELD * (self._deepest - self._surface)
        if pair.displacement <= least:
            self._has_held = False
            return False
        self._has_held |= self._samples[len(self._samples) // 2].displacement > least
        return self._has_held

    def leave(self) -> None:
        """End the contact: what is air at its end is air before the next one."""
        pressed = (
            k for k, p in enumerate(self._samples) if p.force >= self._bias + self.threshold
        )
        last = max(pressed, default=-1)
        for _ in range(last + 1):
            self._samples.popleft()
