# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""A grid of 400 sites with stiffer inclusions: each site against its surroundings."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from fden_ros.benchmarks.populations import (
    PRIOR,
    draw_likelihood,
    population,
    press,
)
from fden_ros.core.arrays import Array
from fden_ros.core.classification.classifier import Likelihood, likelihood_of_estimate
from fden_ros.core.classification.relative import (
    Comparison,
    compare,
    neighbours,
    without_prior,
)
from fden_ros.core.law.apparent_stiffness import LogStiffness, log_stiffness

SIDE, SPACING = 20, 5.0  #: sites, [mm]
CONTRASTS = (1.5, 2.0, 4.0)
DIAMETERS = (8.0, 12.0, 20.0)  #: [mm]
#: Healthy tissue varies from place to place: deviation of ln G, ln Gn, alpha within one organ, and
#: the length over which it does [mm].
NATURAL_SD = (0.12, 0.05, 0.006)
_LENGTH = 15.0
#: How sharp the edge of an inclusion is to the probe [mm].
_EDGE = 1.5
#: Surroundings are within this distance [mm].
SURROUNDINGS = 25.0
STRAIN, TIME_SCALE = 0.1, 0.1
RATIO = 1.25


@dataclass(frozen=True)
class Inclusion:
    """A stiffer ball, seen from above [mm]."""

    x: float
    y: float
    diameter: float
    contrast: float


@dataclass(frozen=True, eq=False)
class Grid:
    """Sites of one organ."""

    positions: Array  #: [mm], shape (n, 2)
    values: Array  #: true (ln G, ln Gn, alpha), shape (n, 3)
    inclusions: tuple[Inclusion, ...]
    inside: NDArray[np.intp]  #: index of the inclusion that the site lies in, or -1
    edge: NDArray[np.bool_]  #: outside, but the probe feels an inclusion

    @property
    def log_ratio(self) -> Array:
        """Return ln of how many times stiffer than healthy, 0 outside, shape (n,)."""
        contrasts = np.array([math.log(i.contrast) for i in self.inclusions] + [0.0])
        result: Array = contrasts[self.inside]
        return result


def make_grid(generator: np.random.Generator, has_lesions: bool = True) -> Grid:
    """Return 400 sites with an inclusion of every contrast and size, at random places."""
    axis = SPACING * np.arange(SIDE)
    positions = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    inclusions = _place(generator, axis[-1]) if has_lesions else ()
    liver = population().tissues[1]
    values = liver.mean + np.stack([sd * _field(generator) for sd in NATURAL_SD], axis=-1)
    inside = np.full(len(positions), -1, dtype=np.intp)
    felt = np.zeros(len(positions))
    for index, one in enumerate(inclusions):
        depth = 0.5 * one.diameter - np.hypot(*(positions - [one.x, one.y]).T)
        share = 1.0 / (1.0 + np.exp(-depth / (0.5 * _EDGE)))
        # In parallel under the probe: the modulus is the mean by area.
        values[:, 0] += np.log1p((one.contrast - 1.0) * share)
        inside[depth > 0.0] = index
        felt = np.maximum(felt, share)
    return Grid(positions, values, inclusions, inside, (inside < 0) & (felt > 0.02))


def _place(generator: np.random.Generator, extent: float) -> tuple[Inclusion, ...]:
    wanted = [(d, c) for d in sorted(DIAMETERS, reverse=True) for c in CONTRASTS]
    while True:
        placed: list[Inclusion] = []
        for diameter, contrast in wanted:
            for _ in range(200):
                x, y = generator.uniform(0.4 * diameter, extent - 0.4 * diameter, 2)
                if all(
                    math.hypot(x - o.x, y - o.y) > 0.5 * (diameter + o.diameter) + 6.0
                    for o in placed
                ):
                    placed.append(Inclusion(float(x), float(y), diameter, contrast))
                    break
        if len(placed) == len(wanted):
            return tuple(placed)


def _field(generator: np.random.Generator) -> Array:
    """Return a smooth random field of unit variance over the grid, shape (n,)."""
    margin = 2 * SIDE
    noise = generator.standard_normal((SIDE + 2 * margin, SIDE + 2 * margin))
    smooth = gaussian_filter(noise, _LENGTH / SPACING / math.sqrt(2.0), mode="wrap")
    smooth /= smooth.std()
    result: Array = smooth[margin:-margin, margin:-margin].reshape(-1)
    return result


def drawn_estimates(
    grid: Grid, precision: Array, generator: np.random.Generator
) -> list[LogStiffness]:
    """Return what contacts with these information matrices would make of the sites."""
    chosen = precision[generator.integers(len(precision), size=len(grid.values))]
    likelihood = draw_likelihood(grid.values, chosen, generator)
    return [
        _of(Likelihood(*(part[i] for part in _parts(likelihood)))) for i in range(len(grid.values))
    ]


def _parts(likelihood: Likelihood) -> tuple[Array, Array, Array]:
    return likelihood.centre, likelihood.score, likelihood.information


def pressed_estimates(grid: Grid, advance: Callable[[], None]) -> list[LogStiffness]:
    """Return what simulator and pipeline make of the sites, pressed with a short hold."""
    library = population()
    found = []
    for index, value in enumerate(grid.values):
        one = press(library, value, 0, index, kind=1)
        advance()
        if one.estimate is None:
            found.append(LogStiffness(np.array(math.nan), np.array(math.nan)))
        else:
            found.append(_of(likelihood_of_estimate(one.estimate, PRIOR, False)))
    return found


def _of(likelihood: Likelihood) -> LogStiffness:
    own = without_prior(likelihood)
    if own is None:
        return LogStiffness(np.array(math.nan), np.array(math.nan))
    return log_stiffness(*own, STRAIN, TIME_SCALE)


