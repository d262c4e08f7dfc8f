# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contact: when the probe touches, where the tissue's surface is, and when the probe leaves.

In the air the force's bias and noise are measured. A rise above the noise is a contact; its true
onset is then looked for backwards, by fitting the model's own response to the samples kept from
before the detection, because a threshold alone places the strain origin too late. The pipeline
replays those samples, so nothing of the contact is lost.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.contact.air import CHUNK_NS, MIN_CHUNKS, Baseline, Chunk, Chunks, Excess
from fden_ros.core.contact.air import ContactConfig as ContactConfig
from fden_ros.core.contact.surface import FIRST_WINDOW, Surface, find_surface
from fden_ros.core.streams.samples import NANOSECONDS, Pair

#: A probe has come to the surface through the air when its way there is more than this many
#: deviations of the surface, and than this many usual steps of the displacement: noise
#: alone reaches six.
_APPROACH_DEVIATIONS, _APPROACH_STEPS = 5.0, 10.0
#: After a release a probe that has not advanced touches nothing. It has by more than 6 usual
#: second differences, 10 deviations of white noise, whose range in 10,000 samples is 8, and than
#: 2 of the smallest steps of its encoder.
_ADVANCE_NOISE, _ADVANCE_STEPS = 6.0, 2.0
#: How the force swings while the probe moves is known after 0.2 s in which it moved at 0.3 of its
#: present speed; before that a rise must last for 0.15 s from a tenth of its depth on: then one
#: half of a vibration of 5 Hz is over.
_MOTION_TIME, _MOTION_SHARE = 0.2, 0.3
LASTING_TIME, _SHALLOW = 0.15, 0.1
#: The force rises by itself where a line in time explains it better than one in the way does, by
#: this chi-squared.
_BY_ITSELF = 4.0


class Approach(NamedTuple):
    """The samples of the lookback, and the surface that explains the newest."""

    time: Array  #: [s]
    force: Array  #: less bias and drift [N]
    displacement: Array  #: compliance removed [m]
    surface: Surface

    def came_through_air(self) -> bool:
        """Whether the probe came to the surface through the air."""
        before = self.displacement[: self.surface.first]
        if before.size < 2:
            return False
        noise = float(np.median(np.abs(np.diff(before))))
        way = self.surface.displacement - float(before.min())
        return way > max(
            _APPROACH_DEVIATIONS * self.surface.displacement_sd, _APPROACH_STEPS * noise
        )

    def has_advanced(self) -> bool:
        """Whether the probe has moved in since the release, by more than the displacement's noise.

        What moves evenly has no second differences; of noise they are 1.65 deviations.
        """
        way = self.displacement
        steps = np.abs(np.diff(way))
        noise = float(np.median(np.abs(np.diff(way, n=2)))) if way.size > 2 else 0.0
        step = float(steps[steps > 0.0].min(initial=math.inf))
        advance = float(np.max(way - np.minimum.accumulate(way)))
        return advance > max(_ADVANCE_NOISE * noise, _ADVANCE_STEPS * step)

    def rises_by_itself(self, drift: float, noise: float) -> bool:
        """Whether time explains the force before the touch, and not the way of the probe.

        Tissue that was pressed already would push more as the probe advances, and less at rest.
        `drift` [N/s] was taken off the force, whose noise per sample is `noise` [N].
        """
        time, way = (values[: self.surface.first] for values in (self.time, self.displacement))
        force = self.force[: self.surface.first] + drift * time
        if way.size < 3 or np.ptp(way) == 0.0:
            return False
        explained = [np.corrcoef(force, by)[0, 1] ** 2 for by in (time, way)]
        better = float(explained[0] - explained[1]) * force.size * float(np.var(force))
        return better > _BY_ITSELF * noise**2

    def began_in_air(self, threshold: float, rest: float) -> bool:
        """Whether no force was there [N] when the data began, or none for `rest` [s] since."""
        if self.force[0] < threshold:
            return True
        first = min(self.surface.first, self.time.size - 1)
        pressed = np.flatnonzero(self.force[:first] >= threshold)
        return bool(pressed.size) and float(self.time[first] - self.time[pressed[-1]]) > rest

    @property
    def lasting(self) -> float:
        """Since when the probe is behind the surface [s]."""
        return float(self.time[-1] - self.time[min(self.surface.first, self.time.size - 1)])

    def is_established(self, *, is_clear: bool) -> bool:
        """Whether the present rise can be no swing of a force that is shaken by the motion.

        It has lasted, or the probe has moved as fast before and the force's swing is known.
        """
        time, first = self.time, min(self.surface.first, self.time.size - 1)
        depth = self.displacement - self.surface.displacement
        # Where the probe rested, the surface may have been found anywhere in that time.
        shallow = np.flatnonzero(depth[first:] < _SHALLOW * depth[-1])
        if shallow.size:
            first += int(shallow[-1])
        lasting = float(time[-1] - time[first])
        if lasting > LASTING_TIME or not is_clear:
            return lasting > LASTING_TIME
        instants = np.arange(time[first], time[0], -CHUNK_NS / NANOSECONDS)
        places = np.interp(instants, time, self.displacement)
        speed = abs(float(depth[-1] - depth[first])) / max(lasting, CHUNK_NS / NANOSECONDS)
        moved = np.abs(np.diff(places)) * NANOSECONDS / CHUNK_NS
        moving = np.count_nonzero(moved >= _MOTION_SHARE * speed)
        return bool(moving * CHUNK_NS > _MOTION_TIME * NANOSECONDS)


