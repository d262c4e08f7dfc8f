# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Where an approach met the tissue: the surface, found backwards from the detection.

And how the force rose: along a line from that surface, or exponentially.

Below the boundary strain 1/Gn the law is linear, and a touch bends the force: there the surface
is. Where noise hides that part, the force that is seen rises as :math:`e^{G_n x}` from nowhere,
and a surface found by a line is where the noise ends, not where the tissue begins.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import gamma

from fden_ros.core.arrays import Array

#: Growths over the depth at which exponentials are compared with the line, a factor of the
#: root of two apart: a line bends less than the first of them, and the steepest is beyond what
#: the noise hides.
_GROWTHS = (0.5, 0.71, 1.0, 1.41, 2.0, 2.83, 4.0, 5.66, 8.0)
#: The surface is seen where a line from it explains the force by at least this chi-squared better
#: than every exponential does, which is what tells a touch from a drift. Of 60 simulated touches
#: whose linear part was hidden none was above; of 99 whose linear part was seen at most 10 were
#: below.
_LEAST_EVIDENCE = 20.0


#: A probe is off the surface by more than this many deviations of the surface, and than this many
#: usual steps of the displacement: noise alone reaches six.
_CLEAR_DEVIATIONS, _CLEAR_STEPS = 5.0, 10.0
#: And away from it after this time [s]: a probe that chatters is off for less.
_LEAST_AWAY = 0.5


class Surface(NamedTuple):
    """Where an approach met the tissue."""

    first: int  #: of the first sample in contact
    displacement: float  #: [m]
    displacement_sd: float  #: [m]
    evidence: float  #: chi-squared by which a contact explains the force better than a drift does
    is_seen: bool  #: the force rose along a line from there, not exponentially


#: The samples of a window are averaged into at most 96 bins, and 40 times in it are tried for the
#: onset, then 40 about the best: the work is bounded, however many samples a window holds.
_MAX_BINS = 96
_CANDIDATES = 40
#: The first window is this long [s] and holds at least this many samples; it doubles until the
#: onset lies well within it.
FIRST_WINDOW = 0.1
_MIN_WINDOW_SAMPLES = 24
_CONTACT_SHARE = 0.6
#: Before the onset the force is less than this share of that at the detection.
_AIR_SHARE = 0.1


def clear_way(surface_sd: float, displacement: Array) -> float:
    """Return the way from a surface [m] that neither its deviation nor usual steps make.

    `displacement`: two samples or more, [m], shape (n,).
    """
    step = float(np.median(np.abs(np.diff(displacement))))
    return max(_CLEAR_DEVIATIONS * surface_sd, _CLEAR_STEPS * step)


