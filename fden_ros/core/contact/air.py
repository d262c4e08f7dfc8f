# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The force in the air before a contact: its bias, its noise, its drift, and what exceeds them.

Force is averaged over chunks of time: long enough to average, short enough to react. Means over 1
to 16 chunks are compared with such means in the air.

Over :math:`s` chunks of :math:`n` samples the mean scatters by :math:`\sigma_s/\sqrt{s n}`, where
:math:`\sigma_s` is constant with the scale for white noise, falls for a vibration and grows for a
force that wanders. It is measured in the air at each scale; the threshold is the mean that air
exceeds with a probability of 5e-6, by Student's t.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from itertools import chain, islice
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from fden_ros.core.arrays import Array
from fden_ros.core.parameter import TINY, parameter
from fden_ros.core.streams import NANOSECONDS, Pair, Position, Resolution


@dataclass(frozen=True)
class ContactConfig:
    """When a contact begins and ends, and when it is at a new site."""

    force_threshold: float = parameter(
        "force.threshold",
        0.0,
        "Force above its bias that is a contact; 0: what means over 1 to 16 chunks of the air "
        "exceed with a probability of 5e-6.",
        "N",
        0.0,
        1000.0,
    )
    force_noise: float = parameter(
        "force.noise",
        0.0,
        "Standard deviation of the force's noise per sample; 0: measured in the air before each "
        "contact.",
        "N",
        0.0,
        1000.0,
    )
    noise_floor: float = parameter(
        "force.noise_floor",
        1e-5,
        "Least noise that is believed, so that a quantised signal does not look perfect.",
        "N",
        TINY,
        1000.0,
    )
    measure_bias: bool = parameter(
        "force.measure_bias",
        True,
        "Measure the force's bias in the air before each contact; false: it is 0 after any tare.",
    )
    #: How far before its detection the onset of a contact is looked for; or 24 times 3 samples,
    #: where those last longer [s].
    lookback: float = 5.0
    site_distance: float = parameter(
        "site.distance",
        0.0,
        "A touch further to the side is a new site, where positions are known; 0: a fifth of the "
        "probe's radius, 0.5 to 2 mm.",
        "m",
        0.0,
        1.0,
    )
    site_timeout: float = parameter(
        "site.timeout",
        2.0,
        "Without positions, a touch after a longer time in the air may be of another place.",
        "s",
        0.0,
        100000.0,
    )
    without_position: str = parameter(
        "site.without_position",
        "either",
        "Whose a touch without a position is: the same place, another, or either: then the data "
        "decide after site.timeout.",
        choices=("same", "other", "either"),
    )
    series_compliance: float = parameter(
        "displacement.compliance",
        0.0,
        "Compliance of tool and robot in series with the tissue; the displacement is compensated.",
        "m/N",
        0.0,
        1.0,
    )
    #: Unit vector into the tissue, in the frame of the positions; zeros: it is not known.
    approach_axis: Position = (0.0, 0.0, 1.0)

    def compliance_free(self, pair: Pair, force: float) -> float:
        """Return the displacement of the tissue's surface [m], without the tool's own give."""
        return pair.displacement - self.series_compliance * force


#: Force is averaged in chunks of at least 20 ms [ns] and 3 samples.
CHUNK_NS = 20_000_000
_CHUNK_SAMPLES = 3


class Chunk(NamedTuple):
    """The force of consecutive samples."""

    size: int
    start_ns: int
    end_ns: int
    mean: float  #: [N]
    square_sum: float  #: of deviations from the mean [N^2]
    step: float = 0.0  #: from the mean of its first half to that of its last [N]


