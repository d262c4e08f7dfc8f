# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Where a probe in continuous contact is: a window of its palpation, and a place on its path."""

from __future__ import annotations

from fden_ros.core.oscillation.palpation import Palpated
from fden_ros.core.outputs import Flag
from fden_ros.core.streams.samples import Pair, Position


class Window:
    """The samples of one window of the palpation."""

    def __init__(self) -> None:
        self.samples = self.stop_ns = self.start_ns = 0
        self.max_force = 0.0
        self._sum = (0.0, 0.0, 0.0)
        self._located = 0

    def add(self, pair: Pair) -> None:
        """Take a sample."""
        self.start_ns = self.start_ns or pair.stamp_ns
        self.stop_ns = pair.stamp_ns
        self.samples += 1
        self.max_force = max(self.max_force, pair.force)
        if pair.position is not None:
            x, y, z = (a + b for a, b in zip(self._sum, pair.position, strict=True))
            self._sum = (x, y, z)
            self._located += 1

    @property
    def position(self) -> Position | None:
        """Mean position [m]; None where one is not known."""
        if not self._located or self._located < self.samples:
            return None
        x, y, z = (value / self._located for value in self._sum)
        return x, y, z


class Place:
    """What is gathered at one place of the path."""

    def __init__(self, number: int, start_ns: int, position: Position | None) -> None:
        self.number = number
        self.start_ns = self.end_ns = start_ns
        self.first = position
        self.samples = 0
        self.max_force = 0.0
        self.flags = Flag.ORIGIN_UNCERTAIN
        self.rejected = 0
        self.found: Palpated | None = None
        self._sum = (0.0, 0.0, 0.0)
        self._windows = 0

    def add(self, window: Window, found: Palpated | None) -> None:
        """Take a window of this place."""
        self.end_ns = window.stop_ns
        self.samples += window.samples
        self.max_force = max(self.max_force, window.max_force)
        self.found = found if found is not None else self.found
        self._windows += 1
        if window.position is not None:
            x, y, z = (a + b for a, b in zip(self._sum, window.position, strict=True))
            self._sum = (x, y, z)

    @property
    def position(self) -> Position | None:
        """Mean position of its windows [m]."""
        if self.first is None:
            return None
        x, y, z = (value / self._windows for value in self._sum)
        return x, y, z
