# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""What discs may be stiffer than their surroundings: draws of them that follow the presses.

Each draw has slots, each empty or with a disc that may be stretched to an ellipse,

.. math:: \ln k(p) = b(p) + \sum_s a_s D_s(p)

with a Gaussian process b. Given the others, the height of a disc is Gaussian and its evidence
exact, so that two moves of a slot are Metropolis steps without it: to a disc of a dictionary or
to none; and a shift, growth and stretch. Discs keep apart: two that touch are one. A new press
chooses among the draws (a particle filter), so that none stays in a mode of its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from fden_ros.core.arrays import Array, Indices, Mask

#: Least and largest radius [m], and the width of the edges that a press sees [m].
LEAST_RADIUS, _MOST_RADIUS, _EDGE = 3e-3, 13e-3, 1e-3
#: Standard deviation of the two logarithms of a stretch [1]: axes differ by a fifth.
_STRETCH_SD = 0.1
#: Height of a disc, its mean and standard deviation [1], and slots of discs, each empty before.
_HEIGHT, _HEIGHT_SD = 0.7, 0.35
_SLOTS, _EMPTY = 4, 0.5
#: Draws, rounds of moves after a press, each of one jump and shifts, and those where no more than
#: a few of the draws [1] have led to the press: others that are alike would stay so.
DRAWS, _ROUNDS, _MANY_ROUNDS, _FEW, _SHIFTS = 160, 2, 6, 0.5, 10
#: Presses of a first call that are followed at once [1].
_AT_ONCE = 8
#: Dictionary: places along the longer side, and radii [1].
_PLACES, _RADII = 16, 5
#: Largest shifts: of places [m], of the logarithm of the radius and of stretches [1]; a share of
#: them between the two is drawn [1].
_LARGEST = np.array([1.5e-3, 1.5e-3, 0.15, 0.1, 0.1])
_SHARES = (0.15, 1.5)


class _Height(NamedTuple):
    """What is known of discs' heights, given all else."""

    mean: Array
    precision: Array
    evidence: Array  #: logarithm, against no disc


