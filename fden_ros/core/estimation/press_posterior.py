# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The posterior of one press as it grows: record, solutions, and the filter between them.

The order of events, for each block: the filter takes it; the look for a change or the solution
that is under way goes on by the work of a block, and where a solution has ended the filter goes on
from there, by the blocks since. Where the record has grown enough a solution begins; where a block
is not explained, a look for a change.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.change import (
    LOOK_PERIOD,
    PROMISING,
    SUSPECTED,
    SUSPICIOUS,
    THRESHOLD,
    ChangeLook,
    Look,
    Placing,
)
from fden_ros.core.estimation.estimator import Innovation
from fden_ros.core.estimation.filter import PressFilter
from fden_ros.core.estimation.modes import Modes
from fden_ros.core.estimation.parts import Advanced
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.press_setting import MOST_LATE, PressSetting
from fden_ros.core.estimation.record import Block, Record, Sample
from fden_ros.core.estimation.search import Care, Search, Solved
from fden_ros.core.estimation.unknowns import (
    LAW,
    LINEAR_DELAY,
    LOG_G,
    LOG_GN,
    ORDER,
    Unknown,
)
from fden_ros.core.estimation.whiteness import NO_CHANCE
from fden_ros.core.law.characteristic import elastic_response

#: The posterior is solved anew when the time since the touch, or the largest compression, has
#: grown by these factors [1], some 20 times a contact; between two the filter is off by half
#: a standard deviation.
_TIME_RATIO, _DEPTH_RATIO = 1.35, 1.18
#: Points that a solution evaluates for each second of samples [1/s]; it is used at the block where
#: it ends: 1200 points, some 2 to 4 ms, a block of 10 ms. Work is counted and
#: not timed, so that what comes of a recording is what came of it live.
_WORK_RATE = 1.2e5
#: At most so much of it at a block [1]: 0.25 s of samples.
_MOST_WORK = 3e4
#: A look for a change has this much more, since it has to tell within 0.1 s [1].
_LOOK_HASTE = 12.0
#: A long delay is told anew where its standard deviation has fallen to this part [1].
_TOLD = 0.5
#: Blocks before the first solution [1]; it is sought from all starts each time that their number
#: has doubled.
_FIRST_SOLUTION = 4
#: The touch may be this many standard deviations of the origin before its nominal place [1].
_REACH = 6.0
#: A change is placed anew once it was seen for this time [s].
_PLACED_AFTER = 0.1


class _Begun(NamedTuple):
    """A solution that has been begun."""

    search: Search
    compression: float  #: largest of its record [1]
    found: Advanced[Solved]
    since: list[Block]  #: the blocks after its record


class _Looking(NamedTuple):
    """A look for a change that has been begun."""

    found: Advanced[Look]
    end: float  #: of its record [s]
    since: list[Block]  #: the blocks after its record


