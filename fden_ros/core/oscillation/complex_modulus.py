# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The complex modulus from a small oscillation on top of whatever else the probe does.

Over a window of whole periods of the slowest frequency, strain and stress are each fitted, by
least squares, with

.. math:: c_0 + c_1 \tau + c_2 \tau^2
          + \sum_j \left(a_j \cos\omega_j t + b_j \sin\omega_j t\right), \quad
          \tau \in [-1, 1] ,

where the polynomial takes up mean, relaxation and slow motion. With the phasors
:math:`X = a_x - i b_x` and F alike, :math:`G^*(\omega) = F/X`, and in the linear range
:math:`\alpha = \tfrac{2}{\pi}\arg G^*` and :math:`G = |G^*|/\omega^\alpha` (paper, eqs. defMI to
Gpp2). With several frequencies the slope of :math:`\ln|G^*|` over :math:`\ln\omega` is alpha a
second time. Beyond 1/Gn this G is the tangent :math:`\varphi'(x_0)`.

Only sums over the window are kept: a sample costs constant time and memory. The deviations assume
white residuals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

#: Coefficients of the trend: a parabola absorbs the relaxation of a hold over a window.
_TREND = 3
#: Least amplitude of strain [1] that counts as a dither.
LEAST_AMPLITUDE = 1e-4
#: Least samples in a period: with fewer the phasor is arbitrary.
_SAMPLES_PER_PERIOD = 8


class ComplexModulus(NamedTuple):
    """The complex modulus at one frequency, from one window."""

    start: float  #: first time of the window [s]
    samples: int
    angular_frequency: float  #: omega [rad/s]
    mean_strain: float  #: [1]
    strain_amplitude: float  #: of the dither [1]
    storage: float  #: G' [Pa]
    loss: float  #: G'' [Pa]
    sd: float  #: standard deviation of G' and of G'' each [Pa]
    distortion: float  #: RMS of the stress's residual over the RMS of the sines [1]
    slope: float | None = None  #: of ln|G*| over ln omega in this window [1]; None: one frequency
    slope_sd: float | None = None  #: its standard deviation [1]

    @property
    def fractional_order(self) -> float:
        """Alpha by the phase [1]."""
        return 2.0 / math.pi * math.atan2(self.loss, self.storage)

    @property
    def fractional_order_sd(self) -> float:
        """Standard deviation of alpha by the phase."""
        return 2.0 / math.pi * self.sd / math.hypot(self.storage, self.loss)

    @property
    def stiffness(self) -> float:
        """G by the magnitude [Pa s^alpha]: that of the tangent at the mean strain."""
        magnitude = math.hypot(self.storage, self.loss)
        return float(magnitude / self.angular_frequency**self.fractional_order)


class ComplexModulusMeter:
    """Measures the complex modulus window after window.

    `frequencies` of the dither [Hz] are positive, and each stands once; a window has `periods` of
    the lowest. Less than `least_amplitude` of strain [1] is no dither.
    """

    def __init__(
        self,
        frequencies: Sequence[float],
        periods: int,
        least_amplitude: float = LEAST_AMPLITUDE,
    ) -> None:
        self.window = periods / min(frequencies)  #: its length [s]
        self._angular_frequencies = 2.0 * math.pi * np.array(sorted(frequencies))
        self._least_samples = _SAMPLES_PER_PERIOD * self.window * max(frequencies)
        self._least_amplitude = least_amplitude
        self._size = _TREND + 2 * len(frequencies)
        self._start = self._stop = 0.0
        self.reset()

    def reset(self) -> None:
        """Forget the window: the contact ended, or samples are missing."""
        #: Products of the coefficients' functions and the two signals, summed over the samples.
        self._sums = np.zeros((self._size + 2, self._size + 2))
        self.samples = 0  #: of the window

    def add(self, time: float, strain: float, stress: float) -> list[ComplexModulus]:
        """Add a sample; return one result per frequency if it ends a window, or none.

        `time` [s] increases; `strain` [1], `stress` [Pa].
        """
        # Half a step of slack: the sample that rounds to the window's end begins the next one.
        ended = self.samples > 1 and time - self._start >= self.window - 0.5 * (time - self._stop)
        results = self._solve() if ended else []
        if ended:
            self.reset()
        if self.samples == 0:
            self._start, self._offset = time, (strain, stress)
        self._stop = time
        since = time - self._start
        place = 2.0 * since / self.window - 1.0
        angles = self._angular_frequencies * since
        waves = np.stack([np.cos(angles), np.sin(angles)], axis=1).ravel()
        # About the first sample, so that a large mean costs no digits.
        signals = strain - self._offset[0], stress - self._offset[1]
        row = np.array([1.0, place, place * place, *waves, *signals])
        self._sums += np.outer(row, row)
        self.samples += 1
        return results

    def _solve(self) -> list[ComplexModulus]:
        if self.samples < self._least_samples:
            return []
        size = self._size
        normal, moments = self._sums[:size, :size], self._sums[:size, size:]
        try:
            inverse = np.linalg.inv(normal)
        except np.linalg.LinAlgError:
            return []
        solution = np.linalg.solve(normal, moments)
        powers = self._sums.diagonal()[size:]
        left = np.maximum(powers - np.sum(solution * moments, axis=0), 0.0)
        variances = left / (self.samples - size)
        sines = solution[_TREND:, 1]
        pairs = solution[_TREND::2] - 1j * solution[_TREND + 1 :: 2]
        results = []
        for index, omega in enumerate(self._angular_frequencies):
            place = _TREND + 2 * index
            strain, stress = (complex(phasor) for phasor in pairs[index])
            if abs(strain) < self._least_amplitude:
                continue
            modulus = stress / strain
            spread = 0.5 * (inverse[place, place] + inverse[place + 1, place + 1])
            noise = variances[1] + abs(modulus) ** 2 * variances[0]
            results.append(
                ComplexModulus(
                    self._start,
                    self.samples,
                    float(omega),
                    # The mean of the quadratic trend over the window.
                    float(self._offset[0] + solution[0, 0] + solution[2, 0] / 3.0),
                    abs(strain),
                    modulus.real,
                    modulus.imag,
                    math.sqrt(spread * noise) / abs(strain),
                    math.sqrt(left[1] / self.samples / max(0.5 * float(sines @ sines), 1e-300)),
                )
            )
        return _with_slope(results)


def _with_slope(results: list[ComplexModulus]) -> list[ComplexModulus]:
    """Return the moduli of one window with the slope through them."""
    if len(results) < 2:
        return results
    place = np.log([one.angular_frequency for one in results])
    magnitude = np.hypot([one.storage for one in results], [one.loss for one in results])
    known = magnitude / np.maximum([one.sd for one in results], 1e-12 * magnitude)
    line, covariance = np.polyfit(place, np.log(magnitude), 1, w=known, cov="unscaled")
    slope, slope_sd = float(line[0]), math.sqrt(covariance[0, 0])
    return [one._replace(slope=slope, slope_sd=slope_sd) for one in results]
