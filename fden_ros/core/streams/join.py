# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One stream waits for another: the samples around each of its stamps, between which to go.

Every decision rests on stamps and on the order of samples within their own stream, never on when
samples of the two streams arrive relative to each other. So live, replayed and batched data give
the same matches.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from fden_ros.core.streams.guard import StreamGuard
from fden_ros.core.streams.rotation import Quaternion
from fden_ros.core.streams.samples import Position, Sample

#: The noise of a stream is measured over its last 256 samples.
NOISE_SAMPLES = 256
#: In a slow stream samples up to 2 usual steps of the leading stream apart are interpolated
#: between, and a sample waits for up to 4 usual steps of its stream.
_GAP_STEPS, _WINDOW_STEPS = 2.0, 4.0
#: More samples than the pairs of a window leave behind.
_MOST_AHEAD = 65_536


class Around(NamedTuple):
    """The samples of a stream before and after an instant; the same one twice at its own stamp."""

    before: Sample
    after: Sample
    fraction: float  #: of the time from the one to the other [1]

    @property
    def value(self) -> float:
        """Value at the instant, linear in between."""
        return self.before.value + self.fraction * (self.after.value - self.before.value)

    @property
    def load(self) -> float:
        """Load at the instant, linear in between."""
        return self.before.load + self.fraction * (self.after.load - self.before.load)

    @property
    def position(self) -> Position | None:
        """Position at the instant, linear in between; None where one of the two is not known."""
        before, after, fraction = self
        if before.position is None or after.position is None:
            return None
        (x0, y0, z0), (x1, y1, z1) = before.position, after.position
        return x0 + fraction * (x1 - x0), y0 + fraction * (y1 - y0), z0 + fraction * (z1 - z0)


#: Of the streams that a sample has been matched with so far, in order.
Matched = tuple[Around, ...]


@dataclass(frozen=True)
class JoinLimits:
    """How far a join looks; times in ns.

    Parameters
    ----------
    unpaired, gap : str
        Reasons to reject a leading sample: without a sample around it; in a gap.
    """

    #: Samples further apart than this, and than 2 usual steps of the leading stream, are not
    #: interpolated between.
    max_gap_ns: int
    #: A sample waits at most this long, in stamps; or 4 usual steps of its stream, where they are
    #: longer.
    window_ns: int
    delay_ns: int  #: the following stream's stamps lag the leading one's by this much
    unpaired: str
    gap: str


class Passed:
    """The newest samples of a stream that the pairs so far have left behind.

    Pairs that wait for yet another stream leave samples behind too: those count from when the
    pair is made, so that what is known at a pair does not depend on how long it waited.
    """

    def __init__(self) -> None:
        self.samples: deque[Sample] = deque(maxlen=NOISE_SAMPLES)  #: the last 256
        self._ahead: deque[tuple[tuple[int, int], Sample]] = deque(maxlen=_MOST_AHEAD)

    def add(self, key: tuple[int, int], sample: Sample) -> None:
        """Take a sample that was left behind by the leading sample of this epoch and stamp."""
        self._ahead.append((key, sample))

    def until(self, key: tuple[int, int]) -> None:
        """Count what was left behind up to this epoch and stamp, of which a pair is made."""
        while self._ahead and self._ahead[0][0] <= key:
            self.samples.append(self._ahead.popleft()[1])