class Inclusions:
    """Draws of what is stiffer.

    Parameters
    ----------
    low, high : ndarray, shape (2,)
        Corners of the region [m].
    """

    def __init__(self, low: Array, high: Array) -> None:
        self._rng = np.random.default_rng(0)
        sides = high - low
        counts = np.maximum(np.round(sides / sides.max() * _PLACES), 1.0)
        self._counts = (*counts.astype(int).tolist(), _RADII)
        self._low = np.array([*low, math.log(LEAST_RADIUS)])
        self._high = np.array([*high, math.log(_MOST_RADIUS)])
        self._step = (self._high - self._low) / self._counts
        index = np.indices(self._counts).reshape(3, -1).T
        self._dictionary = np.pad(self._low + (index + 0.5) * self._step, ((0, 0), (0, 2)))
        #: x, y, ln radius and stretches of discs, (draws, slots, 5).
        self.discs: Array = np.zeros((DRAWS, _SLOTS, 5))
        #: Their heights, (draws, slots); 0: an empty slot.
        self.heights: Array = np.zeros((DRAWS, _SLOTS))
        self._fit: Array | None = None

    def follow(self, places: Array, root: Array, target: Array) -> None:
        """Make the draws those of presses.

        Parameters
        ----------
        places : ndarray, shape (n, 2)
        root : ndarray, shape (n, n)
            Lower triangular; whitens what is known of b and the noise at these places.
        target : ndarray, shape (n,)
            ln k less its mean, whitened.
        """
        if self._fit is None:
            # One after the other, so that all at once do not leave the draws where they first fit.
            for count in range(_AT_ONCE, len(places), _AT_ONCE):
                self._follow(places[:count], root[:count, :count], target[:count])
        self._follow(places, root, target)

    def _follow(self, places: Array, root: Array, target: Array) -> None:
        self._places, self._root = places, root
        self._white = _seen(self.discs.reshape(-1, 5), places) @ root.T
        self._white = self._white.reshape(DRAWS, _SLOTS, -1)
        self._left = target - np.einsum("ds,dsn->dn", self.heights, self._white)
        self._known = _seen(self._dictionary, places) @ root.T
        self._square = np.sum(self._known**2, axis=1)
        kept = 0.0
        if self._fit is not None:
            kept = self._choose(-0.5 * np.sum(self._left**2, axis=1) - self._fit)
        for _ in range(_ROUNDS if kept > _FEW else _MANY_ROUNDS):
            self._jump()
            for _ in range(_SHIFTS):
                self._shift()
        self._fit = -0.5 * np.sum(self._left**2, axis=1)

    def raised(self, places: Array) -> tuple[Array, Array]:
        """Return what discs add to ln k and whether places lie in one, each (n, draws)."""
        rows, slots = np.nonzero(self.heights)
        outside = _outside(self.discs[rows, slots].astype("f4"), places.astype("f4"))
        heights = self.heights[rows, slots, None] * _softened(outside)
        added, masks = np.zeros((2, DRAWS, len(places)))
        for slot in range(_SLOTS):
            own = slots == slot
            added[rows[own]] += heights[own]
            masks[rows[own]] += outside[own] < 0.0
        return added.T, masks.T

    def missed(self, factor: float, risk: float) -> float:
        """Return the radius [m] above which no further disc is stiffer by `factor`.

        But with a probability of `risk`, where one of each radius is as likely as none before.
        """
        found = _height(self._left @ self._known.T, self._square)
        is_stiffer = ndtr((found.mean - math.log(factor)) * np.sqrt(found.precision))
        odds = np.exp(np.minimum(found.evidence, 50.0)) * is_stiffer
        each = odds.reshape(DRAWS, -1, _RADII).mean(axis=1)
        chances = np.mean(each / (1.0 + each), axis=0)
        ends = np.exp(self._low[2] + self._step[2] * np.arange(1, _RADII + 1))
        return float(ends[chances > risk].max(initial=LEAST_RADIUS))

    def _choose(self, gains: Array) -> float:
        """Take draws as often as new presses make them likelier; return which share is kept."""
        weights = np.exp(gains - gains.max())
        ends = np.cumsum(weights) / weights.sum()
        places = (np.arange(DRAWS) + self._rng.uniform()) / DRAWS
        taken = np.minimum(np.searchsorted(ends, places), DRAWS - 1)
        self.discs, self.heights = self.discs[taken], self.heights[taken]
        self._white, self._left = self._white[taken], self._left[taken]
        return np.unique(taken).size / DRAWS

    def _jump(self) -> None:
        """Draw a slot's disc from the whole dictionary, smeared over its steps, or none."""
        rows, slots = np.arange(DRAWS), self._rng.integers(0, _SLOTS, DRAWS)
        left = self._without(slots)
        listed = _height(left @ self._known.T, self._square).evidence
        size = listed.shape[1]
        most = np.maximum(listed.max(axis=1), 0.0)
        sums = np.cumsum(np.exp(listed - most[:, None]), axis=1)
        empty = _EMPTY / (1.0 - _EMPTY) * size * np.exp(-most)
        drawn = self._rng.uniform(size=DRAWS) * (sums[:, -1] + empty)
        chosen = np.sum(sums < drawn[:, None], axis=1)
        is_disc = chosen < size
        chosen = np.minimum(chosen, size - 1)
        new = self._dictionary[chosen]
        new[:, :3] += (self._rng.uniform(size=(DRAWS, 3)) - 0.5) * self._step
        new[:, 3:] = _STRETCH_SD * self._rng.standard_normal((DRAWS, 2))
        white = _seen(new, self._places) @ self._root.T
        old = self.discs[rows, slots]
        place = ((old[:, :3] - self._low) / self._step).astype(int)
        place = np.clip(place, 0, np.array(self._counts) - 1)
        before = listed[rows, np.ravel_multi_index(tuple(place.T), self._counts)]
        was_disc = self.heights[rows, slots] != 0.0
        gain = np.where(is_disc, _known_of(left, white).evidence - listed[rows, chosen], 0.0)
        own = _known_of(left, self._white[rows, slots]).evidence
        gain -= np.where(was_disc, own - before, 0.0)
        taken = self._is_taken(gain) & (~is_disc | self._is_apart(slots, new))
        self._set(slots, left, taken, new, white, np.where(taken, is_disc, was_disc))

    def _shift(self) -> None:
        """Move a disc of each draw a little."""
        rows, is_disc = np.arange(DRAWS), self.heights != 0.0
        slots = np.argmax(is_disc * self._rng.uniform(0.5, 1.0, is_disc.shape), axis=1)
        left, is_disc = self._without(slots), is_disc[rows, slots]
        old = self.discs[rows, slots]
        least, most = np.log(_SHARES)
        shares = np.exp(self._rng.uniform(least, most, (DRAWS, 1)))
        new = old + shares * self._rng.standard_normal((DRAWS, 5)) * _LARGEST
        white = _seen(new, self._places) @ self._root.T
        gain = _known_of(left, white).evidence
        gain -= _known_of(left, self._white[rows, slots]).evidence
        gain -= 0.5 * np.sum(new[:, 3:] ** 2 - old[:, 3:] ** 2, axis=1) / _STRETCH_SD**2
        is_within = np.all((new[:, :3] > self._low) & (new[:, :3] < self._high), axis=1)
        taken = self._is_taken(gain) & is_disc & is_within & self._is_apart(slots, new)
        self._set(slots, left, taken, new, white, is_disc)

    def _without(self, slots: Indices) -> Array:
        """Return what draws leave of the presses without the disc of a slot."""
        rows = np.arange(DRAWS)
        own: Array = self.heights[rows, slots, None] * self._white[rows, slots]
        return self._left + own

    def _is_taken(self, gains: Array) -> Mask:
        return np.asarray(np.log(self._rng.uniform(size=DRAWS)) < gains)

    def _is_apart(self, slots: Indices, new: Array) -> Mask:
        """Whether discs touch none of the other slots."""
        away = np.linalg.norm(self.discs[..., :2] - new[:, None, :2], axis=2)
        least = np.exp(self.discs[..., 2]) + np.exp(new[:, None, 2])
        is_free = (away >= least) | (self.heights == 0.0)
        is_free[np.arange(DRAWS), slots] = True
        return np.asarray(is_free.all(axis=1))

    def _set(
        self, slots: Indices, left: Array, taken: Mask, new: Array, white: Array, is_disc: Mask
    ) -> None:
        """Put new discs where they are taken, and draw the heights of the slots."""
        rows = np.arange(DRAWS)
        self.discs[rows[taken], slots[taken]] = new[taken]
        self._white[rows[taken], slots[taken]] = white[taken]
        own = self._white[rows, slots]
        known = _known_of(left, own)
        drawn = known.mean + self._rng.standard_normal(DRAWS) / np.sqrt(known.precision)
        self.heights[rows, slots] = drawn = np.where(is_disc, drawn, 0.0)
        self._left = left - drawn[:, None] * own


