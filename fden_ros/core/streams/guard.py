# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One stream on its own: samples in order of their stamps are accepted, others rejected."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

from fden_ros.core.streams.rotation import TOLERANCE, Quaternion, angle
from fden_ros.core.streams.samples import (
    BRIEF_NS,
    CHUNK_NS,
    NANOSECONDS,
    Pair,
    Position,
    Reason,
    Sample,
)

#: Five samples in a row are not alike by chance. A signal that changes by the same amount in them
#: is a ramp without noise. A force that repeats its value in them, and 5 times longer than ever
#: before, is stuck, and dropped until it changes; unless its usual change is less than 5 of its
#: quantisation steps: such a force stands still between two steps.
_RUN = 5
#: Stamps closer than this [ns] are of a single sample: the fractional integral's shortest step.
MIN_STEP_NS = 10_000
#: A step, or a change of the value, beyond 10 usual ones is far, a step also beyond 1 s while they
#: are not known. It waits for the next sample to confirm it. After a far step this follows within
#: 1 s, 10 usual steps, or 10 times the step. Since a stamp that is not far ahead makes 10 samples
#: late, twice as many consecutive late ones, in order, are also a jump of the clock. No pause and
#: no spike counts as more than 10 in the mean of the usual ones.
_FAR = 10
#: The means of the step between stamps and of the change between values are over 32 samples, and
#: are used for tests from this number on.
USUAL_SAMPLES = 32
#: A turn of a frame counts as the motion of a point this far from it [m].
_LEVER = 0.1


class Resolution:
    """The step of a signal whose changes are all whole numbers of it."""

    def __init__(self) -> None:
        self._step = 0.0
        self._last: float | None = None
        self._last_change = 0.0
        self._alike = 0  # changes in a row that are the same
        self._is_continuous = False

    @property
    def step(self) -> float:
        """The step; 0: the signal is continuous, or not known."""
        return self._step if self._alike < _RUN else 0.0

    def add(self, value: float) -> None:
        """Add a value."""
        if self._is_continuous:
            return
        last, self._last = self._last, value
        if last is None:
            return
        change = value - last
        size = abs(change)
        if math.isclose(value, last):
            self._alike = 0
            return
        is_like = abs(change - self._last_change) < TOLERANCE * size
        self._alike = self._alike + 1 if is_like else 1
        self._last_change = change
        step = self._step or size
        self._step = min(size, step)
        if abs(math.remainder(max(size, step), self._step)) > TOLERANCE * self._step:
            self._step, self._is_continuous = 0.0, True


class Usual:
    """The mean of positive values, exponential over 32 of them."""

    def __init__(self) -> None:
        self.mean = self._last = 0.0
        self.count = 0
        #: The larger of the mean of all and of the smaller one of the last two, for values that
        #: grow, as the steps of log-spaced recordings; 0: there were none.
        self.value = 0.0

    @property
    def is_known(self) -> bool:
        """Whether there were enough values for tests."""
        return self.count >= USUAL_SAMPLES

    def add(self, value: float) -> None:
        """Add a value."""
        self.count += 1
        mean = self.mean or value
        self.mean = mean + (min(value, _FAR * mean) - mean) / min(self.count, USUAL_SAMPLES)
        self.value = max(self.mean, min(self._last, value))
        self._last = value


