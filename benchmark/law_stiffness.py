# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""N/m on tissue of any law: does its interval hold what a small step meets there.

Each law is pressed with three probes, on two rigs. At each moment of a press what is published,
converged or not, is held against the simulation itself: with a step of a thousandth of the depth
and without, after the time scale. What is flagged does not count.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from benchmark.score import TWO_SIDED_95, Share, share, warns
from benchmark.trial import elapsed, fed
from fden_ros.core.arrays import Array
from fden_ros.core.law import Geometry
from fden_ros.core.outputs import Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.parameters import check, pipeline_config

#: From the strains of the probe at the end of each step, which lasts so many seconds, to stresses.
Stress = Callable[[Array, float], Array]

GEOMETRIES: Mapping[str, Mapping[str, Any]] = {
    "flat punch": {
        "geometry.kind": "flat_punch",
        "geometry.area": math.pi * 0.01**2,
        "geometry.thickness": 0.02,
    },
    "punch in a wide layer": {
        "geometry.kind": "flat_punch",
        "geometry.area": math.pi * 0.005**2,
        "geometry.thickness": 0.02,
        "geometry.hayes": True,
    },
    "sphere": {"geometry.kind": "sphere", "geometry.radius": 0.01},
    "sphere on a layer": {
        "geometry.kind": "sphere",
        "geometry.radius": 0.01,
        "geometry.thickness": 0.01,
    },
}
#: How long the small motion lasts [s], and its size in parts of the compression [1].
TIME_SCALE, _SIZE = 0.1, 1e-3
#: How well the simulation tells it: its step takes a fiftieth of the time scale [1].
_RESOLUTION = 0.005


class Press(NamedTuple):
    """A simulated motion, and how it is sampled."""

    strains: Array  #: of the probe at the end of each step, negative in the air
    step: float  #: [s]
    cuts: int  #: steps for each sample
    noise: Array  #: of the samples, in parts of the largest force
    instants: tuple[float, ...]  #: at which N/m is asked for [s]


class Found(NamedTuple):
    """N/m at one moment."""

    is_known: bool
    is_flagged: bool = False
    is_inside: bool = False  #: the truth lies in the 95 % interval
    ratio: float = math.nan  #: to the truth
    half_width: float = math.nan  #: of the interval, in parts of the value


def kelvin_voigt(stiffness: float, time: float) -> Stress:
    """Return spring and dashpot: E (x + time dx/dt), while it pushes."""

    def stress(strains: Array, step: float) -> Array:
        inside = np.maximum(strains, 0.0)
        rates = np.diff(inside, prepend=0.0) / step
        return np.maximum(stiffness * (inside + time * rates), 0.0) * (strains > 0.0)

    return stress


def hunt_crossley(stiffness: float, exponent: float, damping: float) -> Stress:
    """Return k x^n (1 + damping dx/dt), while it pushes."""

    def stress(strains: Array, step: float) -> Array:
        inside = np.maximum(strains, 0.0)
        rates = np.diff(inside, prepend=0.0) / step
        return np.maximum(stiffness * inside**exponent * (1.0 + damping * rates), 0.0)

    return stress


def found_at(press: Press, stress: Stress, parameters: Mapping[str, Any]) -> list[Found]:
    """Return what is published at the moments of a press, beside the truth.

    The strains are pressed whatever the geometry: the way follows from them.
    """
    config = pipeline_config(check(parameters))
    geometry = config.geometry
    strains, per_force = press.strains, geometry.stress_per_force
    compressions = np.sign(strains) * [geometry.compression(x) for x in np.abs(strains)]
    forces = stress(strains, press.step)[press.cuts - 1 :: press.cuts] / per_force
    forces = forces + press.noise * forces.max()
    depths = geometry.length * compressions[press.cuts - 1 :: press.cuts]
    times = press.step * press.cuts * np.arange(1.0, depths.size + 1.0)
    newest: list[TissueState] = []

    def hear(output: Output) -> None:
        if isinstance(output, TissueState):
            newest[:] = [output]

    pipeline, waiting, found = Pipeline(config, hear), list(press.instants), []
    for _ in fed(pipeline, times, forces, depths, placed=True):
        if waiting and newest and elapsed(newest[0].stamp_ns) >= waiting[0]:
            waiting.pop(0)
            truth = _truth(press, stress, geometry, elapsed(newest[0].stamp_ns))
            found.append(_beside(newest[0], truth))
    pipeline.finish()
    return found


def _beside(state: TissueState, truth: float) -> Found:
    one = state.apparent_stiffness
    if one is None:
        return Found(False)
    reach = TWO_SIDED_95 * one.sd
    is_inside = abs(one.value - truth) <= reach + _RESOLUTION * truth
    return Found(True, warns(state.flags), is_inside, one.value / truth, reach / one.value)


def _truth(press: Press, stress: Stress, geometry: Geometry, at: float) -> float:
    """Return what a small step meets after the time scale [N/m], from a time on [s]."""
    before = press.strains[: round(at / press.step)]
    compression = geometry.compression(float(before[-1]))
    count, forces = round(TIME_SCALE / press.step), []
    for moved in (compression, compression * (1.0 + _SIZE)):
        stays = np.full(count, geometry.strain(moved))
        after = stress(np.concatenate([before, stays]), press.step)[-1]
        forces.append(float(after) / geometry.stress_per_force)
    return (forces[1] - forces[0]) / (_SIZE * compression * geometry.length)


def row_of(found: list[Found]) -> dict[str, Any]:
    """Return the figures of a law."""
    known = [one for one in found if one.is_known]
    counted = [one for one in known if not one.is_flagged]
    row: dict[str, Any] = {
        "known": Share(len(known), len(found)),
        "flagged": share(one.is_flagged for one in known),
        "in 95 %": share(one.is_inside for one in counted),
    }
    if counted:
        row["ratio, median"] = float(np.median([one.ratio for one in counted]))
        row["half width"] = float(np.median([one.half_width for one in counted]))
    return row
