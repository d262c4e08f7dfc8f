# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether the tissue under the probe has changed within a press.

The filter that resolved and explained a block last predicts those that follow, without learning
from them: neither it nor a grid laid meanwhile explains a change away. What passes (a jerk of the
drive, a delay, a gap, a grid that was laid badly) returns to this prediction; a change does not.
"""

from __future__ import annotations

import copy
import math

from fden_ros.core.arrays import LIKELY
from fden_ros.core.estimation.cells import Press
from fden_ros.core.estimation.face import Innovation
from fden_ros.core.estimation.filter import Filter

#: A block is explained within as many standard deviations, a change begins beyond these [1], and
#: lasts beyond what is likely. Those of a grid that has not settled are too small: it begins at as
#: many times as much [1].
_DEVIATIONS, _UNSETTLED = 4.0, 2.0
#: A part of the largest stress that is smaller is an error of law or rig [1].
_PART = 0.04
#: The tissue has changed where as many blocks and for this time [s] all are off to one side.
_BLOCKS, _TIME = 3, 0.08


class ChangeGate:
    """Looks for a change in the blocks of one press.

    Attributes
    ----------
    is_changed : bool
        The tissue has changed.
    is_doubtful, is_beyond : bool
        The newest block is off its prediction; by more than errors of law or rig.
    """

    def __init__(self) -> None:
        self.is_changed = self.is_doubtful = self.is_beyond = False
        self._largest = self._explained = 0.0  #: stress, and that of the last such block [Pa]
        self._trusted: Filter | None = None  #: resolved and explained a block last
        self._since, self._count = 0.0, 0  #: the first block that is off [s], and how many are
        self._side = 0.0
        self._blind = 0  #: blocks since, of which none is off
        self._unseen = self._trusted_unseen = 0.0

    def see(self, filter_: Filter, tail: Press, found: Innovation, unseen: float) -> None:
        """Take a block and its innovation; the filter has learned from it.

        `unseen`: deviation of the stress, over that, for a relaxation that no block has shown [1].
        """
        self._unseen = unseen
        stress, now = found.predicted_stress + found.innovation, float(tail.middles[0])
        self._largest = max(self._largest, abs(stress))
        self.is_doubtful = found.normalized_squared > _DEVIATIONS**2
        if not (self._count or self.is_doubtful or filter_.is_coarse):
            self._trust(filter_, stress)
            return
        own = self._compared(tail, stress)
        if own is None:
            return
        self._count += 1
        beyond = abs(own.innovation) - _PART * self._largest
        self.is_doubtful, self.is_beyond = True, beyond > 0.0
        if self._count >= _BLOCKS and now - self._since >= _TIME:
            # An error of the curve grows with the depth: it is less than the stress has grown by.
            self.is_changed |= beyond > abs(own.predicted_stress - self._explained)
            self._trust(filter_, stress)

    def _compared(self, tail: Press, stress: float) -> Innovation | None:
        """Compare a block with the trusted filter; None: it is not off that."""
        if (trusted := self._trusted) is None or (own := trusted.compared(tail, stress)) is None:
            return None
        if not self._unseen:
            # The probe has slowed down since: relaxation is seen for the first time.
            more = (self._trusted_unseen * own.predicted_stress) ** 2
            own = own._replace(variance=own.variance + more)
        if self._count:
            if own.innovation * self._side > LIKELY * math.sqrt(own.variance):
                return own
            self._count, self.is_beyond = 0, False
            return None
        factor = 1.0 if trusted.grid.is_settled else _UNSETTLED
        if self.is_doubtful and own.normalized_squared > (_DEVIATIONS * factor) ** 2:
            self._since, self._side = float(tail.middles[0]), math.copysign(1.0, own.innovation)
            return own
        self._blind += 1
        if self._blind >= _BLOCKS:
            self._trusted = None
        return None

    def _trust(self, filter_: Filter, stress: float) -> None:
        self._trusted, self._explained = copy.copy(filter_), stress
        self._trusted_unseen = self._unseen
        self._count, self._blind, self.is_beyond = 0, 0, False

    def rest(self) -> None:
        """Suspect nothing: the probe retreats."""
        self._trusted, self._count = None, 0
        self.is_doubtful = self.is_beyond = False
