# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""When the posterior of a press is solved anew, and with how much care."""

from __future__ import annotations

from fden_ros.core.estimation.hypothesis import Hypothesis
from fden_ros.core.estimation.search import Care

#: It is solved anew when the time since the touch, or the largest compression, has grown by these
#: factors [1], some 20 times a contact; between two the filter is off by half a deviation.
_TIME_RATIO, _DEPTH_RATIO = 1.35, 1.18
#: It is asked whether another law is likelier where the press is longer than at the last time by
#: this factor [1].
_ASKED_RATIO = 1.5
#: Blocks before the first solution [1]; it is sought from all starts each time that their number
#: has doubled.
LEAST_BLOCKS = 4


class Schedule:
    """Of one press, whose blocks it counts.

    Attributes
    ----------
    blocks : int
        So far.
    is_over : bool
        The press is.
    has_slowed : bool
        The motion had when a solution was begun.
    """

    def __init__(self) -> None:
        self.blocks, self.is_over = 0, False
        self._blocks_at_starts = 0
        self._elapsed = self._compression = self._asked_at = self._asking_at = 0.0
        self._solved_compression = 0.0
        self.has_slowed = False

    @property
    def can_begin(self) -> bool:
        """Whether there are blocks enough for a solution."""
        return self.blocks >= LEAST_BLOCKS

    def is_due(self, elapsed: float, compression: float, best: Hypothesis) -> bool:
        """Whether a solution is due, after a time [s] and with a largest compression [1]."""
        return self.can_begin and (
            elapsed > _TIME_RATIO * self._elapsed
            or compression > _DEPTH_RATIO * self._compression > 0.0
            or (best.filter is not None and best.filter.has_moved)
        )

    def is_deeper(self, compression: float) -> bool:
        """Whether one is due for the depth that was reached since the last [1]."""
        return compression > _DEPTH_RATIO * self._solved_compression

    def ask(self) -> None:
        """Let one be due: the filter is too far from the last."""
        self._elapsed, self._compression = 0.0, 1e-9

    def ended(self, elapsed: float, compression: float) -> None:
        """Take note of a solution."""
        self._elapsed, self._compression = elapsed, compression
        self._solved_compression = compression
        self._asked_at = self._asking_at

    def care(self, least: Care, elapsed: float, best: Hypothesis, *, has_slowed: bool) -> Care:
        """Return the care of a solution that begins now; `has_slowed`: the motion of its record.

        Whether another law is likelier is asked once the motion has slowed, or the press is over,
        and again where the press is longer by a half; on a ramp, only whether the relaxation is
        over at once.
        """
        self.has_slowed |= has_slowed
        care = least
        if self.is_over or 2 * self._blocks_at_starts <= self.blocks or best.solved is None:
            care = max(care, Care.FROM_STARTS)
        can_tell = best.solved is not None and best.setting.can_tell_mismatch
        shows_relaxation = has_slowed or self.is_over
        if can_tell and not shows_relaxation and care is Care.FROM_STARTS:
            care = Care.ASKED_AT_ONCE
        elif can_tell and shows_relaxation and elapsed >= _ASKED_RATIO * self._asked_at:
            care = Care.ASKED
        # What has not ended by the end of the press is asked anew.
        self._asking_at = elapsed if care is Care.ASKED else self._asked_at
        if care >= Care.FROM_STARTS:
            self._blocks_at_starts = self.blocks
        return care