class Chunks:
    """Collects samples until a chunk is full."""

    def __init__(self) -> None:
        self._forces: list[float] = []
        self._start_ns = 0

    def add(self, pair: Pair) -> Chunk | None:
        """Take a sample; return the chunk that ends with it."""
        forces = self._forces
        if not forces or pair.stamp_ns < self._start_ns:
            # A clock that jumped back leaves a chunk without an end.
            forces.clear()
            self._start_ns = pair.stamp_ns
        forces.append(pair.force)
        if len(forces) < _CHUNK_SAMPLES or pair.stamp_ns - self._start_ns < CHUNK_NS:
            return None
        mean = math.fsum(forces) / len(forces)
        square_sum = math.fsum((force - mean) ** 2 for force in forces)
        half = len(forces) // 2
        step = (math.fsum(forces[-half:]) - math.fsum(forces[:half])) / half
        chunk = Chunk(len(forces), self._start_ns, pair.stamp_ns, mean, square_sum, step)
        forces.clear()
        return chunk


#: Means are over so many chunks.
SCALES = (1, 2, 4, 8, 16)
#: Probability that a mean in the air exceeds its threshold: an hour has 180,000 chunks, and what
#: exceeds it must still be explained better by a contact than by a drift.
_CHANCE = 5e-6
#: Longer means are expected to scatter as white noise has it, with the weight of so many of them.
_EXPECTED = 8


class Excess(NamedTuple):
    """The mean of the newest chunks at the scale where it exceeds the air most."""

    ratio: float  #: of the mean above the bias to its threshold [1]
    threshold: float  #: [N]
    scale: int  #: chunks that are averaged


def _scatter_of(means: Array, size: float, noise: float) -> tuple[Array, Array]:
    """Return the standard deviation of means in the air [N] and its degrees of freedom, per scale.

    By the successive differences (Allan's variance) of the `means` of chunks in the air [N], of
    `size` samples each, within which these have a deviation of `noise` [N].
    """
    found: list[tuple[float, float]] = []
    freedom, variance = means.size * (size - 1.0), noise**2
    for scale in SCALES:
        count = means.size // scale
        weight = _EXPECTED if means.size == 0 else min(freedom, _EXPECTED)
        freedom = max(count - 1, 0)
        averaged = means[means.size - count * scale :].reshape(count, scale).mean(axis=1)
        steps = np.diff(averaged)
        square_sum = 0.5 * scale * size * float(steps @ steps)
        variance = (square_sum + weight * variance) / (freedom + weight)
        freedom += weight
        found.append((math.sqrt(variance / (scale * size)), freedom))
    sd, degrees = np.array(found).T
    return sd, degrees


def _deepest_fall(means: Array, scale: int) -> float:
    """Return how far means over `scale` of the chunks fell below the bias [N]."""
    if means.size < scale:
        return 0.0
    sums = np.cumsum(np.concatenate([[0.0], means]))
    return max(-float((sums[scale:] - sums[:-scale]).min()) / scale, 0.0)


class Air(NamedTuple):
    """What the force is in the air."""

    mean: float  #: [N]
    noise: float  #: standard deviation per sample, slow changes included [N]
    fast_noise: float  #: the same without slow changes [N]
    size: int  #: samples behind it


def least_noise(noise: float) -> float:
    """Return the floor for a force noise [N]: a tenth of it, to one digit."""
    return float(f"{0.1 * noise:.0e}")


class Level(NamedTuple):
    """The force without contact, when the last chunk ended."""

    value: float  #: [N]
    sd: float  #: standard deviation of `value` [N]
    noise: float  #: standard deviation per sample [N]
    slope: float = 0.0  #: [N/s]
    slope_sd: float = 0.0  #: [N/s]


#: Fewer chunks than this give neither bias nor noise.
MIN_CHUNKS = 5
#: Bias and noise are known from 48 samples, or from 12 chunks of a slow sensor: from fewer the
#: noise may come out so small that noise looks like a contact.
_MIN_AIR_SAMPLES = 48
_ENOUGH_CHUNKS = 12
#: A slow contact is detected within 1 s [ns] of its beginning. Chunks of the newest second may
#: hold that: they do not count.
SLOW_NS = NANOSECONDS
#: Bias and noise are measured anew after every 8 chunks.
_AIR_EVERY = 8
#: From half of what is a contact on, a slow one may be on, and the baseline stands still.
_SUSPICION = 0.5
#: What swings, as a vibrating arm does, is no contact: that rises above the bias by 2.2 times as
#: far as means over the same time fell below it in the lookback, so that no trough ends it.
_SWING_FACTOR = 2.2
#: From 4 standard deviations on a sample clearly is not the air's, the noise counts as coloured
#: (by how far the variance of the chunks' means exceeds that of white noise), and a trend of the
#: force in the air as drift.
CLEAR_DEVIATIONS = 4.0

