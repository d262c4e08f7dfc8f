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

"""Tissue that changes under the probe: how soon it is told, and how often without a change.

A probe presses to 25 % and holds. On the way down it meets an *inclusion*, where G becomes so many
times what it was, at once; or a *body* beside the tissue, by which from there on only the slope is
so many times what it was; or in the hold it *slides*, over 40 ms, onto tissue so many times
stiffer and has the same past. The stress is the closed form, which shares nothing with the
estimator. A change counts as told where ``TISSUE_CHANGED`` is in a state at most so long after it
began. Bodies have no goal: little of one is loaded by then.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fden_ros.benchmarks import Goal, Report, progress, within
from fden_ros.benchmarks.processes import completed
from fden_ros.benchmarks.selection import chosen
from fden_ros.core.outputs import ContactSummary, Flag, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.errors import InputError
from fden_ros.parameters import check, pipeline_config, read_parameter_file
from fden_ros.simulation.closed_form import (
    FdenModel,
    LinearMove,
    moves_of_knots,
    stress_of_moves,
)
from fden_ros.simulation.contact import Stiffening, contacts_of_moves
from fden_ros.simulation.scenario import Geometry
from fden_ros.simulation.simulate import KNOWN_RIG, START_NS

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

Array = NDArray[np.float64]

EPILOG = """\
examples:
  fden benchmark changes                          # 12 contacts a cell
  fden benchmark changes --quick
  fden benchmark changes --rows flat_30,flat_100_arm --contacts 4
  fden benchmark changes --json | jq '.figures.rows.flat_30'
