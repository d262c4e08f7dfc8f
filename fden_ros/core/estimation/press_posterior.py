# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The posterior of one press as it grows: record, solutions, and the filter between them.

The order of events, for each block: the filter takes it; where the record has grown enough, the
posterior is solved anew beside, and after a time that the data tell the filter goes on from there,
by the blocks since. Where a block is not explained a change is looked for at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
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
    Look,
    change_of,
    placed,
)
from fden_ros.core.estimation.estimator import Innovation
from fden_ros.core.estimation.filter import PressFilter
from fden_ros.core.estimation.parts import Advanced
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.press_setting import PressSetting
from fden_ros.core.estimation.record import Block, Record, Sample
from fden_ros.core.estimation.search import Care, Search, Solved
from fden_ros.core.estimation.unknowns import LAW, LOG_G, LOG_GN, ORDER, Unknown
from fden_ros.core.estimation.whiteness import NO_CHANCE
from fden_ros.core.law.characteristic import elastic_response

#: The posterior is solved anew when the time since the touch, or the largest compression, has
#: grown by these factors [1], some 20 times a contact; between two the filter is off by half
#: a standard deviation.
_TIME_RATIO, _DEPTH_RATIO = 1.35, 1.18
#: A solution goes on by so many points evaluated at each block, and is used at the block in which
#: it ends.
BUDGET = 2000
#: Blocks before the first solution [1]; it is sought from all starts each time that their number
#: has doubled.
_FIRST_SOLUTION = 4
#: The touch may be this many standard deviations of the origin before its nominal place [1].
_REACH = 6.0
#: A change is placed anew once it was seen for this time [s], within this time [s].
_PLACED_AFTER, _PLACED_WITHIN = 0.1, 0.04


