# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The posterior of one press as it grows: one record, and the hypotheses that explain it.

The order of events, for each block: the filters of all hypotheses take it; the solutions that are
under way go on by the work of a block, and where these have ended the filters go on from there, by
the blocks since. Where the record has grown enough all hypotheses are solved anew, of the same
record, and weighed under the same errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from scipy.special import logsumexp

from fden_ros.core.estimation.block import Block, Points, Sample
from fden_ros.core.estimation.estimator import Innovation
from fden_ros.core.estimation.filter import Update
from fden_ros.core.estimation.hypothesis import LEAST_WEIGHT, Hypothesis
from fden_ros.core.estimation.intake import Intake
from fden_ros.core.estimation.mixture import NEGLIGIBLE, weights_of
from fden_ros.core.estimation.parts import Advanced, Parts
from fden_ros.core.estimation.posterior import UNSOLVABLE
from fden_ros.core.estimation.press_setting import PressSetting
from fden_ros.core.estimation.schedule import LEAST_BLOCKS, Schedule
from fden_ros.core.estimation.search import Care, Search, Solved
from fden_ros.core.estimation.solution import cost_of, evidence_under
from fden_ros.core.estimation.whiteness import NO_CHANCE

#: A solution with its log evidence; None: it was not found.
_Weighed = tuple[Solved, float] | None


class _Begun(NamedTuple):
    """Solutions that have been begun."""

    hypotheses: tuple[Hypothesis, ...]
    end: float  #: of their record [s]
    elapsed: float  #: from the touch to there [s]
    compression: float  #: largest of it [1]
    found: Advanced[list[_Weighed]]
    since: list[Block]  #: the blocks after their record


class PressPosterior:
    """One press.

    Parameters
    ----------
    intake : Intake
        Of its samples, of which none has come.

    Attributes
    ----------
    hypotheses : list of Hypothesis
        Those that are not ruled out.
    best : Hypothesis
        The likeliest.
    weighed : list of (float, Hypothesis)
        Those that have a solution, with weights that add up to 1.
    begun_at, solved_at : int
        Blocks in the records of the newest solutions that were begun, and of the newest that have
        ended.
    """

    def __init__(self, hypotheses: Sequence[Hypothesis], intake: Intake) -> None:
        self.hypotheses, self.intake = list(hypotheses), intake
        self.weigh()
        self._is_surprised = False
        self.begun_at = self.solved_at = 0
        self._start = self._last = self._worked_at = intake.now
        self._schedule = Schedule()
        self._begun: _Begun | None = None

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
    def shows_relaxation(self) -> bool:
        """Whether the motion had slowed when a solution was begun."""
        return self._schedule.has_slowed

    @property
    def is_deeper(self) -> bool:
        """Whether the probe has gone deeper than what filters may tell since the last solution."""
        return self._schedule.is_deeper(self.intake.record.max_compression)

    @property
    def is_working(self) -> bool:
        """Whether anything is under way."""
        return self._begun is not None

    @property
    def is_solving(self) -> bool:
        """Whether a solution is under way."""
        return self._begun is not None

    @property
    def is_doubtful(self) -> bool:
        """Whether a solution was not found, or does not explain the newest block."""
        if self.solved is None:
            return False
        is_asked = self._is_surprised or self.best.has_turned
        is_solved = all(one.is_solved for one in self.likely)
        is_linear = all(one.filter.is_linear for one in self.likely if one.filter is not None)
        return is_asked or not is_linear or not is_solved

    # Samples

    def take(self, sample: Sample, step: float, *, is_free: bool) -> None:
        """Take a sample, `step` seconds after the last."""
        self.intake.take(sample, step, is_free=is_free)

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
        blocks, now = self.intake.blocks(), self.intake.now
        if self.best.filter is not None and blocks:
            innovation = self._filtered(blocks, compression)
        if self._begun is not None:
            self._begun.since.extend(blocks)
        self._schedule.blocks += 1
        self._is_surprised = innovation.normalized_squared > NO_CHANCE**2
        if self._begun is None and not is_past and self._is_due(now):
            self.begin_solution()
        self.work(now - self._worked_at)
        self._worked_at = now
        return innovation

    def work(self, seconds: float) -> None:
        """Go on with what is under way, by the work of a time [s]."""
        # Points that a solution evaluates for each second of samples; it is used at the block
        # where it ends: 750 points, some 1.5 ms, a block of 10 ms. At most that of 0.4 s. Work is
        # counted and not timed, so that what comes of a recording is what came of it live.
        work = min(0.75e5 * seconds, 3e4)
        if self._begun is not None and self._begun.found.advance(work):
            self.go_on()

    def _is_due(self, now: float) -> bool:
        deepest = self.intake.record.max_compression
        return self._schedule.is_due(now - self._start, deepest, self.best)

    def _unpredicted(self, stress: float) -> Innovation:
        return Innovation(0.0, stress, 0.0, self.setting.stress_sd**2)

    def _filtered(self, blocks: list[Block], compression: float) -> Innovation:
        """Let the filters take the newest blocks; return how the likeliest predicted them."""
        best = self.best
        points = self.intake.record.points_after(blocks, self._last)
        self._last = float(points.times[-1])
        found = _stepped(self.hypotheses, points)[self.hypotheses.index(best)]
        self.weigh()
        elastic = best.elastic_response(compression)
        if found is None or elastic is None:
            self._schedule.ask()
            return self._unpredicted(float(points.stresses[0]))
        return Innovation(elastic, found.prediction, found.innovation, found.variance)

    # Solutions

    def begin_last(self) -> None:
        """Begin to solve at the end of the press, from all starts, behind what is under way."""
        self._schedule.is_over, self._begun = True, None
        self.begin_solution()

    def finish(self) -> None:
        """Do what is left of that now."""
        self.go_on()

    def begin_solution(self, care: Care = Care.TRACKED) -> None:
        """Begin to solve the posterior of the record so far, for all hypotheses."""
        intake, elapsed = self.intake, self.intake.now - self._start
        record, points = intake.record, intake.record.points()
        if points.stresses.size < LEAST_BLOCKS or not self._schedule.can_begin:
            return
        has_slowed = record.has_slowed(self.setting.geometry.exponent)
        care = self._schedule.care(care, elapsed, self.best, has_slowed=has_slowed)
        searches = [
            one.search(points, elapsed, intake.deepest, intake.compression_sd, care)
            for one in self.hypotheses
        ]
        self._begun = _Begun(
            tuple(self.hypotheses),
            float(points.times[-1]),
            elapsed,
            record.max_compression,
            Advanced(partial(_solved_together, searches)),
            [],
        )
        self.begun_at = self._schedule.blocks

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
        self._schedule.ended(begun.elapsed, begun.compression)
        solved, missed = _taken_over(begun.hypotheses, found)
        self.hypotheses = _kept(solved, missed)
        self._catch_up(solved, begun.end, begun.since)
        _keep_shares(self.weighed, missed, solved)
        self.weigh()

    def _catch_up(self, solved: Sequence[Hypothesis], end: float, since: list[Block]) -> None:
        """Go on from solutions whose record ends at a time [s], by the blocks since."""
        if not since:
            self._last = end
            return
        points = self.intake.record.points_after(since, end)
        self._last = float(points.times[-1])
        if None in _stepped([one for one in solved if one in self.hypotheses], points):
            self._schedule.ask()