class Join:
    """Match samples of a leading stream with those of a following one around their stamps.

    Parameters
    ----------
    lead_guard : StreamGuard
        Has accepted the leading samples, and counts those that are rejected here.
    follow_guard : StreamGuard
        Accepts the following ones.
    on_match : callable
        Called in order with each leading sample and what it has been matched with, this stream
        last.
    """

    def __init__(
        self,
        limits: JoinLimits,
        lead_guard: StreamGuard,
        follow_guard: StreamGuard,
        on_match: Callable[[Sample, Matched], None],
    ) -> None:
        self._limits = limits
        self._lead_guard, self._follow_guard = lead_guard, follow_guard
        self._on_match = on_match
        self._leading: deque[tuple[Sample, Matched]] = deque()
        self._following: deque[Sample] = deque()
        #: The samples of the following stream that nothing waits for any more.
        self.passed = Passed()
        self._behind_since_ns: int | None = None

    @property
    def waiting(self) -> int:
        """How many samples of both streams are kept."""
        return len(self._leading) + len(self._following)

    def lead(self, sample: Sample, matched: Matched) -> None:
        """Take an accepted sample of the leading stream, and what it is matched with already."""
        self._leading.append((sample, matched))
        self._bound_leading(sample)
        self._match()

    def follow(
        self,
        stamp_ns: int,
        value: float,
        position: Position | None = None,
        load: float = 0.0,
        turn: Quaternion | None = None,
    ) -> None:
        """Take a sample of the following stream, if its guard accepts it."""
        delay_ns = self._limits.delay_ns
        for sample in self._follow_guard.accept(stamp_ns, value, position, load, turn):
            if delay_ns:
                sample = sample._replace(stamp_ns=sample.stamp_ns - delay_ns)
            self._following.append(sample)
            self._match()
            self._bound_following()

    def _match(self) -> None:
        leading, following = self._leading, self._following
        while leading and following:
            lead, matched = leading[0]
            key = (lead.epoch, lead.stamp_ns)
            while len(following) > 1 and following[1][:2] <= key:
                self.passed.add(key, following.popleft())
            before = following[0]
            if before[:2] > key:
                self._reject_oldest(self._limits.unpaired)
                self._join_epoch(lead, before)
            elif before[:2] == key:
                leading.popleft()
                self._on_match(lead, (*matched, Around(before, before, 0.0)))
            elif len(following) == 1:
                return
            else:
                self._between(lead, matched, before, following[1])

    def _between(self, lead: Sample, matched: Matched, before: Sample, after: Sample) -> None:
        if before.epoch != lead.epoch or after.epoch != lead.epoch:
            self._reject_oldest(self._limits.unpaired)
            return
        gap_ns = after.stamp_ns - before.stamp_ns
        if gap_ns > max(self._limits.max_gap_ns, _GAP_STEPS * lead.usual_ns):
            self._reject_oldest(self._limits.gap)
            return
        self._leading.popleft()
        fraction = (lead.stamp_ns - before.stamp_ns) / gap_ns
        self._on_match(lead, (*matched, Around(before, after, fraction)))

    def _join_epoch(self, lead: Sample, follower: Sample) -> None:
        """Let the leading stream join an epoch that only the other entered, after a window."""
        if follower.epoch <= self._lead_guard.epoch:
            self._behind_since_ns = None
        elif self._behind_since_ns is None:
            self._behind_since_ns = lead.stamp_ns
        elif lead.stamp_ns - self._behind_since_ns > self._limits.window_ns:
            self._lead_guard.join_epoch(follower.epoch, lead.stamp_ns)
            self._behind_since_ns = None

    def _reject_oldest(self, reason: str) -> None:
        self._leading.popleft()
        self._lead_guard.reject(reason)

    def _bound_leading(self, newest: Sample) -> None:
        """Drop samples that have waited for longer than the window.

        If one was dropped after its clock jumped back, the other stream's clock did not jump: that
        stream is then taken to be in the same epoch.
        """
        while self._has_waited(self._leading[0][0], newest, self._lead_guard):
            self._reject_oldest(self._limits.unpaired)
            if self._follow_guard.epoch < newest.epoch:
                self._follow_guard.join_epoch(newest.epoch, newest.stamp_ns)

    def _bound_following(self) -> None:
        newest = self._following[-1]
        while self._has_waited(self._following[0], newest, self._follow_guard):
            self._following.popleft()

    def _has_waited(self, oldest: Sample, newest: Sample, guard: StreamGuard) -> bool:
        if oldest is newest:
            return False
        start_ns = oldest.stamp_ns if oldest.epoch == newest.epoch else guard.epoch_start_ns
        window_ns = max(self._limits.window_ns, _WINDOW_STEPS * newest.usual_ns)
        return newest.stamp_ns - start_ns > window_ns
