# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The posterior of one press as it grows: one record, and the hypotheses that explain it.

The order of events, for each block: the filters of all hypotheses take it; the look for a change
or the solutions that are under way go on by the work of a block, and where these have ended the
filters go on from there, by the blocks since. Where the record has grown enough all hypotheses are
solved anew, of the same record, and weighed under the same errors; where a block is not explained,
a change is looked for.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.epoch import Epoch, Weighed, keep_shares, kept, taken_over
from fden_ros.core.estimation.estimator import Innovation
from fden_ros.core.estimation.filter import PressFilter
from fden_ros.core.estimation.hypothesis import LEAST_WEIGHT, Hypothesis
from fden_ros.core.estimation.maxima import Solutions
from fden_ros.core.estimation.mixture import weights_of
from fden_ros.core.estimation.parts import Advanced
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.press_setting import MOST_LATE, PressSetting
from fden_ros.core.estimation.proposals.change import (
    LOOK_PERIOD,
    PROMISING,
    SUSPECTED,
    SUSPICIOUS,
    ChangeLook,
    Look,
    Placing,
)
from fden_ros.core.estimation.record import Block, Record, Sample
from fden_ros.core.estimation.search import Care, Solved
from fden_ros.core.estimation.unknowns import LAW, LINEAR_DELAY, LOG_G, LOG_GN, ORDER, Unknown
from fden_ros.core.estimation.whiteness import NO_CHANCE
from fden_ros.core.law.characteristic import elastic_response

#: The posterior is solved anew when the time since the touch, or the largest compression, has
#: grown by these factors [1], some 20 times a contact; between two the filter is off by half
#: a standard deviation.
_TIME_RATIO, _DEPTH_RATIO = 1.5, 1.25
#: Points that a solution evaluates for each second of samples [1/s]; it is used at the block where
#: it ends: 750 points, some 1.5 ms, a block of 10 ms. Work is counted and
#: not timed, so that what comes of a recording is what came of it live.
_WORK_RATE = 0.75e5
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


#: Hypotheses of one press [1], so that a solution of all has a longest time.
_MOST_HYPOTHESES = 6


class _Begun(NamedTuple):
    """Solutions that have been begun."""

    hypotheses: tuple[Hypothesis, ...]
    end: float  #: of their record [s]
    elapsed: float  #: from the touch to there [s]
    compression: float  #: largest of it [1]
    found: Advanced[list[Weighed]]
    since: list[Block]  #: the blocks after their record


class _Looking(NamedTuple):
    """A look for a change that has been begun."""

    hypothesis: Hypothesis
    found: Advanced[Look]
    end: float  #: of its record [s]
    since: list[Block]  #: the blocks after its record


class _Placing(NamedTuple):
    """A change that is being placed."""

    change: Unknown
    found: Advanced[Unknown]


