# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""A low-pass filter on the force, by the spectrum of its noise in the air.

Noise of a sensor is white up to its filter, so the spectrum at rest is that of the filter, over a
floor of what comes after it. Whittle's likelihood compares filters of several kinds and times
with noise that is white, or falls with a power of the frequency as a drift's does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import periodogram
from scipy.special import digamma, polygamma

from fden_ros.configure.signs import LEAST_RATIO
from fden_ros.core.arrays import Array

#: Length of the parts whose spectra are averaged [s], at least.
_PART, _LEAST_PART = 2.0, 1.0
#: Frequencies that count, as a part of the rate: beyond, sampling folds the spectrum.
_HIGHEST = 0.3
#: Floors behind the filter, relative to its passband.
_FLOORS = np.array([0.0, *np.geomspace(1e-8, 0.3, 16)])
#: Slopes of noise that no filter makes, and their floors, relative to it at the lowest frequency.
_SLOPES = np.linspace(0.0, 4.0, 17)
#: Parts of the periodogram that are independent, with Hann's window.
_INDEPENDENT = 0.67
#: A filter below so many steps of the stamps changes nothing.
_LEAST_STEPS = 2.0
#: What a spectrum may leave by the kind of its filter, in ln of the power.
_MISFIT = 0.05
#: A vibration is a line of so many frequencies.
_LINE = 5
#: Relative deviation of a time by what kind of filter it is.
_KIND_SD = 0.2


class Filter(NamedTuple):
    """A low-pass filter."""

    delay: float  #: of slow signals [s]
    sd: float  #: [s]
    cutoff: float  #: at half the power [Hz]


def find_filter(rest: Sequence[Array], rate: float) -> Filter | None:
    """Return the filter on a force, from stretches at rest in the air; None: none is seen.

    Parameters
    ----------
    rest : sequence of Array
        Samples of each stretch (n,).
    rate : float
        Samples a second.
    """
    longest = max((part.size for part in rest), default=0)
    size = min(int(_PART * rate), longest)
    if size < max(_LEAST_PART * rate, 32):
        return None
    parts = [p[i : i + size] for p in rest for i in range(0, p.size - size + 1, size)]
    frequencies, powers = periodogram(np.array(parts), rate, "hann", detrend="linear")
    kept = (frequencies > 1.5 * frequencies[1]) & (frequencies < _HIGHEST * rate)
    frequencies, power = frequencies[kept], powers.mean(axis=0)[kept]
    if frequencies.size < 8 or not power.min() > 0.0:
        return None
    count = _INDEPENDENT * len(parts)
    falling = (frequencies[0] / frequencies) ** _SLOPES[:, None]
    free = max(float(_likelihoods(one, power, count).max()) for one in falling)
    line = slice(max(int(power.argmax()) - _LINE // 2, 0), int(power.argmax()) + _LINE // 2 + 1)
    left = np.delete(power, line)
    with_line = float(_likelihoods(np.ones_like(left), left, count)[0])
    free = max(free, with_line - count * float(np.log(power[line]).sum()))
    # The passband has to be seen, and its end.
    cutoffs = np.geomspace(2.0 * frequencies[0], 0.5 * frequencies[-1], 40)
    likelihoods, delays, halves = [], [], []
    for cutoff in cutoffs:
        for gain, steps, half in _filters(frequencies / cutoff):
            likelihoods.append(_likelihoods(gain, power, count).max())
            delays.append(steps / (2.0 * math.pi * cutoff))
            halves.append(half * cutoff)
    best = int(np.argmax(likelihoods))
    # A spectrum that fits leaves Gamma variables of mean 1: a line of a vibration does not.
    size = power.size * count
    misfit = -likelihoods[best] - float(count * np.log(power).sum())
    expected = size * (math.log(len(parts)) - float(digamma(len(parts))))
    scatter = math.sqrt(size * count * float(polygamma(1, len(parts))))
    most = expected + 5.0 * scatter + _MISFIT * size
    if likelihoods[best] - free < math.log(LEAST_RATIO) or misfit > most:
        return None
    if delays[best] < _LEAST_STEPS / rate:
        return None
    weights = np.exp(np.array(likelihoods) - likelihoods[best])
    delay = float(np.average(delays, weights=weights))
    sd = math.sqrt(float(np.average((np.array(delays) - delay) ** 2, weights=weights)))
    return Filter(delay, math.hypot(sd, _KIND_SD * delay), halves[best])


def _filters(ratio: Array) -> list[tuple[Array, float, float]]:
    """Return power gain (n,), delay in radians of the cutoff, and where half the power is left.

    Of first-order stages in a row, of Butterworth's filters, and of a mean over a time.
    """
    stages = [
        ((1.0 + ratio**2) ** -count, float(count), math.sqrt(2.0 ** (1.0 / count) - 1.0))
        for count in (1, 2, 3)
    ]
    butterworth = [
        (1.0 / (1.0 + ratio ** (2 * order)), delay, 1.0)
        for order, delay in ((2, math.sqrt(2.0)), (4, 2.613))
    ]
    return [*stages, *butterworth, (np.sinc(0.443 * ratio) ** 2, 0.443 * math.pi, 1.0)]


def _likelihoods(gain: Array, power: Array, count: float) -> Array:
    """Return ln of Whittle's likelihood with each floor, its size at the best (k,)."""
    shape = gain + np.maximum(_FLOORS, 1e-12)[:, None]
    size = np.mean(power / shape, axis=1)
    return np.asarray(-count * (power.size * np.log(size) + np.log(shape).sum(axis=1)))
