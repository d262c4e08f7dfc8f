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

from fden_ros.core.estimation.error_model import Errors
from fden_ros.core.estimation.modes import follow_modes
from fden_ros.core.estimation.posterior import UNSOLVABLE, Posterior
from fden_ros.core.estimation.record import Points
from fden_ros.core.estimation.scales import Scales
from fden_ros.core.estimation.solution import Solution
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


def change_of(
    points: Points,
    solutions: Sequence[Solution],
    without: Posterior,
    with_event: Callable[[Unknown], Posterior],
    strain: float,
) -> Look:
    """Look for a change that the record shows.

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
    solution = solutions[0]
    state = solution.maximum.state
    if state.size != without.model.size or not solution.is_solved:
        return Look(None, -math.inf)
    count, now = len(without.model.unknowns), float(points.times[-1])
    start = np.insert(state, count, 0.0)
    best, alone = None, -_BEYOND
    with contextlib.suppress(*UNSOLVABLE):
        tracked = [(s.maximum.state, s) for s in solutions]
        best = follow_modes(without, points, tracked, strain).best
        alone = best.log_evidence

    def look(unknown: Unknown) -> tuple[float, float]:
        """Return the log evidence with an event, and its size.

        That its tissue is softer, and so has smaller errors, does not count for an event.
        """
        if unknown.since is not None and not points.times[0] < unknown.since < now:
            return -math.inf, 0.0
        posterior = with_event(unknown)
        try:
            found = posterior.tracked(points, start, solution)
        except UNSOLVABLE:
            return -math.inf, 0.0
        evidence = found.log_evidence
        if best is not None:
            errors = [s.maximum.errors for s in (best, found)]
            alone_det, its_det = (_log_det(without, e, best.best_scales) for e in errors)
            evidence -= 0.5 * max(alone_det - its_det, 0.0)
        return evidence, abs(float(found.mean[count]))

    between = 0.5 * (points.times[points.last[:-1]] + points.times[points.first[1:]])
    times = [*between[-_RECENT:].tolist(), *(now - ago for ago in _AGO)]
    looked = [change_since(time) for time in times]
    evidence, sizes = np.array([look(unknown) for unknown in looked]).T
    gain = float(evidence.max()) - alone
    evidence[sizes < _LEAST_STEP] = -math.inf
    evidence[np.array(times) > between[-2]] = -math.inf
    likeliest = looked[int(np.argmax(evidence))]
    if evidence.max() - alone < THRESHOLD or likeliest.since is None:
        return Look(None, gain)
    width, highest = now - likeliest.since, float(evidence.max())
    change, highest = placed(likeliest, highest, width, lambda unknown: look(unknown)[0])
    largest = float(np.abs(points.stresses).max())
    for time in points.middles[-1 - _JERKS : -1].tolist():
        jerk = jerk_at(time, largest)
        if look(jerk)[0] > highest:
            return Look(jerk, gain)
    return Look(change, gain)


def placed(
    change: Unknown, highest: float, width: float, evidence_of: Callable[[Unknown], float]
) -> tuple[Unknown, float]:
    """Return a change at the likeliest time within about `width` [s], and its log evidence.

    `highest`: the log evidence where it is.
    """
    for closer in _CLOSER:
        assert change.since is not None
        for since in (change.since - closer * width, change.since + closer * width):
            other = change_since(since)
            found = evidence_of(other)
            if found > highest:
                change, highest = other, found
    return change, highest


def _log_det(posterior: Posterior, errors: Errors, scales: Scales) -> float:
    """Return log det of the covariance of errors at some scales."""
    none = np.empty((errors.noise.size, 0))
    return posterior.error_model.whitened(none, errors, scales.roughness, scales.motion)[1]
