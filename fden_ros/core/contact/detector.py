"""Contact: when the probe touches, where the tissue's surface is, and when the probe leaves.

In the air the force's bias and noise are measured. A rise above the noise is a contact; its true
onset is then looked for backwards, by fitting the model's own response to the samples kept from
before the detection, because a threshold alone places the strain origin too late. The pipeline
replays those samples, so nothing of the contact is lost.
"""

from __future__ import annotations

import math
import sys
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gamma

from fden_ros.core.streams.samples import NANOSECONDS, Pair, Position

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ContactConfig:
    """When a contact begins and ends, and when it is at a new site.

    Parameters
    ----------
    force_threshold : float
        Force above its bias that is a contact [N]; 0: four standard deviations of the measured
        noise.
    measure_bias : bool
        Take the force's bias from each approach. False: the force is trusted as it is (after any
        tare).
    force_noise : float
        Standard deviation of the force per sample [N]; 0: measured in the air.
    noise_floor : float
        Least force noise that is believed [N], so that a quantised or noise-free signal does not
        look perfect.
    lookback : float
        How far before its detection the onset is looked for [s].
    site_distance : float
        Lateral distance beyond which a contact is at a new site [m]; needs positions.
    site_timeout : float
        Time in the air after which a contact is at a new site, where there are no positions [s].
    approach_axis : tuple of float
        Unit vector into the tissue, in the frame of the positions.
    series_compliance : float
        Compliance of tool and robot in series with the tissue [m/N].
    """

    force_threshold: float = 0.0
    measure_bias: bool = True
    force_noise: float = 0.0
    noise_floor: float = 1e-5
    lookback: float = 5.0
    site_distance: float = 0.005
    site_timeout: float = 2.0
    approach_axis: Position = (0.0, 0.0, 1.0)
    series_compliance: float = 0.0


class Onset(NamedTuple):
    """The beginning of a contact."""

    samples: tuple[Pair, ...]  #: from just before the onset to the detection
    bias: float  #: of the force, already subtracted from the samples [N]
    bias_sd: float  #: its standard deviation [N]
    drift: float  #: of the force in the air, where it can be told from none [N/s]
    drift_sd: float  #: its standard deviation; 0 where there is no drift [N/s]
    noise_sd: float  #: of the force, per sample [N]
    displacement: float  #: at the onset, compliance removed [m]
    displacement_sd: float  #: its standard deviation [m]
    seen: bool  #: False: the force was there when the data began, so the origin is not known
    air_seen: bool  #: the data began in the air, even if the surface is not to be seen in them


class Release(NamedTuple):
    """The end of a contact."""

    stamp_ns: int


class _Chunk(NamedTuple):
    """Some 20 ms of force: enough to average, short enough to react."""

    size: int
    start_ns: int
    end_ns: int
    mean: float
    square_sum: float  #: of deviations from the mean


class _Air(NamedTuple):
    """What the force is in the air."""

    mean: float  #: [N]
    noise: float  #: standard deviation per sample, slow changes included [N]
    fast_noise: float  #: the same without slow changes [N]
    size: int  #: samples behind it


