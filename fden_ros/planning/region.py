# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Where to press a region: what is stiffer there, and the place that tells most of it.

The logarithm of the stiffness is a Gaussian process and a few stiffer discs on it,

.. math:: \ln k(p) = b(p) + \sum_s a_s D_s(p)

with the kernel of b a constant, a squared exponential (one organ differs from place to place) and
a Matérn 5/2 (what is no disc). Discs are drawn one at a time given the others (Gibbs): a slot's
disc, among all of a dictionary and none, has a Gaussian height, whose evidence is exact. The mask
is where a disc is.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.special import ndtr

from fden_ros.core.arrays import Array
from fden_ros.core.outputs import WITHHELD, ContactSummary

#: Lengths [m] and standard deviations [1] of the process; of its mean [1].
_ORGAN_LENGTH, _ORGAN_SD = 25e-3, 0.2
_ROUGH_LENGTH, _ROUGH_SD = 7e-3, 0.08
_MEAN_SD = 2.0
#: Cells along the longer side [1].
_CELLS = 31
#: Radii of the discs [m], and the width of their edges [m].
_RADII = np.array([3e-3, 4.5e-3, 6e-3, 7.5e-3, 9e-3, 11e-3, 13e-3])
_EDGE = 1e-3
#: Height of a disc, its mean and standard deviation [1], and slots of discs, each empty before.
_HEIGHT, _HEIGHT_SD = 0.7, 0.35
_SLOTS, _EMPTY = 3, 0.5
#: Chains, and draws of all slots per chain, the first of which are left out.
_CHAINS, _SWEEPS, _LEFT_OUT = 12, 6, 2
#: Along a side, the places where every region is pressed first [1].
_START = 4
#: Probabilities at the boundary that are tried [1].
_LEVELS = (0.3, 0.4, 0.5)


#: Draws where the chains begin anew [1].
_FIRST_SWEEPS = 20
#: Overlap that is enough where none is stated [1]; what is said is said with this risk [1].
ENOUGH, _RISK = 0.8, 0.05
#: What is called stiffer is that by this factor [1].
STIFFER = 1.5
#: Time of a press [s] and speed from place to place [m/s] where none are stated.
_SECONDS, _SPEED = 4.0, 0.02
#: Deviations of ln k are not below this: places and depths are not exact [1].
_LEAST_SD = 0.02


class Presses(NamedTuple):
    """Where a region was pressed, and ln k there, k in N/m."""

    places: Array  #: (x, y) [m], (n, 2)
    logs: Array  #: (n,)
    sds: Array  #: (n,)

    @property
    def is_spread(self) -> bool:
        """Whether the places have an area."""
        return bool(np.linalg.matrix_rank(self.places - self.places.mean(axis=0), 1e-3) == 2)

    @classmethod
    def of(cls, rows: Iterable[tuple[float, float, float, float]]) -> Presses:
        """Return presses of rows of x, y [m], N/m and its standard deviation [N/m]."""
        found = np.array([row for row in rows if row[2] > 0.0 and row[3] > 0.0]).reshape(-1, 4)
        relative = np.maximum(found[:, 3] / found[:, 2], _LEAST_SD)
        return cls(found[:, :2], np.log(found[:, 2]), relative)

    @classmethod
    def found(cls, summaries: Iterable[ContactSummary]) -> Presses:
        """Return those of contacts with a place and a stiffness that is not withheld."""
        return cls.of(
            (*one.position[:2], one.apparent_stiffness.value, one.apparent_stiffness.sd)
            for one in summaries
            if one.position and one.apparent_stiffness and not one.flags & WITHHELD
        )


