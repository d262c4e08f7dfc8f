# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Where to press a region: what is stiffer there, and the place that tells most of it.

The logarithm of the stiffness is a Gaussian process and a few stiffer discs on it
(:mod:`fden_ros.planning.inclusions`). The kernel of the process has a constant, a squared
exponential (one organ differs from place to place) and a Matérn 5/2 (what is no disc). The mask is
where a disc is.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from fden_ros.core.arrays import Array, Indices, Mask
from fden_ros.core.outputs import WITHHELD, ContactSummary
from fden_ros.planning.inclusions import Inclusions

#: Lengths [m] and standard deviations [1] of the process; of its mean [1].
_ORGAN_LENGTH, _ORGAN_SD = 25e-3, 0.2
_ROUGH_LENGTH, _ROUGH_SD = 7e-3, 0.08
_MEAN_SD = 2.0
#: Cells along the longer side [1], and the least one of a region that presses span [m].
_CELLS, _LEAST_SIDE = 31, 0.03
#: A press tells nothing so near to one that told nothing [m]: its variance is this [1].
_SAME_PLACE, _TOLD_NOTHING = 4e-3, 1e6
#: Values of a press that are told apart [1].
_OUTCOMES = 10
#: Along a side, the places where every region is pressed first [1].
_START = 4
#: Probabilities at the boundary that are tried [1].
_LEVELS = (0.3, 0.4, 0.5)

#: Overlap that is enough where none is stated, and the probability of it that is [1].
ENOUGH, _SURE = 0.8, 0.8
#: That nothing larger is missed is said with this risk [1]; so small a radius may be [m].
_RISK, _NEGLIGIBLE = 0.05, 6e-3
#: What is called stiffer is that by this factor [1].
STIFFER = 1.5
#: Time of a press [s] and speed from place to place [m/s] where none are stated.
_SECONDS, _SPEED = 4.0, 0.02
#: Deviations of ln k are not below this [1]: no inclusion is just an ellipse with such an edge.
#: With 0.02 presses known to 1 % showed inclusions of up to 15 mm where there were none.
_LEAST_SD = 0.05


