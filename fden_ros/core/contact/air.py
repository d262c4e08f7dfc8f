# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The force in the air before a contact: its bias, its noise, its drift, and what exceeds them.

Force is averaged over chunks of time. Means over 1 to 16 chunks are compared with such means in
the air. Over :math:`s` chunks of :math:`n` samples the mean scatters by
:math:`\sigma_s/\sqrt{s n}`, where :math:`\sigma_s` is constant with the scale for white noise,
falls for a vibration and grows for a force that wanders. It is measured in the air at each scale;
the threshold is the mean that air exceeds with a probability of 5e-6, by Student's t.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from itertools import chain, islice
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from fden_ros.core.arrays import NOT_BY_CHANCE, Array
from fden_ros.core.parameter import TINY, parameter
from fden_ros.core.streams import CHUNK_NS, NANOSECONDS, Pair, Position, Resolution


@dataclass(frozen=True)
class ContactConfig:
    """When a contact begins and ends."""

    force_threshold: float = parameter(
        "force.threshold", 0.0, "Least force of a contact; 0: set by the noise.", "N", 0.0, 1000.0
    )
    force_noise: float = parameter(
        "force.noise", 0.0, "Noise per sample, as sd; 0: measured in the air.", "N", 0.0, 1000.0
    )
    noise_floor: float = parameter(
        "force.noise_floor", 1e-5, "Lower limit of the noise.", "N", TINY, 1000.0
    )
    measure_bias: bool = parameter(
        "force.measure_bias",
        True,
        "Measure the bias in the air; false: it is taken as 0, apart from any tare.",
    )
    #: The onset of a contact is searched for up to this time before its detection, or 24 times 3
    #: samples where those last longer [s].
    lookback: float = 5.0
    series_compliance: float = parameter(
        "displacement.compliance",
        0.0,
        "Compliance of tool and robot, which is compensated.",
        "m/N",
        0.0,
        1.0,
    )
    #: Unit vector into the tissue, in the frame of the positions; zeros: not known.
    approach_axis: Position = (0.0, 0.0, 1.0)

    def compliance_free(self, pair: Pair, force: float) -> float:
        """Return the displacement of the tissue's surface [m], without the tool's compliance."""
        return pair.displacement - self.series_compliance * force


#: Force is averaged in chunks of at least 20 ms and this number of samples.
CHUNK_SAMPLES = 3
#: Means are over these numbers of chunks.
SCALES = (1, 2, 4, 8, 16)
#: Probability that a mean in the air exceeds its threshold: an hour has 180,000 chunks, and a
#: contact must also explain the excess better than a drift does.
_CHANCE = 5e-6
#: Fewer than 5 chunks give no bias. The lookback keeps at least 24 chunks, and as many samples as
#: these have at least. Bias and noise are known from half of them on: with fewer the noise may
#: come out so small that noise looks like a contact.
MIN_CHUNKS, _KEPT_CHUNKS = 5, 24
LEAST_SAMPLES = _KEPT_CHUNKS * CHUNK_SAMPLES
#: A slow contact is detected within 1 s [ns] of its beginning, so chunks of the newest second do
#: not count.
SLOW_NS = NANOSECONDS
#: Bias and noise are measured anew after every 8 chunks. The prior of the scatter of longer means,
#: that of white noise, weighs as much as 8 means.
_RENEWED = 8
#: Vibration is no contact: a contact exceeds the bias by more than 2.2 times the deepest dip of
#: means over the same time in the lookback, so that no trough ends it.
_SWING_FACTOR = 2.2
#: Noise below this part of a step of the force, that of its rounding included, does not whiten the
#: rounding error.
_DITHER = 0.6


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
        """Add a sample; return the chunk that it completes."""
        forces = self._forces
        if not forces:
            self._start_ns = pair.stamp_ns
        forces.append(pair.force)
        if len(forces) < CHUNK_SAMPLES or pair.stamp_ns - self._start_ns < CHUNK_NS:
            return None
        mean, half = math.fsum(forces) / len(forces), len(forces) // 2
        square_sum = math.fsum((force - mean) ** 2 for force in forces)
        step = (math.fsum(forces[-half:]) - math.fsum(forces[:half])) / half
        chunk = Chunk(len(forces), self._start_ns, pair.stamp_ns, mean, square_sum, step)
        forces.clear()
        return chunk


class Air(NamedTuple):
    """The force without contact, at the end of some chunks."""

    value: float  #: [N]
    sd: float  #: standard deviation of `value` [N]
    noise: float  #: standard deviation per sample, slow swings included [N]
    white: float  #: the same within a chunk [N]
    end_ns: int = 0
    slope: float = 0.0  #: [N/s]; 0: not significant
    slope_sd: float = 0.0  #: [N/s]


