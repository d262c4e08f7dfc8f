# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One stream waits for another: the samples around each of its stamps, to interpolate between.

Every decision rests on stamps and on the order of samples within their own stream, never on when
samples of the two streams arrive relative to each other. So live, replayed and batched data give
the same matches.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from fden_ros.core.streams.guard import StreamGuard
from fden_ros.core.streams.rotation import Transform, slerp
from fden_ros.core.streams.samples import NANOSECONDS, Position, Sample

#: Samples of a slow stream are interpolated up to 2 usual steps of the leading stream apart, and
#: a sample waits for up to twice as many of its stream.
_GAP_STEPS = 2.0


class Around(NamedTuple):
    """The samples of a stream before and after an instant; the same one twice at its own stamp."""

    before: Sample
    after: Sample
    fraction: float  #: of the time from the one to the other [1]

    @property
    def value(self) -> float:
        """Value at the instant."""
        return self._between(self.before.value, self.after.value)

    @property
    def load(self) -> float:
        """Load at the instant."""
        return self._between(self.before.load, self.after.load)

    @property
    def position(self) -> Position | None:
        """Position at the instant; None where one of the two is not known."""
        if self.before.position is None or self.after.position is None:
            return None
        x, y, z = map(self._between, self.before.position, self.after.position)
        return x, y, z

    def _between(self, before: float, after: float) -> float:
        return before + self.fraction * (after - before)

    @property
    def transform(self) -> Transform:
        """Place and turn at the instant: the place linear, the turn at a constant rate."""
        position, before, after = self.position, self.before.turn, self.after.turn
        assert position is not None and before is not None and after is not None
        is_between = self.after is not self.before
        return Transform(position, slerp(before, after, self.fraction) if is_between else before)


#: From the streams that a sample has been matched with so far, in order.
Matched = tuple[Around, ...]


class Join:
    """Match samples of a leading stream with those of a following one around their stamps.

    Parameters
    ----------
    times : tuple of float
        Samples further apart than the first, and than 2 usual steps of the leading stream, are not
        interpolated between. A sample waits at most for the second, in stamps, or 4 usual steps of
        its stream. The stamps of the following stream lag by the third [s].
    lead_guard, follow_guard : StreamGuard
        The one has accepted the leading samples, and counts those that are rejected here; the
        other accepts the following ones.
    on_match : callable
        Called in order with each leading sample and what it has been matched with, this stream
        last.
    reasons : tuple of str
        Of a leading sample without one around it, and of one in a gap.
    """

    def __init__(
        self,
        times: tuple[float, float, float],
        lead_guard: StreamGuard,
        follow_guard: StreamGuard,
        on_match: Callable[[Sample, Matched], None],
        reasons: tuple[str, str],
    ) -> None:
        times_ns = (round(time * NANOSECONDS) for time in times)
        self._max_gap_ns, self._window_ns, self._delay_ns = times_ns
        self._lead_guard, self.follow_guard = lead_guard, follow_guard
        self._on_match = on_match
        self._unpaired, self._gap = reasons
        self._leading: deque[tuple[Sample, Matched]] = deque()
        self._following: deque[Sample] = deque()
        self._behind_since_ns: int | None = None

    def lead(self, sample: Sample, matched: Matched) -> None:
        """Add an accepted sample of the leading stream, and its matches so far."""
        self._leading.append((sample, matched))
        # Samples that have waited for longer than the window go. If one did so after its clock
        # jumped back, the other's did not jump: that stream is taken to be in the same epoch.
        while self._has_waited(self._leading[0][0], sample, self._lead_guard):
            self._reject_oldest(self._unpaired)
            if self.follow_guard.epoch < sample.epoch:
                self.follow_guard.join_epoch(sample.epoch, sample.stamp_ns)
        self._match()

    def follow(self, stamp_ns: int, value: float, *more: Any) -> None:
        """Add a sample of the following stream, if its guard accepts it."""
        delay_ns, following = self._delay_ns, self._following
        for sample in self.follow_guard.accept(stamp_ns, value, *more):
            if delay_ns:
                sample = sample._replace(stamp_ns=sample.stamp_ns - delay_ns)
            following.append(sample)
            self._match()
            while self._has_waited(following[0], sample, self.follow_guard):
                following.popleft()

    def _match(self) -> None:
        leading, following = self._leading, self._following
        while leading and following:
            lead, matched = leading[0]
            key = lead[:2]
            while len(following) > 1 and following[1][:2] <= key:
                following.popleft()
            before = following[0]
            if before[:2] > key:
                self._reject_oldest(self._unpaired)
                self._join_epoch(lead, before)
                continue
            if before[:2] < key and len(following) == 1:
                return
            after = following[1] if before[:2] < key else before
            gap_ns = after.stamp_ns - before.stamp_ns
            if before.epoch != after.epoch:
                self._reject_oldest(self._unpaired)
            elif gap_ns > max(self._max_gap_ns, _GAP_STEPS * lead.usual_ns):
                self._reject_oldest(self._gap)
            else:
                leading.popleft()
                fraction = (lead.stamp_ns - before.stamp_ns) / max(gap_ns, 1)
                self._on_match(lead, (*matched, Around(before, after, fraction)))

    def _join_epoch(self, lead: Sample, follower: Sample) -> None:
        """Let the leading stream join an epoch that only the other entered, after a window."""
        if follower.epoch <= self._lead_guard.epoch:
            self._behind_since_ns = None
        elif self._behind_since_ns is None:
            self._behind_since_ns = lead.stamp_ns
        elif lead.stamp_ns - self._behind_since_ns > self._window_ns:
            self._lead_guard.join_epoch(follower.epoch, lead.stamp_ns)
            self._behind_since_ns = None

    def _reject_oldest(self, reason: str) -> None:
        self._leading.popleft()
        self._lead_guard.reject(reason)

    def _has_waited(self, oldest: Sample, newest: Sample, guard: StreamGuard) -> bool:
        if oldest is newest:
            return False
        start_ns = oldest.stamp_ns if oldest.epoch == newest.epoch else guard.epoch_start_ns
        waited_ns = newest.stamp_ns - start_ns
        return waited_ns > self._window_ns and waited_ns > 2.0 * _GAP_STEPS * newest.usual_ns