class _Begun(NamedTuple):
    """A solution that has been begun."""

    search: Search
    compression: float  #: largest of its record [1]
    found: Advanced[Solved]
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
    executor : Executor or None
        Where solutions are computed; None: here.
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
    """

    def __init__(
        self,
        setting: PressSetting,
        start: float,
        deepest: float = 0.0,
        compression_sd: float = 0.0,
        executor: Executor | None = None,
        way: Array | None = None,
    ) -> None:
        self.setting, self._start, self._executor = setting, start, executor
        is_one_sided = setting.geometry.is_one_sided
        reach = _REACH * setting.origin_sd if is_one_sided else 0.0
        is_at_rest = is_one_sided and setting.carried is None
        self.record = Record(compression_sd, reach, is_at_rest=is_at_rest)
        if way is not None and (reach or is_at_rest):
            self.record.see_way(way + np.array([[start], [0.0], [0.0]]))
        self.deepest, self.compression_sd = deepest, compression_sd
        self.solved: Solved | None = None
        self.filter: PressFilter | None = None
        self.events: tuple[Unknown, ...] = ()
        self.is_lost = self._is_surprised = False
        self.begun_at = self.solved_at = 0
        self._samples: list[Sample] = []
        self._now = self._last = start
        self._is_pressed = False
        self._blocks = self._blocks_at_starts = 0
        self._solved_at = (0.0, 0.0)
        self._begun: _Begun | None = None
        self._is_placed = True
        self._looked_at, self._asked_at = -math.inf, 0.0
        self._size_at_look = 0
        self._suspected_at: float | None = None

    @property
    def change_count(self) -> int:
        """Changes of the tissue under the probe that were found."""
        return sum(event.since is not None for event in self.events)

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
        return self._is_surprised or self.is_lost or not self.solved.best.is_solved

    # Samples

    def take(self, sample: Sample, compression_sd: float, *, is_free: bool) -> None:
        """Take a sample whose compression has a standard deviation [1]."""
        self._now = sample.time
        if compression_sd:
            self.compression_sd = compression_sd
            self.record.noise_sd = self.record.noise_sd or compression_sd
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
        blocks = self.record.blocks(self._samples) if self._samples else []
        if self.filter is not None and blocks:
            innovation = self._filtered(self.filter, blocks, compression)
        if self._begun is not None:
            self._begun.since.extend(blocks)
            if self._begun.found.advance(BUDGET):
                self.go_on()
        self._samples = []
        self._blocks += 1
        self._is_surprised = innovation.normalized_squared > NO_CHANCE**2
        if innovation.normalized_squared > SUSPICIOUS**2 and self._suspected_at is None:
            self._suspected_at = self._now
        if self._suspected_at is not None:
            self._suspect(self._suspected_at)
        elif self._is_due() and not is_past:
            self.begin_solution()
        return innovation

    def _suspect(self, since: float) -> None:
        """Look for a change; a solution would absorb it, so that one waits for it to show."""
        if self.record.is_full and self.record.size == self._size_at_look:
            # It takes no more, and shows what it has shown.
            self._suspected_at = None
            return
        elapsed = self._now - since
        if elapsed < SUSPECTED and self._now - self._looked_at < LOOK_PERIOD:
            return
        look = self._look_for_change()
        is_open = elapsed < LOOK_PERIOD or (elapsed < SUSPECTED and look.gain > PROMISING)
        if look.event is not None or not is_open:
            self._suspected_at = None
            if look.event is not None:
                self.solve()
            elif self._begun is None:
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

    def _posterior(self, events: tuple[Unknown, ...]) -> Posterior:
        return self._made(events)(PressModel)

    def _made(self, events: tuple[Unknown, ...]) -> Callable[[type[PressModel]], Posterior]:
        return partial(self.setting.posterior, events, self.compression_sd, self.deepest)

    def _is_due(self) -> bool:
        is_begun = self._begun is not None
        if is_begun or self._blocks < _FIRST_SOLUTION or self.record.is_full:
            return False
        elapsed, depth = self._solved_at
        return (
            self._now - self._start > _TIME_RATIO * elapsed
            or self.record.max_compression > _DEPTH_RATIO * depth > 0.0
            or self._has_moved()
        )

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
        """Begin to solve at the end of the press, from all starts."""
        self._begun = None
        if self._blocks >= _FIRST_SOLUTION:
            self.begin_solution(Care.LAST)

    def solve(self) -> None:
        """Solve the posterior of the record so far now, from all starts."""
        self.begin_solution(Care.EXACT)
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
        self._place_again()
        points = self.record.points()
        if points.stresses.size < _FIRST_SOLUTION:
            return
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
        self.is_lost, self.solved = False, solved
        self._last = float(search.points.times[-1])
        self._solved_at = search.elapsed, begun.compression
        self.filter = PressFilter(solved.best, solved.model, solved.posterior.error_model)
        if not begun.since:
            return
        points = self.record.points_after(begun.since, self._last)
        self._last = float(points.times[-1])
        try:
            self.filter.step(points)
        except (FloatingPointError, OverflowError):
            self._ask_for_solution()

    def _ask_for_solution(self) -> None:
        """Be due for a solution: the filter is too far from the last one."""
        self._solved_at = 0.0, 1e-9

    # Changes of the tissue, and another law

    def _look_for_change(self) -> Look:
        """Look whether the tissue has changed under the probe; a change is an unknown more."""
        self._looked_at, self._size_at_look = self._now, self.record.size
        if self.solved is None or not self._is_placed:
            return Look(None, -math.inf)
        origin = self.setting.origin(self.solved.best.mean)
        try:
            look = change_of(
                self.record.points(),
                self.solved.modes.solutions,
                self._posterior(self.events),
                lambda unknown: self._posterior((*self.events, unknown)),
                self.setting.largest_strain(self.deepest, origin),
            )
        except UNSOLVABLE:
            return Look(None, -math.inf)
        if look.event is not None:
            self.events = (*self.events, look.event)
            self._is_placed = look.event.since is None
        return look

    def _place_again(self) -> None:
        """Place the newest change anew, once it has been seen for long enough."""
        if self._is_placed or self.solved is None:
            return
        *before, newest = self.events
        if newest.since is None or self._now - newest.since < _PLACED_AFTER:
            return
        self._is_placed = True
        points, solution = self.record.points(), self.solved.best
        state = self.solved.grown(solution, self._posterior(self.events))

        def evidence_of(change: Unknown) -> float:
            posterior = self._posterior((*before, change))
            try:
                return posterior.tracked(points, state, solution).log_evidence
            except UNSOLVABLE:
                return -math.inf

        change, _ = placed(newest, evidence_of(newest), _PLACED_WITHIN, evidence_of)
        self.events = (*before, change)