class Presses(NamedTuple):
    """Where a region was pressed, and ln k there, k in N/m."""

    places: Array  #: (x, y) [m], (n, 2)
    logs: Array  #: (n,)
    sds: Array  #: (n,), infinite where a press told no stiffness

    @property
    def is_told(self) -> Mask:
        """Which of them told a stiffness, (n,)."""
        return np.isfinite(self.sds)

    @property
    def is_spread(self) -> bool:
        """Whether the places have an area."""
        return bool(np.linalg.matrix_rank(self.places - self.places.mean(axis=0), 1e-3) == 2)

    @classmethod
    def of(cls, rows: Iterable[tuple[float, float, float, float]]) -> Presses:
        """Return presses of rows of x, y [m], N/m, and its standard deviation [N/m], or 0, 0."""
        found = np.array([*rows], dtype=float).reshape(-1, 4)
        is_told = np.all(found[:, 2:] > 0.0, axis=1)
        value, sd = np.where(is_told, found[:, 2:].T, 1.0)
        relative = np.where(is_told, np.maximum(sd / value, _LEAST_SD), math.inf)
        return cls(found[:, :2], np.log(value), relative)

    @classmethod
    def found(cls, summaries: Iterable[ContactSummary]) -> Presses:
        """Return those of contacts with a place; no stiffness counts that is withheld."""
        return cls.of(
            (*one.position[:2], found.value, found.sd)
            if (found := one.apparent_stiffness) and not one.flags & WITHHELD
            else (*one.position[:2], 0.0, 0.0)
            for one in summaries
            if one.position
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
    overlaps : ndarray, shape (draws,)
        Intersection over union of the mask and what may be the truth [1].
    missed : float
        Radius above which nothing is left that is stiffer by `STIFFER`, beside what the mask
        shows, but with a probability of 5 % [m].
    values, masks : ndarray, shape (cells, draws)
        ln k and the mask.
    open_variance : ndarray, shape (cells,)
        Of what a press shows, given discs [1].
    """

    mean: Array
    sd: Array
    probability: Array
    level: float
    overlaps: Array
    missed: float
    values: Array
    masks: Array
    open_variance: Array

    @property
    def is_empty(self) -> bool:
        """Whether the mask is."""
        return not np.any(self.probability > self.level)

    @property
    def overlap(self) -> float:
        """Overlap that is expected [1]."""
        return float(self.overlaps.mean())

    @property
    def overlap_sd(self) -> float:
        """Its standard deviation [1]."""
        return float(self.overlaps.std())


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
        The overlap is reached, or there is nothing, as surely as is asked for.
    probability : float
        That the overlap is reached [1].
    """

    places: Array
    known: RegionMap | None
    is_done: bool
    probability: float = 0.0

    def numbers(self) -> dict[str, Any]:
        """Return what ``fden plan --json`` prints of it."""
        known = self.known
        return {
            "places": self.places.tolist(),
            "done": self.is_done,
            "expected_overlap": None if known is None else known.overlap,
            "expected_overlap_sd": None if known is None else known.overlap_sd,
        }

    def line(self) -> str:
        """Return the proposal in one line."""
        if not self.is_done:
            listed = ", ".join(f"({1e3 * x:.1f}, {1e3 * y:.1f})" for x, y in self.places)
            words = f"press at {listed} mm"
            return f"{words}; {self._known()}" if self.known is not None else words
        return f"done: {self._known()}"

    def _known(self) -> str:
        assert self.known is not None
        if self.known.is_empty:
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
        self._inclusions = Inclusions(self.low, self.high)

    @classmethod
    def around(cls, presses: Presses) -> Region:
        """Return the region of presses, with a margin of half the distance of a raster."""
        low, high = presses.places.min(axis=0), presses.places.max(axis=0)
        side = max(float((high - low).max()), _LEAST_SIDE)
        margin = 0.5 * side / math.sqrt(len(presses.logs))
        corners = [(float(x), float(y)) for x, y in (low - margin, high + margin)]
        return cls(*corners)

    def propose(self, presses: Presses, number: int = 1, enough: float = ENOUGH) -> Proposal:
        """Return where to press next: first everywhere, then where a press tells most."""
        known = self.solve(presses) if presses.is_told.any() else None
        here = presses.places[-1] if presses.logs.size else self.low
        left = self._first_places(presses.places)
        if known is None or len(left) >= number:
            return Proposal(left[:number], known, False)
        probability = float(np.mean(known.overlaps >= enough))
        is_done = not len(left) and (
            known.missed <= _NEGLIGIBLE if known.is_empty else probability >= _SURE
        )
        chosen = [*left, *self._next_places(known, here, len(presses.logs), number - len(left))]
        return Proposal(np.array(chosen), known, is_done, probability)

    def solve(self, presses: Presses) -> RegionMap:
        """Return the map that presses tell."""
        places, logs, sds = (part[presses.is_told] for part in presses)
        level = float(np.average(logs, weights=sds**-2.0))
        kernel = _kernel(_distances(places, places)) + np.diag(sds**2)
        root = solve_triangular(np.linalg.cholesky(kernel), np.eye(len(logs)), lower=True)
        found = self._inclusions
        found.follow(places, root, root @ (logs - level))
        cross = _kernel(_distances(places, self.cells))
        white = root @ cross
        added, masks = found.raised(self.cells)
        left = (logs - level)[:, None] - found.raised(places)[0]
        values = level + (root.T @ white).T @ left + added
        open_variance = _kernel(np.zeros(1)) - np.sum(white**2, axis=0)
        probability = masks.mean(axis=1)
        overlaps = {part: _overlaps(masks, probability > part) for part in _LEVELS}
        best = max(_LEVELS, key=lambda part: float(overlaps[part].mean()))
        near = _distances(self.cells, presses.places[~presses.is_told]) < _SAME_PLACE
        noise = np.where(near.any(axis=1), _TOLD_NOTHING, float(np.median(sds)) ** 2)
        return RegionMap(
            mean=values.mean(axis=1),
            sd=np.sqrt(values.var(axis=1) + open_variance),
            probability=probability,
            level=best,
            overlaps=overlaps[best],
            missed=found.missed(STIFFER, _RISK),
            values=values,
            masks=masks,
            open_variance=open_variance + noise,
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

    def _next_places(self, found: RegionMap, here: Array, count: int, number: int) -> list[Array]:
        """Return places whose presses lower the expected variance of the mask most a second.

        After each the draws are moved to what is left given its value (square root filter).
        """
        masks, values = found.masks[self._fourth(0)], found.values
        chosen: list[Array] = []
        for k in range(number):
            tried = self._fourth(count + k)
            told = _told(masks, values[tried], np.sqrt(found.open_variance[tried]))
            cost = _SECONDS + np.linalg.norm(self.cells[tried] - here, axis=1) / _SPEED
            best = tried[int(np.argmax(told / cost))]
            here = self.cells[best]
            chosen.append(here)
            own = values[best] - values[best].mean()
            variance = float(np.mean(own**2)) + found.open_variance[best]
            seen = own / (variance + math.sqrt(variance * found.open_variance[best])) / own.size
            masks, values = (
                part - np.outer((part - part.mean(axis=1, keepdims=True)) @ own, seen)
                for part in (masks, values)
            )
        return chosen

    def _fourth(self, number: int) -> Indices:
        """Return every second cell along both axes, beginning at one of four."""
        index = np.arange(len(self.cells)).reshape([axis.size for axis in self.axes])
        return index[number % 2 :: 2, number // 2 % 2 :: 2].ravel()


def _told(masks: Array, values: Array, sds: Array) -> Array:
    """Return how far presses lower the variance of masks (cells, draws) in all, (places,).

    Draws have `values` (places, draws); a press shows them with `sds` (places,).
    """
    masks, values, sds = (part.astype("f4") for part in (masks.T, values, sds[:, None]))
    low, high = values.min(axis=1, keepdims=True), values.max(axis=1, keepdims=True)
    parts = (np.arange(_OUTCOMES, dtype="f4") + 0.5) / _OUTCOMES
    seen = low - 2.0 * sds + parts * (high - low + 4.0 * sds)
    weights = np.exp(-0.5 * ((seen[:, :, None] - values[:, None]) / sds[:, :, None]) ** 2)
    weights /= weights.sum(axis=(1, 2), keepdims=True)
    chances = np.maximum(weights.sum(axis=2), 1e-9)
    means = (weights.reshape(-1, len(masks)) @ masks).reshape(*chances.shape, -1)
    result: Array = np.sum(np.sum(means**2, axis=2) / chances, axis=1)
    return np.asarray(result - np.sum(masks.mean(axis=0) ** 2))


def _overlaps(masks: Array, mask: Array) -> Array:
    both = np.sum(masks * mask[:, None], axis=0)
    either = masks.sum(axis=0) + mask.sum() - both
    return np.where(either > 0.0, both / np.maximum(either, 1.0), 1.0)


def _distances(a: Array, b: Array) -> Array:
    return np.sqrt(np.sum((a[:, None] - b[None]) ** 2, axis=2))


def _kernel(away: Array) -> Array:
    scaled = math.sqrt(5.0) * away / _ROUGH_LENGTH
    rough = _ROUGH_SD**2 * (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
    organ = _ORGAN_SD**2 * np.exp(-0.5 * (away / _ORGAN_LENGTH) ** 2)
    return _MEAN_SD**2 + organ + rough