@dataclass(frozen=True)
class RegionMap:
    """What presses tell of a region.

    Attributes
    ----------
    mean, sd : ndarray, shape (cells,)
        Of ln k, k in N/m.
    probability : ndarray, shape (cells,)
        Of being stiffer than what is around [1].
    level : float
        Probability at the boundary of the mask: the one with the largest expected overlap [1].
    overlap, overlap_sd : float
        Intersection over union of the mask and the truth, as it is expected [1].
    nothing : float
        Probability that nothing is stiffer [1].
    missed : float
        Radius above which nothing is left that is stiffer by `STIFFER`, beside what the mask
        shows, but with a probability of 5 % [m].
    values, masks : ndarray, shape (cells, draws)
        ln k and the mask.
    open_variance : ndarray, shape (cells,)
        Of ln k, given discs [1].
    """

    mean: Array
    sd: Array
    probability: Array
    level: float
    overlap: float
    overlap_sd: float
    nothing: float
    missed: float
    values: Array
    masks: Array
    open_variance: Array


@dataclass(frozen=True)
class Proposal:
    """Where to press next.

    Attributes
    ----------
    places : ndarray, shape (n, 2)
        x and y [m].
    known : RegionMap or None
        None before the first press.
    is_done : bool
        The overlap is expected to be reached.
    """

    places: Array
    known: RegionMap | None
    is_done: bool

    @property
    def probability(self) -> float:
        """That the overlap is reached now [1]."""
        return 1.0 if self.is_done else 0.0

    def line(self) -> str:
        """Return the proposal in one line."""
        if not self.is_done:
            listed = ", ".join(f"({1e3 * x:.1f}, {1e3 * y:.1f})" for x, y in self.places)
            words = f"press at {listed} mm"
            return f"{words}; {self._known()}" if self.known is not None else words
        return f"done: {self._known()}"

    def _known(self) -> str:
        assert self.known is not None
        if self.known.nothing > 1.0 - _RISK:
            radius = 1e3 * self.known.missed
            return f"no inclusion larger than {radius:.2g} mm and {STIFFER:g} times as stiff"
        found = self.known
        return f"expected overlap {found.overlap:.2f} ± {found.overlap_sd:.2f}"