class PressPosterior:
    """One press.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
    start : float
        Time of the touch [s].
    compression_sd : float
        Standard deviation of a sample's compression [1]; 0: not known yet.
    way : ndarray, shape (3, n), optional
        Of the probe before the touch: times from it [s], compressions [1] and stresses [Pa].

    Attributes
    ----------
    hypotheses : list of Hypothesis
        Those that are not ruled out.
    best : Hypothesis
        The likeliest.
    weighed : list of (float, Hypothesis)
        Those that have a solution, with weights that add up to 1.
    deepest : float
        Largest compression of the press [1].
    begun_at, solved_at : int
        Blocks in the records of the newest solutions that were begun, and of the newest that have
        ended.
    """

    def __init__(
        self,
        hypotheses: Sequence[Hypothesis],
        start: float,
        compression_sd: float = 0.0,
        way: Array | None = None,
    ) -> None:
        self.hypotheses, self._start = list(hypotheses), start
        self.weigh()
        settings = [one.setting for one in hypotheses]
        is_one_sided = settings[0].geometry.is_one_sided
        reach = _REACH * max(one.origin_sd for one in settings) if is_one_sided else 0.0
        is_at_rest = is_one_sided and any(one.carried is None for one in settings)
        late = settings[0].delay_reach
        self.record = Record(compression_sd, reach, is_at_rest=is_at_rest, delay=late)
        # Samples whose motion may not have come yet.
        self._held: deque[tuple[Sample, bool]] = deque()
        if way is not None and (reach or is_at_rest):
            self.record.see_way(way + np.array([[start], [0.0], [0.0]]))
        self.deepest, self.compression_sd = -math.inf, compression_sd
        self._is_surprised = False
        self.begun_at = self.solved_at = 0
        self._samples: list[Sample] = []
        self._now = self._last = self._worked_at = start
        self._is_pressed = False
        self._blocks = self._blocks_at_starts = 0
        self._solved_at = (0.0, 0.0)
        self._begun: _Begun | None = None
        self._look: _Looking | None = None
        self._placing: _Placing | None = None
        self._to_place: Unknown | None = None  # a change
        self._looked_at, self._asked_at = -math.inf, 0.0
        self._suspected_at: float | None = None
        self._is_over = False
        # Whether the records of the solution under way, and of the newest, show a long delay.
        self._begins_with_delay = self._shows_delay = False

    @property
    def setting(self) -> PressSetting:
        """What the likeliest hypothesis knew before the first sample."""
        return self.best.setting

    @property
    def solved(self) -> Solved | None:
        """The newest solution of the likeliest hypothesis; None: there is none yet."""
        return self.best.solved

    def weigh(self) -> None:
        """Weigh the hypotheses that have a solution."""
        self.best = max(self.hypotheses, key=lambda one: one.log_weight)
        solved = [one for one in self.hypotheses if one.solved is not None]
        weights = weights_of([one.log_weight for one in solved]).tolist() if solved else []
        self.weighed = [(w, one) for w, one in zip(weights, solved, strict=True) if w]

    @property
    def likely(self) -> list[Hypothesis]:
        """Those that decide what is claimed."""
        return [one for weight, one in self.weighed if weight >= LEAST_WEIGHT]

    @property
    def change_count(self) -> int:
        """Changes of the tissue under the probe that were found."""
        return self.best.change_count

    @property
    def is_working(self) -> bool:
        """Whether anything is under way."""
        return not (self._begun is None and self._look is None and self._placing is None)

    @property
    def is_solving(self) -> bool:
        """Whether a solution is under way."""
        return self._begun is not None

    @property
    def is_solved(self) -> bool:
        """Whether the newest solution of each likely hypothesis was found."""
        likely = self.likely
        return bool(likely) and all(one.is_solved for one in likely)

    @property
    def is_doubtful(self) -> bool:
        """Whether a newest solution was not found, or the newest block is not explained."""
        if self.solved is None:
            return False
        is_asked = self._suspected_at is not None
        is_explained = self.is_solved and not (
            is_asked or self._is_surprised or self.best.has_turned
        )
        return not is_explained or self._is_delay_open

    @property
    def _is_delay_open(self) -> bool:
        """Whether a long delay is not known so well that the model is linear in it."""
        if self.solved is None or self._filter is None or not self.setting.is_late:
            return False
        if not self._shows_delay:
            return True
        best = self.solved.best
        delay, sd = self.setting.delay(best.mean, best.covariance)
        now, _ = self.setting.delay(self._filter.mean, self._filter.covariance)
        return max(sd, abs(now - delay)) > LINEAR_DELAY

    @property
    def _filter(self) -> PressFilter | None:
        """The likeliest filter; None: there is no solution yet."""
        return self.best.filter

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
        if self._filter is not None and blocks:
            innovation = self._filtered(blocks, compression)
        for under_way in (self._begun, self._look):
            if under_way is not None:
                under_way.since.extend(blocks)
        self._samples = []
        self._blocks += 1
        # What surprises stays unexplained while it is asked whether the tissue has changed.
        is_asked = self._is_surprised and self._suspected_at is not None
        self._is_surprised = is_asked or innovation.normalized_squared > NO_CHANCE**2
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
        work = min(_WORK_RATE * seconds, _MOST_WORK)
        if self._look is not None:
            if self._look.found.advance(_LOOK_HASTE * work):
                self._end_look()
        elif self._placing is not None:
            if self._placing.found.advance(work):
                self._end_placing()
        elif self._begun is not None and self._begun.found.advance(work):
            self.go_on()

    def _suspect(self, since: float) -> None:
        """Look for a change; a solution would absorb it, so that one waits for it to show."""
        if self._look is not None or self._placing is not None:
            return
        if self._now - since < SUSPECTED and self._now - self._looked_at < LOOK_PERIOD:
            return
        if self.solved is not None and self._to_place is None:
            self._begin_look()
            return
        self._suspected_at = None
        if self._begun is None:
            self.begin_solution()

    def _unpredicted(self, stress: float) -> Innovation:
        return Innovation(0.0, stress, 0.0, self.setting.stress_sd**2)

    def _filtered(self, blocks: list[Block], compression: float) -> Innovation:
        """Let the filters take the newest blocks; return how the likeliest predicted them."""
        best = self.best
        points = self.record.points_after(blocks, self._last)
        self._last = float(points.times[-1])
        found = {id(one): one.step(points) for one in self.hypotheses}[id(best)]
        self.weigh()
        own_filter = best.filter
        assert own_filter is not None
        try:
            if found is None:
                raise FloatingPointError("the likeliest filter predicts nothing")
            mean = own_filter.mean
            own = compression + best.past.shift - best.setting.origin(mean)
            strain = best.setting.geometry.strain(own)
            elastic = elastic_response(strain, math.exp(mean[LOG_G]), math.exp(mean[LOG_GN]))
        except (FloatingPointError, OverflowError):
            self._ask_for_solution()
            return self._unpredicted(float(points.stresses[0]))
        return Innovation(elastic.value, found.prediction, found.innovation, found.variance)

    # Solutions

    def _is_due(self) -> bool:
        is_begun = self._begun is not None
        if is_begun or self._blocks < _FIRST_SOLUTION:
            return False
        elapsed, depth = self._solved_at
        return (
            self._now - self._start > _TIME_RATIO * elapsed
            or self.record.max_compression > _DEPTH_RATIO * depth > 0.0
            or self._has_moved()
            or self.best.has_turned
            or self._has_told_delay()
        )

    def _has_told_delay(self) -> bool:
        """Whether the delay has become known since a solution about which the filter is linear."""
        if self.solved is None or self._filter is None or not self._is_delay_open:
            return False
        _, before = self.setting.delay(self.solved.best.mean, self.solved.best.covariance)
        _, now = self.setting.delay(self._filter.mean, self._filter.covariance)
        return now < _TOLD * before

    def _has_moved(self) -> bool:
        """Whether the filter is a standard deviation from the solution about which it is linear.

        It went on by four of them in a hold of a minute.
        """
        if self.solved is None or self._filter is None:
            return False
        law, best = slice(0, len(LAW)), self.solved.best
        moved = np.square(self._filter.mean - best.mean)[law]
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
        best = self.best
        if best.solved is None or not best.setting.can_tell_mismatch:
            return False
        variance = float(best.solved.best.covariance[ORDER, ORDER])
        return variance <= best.setting.config.converged_order_sd**2

    def begin_solution(self, care: Care = Care.TRACKED) -> None:
        """Begin to solve the posterior of the record so far, for all hypotheses."""
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
        elapsed = self._now - self._start
        epoch = Epoch(
            tuple(
                one.search(points, elapsed, self.deepest, self.compression_sd, care)
                for one in self.hypotheses
            )
        )
        self._begun = _Begun(
            tuple(self.hypotheses),
            float(points.times[-1]),
            elapsed,
            self.record.max_compression,
            Advanced(epoch.in_parts),
            [],
        )
        self.begun_at = self._blocks
        if self.setting.is_late:
            # An earlier press of the site has shown it.
            is_known = self.setting.carried is not None
            self._begins_with_delay = is_known or self.record.has_slowed

    def go_on(self) -> None:
        """Go on from the solutions that were begun, by the blocks since."""
        begun, self._begun = self._begun, None
        if begun is None:
            return
        self.solved_at = self.begun_at
        try:
            found = begun.found.result()
        except UNSOLVABLE:
            for one in self.hypotheses:
                one.misses += 1
            return
        self._solved_at = begun.elapsed, begun.compression
        self._shows_delay = self._begins_with_delay
        solved, missed = taken_over(begun.hypotheses, found)
        self._catch_up(solved, begun.end, begun.since)
        keep_shares(self.weighed, missed, solved)
        self.hypotheses = kept(self.hypotheses)
        self.weigh()

    def _catch_up(self, solved: Sequence[Hypothesis], end: float, since: list[Block]) -> None:
        """Go on from solutions whose record ends at a time [s], by the blocks since."""
        if not since:
            self._last = end
            return
        points = self.record.points_after(since, end)
        self._last = float(points.times[-1])
        for one in solved:
            if one in self.hypotheses and one.step(points) is None:
                self._ask_for_solution()

    def _ask_for_solution(self) -> None:
        """Be due for a solution: the filter is too far from the last one."""
        self._solved_at = 0.0, 1e-9

    # Changes of the tissue

    def _posterior_with(
        self, one: Hypothesis, events: tuple[Unknown, ...]
    ) -> Callable[..., Posterior]:
        """Return what makes the posterior of a hypothesis with these events and more."""
        sizes = self.compression_sd, one.deepest(self.deepest)
        return partial(one.setting.posterior_with, events, *sizes)

    def _begin_look(self) -> None:
        """Begin to look whether the tissue has changed under the probe."""
        best = self.best
        assert best.solved is not None
        self._looked_at = self._now
        origin = best.setting.origin(best.solved.best.mean)
        points = best.points(self.record.points())
        made = self._posterior_with(best, best.events)
        strain = best.setting.largest_strain(best.deepest(self.deepest), origin)
        look = ChangeLook(points, best.solved.solutions.maxima, made(), made, strain)
        self._look = _Looking(best, Advanced(look.in_parts), float(points.times[-1]), [])

    def _end_look(self) -> None:
        """Take what a look has found: hypotheses with a change, or a jerk."""
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
            self._begun = None  # of tissue without the event
            self._adopt(looking, look)
            self.begin_solution(Care.EXACT)
        elif self._begun is None:
            self.begin_solution()

    def _adopt(self, looking: _Looking, look: Look) -> None:
        """Put an event in place of its absence, where it was looked for; beside it elsewhere."""
        event, without = look.event, looking.hypothesis
        assert event is not None and without.solved is not None
        self._to_place = event if event.since is not None else None
        others = [one for one in self.hypotheses if one is not without]
        changed = without.with_event(event)
        # What one explains by a change another may explain without it.
        beside = [one.with_event(event) for one in others]
        self.hypotheses = ([changed, *others, *beside])[:_MOST_HYPOTHESES]
        if look.posterior is not None and look.solution is not None:
            solution = look.solution
            found = Solutions((solution,), (solution.log_evidence,))
            solved = replace(without.solved, posterior=look.posterior, solutions=found)
            changed.take_over(solved, 0.0)
            changed.shift_weight(without.log_weight - changed.log_weight)
            self._catch_up([changed], looking.end, looking.since)
        self.weigh()

    @property
    def _is_to_be_placed(self) -> bool:
        """Whether the newest change is to be placed anew: it has been seen for long enough."""
        change = self._to_place
        if change is None or self.solved is None:
            return False
        assert change.since is not None
        return self._now - change.since >= _PLACED_AFTER

    def _begin_placing(self) -> None:
        change, self._to_place, best = self._to_place, None, self.best
        if change is None or change not in best.events or best.solved is None:
            return
        rest = tuple(event for event in best.events if event is not change)
        made = self._posterior_with(best, best.events)()
        placing = Placing(
            best.points(self.record.points()),
            best.solved.grown(best.solved.best, made),
            best.solved.best,
            self._posterior_with(best, rest),
            change,
        )
        self._placing = _Placing(change, Advanced(placing.in_parts))

    def _end_placing(self) -> None:
        """Take the newest change where it was placed."""
        assert self._placing is not None
        placing, self._placing = self._placing, None
        placed = placing.found.result()
        for one in self.hypotheses:
            one.events = tuple(placed if e is placing.change else e for e in one.events)
        self.begin_solution()
