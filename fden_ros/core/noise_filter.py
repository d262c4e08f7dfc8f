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
#: A filter is compared with white noise beside a sine, as of hum, and a drift, by at least this
#: number of samples, at this number of frequencies at most, and found from this log likelihood
#: ratio on. What is above this many times the power of the filtered noise is a line.
_LEAST_COUNT, _FREQUENCIES, _LIKELIER, _LINE = 64, 400, 6.0, 10.0
#: The time of the filter is below that returned with this probability.
_SURE = 0.84
#: A drift, a random walk, is above the white noise up to these parts of the frequencies.
_DRIFTS: Array = np.array([0.0, 0.01, 0.02, 0.04])
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
    power, rest = (np.abs(np.fft.rfft(one)[own]) ** 2 for one in (forces, _without_sine(forces)))
    sines = np.sin(math.pi * period * np.fft.rfftfreq(count, period)[own])
    constants = np.geomspace(0.5 * period, 0.5 * count * period, 24)
    squares = (2.0 / period * constants[:, None, None] * sines) ** 2
    # Of the filtered noise, in that before: by half the first order's noise bandwidth.
    shares = _SHARES[:, None] * (0.5 * period / constants[:, None, None])
    first, second = 1.0 / (1.0 + squares), 1.0 / (1.0 + squares**2)
    spectra = np.concatenate([first + shares, second + math.sqrt(0.5) * shares])
    constants = np.concatenate([constants, math.sqrt(2.0) * constants])
    misfits, is_plain = _misfits(power, spectra)
    if not is_plain:
        # Noise behind a filter may have a sine as well.
        misfits, _ = _misfits(rest, spectra)
    periods = np.arange(own.start, own.start + power.size)
    drifts = 1.0 + (_DRIFTS[:, None] * power.size / periods) ** 2
    likelier = power.size * (_misfits(rest, drifts)[0].min() - misfits)
    if likelier.max() < _LIKELIER:
        return 0.0
    order = np.argsort(constants)
    weights = np.exp(likelier - likelier.max()).sum(axis=1)[order]
    sure = np.searchsorted(np.cumsum(weights), _SURE * weights.sum())
    return float(constants[order][sure])


def _misfits(power: Array, spectra: Array) -> tuple[Array, bool]:
    """Return negative log likelihoods by spectra, (..., frequencies), over their number.

    And whether the power, (frequencies,), is without a line by the best.
    """
    level = (power / spectra).mean(axis=-1)
    found = np.asarray(np.log(spectra).mean(axis=-1) + np.log(level))
    best = np.unravel_index(int(np.argmin(found)), found.shape)
    return found, bool((power / spectra[best]).max() <= _LINE * level[best])


def _without_sine(forces: Array) -> Array:
    """Return forces, (n,), without the sine and the line that explain most of them."""
    count, places = forces.size, np.arange(forces.size)
    peak = float(np.argmax(np.abs(np.fft.rfft(forces, 8 * count))[4:]) + 4) / 8.0
    found = forces
    # In a few periods a peak is off the frequency by up to half of one.
    for periods in peak + np.linspace(-0.5, 0.5, 41):
        angle = 2.0 * math.pi * periods / count * places
        columns = np.column_stack([np.cos(angle), np.sin(angle), np.ones(count), places])
        rest = forces - columns @ np.linalg.lstsq(columns, forces, rcond=None)[0]
        found = min(found, rest, key=lambda one: float(one @ one))
    return found
