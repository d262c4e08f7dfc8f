# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Where an approach met the tissue: the surface, found backwards from the detection.

Least squares of the law's response at small strain, :math:`k\,D^\alpha \max(d - d_0, 0)`, over
the surface :math:`d_0`; the stiffness k and the force's bias are eliminated. This is exact for any
approach, since the fractional derivative is that of the measured motion.

Where noise hides the linear part, below the strain 1/Gn, the force rises as :math:`e^{G_n x}`. A
surface found by a line is then where the force leaves the noise, not where the tissue begins.
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

import numpy as np
from scipy.special import gamma

from fden_ros.core.arrays import NOT_BY_CHANCE, Array
from fden_ros.core.streams import BRIEF_NS, CHUNK_NS, NANOSECONDS

#: Growths over the depth at which exponentials are compared with the line: the line bends less
#: than the first of them, and the steepest is beyond what the noise hides.
_GROWTHS = (0.5, 0.71, 1.0, 1.41, 2.0, 2.83, 4.0, 5.66, 8.0)
#: The surface is seen where a line from it explains the force by at least this chi-squared better
#: than every exponential does. Of 60 simulated touches whose linear part was hidden none was
#: above; of 99 whose linear part was seen at most 10 were below.
LEAST_EVIDENCE = 20.0
#: This many times in a window are tried for the onset, then as many about the best; its samples
#: are averaged into at most twice as many bins. So the work is bounded, whatever a window holds.
_CANDIDATES = 40
#: The first window is this long [s] and holds at least this many samples; it doubles until the
#: onset lies well within it, at less than this share of it.
FIRST_WINDOW, _MIN_WINDOW_SAMPLES, _CONTACT_SHARE = 0.1, 24, 0.6
#: Force, depth or time below this share of that detected is small.
SMALL = 0.1
#: A rise must last for this time [s] from a tenth of its depth on: one half of a vibration of 5 Hz
#: is then over. Or the probe has moved for as long before, at this share of its present speed, by
#: steps of a chunk: then the swing of the force while it moves is known.
_LASTING, _MOTION_SHARE = 0.15, 0.3
_MOTION_STEP = CHUNK_NS / NANOSECONDS
#: Acceleration and force are averaged over twice this time [s].
_AVERAGED = 0.004


class Approach(NamedTuple):
    """The samples of the lookback, and the surface that explains the newest."""

    time: Array  #: [s]
    force: Array  #: less bias and drift [N]
    displacement: Array  #: compliance removed [m]
    first: int  #: sample behind the surface
    surface: float  #: [m]
    surface_sd: float  #: [m]
    evidence: float  #: chi-squared by which a contact explains the force better than a drift does
    shows_surface: bool  #: the force rose along a line from there, not exponentially

    def came_through_air(self) -> bool:
        """Whether the probe came to the surface through the air."""
        before = self.displacement[: self.first]
        way = self.surface - float(before.min(initial=self.surface))
        return way > _clear_way(before, self.surface_sd)

    def has_advanced(self) -> bool:
        """Whether the probe has moved in: otherwise it touches nothing after a release."""
        way = self.displacement
        return float(np.max(way - np.minimum.accumulate(way))) > _clear_way(way)

    def inertia(self, compliance: float) -> tuple[float, float]:
        """Return the mass beyond the sensor [kg] and its largest force in the air [N]; 0: none.

        The noise of the force is in the displacement without `compliance` [m/N], but not in the
        measured one. A second difference over n samples is the mean of the acceleration under a
        triangle. Where the force of inertia was taken for the touch, the air may be the first
        half of the way in.
        """
        end = self.first
        if not self.came_through_air():
            way_in = self.displacement[end:] - self.displacement[end]
            end += int(np.argmax(way_in >= 0.5 * way_in.max()))
        way, force = self.displacement[:end], self.force[:end]
        way = way + compliance * force
        step = float(self.time[-1]) / max(self.time.size - 1, 1)
        n = max(round(_AVERAGED / step), 1)
        if way.size < 8 * n:
            return 0.0, 0.0
        acceleration = (way[2 * n :] - 2.0 * way[n:-n] + way[: -2 * n]) / (n * step) ** 2
        triangle = np.convolve(np.ones(n), np.ones(n)) / n**2
        mean = np.convolve(force[1:] - np.median(force), triangle, "valid")[: acceleration.size]
        power = float(acceleration @ acceleration)
        mass = float(acceleration @ mean) / max(power, sys.float_info.min)
        left = float(np.std(mean - mass * acceleration)) * math.sqrt(2.0 * n)
        if mass * math.sqrt(power) <= NOT_BY_CHANCE * left:
            return 0.0, 0.0
        return mass, mass * float(np.abs(acceleration).max())

    def rises_by_itself(self, drift: float, noise: float) -> bool:
        """Whether time explains the force before the touch better than the displacement does.

        Tissue that is already pressed would push more as the probe advances, and less at rest.
        `drift` [N/s] was subtracted from the force, whose noise per sample is `noise` [N].
        """
        time, way = (values[: self.first] for values in (self.time, self.displacement))
        force = self.force[: self.first] + drift * time
        if way.size < 3 or np.ptp(way) == 0.0:
            return False
        by_time, by_way = (np.corrcoef(force, by)[0, 1] ** 2 for by in (time, way))
        explained = float(by_time - by_way) * force.size * float(np.var(force))
        return explained > LEAST_EVIDENCE * noise**2

    def is_established(self, *, is_clear: bool) -> bool:
        """Whether the present rise cannot be a swing of a force that the motion shakes.

        It has lasted, or the probe has moved as fast before and the force's swing is known.
        """
        time, first = self.time, self.first
        depth = self.displacement - self.displacement[first]
        rests = not self.has_advanced()
        # Where the probe rested, the surface may lie anywhere in that time.
        rise = self.force if rests else depth
        shallow = np.flatnonzero(rise[first:] < SMALL * rise[-1])
        first += int(shallow[-1]) if shallow.size else 0
        lasting = float(time[-1] - time[first])
        if lasting > _LASTING or rests or not is_clear:
            return lasting > _LASTING
        instants = np.arange(time[first], time[0], -_MOTION_STEP)
        moved = np.abs(np.diff(np.interp(instants, time, self.displacement)))
        speed = abs(float(depth[-1] - depth[first])) / max(lasting, _MOTION_STEP)
        least = max(_MOTION_SHARE * speed * _MOTION_STEP, _clear_way(self.displacement))
        moving = np.count_nonzero(moved >= least)
        return bool(moving * _MOTION_STEP > _LASTING)