class Region:
    """A rectangle of tissue.

    Parameters
    ----------
    low, high : tuple of float
        Corners (x, y) [m].
    """

    def __init__(self, low: tuple[float, float], high: tuple[float, float]) -> None:
        self.low, self.high = np.array(low), np.array(high)
        sides = self.high - self.low
        step = float(sides.max()) / (_CELLS - 1)
        self.axes = [
            np.linspace(a, b, max(round((b - a) / step) + 1, 2))
            for a, b in zip(low, high, strict=True)
        ]
        x, y = np.meshgrid(*self.axes, indexing="ij")
        self.cells: Array = np.column_stack([x.ravel(), y.ravel()])
        self._away = _distances(self.cells, self.cells)
        #: Discs at the cells, (cells, centres, radii).
        self._discs = _edge(self._away, _RADII).reshape(len(self.cells), -1)
        self._masks = (self._away[:, :, None] < _RADII).reshape(len(self.cells), -1)
        self._rng = np.random.default_rng(0)
        self._slots = np.full((_CHAINS, _SLOTS), -1)
        self._heights = np.zeros((_CHAINS, _SLOTS))
        self._is_warm = False

    @classmethod
    def around(cls, presses: Presses) -> Region:
        """Return the region of presses, with a margin of half the distance of a raster."""
        low, high = presses.places.min(axis=0), presses.places.max(axis=0)
        side = max(float((high - low).max()), _CELLS * _EDGE)
        margin = 0.5 * side / math.sqrt(len(presses.logs))
        corners = [(float(x), float(y)) for x, y in (low - margin, high + margin)]
        return cls(*corners)

    def propose(self, presses: Presses, number: int = 1, enough: float = ENOUGH) -> Proposal:
        """Return where to press next: first everywhere, then where a press tells most."""
        known = self.solve(presses) if presses.logs.size else None
        here = presses.places[-1] if presses.logs.size else self.low
        left = self._first_places(presses.places)
        if known is None or len(left) >= number:
            return Proposal(left[:number], known, False)
        is_done = not len(left) and (
            known.overlap - known.overlap_sd >= enough or known.nothing > 1.0 - _RISK
        )
        chosen = [*left, *self._next_places(known, here, number - len(left))]
        return Proposal(np.array(chosen), known, is_done)

    def solve(self, presses: Presses) -> RegionMap:
        """Return the map that presses tell."""
        places, logs, sds = presses
        sweeps = _SWEEPS if self._is_warm else _FIRST_SWEEPS
        self._is_warm = True
        level = float(np.average(logs, weights=sds**-2.0))
        kernel = _kernel(_distances(places, places)) + np.diag(sds**2)
        root = np.linalg.cholesky(kernel)
        away = _distances(places, self.cells)
        discs = _edge(away, _RADII).reshape(len(places), -1)
        white = solve_triangular(root, discs, lower=True)
        target = solve_triangular(root, logs - level, lower=True)
        draws = self._draws(white, target, sweeps)
        slots, heights = (np.concatenate(part) for part in zip(*draws, strict=True))
        cross = _kernel(away)
        weights = cho_solve((root, True), cross)
        open_variance = _kernel(np.zeros(1)) - np.sum(cross * weights, axis=0)
        left = (logs - level)[:, None] - _raised(discs, slots, heights)
        values = level + weights.T @ left + _raised(self._discs, slots, heights)
        masks = np.any(self._masks[:, slots] & (slots >= 0), axis=2).astype(float)
        probability = masks.mean(axis=1)
        overlaps = {part: _overlap(masks, probability > part) for part in _LEVELS}
        best = max(_LEVELS, key=lambda part: overlaps[part][0])
        return RegionMap(
            mean=values.mean(axis=1),
            sd=np.sqrt(values.var(axis=1) + open_variance),
            probability=probability,
            level=best,
            overlap=overlaps[best][0],
            overlap_sd=overlaps[best][1],
            nothing=float(np.mean(~masks.any(axis=0))),
            missed=self._missed(white, target),
            values=values,
            masks=masks,
            open_variance=open_variance + float(np.median(sds)) ** 2,
        )

    def boundary(self, found: RegionMap) -> Array:
        """Return the sides of cells between what is stiffer and what is not, (n, 2, 2) [m]."""
        shape = [axis.size for axis in self.axes]
        inside = np.pad(found.probability.reshape(shape) > found.level, 1)
        steps = np.array([axis[1] - axis[0] for axis in self.axes])
        sides: list[Array] = []
        for k, along in enumerate(np.eye(2)):
            ends = np.argwhere(np.diff(inside, axis=k)) - 1.0 + 0.5 * along
            half = 0.5 * (1.0 - along)
            sides.append(np.stack([ends - half, ends + half], axis=1))
        result: Array = self.low + np.concatenate(sides) * steps
        return result

    def _first_places(self, places: Array) -> Array:
        """Return what is left of the places where every region is pressed first, row by row."""
        part = (np.arange(_START) + 0.5) / _START
        rows = [(x, y) for k, y in enumerate(part) for x in (part[::-1] if k % 2 else part)]
        first = self.low + np.array(rows) * (self.high - self.low)
        near = 0.25 * float((self.high - self.low).max()) / _START
        is_left = ~np.any(_distances(first, places) < near, axis=1)
        result: Array = first[is_left]
        return result

    def _next_places(self, found: RegionMap, here: Array, number: int) -> list[Array]:
        """Return places whose presses lower the expected variance of the mask most a second.

        After each the draws are moved to what is left given its value (square root filter).
        """
        masks = found.masks - found.masks.mean(axis=1, keepdims=True)
        values = found.values - found.values.mean(axis=1, keepdims=True)
        chosen: list[Array] = []
        for _ in range(number):
            shared = masks @ values.T / masks.shape[1]
            variance = np.mean(values**2, axis=1) + found.open_variance
            cost = _SECONDS + np.linalg.norm(self.cells - here, axis=1) / _SPEED
            best = int(np.argmax(np.sum(shared**2, axis=0) / variance / cost))
            here = self.cells[best]
            chosen.append(here)
            part = 1.0 / (1.0 + math.sqrt(found.open_variance[best] / variance[best]))
            seen = part * values[best] / variance[best]
            masks = masks - np.outer(shared[:, best], seen)
            values = values - np.outer(values @ values[best] / masks.shape[1], seen)
        return chosen

    def _missed(self, white: Array, target: Array) -> float:
        """Return the radius above which one more disc is unlikely [m]."""
        precision, constant = _of_heights(white)
        left = target[:, None] - _raised(white, self._slots, self._heights)
        means = (left.T @ white + _HEIGHT / _HEIGHT_SD**2) / precision
        odds = np.exp(np.minimum(0.5 * means**2 * precision + constant, 50.0))
        odds *= ndtr((means - math.log(STIFFER)) * np.sqrt(precision))
        each = odds.reshape(_CHAINS, -1, _RADII.size).sum(axis=1)
        chances = np.mean(each / (1.0 + each.sum(axis=1, keepdims=True)), axis=0)
        above = np.cumsum(chances[::-1])[::-1]
        return float(_RADII[above > _RISK].max(initial=0.0))

    def _draws(self, white: Array, target: Array, sweeps: int) -> list[tuple[Array, Array]]:
        """Return slots and heights (chains, slots) of each sweep; -1: an empty slot."""
        size = white.shape[1]
        precision, constant = _of_heights(white)
        found = []
        left = target[:, None] - _raised(white, self._slots, self._heights)
        chains = np.arange(_CHAINS)
        for sweep in range(sweeps):
            for s in range(_SLOTS):
                left += white[:, self._slots[:, s]] * self._heights[:, s]
                means = (left.T @ white + _HEIGHT / _HEIGHT_SD**2) / precision
                evidence = 0.5 * means**2 * precision + constant
                most = np.maximum(evidence.max(axis=1), 0.0)
                sums = np.cumsum(np.exp(evidence - most[:, None]), axis=1)
                place = self._rng.uniform(size=_CHAINS) * (sums[:, -1] + np.exp(-most))
                chosen = np.sum(sums < place[:, None], axis=1)
                chosen[chosen >= size] = -1
                drawn = self._rng.standard_normal(_CHAINS) / np.sqrt(precision[chosen])
                self._slots[:, s] = chosen
                self._heights[:, s] = np.where(chosen >= 0, means[chains, chosen] + drawn, 0.0)
                left -= white[:, chosen] * self._heights[:, s]
            if sweep >= min(_LEFT_OUT, sweeps - 1):
                found.append((self._slots.copy(), self._heights.copy()))
        return found