class Baseline:
    """Bias, drift and noise of the force, from chunks in the air.

    The chunks of the lookback are kept, and the newest 24: the air before a long contact stands
    in for that after it until the latter is known.
    """

    def __init__(self, config: ContactConfig) -> None:
        self._config = config
        self.resolution = Resolution()  #: of the force
        #: Whether contacts are found against the measured air: a stated bias is believed until the
        #: first release, after which adhesion or drift may hold the force above it.
        self.is_measured = config.measure_bias
        self.is_suspected = False  #: a slow contact may have begun
        self.thresholds: Array = np.zeros(len(SCALES))  #: means above these are not air [N]
        self._chunks: deque[Chunk] = deque()
        self._count = 0
        self._air: Air | None = None

    @property
    def drift(self) -> float:
        """Trend of the force in the air [N/s]; 0: not significant, or the bias is given."""
        return self._air.slope if self._air and self._config.measure_bias else 0.0

    def mean(self) -> float | None:
        """Return the mean of the chunks [N]; None while there are fewer than 5."""
        return None if len(self._chunks) < MIN_CHUNKS else _mean_of(tuple(self._chunks))[0]

    def is_old(self, stamp_ns: int, now_ns: int) -> bool:
        """Whether a stamp lies before the lookback."""
        return now_ns - stamp_ns > self._config.lookback * NANOSECONDS

    def keep(self, chunk: Chunk) -> None:
        """Add a chunk in the air."""
        chunks = self._chunks
        chunks.append(chunk)
        self._count += 1
        while len(chunks) > _KEPT_CHUNKS and self.is_old(chunks[0].start_ns, chunk.start_ns):
            chunks.popleft()

    def before(self, chunk: Chunk) -> Air | None:
        """Return the force in the air before `chunk`; None while it is not known."""
        chunks, config = tuple(self._chunks), self._config
        if 2 * len(chunks) < _KEPT_CHUNKS:
            if self.is_measured or not (config.force_noise or config.force_threshold):
                return None
            return self._measured(chunks or (chunk._replace(square_sum=0.0),))
        # Not while a slow contact may have begun, or the baseline would follow it.
        is_due = self._count % _RENEWED == 0 and not self.is_suspected
        if self._air is None or is_due:
            old = tuple(one for one in chunks if one.end_ns <= chunk.start_ns - SLOW_NS)
            self._air = self._measured(max(old, chunks[: -(-len(chunks) // 2)], key=len))
        return self._air

    def bias_at(self, stamp_ns: int) -> float:
        """Return the force without contact [N], its trend extrapolated to `stamp_ns`."""
        air = self._air if self.is_measured else None
        return air.value + air.slope * (stamp_ns - air.end_ns) / NANOSECONDS if air else 0.0

    def excess(self, chunk: Chunk) -> tuple[float, float]:
        """Return by which ratio to its threshold a mean up to a chunk exceeds the air most.

        The chunk is not kept yet. Also return that threshold [N].
        """
        rises, size, total = [], 0, 0.0
        newest = islice(chain((chunk,), reversed(self._chunks)), SCALES[-1])
        for count, one in enumerate(newest, start=1):
            size += one.size
            total += one.size * (one.mean - self.bias_at(one.end_ns))
            if count in SCALES:
                rises.append(total / size)
        best = int(np.argmax(np.array(rises) / self.thresholds[: len(rises)]))
        rise, limit, scale = rises[best], float(self.thresholds[best]), SCALES[best]
        # Where the bias is given, a force below it may be the bias.
        if rise > limit and self.is_measured and len(self._chunks) >= scale:
            above = [one.mean - self.bias_at(one.end_ns) for one in self._chunks]
            sums = np.cumsum([0.0, *above])
            fall = -float((sums[scale:] - sums[:-scale]).min()) / scale
            limit = max(limit, _SWING_FACTOR * fall)
        return rise / limit, limit

    def _measured(self, chunks: tuple[Chunk, ...]) -> Air:
        """Return the air of some chunks, and set the thresholds by it."""
        air = self._air_of(chunks)
        means = np.array([chunk.mean for chunk in chunks])
        sd, freedom = _scatter_of(means, sum(c.size for c in chunks) / len(chunks), air.white)
        least: Array = -stdtrit(freedom, _CHANCE) * np.hypot(sd, air.sd)
        if not self.is_measured:
            # A longer mean is no better evidence that the stated bias is right.
            least = np.maximum(least, least[0])
        self.thresholds = np.maximum(least, self._config.force_threshold)
        return air

    def _air_of(self, chunks: tuple[Chunk, ...]) -> Air:
        """Return the mean of the air's force or, where it drifts, its trend."""
        config, step, end_ns = self._config, self.resolution.step, chunks[-1].end_ns
        mean, fast, count = _mean_of(chunks)
        error = step * 12.0**-0.5  # of one rounding
        # Where noise does not whiten it, it persists for many samples.
        rounding = 0.0 if config.force_noise or fast >= _DITHER * step else error
        slow = max(config.noise_floor, rounding * math.sqrt(max(chunk.size for chunk in chunks)))
        noise = config.force_noise or max(_noise_of_means(chunks, fast, count), slow)
        white = config.force_noise or max(fast, error, config.noise_floor)
        level = Air(mean, math.hypot(noise / math.sqrt(count), rounding), noise, white, end_ns)
        if len(chunks) < 2 * MIN_CHUNKS:
            return level
        time = np.array([0.5 * (c.start_ns + c.end_ns) - end_ns for c in chunks]) / NANOSECONDS
        weight = np.array([float(c.size) for c in chunks])
        force = np.array([c.mean for c in chunks])
        centre = float(weight @ time / weight.sum())
        spread = float(weight @ (time - centre) ** 2)
        slope = float(weight @ ((time - centre) * (force - mean)) / spread)
        slope_sd = noise / math.sqrt(spread)
        if abs(slope) < NOT_BY_CHANCE * slope_sd:
            return level
        sd = math.hypot(level.sd, slope_sd * centre)
        return Air(mean - slope * centre, sd, noise, white, end_ns, slope, slope_sd)

    def level(self, bias: float, noise: float, before_ns: int) -> Air:
        """Return the force without contact, as it was in the air before `before_ns`.

        `bias` [N] and `noise` [N] stand in where there is none.
        """
        chunks = tuple(chunk for chunk in self._chunks if chunk.end_ns < before_ns)
        air = self._air_of(chunks) if chunks else Air(bias, noise, noise, noise)
        return air if self._config.measure_bias else Air(0.0, 0.0, air.noise, air.white)

    def forget_since(self, stamp_ns: int) -> None:
        """Drop the chunks that reach into a contact that began at `stamp_ns`."""
        self._air = None
        while self._chunks and self._chunks[-1].end_ns >= stamp_ns:
            self._chunks.pop()

    def forget_all_but(self, count: int) -> None:
        """Drop all chunks but the newest `count`."""
        self._air = None
        while len(self._chunks) > count:
            self._chunks.popleft()


def _mean_of(chunks: tuple[Chunk, ...]) -> tuple[float, float, int]:
    """Return mean [N], deviation within the chunks [N] and count of their samples."""
    count = sum(chunk.size for chunk in chunks)
    mean = math.fsum(chunk.size * chunk.mean for chunk in chunks) / count
    within = math.fsum(chunk.square_sum for chunk in chunks)
    return mean, math.sqrt(within / max(count - len(chunks), 1)), count


def _scatter_of(means: Array, size: float, noise: float) -> tuple[Array, Array]:
    """Return the standard deviation of means in the air [N] and its degrees of freedom, per scale.

    From the successive differences (Allan's variance) of the `means` of chunks in the air [N], of
    `size` samples each, with a deviation of `noise` [N] within them.
    """
    found: list[tuple[float, float]] = []
    freedom, variance = means.size * (size - 1.0), noise**2
    for scale in SCALES:
        count, weight = means.size // scale, min(freedom, _RENEWED)
        freedom = max(count - 1, 0)
        averaged = means[means.size - count * scale :].reshape(count, scale).mean(axis=1)
        square_sum = 0.5 * scale * size * float(np.sum(np.diff(averaged) ** 2))
        variance = (square_sum + weight * variance) / (freedom + weight)
        freedom += weight
        found.append((math.sqrt(variance / (scale * size)), freedom))
    sd, degrees = np.array(found).T
    return sd, degrees


def _noise_of_means(chunks: tuple[Chunk, ...], white: float, count: int) -> float:
    """Return the noise per sample [N] that means over some time show.

    Coloured noise averages less than the `white` noise within the chunks, of `count` samples. So
    it is half the variance of the differences of successive means (Allan), less drift, at the
    scale where that is largest. The least scale is half a chunk, a block of the estimator:
    vibration of 35 Hz nearly cancels in a whole one.
    """
    noise, size = white, 0.5 * count / len(chunks)
    means, steps = np.array([c.mean for c in chunks]), np.array([c.step for c in chunks])
    while steps.size >= MIN_CHUNKS - 1:
        at_scale = math.sqrt(0.5 * size * float(np.var(steps)))
        if at_scale > noise * (1.0 + NOT_BY_CHANCE * math.sqrt(0.75 / steps.size)):
            noise = at_scale
        size *= 2.0
        steps, means = np.diff(means), 0.5 * (means[: means.size // 2 * 2 : 2] + means[1::2])
    return noise
