r"""Whether the innovations are what model and noise explain.

Normalised innovations of a right model are white with variance 1. So the mean of :math:`2^j` of
them, times :math:`2^{j/2}`, has variance 1 at every scale j. A wrong model leaves slow deviations
behind, which stand out at the long scales; noise that was underestimated stands out at the
shortest.
"""

from __future__ import annotations

import math

_SCALES = 14
#: Of a normal distribution, one-sided: 3e-7 for each test of a scale.
_MISMATCH_DEVIATIONS = 5.0
#: A single window so far from zero is a change: 2e-9 where the model is right.
CHANGE_DEVIATIONS = 6.0
#: Scales of the windows, 4 to 64 innovations, in which a change is looked for.
_CHANGE_SCALES = range(2, 7)
LONGEST_CHANGE_WINDOW = 1 << _CHANGE_SCALES[-1]
#: The inflation is read off scales with so many windows.
_ENOUGH_WINDOWS = 4


class InnovationMonitor:
    """Test normalised innovations at scales of 1 to 8192 of them, in constant memory."""

    def __init__(self) -> None:
        #: how many innovations have come since they are larger or slower than the model explains
        self.mismatch_count = 0
        #: how many of the newest innovations stand out, while all before them did not; or 0
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
        """By how much the variance of the estimate is too small, at least 1."""
        if not self.mismatch_count:
            return 1.0
        means = (
            total / count
            for total, count in zip(self._square_sums, self._windows, strict=True)
            if count >= _ENOUGH_WINDOWS
        )
        return max(1.0, *means) if self._windows[0] >= _ENOUGH_WINDOWS else 1.0


def _chi_squared_limit(degrees: int) -> float:
    """Return what chi-squared exceeds by chance only (Wilson and Hilferty 1931)."""
    spread = 2.0 / (9.0 * degrees)
    return degrees * (1.0 - spread + _MISMATCH_DEVIATIONS * math.sqrt(spread)) ** 3