class StreamGuard:
    """Accept a stream's samples in order of their stamps; reject and count the others.

    A stamp more than 0.5 s before or 10 usual steps after its predecessor is held back: the next
    sample distinguishes a jump of the clock from a stray stamp. Where `is_vector`, values are
    judged by the distance of the samples' positions, and by their turns.
    """

    def __init__(
        self, limit: float, rejected: Counter[str], name: str, *, is_vector: bool = False
    ) -> None:
        self._limit, self._is_vector = limit, is_vector
        self._rejected, self._name = rejected, name
        self.epoch = self.epoch_start_ns = 0
        self._newest: Sample | None = None
        self._held: Sample | None = None
        self._late_run = self._late_newest_ns = 0
        self.usual = Usual()  #: step between accepted stamps [ns]
        self._values = ValueGuard(self.reject, limits_runs=name == "force", is_vector=is_vector)
        self.largest = 0.0  #: magnitude that was rejected as out of range
        self.too_large = 0  #: number of those samples
        self.too_close = 0  #: samples within 10 us of the last that are not copies of it
        self.close_step = 0.0  #: of the newest of these [s]

    def reject(self, reason: str) -> None:
        """Count one rejected sample."""
        self._rejected[f"{self._name}.{reason}"] += 1

    def join_epoch(self, epoch: int, start_ns: int) -> None:
        """Assign the following samples to `epoch`, which starts at `start_ns`."""
        self.epoch, self.epoch_start_ns = epoch, start_ns

    def accept(
        self,
        stamp_ns: int,
        value: float,
        position: Position | None = None,
        load: float = 0.0,
        turn: Quaternion | None = None,
    ) -> list[Sample]:
        """Check a sample; return those accepted now: none, this one, or a held one and this.

        A displacement has the `position` [m] and the `turn` of the probe where known, and as
        `load` [N] what the sensor measures there without any contact.
        """
        if not math.isfinite(value + load) or (
            position is not None and not all(map(math.isfinite, position))
        ):
            self.reject(Reason.NON_FINITE)
            return []
        size = math.hypot(*position) if self._is_vector and position is not None else abs(value)
        if size > self._limit:
            self.reject(Reason.OUT_OF_RANGE)
            self.too_large += 1
            self.largest = max(self.largest, size)
            return []
        if stamp_ns <= 0:
            self.reject(Reason.ZERO_STAMP)
            return []
        usual_ns = self.usual.value
        sample = Sample(self.epoch, stamp_ns, value, position, load, usual_ns, turn)
        in_time = self._in_order(sample) if self._held is None else self._after_held(sample)
        return [one for sample in in_time for one in self._values.judge(sample)]

    def _take(self, *samples: Sample) -> tuple[Sample, ...]:
        for sample in samples:
            # A sample that begins an epoch has no step.
            if self._newest is not None and self._newest.epoch == sample.epoch:
                self.usual.add(float(sample.stamp_ns - self._newest.stamp_ns))
            self._newest = sample
        self._late_run = 0
        return samples

    def _in_order(self, sample: Sample) -> tuple[Sample, ...]:
        if self._newest is None:
            return self._take(sample)
        step = sample.stamp_ns - self._newest.stamp_ns
        # Accepted at once, a stray stamp a little ahead would make all later ones late.
        far = max(_FAR * self.usual.value, 0 if self.usual.is_known else NANOSECONDS)
        if MIN_STEP_NS <= step <= far:
            return self._take(sample)
        if step > far or step < -BRIEF_NS:
            self._held = sample
            return ()
        if step > -MIN_STEP_NS:
            self.reject(Reason.DUPLICATE_STAMP)
            if step > 0:
                self.too_close += 1
                self.close_step = step / NANOSECONDS
            return ()
        is_in_order = sample.stamp_ns > self._late_newest_ns
        self._late_run = self._late_run + 1 if is_in_order else 1
        self._late_newest_ns = sample.stamp_ns
        if self._late_run < 2 * _FAR:
            self.reject(Reason.LATE_STAMP)
            return ()
        return self._take(self._next_epoch(sample))

    def _after_held(self, sample: Sample) -> tuple[Sample, ...]:
        held, self._held = self._held, None
        assert held is not None and self._newest is not None
        newest_ns = self._newest.stamp_ns
        is_ahead = held.stamp_ns > newest_ns
        far = max(NANOSECONDS, _FAR * max(self.usual.value, held.stamp_ns - newest_ns))
        # What goes on from the newest sample, and not from one far behind it, is no jump back.
        goes_on = is_ahead or sample.stamp_ns < newest_ns
        if goes_on and MIN_STEP_NS <= sample.stamp_ns - held.stamp_ns <= far:
            if is_ahead:
                return self._take(held, sample)
            first = self._next_epoch(held)
            return self._take(first, sample._replace(epoch=self.epoch))
        self.reject(Reason.FUTURE_STAMP if is_ahead else Reason.LATE_STAMP)
        return self._in_order(sample)

    def _next_epoch(self, sample: Sample) -> Sample:
        self.join_epoch(self.epoch + 1, sample.stamp_ns)
        return sample._replace(epoch=self.epoch)


class ValueGuard:
    """Separate measured values from spikes and from those of a stuck sensor.

    A constant signal is suspicious where it `limits_runs`; a displacement may be constant. Where
    it `is_vector`, positions and turns count, not values.
    """

    def __init__(self, reject: Callable[[str], None], limits_runs: bool, is_vector: bool) -> None:
        self._reject, self._limits_runs, self._is_vector = reject, limits_runs, is_vector
        self._last: Sample | None = None
        self._held: Sample | None = None
        self._usual = Usual()  # only of changes: a coarse signal stands still most of the time
        self._run = self._longest_run = 1
        self._resolution = Resolution()

    @property
    def _is_stuck(self) -> bool:
        return (
            self._limits_runs
            and self._run >= _RUN * self._longest_run
            and self._usual.is_known
            and self._usual.mean >= _RUN * self._resolution.step
        )

    def judge(self, sample: Sample) -> list[Sample]:
        """Return the samples that are now known to be good.

        A value more than 10 mean changes from the last is held back: the next one distinguishes a
        spike from a step.
        """
        last, held, self._held = self._last, self._held, None
        if last is None or last.epoch != sample.epoch:
            self._last, self._run = sample, 1
            return [held, sample] if held is not None else [sample]
        change = self._distance(last, sample)
        if held is not None:
            if change >= 0.5 * self._distance(last, held):
                first = self._follow(self._distance(last, held), held)
                return [*first, *self._follow(self._distance(held, sample), sample)]
            self._reject(Reason.SPIKE)
        if self._usual.is_known and change > _FAR * self._usual.mean:
            self._held = sample
            return []
        return self._follow(change, sample)

    def _follow(self, change: float, sample: Sample) -> list[Sample]:
        self._last = sample
        self._resolution.add(sample.value)
        if change > 0.0:
            self._usual.add(change)
            if not self._is_stuck:
                self._longest_run = max(self._longest_run, self._run)
            self._run = 1
        else:
            self._run += 1
            if self._is_stuck:
                self._reject(Reason.STUCK)
                return []
        step = self._resolution.step
        return [sample] if not step or self._is_vector else [sample._replace(resolution=step)]

    def _distance(self, a: Sample, b: Sample) -> float:
        if not self._is_vector or a.position is None or b.position is None:
            return abs(b.value - a.value)
        distance = math.dist(a.position, b.position)
        if a.turn is None or b.turn is None:
            return distance
        return distance + _LEVER * angle(a.turn, b.turn)


def gap_before(pair: Pair, newest_ns: int) -> int:
    """Return the length of the gap between a stamp and the pair after it [ns], 0 without one."""
    step_ns = pair.stamp_ns - newest_ns
    is_gap = pair.usual_ns and step_ns > max(_FAR * pair.usual_ns, CHUNK_NS)
    return step_ns if is_gap else 0
