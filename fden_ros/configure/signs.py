# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Signs of force and displacement: the readings of a recording compared.

Force and displacement may each grow or fall as the probe presses: four readings, of which usually
two agree with the force's change. Under the right one the force is that of a contact:

.. math:: F(t) = b + d\,t + \sum_{k,m} w_{km} \int_0^t e^{-(t-s)/\tau_m} \, d(x(s)-x_k)_+
          + \sum_m h_m e^{-t/\tau_m}, \qquad w_{km} \ge 0

It is constant in the air except for a drift d, grows convexly with the depth x, never pulls, and
relaxes towards the force in the air; h is the tissue's memory of earlier presses. Nonnegative
least squares fit each reading, and the ratio of the likelihoods shows how far the next best is
excluded. Each weight also fits the noise: twice its variance per weight is added to the residual
(Mallows), otherwise a few chunks fit any sign. Several presses are fitted separately, cut between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.signal import find_peaks, lfilter

from fden_ros.core.arrays import Array

Mask = NDArray[np.bool_]

#: A reading is claimed where it is this many times as likely as any other.
LEAST_RATIO = 1e4
#: Times of relaxation [s]: a sum of two fits a press and a hold of a power law.
_TIMES = (0.5, 6.0)
#: Delays of the displacement that are tried [s].
_DELAYS = (-0.02, 0.0, 0.02, 0.04, 0.06)
#: Knots of the depth, evenly and by the changes of the force.
_KNOTS = 6
#: A stroke that cuts is at least this part of the range in which the force changes.
_STROKE = 0.4
#: Parts are fitted separately up to this number, and from this number of chunks on.
_MOST_PARTS, _LEAST_CHUNKS = 40, 10

#: Signs of force and motion.
_READINGS = ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0))


class Course(NamedTuple):
    """Force and motion of one recording along their lines, in chunks (n,)."""

    times: Array  #: [s]
    motion: Array
    push: Array
    seen: Mask  #: chunks that count
    noise: float  #: standard deviation of the push


class _Fit(NamedTuple):
    """The residual of a reading, and its expectation for another such recording."""

    residual: Array
    misfit: float


class Signs(NamedTuple):
    """The likeliest reading, and by how much."""

    force: float  #: 1 where it grows into the tissue, -1 where it falls
    motion: float
    log_ratio: float  #: logarithm of its likelihood over that of the next best reading
    probability: float  #: all four equally likely before the data

    @property
    def is_stated(self) -> bool:
        """Whether the other readings are excluded."""
        return self.log_ratio > math.log(LEAST_RATIO)


def find_signs(courses: Sequence[Course]) -> Signs:
    """Compare the readings of recordings of one rig."""
    total = sum((_compared(course) for course in courses), np.zeros(len(_READINGS)))
    next_best, best = np.argsort(total)[-2:]
    probability = 1.0 / float(np.exp(total - total[best]).sum())
    return Signs(*_READINGS[best], float(total[best] - total[next_best]), probability)


def _compared(course: Course) -> Array:
    """Return ln of the likelihoods (4,), with the cuts of the best reading.

    They are those of Gaussians with unknown variance.
    """
    tried = (
        course._replace(motion=np.interp(course.times + delay, course.times, course.motion))
        for delay in _DELAYS
    )
    whole = (0, course.times.size)
    course = min(tried, key=lambda one: min(_fitted(one, *whole, r).misfit for r in _READINGS))
    least, found = math.inf, np.zeros(len(_READINGS))
    for cuts in _partitions(course):
        parts = [[_fitted(course, a, b, reading) for reading in _READINGS] for a, b in cuts]
        misfits = np.maximum([[one.misfit for one in part] for part in parts], 1e-300)
        if misfits.sum(axis=0).min() < least:
            least = misfits.sum(axis=0).min()
            best = misfits.argmin(axis=1)
            counts = [independent(part[k].residual) for part, k in zip(parts, best, strict=True)]
            found = -0.5 * (np.array(counts) @ np.log(misfits))
    return found


