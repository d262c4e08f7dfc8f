# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The time of a filter of the force, which its noise in the air shows."""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.arrays import Array

#: The estimator knows a filter of the force as a delay. Behind one of a longer time [s] N/m was
#: up to 6 deviations off, whatever delay was stated.
LONGEST_FILTER = 0.05
#: A filter is compared with white noise by at least this number of samples, at this number of
#: frequencies at most, and found from this log likelihood ratio on, which white noise does not
#: reach. A power above this many times that of the filter is a vibration; a time above
#: this share of the record is that of a drift.
_LEAST_COUNT, _FREQUENCIES, _LIKELIER, _LINE, _LONGEST = 64, 400, 10.0, 10.0, 1.0 / 6.0
#: Variances of white noise behind the filter, in that of the filtered noise.
_SHARES: Array = np.array([0.0, 0.003, 0.01, 0.03, 0.1, 0.3])


def filter_time(times: Array, forces: Array, step: float) -> float:
    """Return the time constant of a filter that the noise in the air shows [s]; 0: none.

    Noise is white at its source. Behind a filter of first or second order its spectrum falls
    beyond the filter's frequency, as Whittle's likelihood shows; the filter delays the force by
    this time as well.

    Parameters
    ----------
    times, forces : ndarray, shape (n,)
        Without contact [s], [N].
    step : float
        The force's resolution [N]: rounding hides smaller noise.
    """
    count = times.size
    if count < _LEAST_COUNT:
        return 0.0
    period = float(times[-1] - times[0]) / (count - 1)
    forces = forces - np.polyval(np.polyfit(times - times[0], forces, 1), times - times[0])
    if float(np.var(forces)) <= step**2:
        return 0.0
    # The lowest are those of a drift.
    own = slice(2, 2 + _FREQUENCIES)
    power = np.abs(np.fft.rfft(forces)[own]) ** 2
    sines = np.sin(math.pi * period * np.fft.rfftfreq(count, period)[own])
    constants = np.geomspace(0.5 * period, 0.5 * count * period, 24)
    squares = (2.0 / period * constants[:, None, None] * sines) ** 2
    # Of the filtered noise, in that before: by half the first order's noise bandwidth.
    shares = _SHARES[:, None] * (0.5 * period / constants[:, None, None])
    first, second = 1.0 / (1.0 + squares), 1.0 / (1.0 + squares**2)
    spectra = np.concatenate([first + shares, second + math.sqrt(0.5) * shares])
    level = (power / spectra).mean(axis=2)
    misfit = np.log(spectra).mean(axis=2) + np.log(level)
    constants = np.concatenate([constants, math.sqrt(2.0) * constants])
    likelier = sines.size * (math.log(float(power.mean())) - misfit)
    best = np.unravel_index(int(np.argmax(likelier)), likelier.shape)
    if likelier[best] < _LIKELIER or (power / spectra[best]).max() > _LINE * level[best]:
        return 0.0
    weights = np.exp(likelier - likelier[best]).sum(axis=1)
    found = math.exp(float(weights @ np.log(constants) / weights.sum()))
    return found if found <= _LONGEST * count * period else 0.0