class PressPosterior:
    """One press.

    Parameters
    ----------
    setting : PressSetting
    start : float
        Time of the touch [s].
    deepest : float
        Largest compression of the site so far [1].
    compression_sd : float
        Standard deviation of a sample's compression [1]; 0: not known yet.
    way : ndarray, shape (3, n), optional
        Of the probe before the touch: times from it [s], compressions [1] and stresses [Pa].

    Attributes
    ----------
    solved : Solved or None
        The newest solution; None: there is none yet.
    filter : PressFilter or None
        Has gone on from it.
    events : tuple of Unknown
        Changes of the tissue under the probe, and jerks.
    is_lost : bool
        The newest solution was not found.
    begun_at, solved_at : int
        Blocks in the records of the newest solution that was begun, and of the newest that has
        ended.
    work_share : float
        Part of the work of a block that is its own [1].
    """

    def __init__(
        self,
        setting: PressSetting,
        start: float,
        deepest: float = 0.0,
        compression_sd: float = 0.0,
        way: Array | None = None,
    ) -> None:
        self.setting, self._start = setting, start
        is_one_sided = setting.geometry.is_one_sided
        reach = _REACH * setting.origin_sd if is_one_sided else 0.0
        is_at_rest = is_one_sided and setting.carried is None
        late = setting.delay_reach
        self.record = Record(compression_sd, reach, is_at_rest=is_at_rest, delay=late)
        # Samples whose motion may not have come yet.
        self._held: deque[tuple[Sample, bool]] = deque()
        if way is not None and (reach or is_at_rest):
            self.record.see_way(way + np.array([[start], [0.0], [0.0]]))
        self.deepest, self.compression_sd = deepest, compression_sd
        self.solved: Solved | None = None
        self.filter: PressFilter | None = None
        self.events: tuple[Unknown, ...] = ()
        self.is_lost = self._is_surprised = False
        self.begun_at = self.solved_at = 0
        self._samples: list[Sample] = []
        self._now = self._last = self._worked_at = start
        self.work_share = 1.0
        self._is_pressed = False
        self._blocks = self._blocks_at_starts = 0
        self._solved_at = (0.0, 0.0)
        self._begun: _Begun | None = None
        self._look: _Looking | None = None
        self._placing: Advanced[Unknown] | None = None
        self._is_placed = True
        self._looked_at, self._asked_at = -math.inf, 0.0
        self._size_at_look = 0
        self._suspected_at: float | None = None
        self._is_over = False
        # Whether the records of the solution under way, and of the newest, show a long delay.
        self._begins_with_delay = self._shows_delay = False

    @property
    def change_count(self) -> int:
        """Changes of the tissue under the probe that were found."""
        return sum(event.since is not None for event in self.events)

    @property
    def is_working(self) -> bool:
        """Whether anything is under way."""
        return not (self._begun is None and self._look is None and self._placing is None)

    @property
    def is_solving(self) -> bool:
        """Whether a solution is under way."""
        return self._begun is not None

    @property
    def log_evidence(self) -> float:
        """Log evidence of the record for what was known before it, at the newest solution.

        A change counts as what makes one in a thousand contacts.
        """
        if self.solved is None or self.is_lost:
            return -math.inf
        modes = self.solved.modes
        found = modes.best.log_evidence + modes.log_gain
        return found + self.solved.posterior.log_prior_density - THRESHOLD * self.change_count

    @property
    def is_doubtful(self) -> bool:
        """Whether the newest solution was not found, or the newest block is not explained."""
        if self.solved is None:
            return False
        return (
            self._is_surprised
            or self.is_lost
            or not self.solved.best.is_solved
            or self._is_delay_open
        )

    @property
    def _is_delay_open(self) -> bool:
        """Whether a long delay is not known so well that the model is linear in it."""
        if self.solved is None or self.filter is None or not self.setting.is_late:
            return False
        if not self._shows_delay:
            return True
        best = self.solved.best
        delay, sd = self.setting.delay(best.mean, best.covariance)
        now, _ = self.setting.delay(self.filter.mean, self.filter.covariance)
        return max(sd, abs(now - delay)) > LINEAR_DELAY

    # Samples

    def take(self, sample: Sample, compression_sd: float, *, is_free: bool) -> None:
        """Take a sample whose compression has a standard deviation [1]."""
        if compression_sd:
            self.compression_sd = compression_sd
            self.record.noise_sd = self.record.noise_sd or compression_sd
        if not self.setting.is_late:
            self._take(sample, is_free=is_free)
            return
        self._held.append((sample, is_free))
        until = sample.time - self._lateness()
        while self._held and self._held[0][0].time <= until:
            held, was_free = self._held.popleft()
            self._take(held, is_free=was_free)

    def _lateness(self) -> float:
        """Return how late the displacement may be [s], as far as is known by now."""
        most = self.setting.delay_reach
        if self.solved is None:
            return most
        delay, sd = self.setting.delay(self.solved.best.mean, self.solved.best.covariance)
        return min(max(delay + MOST_LATE * sd, 0.0), most)

    def _take(self, sample: Sample, *, is_free: bool) -> None:
        self._now = sample.time
        self._is_pressed |= not is_free
        is_observed = not (is_free and self._is_pressed)
        self.record.add(*sample, is_observed=is_observed)
        if is_observed:
            self._samples.append(sample)
            self.deepest = max(self.deepest, sample.compression)

    def skip(self) -> None:
        """Let the samples since the last block go by."""
        self._samples = []

    def update(self, stress: float, compression: float, *, is_past: bool = False) -> Innovation:
        """Take the block of the samples since the last; return how the filter predicted it.

        Parameters
        ----------
        stress, compression : float
            Means of the block [Pa, 1].
        is_past : bool
            Later samples have come already: a solution would have less time.

        """
        innovation = self._unpredicted(stress)
        if self._held:
            self.record.see_ahead([sample for sample, _ in self._held])
        blocks = self.record.blocks(self._samples) if self._samples else []
        if self.filter is not None and blocks:
            innovation = self._filtered(self.filter, blocks, compression)
        for under_way in (self._begun, self._look):
            if under_way is not None:
                under_way.since.extend(blocks)
        self._samples = []
        self._blocks += 1
        self._is_surprised = innovation.normalized_squared > NO_CHANCE**2
        if innovation.normalized_squared > SUSPICIOUS**2 and self._suspected_at is None:
            self._suspected_at = self._now
        if self._suspected_at is not None:
            self._suspect(self._suspected_at)
        elif self._is_due() and not is_past:
            if self._is_to_be_placed:
                self._begin_placing()
            else:
                self.begin_solution()
        self.work(self._now - self._worked_at)
        self._worked_at = self._now
        return innovation

    def work(self, seconds: float) -> None:
        """Go on with what is under way, by the work of a time [s]."""
        work = self.work_share * min(_WORK_RATE * seconds, _MOST_WORK)
        if self._look is not None:
            if self._look.found.advance(_LOOK_HASTE * work):
                self._end_look()
        elif self._placing is not None:
            if self._placing.advance(work):
                self._end_placing()
        elif self._begun is not None and self._begun.found.advance(work):
            self.go_on()

    def _suspect(self, since: float) -> None:
        """Look for a change; a solution would absorb it, so that one waits for it to show."""
        if self._look is not None or self._placing is not None:
            return
        if self._now - since < SUSPECTED and self._now - self._looked_at < LOOK_PERIOD:
            return
        if self.solved is not None and self._is_placed:
            self._begin_look()
            return
        self._suspected_at = None
        if self._begun is None:
            self.begin_solution()

    def _unpredicted(self, stress: float) -> Innovation:
        return Innovation(0.0, stress, 0.0, self.setting.stress_sd**2)

    def _filtered(
        self, own_filter: PressFilter, blocks: list[Block], compression: float
    ) -> Innovation:
        """Let the filter take the newest blocks."""
        points = self.record.points_after(blocks, self._last)
        self._last = float(points.times[-1])
        try:
            found = own_filter.step(points)
            mean = own_filter.mean
            strain = self.setting.geometry.strain(compression - self.setting.origin(mean))
            elastic = elastic_response(strain, math.exp(mean[LOG_G]), math.exp(mean[LOG_GN]))
        except (FloatingPointError, OverflowError):
            self._ask_for_solution()
            return self._unpredicted(float(points.stresses[0]))
        return Innovation(elastic.value, found.prediction, found.innovation, found.variance)

    # Solutions

    def _made(self, events: tuple[Unknown, ...]) -> Callable[[type[PressModel]], Posterior]:
        return partial(self.setting.posterior, events, self.compression_sd, self.deepest)

    def _made_with(self, events: tuple[Unknown, ...]) -> Callable[..., Posterior]:
        """Return what makes the posterior with more events."""
        sizes = self.compression_sd, self.deepest
        return partial(self.setting.posterior_with, events, *sizes)

    def _is_due(self) -> bool:
        is_begun = self._begun is not None
        if is_begun or self._blocks < _FIRST_SOLUTION:
            return False
        elapsed, depth = self._solved_at
        return (
            self._now - self._start > _TIME_RATIO * elapsed
            or self.record.max_compression > _DEPTH_RATIO * depth > 0.0
            or self._has_moved()
            or self._has_told_delay()
        )

    def _has_told_delay(self) -> bool:
        """Whether the delay has become known since a solution about which the filter is linear."""
        if self.solved is None or self.filter is None or not self._is_delay_open:
            return False
        _, before = self.setting.delay(self.solved.best.mean, self.solved.best.covariance)
        _, now = self.setting.delay(self.filter.mean, self.filter.covariance)
        return now < _TOLD * before

    def _has_moved(self) -> bool:
        """Whether the filter is a standard deviation from the solution about which it is linear.

        It went on by four of them in a hold of a minute.
        """
        if self.solved is None or self.filter is None:
            return False
        law, best = slice(0, len(LAW)), self.solved.best
        moved = np.square(self.filter.mean - best.mean)[law]
        return bool(np.any(moved > best.covariance.diagonal()[law]))

    def begin_last(self) -> None:
        """Begin to solve at the end of the press, from all starts, behind what is under way."""
        self._is_over, self._begun = True, None
        self.record.see_ahead([sample for sample, _ in self._held])
        if self._look is None and self._placing is None:
            self.begin_solution()

    def finish(self) -> None:
        """Do what is left of that now."""
        if self._look is not None:
            self._end_look()
        if self._placing is not None:
            self._end_placing()
        self.go_on()

    @property
    def _is_order_known(self) -> bool:
        """Whether alpha is as well known as one that has converged, so that it may be claimed."""
        if self.solved is None or not self.setting.can_tell_mismatch:
            return False
        variance = float(self.solved.best.covariance[ORDER, ORDER])
        return variance <= self.setting.config.converged_order_sd**2

    def begin_solution(self, care: Care = Care.TRACKED) -> None:
        """Begin to solve the posterior of the record so far."""
        points = self.record.points()
        if points.stresses.size < _FIRST_SOLUTION or self._blocks < _FIRST_SOLUTION:
            return
        if self._is_over:
            care = Care.LAST
        if 2 * self._blocks_at_starts <= self._blocks or self.solved is None:
            care = max(care, Care.FROM_STARTS)
        if self._is_order_known and self._now - self._start >= 2.0 * self._asked_at:
            care, self._asked_at = max(care, Care.ASKED), self._now - self._start
        if care >= Care.FROM_STARTS:
            self._blocks_at_starts = self._blocks
        made, elapsed = self._made(self.events), self._now - self._start
        search = Search(self.setting, made, points, self.solved, elapsed, self.deepest, care)
        found = Advanced(search.in_parts)
        self._begun = _Begun(search, self.record.max_compression, found, [])
        self.begun_at = self._blocks
        if self.setting.is_late:
            # An earlier press of the site has shown it.
            is_known = self.setting.carried is not None
            self._begins_with_delay = is_known or self.record.has_slowed

    def go_on(self) -> None:
        """Go on from the solution that was begun, by the blocks since."""
        begun, self._begun = self._begun, None
        if begun is None:
            return
        search = begun.search
        self.solved_at = self.begun_at
        try:
            solved = begun.found.result()
        except UNSOLVABLE:
            self.is_lost = True
            return
        self._solved_at = search.elapsed, begun.compression
        self._shows_delay = self._begins_with_delay
        self._take_over(solved, float(search.points.times[-1]), begun.since)

    def _take_over(self, solved: Solved, end: float, since: list[Block]) -> None:
        """Go on from a solution whose record ends at a time [s], by the blocks since."""
        self.is_lost, self.solved, self._last = False, solved, end
        self.filter = PressFilter(solved.best, solved.model, solved.posterior.error_model)
        if not since:
            return
        points = self.record.points_after(since, self._last)
        self._last = float(points.times[-1])
        try:
            self.filter.step(points)
        except (FloatingPointError, OverflowError):
            self._ask_for_solution()

    def _ask_for_solution(self) -> None:
        """Be due for a solution: the filter is too far from the last one."""
        self._solved_at = 0.0, 1e-9

    # Changes of the tissue, and another law

    def _begin_look(self) -> None:
        """Begin to look whether the tissue has changed under the probe."""
        assert self.solved is not None
        self._looked_at = self._now
        origin = self.setting.origin(self.solved.best.mean)
        points = self.record.points()
        look = ChangeLook(
            points,
            self.solved.modes.solutions,
            self._made(self.events)(PressModel),
            self._made_with(self.events),
            self.setting.largest_strain(self.deepest, origin),
        )
        self._look = _Looking(Advanced(look.in_parts), float(points.times[-1]), [])

    def _end_look(self) -> None:
        """Take what a look has found: a change is an unknown more."""
        assert self._look is not None and self._suspected_at is not None
        looking, self._look = self._look, None
        try:
            look = looking.found.result()
        except UNSOLVABLE:
            look = Look(None, -math.inf)
        elapsed = self._looked_at - self._suspected_at
        is_open = elapsed < LOOK_PERIOD or (elapsed < SUSPECTED and look.gain > PROMISING)
        if look.event is None and is_open and not self._is_over:
            return
        self._suspected_at = None
        if look.event is not None:
            self.events = (*self.events, look.event)
            self._is_placed = look.event.since is None
            self._begun = None  # of tissue without the event
            if look.posterior is not None and look.solution is not None:
                assert self.solved is not None
                modes = Modes((look.solution,))
                solved = replace(self.solved, posterior=look.posterior, modes=modes)
                self._take_over(solved, looking.end, looking.since)
            self.begin_solution(Care.EXACT)
        elif self._begun is None:
            self.begin_solution()

    @property
    def _is_to_be_placed(self) -> bool:
        """Whether the newest change is to be placed anew: it has been seen for long enough."""
        if self._is_placed or self.solved is None:
            return False
        since = self.events[-1].since
        return since is not None and self._now - since >= _PLACED_AFTER

    def _begin_placing(self) -> None:
        assert self.solved is not None
        self._is_placed = True
        placing = Placing(
            self.record.points(),
            self.solved.grown(self.solved.best, self._made(self.events)(PressModel)),
            self.solved.best,
            self._made_with(self.events[:-1]),
            self.events[-1],
        )
        self._placing = Advanced(placing.in_parts)

    def _end_placing(self) -> None:
        """Take the newest change where it was placed."""
        assert self._placing is not None
        placing, self._placing = self._placing, None
        self.events = (*self.events[:-1], placing.result())
        self.begin_solution()