def _partitions(course: Course) -> list[list[tuple[int, int]]]:
    """Return the whole, and the parts from one turning point of the motion to the next but one."""
    motion = course.motion
    found = [[(0, motion.size)]]
    changes = np.abs(np.diff(course.push))
    active = changes > 3.0 * float(np.median(changes))
    middles = 0.5 * (motion[1:] + motion[:-1])
    if not active.any():
        return found
    stroke = float(np.ptp(np.quantile(middles[active], [0.05, 0.95])))
    least = max(_STROKE * stroke, 1e-300)
    farthest, nearest = (find_peaks(sign * motion, prominence=least)[0] for sign in (1.0, -1.0))
    for turns, opposite in ((farthest, nearest), (nearest, farthest)):
        turns = turns[:: max(math.ceil(turns.size / _MOST_PARTS), 1)]
        ends = [0]
        for turn in turns:
            if min(turn - ends[-1], motion.size - turn) >= _LEAST_CHUNKS:
                ends.append(int(turn))
        # Half a press fits any sign, with a memory of its own: no cut may separate two halves.
        if len(ends) > 1 and opposite.size:
            found.append(list(zip(ends, [*ends[1:], motion.size], strict=True)))
    return found


def _fitted(course: Course, first: int, last: int, reading: tuple[float, float]) -> _Fit:
    """Fit a reading to a part."""
    span = slice(first, last)
    seen = course.seen[span]
    if seen.sum() < _LEAST_CHUNKS:
        return _Fit(np.empty(0), 0.0)
    push, depth = reading[0] * course.push[span], reading[1] * course.motion[span]
    knots = _knots(depth, push)
    residual, count = contact_fit(course.times[span], push, depth, knots, _TIMES, seen)
    return _Fit(residual, float(residual @ residual) + 2.0 * count * course.noise**2)


def contact_fit(
    times: Array,
    push: Array,
    depth: Array,
    knots: Array,
    relaxation: Sequence[float],
    seen: Mask | None = None,
) -> tuple[Array, int]:
    """Fit the force of a contact to even samples (n,); return the residual and free weights.

    Springs, and Maxwell elements of times `relaxation` [s], begin at `knots` of the depth (k,).
    """
    chosen: Mask = np.ones(times.size, bool) if seen is None else seen
    since = times - times[0]
    free = [np.ones_like(since), since, *(np.exp(-since / time) for time in relaxation)]
    axes = np.linalg.qr(np.stack(free, axis=1)[chosen])[0]
    columns = np.column_stack([_contact(since, depth, knots, relaxation), push])[chosen]
    columns -= axes @ (axes.T @ columns)
    sizes = np.maximum(np.linalg.norm(columns[:, :-1], axis=0), 1e-12)
    small = np.asarray(np.linalg.qr(columns / [*sizes, 1.0], mode="r"))
    weights = nnls(small[:, :-1], small[:, -1], maxiter=100 * sizes.size)[0]
    residual = np.asarray(columns[:, -1] - columns[:, :-1] @ (weights / sizes))
    return residual, len(free) + int(np.count_nonzero(weights))


def independent(residual: Array) -> float:
    """Return the number of independent samples: neighbours are correlated."""
    size = max(float(residual @ residual), 1e-300)
    together = float(residual[1:] @ residual[:-1]) / size if residual.size > 1 else 0.0
    together = min(max(together, 0.0), 0.99)
    return residual.size * (1.0 - together) / (1.0 + together)


def _contact(since: Array, depth: Array, knots: Array, relaxation: Sequence[float]) -> Array:
    """Return the forces of unit springs and Maxwell elements that begin at knots of the depth."""
    step = float(np.median(np.diff(since)))
    columns = []
    for knot in knots:
        pressed = np.maximum(depth - knot, 0.0)
        columns.append(pressed)
        for time in relaxation:
            kept = math.exp(-step / time)
            force = lfilter([1.0], [1.0, -kept], np.diff(pressed, prepend=pressed[0]))
            # The probe leaves: nothing pulls it.
            columns.append(np.where(pressed > 0.0, force, 0.0) if pressed[0] == 0.0 else force)
    return np.stack(columns, axis=1)


def _knots(depth: Array, push: Array) -> Array:
    even = np.linspace(depth.min(), depth.max(), _KNOTS, endpoint=False)
    middles = 0.5 * (depth[1:] + depth[:-1])
    order = np.argsort(middles)
    changes = np.cumsum(np.abs(np.diff(push))[order])
    if not changes[-1] > 0.0:
        return even
    parts = np.linspace(0.0, changes[-1], _KNOTS + 2)[1:-1]
    return np.unique(np.concatenate([even, np.interp(parts, changes, middles[order])]))
