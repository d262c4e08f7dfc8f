"""Two streams of stamped samples into pairs: displacement interpolated to the stamps of the force.

Every decision rests on stamps and on the order of samples within their own stream, never on when
samples of the two streams arrive relative to each other. So live, replayed and batched data give
the same pairs.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fden_ros.core.streams.samples import NANOSECONDS, Pair, Position, Reason, Sample

#: The displacement's noise is measured over so many samples, robustly: median |normal| is 0.6745.
_NOISE_SAMPLES = 256
_MEDIAN_OF_NORMAL = 0.6745




@dataclass(frozen=True)
class SynchronizeConfig:
    """How streams are checked and paired; times in seconds.

    Parameters
    ----------
    displacement_delay : float
        The displacement's stamps lag the force's by this much [s]; may be negative.
    max_gap : float
        Displacement samples further apart than this are not interpolated between [s].
    pairing_window : float
        A sample waits at most this long, in stamps, for its partner [s].
    force_limit, displacement_limit : float
        Larger magnitudes are rejected as out of range [N, m].
    """

    displacement_delay: float = 0.0
    max_gap: float = 0.25
    pairing_window: float = 5.0
    force_limit: float = 1e5
    displacement_limit: float = 10.0


#: Stamps closer than this are one sample [ns]: the fractional integral's shortest step.
_MIN_STEP_NS = 10_000
#: A stamp this far back, confirmed by the next sample, is a jump of the clock; less is a late
#: sample [ns].
_BACKWARD_JUMP_NS = NANOSECONDS // 2
#: A stamp so many usual steps ahead, and in any case one this far ahead [ns], waits for the next
#: sample to confirm it.
_FAR_STEPS = 10.0
_FORWARD_JUMP_NS = NANOSECONDS
#: This many late samples in a row, in order among themselves, are a jump of the clock too.
_LATE_RUN = 20
#: The usual step, in stamps and in values, follows the last samples with this gain.
_GAIN = 1.0 / 32.0
#: A value so many usual changes away from its neighbours on both sides is a spike.
_SPIKE_CHANGES = 12.0
#: One change alone makes what is usual grow by no more than this share of it, times the gain.
_MOST_GROWTH = 4.0
#: What is usual is known from so many samples.
_USUAL_SAMPLES = 32
#: A signal that never repeated itself for longer than a fifth of this many samples is stuck: the
#: sensor is dead, or at its end.
_STUCK_SAMPLES = 5
_STUCK_TIMES = 5






class StreamGuard:
    """Accept a stream's samples in order of their stamps; reject and count the others.

    A stamp far from its predecessor is held back until the next sample tells a jump of the clock
    from a stray stamp.
    """

    def __init__(self, limit: float, rejected: Counter[str], name: str) -> None:
        self._limit = limit
        self._rejected = rejected
        self._name = name
        self.epoch = 0
        self.epoch_start_ns = 0
        self._newest_ns: int | None = None
        self._held: Sample | None = None
        self._late_run = 0
        self._late_newest_ns = 0
        self._usual_step_ns = 0.0
        self._step_count = 0
        self._values = _ValueGuard(limits_runs=name == "force")

    @property
    def is_stuck(self) -> bool:
        """Whether the signal repeats itself as it never did before."""
        return self._values.is_stuck

    def reject(self, reason: str) -> None:
        """Count one rejected sample."""
        self._rejected[f"{self._name}.{reason}"] += 1

    def accept(
        self, stamp_ns: int, value: float, position: Position | None = None, load: float = 0.0
    ) -> tuple[Sample, ...]:
        """Check one sample; return what is now accepted: none, this, or a held one and this."""
        if not math.isfinite(value + load) or not all(map(math.isfinite, position or ())):
            self.reject(Reason.NON_FINITE)
            return ()
        if abs(value) > self._limit:
            self.reject(Reason.OUT_OF_RANGE)
            return ()
        if stamp_ns <= 0:
            self.reject(Reason.ZERO_STAMP)
            return ()
        accepted = self._by_stamp(Sample(self.epoch, stamp_ns, value, position, load))
        return self._by_value(accepted) if accepted else ()

    def _by_stamp(self, sample: Sample) -> tuple[Sample, ...]:
        if self._newest_ns is None:
            return self._take(sample)
        if self._held is not None:
            return self._after_held(self._held, sample)
        return self._in_order(sample)

    def _by_value(self, samples: tuple[Sample, ...]) -> tuple[Sample, ...]:
        accepted: list[Sample] = []
        for sample in samples:
            for judged, reason in self._values.judge(sample):
                if reason is None:
                    accepted.append(judged)
                else:
                    self.reject(reason)
        return tuple(accepted)

    def _take(self, *samples: Sample) -> tuple[Sample, ...]:
        if self._newest_ns is not None and samples[0].epoch == self.epoch:
            step_ns = float(samples[-1].stamp_ns - self._newest_ns) / len(samples)
            usual_ns = self._usual_step_ns or step_ns
            self._step_count += 1
            self._usual_step_ns = usual_ns + _GAIN * (step_ns - usual_ns)
        self._newest_ns = samples[-1].stamp_ns
        self._late_run = 0
        return samples

    def _in_order(self, sample: Sample) -> tuple[Sample, ...]:
        assert self._newest_ns is not None
        step = sample.stamp_ns - self._newest_ns
        # Taken at once, a stray stamp a little ahead would make all that come after it late.
        far: float = _FORWARD_JUMP_NS
        if self._step_count >= _USUAL_SAMPLES:
            far = min(_FAR_STEPS * self._usual_step_ns, far)
        if _MIN_STEP_NS <= step <= far:
            return self._take(sample)
        if step > far or step < -_BACKWARD_JUMP_NS:
            self._held = sample
            return ()
        if step > -_MIN_STEP_NS:
            self.reject(Reason.DUPLICATE_STAMP)
            return ()
        return self._late(sample)

    def _late(self, sample: Sample) -> tuple[Sample, ...]:
        in_order = sample.stamp_ns > self._late_newest_ns
        self._late_run = self._late_run + 1 if in_order or self._late_run == 0 else 1
        self._late_newest_ns = sample.stamp_ns
        if self._late_run < _LATE_RUN:
            self.reject(Reason.LATE_STAMP)
            return ()
        return self._take(self._next_epoch(sample))

    def _after_held(self, held: Sample, sample: Sample) -> tuple[Sample, ...]:
        assert self._newest_ns is not None
        self._held = None
        if _MIN_STEP_NS <= sample.stamp_ns - held.stamp_ns <= _FORWARD_JUMP_NS:
            if held.stamp_ns > self._newest_ns:
                return self._take(held, sample)
            first = self._next_epoch(held)
            return self._take(first, sample._replace(epoch=self.epoch))
        future = held.stamp_ns > self._newest_ns
        self.reject(Reason.FUTURE_STAMP if future else Reason.LATE_STAMP)
        return self._in_order(sample)

    def _next_epoch(self, sample: Sample) -> Sample:
        self.join_epoch(self.epoch + 1, sample.stamp_ns)
        return sample._replace(epoch=self.epoch)

    def join_epoch(self, epoch: int, start_ns: int) -> None:
        """Take the following samples to belong to `epoch`, which starts at `start_ns`."""
        self.epoch = epoch
        self.epoch_start_ns = start_ns


class _ValueGuard:
    """Tell values that the sensor can mean from spikes and from a sensor that is stuck.

    Parameters
    ----------
    limits_runs : bool
        Whether a signal that stands still is suspicious; a displacement may well.
    """

    def __init__(self, limits_runs: bool) -> None:
        self._limits_runs = limits_runs
        self._last: Sample | None = None
        self._held: Sample | None = None
        self._usual_change = 0.0
        self._changes = 0
        self._run = 1
        self._longest_run = 1

    @property
    def is_stuck(self) -> bool:
        """Whether the same value came too often in a row."""
        return (
            self._limits_runs
            and self._run >= max(_STUCK_SAMPLES, _STUCK_TIMES * self._longest_run)
            and self._changes >= _USUAL_SAMPLES
        )

    def judge(self, sample: Sample) -> list[tuple[Sample, str | None]]:
        """Return the samples that are now judged, each with the reason to reject it, or None.

        A value far from the last one is held back until the next tells a spike from a step.
        """
        last, held = self._last, self._held
        judged: list[tuple[Sample, str | None]] = []
        if last is None or last.epoch != sample.epoch:
            self._held = None
            self._last = sample
            self._run = 1
            return [(held, None), (sample, None)] if held is not None else [(sample, None)]
        change = abs(sample.value - last.value)
        if held is not None:
            self._held = None
            if change >= 0.5 * abs(held.value - last.value):
                return [(held, self._follow(last, held)), (sample, self._follow(held, sample))]
            judged.append((held, Reason.SPIKE))
        if self._changes >= _USUAL_SAMPLES and change > _SPIKE_CHANGES * self._usual_change > 0.0:
            self._held = sample
            return judged
        judged.append((sample, self._follow(last, sample)))
        return judged

    def _follow(self, last: Sample, sample: Sample) -> str | None:
        self._last = sample
        change = abs(sample.value - last.value)
        if change > 0.0:
            self._changes += 1
            self._learn(change)
            if not self.is_stuck:
                self._longest_run = max(self._longest_run, self._run)
            self._run = 1
            return None
        self._run += 1
        return Reason.STUCK if self.is_stuck else None

    def _learn(self, change: float) -> None:
        # Only of changes: a coarse signal stands still most of the time.
        usual = self._usual_change or change
        self._usual_change = usual + _GAIN * (min(change, _MOST_GROWTH * usual) - usual)


class Synchronizer:
    """Pair force with displacement by stamp.

    Parameters
    ----------
    config : SynchronizeConfig
    on_pair : callable
        Called with each :class:`Pair`, in order.
    rejected : collections.Counter
        Counts of rejected samples, keyed ``"force.<reason>"`` or ``"displacement.<reason>"``;
        added to.
    """

    def __init__(
        self, config: SynchronizeConfig, on_pair: Callable[[Pair], None], rejected: Counter[str]
    ) -> None:
        self._config = config
        self._on_pair = on_pair
        self._delay_ns = round(config.displacement_delay * NANOSECONDS)
        self._max_gap_ns = round(config.max_gap * NANOSECONDS)
        self._window_ns = round(config.pairing_window * NANOSECONDS)
        self.force_guard = StreamGuard(config.force_limit, rejected, "force")
        self.displacement_guard = StreamGuard(config.displacement_limit, rejected, "displacement")
        self._forces: deque[Sample] = deque()
        self._displacements: deque[Sample] = deque()
        self._passed: deque[Sample] = deque(maxlen=_NOISE_SAMPLES)
        self._behind_since_ns: int | None = None

    def motion_noise(self) -> float:
        """Variance of the displacement's noise per sample times the time between samples [m^2 s].

        From how far each of the last samples lies from the line between its neighbours; 0 while
        there are too few.
        """
        if len(self._passed) < _NOISE_SAMPLES // 8:
            return 0.0
        time = np.array([sample.stamp_ns - self._passed[0].stamp_ns for sample in self._passed])
        value = np.array([sample.value for sample in self._passed])
        step = np.diff(time) / NANOSECONDS
        share = step[:-1] / (step[:-1] + step[1:])
        apart = value[1:-1] - (1.0 - share) * value[:-2] - share * value[2:]
        scale = np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
        deviation = float(np.median(np.abs(apart / scale))) / _MEDIAN_OF_NORMAL
        return deviation**2 * float(np.median(step))

    def add_force(self, stamp_ns: int, force: float) -> None:
        """Add a force sample [N]."""
        for sample in self.force_guard.accept(stamp_ns, force):
            self._forces.append(sample)
            self._bound_memory(self._forces, self.force_guard)
            self._pair()

    def add_displacement(
        self,
        stamp_ns: int,
        displacement: float,
        position: Position | None = None,
        load: float = 0.0,
    ) -> None:
        """Add a displacement sample [m], and the probe's position [m] where it is known.

        `load` [N] is what the sensor measures there without any contact.
        """
        for sample in self.displacement_guard.accept(stamp_ns, displacement, position, load):
            if self._delay_ns:
                sample = sample._replace(stamp_ns=sample.stamp_ns - self._delay_ns)
            self._displacements.append(sample)
            self._pair()
            self._bound_memory(self._displacements, self.displacement_guard)

    def _pair(self) -> None:
        forces, displacements = self._forces, self._displacements
        while forces and displacements:
            force = forces[0]
            key = (force.epoch, force.stamp_ns)
            while len(displacements) > 1 and displacements[1][:2] <= key:
                self._passed.append(displacements.popleft())
            before = displacements[0]
            if before[:2] > key:
                self._reject_oldest_force(Reason.UNPAIRED)
                self._follow_displacement(force, before)
            elif before[:2] == key:
                forces.popleft()
                net = force.value - before.load
                self._on_pair(Pair(*key, net, before.value, before.position))
            elif len(displacements) == 1:
                return
            else:
                self._interpolate(force, before, displacements[1])

    def _interpolate(self, force: Sample, before: Sample, after: Sample) -> None:
        if before.epoch != force.epoch or after.epoch != force.epoch:
            self._reject_oldest_force(Reason.UNPAIRED)
            return
        gap_ns = after.stamp_ns - before.stamp_ns
        if gap_ns > self._max_gap_ns:
            self._reject_oldest_force(Reason.DISPLACEMENT_GAP)
            return
        share = (force.stamp_ns - before.stamp_ns) / gap_ns
        displacement = before.value + share * (after.value - before.value)
        position = None
        if before.position is not None and after.position is not None:
            (x0, y0, z0), (x1, y1, z1) = before.position, after.position
            position = (x0 + share * (x1 - x0), y0 + share * (y1 - y0), z0 + share * (z1 - z0))
        self._forces.popleft()
        net = force.value - (before.load + share * (after.load - before.load))
        self._on_pair(Pair(force.epoch, force.stamp_ns, net, displacement, position))

    def _follow_displacement(self, force: Sample, displacement: Sample) -> None:
        """Let the force join an epoch that only the displacement entered, after a window."""
        if displacement.epoch <= self.force_guard.epoch:
            self._behind_since_ns = None
        elif self._behind_since_ns is None:
            self._behind_since_ns = force.stamp_ns
        elif force.stamp_ns - self._behind_since_ns > self._window_ns:
            self.force_guard.join_epoch(displacement.epoch, force.stamp_ns)
            self._behind_since_ns = None

    def _reject_oldest_force(self, reason: str) -> None:
        self._forces.popleft()
        self.force_guard.reject(reason)

    def _bound_memory(self, samples: deque[Sample], guard: StreamGuard) -> None:
        """Drop what has waited for longer than the window.

        A force that waited in vain although its clock jumped back tells that the other stream's
        clock did not: that stream is then taken to be in the same epoch.
        """
        newest = samples[-1]
        while self._waited_ns(samples[0], newest, guard) > self._window_ns:
            samples.popleft()
            if guard is self.force_guard:
                guard.reject(Reason.UNPAIRED)
                if self.displacement_guard.epoch < newest.epoch:
                    self.displacement_guard.join_epoch(newest.epoch, newest.stamp_ns)

    @staticmethod
    def _waited_ns(oldest: Sample, newest: Sample, guard: StreamGuard) -> int:
        if oldest.epoch == newest.epoch:
            return newest.stamp_ns - oldest.stamp_ns
        return newest.stamp_ns - guard.epoch_start_ns
