# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether the tissue changes under the probe: suspicion, looks, and where a change is placed.

An innovation that surprises asks; a look after some blocks answers. A change that was found is
placed anew once it has been seen for a while.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from fden_ros.core.estimation.block import Block
from fden_ros.core.estimation.hypothesis import Hypothesis
from fden_ros.core.estimation.intake import Intake
from fden_ros.core.estimation.maxima import Solutions
from fden_ros.core.estimation.parts import Advanced
from fden_ros.core.estimation.posterior import UNSOLVABLE
from fden_ros.core.estimation.proposals.change import (
    LOOK_PERIOD,
    PROMISING,
    SUSPECTED,
    SUSPICIOUS,
    THRESHOLD,
    ChangeLook,
    Look,
    Placing,
)
from fden_ros.core.estimation.unknowns import Unknown

#: A look has this much more work than a solution, since it has to tell within 0.1 s [1].
_HASTE = 20.0


class Found(NamedTuple):
    """What a look has found."""

    hypothesis: Hypothesis  #: for which it was looked
    look: Look
    end: float  #: of its record [s]
    since: list[Block]  #: the blocks after its record


class Placed(NamedTuple):
    """A change that was placed anew."""

    before: Unknown
    after: Unknown


class _Looking(NamedTuple):
    """A look that has been begun."""

    hypothesis: Hypothesis
    found: Advanced[Look]
    end: float
    since: list[Block]


class _Placing(NamedTuple):
    """A change that is being placed."""

    change: Unknown
    found: Advanced[Unknown]


class ChangeWatch:
    """Watches one press for changes."""

    def __init__(self) -> None:
        self._suspected_at: float | None = None
        self._looked_at = -math.inf
        self._look: _Looking | None = None
        self._placing: _Placing | None = None
        self._to_place: Unknown | None = None

    @property
    def is_asked(self) -> bool:
        """Whether it is asked if the tissue has changed."""
        return self._suspected_at is not None

    @property
    def is_working(self) -> bool:
        """Whether a look or a placing is under way."""
        return self._look is not None or self._placing is not None

    def add(self, blocks: list[Block], now: float, normalized_squared: float) -> None:
        """Take blocks, whose last has an innovation of so many standard deviations squared."""
        if self._look is not None:
            self._look.since.extend(blocks)
        if normalized_squared > SUSPICIOUS**2 and self._suspected_at is None:
            self._suspected_at = now

    def is_look_due(self, now: float) -> bool:
        """Whether the next look is due: a solution would absorb a change before it shows."""
        since = self._suspected_at
        if since is None or self.is_working:
            return False
        return now - since >= SUSPECTED or now - self._looked_at >= LOOK_PERIOD

    def give_up(self) -> None:
        """Ask no more."""
        self._suspected_at = None

    def begin_look(self, best: Hypothesis, intake: Intake) -> bool:
        """Begin to look whether the tissue has changed; return whether that can be done."""
        if best.solved is None or self._to_place is not None:
            return False
        self._looked_at = intake.now
        origin = best.setting.origin(best.solved.best.mean)
        points = best.points(intake.record.points())
        deepest = best.deepest(intake.deepest)
        made = partial(best.setting.posterior_with, best.events, intake.compression_sd, deepest)
        strain = best.setting.largest_strain(deepest, origin)
        look = ChangeLook(points, best.solved.solutions.maxima, made(), made, strain)
        self._look = _Looking(best, Advanced(look.in_parts), float(points.times[-1]), [])
        return True

    def is_placing_due(self, now: float) -> bool:
        """Whether the newest change has been seen for long enough to be placed anew."""
        change = self._to_place
        if change is None:
            return False
        assert change.since is not None
        # It has been seen for this time [s].
        return now - change.since >= 0.1

    def begin_placing(self, best: Hypothesis, intake: Intake) -> None:
        """Begin to place the newest change anew, where the likeliest hypothesis has it."""
        change, self._to_place = self._to_place, None
        if change is None or change not in best.events or best.solved is None:
            return
        rest = tuple(event for event in best.events if event is not change)
        sizes = intake.compression_sd, best.deepest(intake.deepest)
        made = best.setting.posterior_with(best.events, *sizes)
        placing = Placing(
            best.points(intake.record.points()),
            best.solved.grown(best.solved.best, made),
            best.solved.best,
            partial(best.setting.posterior_with, rest, *sizes),
            change,
        )
        self._placing = _Placing(change, Advanced(placing.in_parts))

    def advance(self, work: float, *, is_over: bool) -> Found | Placed | None:
        """Go on by some work; return what has been found, if anything has."""
        if self._look is not None and self._look.found.advance(_HASTE * work):
            return self._end_look(is_over=is_over)
        if self._placing is not None and self._placing.found.advance(work):
            return self._end_placing()
        return None

    def finish(self) -> Found | Placed | None:
        """Do what is left at the end of a press."""
        if self._look is not None:
            return self._end_look(is_over=True)
        return self._end_placing() if self._placing is not None else None

    def _end_look(self, *, is_over: bool) -> Found | None:
        """Return what a look has found; None: it is looked again."""
        assert self._look is not None and self._suspected_at is not None
        looking, self._look = self._look, None
        try:
            look = looking.found.result()
        except UNSOLVABLE:
            look = Look(None, -math.inf)
        elapsed = self._looked_at - self._suspected_at
        is_open = elapsed < LOOK_PERIOD or (elapsed < SUSPECTED and look.gain > PROMISING)
        if look.event is None and is_open and not is_over:
            return None
        self._suspected_at = None
        if look.event is not None:
            self._to_place = look.event if look.event.since is not None else None
        return Found(looking.hypothesis, look, looking.end, looking.since)

    def _end_placing(self) -> Placed:
        assert self._placing is not None
        placing, self._placing = self._placing, None
        return Placed(placing.change, placing.found.result())


def with_event(hypotheses: Sequence[Hypothesis], found: Found) -> list[Hypothesis]:
    """Return hypotheses with an event, that for which it was looked first, and those without.

    What one explains by a change another may explain without it; the weights tell.
    """
    look, without = found.look, found.hypothesis
    assert look.event is not None and without.solved is not None
    others = [one for one in hypotheses if one is not without]
    changed = without.with_event(look.event)
    if look.posterior is not None and look.solution is not None:
        solutions = Solutions((look.solution,), (look.solution.log_evidence,))
        solved = replace(
            without.solved, posterior=look.posterior, solutions=solutions, plateau_odds=None
        )
        changed.take_over(solved, 0.0)
        odds = look.gain - THRESHOLD * (changed.change_count - without.change_count)
        changed.shift_weight(without.log_weight + odds - changed.log_weight)
    beside = [one.with_event(look.event) for one in others]
    return [changed, *others, without, *beside]