def _stepped(hypotheses: Sequence[Hypothesis], points: Points) -> list[Update | None]:
    """Let hypotheses take blocks, all under the errors of the likeliest; return what they return.

    Each under its own, in a hold the softer tissue would win: the motion of its surface, which is
    stated and may be none, makes less stress.
    """
    best = max(hypotheses, key=lambda one: one.log_weight)
    first = best.step(points)
    under = first.errors if first is not None else None
    return [first if one is best else one.step(points, under) for one in hypotheses]


def _solved_together(searches: Sequence[Search]) -> Parts[list[_Weighed]]:
    """Return the solutions of all hypotheses, of one record, in parts.

    Each has its log evidence, under the same errors; None: there is none.

    Raises
    ------
    FloatingPointError
        If there is none of any.
    """
    found: list[Solved | None] = []
    for search in searches:
        try:
            found.append((yield from search.in_parts()))
        except UNSOLVABLE:
            found.append(None)
    solved = [one for one in found if one is not None]
    if not solved:
        raise FloatingPointError("no hypothesis has a solution")
    best = max(solved, key=lambda one: one.log_evidence)
    result: list[_Weighed] = []
    for search, one in zip(searches, found, strict=True):
        if one is None:
            result.append(None)
            continue
        evidence = one.log_evidence
        if one is not best:
            yield cost_of(search.points, one.posterior.grid)
            evidence += _under(search.points, one, best) - one.best.log_evidence
        result.append((one, evidence) if math.isfinite(evidence) else None)
    return result


def _under(points: Points, one: Solved, best: Solved) -> float:
    """Return the log evidence of the best maximum under the errors of another solution."""
    try:
        grid = one.posterior.grid
        return evidence_under(one.posterior, points, one.best, best.best.maximum.errors, grid)
    except UNSOLVABLE:
        return -math.inf


def _taken_over(
    hypotheses: Sequence[Hypothesis], found: Sequence[_Weighed]
) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """Let hypotheses go on from their solutions; return those that have one, and those without."""
    solved, missed = [], []
    for one, result in zip(hypotheses, found, strict=True):
        if result is None:
            one.misses += 1
            missed.append(one)
        else:
            one.take_over(*result)
            solved.append(one)
    return solved, missed


def _keep_shares(
    before: Sequence[tuple[float, Hypothesis]],
    missed: Sequence[Hypothesis],
    solved: Sequence[Hypothesis],
) -> None:
    """Let hypotheses whose solution was not found keep their weights, which are in `before`.

    All have taken the same blocks.
    """
    shares = [(weight, one) for weight, one in before if one in missed]
    rest = 1.0 - sum(weight for weight, _ in shares)
    total = float(logsumexp([one.log_weight for one in solved]))
    for weight, one in shares:
        one.shift_weight(total + math.log(weight / max(rest, 1e-300)) - one.log_weight)


def _kept(solved: Sequence[Hypothesis], missed: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the hypotheses that are not ruled out: by their evidence, or lost twice in a row."""
    most = max(one.log_weight for one in solved)
    return [
        *(one for one in solved if one.log_weight >= most - NEGLIGIBLE),
        *(one for one in missed if one.misses < 2),
    ]
