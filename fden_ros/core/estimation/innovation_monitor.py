# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Whether the innovations are what model and noise explain.

Normalised innovations of a right model are white with variance 1. So the mean of :math:`2^j` of
them, times :math:`2^{j/2}`, has variance 1 at every scale j. A wrong model leaves slow deviations
behind, which stand out at the long scales; noise that was underestimated stands out at the
shortest.
"""

from __future__ import annotations

import math

#: Scales j [1]: windows of up to 8192 innovations, 80 s of blocks of 10 ms.
_SCALES = 14
#: Threshold of the test of a scale in standard deviations of a normal distribution [1], one-sided:
#: a probability of 3e-7 for each test, so that less than one contact of 1,000 blocks in a thousand
#: raises an alarm (test_core_innovation_monitor).
_MISMATCH_DEVIATIONS = 5.0
#: Deviation of the sum over one window from 0 beyond which it proves a change [1]: a probability
#: of 2e-9 where the model is right.
CHANGE_DEVIATIONS = 6.0
#: Scales j of the windows, 4 to 64 innovations, in which a change is looked for [1]: one
#: innovation alone may be an outlier, and a change that 64 do not show is a mismatch.
_CHANGE_SCALES = range(2, 7)
#: Innovations in the longest of these windows [1].
LONGEST_CHANGE_WINDOW = 1 << _CHANGE_SCALES[-1]
#: Windows that a scale must have before the inflation is read off it [1]: fewer leave a mean
#: square to chance.
_ENOUGH_WINDOWS = 4


class InnovationMonitor:
    """Test normalised innovations at scales of 1 to 8192 of them, in constant memory."""

    def __init__(self) -> None:
        #: Innovations since the first test that proved a mismatch, that one included; 0: none has.
        self.mismatch_count = 0
        #: Newest innovations whose sum is beyond :data:`CHANGE_DEVIATIONS` of what was usual
        #: before; 0: none are.
        self.change_window = 0
        self._first_half = [0.0] * _SCALES
        self._count = 0
        self._windows = [0] * _SCALES
        self._square_sums = [0.0] * _SCALES

    def add(self, normalized: float) -> None:
        """Take an innovation over its standard deviation."""
        usual = self._usual_variance()
        self._count += 1
        self.mismatch_count += self.mismatch_count > 0
        self.change_window = 0
        total = normalized
        for scale in range(_SCALES):
            square = total * total / (1 << scale)
            self._windows[scale] += 1
            self._square_sums[scale] += square
            if scale in _CHANGE_SCALES and square > CHANGE_DEVIATIONS**2 * usual:
                self.change_window = 1 << scale
            if self._square_sums[scale] > _chi_squared_limit(self._windows[scale]):
                self.mismatch_count = max(self.mismatch_count, 1)
            if self._count >> scale & 1:
                self._first_half[scale] = total
                return
            total += self._first_half[scale]

    def _usual_variance(self) -> float:
        return max(self._square_sums[0] / self._windows[0], 1.0) if self._windows[0] else 1.0

    @property
    def inflation(self) -> float:
        """Factor by which the variance of the estimate is too small, at least 1."""
        if not self.mismatch_count:
            return 1.0
        means = (
            total / count
            for total, count in zip(self._square_sums, self._windows, strict=True)
            if count >= _ENOUGH_WINDOWS
        )
        return max(1.0, *means) if self._windows[0] >= _ENOUGH_WINDOWS else 1.0


def _chi_squared_limit(degrees: int) -> float:
    """Return the value that chi-squared exceeds at _MISMATCH_DEVIATIONS only.

    (Wilson and Hilferty, Proc. Natl. Acad. Sci. 17 (1931) 684.)
    """
    spread = 2.0 / (9.0 * degrees)
    return degrees * (1.0 - spread + _MISMATCH_DEVIATIONS * math.sqrt(spread)) ** 3
