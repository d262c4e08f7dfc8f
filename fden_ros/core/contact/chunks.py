# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The mean of the force over chunks of time: long enough to average, short enough to react."""

from __future__ import annotations

import math
from typing import NamedTuple

from fden_ros.core.streams.samples import Pair

#: Force is averaged in chunks of at least 20 ms [ns] and 3 samples.
CHUNK_NS = 20_000_000
_CHUNK_SAMPLES = 3


class Chunk(NamedTuple):
    """The force of consecutive samples."""

    size: int
    start_ns: int
    end_ns: int
    mean: float  #: [N]
    square_sum: float  #: of deviations from the mean [N^2]


class Chunks:
    """Collects samples until a chunk is full."""

    def __init__(self) -> None:
        self._forces: list[float] = []
        self._start_ns = 0

    def add(self, pair: Pair) -> Chunk | None:
        """Take a sample; return the chunk that ends with it."""
        forces = self._forces
        if not forces or pair.stamp_ns < self._start_ns:
            # A clock that jumped back leaves a chunk without an end.
            forces.clear()
            self._start_ns = pair.stamp_ns
        forces.append(pair.force)
        if len(forces) < _CHUNK_SAMPLES or pair.stamp_ns - self._start_ns < CHUNK_NS:
            return None
        mean = math.fsum(forces) / len(forces)
        square_sum = math.fsum((force - mean) ** 2 for force in forces)
        chunk = Chunk(len(forces), self._start_ns, pair.stamp_ns, mean, square_sum)
        forces.clear()
        return chunk
