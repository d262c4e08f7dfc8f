# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The measured slope: stiffness in N/m without a law, a touch or a zero.

It is dF/dd at the end of loading, and at the beginning of unloading (S of Oliver and Pharr,
Journal of Materials Research 7, 1564, 1992). A *run* is motion in one direction, kept as pieces of
the path, the newest the finest. The slope is that of a parabola through a window at the run's end,
evaluated at that end. The window is the narrowest whose standard error is 2 % of the slope,
otherwise the one with the least. The standard error includes the change of the slope by a cubic.
If the end itself is not known, the slope is that in the middle of a window.
"""

from __future__ import annotations

import bisect
import math
import sys
from collections import deque
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack
from scipy.special import stdtrit

from fden_ros.core.arrays import CLEAR, LIKELY, Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact import SMALL
from fden_ros.core.streams import NANOSECONDS, Pair

#: Least length of a piece, as a part of the geometry's length and in deviations of the
#: displacement's noise; pieces of one length before the two oldest are joined.
_LEAST_PIECE, _PIECE_DEVIATIONS, _PER_LEVEL = 2.5e-4, 4.0, 10
#: A window has at least this many pieces. A run ends where a piece takes this many times as long
#: as usual, and its slope is due again when the window has grown by one part in as many.
_PIECES = 8
#: Ratio of two windows.
_WIDER = 1.4
#: A slope is known to at least this part of itself. A run that goes on with the last one changes
#: the force by at least this part of that. The envelope of a force saturates where it rises by
#: less than this part of its rise over as wide a window before, clearly, ...
_QUARTER = 0.25
#: ... at least at this part of the speed then, on 6 pieces.
_SPEED, _LEAST_FLAT = 0.8, 6
#: Largest correlation of neighbouring residuals.
_MOST_CORRELATED = 0.8
#: Relative standard error from which on a window is wide enough.
_FINE = 0.02
#: Standard deviation of white noise over the mean magnitude of its third differences.
_THIRD_DIFFERENCE = math.sqrt(math.pi / 40.0)


class MeasuredSlope(NamedTuple):
    """Slope of force over displacement in one direction."""

    value: float  #: dF/dd [N/m]
    sd: float  #: its standard deviation [N/m]
    depth: float  #: below the surface [m]; NaN: no touch was seen
    stamp_ns: int  #: when the probe was there


class Slopes(NamedTuple):
    """At the end of loading, and at the beginning of unloading; None: not known."""

    loading: MeasuredSlope | None = None
    unloading: MeasuredSlope | None = None

    def below(self, surface: float) -> Slopes:
        """Return the slopes with depths from a surface [m]."""
        return Slopes(*(one and one._replace(depth=one.depth - surface) for one in self))

    def deepest(self, new: Slopes) -> Slopes:
        """Return the deeper slope of each direction, the new one where both are equal."""
        pairs = zip(self, new, strict=True)
        return Slopes(*(b if not a or (b and b.depth >= a.depth) else a for a, b in pairs))


NOT_MEASURED = Slopes()


class _Run:
    """Motion in one direction from a place [m] on; `sign` is 1 into the tissue."""

    def __init__(self, sign: float, start: float, stamp_ns: int, length: float) -> None:
        self.sign, self.start, self.length, self.start_ns = sign, start, length, stamp_ns
        self.width, self.duration, self.due_width = 0.0, 0.0, length
        self.levels: list[deque[Array]] = [deque()]
        self._open(0.0, stamp_ns)

    def _open(self, way: float, stamp_ns: int) -> None:
        self.open_way, self._open_ns = way, stamp_ns
        self._way = self._square = self._cube = self._force = 0.0  # sums
        self._count = 0

    def add(self, stamp_ns: int, way: float, force: float) -> None:
        """Add a sample."""
        self._way += way
        self._square += way * way
        self._cube += way**3
        self._force += self.sign * force
        self._count += 1
        width = self.length * math.floor((way - self.open_way) / self.length)
        if width <= 0.0:
            return
        duration = (stamp_ns - self._open_ns) / NANOSECONDS
        time = (stamp_ns - self.start_ns) / NANOSECONDS - 0.5 * duration
        sums = np.array([self._way, self._square, self._cube, self._force])
        piece = np.array([width, duration, time, *sums / self._count, 1.0 / self._count])
        is_first = self.open_way == 0.0  # it may hold the rest, or the turn, from before
        self._open(self.open_way + width, stamp_ns)
        if is_first:
            return
        self.width, self.duration = self.width + width, self.duration + duration
        for level in self.levels:
            level.append(piece)
            if len(level) <= _PER_LEVEL:
                return
            piece = _joined(level.popleft(), level.popleft())
        self.levels.append(deque([piece]))

    def rests(self, stamp_ns: int) -> bool:
        """Whether the present piece takes so long that the probe is at rest."""
        elapsed = (stamp_ns - self._open_ns) / NANOSECONDS
        return elapsed * self.width > _PIECES * self.duration * self.length > 0.0

    def columns(self) -> Array:
        """Return pieces from the measured end: a row for each number of a piece.

        Width, duration, time, means of way, its square, its cube and force, variance of the force.
        """
        pieces = np.array([p for level in self.levels for p in reversed(level)]).reshape(-1, 8).T
        if self.sign < 0.0 or pieces.shape[1] < 2:
            return pieces[:, ::-1]
        speeds = pieces[0] / np.maximum(pieces[1], 1.0 / NANOSECONDS)
        rises = pieces[6, :-1] - pieces[6, 1:]
        pace = float(rises @ speeds[:-1]) / max(float(rises.sum()), sys.float_info.min)
        # Loading ends where the probe slows down to half of the speed at which the force rose.
        return pieces[:, int(np.argmax(speeds >= 0.5 * pace)) :]


def _joined(a: Array, b: Array) -> Array:
    own = a[0] / (a[0] + b[0])
    piece: Array = own * a + (1.0 - own) * b
    piece[:2], piece[7] = a[:2] + b[:2], own**2 * a[7] + (1.0 - own) ** 2 * b[7]
    return piece


class _Window(NamedTuple):
    slope: float  #: [N/m]
    sd: float  #: [N/m]
    way: float  #: of the slope's place [m]
    width: float  #: [m]
    curve: float  #: change of the slope with the way [N/m^2]
    bias: float  #: clear change of the slope by a cubic, here or in a narrower window [N/m]
    is_known: bool


def _window(columns: Array, place: float, noise: tuple[float, float], bias: float) -> _Window:
    """Return the slope at an end of a window, 1 or -1, or in its middle, 0.

    `columns` has the force of inertia as its last row. `noise` is the least of a sample, and that
    which means over a longer time show [N]; `bias` that of the narrower windows.
    """
    weights, _, _, ways, squares, cubes, forces, variances, inertia = columns
    width = float(weights.sum())
    half, middle = 0.5 * width, float(weights @ ways) / width
    # Means over the pieces of the powers of the distance from the middle, in halves.
    third = (cubes - 3.0 * middle * squares + 3.0 * middle**2 * ways - middle**3) / half**3
    second = (squares - 2.0 * middle * ways + middle**2) / half**2
    design = np.stack([np.ones_like(ways), (ways - middle) / half, second, third], axis=1)
    parabola, _ = _fitted(columns, design[:, :3])
    cubic, variance = _fitted(columns, design)
    variance = max(variance, noise[0] ** 2)
    slow = max(variance, noise[1] ** 2)
    curve = 2.0 * float(parabola[2] @ forces) / half**2
    student = float(stdtrit(len(forces) - 4, 0.975)) / 1.959964  # of the normal distribution
    gradient = np.array([0.0, 1.0, 2.0 * place, 3.0 * place**2]) / half
    line = gradient[:3] @ parabola
    bend = line - gradient @ cubic
    own, unsure = (student**2 * slow * float(one**2 @ variances) for one in (line, bend))
    change, slope = abs(float(bend @ forces)), float(line @ forces)
    inertial = float(line @ inertia)
    if change**2 > LIKELY**2 * unsure:  # by chance it may vanish in wider windows
        bias = max(bias, change)
    sd = math.sqrt(own + unsure + max(bias, change) ** 2 + inertial**2)
    slope -= inertial
    is_known = _QUARTER * slope >= sd and slope * width >= CLEAR * math.sqrt(variance)
    return _Window(slope, sd, middle + place * half, width, curve, bias, is_known)


def _fitted(columns: Array, design: Array) -> tuple[Array, float]:
    """Return the matrix from forces to coefficients, and the variance of a sample's force [N^2].

    The correlation of neighbouring residuals widens the latter.
    """
    weights, forces, variances = columns[0], columns[6], columns[7]
    weighted = (weights[:, None] * design).T
    k = design.shape[1]
    room = 4 * k + weights.size
    matrix: Array = lapack.dgelsy(weighted @ design, weighted, np.zeros(k), 1e-15, room)[1]
    left = (forces - design @ (matrix @ forces)) / np.sqrt(variances)
    total = max(float(left @ left), sys.float_info.min)
    correlated = min(max(float(left[1:] @ left[:-1]) / total, 0.0), _MOST_CORRELATED)
    return matrix, total / (len(forces) - k) * (1.0 + correlated) / (1.0 - correlated)


def _line(columns: Array) -> tuple[float, float]:
    """Return the slope of a line through pieces and its standard error [N/m]."""
    way = columns[3] - columns[3].mean()
    width = float(np.ptp(way))
    matrix, variance = _fitted(columns, np.stack([np.ones_like(way), way / width], axis=1))
    error = math.sqrt(variance * float(matrix[1] ** 2 @ columns[7]))
    return float(matrix[1] @ columns[6]) / width, error / width


def _accelerations(columns: Array) -> Array:
    """Return the change of the speed along pieces, over time [m/s^2]."""
    speeds = columns[0] / np.maximum(columns[1], 1.0 / NANOSECONDS)
    steps = np.diff(columns[2])
    changes = np.diff(speeds) / np.where(steps == 0.0, math.inf, steps)
    around = np.pad(changes, 1, "edge")
    mean: Array = 0.5 * (around[1:] + around[:-1])
    return mean


def _is_saturated(columns: Array, change: float) -> bool:
    """Whether the force stands still at the end of loading, from which the columns begin.

    No tissue does that under a probe that moves on: the sensor, or its amplifier, is at its end.
    Repeated values are those of a slow sensor, or are rejected as stuck.
    """
    widths, times = np.cumsum(columns[0]), np.cumsum(columns[1])
    count = _LEAST_FLAT
    while count < widths.size and 2.0 * widths[count - 1] <= widths[-1]:
        twice = int(np.searchsorted(widths, 2.0 * widths[count - 1])) + 1
        end, before = columns[:, :count], columns[:, count : max(twice, count + _LEAST_FLAT)]
        if before.shape[1] >= _LEAST_FLAT and np.ptp(end[6]) > 1e-9 * np.abs(end[6]).max():
            (slope, error), (rise, rise_error) = _line(end), _line(before)
            is_flat = abs(slope) + CLEAR * error < _QUARTER * (rise - CLEAR * rise_error)
            pace = float(before[0].sum()) / max(float(before[1].sum()), sys.float_info.min)
            is_fast = widths[count - 1] > _SPEED * pace * times[count - 1]
            if is_flat and is_fast and rise * widths[count - 1] > SMALL * change:
                return True
        count += max(count // 5, 1)
    return False


def _best(
    columns: Array, places: tuple[float, ...], least_change: float, noise: tuple[float, float]
) -> _Window | None:
    """Return the slope at the first place of a window where it is known; None: at none."""
    widths, forces, last = np.cumsum(columns[0]).tolist(), columns[6].tolist(), columns.shape[1]
    for place in places:
        found, count, bias = [], _PIECES, 0.0
        while count <= last:
            change = abs(sum(forces[:3]) - sum(forces[count - 3 : count])) / 3.0
            is_wide = count == last or change >= max(least_change, CLEAR * noise[0])
            if is_wide:
                one = _window(columns[:, :count], place, noise, bias)
                bias = one.bias
                found += [one] * one.is_known
                if place and one.is_known and one.sd <= _FINE * one.slope:
                    return one
            wider = bisect.bisect_left(widths, _WIDER * widths[count - 1])
            count = last if count < last < wider else max(wider, count + 1)
        if found:
            return min(found, key=lambda one: one.sd)
    return None


class MeasuredSlopes:
    """Measures the slopes sample by sample, and keeps those of the newest contacts.

    A press has those where it was deepest, a place on a path the newest.
    """

    def __init__(self, config: PipelineConfig) -> None:
        self._contact, self._is_continuous = config.contact, config.is_continuous
        self._noise = max(config.contact.force_noise, config.contact.noise_floor)
        self._stated_delay_sd = config.estimator.uncertainty.delay_sd
        self._least_piece = _LEAST_PIECE * config.geometry.length
        self._unseen, self._surface, self._was_in_contact = NOT_MEASURED, math.nan, False
        self._slow_noise = 0.0  # of the force per sample, as means over a longer time show it [N]
        self._delay_sd = self._stated_delay_sd  # [s]
        self._mass = 0.0  # beyond the sensor, of roughly known size [kg]
        #: Of three contacts, as the summary of one may come in the next: slopes and surface [m].
        self._found: dict[int, tuple[Slopes, float]] = {}
        self.forget()

    @property
    def newest(self) -> Slopes:
        """The newest slopes."""
        return self._newest.below(self._surface)

    @property
    def unseen(self) -> Slopes:
        """The slopes of motion outside of any contact, at its deepest point."""
        return self._unseen.below(math.nan)

    def of(self, contact_id: int) -> Slopes:
        """Return the slopes of a contact."""
        slopes, surface = self._found.get(contact_id, (NOT_MEASURED, math.nan))
        return slopes.below(surface)

    def forget(self) -> None:
        """Drop the motion so far: the clock, or the place, has changed."""
        self._newest = NOT_MEASURED
        #: The force stood still while the probe moved on: the contact is measured no further.
        self.is_saturated = False
        self._run: _Run | None = None
        self._change = self._sign = 0.0  # of the force in the last run [N], and its direction
        self._roughness, self._last = 0.0, deque[float](maxlen=4)

    def skip(self) -> None:
        """Begin a new run: samples are missing, or the force's zero has changed."""
        self._finish()
        self._last.clear()

    def add(self, pair: Pair) -> None:
        """Add a sample, before its contact is known."""
        # The bias of the force moves all places by the shift of the surface in `assign`.
        stamp_ns, place = pair.stamp_ns, self._contact.compliance_free(pair, pair.force)
        self._last.append(place)
        if len(self._last) == 4:
            a, b, c, d = self._last
            size = abs(d - a + 3.0 * (b - c)) * _THIRD_DIFFERENCE
            self._roughness += (size - self._roughness) / 64.0
        length = max(self._least_piece, _PIECE_DEVIATIONS * self._roughness)
        run = self._run = self._run or _Run(1.0, place, stamp_ns, length)
        way = run.sign * (place - run.start)
        has_turned = way < run.open_way - run.length
        if not has_turned:
            run.add(stamp_ns, way, pair.force)
        if has_turned or run.rests(stamp_ns):
            self._finish()
            self._run = _Run(-run.sign if has_turned else run.sign, place, stamp_ns, length)
        elif run.width >= run.due_width:
            self._measure(run)

    def assign(
        self,
        contact_id: int,
        air: tuple[float, float, float, float],
        surface: float,
        *,
        in_contact: bool,
    ) -> None:
        """Assign the results after a sample to the contact of that sample.

        `air` is bias and noise of the force [N], the time of a filter [s], and the mass beyond the
        sensor [kg]; `surface` that of the contact [m], NaN where it was not seen.
        """
        bias, self._slow_noise, late, mass = air
        if mass > self._mass:
            self._newest = NOT_MEASURED  # inertia was not allowed for
        self._mass = mass
        self._delay_sd = math.hypot(self._stated_delay_sd, late)
        self._surface = surface - self._contact.series_compliance * bias
        if in_contact or self._is_continuous:
            kept = self._found.pop(contact_id, (NOT_MEASURED, 0.0))[0]
            is_newest = self._is_continuous or self.is_saturated
            slopes = self._newest if is_newest else kept.deepest(self._newest)
            self._found[contact_id] = slopes, self._surface
            if len(self._found) > 3:
                del self._found[min(self._found)]
        elif self._was_in_contact:
            self.forget()
        else:
            self._unseen, self.is_saturated = self._unseen.deepest(self._newest), False
        self._was_in_contact = in_contact

    def _finish(self) -> None:
        run, self._run = self._run, None
        if run is not None and run.width:
            change = self._measure(run)
            self._change = max(change, self._change if self._sign == run.sign else 0.0)
            self._sign = run.sign

    def _measure(self, run: _Run) -> float:
        """Measure a run in its present state; return the change of its force [N]."""
        run.due_width = run.width * (1.0 + 1.0 / _PIECES)
        columns = run.columns()
        if columns.shape[1] < _PIECES:
            return 0.0
        change = abs(float(columns[6, :3].mean() - columns[6, -3:].mean()))
        is_press = run.sign > 0.0 and run is not self._run and not self._is_continuous
        self.is_saturated |= is_press and _is_saturated(columns, change)
        if self.is_saturated:
            self._newest = NOT_MEASURED
            return change
        # The relaxation left by a creeping probe in one direction is no loading.
        left = _QUARTER * self._change if run.sign == self._sign else 0.0
        least = max(SMALL * change, left)
        columns = np.vstack([columns, self._mass * _accelerations(columns)])
        noise = self._noise, self._slow_noise
        # Without a surface there is no depth, which tells that a slope is not that of the end.
        is_end_alone = math.isnan(self._surface) and not self._is_continuous
        places = (run.sign,) if is_end_alone else (run.sign, 0.0)
        found = _best(columns, places, least, noise) if change >= least else None
        if found is None:
            return change
        run.due_width = run.width + found.width / _PIECES
        first = columns[:3, 0]
        way = run.sign * (columns[3, 0] - found.way) + 0.5 * first[0]
        elapsed = np.interp(way, np.cumsum(columns[0]), np.cumsum(columns[1]), left=0.0)
        time = first[2] + run.sign * (0.5 * first[1] - elapsed)
        stamp_ns = run.start_ns + round(float(time) * NANOSECONDS)
        # Force and place are of times that differ by the delay.
        speed = float(columns[0].sum()) / max(float(columns[1].sum()), 1.0 / NANOSECONDS)
        sd = math.hypot(found.sd, found.curve * speed * self._delay_sd)
        slope = MeasuredSlope(found.slope, sd, run.start + run.sign * found.way, stamp_ns)
        before = self._newest.unloading
        if run.sign > 0.0:
            self._newest = self._newest._replace(loading=slope)
        elif before is None or before.stamp_ns < run.start_ns:
            self._newest = self._newest._replace(unloading=slope)
        elif slope.sd < before.sd and abs(slope.value - before.value) < before.sd:
            # A wider window counts while it agrees with the narrower ones.
            self._newest = self._newest._replace(unloading=slope)
        return change
