# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The noise of the measured motion, sample by sample: its distance from a straight line.

The law answers to the motion that was measured, the tissue to the true one. White noise of the
displacement so looks like tissue that does not answer to fast motion (errors in variables): alpha
comes out too low, by twenty of its deviations in a hold of 30 s on stiff tissue. The line is a
fading-memory filter of the first order, which begins anew where the motion leaves it.

References
----------
Morrison, Introduction to Sequential Smoothing and Prediction (1969), ch. 9 and 13: expanding and
fading memory.
"""

from __future__ import annotations

import math

from fden_ros.core.streams.samples import ReadingNoise

#: Memory of the line [s]: a fifth of a period of 1 Hz.
_MEMORY = 0.2
#: Distance from the line at which a new one begins: in standard deviations of the noise of the
#: distance [1]; and samples [1] that a line needs before it is held against a sample.
_MOST_DEVIATIONS, _LEAST_SAMPLES = 5.0, 3
#: The same distance where the noise is lost in the steps in which the motion comes, in steps [1]:
#: a reading and a line through readings are each half a step off at most, and a line that begins
#: is a little off. At 2, where the probe stops, the line goes on for so long that what is off it
#: is no noise any more, and alpha comes out too low in the hold; at 1 it begins anew by chance.
_MOST_STEPS = 1.3


class MotionJitter:
    """Follows the motion by a line.

    Parameters
    ----------
    noise : ReadingNoise
        Of the compression [1].
    """

    def __init__(self, noise: ReadingNoise) -> None:
        self._noise = noise
        self.interrupt()

    def interrupt(self) -> None:
        """Let the next sample begin a new line."""
        self._count = 0
        self._place = self._rate = 0.0

    def press(self, step: float, compression: float) -> float:
        """Take a sample `step` seconds after the last; return how far it is off the line [1]."""
        if step <= 0.0 or self._noise.white <= 0.0:
            self._begin(compression)
            return 0.0
        off = compression - (self._place + self._rate * step)
        is_known = self._count >= _LEAST_SAMPLES
        if is_known and abs(off) > self._farthest(step):
            self._begin(compression)
            return 0.0
        n, kept = self._count, math.exp(-step / _MEMORY)
        of_place = max(2.0 * (2.0 * n + 1.0) / ((n + 1.0) * (n + 2.0)), 1.0 - kept**2)
        of_rate = max(6.0 / ((n + 1.0) * (n + 2.0)), (1.0 - kept) ** 2)
        self._count += 1
        self._place = compression - (1.0 - min(of_place, 1.0)) * off
        self._rate += min(of_rate, 1.0) * off / step
        return compression - self._place if is_known else 0.0

    def _farthest(self, step: float) -> float:
        """Return how far noise is off the line at most, `step` seconds after the last sample."""
        if self._noise.step:
            return _MOST_STEPS * self._noise.step
        return _MOST_DEVIATIONS * math.sqrt(2.0 * self._noise.white / step)

    def _begin(self, compression: float) -> None:
        self._place, self._rate, self._count = compression, 0.0, 1
