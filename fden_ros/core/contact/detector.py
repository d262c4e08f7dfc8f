# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contact: when the probe touches, where the tissue's surface is, and when the probe leaves.

The force's bias and noise are measured in the air. A contact is a rise above the noise that the
motion explains better than a drift does. Its onset is searched for backwards, among the samples
kept from before the detection, because a threshold alone places the contact point too deep.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.contact.air import (
    LEAST_SAMPLES,
    MIN_CHUNKS,
    SLOW_NS,
    Baseline,
    Chunk,
    Chunks,
    ContactConfig,
)
from fden_ros.core.contact.surface import (
    FIRST_WINDOW,
    LEAST_EVIDENCE,
    SMALL,
    Approach,
    find_surface,
)
from fden_ros.core.noise_filter import filter_time
from fden_ros.core.streams import CHUNK_NS, NANOSECONDS, Pair

#: A chunk is not the air's from 4 deviations of a sample on. Noise counts as coloured from 1.5
#: times the white noise.
_NO_AIR, _COLOUR = 4.0, 1.5
#: From half of a contact's threshold on, a slow one may have begun: the baseline is frozen. A
#: contact ends when the mean of two chunks is below it and the probe has moved back, ...
_LOW = 0.5
#: ... or when the probe is behind the surface by this share of its deepest penetration.
_RETREAT = 0.2
#: Less than this share of the deepest penetration, or of the force detected, does not count. A
#: probe that holds still within it does not leave: the tissue relaxes. Nor do a smaller force of
#: inertia in the air, and a smaller retract of a round probe, matter.
SLIGHT = 0.05


class Onset(NamedTuple):
    """The beginning of a contact."""

    samples: tuple[Pair, ...]  #: from just before the onset to the detection
    #: The approach before these: times, counted from the first of them [s], displacements
    #: [m], compliance removed, and forces, less bias and drift [N]; shape (3, n).
    way: Array
    bias: float  #: of the force, already subtracted from the samples [N]
    #: Its standard deviation [N]; that of a stated bias is the force with which a record begins,
    #: since nothing tells for how long that had pressed.
    bias_sd: float
    drift: float  #: of the force in the air, where it is significant [N/s]
    drift_sd: float  #: its standard deviation; 0 where there is no drift [N/s]
    noise_sd: float  #: of the force, per sample [N]
    displacement: float  #: at the onset, compliance removed [m]
    displacement_sd: float  #: its standard deviation [m]
    shows_surface: bool  #: noise does not hide where the force begins
    seen: bool  #: False: the data began in contact, so the contact point is not known
    air_seen: bool  #: the data began in the air, even if they do not show the surface
    clear_force: float  #: the mean of a chunk above it is in contact [N]
    filter_time: float  #: of a filter that the noise in the air shows [s]; 0: none
    mass: float  #: beyond the sensor, whose inertia is in the force [kg]; 0: not noticeable
    #: By which the probe was off the surface [m] since presumed air turned out to be a contact.
    clearance: float = math.inf

    @property
    def release_force(self) -> float:
        """The force below which a sample is not pressing [N]."""
        return _LOW * self.clear_force


class Release(NamedTuple):
    """The end of a contact."""

    stamp_ns: int


@dataclass
class _Rise:
    """A rise of the force that may be a contact's.

    It is a drift where a contact explains it better than a straight line in time by less than
    `LEAST_EVIDENCE`. A rise that may still grow is observed until this is a `SMALL` share of the
    evidence: the longer it lasts, the better it shows the surface. It is examined again when it
    has lasted longer by that share, or has fallen by half. It was a drift when it lasted for 2
    chunks, is over, and a slow contact would have been found by then.
    """

    doubted_ns: int | None = None  #: when a drift first explained it as well
    doubted_chunks: int = 0  #: chunks above the threshold since then
    peak: float = 0.0  #: largest ratio to the threshold, since it fell last [1]
    is_doubted: bool = False  #: a drift explains it as well
    look_ns: int = 0  #: next examination


class _Press:
    """A contact until its end."""

    def __init__(self, onset: Onset, threshold: float) -> None:
        self.onset, self._deepest = onset, onset.displacement
        self._least = _LOW * threshold
        self._last: Chunk | None = None
        self._behind_chunks = 0
        #: The probe has left, and the remaining force is drift of the sensor.
        self.is_behind = False

    def add(self, chunk: Chunk, pair: Pair) -> int | None:
        """Add a chunk and its last pair; return since when the probe has left [ns], or None."""
        onset, depth = self.onset, pair.displacement - self.onset.displacement
        self._deepest = max(self._deepest, pair.displacement)
        deepest = self._deepest - onset.displacement
        if chunk.mean - onset.bias > onset.clear_force:
            # However faint its beginning, single chunks have shown the contact now.
            self._least = onset.release_force
        level = onset.bias + self._least
        is_low = chunk.mean < level
        is_behind = depth < -_RETREAT * deepest
        self._behind_chunks += is_behind
        # The chunk in which the probe leaves may be mostly contact.
        if is_behind and (is_low or self._behind_chunks > 1):
            self.is_behind = not is_low
            return chunk.start_ns
        last, self._last = self._last or chunk, chunk
        above = last.size * (last.mean - level) + chunk.size * (chunk.mean - level)
        # Until the probe moves back it is relaxation that lowers the force.
        has_left = above < 0.0 and deepest - depth >= SLIGHT * deepest
        return last.start_ns if has_left else None


