# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tissue that changes under the probe: how often it is reported, and how often falsely.

A probe presses to 25 % and holds. On the way down it meets an *inclusion*, where G becomes so many
times what it was, at once; or in the hold it *slides*, over 40 ms, onto tissue so many times
stiffer and has the same past. The stress is the closed form, which shares nothing with the
estimator. A change counts as reported where ``TISSUE_CHANGED`` is in a state after it began, and
falsely where it is in one before.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmark.harness import Benchmark, Report, Table, at_least, by_case, few
from benchmark.score import Share, share, total
from benchmark.trial import begun, fed, log_uniform, soft_tissue
from fden_ros.core.arrays import Array
from fden_ros.core.outputs import Flag, TissueState
from fden_ros.simulation import FdenModel
from simulation.closed_form import LinearMove, motion_of, moves_of_knots
from simulation.contact import Stiffening, contacts_of_moves
from simulation.scenario import Geometry
from simulation.simulate import KNOWN_RIG

EPILOG = """\
examples:
  fden benchmark changes                          # 12 contacts a cell
  fden benchmark changes --cases flat_30,flat_100_arm --contacts 4
"""

#: The press: deepest strain, strain at which an inclusion is met [1], hold [s], height above the
#: tissue from where it presses as a share of the length [1], time in the air before it and after
#: it [s].
_DEEPEST, _MET, _HOLD, _ABOVE, _PAUSE, _AFTER = 0.25, 0.14, 2.0, 0.05, 2.0, 0.5
#: Knots of a sphere's press, which is at a constant speed; linear in strain in between.
_KNOTS = 30
#: Time of a slide [s], and from the beginning of the hold to that of the slide [s].
_SLIDE_TIME, _SLIDE_AFTER = 0.04, (0.6, 1.2)
#: Noise of the stress [Pa] and of the displacement as a share of the length [1].
_NOISE_PA, _NOISE_SHARE = 3.0, 5e-5


class Change(NamedTuple):
    """An event under the probe: G becomes `ratio` times its value."""

    kind: str
    ratio: float = 1.0

    @property
    def name(self) -> str:
        """Kind and ratio."""
        return self.kind if self.kind == "none" else f"{self.kind} {self.ratio:g}"


NOTHING = Change("none")
CHANGES = (
    Change("slide", 1.3),
    *(Change("inclusion", ratio) for ratio in (1.5, 2.0, 4.0)),
    NOTHING,
)
_BY_NAME = {change.name: change for change in CHANGES}

_FLAT = Geometry("flat_punch", radius_m=0.01, thickness_m=0.02)
_SPHERE = Geometry("sphere", radius_m=0.01)


class Row(NamedTuple):
    """One row of the table."""

    name: str
    geometry: Geometry
    rate_hz: float
    parameters: Mapping[str, Any] = KNOWN_RIG


CASES = {
    row.name: row
    for row in (
        *(Row(f"flat_{rate}", _FLAT, float(rate)) for rate in (10, 30, 100, 500, 1000)),
        *(Row(f"flat_{rate}_arm", _FLAT, float(rate), {}) for rate in (30, 100)),
        *(Row(f"sphere_{rate}", _SPHERE, float(rate)) for rate in (30, 500)),
    )
}