_CHUNK_NS = 20_000_000
_CHUNK_SAMPLES = 3
_MIN_CHUNKS = 5
#: The air's noise is known from so many samples, or chunks of a slow sensor: from fewer it may
#: come out so small that noise looks like a contact.
_MIN_AIR_SAMPLES = 48
_ENOUGH_CHUNKS = 12
#: The newest chunks may hold the beginning of a slow contact: they do not count as air yet.
_LAG_NS = NANOSECONDS
#: The air's force is measured anew after this many chunks.
_AIR_EVERY = 8
_RELEASE_CHUNKS = 2
#: The force lately, over so long, and so many standard deviations above the air's, is a contact
#: perhaps: then the air before it is remembered for so many times the lookback.
_RECENT_NS = 400_000_000
_RISE_DEVIATIONS = 6.0
_SLOW_LOOKBACKS = 4
#: The noise counts as coloured when the chunks' means differ by so much more than chance.
_COLOUR_DEVIATIONS = 4.0
#: A trend of the force in the air counts from this many standard deviations.
_DRIFT_DEVIATIONS = 4.0
#: Less chi-squared in favour of a contact, and a rise of the force is taken for a drift ...
_MIN_EVIDENCE = 12.0
#: ... and looked at again when it has grown by this factor.
_RETRY = 1.25
_BELOW_BASELINE_CHUNKS = 10
_THRESHOLD_DEVIATIONS = 4.0
#: Where the noise is coloured, the chunks' means scatter hardly less than the samples.
_THRESHOLD_DEVIATIONS_OF_MEANS = 6.0
#: The probe is off the tissue when it has retreated behind the surface by this share of its
#: deepest penetration.
_RETREAT = 0.2
#: The samples in the air are kept within this bound, whatever the sampling rate.
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
        self._lookback_ns = round(config.lookback * NANOSECONDS)
        self.in_contact = False
        self.below_baseline = 0  #: times that the force fell clearly below its baseline
        self.drifts = 0  #: times that a rise of the force turned out to be a drift
        self.force_bias = 0.0  #: subtracted from the force of the current contact [N]
        self.release_threshold = 0.0  #: force below which the probe is no longer pressing [N]
        self.reset()

    def reset(self) -> None:
        """Forget everything but what the configuration says."""
        self.in_contact = False
        self._samples: deque[Pair] = deque(maxlen=_MAX_LOOKBACK_SAMPLES)
        self._chunks: deque[_Chunk] = deque()
        self._chunks_in_air = 0
        self._air: _Air | None = None
        self._trend = _Level(0.0, 0.0, 0.0)
        self._trend_end_ns = 0
        self._means_sd = 0.0
        self._open: list[float] = []
        self._open_start_ns = 0
        self._low_chunks = 0
        self._low_start_ns = 0
        self._doubted_rise = 0.0
        self._suspected = False
        self._surface = self._deepest = 0.0
        self._behind_chunks = 0

    def compliance_free(self, pair: Pair, force: float) -> float:
        """Return the displacement of the tissue's surface [m], without the tool's own give."""
        return pair.displacement - self._config.series_compliance * force

    def mean_air_force(self) -> float | None:
        """Return the mean force of late in the air [N]; None in contact, or if not known yet."""
        if self.in_contact or len(self._chunks) < _MIN_CHUNKS:
            return None
        return _air_of(tuple(self._chunks)).mean

    def add(self, pair: Pair) -> Onset | Release | None:
        """Take one pair; return an event if the contact begins or ends with it."""
        if not self.in_contact:
            self._remember(pair)
        chunk = self._close_chunk(pair)
        if chunk is None:
            return None
        return self._in_contact(chunk, pair) if self.in_contact else self._in_air(chunk)

    def _remember(self, pair: Pair) -> None:
        samples = self._samples
        samples.append(pair)
        oldest_allowed = pair.stamp_ns - self._reach_ns()
        while samples[0].stamp_ns < oldest_allowed:
            samples.popleft()

    def _reach_ns(self) -> int:
        """Return how far back the air is remembered: longer while a slow contact may be on."""
        return self._lookback_ns * (_SLOW_LOOKBACKS if self._suspected else 1)

    def _close_chunk(self, pair: Pair) -> _Chunk | None:
        values = self._open
        if not values or pair.stamp_ns < self._open_start_ns:
            # A clock that jumped back leaves a chunk without an end.
            values.clear()
            self._open_start_ns = pair.stamp_ns
        values.append(pair.force)
        if len(values) < _CHUNK_SAMPLES or pair.stamp_ns - self._open_start_ns < _CHUNK_NS:
            return None
        mean = math.fsum(values) / len(values)
        chunk = _Chunk(
            len(values),
            self._open_start_ns,
            pair.stamp_ns,
            mean,
            math.fsum((v - mean) ** 2 for v in values),
        )
        values.clear()
        return chunk

    def _in_air(self, chunk: _Chunk) -> Onset | None:
        air = self._air_before(chunk)
        if air is None:
            self._keep(chunk)
            return None
        noise = self._config.force_noise or max(air.fast_noise, self._config.noise_floor)
        threshold = max(
            self._config.force_threshold,
            _THRESHOLD_DEVIATIONS * noise,
            _THRESHOLD_DEVIATIONS_OF_MEANS * self._means_sd,
        )
        bias = self._bias_at(chunk.end_ns) if self._config.measure_bias else 0.0
        rise = chunk.mean - bias
        if rise > max(threshold, _RETRY * self._doubted_rise):
            onset = self._begin(bias, threshold, chunk.end_ns)
            if onset is not None:
                return onset
            # A force that rises in a straight line, whatever the probe does, is a drift.
            self.drifts += self._doubted_rise == 0.0
            self._doubted_rise = rise
        elif rise < threshold:
            self._doubted_rise = 0.0
        self._keep(chunk)
        self._suspected = self._doubted_rise == 0.0 and self._is_rising(bias, noise)
        self._watch_below_baseline(rise < -threshold)
        return None

    def _keep(self, chunk: _Chunk) -> None:
        chunks = self._chunks
        chunks.append(chunk)
        self._chunks_in_air += 1
        while chunk.start_ns - chunks[0].start_ns > self._reach_ns():
            chunks.popleft()

    def _is_rising(self, bias: float, noise: float) -> bool:
        """Whether the force has lately been above the air's by more than chance."""
        newest_ns = self._chunks[-1].end_ns
        size, total = 0, 0.0
        for chunk in reversed(self._chunks):
            if newest_ns - chunk.start_ns > _RECENT_NS:
                break
            size += chunk.size
            total += chunk.size * chunk.mean
        if size == 0:
            return False
        return total / size - bias > noise * max(1.0, _RISE_DEVIATIONS / math.sqrt(size))

    def _air_before(self, chunk: _Chunk) -> _Air | None:
        """Return what the air's force was before `chunk`, None while it is not known."""
        count = len(self._chunks)
        if not self._is_air_known():
            config = self._config
            told = not config.measure_bias and (config.force_noise or config.force_threshold)
            return _air_of(tuple(self._chunks)) if told else None
        # Not while a slow contact may be on, or the baseline would creep along with it.
        if self._air is None or (not self._suspected and self._chunks_in_air % _AIR_EVERY == 0):
            newest_ns = chunk.start_ns - _LAG_NS
            old = tuple(c for c in self._chunks if c.end_ns <= newest_ns)
            old = max(old, tuple(self._chunks)[: -(-count // 2)], key=len)
            self._air = _air_of(old)
            self._trend = _level_at_end(old, self._air, _noise_of_means(old, self._air))
            self._trend_end_ns = old[-1].end_ns
            self._means_sd = float(np.std(np.diff([c.mean for c in old]))) / math.sqrt(2.0)
        return self._air

    def _bias_at(self, stamp_ns: int) -> float:
        """Return the force without contact [N], extrapolated."""
        elapsed = (stamp_ns - self._trend_end_ns) / NANOSECONDS
        return self._trend.value + self._trend.slope * elapsed

    def _is_air_known(self) -> bool:
        count = len(self._chunks)
        if count < _MIN_CHUNKS:
            return False
        return (
            count >= _ENOUGH_CHUNKS
            or sum(chunk.size for chunk in self._chunks) >= _MIN_AIR_SAMPLES
        )

    def _watch_below_baseline(self, below: bool) -> None:
        self._low_chunks = self._low_chunks + 1 if below and self._config.measure_bias else 0
        if self._low_chunks < _BELOW_BASELINE_CHUNKS:
            return
        # What was taken for air was a contact, or the force has the wrong sign.
        self.below_baseline += 1
        self._low_chunks = 0
        recent = tuple(self._chunks)[-_MIN_CHUNKS:]
        self._air = None
        self._chunks.clear()
        self._chunks.extend(recent)
        self._samples.clear()

    def _begin(self, bias: float, threshold: float, now_ns: int) -> Onset | None:
        pairs = self._samples
        start_ns = pairs[0].stamp_ns
        time = np.array([(pair.stamp_ns - start_ns) * 1e-9 for pair in pairs])
        force = np.array([pair.force for pair in pairs]) - bias
        if self._config.measure_bias:
            force -= self._trend.slope * (time - (now_ns - start_ns) * 1e-9)
        displacement = np.array([pair.displacement for pair in pairs])
        displacement -= self._config.series_compliance * force
        surface = find_surface(time, force, displacement, self._order)
        if self._config.measure_bias and surface.evidence < _MIN_EVIDENCE:
            return None
        self._forget_since(pairs[min(surface.first, len(pairs) - 1)].stamp_ns)
        level = self._level(bias)
        air_seen = float(force[0]) < threshold
        seen = surface.first > 0 and air_seen
        # A little before the onset, so that the memory begins with the air.
        first = max(surface.first - 2, 0) if seen else 0
        onset = Onset(
            samples=tuple(pairs)[first:],
            bias=level.value,
            bias_sd=level.sd,
            drift=level.slope,
            drift_sd=level.slope_sd,
            noise_sd=level.noise,
            displacement=surface.displacement,
            displacement_sd=surface.displacement_sd,
            seen=seen,
            air_seen=air_seen,
        )
        self.in_contact = True
        self.force_bias = level.value
        self.release_threshold = 0.5 * threshold
        self._samples.clear()
        self._low_chunks = 0
        self._suspected = False
        self._behind_chunks = 0
        self._surface = self._deepest = surface.displacement
        return onset

    def _forget_since(self, stamp_ns: int) -> None:
        """Drop the chunks that reach into the contact."""
        chunks = self._chunks
        while chunks and chunks[-1].end_ns >= stamp_ns:
            chunks.pop()
        self._air = None

    def _level(self, bias: float) -> _Level:
        """Return what the force is without contact, from the air before it."""
        config = self._config
        chunks = tuple(self._chunks)
        air = _air_of(chunks)
        noise = config.force_noise or max(_noise_of_means(chunks, air), config.noise_floor)
        if not config.measure_bias:
            return _Level(0.0, 0.0, noise)
        if air.size == 0:
            return _Level(bias, noise, noise)
        return _level_at_end(chunks, air, noise)

    def _in_contact(self, chunk: _Chunk, pair: Pair) -> Release | None:
        self._deepest = max(self._deepest, pair.displacement)
        retreat = self._surface - pair.displacement
        is_low = chunk.mean - self.force_bias < self.release_threshold
        is_behind = retreat > _RETREAT * (self._deepest - self._surface)
        self._behind_chunks += is_behind
        # The chunk in which the probe leaves may still be full of contact.
        if is_behind and (is_low or self._behind_chunks > 1):
            if not is_low:
                # Behind the surface there is no tissue: the force left is drift of the sensor.
                self._chunks.clear()
                self._air = None
            return self._release(chunk.start_ns)
        if not is_low:
            self._low_chunks = 0
            return None
        if self._low_chunks == 0:
            self._low_start_ns = chunk.start_ns
        self._low_chunks += 1
        if self._low_chunks < _RELEASE_CHUNKS:
            return None
        return self._release(self._low_start_ns)

    def _release(self, stamp_ns: int) -> Release:
        self.in_contact = False
        self._low_chunks = 0
        return Release(stamp_ns)


def _air_of(chunks: tuple[_Chunk, ...]) -> _Air:
    count = sum(chunk.size for chunk in chunks)
    if count == 0:
        return _Air(0.0, 0.0, 0.0, 0)
    mean = math.fsum(chunk.size * chunk.mean for chunk in chunks) / count
    within = math.fsum(chunk.square_sum for chunk in chunks)
    between = math.fsum(chunk.size * (chunk.mean - mean) ** 2 for chunk in chunks)
    noise = math.sqrt((within + between) / max(count - 1, 1))
    return _Air(mean, noise, math.sqrt(within / max(count - len(chunks), 1)), count)


class _Level(NamedTuple):
    """The force without contact, when the last chunk ended."""

    value: float  #: [N]
    sd: float  #: standard deviation of `value` [N]
    noise: float  #: standard deviation per sample [N]
    slope: float = 0.0  #: [N/s]
    slope_sd: float = 0.0  #: [N/s]


def _noise_of_means(chunks: tuple[_Chunk, ...], air: _Air) -> float:
    """Return the noise per sample [N] that means over some time show.

    More than that within the chunks where the noise is coloured, since then averaging helps less:
    half the variance of the differences of successive means (Allan), drift apart, at the scale
    where it is largest.
    """
    if len(chunks) < _MIN_CHUNKS:
        return air.noise
    noise = air.fast_noise
    size = air.size / len(chunks)
    means = np.array([chunk.mean for chunk in chunks])
    while means.size >= _MIN_CHUNKS:
        at_scale = math.sqrt(0.5 * size * float(np.var(np.diff(means))))
        if at_scale > noise * (1.0 + _COLOUR_DEVIATIONS * math.sqrt(0.75 / means.size)):
            noise = at_scale
        size *= 2.0
        means = 0.5 * (means[: means.size // 2 * 2 : 2] + means[1::2])
    return noise


def _level_at_end(chunks: tuple[_Chunk, ...], air: _Air, noise: float) -> _Level:
    """Return the mean of the air's force or, where it drifts, its trend."""
    level = _Level(air.mean, noise / math.sqrt(air.size), noise)
    if len(chunks) < 2 * _MIN_CHUNKS:
        return level
    end_ns = chunks[-1].end_ns
    time = np.array([0.5 * (c.start_ns + c.end_ns) - end_ns for c in chunks]) / NANOSECONDS
    weight = np.array([float(c.size) for c in chunks])
    force = np.array([c.mean for c in chunks])
    centre = float(weight @ time / weight.sum())
    spread = float(weight @ (time - centre) ** 2)
    slope = float(weight @ ((time - centre) * (force - air.mean)) / spread)
    slope_sd = noise / math.sqrt(spread)
    if abs(slope) < _DRIFT_DEVIATIONS * slope_sd:
        return level
    sd = math.hypot(level.sd, slope_sd * centre)
    return _Level(air.mean - slope * centre, sd, noise, slope, slope_sd)


class Surface(NamedTuple):
    """Where an approach met the tissue."""

    first: int  #: of the first sample in contact
    displacement: float  #: [m]
    displacement_sd: float  #: [m]
    evidence: float  #: chi-squared by which a contact explains the force better than a drift does


_MAX_BINS = 96
_CANDIDATES = 40
#: The first window is this long [s] and holds at least this many samples; it doubles until the
#: onset lies well within it.
_FIRST_WINDOW = 0.1
_MIN_WINDOW_SAMPLES = 24
_CONTACT_SHARE = 0.6
#: Before the onset the force is less than this share of that at the detection.
_AIR_SHARE = 0.1


def find_surface(
    time: Array, force: Array, displacement: Array, fractional_order: float
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
    """
    window = _FIRST_WINDOW
    detected = float(force[-_MIN_WINDOW_SAMPLES // 2 :].mean())
    while True:
        start = min(
            int(np.searchsorted(time, time[-1] - window)),
            max(time.size - _MIN_WINDOW_SAMPLES, 0),
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
    index = int(np.searchsorted(time, onset_time))
    return Surface(index, surface, bins.deviation(onset_time, spacing), bins.evidence(onset_time))


@dataclass(frozen=True)
class _Bins:
    """Samples averaged into few bins, with the fractional derivative as a matrix on increments."""

    time: Array
    force: Array
    displacement: Array
    derivative: Array

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
        return cls(bin_time, mean(force), mean(displacement), matrix)

    def misfit(self, onset_times: Array) -> Array:
        """Sum of squared residuals [N^2] for each candidate onset, shape (candidates,)."""
        surface = np.interp(onset_times, self.time, self.displacement)
        depth = np.maximum(self.displacement[:, None] - surface, 0.0)
        depth *= self.time[:, None] >= onset_times
        response = self.derivative @ np.diff(depth, axis=0)
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

    def evidence(self, onset_time: float) -> float:
        """Return the chi-squared by which a contact fits better than a line in time."""
        contact = float(self.misfit(np.array([onset_time]))[0])
        line = np.polynomial.Polynomial.fit(self.time, self.force, 1)
        drift = float(np.sum((self.force - line(self.time)) ** 2))
        noise = max(min(contact, drift), sys.float_info.min) / max(self.time.size - 3, 1)
        return (drift - contact) / noise

    def deviation(self, onset_time: float, spacing: float) -> float:
        """Return the standard deviation of the surface [m] from the curvature of the misfit."""
        near = onset_time + np.array([-spacing, 0.0, spacing])
        low, middle, high = self.misfit(near)
        noise = max(float(middle), 0.0) / max(self.time.size - 2, 1)
        steps = np.interp(near, self.time, self.displacement)
        step = max(0.5 * abs(float(steps[2] - steps[0])), sys.float_info.min)
        curvature = max(float(low + high - 2.0 * middle), sys.float_info.min)
        return min(step * math.sqrt(2.0 * noise / curvature), float(np.ptp(self.displacement)))