def find_surface(
    time: Array,
    force: Array,
    displacement: Array,
    fractional_order: float,
    noise: float = 0.0,
    window: float = FIRST_WINDOW,
) -> Surface:
    r"""Find where the force begins to follow the displacement.

    Least squares of the model's small-strain response :math:`k\,D^\alpha \max(d - d_0, 0)` over
    the surface :math:`d_0`, the stiffness k and the force's bias eliminated; exact for any
    approach, since the fractional derivative is that of the measured motion. The window reaches
    back from the last sample just as far as it must.

    Parameters
    ----------
    time, force, displacement : ndarray, shape (n,)
        Samples [s], [N] less bias, [m]; the last ones in contact.
    fractional_order : float
        Rough alpha [1].
    noise : float
        Least standard deviation of the force per sample, as white noise [N].
    window : float
        First window [s].
    """
    detected = float(force[-_MIN_WINDOW_SAMPLES // 2 :].mean())
    while True:
        start = min(
            int(np.searchsorted(time, time[-1] - window)), max(time.size - _MIN_WINDOW_SAMPLES, 0)
        )
        bins = _Bins.of(time, force, displacement, start, fractional_order)
        onset_time = bins.best(
            np.linspace(bins.time[0], bins.time[-1], _CANDIDATES, endpoint=False)
        )
        inside = time[-1] - onset_time <= _CONTACT_SHARE * (time[-1] - time[start])
        # A bend within the contact is no onset: before that, the force is the air's.
        if start == 0 or (inside and bins.mean_force_until(onset_time) < _AIR_SHARE * detected):
            break
        window = 2.0 * max(window, float(time[-1] - time[start]))
    spacing = (bins.time[-1] - bins.time[0]) / _CANDIDATES
    onset_time = bins.best(onset_time + np.linspace(-spacing, spacing, _CANDIDATES))
    surface = float(np.interp(onset_time, bins.time, bins.displacement))
    surface_sd = bins.deviation(onset_time, spacing, noise)
    return Surface(
        _last_way_in(time, displacement, onset_time, surface, surface_sd),
        surface,
        surface_sd,
        bins.evidence(onset_time, noise),
        bins.shows(onset_time),
    )


def _last_way_in(
    time: Array, displacement: Array, onset_time: float, surface: float, surface_sd: float
) -> int:
    """Return the first sample behind the surface since the probe was last before it.

    A retract passes the surface, too, and explains the force of the next press as well. What is
    shorter than `_LEAST_AWAY` is no retract: a probe that chatters is in one contact.
    """
    first = int(np.searchsorted(time, onset_time))
    way = displacement[first:]
    if way.size < 2:
        return first
    # As far before it as a probe is that came through the air.
    before = np.flatnonzero(way < surface - clear_way(surface_sd, way))
    if not before.size or time[first + before[-1]] - time[first + before[0]] < _LEAST_AWAY:
        return first
    left = int(before[-1])
    return first + left + int(np.argmax(way[left:] >= surface))


@dataclass(frozen=True)
class _Bins:
    """Samples averaged into few bins, with the fractional derivative as a matrix on increments."""

    time: Array
    force: Array
    displacement: Array
    derivative: Array
    size: int  #: samples per bin

    @classmethod
    def of(
        cls, time: Array, force: Array, displacement: Array, start: int, fractional_order: float
    ) -> _Bins:
        size = time.size - start
        per_bin = max(1, -(-size // _MAX_BINS))
        count = size // per_bin
        kept = slice(time.size - count * per_bin, None)

        def mean(values: Array) -> Array:
            averaged: Array = values[kept].reshape(count, per_bin).mean(axis=1)
            return averaged

        bin_time = mean(time)
        exponent = 1.0 - fractional_order
        lag = np.maximum(bin_time[:, None] - bin_time[None, :], 0.0) ** exponent
        matrix = (lag[:, :-1] - lag[:, 1:]) / (np.diff(bin_time) * gamma(exponent + 1.0))
        return cls(bin_time, mean(force), mean(displacement), matrix, per_bin)

    def misfit(self, onset_times: Array) -> Array:
        """Sum of squared residuals [N^2] for each candidate onset, shape (candidates,)."""
        surface = np.interp(onset_times, self.time, self.displacement)
        depth = np.maximum(self.displacement[:, None] - surface, 0.0)
        depth *= self.time[:, None] >= onset_times
        return self._misfit_of(depth)

    def _misfit_of(self, signals: Array) -> Array:
        """Sum of squared residuals [N^2] of the responses to signals (bins, m), shape (m,)."""
        response = self.derivative @ np.diff(signals, axis=0)
        # Centred, because the force's bias is fitted too.
        response -= response.mean(axis=0)
        force = self.force - self.force.mean()
        power = np.sum(response**2, axis=0)
        gain = np.maximum(force @ response, 0.0)
        explained = np.divide(gain**2, power, out=np.zeros_like(power), where=power > 0.0)
        misfit: Array = force @ force - explained
        return misfit

    def mean_force_until(self, onset_time: float) -> float:
        before = self.force[self.time <= onset_time]
        return float(before.mean()) if before.size else 0.0

    def best(self, onset_times: Array) -> float:
        return float(onset_times[np.argmin(self.misfit(onset_times))])

    def evidence(self, onset_time: float, least_noise: float) -> float:
        """Return the chi-squared by which a contact fits better than a line in time."""
        contact = float(self.misfit(np.array([onset_time]))[0])
        line = np.polynomial.Polynomial.fit(self.time, self.force, 1)
        drift = float(np.sum((self.force - line(self.time)) ** 2))
        noise = max(min(contact, drift), sys.float_info.min) / max(self.time.size - 3, 1)
        noise = max(noise, least_noise**2 / self.size)
        return (drift - contact) / noise

    def shows(self, onset_time: float) -> bool:
        """Whether the force rose along a line from the onset on, not exponentially."""
        detected = float(self.displacement[-1])
        depth = detected - float(np.interp(onset_time, self.time, self.displacement))
        if depth <= 0.0:
            return True
        behind = np.minimum((self.displacement - detected) / depth, 0.0)
        exponential = float(self._misfit_of(np.exp(np.outer(behind, _GROWTHS))).min())
        line = float(self.misfit(np.array([onset_time]))[0])
        noise = max(min(exponential, line), sys.float_info.min) / max(self.time.size - 3, 1)
        return exponential - line >= _LEAST_EVIDENCE * noise

    def deviation(self, onset_time: float, spacing: float, least_noise: float) -> float:
        """Return the standard deviation of the surface [m] from the curvature of the misfit.

        One bin in contact, or two of which the first is hardly so, tell the force's gain or the
        surface, not both: then it may be anywhere between two bins.
        """
        near = onset_time + np.array([-spacing, 0.0, spacing])
        low, middle, high = self.misfit(near)
        noise = max(float(middle) / max(self.time.size - 2, 1), least_noise**2 / self.size)
        steps = np.interp(near, self.time, self.displacement)
        step = max(0.5 * abs(float(steps[2] - steps[0])), sys.float_info.min)
        curvature = max(float(low + high - 2.0 * middle), sys.float_info.min)
        found = step * math.sqrt(2.0 * noise / curvature)
        if np.count_nonzero(self.time > onset_time) < 3:
            found = max(found, float(np.ptp(self.displacement[-2:])) / math.sqrt(12.0))
        return min(found, float(np.ptp(self.displacement)))