def _of_heights(white: Array) -> tuple[Array, Array]:
    """Return the precision of each disc's height, and what its log evidence has besides."""
    precision = np.sum(white**2, axis=0) + _HEIGHT_SD**-2.0
    before = math.log((1.0 - _EMPTY) / (_EMPTY * white.shape[1]))
    before -= 0.5 * (_HEIGHT / _HEIGHT_SD) ** 2
    return precision, before - 0.5 * np.log(_HEIGHT_SD**2 * precision)


def _raised(discs: Array, slots: Array, heights: Array) -> Array:
    """Return what discs (n, dictionary) add in each draw, (n, draws)."""
    result: Array = np.einsum("nms,ms->nm", discs[:, slots], heights)
    return result


def _overlap(masks: Array, mask: Array) -> tuple[float, float]:
    both = np.sum(masks * mask[:, None], axis=0)
    either = masks.sum(axis=0) + mask.sum() - both
    each = np.where(either > 0.0, both / np.maximum(either, 1.0), 1.0)
    return float(each.mean()), float(each.std())


def _distances(a: Array, b: Array) -> Array:
    return np.sqrt(np.sum((a[:, None] - b[None]) ** 2, axis=2))


def _edge(away: Array, radii: Array) -> Array:
    return 1.0 / (1.0 + np.exp(np.clip((away[..., None] - radii) / _EDGE, -50.0, 50.0)))


def _kernel(away: Array) -> Array:
    scaled = math.sqrt(5.0) * away / _ROUGH_LENGTH
    rough = _ROUGH_SD**2 * (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
    organ = _ORGAN_SD**2 * np.exp(-0.5 * (away / _ORGAN_LENGTH) ** 2)
    return _MEAN_SD**2 + organ + rough