"""

_CONTACTS, _QUICK_CONTACTS = 12, 1
#: A change is to be told within this of its beginning [s].
_IN_TIME = 0.1
#: Share of the changes that are to be told in time, and of contacts told without a change.
_TOLD, _FALSE = 0.95, 0.02
#: The press: deepest strain, strain at which an inclusion is met [1], hold [s], height above the
#: tissue from where it presses as a share of the length [1], time in the air before it [s].
_DEEPEST, _MET, _HOLD, _ABOVE, _PAUSE = 0.25, 0.14, 2.0, 0.05, 2.0
#: Knots of a sphere's press, which is at a constant speed; linear in strain in between.
_KNOTS = 30
#: Time of a slide [s], and from the beginning of the hold to that of the slide [s].
_SLIDE_TIME, _SLIDE_AFTER = 0.04, (0.6, 1.2)
#: Noise of the stress [Pa] and of the displacement as a share of the length [1].
_NOISE_PA, _NOISE_SHARE = 3.0, 5e-5
_NANO = 1e-9


@dataclass(frozen=True)
class Change:
    """What happens under the probe: G is `ratio` times what it was."""

    kind: str
    ratio: float = 1.0

    @property
    def name(self) -> str:
        """Kind and ratio."""
        return self.kind if self.kind == "none" else f"{self.kind}_{self.ratio:g}"


NOTHING = Change("none")
CHANGES = (
    Change("slide", 1.3),
    *(Change("inclusion", ratio) for ratio in (1.5, 2.0, 4.0)),
    *(Change("body", ratio) for ratio in (1.5, 2.0, 4.0)),
    NOTHING,
)

#: Those that are to be told in time.
_WITH_GOAL = ("slide", "inclusion")

_FLAT = Geometry("flat_punch", radius_m=0.01, thickness_m=0.02)
_SPHERE = Geometry("sphere", radius_m=0.01)
_PASS = Geometry("pass_through")


@dataclass(frozen=True)
class Row:
    """One row of the table."""

    name: str
    geometry: Geometry
    rate_hz: float
    parameters: Mapping[str, Any]

    @property
    def says(self) -> str:
        """The row in words."""
        rig = "" if self.parameters else ", arm"
        return f"{self.geometry.kind}, {self.rate_hz:g} Hz{rig}"


ROWS = {
    row.name: row
    for row in (
        Row("flat_10", _FLAT, 10.0, KNOWN_RIG),
        Row("flat_30", _FLAT, 30.0, KNOWN_RIG),
        Row("sphere_30", _SPHERE, 30.0, KNOWN_RIG),
        Row("pass_through_30", _PASS, 30.0, KNOWN_RIG),
        Row("flat_30_arm", _FLAT, 30.0, {}),
        Row("flat_100", _FLAT, 100.0, KNOWN_RIG),
        Row("flat_100_arm", _FLAT, 100.0, {}),
        Row("flat_300", _FLAT, 300.0, KNOWN_RIG),
        Row("sphere_300", _SPHERE, 300.0, KNOWN_RIG),
        Row("pass_through_300", _PASS, 300.0, KNOWN_RIG),
        Row("flat_1000", _FLAT, 1000.0, KNOWN_RIG),
    )
}


class Pressed(NamedTuple):
    """One press: samples of shape (n,), and when the change begins [s]; inf: never."""

    times: Array  #: [s]
    forces: Array  #: [N], or [Pa] for pass_through
    displacements: Array  #: [m], or strain [1]
    changed_at: float


class Told(NamedTuple):
    """What was told of one press."""

    delay: float  #: from the change's beginning to the first state with it [s]; inf: not told
    is_false: bool  #: told before it began, or without one
    is_mismatch: bool  #: of the contact, at its end

    @property
    def in_time(self) -> bool:
        """Whether the change was told soon enough."""
        return not self.is_false and self.delay <= _IN_TIME


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmark's own arguments."""
    parser.epilog = EPILOG
    parser.add_argument(
        "--contacts", type=int, metavar="N", help=f"of each cell (default: {_CONTACTS})"
    )
    parser.add_argument("--rows", metavar="A,B", help="names of the rows (default: all)")
    parser.add_argument(
        "--first", type=int, default=0, metavar="N", help="number of the first (default: 0)"
    )
    parser.add_argument("--parameters", type=Path, metavar="FILE", help="of the identifier")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default: 2)")


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify and count."""
    rows = chosen(args.rows, ROWS, "row", ROWS)
    usual = _QUICK_CONTACTS if args.quick else _CONTACTS
    contacts = usual if args.contacts is None else args.contacts
    if contacts < 1 or args.jobs < 1 or args.first < 0:
        raise InputError("--contacts and --jobs must be at least 1, --first at least 0")
    parameters: dict[str, Any] = {}
    if args.parameters:
        parameters = dict(read_parameter_file(args.parameters).as_dict())
    tasks = [
        (row, change, args.first + number)
        for row in rows
        for change in CHANGES
        for number in range(contacts)
    ]
    found: dict[tuple[str, str, int], Told] = {}
    with progress("presses", len(tasks)) as advance:
        for (row, change, number), told in completed(run_press, tasks, parameters, jobs=args.jobs):
            found[row.name, change.name, number] = told
            advance()
    cells = {
        row.name: {
            change.name: [found[row.name, change.name, args.first + n] for n in range(contacts)]
            for change in CHANGES
        }
        for row in rows
    }
    figures = {
        row: {change: figures_of(told) for change, told in cell.items()}
        for row, cell in cells.items()
    }
    return Report(
        goals=_goals(figures, args.quick),
        figures={"in_time_s": _IN_TIME, "rows": figures},
        tables=[_table(rows, figures)],
        draw=lambda figure: _draw(figure, rows, cells),
    )


# A press


def press(geometry: Geometry, rate_hz: float, change: Change, number: int) -> Pressed:
    """Simulate press `number`; tissue and motion are the same for every row and change."""
    tissue, chance = (np.random.default_rng([number, purpose]) for purpose in (1, 2))
    model = FdenModel(
        linear_stiffness=math.exp(tissue.uniform(math.log(500.0), math.log(8000.0))),
        nonlinear_stiffness=tissue.uniform(6.0, 10.0),
        fractional_order=tissue.uniform(0.08, 0.32),
    )
    strain_rate = math.exp(tissue.uniform(math.log(0.1), math.log(0.5)))
    knots, hold = _knots(geometry, strain_rate)
    slide = hold + tissue.uniform(*_SLIDE_AFTER)
    stiffening, changed_at = None, math.inf
    if change.kind == "slide":
        changed_at = slide
    elif change != NOTHING:
        changed_at = next(time for knot in knots for time in knot.crossings(_MET))
    if change.kind == "inclusion":
        stiffening = Stiffening(_MET, change.ratio)
    times = np.arange(tissue.uniform() / rate_hz, knots[-1].stop, 1.0 / rate_hz)
    stress = contacts_of_moves(knots, model, stiffening).stress(times)
    if change.kind == "body":
        stress += (change.ratio - 1.0) * _beyond(knots, times, model)
    if change.kind == "slide":
        share = np.clip((times - slide) / _SLIDE_TIME, 0.0, 1.0)
        stress = stress * (1.0 + (change.ratio - 1.0) * share)
    stress = stress + chance.normal(0.0, _NOISE_PA, times.size)
    depths = geometry.depth_of_strain(_strains(knots, times))
    depths = depths + chance.normal(0.0, _NOISE_SHARE * geometry.length_m, times.size)
    return Pressed(times, stress * geometry.force_per_stress, depths, changed_at)


def _knots(geometry: Geometry, strain_rate: float) -> tuple[list[LinearMove], float]:
    """Return pause, press at a constant speed, hold and release, and when the hold begins [s]."""
    deepest = float(geometry.depth_of_strain(np.array([_DEEPEST]))[0]) / geometry.length_m
    knots = _KNOTS if geometry.kind == "sphere" else 2
    depths = np.concatenate([[-_ABOVE], np.linspace(0.0, deepest, knots)])
    # In the mean over the press as fast as a strain of so much a second.
    speed = strain_rate * deepest / _DEEPEST
    down = _PAUSE + (depths + _ABOVE) / speed
    hold = float(down[-1])
    up = hold + _HOLD + (down[-1] - down[::-1])
    strains = np.array([geometry.strain_of_depth(d * geometry.length_m) for d in depths])
    times = np.concatenate([[0.0], down, up, [up[-1] + 0.5]])
    return moves_of_knots(
        times, np.concatenate([[-_ABOVE], strains, strains[::-1], [-_ABOVE]])
    ), hold


def _beyond(knots: Sequence[LinearMove], times: Array, model: FdenModel) -> Array:
    """Return the stress [Pa] of what is loaded only beyond where the inclusion lies, (n,)."""
    ends = {knots[0].start, *(knot.stop for knot in knots)}
    ends |= {time for knot in knots for time in knot.crossings(_MET)}
    instants = np.array(sorted(ends))
    deeper = np.maximum(_strains(knots, instants), _MET)
    return np.maximum(stress_of_moves(moves_of_knots(instants, deeper), times, model), 0.0)


def _strains(knots: Sequence[LinearMove], times: Array) -> Array:
    """Return the strain at times, (n,)."""
    ends = [knots[0].start, *(knot.stop for knot in knots)]
    strains = [knots[0].start_strain, *(knot.stop_strain for knot in knots)]
    return np.interp(times, ends, strains)


def run_press(row: Row, change: Change, number: int, parameters: Mapping[str, Any]) -> Told:
    """Simulate a press, identify it, and say what was told of the change."""
    pressed = press(row.geometry, row.rate_hz, change, number)
    own = {**row.parameters, **_geometry_parameters(row.geometry), **parameters}
    told_at: list[float] = []
    flags = [Flag.NONE]
    now = 0.0

    def listen(output: Output) -> None:
        if isinstance(output, TissueState | ContactSummary):
            flags[0] = output.flags
            if output.flags & Flag.TISSUE_CHANGED:
                told_at.append(now)

    pipeline = Pipeline(pipeline_config(check(own)), listen)
    samples = (pressed.times, pressed.displacements, pressed.forces)
    for time, displacement, force in zip(*(s.tolist() for s in samples), strict=True):
        stamp, now = START_NS + round(time / _NANO), time
        pipeline.add_displacement(stamp, displacement)
        pipeline.add_force(stamp, force)
    pipeline.finish()
    delay = told_at[0] - pressed.changed_at if told_at else math.inf
    return Told(delay, delay < 0.0, bool(flags[0] & Flag.MODEL_MISMATCH))


def _geometry_parameters(geometry: Geometry) -> dict[str, Any]:
    dimensions = {
        "flat_punch": {
            "geometry.area": geometry.force_per_stress,
            "geometry.thickness": geometry.length_m,
        },
        "sphere": {"geometry.radius": geometry.length_m},
        # Its force is a stress.
        "pass_through": {"force.limit": 1e6},
    }
    return {"geometry.kind": geometry.kind, **dimensions[geometry.kind]}


# Figures


def figures_of(told: Sequence[Told]) -> dict[str, Any]:
    """Return the figures of a cell, by name."""
    delays = np.array([one.delay for one in told if not one.is_false])
    late = np.isfinite(delays) & (delays > _IN_TIME)
    return {
        "contacts": len(told),
        "in_time": sum(one.in_time for one in told),
        "late": int(late.sum()),
        "false": sum(one.is_false for one in told),
        "mismatch": sum(one.is_mismatch for one in told),
        "delays": [None if math.isinf(delay) else delay for delay in delays.tolist()],
    }


_Figures = Mapping[str, Mapping[str, Mapping[str, Any]]]


def _goals(figures: _Figures, quick: bool) -> list[Goal]:
    goals = []
    for name, cells in figures.items():
        changed = [cells[change.name] for change in CHANGES if change.kind in _WITH_GOAL]
        share = sum(c["in_time"] for c in changed) / sum(c["contacts"] for c in changed)
        goals.append(within(f"{name}: changes told within 100 ms", share, (_TOLD, 1.0)))
    every = [cell for cells in figures.values() for cell in cells.values()]
    false = sum(cell["false"] for cell in every) / sum(cell["contacts"] for cell in every)
    goals.append(within("told before a change, or without one", false, (0.0, _FALSE)))
    if quick:
        return [Goal(goal.name, goal.value, goal.goal, None) for goal in goals]
    return goals


def _table(rows: Sequence[Row], figures: _Figures) -> Table:
    from rich.box import MARKDOWN
    from rich.table import Table

    changes = [change for change in CHANGES if change is not NOTHING]
    table = Table(box=MARKDOWN, title="in time + later, of so many; - before it began")
    table.add_column("geometry, rate", no_wrap=True)
    for change in changes:
        table.add_column(f"{change.kind[:5]} {change.ratio:g}", justify="right", no_wrap=True)
    table.add_column("none", justify="right", no_wrap=True)
    for row in rows:
        cells = figures[row.name]
        nothing = cells[NOTHING.name]
        counts = [_counts(cells[change.name]) for change in changes]
        table.add_row(row.says, *counts, f"{nothing['false']} of {nothing['contacts']}")
    return table


def _counts(cell: Mapping[str, Any]) -> str:
    """Return how many were told in time, later, and too soon."""
    late = f"+{cell['late']}" if cell["late"] else ""
    false = f"-{cell['false']}" if cell["false"] else ""
    return f"{cell['in_time']}{late}{false}"


def _draw(
    figure: Figure, rows: Sequence[Row], cells: Mapping[str, Mapping[str, Sequence[Told]]]
) -> None:
    """Draw how long after its beginning each change was told, a line a cell."""
    changes = [change for change in CHANGES if change is not NOTHING]
    figure.set_size_inches(10.0, 2.0 + 0.24 * len(rows) * len(changes))
    axes = figure.subplots()
    lines = [(row, change) for row in rows for change in changes]
    places = np.arange(len(lines))[::-1]
    for place, (row, change) in zip(places, lines, strict=True):
        told = cells[row.name][change.name]
        delays = [1e3 * one.delay for one in told if math.isfinite(one.delay)]
        axes.plot(delays, np.full(len(delays), place), "|", color="#2166ac", markersize=8)
        missed = len(told) - len(delays)
        if missed:
            axes.annotate(
                f"{missed} not told",
                (0.99, place),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="center",
                fontsize=7,
                color="#b2182b",
            )
    axes.axvline(1e3 * _IN_TIME, color="0.5", linewidth=0.8)
    axes.set_yticks(
        places,
        [f"{row.says}: {change.name.replace('_', ' ')}" for row, change in lines],
        fontsize=7,
    )
    axes.set_xscale("symlog", linthresh=100.0)
    axes.set_xlabel("told after the change began [ms]; the line is the goal")
