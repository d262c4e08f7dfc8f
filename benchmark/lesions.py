# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Grids of 400 sites with stiffer inclusions: each site against its surroundings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.stats import mannwhitneyu

from benchmark.populations import draw_likelihood, population
from benchmark.score import share
from fden_ros.core.arrays import Array
from fden_ros.core.classification.classifier import Likelihood
from fden_ros.core.classification.relative import Comparison, compare, neighbours, without_prior
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
#: So many times stiffer with a probability above a half is an alarm.
RATIO = 1.25


@dataclass(frozen=True, eq=False)
class Grid:
    """Sites of one organ; arrays over the sites."""

    positions: Array  #: [mm], shape (n, 2)
    values: Array  #: true (ln G, ln Gn, alpha), shape (n, 3)
    contrast: Array  #: of the inclusion that the site lies in, 1 outside, shape (n,)
    diameter: Array  #: likewise [mm], 0 outside, shape (n,)
    edge: NDArray[np.bool_]  #: outside, but the probe feels an inclusion, shape (n,)


def make_grid(generator: np.random.Generator, has_lesions: bool = True) -> Grid:
    """Return 400 sites with an inclusion of every contrast and size, at random places."""
    axis = SPACING * np.arange(SIDE)
    positions = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    liver = population().tissues[1]
    inclusions = _placed(generator, float(axis[-1])) if has_lesions else []
    values = liver.mean + np.stack([sd * _field(generator) for sd in NATURAL_SD], axis=-1)
    contrast, diameter, felt = np.ones(len(positions)), np.zeros(len(positions)), values[:, 0] < 0
    for x, y, wide, stiffer in inclusions:
        depth = 0.5 * wide - np.hypot(*(positions - [x, y]).T)
        inside = 1.0 / (1.0 + np.exp(-depth / (0.5 * _EDGE)))
        # In parallel under the probe: the modulus is the mean by area.
        values[:, 0] += np.log1p((stiffer - 1.0) * inside)
        contrast[depth > 0.0], diameter[depth > 0.0] = stiffer, wide
        felt |= inside > 0.02
    return Grid(positions, values, contrast, diameter, felt & (contrast == 1.0))


def _placed(generator: np.random.Generator, extent: float) -> list[tuple[float, ...]]:
    """Return x, y, diameter [mm] and contrast of inclusions that do not touch."""
    wanted = [(d, c) for d in sorted(DIAMETERS, reverse=True) for c in CONTRASTS]
    while True:
        placed: list[tuple[float, ...]] = []
        for diameter, contrast in wanted:
            for _ in range(200):
                x, y = generator.uniform(0.4 * diameter, extent - 0.4 * diameter, 2).tolist()
                if all(
                    math.hypot(x - other[0], y - other[1]) > 0.5 * (diameter + other[2]) + 6.0
                    for other in placed
                ):
                    placed.append((x, y, diameter, contrast))
                    break
        if len(placed) == len(wanted):
            return placed


def _field(generator: np.random.Generator) -> Array:
    """Return a smooth random field of unit variance over the grid, shape (n,)."""
    margin = 2 * SIDE
    noise = generator.standard_normal((SIDE + 2 * margin, SIDE + 2 * margin))
    smooth = gaussian_filter(noise, _LENGTH / SPACING / math.sqrt(2.0), mode="wrap")
    smooth /= smooth.std()
    result: Array = smooth[margin:-margin, margin:-margin].reshape(-1)
    return result


def stiffness_of(likelihood: Likelihood | None) -> LogStiffness:
    """Return the logarithm of the stiffness that one contact's data say; NaN: nothing."""
    own = None if likelihood is None else without_prior(likelihood)
    if own is None:
        return LogStiffness(np.array(math.nan), np.array(math.nan))
    return log_stiffness(*own, STRAIN, TIME_SCALE)


def drawn_estimates(
    grid: Grid, precision: Array, generator: np.random.Generator
) -> list[LogStiffness]:
    """Return what contacts with these information matrices would make of the sites."""
    drawn = draw_likelihood(grid.values, precision, generator)
    parts = zip(drawn.centre, drawn.score, drawn.information, strict=True)
    return [stiffness_of(Likelihood(*part)) for part in parts]


def comparisons(grid: Grid, found: list[LogStiffness]) -> list[Comparison | None]:
    """Return each site against those around it."""
    values = np.array([float(one.value) for one in found])
    variances = np.array([float(one.variance) for one in found])
    results: list[Comparison | None] = []
    for index, one in enumerate(found):
        near = neighbours(grid.positions, index, SURROUNDINGS)
        near = near[np.isfinite(values[near])]
        is_known = math.isfinite(float(one.value))
        around = LogStiffness(values[near], variances[near])
        results.append(compare(one, around) if is_known else None)
    return results


def rows_of(grids: list[tuple[Grid, list[Comparison | None]]]) -> dict[str, dict[str, Any]]:
    """Return areas under the ROC curve and alarms by contrast, over all grids."""
    sites: list[tuple[float, bool, float, float, bool]] = []
    for grid, compared in grids:
        nothing = np.zeros((len(grid.values), 3, 3))
        own = log_stiffness(grid.values, nothing, STRAIN, TIME_SCALE).value
        sound = (grid.contrast == 1.0) & ~grid.edge
        for index, one in enumerate(compared):
            if one is None or grid.edge[index]:
                continue
            near = neighbours(grid.positions, index, SURROUNDINGS)
            low, high = one.interval()
            healthy_ratio = math.exp(own[index] - np.mean(own[near[sound[near]]]))
            sites.append(
                (
                    one.deviations,
                    one.probability_stiffer(RATIO) > 0.5,
                    float(grid.contrast[index]),
                    float(grid.diameter[index]),
                    low <= healthy_ratio <= high,
                )
            )
    score, alarm, contrast, diameter, holds = (np.array(x) for x in zip(*sites, strict=True))
    healthy = contrast == 1.0
    rows: dict[str, dict[str, Any]] = {
        "healthy": {
            "alarms": share(alarm[healthy]),
            "intervals that hold": share(holds[healthy]),
        }
    }
    for stiffer in CONTRASTS if not healthy.all() else ():
        own_sites = contrast == stiffer
        row: dict[str, Any] = {"alarms": share(alarm[own_sites])}
        for name, some in (
            ("area under ROC", own_sites),
            *((f"of {d:g} mm", own_sites & (diameter == d)) for d in DIAMETERS),
        ):
            row[name] = _area_under_roc(score[some], score[healthy])
        rows[f"{stiffer:g} times stiffer"] = row
    return rows


def _area_under_roc(lesions: Array, healthy: Array) -> float:
    """Return the probability that a lesion's score is above a healthy site's."""
    found = mannwhitneyu(lesions, healthy).statistic
    return float(found) / (lesions.size * healthy.size)
