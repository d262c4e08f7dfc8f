# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How the probe came to the tissue, before the first block of a record."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import LINE_TOLERANCE, SAME_TIME, TOUCH_TIME, Cell


class ApproachMotion:
    """The motion before the first block.

    Parameters
    ----------
    reach : float
        How far before its nominal place the touch may be, as compression [1]; 0: it is known.
    is_at_rest : bool
        That place is where the compression is 0; else the tissue may be met first where the
        record begins.
    """

    def __init__(self, reach: float, *, is_at_rest: bool) -> None:
        self._reach, self._is_at_rest = reach, is_at_rest
        self._way: list[Cell] = []

    def see_way(self, way: Array, tolerance: float) -> None:
        """Take the way before the first sample, as far as the touch may be before that.

        Parameters
        ----------
        way : ndarray, shape (3, n)
            Times [s], compressions [1] and stresses [Pa].
        tolerance : float
            Of the compression [1].
        """
        if not way.size:
            return
        compressions = way[1]
        nominal = 0.0 if self._is_at_rest else compressions[-1]
        behind = np.flatnonzero(compressions < nominal - self._reach + tolerance)
        first = int(behind[-1]) if behind.size else int(np.argmin(compressions))
        times, compressions, _ = own = way[:, first:]
        # At most 12 parts as long as each other, in time and in the way forward together.
        forward = np.maximum.accumulate(compressions)
        gone = (times - times[0]) / max(np.ptp(times), SAME_TIME)
        gone += (forward - forward[0]) / max(np.ptp(forward), LINE_TOLERANCE)
        places = np.searchsorted(gone, np.linspace(0.0, gone[-1], 13)[1:-1])
        for part in np.split(own, np.unique(places), axis=1):
            if part.size:
                cell = Cell(float(part[0, 0]), True)
                for sample in part.T.tolist():
                    cell.add(*sample)
                self._way.append(cell)

    def cells(self, cells: Sequence[Cell]) -> list[Cell]:
        """Return the motion before the first block where the touch may have been before that one.

        The probe comes as it goes on, along the line of the blocks near the touch; where that is
        longer than these, as it was seen to come.
        """
        if not self._reach and not self._is_at_rest:
            return []
        near = [c for k, c in enumerate(cells) if k < 3 or c.start - cells[0].start < TOUCH_TIME]
        if len(near) < 2:
            return []
        lines = np.array([cell.line()[::2] for cell in near])
        times, compressions = lines[:, 0] - lines[0, 0], lines[:, 1]
        speed, first = np.polyfit(times, compressions, 1).tolist()
        # Tissue that has not recovered from an earlier press is met where the record begins.
        gone = first if self._is_at_rest else min(first, 0.0)
        # A probe is taken to have come along its line for at most 1 s.
        missing = min(gone + self._reach, 1.0 * speed)
        if missing <= 0.0:
            return []
        if self._way and missing > TOUCH_TIME * speed:
            return self._way
        before = Cell(float(lines[0, 0]) - missing / speed, False)
        before.add(before.start, first - missing, 0.0)
        return [before]