#: Standard deviation of what is rounded off, in steps; noise of less than 0.6 steps, that of
#: the rounding included, does not make it white.
_ROUNDING, _DITHER = 12.0**-0.5, 0.6


class Baseline:
    """Bias, drift and noise of the force, from chunks in the air.

    Chunks older than the lookback, and than 24 chunks last, are forgotten.
    """

    def __init__(self, config: ContactConfig) -> None:
        self._config = config
        self.resolution = Resolution()  #: of the force
        #: Whether contacts are told against the air as it was measured: a stated bias is believed
        #: until the first release, after which adhesion or drift may hold the force above it.
        self.is_measured = config.measure_bias
        self._thresholds: Array = np.zeros(len(SCALES))  # of contact [N]
        self.is_suspected = False  #: a slow contact may be on
        self._chunks: deque[Chunk] = deque()
        self._count = 0
        self._chunk_ns = 0  # time from chunk to chunk
        self._air: Air | None = None
        self._is_carried = False  # the air before a long contact stands in for that after it
        self._trend = Level(0.0, 0.0, 0.0)
        self._trend_end_ns = 0

    @property
    def drift(self) -> float:
        """Trend of the force in the air [N/s]; 0 where it is not significant."""
        return self._trend.slope

    @property
    def threshold_of_chunk(self) -> float:
        """The least mean of a single chunk above the bias that is no air [N]."""
        return float(self._thresholds[0])

    @property
    def reach_ns(self) -> int:
        """How far back the air is remembered [ns]: for the lookback, or 24 chunks if longer."""
        stated_ns = round(self._config.lookback * NANOSECONDS)
        return max(stated_ns, 2 * _ENOUGH_CHUNKS * self._chunk_ns)

    def mean(self) -> float | None:
        """Return the mean of the chunks [N]; None while there are fewer than 5."""
        if len(self._chunks) < MIN_CHUNKS:
            return None
        return _air_of(tuple(self._chunks)).mean

    @property
    def _rounding(self) -> float:
        return _ROUNDING * self.resolution.step

    def keep(self, chunk: Chunk) -> None:
        """Take a chunk in the air."""
        chunks = self._chunks
        # A clock that jumped back has left chunks ahead.
        self._drop_since(chunk.start_ns)
        if chunks and chunk.start_ns - chunks[-1].end_ns <= chunk.end_ns - chunk.start_ns:
            self._chunk_ns = chunk.start_ns - chunks[-1].start_ns
        chunks.append(chunk)
        self._count += 1
        while chunk.start_ns - chunks[0].start_ns > self.reach_ns:
            chunks.popleft()

    def noise_of(self, air: Air) -> float:
        """Return the noise per sample that is tested against [N]."""
        own = max(air.fast_noise, self._rounding)
        return self._config.force_noise or max(own, self._config.noise_floor)

    def excess(self, chunk: Chunk) -> Excess:
        """Return how far the force up to a chunk that is not kept yet exceeds the air."""
        rises = self._rises_with(chunk)
        limits = self._thresholds[: rises.size]
        best = int(np.argmax(rises / limits))
        rise, limit, scale = float(rises[best]), float(limits[best]), SCALES[best]
        if rise > limit and self.is_measured:
            # Where the bias is given, what is below it may be the bias.
            limit = max(limit, _SWING_FACTOR * _deepest_fall(self._above_bias(), scale))
        return Excess(rise / limit, limit, scale)

    def _rises_with(self, chunk: Chunk) -> Array:
        """Return the means of the newest chunks above the bias [N], per scale."""
        found = []
        size, total = 0, 0.0
        newest = islice(chain((chunk,), reversed(self._chunks)), SCALES[-1])
        for count, one in enumerate(newest, start=1):
            size += one.size
            total += one.size * (one.mean - self.bias_at(one.end_ns))
            if count in SCALES:
                found.append(total / size)
        return np.array(found)

    def _above_bias(self) -> Array:
        return np.array([chunk.mean - self.bias_at(chunk.end_ns) for chunk in self._chunks])

    def before(self, chunk: Chunk) -> Air | None:
        """Return the force in the air before `chunk`; None while it is not known."""
        chunks = tuple(self._chunks)
        if not self._is_known():
            if self._air is not None:
                # The next touch may come before the air is known anew.
                self._is_carried = True
                return self._air
            if self.is_measured or not (self._config.force_noise or self._config.force_threshold):
                return None
            air = _air_of(chunks)
            self._thresholds = self._thresholds_in(chunks, air, chunk.size)
            return air
        is_new = chunks[-1].end_ns - chunks[0].start_ns < SLOW_NS
        if self._is_carried and self._air is not None and is_new and self.is_rising(chunk):
            return self._air
        # Not while a slow contact may be on, or the baseline would creep along with it.
        is_due = not self.is_suspected and self._count % _AIR_EVERY == 0
        if self._air is None or self._is_carried or is_due:
            self._is_carried = False
            newest_ns = chunk.start_ns - SLOW_NS
            old = tuple(c for c in chunks if c.end_ns <= newest_ns)
            old = max(old, chunks[: -(-len(chunks) // 2)], key=len)
            self._air = _air_of(old)
            self._trend = _level_at_end(old, self._air, _noise_of_means(old, self._air))
            self._trend_end_ns = old[-1].end_ns
            self._thresholds = self._thresholds_in(old, self._air, chunk.size)
        return self._air

    def is_rising(self, chunk: Chunk) -> bool:
        """Whether a contact may be on that has not risen far enough to be told."""
        return self.excess(chunk).ratio > _SUSPICION

    def _thresholds_in(self, chunks: tuple[Chunk, ...], air: Air, size: int) -> Array:
        """Return the least mean that is no air for each scale [N]."""
        means = np.array([chunk.mean for chunk in chunks])
        usual_size = air.size / len(chunks) if chunks else size
        sd, freedom = _scatter_of(means, usual_size, self.noise_of(air))
        step = self.resolution.step
        is_dithered = self._config.force_noise or air.fast_noise >= _DITHER * step
        rounding = 0.0 if is_dithered else self._rounding
        sd = np.sqrt(sd**2 + self._trend.sd**2 + rounding**2)
        least: Array = -stdtrit(freedom, _CHANCE) * sd
        if not self.is_measured:
            # A longer mean tells no better whether the bias is what it is said to be.
            least = np.maximum(least, least[0])
        return np.maximum(least, self._config.force_threshold)

    def bias_at(self, stamp_ns: int) -> float:
        """Return the force without contact [N], its trend extrapolated to `stamp_ns`."""
        if not self.is_measured:
            return 0.0
        elapsed = (stamp_ns - self._trend_end_ns) / NANOSECONDS
        return self._trend.value + self._trend.slope * elapsed

    def level(self, bias: float, noise: float, before_ns: int) -> Level:
        """Return the force without contact, as it was in the air before `before_ns`.

        `bias` [N] and `noise` [N] stand in where there is none.
        """
        chunks = tuple(chunk for chunk in self._chunks if chunk.end_ns < before_ns)
        air = _air_of(chunks)
        measured = _noise_of_means(chunks, air) if chunks else noise
        noise = self._config.force_noise or max(measured, self._config.noise_floor)
        rounding = 0.0
        if not self._config.force_noise and air.fast_noise < _DITHER * self.resolution.step:
            # Hardly any noise over the steps: what is rounded off stays for many samples.
            rounding = self._rounding
            noise = max(noise, rounding * math.sqrt(max((c.size for c in chunks), default=1)))
        if not self._config.measure_bias:
            return Level(0.0, 0.0, noise)
        if air.size == 0:
            return Level(bias, noise, noise)
        level = _level_at_end(chunks, air, noise)
        return level._replace(sd=math.hypot(level.sd, rounding))

    def forget_since(self, stamp_ns: int) -> None:
        """Drop the chunks that reach into a contact that began at `stamp_ns`."""
        self._drop_since(stamp_ns)
        self._air = None

    def _drop_since(self, stamp_ns: int) -> None:
        chunks = self._chunks
        while chunks and chunks[-1].end_ns >= stamp_ns:
            chunks.pop()

    def forget_all_but(self, count: int) -> None:
        """Drop all chunks but the newest `count`."""
        recent = tuple(self._chunks)[-count:] if count else ()
        self._air = None
        self._chunks.clear()
        self._chunks.extend(recent)

    def _is_known(self) -> bool:
        count = len(self._chunks)
        if count < MIN_CHUNKS:
            return False
        return (
            count >= _ENOUGH_CHUNKS
            or sum(chunk.size for chunk in self._chunks) >= _MIN_AIR_SAMPLES
        )


def _air_of(chunks: tuple[Chunk, ...]) -> Air:
    count = sum(chunk.size for chunk in chunks)
    if count == 0:
        return Air(0.0, 0.0, 0.0, 0)
    mean = math.fsum(chunk.size * chunk.mean for chunk in chunks) / count
    within = math.fsum(chunk.square_sum for chunk in chunks)
    between = math.fsum(chunk.size * (chunk.mean - mean) ** 2 for chunk in chunks)
    noise = math.sqrt((within + between) / max(count - 1, 1))
    return Air(mean, noise, math.sqrt(within / max(count - len(chunks), 1)), count)


def _noise_of_means(chunks: tuple[Chunk, ...], air: Air) -> float:
    """Return the noise per sample [N] that means over some time show.

    More than that within the chunks where the noise is coloured, since then averaging helps less:
    half the variance of the differences of successive means (Allan), drift apart, at the scale
    where it is largest.
    """
    if len(chunks) < MIN_CHUNKS:
        return air.noise
    noise = air.fast_noise
    # From half a chunk on, which is a block of the estimator: vibration of 35 Hz is nearly over in
    # a whole one.
    size = 0.5 * air.size / len(chunks)
    means, steps = np.array([chunk.mean for chunk in chunks]), [chunk.step for chunk in chunks]
    while True:
        at_scale = math.sqrt(0.5 * size * float(np.var(steps)))
        if at_scale > noise * (1.0 + CLEAR_DEVIATIONS * math.sqrt(0.75 / len(steps))):
            noise = at_scale
        if means.size < MIN_CHUNKS:
            return noise
        size *= 2.0
        steps = np.diff(means).tolist()
        means = 0.5 * (means[: means.size // 2 * 2 : 2] + means[1::2])


def _level_at_end(chunks: tuple[Chunk, ...], air: Air, noise: float) -> Level:
    """Return the mean of the air's force or, where it drifts, its trend."""
    level = Level(air.mean, noise / math.sqrt(air.size), noise)
    if len(chunks) < 2 * MIN_CHUNKS:
        return level
    end_ns = chunks[-1].end_ns
    time = np.array([0.5 * (c.start_ns + c.end_ns) - end_ns for c in chunks]) / NANOSECONDS
    weight = np.array([float(c.size) for c in chunks])
    force = np.array([c.mean for c in chunks])
    centre = float(weight @ time / weight.sum())
    spread = float(weight @ (time - centre) ** 2)
    slope = float(weight @ ((time - centre) * (force - air.mean)) / spread)
    slope_sd = noise / math.sqrt(spread)
    if abs(slope) < CLEAR_DEVIATIONS * slope_sd:
        return level
    sd = math.hypot(level.sd, slope_sd * centre)
    return Level(air.mean - slope * centre, sd, noise, slope, slope_sd)