#: What lasts no longer than this before the first contact may be a press as well as the air [ns]:
#: a record that began in a press of 0.1 N took 50 ms of it for the air (test_faults).
_LEAST_AIR_NS = 100_000_000


class Onset(NamedTuple):
    """The beginning of a contact."""

    samples: tuple[Pair, ...]  #: from just before the onset to the detection
    #: The way of the probe before these: times, counted from the first of them [s], displacements
    #: [m], compliance removed, and forces, less bias and drift [N]; shape (3, n).
    way: Array
    bias: float  #: of the force, already subtracted from the samples [N]
    bias_sd: float  #: its standard deviation [N]
    drift: float  #: of the force in the air, where it is significant [N/s]
    drift_sd: float  #: its standard deviation; 0 where there is no drift [N/s]
    noise_sd: float  #: of the force, per sample [N]
    displacement: float  #: at the onset, compliance removed [m]
    displacement_sd: float  #: its standard deviation [m]
    shows_surface: bool  #: noise does not hide where the force begins
    seen: bool  #: False: the force was there when the data began, so the origin is not known
    air_seen: bool  #: the data began in the air, even if the surface is not to be seen in them


class Release(NamedTuple):
    """The end of a contact."""

    stamp_ns: int


class _Highest(NamedTuple):
    """The highest mean force of a chunk in the air, and where the probe was then."""

    stamp_ns: int
    force: float  #: [N]
    displacement: float  #: [m]


@dataclass
class _Rise:
    """A rise of the force that may be a contact's."""

    peak: float = 0.0  #: largest ratio to what air gives, since it fell last [1]
    is_clear: bool = False  #: a chunk was
    is_doubted: bool = False  #: a drift explains it as well
    look_ns: int = 0  #: when it is looked at again