def find_surface(
    time: Array,
    force: Array,
    displacement: Array,
    fractional_order: float,
    noise: float = 0.0,
    window: float = FIRST_WINDOW,
) -> Approach:
    """Find where the force begins to follow the displacement, in samples that end in contact.

    These are [s], [N] less bias, and [m], shape (n,); `noise` is the least standard deviation of
    the force per sample, as white noise [N], `window` the first one to search [s].
    """
    detected = float(force[-_MIN_WINDOW_SAMPLES // 2 :].mean())
    while True:
        start = int(np.searchsorted(time, time[-1] - window))
        start = min(start, max(time.size - _MIN_WINDOW_SAMPLES, 0))
        bins = _Bins(time, force, displacement, start, fractional_order, noise)
        tried = np.linspace(bins.time[0], bins.time[-1], _CANDIDATES, endpoint=False)
        onset_time = bins.best(tried)
        inside = time[-1] - onset_time <= _CONTACT_SHARE * (time[-1] - time[start])
        # A bend within the contact is no onset: before the onset the force is the air's.
        before = float(bins.force[bins.time <= onset_time].mean())
        if start == 0 or (inside and before < SMALL * detected):
            break
        window = 2.0 * max(window, float(time[-1] - time[start]))
    spacing = (bins.time[-1] - bins.time[0]) / _CANDIDATES
    onset_time = bins.best(onset_time + np.linspace(-spacing, spacing, _CANDIDATES))
    surface, sd = bins.surface(onset_time, spacing)
    first = _last_way_in(time, displacement, onset_time, surface, sd)
    found = (min(first, time.size - 1), surface, sd, *bins.evidence(onset_time))
    return Approach(time, force, displacement, *found)


def _clear_way(displacement: Array, surface_sd: float = 0.0) -> float:
    """Return the way [m] beyond the noise of a `displacement`, and the deviation of a surface.

    Even motion has no second differences; the median of those of noise is 1.65 deviations. With 4
    deviations of the surface a force that grew in the air was a touch.
    """
    if displacement.size < 3:
        return math.inf
    steps = np.abs(np.diff(displacement))
    noise = float(np.median(np.abs(np.diff(displacement, n=2))))
    step = float(steps[steps > 0.0].min(initial=math.inf))
    # Each of two places is rounded.
    return max(NOT_BY_CHANCE * max(noise, surface_sd), 2.0 * step)


def _last_way_in(
    time: Array, displacement: Array, onset_time: float, surface: float, surface_sd: float
) -> int:
    """Return the first sample behind the surface since the probe was last before it.

    A retract also passes the surface, and explains the force of the next press as well. Anything
    brief is no retract: a probe that chatters is in one contact.
    """
    first = int(np.searchsorted(time, onset_time))
    way = displacement[first:]
    # As far before it as a probe that came through the air.
    before = first + np.flatnonzero(way < surface - _clear_way(way, surface_sd))
    if before.size and time[before[-1]] - time[before[0]] >= BRIEF_NS / NANOSECONDS:
        first = int(before[-1])
        first += int(np.argmax(displacement[first:] >= surface))
    return first


class _Bins:
    """Samples averaged into few bins, with the fractional derivative as a matrix on increments."""

    def __init__(
        self, time: Array, force: Array, way: Array, start: int, order: float, noise: float
    ) -> None:
        per_bin = max(1, -(-(time.size - start) // (2 * _CANDIDATES)))
        count = (time.size - start) // per_bin
        kept = slice(time.size - count * per_bin, None)
        self.time, self.force, self.displacement = (
            values[kept].reshape(count, per_bin).mean(axis=1) for values in (time, force, way)
        )
        exponent = 1.0 - order
        lag = np.maximum(self.time[:, None] - self.time[None, :], 0.0) ** exponent
        widths = np.diff(self.time) * gamma(exponent + 1.0)
        self._derivative = (lag[:, :-1] - lag[:, 1:]) / widths
        self._least = noise**2 / per_bin  # variance of the force of a bin [N^2]

    def misfit(self, onset_times: Array) -> Array:
        """Sum of squared residuals [N^2] for each candidate onset, shape (candidates,)."""
        surface = np.interp(onset_times, self.time, self.displacement)
        depth = np.maximum(self.displacement[:, None] - surface, 0.0)
        return self._misfit_of(depth * (self.time[:, None] >= onset_times))

    def _misfit_of(self, signals: Array) -> Array:
        """Sum of squared residuals [N^2] of the responses to signals (bins, m), shape (m,)."""
        response = self._derivative @ np.diff(signals, axis=0)
        # Centred, because the force's bias is fitted too.
        response -= response.mean(axis=0)
        force = self.force - self.force.mean()
        power = np.sum(response**2, axis=0)
        gain = np.maximum(force @ response, 0.0)
        explained = np.divide(gain**2, power, out=np.zeros_like(power), where=power > 0.0)
        misfit: Array = force @ force - explained
        return misfit

    def best(self, onset_times: Array) -> float:
        return float(onset_times[np.argmin(self.misfit(onset_times))])

    def evidence(self, onset_time: float) -> tuple[float, bool]:
        """Return the chi-squared by which a contact fits better than a line in time.

        Also return whether the force rose along a line from the onset on, not exponentially.
        """
        contact = float(self.misfit(np.array([onset_time]))[0])
        line = np.polynomial.Polynomial.fit(self.time, self.force, 1)
        drift = float(np.sum((self.force - line(self.time)) ** 2))
        behind = self.displacement - self.displacement[-1]
        depth = -float(np.interp(onset_time, self.time, behind))
        growths = np.outer(np.minimum(behind / max(depth, sys.float_info.min), 0.0), _GROWTHS)
        exponential = float(self._misfit_of(np.exp(growths)).min())

        def gain(other: float, least: float) -> float:
            noise = max(min(contact, other), sys.float_info.min) / max(self.time.size - 3, 1)
            return (other - contact) / max(noise, least)

        is_seen = depth <= 0.0 or gain(exponential, 0.0) >= LEAST_EVIDENCE
        return gain(drift, self._least), is_seen

    def surface(self, onset_time: float, spacing: float) -> tuple[float, float]:
        """Return the surface and its standard deviation [m], by the curvature of the misfit.

        One bin in contact, or two of which the first hardly is, show the force's gain or the
        surface, not both: the surface may then be anywhere between two bins.
        """
        near = onset_time + np.array([-spacing, 0.0, spacing])
        low, middle, high = self.misfit(near)
        noise = max(float(middle) / max(self.time.size - 2, 1), self._least)
        places = np.interp(near, self.time, self.displacement)
        step = max(0.5 * abs(float(places[2] - places[0])), sys.float_info.min)
        curvature = max(float(low + high - 2.0 * middle), sys.float_info.min)
        sd = step * math.sqrt(2.0 * noise / curvature)
        if np.count_nonzero(self.time > onset_time) < 3:
            sd = max(sd, float(np.ptp(self.displacement[-2:])) / math.sqrt(12.0))
        return float(places[1]), min(sd, float(np.ptp(self.displacement)))