class Pressed(NamedTuple):
    """One press: samples of shape (n,), and when the change begins [s]; inf: never."""

    times: Array  #: [s]
    forces: Array  #: [N]
    displacements: Array  #: [m]
    changed_at: float
    tissue: FdenModel


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify and count."""
    tasks = [
        ((row.name, change.name), number)
        for row in args.cases
        for change in CHANGES
        for number in args.numbers
    ]
    found = by_case(run_trial, tasks, "presses")
    cells = {
        row.name: {c.name: reported_in(found[row.name, c.name]) for c in CHANGES}
        for row in args.cases
    }
    goals = []
    for name, row in cells.items():
        reported = total(row[c.name]["reported"] for c in CHANGES if c != NOTHING).value
        goals.append(at_least(f"{name}: changes reported", reported, 0.8))
    false = total(cell["false"] for row in cells.values() for cell in row.values())
    goals.append(few("reported too soon, or without a change", false, 0.02))
    counts = {
        name: {change: _words(cell) for change, cell in row.items()} for name, row in cells.items()
    }
    return Report(goals, {"rows": Table("Reported, of so many; - before it began", counts)})


def reported_in(delays: Sequence[float]) -> dict[str, Share]:
    """Return the figures of a cell from its delays [s]: below 0 too soon, inf not reported."""
    return {
        "reported": share(0.0 <= delay < math.inf for delay in delays),
        "false": share(delay < 0.0 for delay in delays),
    }


def _words(cell: Mapping[str, Share]) -> str:
    false = cell["false"].part
    words = f"{cell['reported'].part}{f'-{false}' * bool(false)}"
    return f"{words} of {cell['reported'].whole}"


def run_trial(which: tuple[str, str], number: int) -> float:
    """Simulate press `number`, identify it, and return when the change was reported [s]."""
    row, change = CASES[which[0]], _BY_NAME[which[1]]
    pressed = press(row.geometry, row.rate_hz, change, number)
    pipeline, outputs = begun({**row.parameters, **row.geometry.parameters})
    for time in fed(pipeline, pressed.times, pressed.forces, pressed.displacements):
        if any(isinstance(o, TissueState) and o.flags & Flag.TISSUE_CHANGED for o in outputs):
            # Reported without a change is too soon.
            return time - pressed.changed_at
        outputs.clear()
    return math.inf


def press(geometry: Geometry, rate_hz: float, change: Change, number: int) -> Pressed:
    """Simulate press `number`; tissue and motion are the same for every row and change."""
    tissue, chance = (np.random.default_rng([number, purpose]) for purpose in (1, 2))
    model = soft_tissue(tissue)
    knots, hold = _knots(geometry, log_uniform(tissue, 0.1, 0.5))
    slide = hold + tissue.uniform(*_SLIDE_AFTER)
    met = next(time for knot in knots for time in knot.crossings(_MET))
    stiffening = Stiffening(_MET, change.ratio) if change.kind == "inclusion" else None
    times = np.arange(tissue.uniform() / rate_hz, knots[-1].stop, 1.0 / rate_hz)
    stress = contacts_of_moves(knots, model, stiffening).stress(times)
    if change.kind == "slide":
        onto = np.clip((times - slide) / _SLIDE_TIME, 0.0, 1.0)
        stress = stress * (1.0 + (change.ratio - 1.0) * onto)
    stress = stress + chance.normal(0.0, _NOISE_PA, times.size)
    depths = geometry.depth_of_strain(motion_of(knots, times)[0])
    depths = depths + chance.normal(0.0, _NOISE_SHARE * geometry.length_m, times.size)
    begins = {"slide": slide, "inclusion": met}.get(change.kind, math.inf)
    return Pressed(times, stress * geometry.force_per_stress, depths, begins, model)


def _knots(geometry: Geometry, strain_rate: float) -> tuple[list[LinearMove], float]:
    """Return pause, press at a constant speed, hold and release, and when the hold begins [s]."""
    deepest = float(geometry.depth_of_strain(np.array([_DEEPEST]))[0]) / geometry.length_m
    knots = _KNOTS if geometry.kind == "sphere" else 2
    depths = np.concatenate([[-_ABOVE], np.linspace(0.0, deepest, knots)])
    # On average over the press as fast as this strain rate.
    speed = strain_rate * deepest / _DEEPEST
    down = _PAUSE + (depths + _ABOVE) / speed
    up = down[-1] + _HOLD + (down[-1] - down[::-1])
    strains = [geometry.strain_of_depth(depth * geometry.length_m) for depth in depths]
    times = np.concatenate([[0.0], down, up, [up[-1] + _AFTER]])
    return moves_of_knots(times, [-_ABOVE, *strains, *strains[::-1], -_ABOVE]), float(down[-1])


BENCHMARK = Benchmark(run, EPILOG, cases=CASES, contacts=(12, 1))
