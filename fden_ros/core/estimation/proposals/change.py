# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One tissue against two: whether the stiffness has changed under the probe.

The evidence of the record with a change of the stiffness against that without, both averaged anew
over the scales of the law's errors, so that a smooth misfit widens these and a jump cannot be
bought by them. Both are solved from the last solution, which was made before the change. What one
block explains as well, with a stress of its own, is a jerk of the drive and no change.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.density import EVALUATION_COST
from fden_ros.core.estimation.maxima import follow_maxima
from fden_ros.core.estimation.parts import Limit, Parts
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.solution import Solution, cost_of, evidence_under
from fden_ros.core.estimation.unknowns import Unknown, change_since, jerk_at

#: Gain in log evidence beyond which the tissue has changed [1]: by chance in one contact of a
#: thousand, at some 250 looks.
THRESHOLD = 10.6
#: Least relative change of the stiffness that is said [1].
_LEAST_STEP = 0.08
#: A change is looked for between so many of the last blocks [1]: where a block is known to a
#: hundredth of a jump, no other time explains it. What only the newest shows may be a jerk.
_RECENT = 4
#: It may also have been this time ago [s].
_AGO = (0.06, 0.12, 0.24)
#: A jerk is one of so many blocks before the last [1].
_JERKS = 3
#: Distances from the best of these, over the time since, at which it is looked for more closely
#: [1].
_CLOSER = (0.4, 0.2, 0.1, 0.05, 0.025)
#: An innovation beyond this many standard deviations asks for a look [1].
SUSPICIOUS = 3.5
#: Least time between two looks [s], and for how long one is looked for after that innovation [s].
LOOK_PERIOD, SUSPECTED = 0.025, 0.1
#: A change is placed anew within this time [s].
PLACED_WITHIN = 0.04
#: Evaluations by which one tissue is sought [1], and how much more a change has to gain where it
#: was not found in these [1]: without it one beef record was flagged TISSUE_CHANGED.
_MOST_ALONE, _UNSURE = 25, 3.0
#: Gain in log evidence with which it is looked for on [1].
PROMISING = 5.0


class Look(NamedTuple):
    """What a look for a change has found."""

    event: Unknown | None  #: a change, or a jerk; None: none that is large and likely enough
    gain: float  #: in log evidence by one of any size [1]
    #: With the event, the posterior and its solution; None: there is none.
    posterior: Posterior | None = None
    solution: Solution | None = None


