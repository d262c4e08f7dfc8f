# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How many presses find what is stiffer in a region, by proposals and by a raster.

Phantoms of 60 x 60 mm have one to three ellipses 1.5 to 3 times as stiff as the tissue around,
which itself differs by 15 %; every press has a deviation of 5 to 12 %, which it states. The truth
shares nothing with the planner but that a press is blurred by a millimetre. Both end in the same
fit.
"""

from __future__ import annotations

import argparse
import math
import time
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from benchmark.harness import Benchmark, Report, Table, at_least, at_most, measured
from fden_ros.core.arrays import Array
from fden_ros.planning.region import ENOUGH, Presses, Region

EPILOG = """\
examples:
  fden benchmark region --quick
"""

_SIDE, _MOST = 0.06, 50
_FINE = np.linspace(0.0, _SIDE, 61)
_TRUE_CELLS = np.stack(np.meshgrid(_FINE, _FINE, indexing="ij"), axis=-1).reshape(-1, 2)


class Trial(NamedTuple):
    """Of one phantom: presses until the overlap is reached, infinite: never."""

    planned: float
    raster: float
    overlap_at_stop: float  #: NaN: it did not stop
    milliseconds: float


class Phantom:
    """A field of ln N/m."""

    def __init__(self, seed: int) -> None:
        draw = np.random.default_rng([seed, 5])
        self.discs: list[tuple[Array, float, float, float, float]] = []
        count = draw.integers(1, 4)
        while len(self.discs) < count:
            radius, aspect = draw.uniform(5e-3, 10e-3), draw.uniform(1.0, 1.3)
            turn, place = draw.uniform(0.0, math.pi), draw.uniform(radius, _SIDE - radius, 2)
            if all(math.dist(place, one[0]) > radius + one[1] + 2e-3 for one in self.discs):
                height = draw.uniform(math.log(1.5), math.log(3.0))
                self.discs.append((place, radius, aspect, turn, height))
        self._waves = draw.normal(0.0, 40.0, (8, 2)), draw.uniform(0.0, 2.0 * math.pi, 8)
        self._noise = np.random.default_rng([seed, 9])

    def logs(self, places: Array) -> Array:
        """Return ln k at places (n, 2), (n,)."""
        waves, phases = self._waves
        found = math.log(40.0) + 0.075 * np.cos(places @ waves.T + phases).sum(axis=1)
        for disc in self.discs:
            found = found + disc[4] / (1.0 + np.exp(_outside(disc, places) / 1.2e-3))
        return np.asarray(found)

    def pressed(self, places: Array) -> Presses:
        """Return presses at places (n, 2)."""
        sds = self._noise.uniform(0.05, 0.12, len(places))
        noise = sds * self._noise.standard_normal(len(places))
        return Presses(places, self.logs(places) + noise, sds)

    def overlap(self, region: Region, probability: Array, level: float) -> float:
        """Return intersection over union of a mask with the truth."""
        grid = probability.reshape(len(region.axes[0]), -1)
        mask = RegularGridInterpolator(region.axes, grid)(_TRUE_CELLS) > level
        truth = np.any([_outside(disc, _TRUE_CELLS) < 0.0 for disc in self.discs], axis=0)
        return float(np.sum(mask & truth) / np.sum(mask | truth))


def _outside(disc: tuple[Array, float, float, float, float], places: Array) -> Array:
    place, radius, aspect, turn, _ = disc
    away = (places - place) @ np.array(
        [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    )
    return np.asarray(np.hypot(away[:, 0] / aspect**0.5, away[:, 1] * aspect**0.5) - radius)


def _trial(seed: int) -> Trial:
    region, phantom = Region((0.0, 0.0), (_SIDE, _SIDE)), Phantom(seed)
    presses = phantom.pressed(region.propose(Presses.of([]), 16).places)
    costs, planned, at_stop = [], math.inf, math.nan
    while len(presses.logs) <= _MOST and (planned == math.inf or math.isnan(at_stop)):
        began = time.process_time()
        found = region.propose(presses)
        costs.append(1e3 * (time.process_time() - began))
        assert found.known is not None
        overlap = phantom.overlap(region, found.known.probability, found.known.level)
        planned = min(planned, len(presses.logs) if overlap >= ENOUGH else math.inf)
        if found.is_done and math.isnan(at_stop):
            at_stop = overlap
        new = phantom.pressed(found.places[:1])
        presses = Presses(*(np.concatenate(pair) for pair in zip(presses, new, strict=True)))
    return Trial(planned, _raster(seed), at_stop, float(np.median(costs)))


def _raster(seed: int) -> float:
    for count in range(4, 12):
        region, phantom = Region((0.0, 0.0), (_SIDE, _SIDE)), Phantom(seed)
        along = (np.arange(count) + 0.5) / count * _SIDE
        places = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)
        known = region.solve(phantom.pressed(places))
        if phantom.overlap(region, known.probability, known.level) >= ENOUGH:
            return float(count**2)
    return math.inf


def run(args: argparse.Namespace) -> Report:
    """Press phantoms."""
    tasks = [(number,) for number in args.numbers]
    trials = measured(_trial, tasks, jobs=args.jobs, what="phantoms")
    planned, raster, at_stop, costs = (np.array(column) for column in zip(*trials, strict=True))
    row = _row(planned, raster, at_stop, costs)
    median = float(np.median(planned))
    goals = [
        at_most("presses to an overlap of 0.8, median", median, 26.0),
        at_most("in nine of ten", float(_ninth(planned)), 50.0),
        at_least("raster over planned", float(np.median(raster)) / median, 1.8),
        at_most("processor time of a proposal [ms]", float(np.median(costs)), 50.0),
    ]
    return Report(goals, {"phantoms": Table("Phantoms", {f"{len(tasks)} phantoms": row})})


def _ninth(values: Array) -> float:
    return float(np.sort(values)[math.ceil(0.9 * len(values)) - 1])


def _row(planned: Array, raster: Array, at_stop: Array, costs: Array) -> dict[str, Any]:
    stopped = at_stop[np.isfinite(at_stop)]
    return {
        "presses, median": float(np.median(planned)),
        "nine of ten": _ninth(planned),
        "raster, median": float(np.median(raster)),
        "stopped": len(stopped),
        "overlap then, median": float(np.median(stopped)) if len(stopped) else math.nan,
        "enough then": int(np.sum(stopped >= ENOUGH)),
        "nothing found": int(np.sum(stopped == 0.0)),
        "ms": float(np.median(costs)),
    }


BENCHMARK = Benchmark(run, EPILOG, contacts=(40, 4))