def _known_of(left: Array, white: Array) -> _Height:
    """Return what is known of the height of a whitened disc (draws, n) in each draw."""
    return _height(np.sum(left * white, axis=1), np.sum(white**2, axis=1))


def _height(product: Array, square: Array) -> _Height:
    """Return what is known of heights, of products with the presses, and with themselves."""
    precision = square + _HEIGHT_SD**-2.0
    mean = (product + _HEIGHT / _HEIGHT_SD**2) / precision
    before = 0.5 * np.log(_HEIGHT_SD**2 * precision) + 0.5 * (_HEIGHT / _HEIGHT_SD) ** 2
    return _Height(mean, precision, 0.5 * mean**2 * precision - before)


def _outside(discs: Array, places: Array) -> Array:
    """Return how far places (n, 2) are out of discs (m, 5), (m, n) [m]."""
    x, y = (places[None, :, k] - discs[:, k, None] for k in (0, 1))
    along, across = discs[:, 3, None], discs[:, 4, None]
    # The exponential of a symmetric matrix without a trace, to the second order.
    both = 1.0 + 0.5 * (along**2 + across**2)
    a = (both + along) * x + across * y
    b = (both - along) * y + across * x
    return np.asarray(np.sqrt(a * a + b * b) - np.exp(discs[:, 2, None]))


def _softened(outside: Array) -> Array:
    return np.asarray(1.0 / (1.0 + np.exp(np.clip(outside / _EDGE, -50.0, 50.0))))


def _seen(discs: Array, places: Array) -> Array:
    """Return which part of discs (m, 5) presses at places (n, 2) see, (m, n)."""
    return _softened(_outside(discs, places))
