# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The free surface of the tissue: what earlier presses and changes under the probe have left.

A change of the stiffness lowers it by what it adds to the elastic response.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.smooth_errors import KERNEL_HATS, splines
from fden_ros.core.estimation.unknowns import LOG_G, LOG_GN, ORDER, PressMotion, Unknown, order_of
from fden_ros.core.law import (
    RATES,
    Geometry,
    StressMoments,
    creep_slopes,
    creep_weights,
    elastic_responses,
)


@dataclass(frozen=True)
class FreeSurface:
    """What earlier presses have left of the tissue: the creep of their stress."""

    moments: StressMoments  #: at `time`
    time: float  #: [s], of the clock of the records

    def at(self, times: Array) -> Array:
        """Return the exponential moments at times, shape (n, RATES)."""
        return self.moments.after(np.maximum(times - self.time, 0.0))


class TissueSurface:
    """The free surface of one press, with all derivatives.

    Parameters
    ----------
    unknowns : tuple of Unknown
        The first of a state.
    motion : PressMotion
        Of these.
    geometry : Geometry
    kernel, characteristic : slice
        Places of the law's errors in a state, which ends with the latter.
    last_knot : float
        Strain of the characteristic's last knot [1].
    free : FreeSurface or None
        None: the tissue is at rest before the press.

    Attributes
    ----------
    by_softening : ndarray, shape (size,)
        By what unknowns change ln G since the last press, which has left less or more by that.
    """

    def __init__(
        self,
        unknowns: tuple[Unknown, ...],
        motion: PressMotion,
        geometry: Geometry,
        kernel: slice,
        characteristic: slice,
        last_knot: float,
        free: FreeSurface | None,
    ) -> None:
        self._unknowns, self._motion, self._geometry = unknowns, motion, geometry
        self._kernel, self._characteristic, self._last_knot = kernel, characteristic, last_knot
        self._size, self._free = characteristic.stop, free
        self.by_softening = np.zeros(self._size)
        self.by_softening[: len(unknowns)] = [
            u.of_law[LOG_G] if u.of_law else 0.0 for u in unknowns
        ]
        self._moments: tuple[Points, Array] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return it without what the last record has decided: that is found anew."""
        return self.__dict__ | {"_moments": None}

    def softening(self, state: Array) -> float:
        """Return the factor of the stiffness since the last press [1]."""
        return math.exp(float(self.by_softening @ state))

    def changes(self, state: Array) -> tuple[Array, Array]:
        """Return the sizes of the changes [1] and their times [s]."""
        found = [
            (value, u.since)
            for value, u in zip(state, self._unknowns, strict=False)
            if u.since is not None
        ]
        sizes, times = np.array(found, dtype=float).reshape(-1, 2).T
        return np.ascontiguousarray(sizes), np.ascontiguousarray(times)

    def touch_gradient(self, points: Points, state: Array) -> Array:
        """Return how each unknown moves the touch, as a unit vector (n,)."""
        points = self._motion.moved(points, state)
        if self._free is None:
            result, motions = np.zeros(self._size), self._motion.design(points).motions
            first = int(np.argmax(self._motion.compressions(points, state) > 0.0))
            result[: len(self._unknowns)] = motions[:, first]
        else:
            # Tissue that has not recovered is met where the elastic response passes its surface.
            elastic, by_unknowns = self._elastic(points, state)
            surface, lifted = self._creep(self._free, points, state)
            first = int(np.argmax(elastic > surface))
            result = by_unknowns[:, first] - lifted[:, first]
        size = float(np.linalg.norm(result))
        return result / size if size else result

    def at(self, points: Points, state: Array) -> tuple[Array | None, Array | None]:
        """Return it at the points of a moved record, and its derivatives, (size, points).

        None: it is at 0.
        """
        surface, lifted = None, None
        if self._free is not None:
            surface, lifted = self._creep(self._free, points, state)
        ratio = self._change(points, state)
        if ratio is None:
            return surface, lifted
        elastic, by_unknowns = self._elastic(points, state)
        added = ratio * elastic
        surface = -added if surface is None else surface - added
        lifted = -ratio * by_unknowns if lifted is None else lifted - ratio * by_unknowns
        for k, unknown in enumerate(self._unknowns):
            if unknown.since is not None:
                lifted[k] -= elastic * (points.times > unknown.since)
        return surface, lifted

    def _creep(self, free: FreeSurface, points: Points, state: Array) -> tuple[Array, Array]:
        """Return the creep of earlier presses at the points, and its derivatives, (size, points).

        To first order the creep is less by what the relaxation is more.
        """
        if self._moments is None or self._moments[0] is not points:
            self._moments = points, free.at(points.times)
        moments, order = self._moments[1], order_of(state)
        own = KERNEL_HATS[: RATES.size, : self._kernel.stop - self._kernel.start]
        bend = np.exp(-(own @ state[self._kernel]))
        factor = self.softening(state)
        weights = factor * creep_weights(order) * bend
        lifted = np.zeros((self._size, points.times.size))
        lifted[ORDER] = factor * moments @ (creep_slopes(order) * bend)
        lifted[self._kernel] = -(own * weights[:, None]).T @ moments.T
        surface = moments @ weights
        lifted += np.outer(self.by_softening, surface)
        return surface, lifted

    def _change(self, points: Points, state: Array) -> Array | None:
        """Return the part of the elastic response that changes add; None: there are none."""
        if all(unknown.since is None for unknown in self._unknowns):
            return None
        ratio = np.zeros(points.times.size)
        for value, unknown in zip(state, self._unknowns, strict=False):
            if unknown.since is not None:
                ratio += value * (points.times > unknown.since)
        return ratio

    def _elastic(self, points: Points, state: Array) -> tuple[Array, Array]:
        """Return the elastic response at the points, and its derivatives, (size, points)."""
        compressions = self._motion.compressions(points, state)
        if self._geometry.is_one_sided:
            compressions = np.maximum(compressions, 0.0)
        sizes = np.abs(compressions)
        strains, slopes, _ = self._geometry.strains(sizes)
        found = elastic_responses(strains, math.exp(state[LOG_G]), math.exp(state[LOG_GN]))
        knots = self._characteristic.stop - self._characteristic.start
        of_knots, _ = splines(strains, self._last_knot, knots)
        bend = np.exp(of_knots @ state[self._characteristic])
        elastic = found.value * bend
        slope = found.by_strain * slopes * (strains > 0.0) * bend
        by_unknowns = np.zeros((self._size, sizes.size))
        by_unknowns[: len(self._unknowns)] = slope * self._motion.design(points).motions
        by_unknowns[LOG_G] += elastic
        by_unknowns[LOG_GN] += found.by_log_nonlinear_stiffness * bend
        by_unknowns[self._characteristic] = elastic * of_knots.T
        return elastic, by_unknowns
