# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Errors of the motion as noise of the stress: white noise, and corners cut short."""

from __future__ import annotations

import math

#: Error of the strain at a corner of the motion, as a share of the bend [1]: a quarter where the
#: corner is in the middle of a step, 0.17 in the mean over its place in the step.
#: It is not idle: at half of it, presses of beef sampled at 10 Hz move by one to ten deviations.
_CORNER_SHARE = 0.15
#: Error of the stress one step after a corner, over that at the corner and over alpha [1]; then it
#: falls in proportion to time. From the kernel's t^-alpha; a factor of 2 is of no matter.
_CORNER_MEMORY = 2.0
#: Bends below this many standard deviations of the noise [1] are taken for noise: of 1,000
#: samples that do not bend, three would do so by chance. A factor of 2 is of no matter.
_NOISE_BENDS = 3.0


class MotionNoise:
    """Variance of a block's mean stress that comes from its motion.

    Parameters
    ----------
    white : float
        Variance of the compression's noise per sample times the time between samples [s].
    """

    def __init__(self, white: float) -> None:
        self._white = white
        # How sharply the motion bends [1], for which two rates must be known.
        self._bend = self._first_bend = 0.0
        self._is_first = True
        self._last_rate = self._last_compression = math.nan
        self._remembered, self._age = 0.0, 0.0

    def press(self, step: float, compression: float) -> None:
        """Take the motion of a sample in contact."""
        if step > 0.0:
            rate = (compression - self._last_compression) / step
            if not math.isnan(self._last_rate):
                noise = _NOISE_BENDS * math.sqrt(6.0 * self._white / step)
                bend = max(abs(rate - self._last_rate) * step - noise, 0.0)
                self._bend = max(self._bend, bend)
                if self._is_first:
                    self._first_bend = bend
            self._last_rate = rate
        self._is_first = False
        self._last_compression = compression

    def interrupt(self) -> None:
        """Let the next sample begin a new motion."""
        self._last_rate = self._last_compression = math.nan
        self._remembered = 0.0

    def skip_block(self) -> None:
        """Let a block go by."""
        self._bend = self._first_bend = 0.0
        self._is_first = True

    def take_block(
        self, duration: float, size: int, slope: float, fractional_order: float
    ) -> tuple[float, float]:
        """Return the variance for the block that ends now, and a further one for that before.

        A corner between two blocks spoils the last sample of the first, if force and displacement
        are not sampled together.

        Parameters
        ----------
        duration : float
            [s].
        size : int
            Samples in the block.
        slope : float
            Of the elastic response by the compression [Pa].
        fractional_order : float
            alpha [1].

        Returns
        -------
        tuple of float
            [Pa^2]; the second for a block of one sample.
        """
        bend, first_bend = self._bend, self._first_bend
        self.skip_block()
        if not duration:
            return 0.0, 0.0
        step = duration / size
        self._age += duration
        white = self._white * duration ** (-1.0 - 2.0 * fractional_order) * slope**2
        by_bend = _CORNER_SHARE * abs(slope) * step**-fractional_order
        remembered = _CORNER_MEMORY * fractional_order * self._remembered / self._age
        corner = by_bend * bend
        if corner >= remembered:
            self._remembered, self._age = corner * step, step
        return white + max(corner / size, remembered) ** 2, (by_bend * first_bend) ** 2