@dataclass(frozen=True)
class ChangeLook:
    """One tissue against one with an event.

    Parameters
    ----------
    points : Points
        The record up to now.
    solutions : sequence of Solution
        The last ones, about the maxima, the likeliest first.
    without : Posterior
        Of which they are solutions.
    posterior_with : callable
        Returns the posterior with more unknowns, behind those that are not of the law's errors.
    strain : float
        Largest of the record [1].
    """

    points: Points
    solutions: Sequence[Solution]
    without: Posterior
    posterior_with: Callable[..., Posterior]
    strain: float

    @property
    def _place(self) -> int:
        """Place of the event in a state."""
        return len(self.without.model.unknowns)

    def in_parts(self) -> Parts[Look]:
        """Look for a change that the record shows.

        Where the linearised gain promises one, its likeliest time is solved, and the likeliest
        jerk beside it.
        """
        points, last = self.points, self.solutions[0]
        if last.maximum.state.size != self.without.model.size or not last.is_solved:
            return Look(None, -math.inf)
        now = float(points.times[-1])
        between = 0.5 * (points.times[points.last[:-1]] + points.times[points.first[1:]])
        times = self._within([*between[-_RECENT:].tolist(), *(now - ago for ago in _AGO)])
        largest = float(np.abs(points.stresses).max())
        jerks = [jerk_at(time, largest) for time in points.middles[-1 - _JERKS : -1].tolist()]
        gains = yield from self._linear_gains([change_since(time) for time in times])
        highest, since = max(zip(gains, times, strict=True))
        # What the newest block alone shows may be a jerk.
        shown = max(g for g, time in zip(gains, times, strict=True) if time <= between[-2])
        if shown < PROMISING:
            return Look(None, highest)
        width = now - since
        near = [since + side * closer * width for closer in _CLOSER for side in (-1.0, 1.0)]
        times += self._within(near)
        events = [*(change_since(time) for time in times), *jerks]
        gains = yield from self._linear_gains(events)
        timed = zip(gains, times, strict=False)
        event = change_since(max(pair for pair in timed if pair[1] <= between[-2])[1])
        found = yield from self._with(event)
        if found is None or abs(float(found.mean[self._place])) < _LEAST_STEP:
            return Look(None, highest)
        alone = yield from self._alone(last)
        gain = yield from self._gain(found, alone)
        if gain < (THRESHOLD if alone is not None and alone.is_solved else _UNSURE * THRESHOLD):
            return Look(None, max(gain, highest))
        _, jerk = max(zip(gains[len(times) :], jerks, strict=True), key=lambda pair: pair[0])
        jerked = yield from self._with(jerk)
        if (yield from self._gain(jerked, alone)) > gain:
            return Look(jerk, gain, self.posterior_with(jerk), jerked)
        return Look(event, gain, self.posterior_with(event), found)

    def _within(self, times: Sequence[float]) -> list[float]:
        """Return times within the record."""
        first, last = self.points.times[[0, -1]].tolist()
        return [time for time in times if first < time < last]

    def _linear_gains(self, events: Sequence[Unknown]) -> Parts[list[float]]:
        """Return what each of some events gains, from one linearisation at the last solution.

        With A the normal equations of one tissue, a the event's own column of them, of variance
        1, and s and v what is left of its gradient and its diagonal: (s^2/v - ln v)/2.
        """
        points, maximum = self.points, self.solutions[0].maximum
        yield points.times.size
        posterior, place, count = self.posterior_with(*events), self._place, len(events)
        state = np.insert(maximum.state, [place] * count, 0.0)
        try:
            found = posterior.evaluate(points, state)
        except UNSOLVABLE:
            return [math.inf] * count
        errors = posterior.error_model.errors(points, state, found)
        about = posterior.linear(points, found, errors, *maximum.scales[2:])
        precision = posterior.precision(state, maximum.scales)
        normal = about.normal + precision
        towards = about.towards + precision @ (posterior.belief.mean - state)
        own = np.arange(place, place + count)
        rest = np.setdiff1d(np.arange(state.size), own)
        beside = normal[np.ix_(rest, own)]
        solved = np.linalg.solve(
            normal[np.ix_(rest, rest)], np.column_stack([towards[rest], beside])
        )
        left = towards[own] - beside.T @ solved[:, 0]
        variance = normal[own, own] - np.einsum("ij,ij->j", beside, solved[:, 1:])
        variance = np.maximum(variance, 1.0)
        gains: list[float] = (0.5 * (left**2 / variance - np.log(variance))).tolist()
        return gains

    def _with(self, unknown: Unknown) -> Parts[Solution | None]:
        """Return the solution with an event; None: there is none."""
        times, since = self.points.times, unknown.since
        if since is not None and not times[0] < since < times[-1]:
            return None
        last = self.solutions[0]
        start = np.insert(last.maximum.state, self._place, 0.0)
        with contextlib.suppress(*UNSOLVABLE):
            posterior = self.posterior_with(unknown)
            return (yield from posterior.tracked_in_parts(self.points, start, last))
        return None

    def _gain(self, found: Solution | None, alone: Solution | None) -> Parts[float]:
        """Return what a solution with an event gains in log evidence.

        Both are held to the errors there: softer tissue has smaller ones, stiffer tissue larger.
        """
        if found is None or alone is None:
            return -math.inf
        without, errors = self.without, found.maximum.errors
        yield cost_of(self.points, without.grid)
        with contextlib.suppress(*UNSOLVABLE):
            by_one = evidence_under(without, self.points, alone, errors, without.grid)
            return found.log_evidence - by_one
        return -math.inf

    def _alone(self, last: Solution) -> Parts[Solution | None]:
        """Return the best solution of one tissue that the last leads to; None: there is none.

        Where there are two, one may be long sought in vain.
        """
        most = _MOST_ALONE * (EVALUATION_COST + self.points.times.size)
        limit = self.without.limit = Limit(most)
        with contextlib.suppress(*UNSOLVABLE):
            states = [(last.maximum.state, last)]
            found = yield from limit.counted(
                follow_maxima(self.without, self.points, states, self.strain)
            )
            return found.best
        return None


@dataclass(frozen=True)
class Placing:
    """A change that is placed anew, once more has been seen of it."""

    points: Points
    state: Array  #: from which it is solved
    solution: Solution  #: the last one
    posterior_with: Callable[[Unknown], Posterior]  #: of the change
    change: Unknown

    def in_parts(self) -> Parts[Unknown]:
        """Return the change at the likeliest time within PLACED_WITHIN of where it was."""
        change, highest = self.change, (yield from self._evidence(self.change))
        for closer in _CLOSER:
            assert change.since is not None
            width = closer * PLACED_WITHIN
            for since in (change.since - width, change.since + width):
                other = change_since(since)
                found = yield from self._evidence(other)
                if found > highest:
                    change, highest = other, found
        return change

    def _evidence(self, change: Unknown) -> Parts[float]:
        posterior = self.posterior_with(change)
        with contextlib.suppress(*UNSOLVABLE):
            found = posterior.tracked_in_parts(self.points, self.state, self.solution)
            return (yield from found).log_evidence
        return -math.inf
