# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the unknowns of a press make of the motion and of the stress that were measured."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.record import Points
from fden_ros.core.estimation.unknowns import Unknown


class Design(NamedTuple):
    """What one standard deviation of each unknown changes of a record."""

    motions: Array  #: compressions at the points, (unknowns, points)
    stresses: Array  #: stress of the blocks, (unknowns, m)


class PressMotion:
    """The motion of one press.

    Parameters
    ----------
    unknowns : tuple of Unknown
        The first of a state.
    """

    def __init__(self, unknowns: tuple[Unknown, ...]) -> None:
        self._unknowns = unknowns
        late = [k for k, u in enumerate(unknowns) if u.touch_speed is not None]
        self._late = late[0] if late else None  # the delay that shifts the motion
        self._moved: tuple[Points, float, Points] | None = None
        self._design: tuple[Points, Design] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return it without what the last record has decided: that is found anew."""
        return self.__dict__ | {"_moved": None, "_design": None}

    def moved(self, points: Points, state: Array) -> Points:
        """Return a record with its motion as early as a long delay says; that of the last is kept.

        What follows from the record at a state takes this one.
        """
        if self._late is None:
            return points
        unknown = self._unknowns[self._late]
        assert unknown.touch_speed is not None
        delay = unknown.sd * float(state[self._late])
        if self._moved is None or self._moved[0] is not points or self._moved[1] != delay:
            self._moved = points, delay, points.earlier(delay, unknown.touch_speed)
        return self._moved[2]

    def design(self, points: Points) -> Design:
        """Return the design of a record; that of the last one is kept."""
        if self._design is None or self._design[0] is not points:
            motions = np.zeros((len(self._unknowns), points.times.size))
            stresses = np.zeros((len(self._unknowns), points.stresses.size))
            for k, unknown in enumerate(self._unknowns):
                if unknown.motion is not None:
                    motions[k] = unknown.motion(points)
                if unknown.stress is not None:
                    stresses[k] = unknown.stress(points)
            self._design = points, Design(motions, stresses)
        return self._design[1]

    def compressions(self, points: Points, state: Array) -> Array:
        """Return the compressions from the origin at the points of a record that is moved."""
        own = self._of_unknowns(state)
        if self._late is not None:
            own = own.copy()
            own[self._late] = 0.0  # it has moved the record
        result: Array = points.compressions + own @ self.design(points).motions
        return result

    def ends(self, points: Points, state: Array) -> tuple[Array, Array]:
        """Return the compressions from the origin at the ends of blocks [1], (m,).

        And their derivatives by the state, (m, size of it).
        """
        points = self.moved(points, state)
        last = points.last
        by_state = np.zeros((last.size, state.size))
        by_state[:, : len(self._unknowns)] = self.design(points).motions[:, last].T
        return self.compressions(points, state)[last], by_state

    def added_stress(self, points: Points, state: Array) -> Array:
        """Return what the unknowns add to the stress of the blocks [Pa], (m,)."""
        result: Array = self._of_unknowns(state) @ self.design(points).stresses
        return result

    def _of_unknowns(self, state: Array) -> Array:
        """Return the state without the law's errors."""
        return state[: len(self._unknowns)]
