# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a force in the air may show beside a contact, chunk by chunk.

Each watch takes what a chunk shows, and returns whether that completes what it watches for.
"""

from __future__ import annotations

from collections.abc import Callable

from fden_ros.core.contact.air import Chunk
from fden_ros.core.streams import NANOSECONDS

#: After 10 chunks in a row below the bias by more than the threshold the bias is another.
_BELOW_CHUNKS = 10
#: A force that falls by 12 thresholds within a minute [ns] while the probe advances has the wrong
#: sign, however slowly it falls. (The baseline follows a slow one.)
_FALL_THRESHOLDS, _FALL_NS = 12.0, 60 * NANOSECONDS
#: A rise for 5 chunks that the floor of the noise hides may be a press.
_HIDDEN_CHUNKS = 5


class Below:
    """Watches for a force that stays below its bias."""

    def __init__(self) -> None:
        self._chunks = 0

    def add(self, *, is_below: bool) -> bool:
        """Take whether a chunk lies below the bias by more than the threshold."""
        self._chunks = self._chunks + 1 if is_below else 0
        if self._chunks < _BELOW_CHUNKS:
            return False
        self._chunks = 0
        return True


class Fall:
    """Watches for a force that falls as the probe advances."""

    def __init__(self) -> None:
        #: The highest mean force of a chunk [N], and where the probe was then [m].
        self._highest: tuple[Chunk, float] | None = None

    def add(self, chunk: Chunk, displacement: float, threshold: float) -> bool:
        """Take a chunk, the displacement at its end [m] and the threshold of a contact [N]."""
        if self._highest is not None:
            highest, place = self._highest
            is_old = chunk.end_ns - highest.end_ns > _FALL_NS
            if not is_old and chunk.mean <= highest.mean:
                has_fallen = highest.mean - chunk.mean > _FALL_THRESHOLDS * threshold
                is_found = has_fallen and displacement > place
                if is_found:
                    self._highest = None
                return is_found
        self._highest = chunk, displacement
        return False


class Hidden:
    """Watches for a touch that the floor of the noise hides.

    It is a rise above the air's own noise that looks like a touch; by when it is over, no contact
    has come of it.
    """

    def __init__(self) -> None:
        self._chunks, self._is_touch = 0, False

    def add(self, *, is_above: bool, is_touch: Callable[[], bool]) -> bool:
        """Take whether a chunk is above the air's own noise, and what tells it from a drift."""
        if not is_above:
            was_touch = self._is_touch
            self._chunks, self._is_touch = 0, False
            return was_touch
        self._chunks += 1
        if self._chunks == _HIDDEN_CHUNKS:
            self._is_touch = is_touch()
        return False