#: The probe is no longer pressing below half the threshold.
_RELEASE_SHARE = 0.5
#: A contact ends when the mean is below that over as many chunks as told it, at least 2.
_RELEASE_CHUNKS = 2
#: A rise of the force that a contact explains by less than this chi-squared better than a straight
#: line in time does is a drift. One that may still grow is given time up to 200: what is seen
#: longer tells the surface better.
MIN_EVIDENCE, AMPLE_EVIDENCE = 12.0, 200.0
#: A rise is looked at again when it has lasted for a tenth longer, or has fallen by 30 %.
RETRY, _OVER = 0.1, 0.7
#: Such a rise was a drift when it lasted for 2 chunks, is over, and no contact has come of it
#: within 1 s [ns].
_DRIFT_CHUNKS, _DOUBT_NS = 2, 1_000_000_000
#: After 10 chunks in a row that lie below the bias by more than the threshold the baseline is
#: measured anew.
_BELOW_BASELINE_CHUNKS = 10
#: A force that falls by 12 thresholds within a minute while the probe advances has the wrong sign,
#: however slowly it falls. (The baseline follows a slow one.)
_FALL_THRESHOLDS = 12.0
#: That minute [ns].
_FALL_NS = 60 * NANOSECONDS
#: A rise for 5 chunks that the floor of the noise hides may be a press.
_HIDDEN_CHUNKS = 5
#: A sample clearly is not the air's from 4 standard deviations of the noise per sample on.
CLEAR_DEVIATIONS = 4.0
#: Noise counts as coloured from 1.5 times the white noise; then the surface is looked for over 1 s
#: at first.
_COLOUR, LONG_WINDOW = 1.5, 1.0
#: The probe is off the tissue when it has retreated behind the surface by this share of its
#: deepest penetration.
_RETREAT = 0.2
#: It holds still within this share of that of its deepest place.
_HELD = 0.05
#: At most this number of samples in the air is kept, whatever the sampling rate.
_MAX_LOOKBACK_SAMPLES = 40_000


