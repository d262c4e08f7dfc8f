# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""What the law has left out of the stress lately, and where that is going.

In a hold no motion hides it: :math:`v(t) = f(t) - M(t)`, with M the law's stress of the motion so
far at the parameters of today. Its slope over the newest part of the loading's age A,

.. math:: s = \frac{dv}{d\ln A},

is how fast the tissue relaxes beside the law. Where a relaxation begins or ends, as that of a
linear solid, the parameters follow slowly, and the slope shows it at once.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array

#: A hold lasts while the strain stays within this part of where it began [1].
_HOLD_PART = 0.02
#: Points are kept from this time in the hold on [s], as far apart as this part of it [1], and as
#: many of them at most.
_FIRST_POINT, _SPACING, _MOST_POINTS = 0.1, 0.04, 24
#: The slope is that of the newest part of ln A [1]; it takes so many points, and so much of it. On
#: 78 presses of beef what half of it leaves is 0.045 of the stress for each factor e of A (root
#: mean square); 0.053 by a part of 0.5, 0.058 by one of 0.7, and 0.055 where nothing goes on.
_SPAN, _LEAST_POINTS, _LEAST_PART = 0.4, 4, 0.5


class Point(NamedTuple):
    """The stress at one instant of a hold."""

    time: float  #: [s]
    stress: float  #: [Pa]


class Slope(NamedTuple):
    """How the slope s follows from what is left out at the newest points: s = weights @ v."""

    weights: Array  #: shape (n,)
    times: Array  #: of the points, before the present [s], shape (n,)
    points: list[Point]  #: n of them


class Hold:
    """The newest points of the present hold, in bounded memory.

    Attributes
    ----------
    time : float
        That it has lasted [s].
    """

    def __init__(self) -> None:
        self._points: deque[Point] = deque(maxlen=_MOST_POINTS)
        self.end()

    def end(self) -> None:
        """Let the next sample begin another hold."""
        self._points.clear()
        self._strain, self.time, self._next = math.nan, 0.0, _FIRST_POINT

    def copy(self) -> Hold:
        """Return the hold as it is now."""
        own = copy.copy(self)
        own._points = self._points.copy()
        return own

    def is_due(self, step: float, strain: float) -> bool:
        """Take `step` seconds to a strain [1]; return whether a point is to be kept there."""
        if not abs(strain - self._strain) <= _HOLD_PART * abs(self._strain):
            self.end()
            self._strain = strain
            return False
        self.time += step
        return self.time >= self._next

    def keep(self, time: float, stress: float) -> None:
        """Keep a point at the present [s]."""
        self._points.append(Point(time, stress))
        self._next = (1.0 + _SPACING) * self.time

    def slope(self, now: float, age: float) -> Slope | None:
        """Return how the slope follows where the loading's age is `age` [s]; None: not known."""
        points = [p for p in self._points if now - p.time < age]
        if age <= 0.0 or len(points) < _LEAST_POINTS:
            return None
        times = now - np.array([point.time for point in points])
        log_ages = np.log1p(-times / age)
        newest = log_ages >= -_SPAN
        log_ages, times = log_ages[newest], times[newest]
        if log_ages.size < _LEAST_POINTS or np.ptp(log_ages) < _LEAST_PART * _SPAN:
            return None
        off = log_ages - log_ages.mean()
        return Slope(off / (off @ off), times, points[-log_ages.size :])
