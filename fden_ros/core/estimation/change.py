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
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.modes import follow_maxima
from fden_ros.core.estimation.parts import ended
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.record import Points
from fden_ros.core.estimation.solution import Solution, evidence_under
from fden_ros.core.estimation.unknowns import Unknown, change_since, jerk_at

#: Gain in log evidence beyond which the tissue has changed [1]: by chance in one contact of a
#: thousand, at some 250 looks.
THRESHOLD = 10.6
#: Minus the log evidence where a record is beyond numbers without a change [1].
_BEYOND = 1e6
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
#: Gain in log evidence with which it is looked for on [1].
PROMISING = 5.0


class Look(NamedTuple):
    """What a look for a change has found."""

    event: Unknown | None  #: a change, or a jerk; None: none that is large and likely enough
    gain: float  #: in log evidence by one of any size [1]


class _Comparison:
    """One tissue against one with an event.

    Parameters
    ----------
    points : Points
        The record up to now.
    solutions : sequence of Solution
        The last ones, about the maxima, the likeliest first.
    without : Posterior
        Of which they are solutions.
    with_event : callable
        Returns the posterior with one more unknown, behind those that are not of the law's errors.
    strain : float
        Largest of the record [1].
    """

    def __init__(
        self,
        points: Points,
        solutions: Sequence[Solution],
        without: Posterior,
        with_event: Callable[[Unknown], Posterior],
        strain: float,
    ) -> None:
        self._points, self._last, self._strain = points, solutions[0], strain
        self._without, self._with_event = without, with_event
        self._place = len(without.model.unknowns)
        self._alone: Solution | None = None
        self._seek_alone([(s.maximum.state, s) for s in solutions])

    @property
    def would_pull(self) -> bool:
        """Whether one tissue would have to pull at the probe: it has let go of it."""
        if self._alone is None or not self._without.model.geometry.is_one_sided:
            return False
        return bool(self._alone.maximum.evaluation.stress[-1] < 0.0)

    def with_event(self, unknown: Unknown) -> Solution | None:
        """Return the solution with an event; None: there is none."""
        times, since = self._points.times, unknown.since
        if since is not None and not times[0] < since < times[-1]:
            return None
        start = np.insert(self._last.maximum.state, self._place, 0.0)
        with contextlib.suppress(*UNSOLVABLE):
            return self._with_event(unknown).tracked(self._points, start, self._last)
        return None

    def size(self, found: Solution) -> float:
        """Return the size of a solution's event."""
        return abs(float(found.mean[self._place]))

    def gain(self, found: Solution | None) -> float:
        """Return what a solution with an event gains in log evidence.

        Both are held to the errors there: softer tissue has smaller ones, stiffer tissue larger.
        """
        alone = self._alone
        if found is None:
            return -math.inf
        if alone is None:
            return found.log_evidence + _BEYOND
        errors = found.maximum.errors
        with contextlib.suppress(*UNSOLVABLE):
            return found.log_evidence - evidence_under(
                self._without, self._points, alone, errors, self._without.grid
            )
        return -math.inf

    def gain_by(self, unknown: Unknown) -> float:
        """Return what an event gains in log evidence."""
        return self.gain(self.with_event(unknown))

    def seek_back(self, found: Solution) -> None:
        """Seek one tissue from where two have led, too."""
        self._seek_alone([(np.delete(found.maximum.state, self._place), found)])

    def _seek_alone(self, states: Sequence[tuple[Array, Solution]]) -> None:
        with contextlib.suppress(*UNSOLVABLE):
            modes = ended(follow_maxima(self._without, self._points, states, self._strain))
            found = modes.best
            if self._alone is None or found.log_evidence > self._alone.log_evidence:
                self._alone = found


def change_of(
    points: Points,
    solutions: Sequence[Solution],
    without: Posterior,
    with_event: Callable[[Unknown], Posterior],
    strain: float,
) -> Look:
    """Look for a change that the record shows; the arguments are those of `_Comparison`."""
    last = solutions[0]
    if last.maximum.state.size != without.model.size or not last.is_solved:
        return Look(None, -math.inf)
    compared = _Comparison(points, solutions, without, with_event, strain)
    now = float(points.times[-1])
    between = 0.5 * (points.times[points.last[:-1]] + points.times[points.first[1:]])
    times = [*between[-_RECENT:].tolist(), *(now - ago for ago in _AGO)]
    found = [compared.with_event(change_since(time)) for time in times]
    gains = [compared.gain(one) for one in found]
    told = [
        (gain, time, one)
        for gain, time, one in zip(gains, times, found, strict=True)
        if one is not None and time <= between[-2] and compared.size(one) >= _LEAST_STEP
    ]
    if not told:
        return Look(None, max(gains))
    highest, since, likeliest = max(told, key=lambda one: one[0])
    if highest >= THRESHOLD:
        compared.seek_back(likeliest)
        highest = compared.gain(likeliest)
    if highest < THRESHOLD:
        return Look(None, max(gains))
    change, highest = placed(change_since(since), highest, now - since, compared.gain_by)
    largest = float(np.abs(points.stresses).max())
    for time in points.middles[-1 - _JERKS : -1].tolist():
        jerk = jerk_at(time, largest)
        if compared.gain_by(jerk) > highest:
            return Look(jerk, highest)
    return Look(None if compared.would_pull else change, highest)


def placed(
    change: Unknown, highest: float, width: float, evidence_of: Callable[[Unknown], float]
) -> tuple[Unknown, float]:
    """Return a change at the likeliest time within about `width` [s], and its log evidence.

    `highest`: the log evidence where it is, over any other's as `evidence_of` has it.
    """
    for closer in _CLOSER:
        assert change.since is not None
        for since in (change.since - closer * width, change.since + closer * width):
            other = change_since(since)
            found = evidence_of(other)
            if found > highest:
                change, highest = other, found
    return change, highest
