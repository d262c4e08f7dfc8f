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
#: A filter is compared with white noise and a line, as of hum, by at least this number of samples,
#: at this number of frequencies at most, and found from this log likelihood ratio on: without a
#: filter 5,700 draws reached 5.2. The window smears a line over this many frequencies on either
#: side. What is this many times the power of the filtered noise is a line, and left out.
_LEAST_COUNT, _FREQUENCIES, _LIKELIER, _SMEARED, _LINE = 64, 400, 6.0, 2, 10.0
#: Hann's window correlates neighbouring frequencies: this share of them is independent. The time
#: of the filter is below that returned with this probability.
_INDEPENDENT, _SURE = 0.5, 0.84
#: Frequencies that count, as a part of the rate.
_HIGHEST = 0.35
#: Variances of white noise behind the filter, in that of the filtered noise.
_SHARES: Array = np.array([0.0, 0.003, 0.01, 0.03, 0.1, 0.3])


def filter_time(times: Array, forces: Array, step: float) -> float:
    """Return what a filter's time constant is at most by the noise in the air [s]; 0: no filter.

    Noise is white at its source. Behind a filter of first or second order its spectrum falls
    beyond the filter's frequency, as Whittle's likelihood shows; the filter delays the force by
    this time as well. The shorter the air, the longer it may be.

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
    # The lowest are those of a drift; the spectrum of a digital filter may vanish at the highest.
    own = slice(2, 2 + min(_FREQUENCIES, round(_HIGHEST * count)))
    power = np.abs(np.fft.rfft(np.hanning(count) * forces)[own]) ** 2
    sines = np.sin(math.pi * period * np.fft.rfftfreq(count, period)[own])
    constants = np.geomspace(0.5 * period, 0.5 * count * period, 24)
    squares = (2.0 / period * constants[:, None, None] * sines) ** 2
    # Of the filtered noise, in that before: by half the first order's noise bandwidth.
    shares = _SHARES[:, None] * (0.5 * period / constants[:, None, None])
    first, second = 1.0 / (1.0 + squares), 1.0 / (1.0 + squares**2)
    spectra = np.concatenate([first + shares, second + math.sqrt(0.5) * shares])
    constants = np.concatenate([constants, math.sqrt(2.0) * constants])
    places = np.arange(float(power.size))
    while places.size > 4 * _SMEARED:
        count, level = places.size, (power / spectra).mean(axis=2)
        misfit = np.log(spectra).mean(axis=2) + np.log(level)
        likelier = _INDEPENDENT * (_misfit_of_line(power, places) - count * misfit)
        best = np.unravel_index(int(np.argmax(likelier)), likelier.shape)
        ratio = power / spectra[best]
        if likelier[best] < _LIKELIER:
            return 0.0
        if ratio.max() <= _LINE * level[best]:
            break
        kept = np.abs(places - places[np.argmax(ratio)]) > _SMEARED
        places, power, spectra = places[kept], power[kept], spectra[..., kept]
    else:
        return 0.0
    order = np.argsort(constants)
    weights = np.exp(likelier - likelier[best]).sum(axis=1)[order]
    sure = np.searchsorted(np.cumsum(weights), _SURE * weights.sum())
    return float(constants[order][sure])


def _misfit_of_line(power: Array, places: Array) -> float:
    """Return the negative log likelihood of white noise, and a line where it is strongest."""
    line = np.abs(places - places[np.argmax(power)]) <= _SMEARED
    return sum(own.size * math.log(float(own.mean())) for own in (power[line], power[~line]))