class ContactDetector:
    """Distinguish contact from air, sample by sample.

    Parameters
    ----------
    fractional_order : float
        Rough alpha [1], for the shape of the onset only.
    """

    def __init__(self, config: ContactConfig, fractional_order: float) -> None:
        self._config, self._order = config, fractional_order
        self.below_baseline = 0  #: times that the force fell clearly below its baseline
        self.drifts = 0  #: times that a rise of the force turned out to be a drift
        self.has_seen_air = False  #: whether a contact began or ended in the air
        self.reset()

    def reset(self, *, keeps_contact: bool = False) -> None:
        """Forget all samples and the baseline, and the contact unless its release is to come."""
        if not keeps_contact:
            self._press: _Press | None = None
        #: Newest time at which presumed air turned out to be a contact.
        self.left_unseen_ns: int | None = None
        self._lowest = -math.inf  # displacement since then [m]
        self._samples: deque[Pair] = deque()
        self._baseline, self._chunks = Baseline(self._config), Chunks()
        self._rise, self._has_released = _Rise(), False
        self._below = 0  # chunks in a row below the baseline

    @property
    def in_contact(self) -> bool:
        """Whether the probe presses."""
        return self._press is not None

    def mean_air_force(self) -> float | None:
        """Return the mean force of the last chunks in the air [N]; None in contact or before 5."""
        return None if self.in_contact else self._baseline.mean()

    def add(self, pair: Pair) -> Onset | Release | None:
        """Add one pair; return an event if the contact begins or ends with it."""
        samples, press = self._samples, self._press
        if press is None:
            self._baseline.resolution.add(pair.force)
        samples.append(pair)
        self._lowest = min(self._lowest, pair.displacement)
        is_old = self._baseline.is_old
        while len(samples) > LEAST_SAMPLES and is_old(samples[0].stamp_ns, pair.stamp_ns):
            samples.popleft()
        chunk = self._chunks.add(pair)
        if chunk is None:
            return None
        return self._in_air(chunk) if press is None else self._in_contact(press, chunk, pair)

    # In the air

    def _in_air(self, chunk: Chunk) -> Onset | None:
        baseline, rise = self._baseline, self._rise
        air = baseline.before(chunk)
        if air is None:
            baseline.keep(chunk)
            return None
        noise, (ratio, limit) = air.white, baseline.excess(chunk)
        above = chunk.mean - baseline.bias_at(chunk.end_ns)
        beyond_noise = max(self._config.force_threshold, _NO_AIR * noise)
        clear = max(beyond_noise, float(baseline.thresholds[0]))
        is_clear, is_over = above > clear, ratio < _LOW * rise.peak
        rise.peak = max(rise.peak, ratio)
        if rise.peak > 1.0 and (is_over or chunk.end_ns >= rise.look_ns):
            approach = self._approach_until(chunk.end_ns, noise, is_clear=is_clear)
            if self._is_contact(approach, chunk.end_ns, may_grow=not (is_clear or is_over)):
                return self._begun(approach, noise, clear, clear if is_clear else limit)
        if is_over:
            rise = self._end_rise(chunk.end_ns, ratio)
        rise.doubted_chunks += rise.doubted_ns is not None and ratio >= 1.0
        baseline.is_suspected = not rise.is_doubted and ratio > _LOW
        baseline.keep(chunk)
        is_below = baseline.is_measured and above < -beyond_noise
        self._below = self._below + 1 if is_below else 0
        if self._below == 2 * MIN_CHUNKS:
            if self._config.measure_bias:
                # The chunks before were a contact, or the force has the wrong sign.
                self.below_baseline += 1
                self.left_unseen_ns = chunk.end_ns
                self._lowest = self._samples[-1].displacement
            self._below = 0
            baseline.forget_all_but(MIN_CHUNKS)
            self._samples.clear()
        return None

    def _is_contact(self, approach: Approach, now_ns: int, *, may_grow: bool) -> bool:
        """Whether a rise of the force is neither drift nor vibration."""
        if not self._baseline.is_measured:
            return True
        rise, evidence = self._rise, approach.evidence
        if self._has_released and not approach.has_advanced():
            evidence = 0.0
        lasting = float(approach.time[-1] - approach.time[approach.first])
        rise.look_ns = now_ns + round(SMALL * lasting * NANOSECONDS)
        if evidence < LEAST_EVIDENCE:
            # A drift, which rises whatever the probe does, or the beginning of a contact that is
            # still too faint.
            rise.doubted_ns = rise.doubted_ns or now_ns
            rise.is_doubted = not may_grow or now_ns - rise.doubted_ns > SLOW_NS
        ample = LEAST_EVIDENCE / (SMALL if may_grow else 1.0)
        return evidence >= ample and approach.is_established(is_clear=not may_grow)

    def _end_rise(self, now_ns: int, ratio: float) -> _Rise:
        """Drop a rise that is over, and count it as a drift if no contact followed."""
        rise = self._rise
        rise.peak = ratio
        if ratio < 1.0:
            self._rise = _Rise(rise.doubted_ns, rise.doubted_chunks)
            if rise.doubted_ns is not None and now_ns - rise.doubted_ns > SLOW_NS:
                self.drifts += rise.doubted_chunks > 1
                self._rise = _Rise()
        return self._rise

    def _approach_until(self, now_ns: int, white: float, *, is_clear: bool) -> Approach:
        """Return the samples until now, of white noise [N]."""
        pairs, baseline = self._samples, self._baseline
        start_ns, bias = pairs[0].stamp_ns, baseline.bias_at(now_ns)
        time = np.array([(pair.stamp_ns - start_ns) * 1e-9 for pair in pairs])
        force = np.array([pair.force for pair in pairs]) - bias
        force -= baseline.drift * (time - (now_ns - start_ns) * 1e-9)
        displacement = np.array([pair.displacement for pair in pairs])
        displacement -= self._config.series_compliance * force
        long = SLOW_NS / NANOSECONDS
        window = FIRST_WINDOW if is_clear else long
        approach = find_surface(time, force, displacement, self._order, 0.0, window)
        noise = baseline.level(bias, white, pairs[approach.first].stamp_ns).noise
        if noise <= _COLOUR * white:
            return approach
        # A slow swing is neither independent from sample to sample nor seen in 0.1 s.
        return find_surface(time, force, displacement, self._order, noise, long)

    def _begun(self, approach: Approach, noise: float, clear: float, limit: float) -> Onset:
        """Begin the contact of an approach; the baseline drops its samples."""
        baseline, pairs = self._baseline, self._samples
        onset_ns, is_measured = pairs[approach.first].stamp_ns, self._config.measure_bias
        bias, drift = baseline.bias_at(pairs[-1].stamp_ns), baseline.drift
        baseline.forget_since(onset_ns)
        level = baseline.level(bias, noise, onset_ns)
        air_seen = bool(approach.force[0] < clear)
        # A probe that rested until the force rose may have pressed already: its bias would
        # hide the preload.
        came = not is_measured or approach.came_through_air()
        if not self._has_released and is_measured:
            # Nor, before the first release, is it air where the force rises with the displacement,
            # as that of a tissue that is already pressed, or for so short a time: of a record
            # that began in a press of 0.1 N, 50 ms looked like air.
            came &= level.slope <= 0.0 or approach.rises_by_itself(drift, level.noise)
            came &= onset_ns - pairs[0].stamp_ns > MIN_CHUNKS * CHUNK_NS
        mass, inertia = approach.inertia(self._config.series_compliance)
        # Inertia hides the touch: the surface was found up to 5 mm too deep.
        if inertia <= SLIGHT * float(approach.force[approach.first :].max()):
            mass = 0.0
        seen = approach.first > 0 and air_seen and came and not mass
        if not (seen or self._has_released):
            # There was no air yet in which the force could drift: the rise was this contact.
            self.drifts = 0
        self.has_seen_air |= seen
        least = max(baseline.resolution.step, self._config.noise_floor)
        until = 9 * approach.first // 10
        smooth = filter_time(approach.time[:until], approach.force[:until], least)
        # A little before the onset, so that the memory begins with the air.
        first = max(approach.first - 2, 0) if seen else 0
        time, force = approach.time - approach.time[first], approach.force + (bias - level.value)
        onset = Onset(
            samples=tuple(pairs)[first:],
            way=np.array([time, approach.displacement, force])[:, :first],
            bias=level.value,
            bias_sd=level.sd if air_seen or is_measured else abs(float(approach.force[0])),
            drift=level.slope,
            drift_sd=level.slope_sd,
            noise_sd=level.noise,
            displacement=approach.surface,
            displacement_sd=approach.surface_sd,
            shows_surface=approach.shows_surface,
            seen=seen,
            air_seen=air_seen,
            clear_force=max(clear, limit),
            filter_time=smooth,
            mass=mass,
            clearance=approach.surface - self._lowest,
        )
        self._press = _Press(onset, limit)
        pairs.clear()
        self._rise, self._below, baseline.is_suspected = _Rise(), 0, False
        return onset

    # In contact

    def _in_contact(self, press: _Press, chunk: Chunk, pair: Pair) -> Release | None:
        left_ns = press.add(chunk, pair)
        if left_ns is None:
            return None
        if press.is_behind:
            self._baseline.forget_all_but(0)
        self._press, self._has_released, self.has_seen_air = None, True, True
        self._baseline.is_measured = True
        # The air at its end is the air before the next one.
        samples, least = self._samples, press.onset.bias + press.onset.release_force
        newest = (k for k, p in enumerate(samples) if p.force >= least or p.stamp_ns < left_ns)
        for _ in range(max(newest, default=-1) + 1):
            samples.popleft()
        return Release(left_ns)