def true_log_stiffness(grid: Grid) -> Array:
    """Return the true l of the sites, shape (n,)."""
    nothing = np.zeros((len(grid.values), 3, 3))
    return log_stiffness(grid.values, nothing, STRAIN, TIME_SCALE).value


def comparisons(grid: Grid, found: Sequence[LogStiffness]) -> list[Comparison | None]:
    """Return each site against those around it."""
    values = np.array([float(one.value) for one in found])
    variances = np.array([float(one.variance) for one in found])
    results: list[Comparison | None] = []
    for index, one in enumerate(found):
        if not math.isfinite(float(one.value)):
            results.append(None)
            continue
        near = neighbours(grid.positions, index, SURROUNDINGS)
        near = near[np.isfinite(values[near])]
        results.append(compare(one, LogStiffness(values[near], variances[near])))
    return results


def roc(scores: Array, positive: NDArray[np.bool_]) -> tuple[Array, Array, float]:
    """Return false and true positive rates, and the area under their curve (Mann and Whitney).

    Parameters
    ----------
    scores : ndarray, shape (n,)
    positive : ndarray of bool, shape (n,)
    """
    order = np.argsort(-scores, kind="stable")
    hits = positive[order]
    true = np.concatenate([[0.0], np.cumsum(hits) / max(int(hits.sum()), 1)])
    false = np.concatenate([[0.0], np.cumsum(~hits) / max(int((~hits).sum()), 1)])
    area = float(np.sum(np.diff(false) * 0.5 * (true[1:] + true[:-1])))
    return false, true, area


# Over many grids


@dataclass(frozen=True, eq=False)
class Lesions:
    """What the comparison with the surroundings tells."""

    curves: dict[float, tuple[Array, Array, float]]  #: by contrast
    by_size: dict[tuple[float, float], float]  #: area by contrast and diameter
    coverage: float  #: of the 95 % interval of the ratio where there is no lesion around
    coverage_among: float  #: of healthy sites among lesions, which the surroundings include
    false_alarms: float  #: healthy sites with P(stiffer by RATIO) above a half
    found: dict[float, float]  #: sites of a contrast with that
    grid: Grid
    compared: list[Comparison | None]
    through_pipeline: bool
    pipeline_areas: dict[float, float]


def compare_lesions(
    precision: Array,
    grids: int,
    generator: np.random.Generator,
    advance: Callable[[], None],
    *,
    presses_grid: bool,
) -> Lesions:
    """Return what comparing every site with its surroundings tells, over many grids."""
    parts: list[tuple[Array, ...]] = []
    last: tuple[Grid, list[Comparison | None]] | None = None
    for _ in range(grids):
        grid = make_grid(generator)
        compared = comparisons(grid, drawn_estimates(grid, precision, generator))
        last = grid, compared
        parts.append(_grid_scores(grid, compared))
        advance()
    assert last is not None
    sound = make_grid(generator, has_lesions=False)
    _, holds, _, _, _ = _grid_scores(
        sound, comparisons(sound, drawn_estimates(sound, precision, generator))
    )
    areas = {}
    if presses_grid:
        grid = make_grid(np.random.default_rng(7))
        last = grid, comparisons(grid, pressed_estimates(grid, advance))
        score, _, _, truth, _ = _grid_scores(*last)
        areas = {c: _curve(score, truth, c)[2] for c in CONTRASTS}
    score, inside, alarm, truth, diameter = (
        np.concatenate(part) for part in zip(*parts, strict=True)
    )
    return Lesions(
        {contrast: _curve(score, truth, contrast) for contrast in CONTRASTS},
        {
            (contrast, wide): _curve(
                score[(truth == 1.0) | (diameter == wide)],
                truth[(truth == 1.0) | (diameter == wide)],
                contrast,
            )[2]
            for contrast in CONTRASTS
            for wide in DIAMETERS
        },
        float(np.mean(holds)),
        float(np.mean(inside[truth == 1.0])),
        float(np.mean(alarm[truth == 1.0])),
        {contrast: float(np.mean(alarm[truth == contrast])) for contrast in CONTRASTS},
        *last,
        presses_grid,
        areas,
    )


def _grid_scores(
    grid: Grid, compared: Sequence[Comparison | None]
) -> tuple[Array, Array, Array, Array, Array]:
    """Return score, interval holds the truth, alarm, contrast and diameter of the sites."""
    used = [i for i, one in enumerate(compared) if one is not None and not grid.edge[i]]
    contrasts = np.array([i.contrast for i in grid.inclusions] + [1.0])
    diameters = np.array([i.diameter for i in grid.inclusions] + [0.0])
    ones = [compared[i] for i in used]
    own = true_log_stiffness(grid)
    healthy = _healthy(grid, own)
    holds = []
    for index, one in zip(used, ones, strict=True):
        assert one is not None
        low, high = one.interval()
        holds.append(low <= math.exp(own[index] - healthy[index]) <= high)
    return (
        np.array([one.deviations for one in ones if one is not None]),
        np.array(holds, dtype=float),
        np.array([one.probability_stiffer(RATIO) > 0.5 for one in ones if one is not None]),
        contrasts[grid.inside[used]],
        diameters[grid.inside[used]],
    )


def _healthy(grid: Grid, own: Array) -> Array:
    """Return the mean of l over the healthy surroundings of each site, shape (n,)."""
    sound = (grid.inside < 0) & ~grid.edge
    near = [neighbours(grid.positions, i, SURROUNDINGS) for i in range(len(own))]
    return np.array([float(np.mean(own[index[sound[index]]])) for index in near])


def _curve(score: Array, truth: Array, contrast: float) -> tuple[Array, Array, float]:
    kept = (truth == 1.0) | (truth == contrast)
    return roc(score[kept], truth[kept] == contrast)