class ContactDetector:
    """Tell contact from air, sample by sample.

    Parameters
    ----------
    config : ContactConfig
    fractional_order : float
        Rough alpha [1], for the shape of the onset only.
    """

    def __init__(self, config: ContactConfig, fractional_order: float) -> None:
        self._config = config
        self._order = fractional_order
        self.in_contact = False
        self.below_baseline = 0  #: times that the force fell clearly below its baseline
        self.drifts = 0  #: times that a rise of the force turned out to be a drift
        self.has_seen_air = False  #: whether a contact began or ended in the air
        #: The air's own noise per sample [N] where the floor hid a press; 0: it hid none.
        self.hidden_above = 0.0
        self.force_bias = 0.0  #: subtracted from the force of the current contact [N]
        self.release_threshold = 0.0  #: force of a sample that is not pressing [N]
        self.reset()

    def reset(self) -> None:
        """Forget all samples, the baseline and the contact."""
        self.in_contact = False
        #: Newest time at which what was taken for the air turned out to be a contact.
        self.left_unseen_ns: int | None = None
        self._samples: deque[Pair] = deque(maxlen=_MAX_LOOKBACK_SAMPLES)
        self._baseline = Baseline(self._config)
        self._chunks = Chunks()
        self._has_released = False
        self._began_ns: int | None = None
        self._clear = self._low_threshold = 0.0
        self._newest: deque[Chunk] = deque()
        self._averaged = _RELEASE_CHUNKS
        self._chunks_below = 0
        self._rise = _Rise()
        self._doubted_ns: int | None = None
        self._doubted_chunks = 0
        self._surface = self._deepest = 0.0
        self._behind_chunks = 0
        self._has_held = False
        self._highest: _Highest | None = None
        self._hidden_chunks, self._is_touch_hidden = 0, False

    def mean_air_force(self) -> float | None:
        """Return the mean force of the last chunks in the air [N]; None in contact or before 5."""
        return None if self.in_contact else self._baseline.mean()

    def add(self, pair: Pair) -> Onset | Release | None:
        """Take one pair; return an event if the contact begins or ends with it."""
        if self._began_ns is None:
            self._began_ns = pair.stamp_ns
        if not self.in_contact:
            self._remember(pair)
            self._baseline.resolution.add(pair.force)
        else:
            self._samples.append(pair)
        chunk = self._chunks.add(pair)
        if chunk is None:
            return None
        return self._in_contact(chunk, pair) if self.in_contact else self._in_air(chunk)

    def _remember(self, pair: Pair) -> None:
        samples = self._samples
        while samples and samples[-1].stamp_ns > pair.stamp_ns:
            samples.pop()  # the clock has jumped back
        samples.append(pair)
        oldest_allowed = pair.stamp_ns - self._baseline.reach_ns
        while samples[0].stamp_ns < oldest_allowed:
            samples.popleft()

    def _in_air(self, chunk: Chunk) -> Onset | None:
        baseline = self._baseline
        air = baseline.before(chunk)
        if air is None:
            baseline.keep(chunk)
            return None
        noise = baseline.noise_of(air)
        bias = baseline.bias_at(chunk.end_ns)
        excess = baseline.excess(chunk)
        beyond_noise = max(self._config.force_threshold, CLEAR_DEVIATIONS * noise)
        clear = max(beyond_noise, baseline.threshold_of_chunk)
        is_clear = chunk.mean - bias > clear
        rise = self._rise
        is_over = excess.ratio < _OVER * rise.peak
        is_news = is_over or (is_clear and not rise.is_clear)
        rise.peak = max(rise.peak, excess.ratio)
        rise.is_clear |= is_clear
        if rise.peak > 1.0 and (is_news or chunk.end_ns >= rise.look_ns):
            approach = self._approach_until(chunk.end_ns, bias, noise, is_clear=is_clear)
            if self._is_contact(approach, chunk.end_ns, may_grow=not (is_clear or is_over)):
                self._forget_rise()
                if is_clear:
                    excess = Excess(1.0, clear, 1)
                return self._begin(approach, bias, noise, clear, excess)
        self._watch_floor(chunk, baseline.own_noise_of(air), bias)
        if is_over:
            self._end_rise(chunk.end_ns, excess.ratio)
        self._doubted_chunks += self._doubted_ns is not None and excess.ratio >= 1.0
        baseline.is_suspected = not self._rise.is_doubted and baseline.is_rising(chunk)
        baseline.keep(chunk)
        self._watch_below_baseline(chunk.mean - bias < -beyond_noise)
        self._watch_fall(chunk, clear)
        return None

    def _is_contact(self, approach: Approach, now_ns: int, *, may_grow: bool) -> bool:
        """Whether a rise of the force is told from a drift and from a swing."""
        if not self._baseline.is_measured:
            return True
        rise, evidence = self._rise, approach.surface.evidence
        if self._has_released and not approach.has_advanced():
            evidence = 0.0
        rise.look_ns = now_ns + round(RETRY * approach.lasting * NANOSECONDS)
        if evidence < MIN_EVIDENCE:
            # A drift, which rises whatever the probe does; or the beginning of a contact that is
            # too faint to tell yet.
            if self._doubted_ns is None:
                self._doubted_ns = now_ns
            rise.is_doubted = not may_grow or now_ns - self._doubted_ns > _DOUBT_NS
        if evidence < (AMPLE_EVIDENCE if may_grow else MIN_EVIDENCE):
            return False
        return approach.is_established(is_clear=not may_grow)

    def _end_rise(self, now_ns: int, ratio: float) -> None:
        """Forget a rise that is over, and count it as a drift if no contact came of it."""
        self._rise.peak = ratio
        if ratio >= 1.0:
            return
        self._rise = _Rise()
        if self._doubted_ns is not None and now_ns - self._doubted_ns > _DOUBT_NS:
            self.drifts += self._doubted_chunks >= _DRIFT_CHUNKS
            self._forget_rise()

    def _forget_rise(self) -> None:
        self._rise = _Rise()
        self._doubted_ns = None
        self._doubted_chunks = 0

    def _watch_below_baseline(self, below: bool) -> None:
        self._chunks_below = self._chunks_below + 1 if below and self._baseline.is_measured else 0
        if self._chunks_below < _BELOW_BASELINE_CHUNKS:
            return
        if self._config.measure_bias:
            # The chunks before were a contact, or the force has the wrong sign.
            self.below_baseline += 1
            self.left_unseen_ns = self._samples[-1].stamp_ns if self._samples else None
        self._chunks_below = 0
        self._highest = None
        self._baseline.forget_all_but(MIN_CHUNKS)
        self._samples.clear()

    def _watch_floor(self, chunk: Chunk, own: float, bias: float) -> None:
        """Take note of a touch that the air's own noise [N] would show, and its floor hides.

        It is one where the force follows the way, and no contact has come of it when it is over.
        """
        config = self._config
        if config.force_noise or not 0.0 < own < config.noise_floor:
            return
        if chunk.mean - bias <= CLEAR_DEVIATIONS * own:
            if self._is_touch_hidden:
                self.hidden_above = own
            self._hidden_chunks, self._is_touch_hidden = 0, False
            return
        self._hidden_chunks += 1
        if self._hidden_chunks == _HIDDEN_CHUNKS:
            approach = self._approach_until(chunk.end_ns, bias, own, is_clear=True, is_bare=True)
            evidence = approach.surface.evidence
            self._is_touch_hidden = evidence >= MIN_EVIDENCE and approach.has_advanced()

    def _watch_fall(self, chunk: Chunk, threshold: float) -> None:
        """Count a force that falls as the probe advances; it is not taken for anything else."""
        if not self._samples:
            return
        displacement, highest = self._samples[-1].displacement, self._highest
        is_old = highest is not None and chunk.end_ns - highest.stamp_ns > _FALL_NS
        if highest is None or is_old or chunk.mean > highest.force:
            self._highest = _Highest(chunk.end_ns, chunk.mean, displacement)
            return
        fell = highest.force - chunk.mean > _FALL_THRESHOLDS * threshold
        if fell and displacement > highest.displacement:
            self.below_baseline += 1
            self._highest = None

    @property
    def _drift_taken_off(self) -> float:
        """Drift that is taken off the force of an approach [N/s]."""
        return self._baseline.drift if self._config.measure_bias else 0.0

    def _approach_until(
        self, now_ns: int, bias: float, white: float, *, is_clear: bool, is_bare: bool = False
    ) -> Approach:
        """Return the samples until now; `is_bare`: by the white noise [N] alone."""
        pairs = self._samples
        start_ns = pairs[0].stamp_ns
        time = np.array([(pair.stamp_ns - start_ns) * 1e-9 for pair in pairs])
        force = np.array([pair.force for pair in pairs]) - bias
        force -= self._drift_taken_off * (time - (now_ns - start_ns) * 1e-9)
        displacement = np.array([pair.displacement for pair in pairs])
        displacement -= self._config.series_compliance * force
        window = FIRST_WINDOW if is_clear else LONG_WINDOW
        surface = find_surface(time, force, displacement, self._order, 0.0, window)
        level = self._baseline.level(
            bias, white, pairs[min(surface.first, len(pairs) - 1)].stamp_ns
        )
        if level.noise > _COLOUR * white and not is_bare:
            # What swings slowly is neither independent from sample to sample nor seen in 0.1 s.
            surface = find_surface(
                time, force, displacement, self._order, level.noise, LONG_WINDOW
            )
        return Approach(time, force, displacement, surface)

    def _begin(
        self, approach: Approach, bias: float, noise: float, clear: float, excess: Excess
    ) -> Onset:
        pairs, surface = self._samples, approach.surface
        onset_ns = pairs[min(surface.first, len(pairs) - 1)].stamp_ns
        self._baseline.forget_since(onset_ns)
        level = self._baseline.level(bias, noise, onset_ns)
        air_seen = approach.began_in_air(clear, self._config.site_timeout)
        # A probe that rested there until the force rose may have pressed already: its bias would
        # hide the preload.
        came = not self._config.measure_bias or approach.came_through_air()
        # Nor is it air, before the first release, where the force rises with the way.
        if level.slope > 0.0 and not self._has_released:
            came &= approach.rises_by_itself(self._drift_taken_off, level.noise)
        if self._config.measure_bias and not self._has_released:
            assert self._began_ns is not None
            came &= onset_ns - self._began_ns > _LEAST_AIR_NS
        seen = surface.first > 0 and air_seen and came
        if not (seen or self._has_released):
            # There was no air yet in which the force could drift: what rose was this contact.
            self.drifts = 0
        self.has_seen_air |= seen
        # A little before the onset, so that the memory begins with the air.
        first = max(surface.first - 2, 0) if seen else 0
        way = (approach.time - approach.time[first], approach.displacement, approach.force)
        onset = Onset(
            samples=tuple(pairs)[first:],
            way=np.array(way)[:, :first] + np.array([[0.0], [0.0], [bias - level.value]]),
            bias=level.value,
            bias_sd=level.sd,
            drift=level.slope,
            drift_sd=level.slope_sd,
            noise_sd=level.noise,
            displacement=surface.displacement,
            displacement_sd=surface.displacement_sd,
            shows_surface=surface.is_seen,
            seen=seen,
            air_seen=air_seen,
        )
        self.in_contact = True
        self.force_bias = level.value
        self._clear = max(clear, excess.threshold)
        self.release_threshold = _RELEASE_SHARE * self._clear
        self._low_threshold = _RELEASE_SHARE * excess.threshold
        self._newest.clear()
        self._averaged = max(excess.scale, _RELEASE_CHUNKS)
        self._samples.clear()
        self._chunks_below = self._hidden_chunks = 0
        self._is_touch_hidden = False
        self._baseline.is_suspected = False
        self._behind_chunks = 0
        self._surface = self._deepest = surface.displacement
        return onset

    def _in_contact(self, chunk: Chunk, pair: Pair) -> Release | None:
        self._deepest = max(self._deepest, pair.displacement)
        if chunk.mean - self.force_bias > self._clear:
            self._tell_by_chunks()
        retreat = self._surface - pair.displacement
        level = self.force_bias + self._low_threshold
        is_low = chunk.mean < level
        is_behind = retreat > _RETREAT * (self._deepest - self._surface)
        self._behind_chunks += is_behind
        # The chunk in which the probe leaves may still be full of contact.
        if is_behind and (is_low or self._behind_chunks > 1):
            if not is_low:
                # Behind the surface there is no tissue: the force left is drift of the sensor.
                self._baseline.forget_all_but(0)
            return self._release(chunk.start_ns)
        newest = self._newest
        newest.append(chunk)
        while len(newest) > self._averaged:
            newest.popleft()
        while self._samples[0].stamp_ns < newest[0].start_ns:
            self._samples.popleft()
        mean = math.fsum(one.size * one.mean for one in newest) / sum(one.size for one in newest)
        if len(newest) < self._averaged or mean >= level or self._is_held(pair):
            return None
        return self._release(newest[0].start_ns)

    def _is_held(self, pair: Pair) -> bool:
        """Whether it is the tissue's relaxation that lowers the force, and no release.

        Under a probe that holds still at its deepest it is, in the newer half of what is averaged;
        from then on until the probe moves back.
        """
        least = self._deepest - _HELD * (self._deepest - self._surface)
        if pair.displacement <= least:
            return False
        self._has_held |= self._samples[len(self._samples) // 2].displacement > least
        return self._has_held

    def _tell_by_chunks(self) -> None:
        """End a contact, however faintly it began, as one that single chunks have told."""
        self._averaged = _RELEASE_CHUNKS
        self._low_threshold = self.release_threshold

    def _release(self, stamp_ns: int) -> Release:
        self.in_contact = False
        self._has_released = self.has_seen_air = True
        self._baseline.is_measured = True
        self._highest = None
        # What is air at the end of a contact is air before the next one.
        pressing = self.force_bias + self.release_threshold
        pressed = (k for k, p in enumerate(self._samples) if p.force >= pressing)
        last = max(pressed, default=-1)
        for _ in range(last + 1):
            self._samples.popleft()
        return Release(stamp_ns)
