# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How far the tissue's surface has shifted since the first contact, from contact to contact."""

from __future__ import annotations

import math

from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.posterior import StressPosterior

_SHIFT = StateIndex.SHIFT

#: Time for which the surface goes on moving away from where it was [s]: one breath.
_LONGEST_SHIFT = 4.0


class SurfaceShift:
    """Begins each contact where the surface was in the last one.

    So the shift that is left to the state is small, and its column linear.

    Parameters
    ----------
    way : float
        The surface's way in a second, as compression [1]: the unit of the state's shift.

    Attributes
    ----------
    shifted : float
        How far the surface had shifted when this contact began, as compression [1].
    """

    def __init__(self, way: float) -> None:
        self.way = way
        self.shifted = 0.0
        self._elapsed = 0.0  # since the last contact began [s]

    def wait(self, duration: float) -> None:
        """Let time pass [s]."""
        self._elapsed += duration

    def begin_contact(self, posterior: StressPosterior) -> float:
        """Take up what the last contact has found; return the deviation of what came since [1].

        In the surface's ways in a second.
        """
        if self.way == 0.0:
            return 0.0
        self.shifted += self.way * float(posterior.state[_SHIFT])
        elapsed, self._elapsed = self._elapsed, 0.0
        known = float(posterior.covariance[_SHIFT, _SHIFT])
        return math.sqrt(min(elapsed, _LONGEST_SHIFT) + known)
