# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Steps in which a signal comes: its quantisation."""

from __future__ import annotations

#: A change is a whole number of steps when it is within this share of a step of it [1].
_TOLERANCE = 0.01
#: Smaller changes, relative to the value or to the largest change, are rounding [1].
_ROUNDING = 1e-9
#: A signal that changes by the same amount in 4 samples in a row is a ramp without noise.
_RAMP = 4


class Resolution:
    """The step of a signal whose changes are all whole numbers of it."""

    def __init__(self) -> None:
        self._step = 0.0
        self._last: float | None = None
        self._last_change = 0.0
        self._alike = 0  # changes in a row that are the same
        self._is_continuous = False

    @property
    def step(self) -> float:
        """The step; 0: the signal is continuous, or not known."""
        return self._step if self._alike < _RAMP else 0.0

    def add(self, value: float) -> None:
        """Take a value."""
        if self._is_continuous:
            return
        last, self._last = self._last, value
        if last is None:
            return
        change = value - last
        if abs(change) <= _ROUNDING * max(abs(value), abs(last)):
            self._alike = 0
            return
        is_like = abs(change - self._last_change) < _TOLERANCE * abs(change)
        self._alike = self._alike + 1 if is_like else 1
        self._last_change = change
        size, step = abs(change), self._step or abs(change)
        self._step = min(size, step)
        ratio = max(size, step) / self._step
        if ratio > 1.0 / _ROUNDING or abs(ratio - round(ratio)) > _TOLERANCE:
            self._step, self._is_continuous = 0.0, True
