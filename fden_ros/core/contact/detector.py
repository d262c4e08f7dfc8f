# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contact: when the probe touches, where the tissue's surface is, and when the probe leaves.

In the air the force's bias and noise are measured. A rise above the noise is a contact; its true
onset is then looked for backwards, by fitting the model's own response to the samples kept from
before the detection, because a threshold alone places the strain origin too late. The pipeline
replays those samples, so nothing of the contact is lost.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.contact.air import (
    CLEAR_DEVIATIONS,
    MIN_CHUNKS,
    SLOW_NS,
    Baseline,
    Chunk,
    Chunks,
    Excess,
)
from fden_ros.core.contact.air import ContactConfig as ContactConfig
from fden_ros.core.contact.approach import Approach
from fden_ros.core.contact.release import ReleaseDetector
from fden_ros.core.contact.surface import FIRST_WINDOW, find_surface
from fden_ros.core.streams import NANOSECONDS, Pair

#: What lasts no longer than this before the first contact may be a press as well as the air [ns]:
#: a record that began in a press of 0.1 N took 50 ms of it for the air (test_faults).
_LEAST_AIR_NS = 100_000_000
#: A rise of the force that a contact explains by less than this chi-squared better than a straight
#: line in time does is a drift. One that may still grow is given time up to 200: what is seen
#: longer tells the surface better.
MIN_EVIDENCE, AMPLE_EVIDENCE = 12.0, 200.0
#: After 10 chunks in a row below the bias by more than the threshold the bias is another.
_BELOW_CHUNKS = 10
#: A rise is looked at again when it has lasted for a tenth longer, or has fallen by 30 %.
RETRY, _OVER = 0.1, 0.7
#: Such a rise was a drift when it lasted for 2 chunks, is over, and a slow contact would have been
#: told by then.
_DRIFT_CHUNKS = 2
#: Noise counts as coloured from 1.5 times the white noise; then the surface is looked for over 1 s
#: at first.
_COLOUR, LONG_WINDOW = 1.5, 1.0
#: At most this number of samples in the air is kept, whatever the sampling rate.
_MAX_LOOKBACK_SAMPLES = 40_000


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
    release_force: float = 0.0  #: below it a sample is not pressing [N]


class Release(NamedTuple):
    """The end of a contact."""

    stamp_ns: int


@dataclass
class _Rise:
    """A rise of the force that may be a contact's."""

    peak: float = 0.0  #: largest ratio to what air gives, since it fell last [1]
    is_clear: bool = False  #: a chunk was
    is_doubted: bool = False  #: a drift explains it as well
    look_ns: int = 0  #: when it is looked at again


class ContactDetector:
    """Tell contact from air, sample by sample.

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
        self._release = ReleaseDetector(self._samples)
        self._rise = _Rise()
        self._doubted_ns: int | None = None
        self._doubted_chunks = 0
        self._below = 0  # chunks in a row below the baseline

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

    # In the air

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
                onset = self._onset(approach, bias, noise, clear)
                return self._begun(onset, clear, excess)
        if is_over:
            self._end_rise(chunk.end_ns, excess.ratio)
        self._doubted_chunks += self._doubted_ns is not None and excess.ratio >= 1.0
        baseline.is_suspected = not self._rise.is_doubted and baseline.is_rising(chunk)
        baseline.keep(chunk)
        is_below = baseline.is_measured and chunk.mean - bias < -beyond_noise
        self._below = self._below + 1 if is_below else 0
        if self._below == _BELOW_CHUNKS:
            self._forget_baseline()
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
            rise.is_doubted = not may_grow or now_ns - self._doubted_ns > SLOW_NS
        if evidence < (AMPLE_EVIDENCE if may_grow else MIN_EVIDENCE):
            return False
        return approach.is_established(is_clear=not may_grow)

    def _end_rise(self, now_ns: int, ratio: float) -> None:
        """Forget a rise that is over, and count it as a drift if no contact came of it."""
        self._rise.peak = ratio
        if ratio >= 1.0:
            return
        self._rise = _Rise()
        if self._doubted_ns is not None and now_ns - self._doubted_ns > SLOW_NS:
            self.drifts += self._doubted_chunks >= _DRIFT_CHUNKS
            self._forget_rise()

    def _forget_rise(self) -> None:
        self._rise, self._doubted_ns, self._doubted_chunks = _Rise(), None, 0

    def _forget_baseline(self) -> None:
        """Measure the baseline anew: the force has stayed below it."""
        if self._config.measure_bias:
            # The chunks before were a contact, or the force has the wrong sign.
            self.below_baseline += 1
            self.left_unseen_ns = self._samples[-1].stamp_ns if self._samples else None
        self._below = 0
        self._baseline.forget_all_but(MIN_CHUNKS)
        self._samples.clear()

    @property
    def _drift_taken_off(self) -> float:
        """Drift that is taken off the force of an approach [N/s]."""
        return self._baseline.drift if self._config.measure_bias else 0.0

    def _approach_until(
        self, now_ns: int, bias: float, white: float, *, is_clear: bool
    ) -> Approach:
        """Return the samples until now, of white noise [N]."""
        pairs = self._samples
        start_ns = pairs[0].stamp_ns
        time = np.array([(pair.stamp_ns - start_ns) * 1e-9 for pair in pairs])
        force = np.array([pair.force for pair in pairs]) - bias
        force -= self._drift_taken_off * (time - (now_ns - start_ns) * 1e-9)
        displacement = np.array([pair.displacement for pair in pairs])
        displacement -= self._config.series_compliance * force
        window = FIRST_WINDOW if is_clear else LONG_WINDOW
        surface = find_surface(time, force, displacement, self._order, 0.0, window)
        onset_ns = pairs[min(surface.first, len(pairs) - 1)].stamp_ns
        level = self._baseline.level(bias, white, onset_ns)
        if level.noise > _COLOUR * white:
            # What swings slowly is neither independent from sample to sample nor seen in 0.1 s.
            surface = find_surface(
                time, force, displacement, self._order, level.noise, LONG_WINDOW
            )
        return Approach(time, force, displacement, surface)

    def _onset(self, approach: Approach, bias: float, noise: float, clear: float) -> Onset:
        """Return the contact that an approach has met; the baseline forgets what is of it."""
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
        return Onset(
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

    def _begun(self, onset: Onset, clear: float, excess: Excess) -> Onset:
        self.in_contact = True
        self._release.begin(onset.bias, onset.displacement, clear, excess)
        self._samples.clear()
        self._below = 0
        self._baseline.is_suspected = False
        return onset._replace(release_force=self._release.threshold)

    # In contact

    def _in_contact(self, chunk: Chunk, pair: Pair) -> Release | None:
        left_ns = self._release.add(chunk, pair)
        if left_ns is None:
            return None
        if self._release.is_behind:
            self._baseline.forget_all_but(0)
        self.in_contact = False
        self._has_released = self.has_seen_air = True
        self._baseline.is_measured = True
        self._release.leave()
        return Release(left_ns)
