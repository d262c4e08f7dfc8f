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

"""Detection of contact alone, on a disturbed rig: contacts invented, lost and split.

Simulated approaches, three to a recording, go through synchronizer and detector, without any
estimate. The punch is so wide that the undisturbed press takes just ten times the largest noise,
unless ``--ratio`` says otherwise. *Split* counts further contacts within a press; *off* those
whose surface lies beyond five stated deviations, as the estimator takes them, and 0.1 mm.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fden_ros.benchmarks import Goal, Report, progress, within
from fden_ros.benchmarks.disturbed import CASES, Case, presses_of, scenario_of, streams_of
from fden_ros.benchmarks.processes import completed
from fden_ros.benchmarks.selection import chosen
from fden_ros.core.contact.detector import ContactDetector, Onset, Release
from fden_ros.core.site import ORIGIN_WIDENING
from fden_ros.core.streams.samples import NANOSECONDS, Pair
from fden_ros.core.streams.synchronize import Synchronizer
from fden_ros.errors import InputError
from fden_ros.parameters import check, pipeline_config, read_parameter_file
from fden_ros.simulation.disturbance import Disturbances
from fden_ros.simulation.scenario import Scenario
from fden_ros.simulation.simulate import START_NS, simulate
from fden_ros.simulation.trajectory import Ramp

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table


EPILOG = """\
examples:
  fden benchmark contact                          # 200 approaches a row, two minutes
  fden benchmark contact --quick
  fden benchmark contact --ratio 5 --cases hum_20mN,liver_white_20mN

Rows are those of `fden benchmark robots`, pressed to 25 % in 1.25 s and let go.
"""

_APPROACHES, _QUICK_APPROACHES = 200, 9
#: Approaches in a recording.
_SITES = 3
#: A contact within this of a press [s] is the press's.
_SLACK = 0.05
#: A surface is off beyond this many of the deviations that the estimator takes, and this [m].
_DEVIATIONS, _LEAST_ERROR = 5.0, 1e-4
_NANO = 1e-9

_UNDISTURBED = Case("undisturbed", "nothing")
#: Cases of `disturbed` by what is added here: slower and faster vibrations of the moving arm.
ROWS = {
    case.name: case
    for case in (
        _UNDISTURBED,
        *(case for case in CASES if case.detection and not case.pitch_m),
        *(
            Case(
                f"vibration_moving_{rate}Hz",
                f"{rate} Hz, 50 mN, moving",
                disturbances=Disturbances(vibration_n=0.05, vibration_hz=float(rate)),
            )
            for rate in (5, 8, 20, 35)
        ),
        Case(
            "filter_10Hz_white",
            "low-pass 10 Hz, white 100 mN",
            disturbances=Disturbances(filter_hz=10.0),
            noise_n=0.1,
        ),
        Case("creep_50mN", "creep 50 mN", disturbances=Disturbances(creep_n=0.05)),
        Case("thermal_100mN", "thermal 0.1 N, 20 s", disturbances=Disturbances(thermal_n=0.1)),
    )
}


class Approached(NamedTuple):
    """What was found in one recording."""

    presses: int
    invented: int  #: contacts where there was none
    missed: int  #: presses without a contact
    split: int  #: contacts in a press beyond its first
    stuck: int  #: samples dropped as stuck
    spikes: int  #: samples dropped as spikes
    unseen: int  #: contacts in presses whose surface was not seen
    delays: tuple[float, ...]  #: from the touch to the first contact of a press [s]
    surfaces: tuple[float, ...]  #: error of the surface over its deviation
    off: int  #: of these, beyond five and 0.1 mm


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmark's own arguments."""
    parser.epilog = EPILOG
    parser.add_argument(
        "--approaches", type=int, metavar="N", help=f"a row (default: {_APPROACHES})"
    )
    parser.add_argument("--cases", metavar="A,B", help="names of the rows (default: all)")
    parser.add_argument(
        "--ratio",
        type=float,
        default=10.0,
        metavar="R",
        help="largest force of a press over the largest noise (default: 10)",
    )
    parser.add_argument("--parameters", type=Path, metavar="FILE", help="of the identifier")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default: 2)")


def run(args: argparse.Namespace) -> Report:
    """Simulate, detect and judge."""
    rows = chosen(args.cases, ROWS, "case", ROWS)
    usual = _QUICK_APPROACHES if args.quick else _APPROACHES
    approaches = usual if args.approaches is None else args.approaches
    if approaches < 1 or args.jobs < 1:
        raise InputError("--approaches and --jobs must be at least 1")
    if not (math.isfinite(args.ratio) and args.ratio > 0.0):
        raise InputError(f"--ratio is {args.ratio}; it must be positive")
    parameters: dict[str, Any] = {}
    if args.parameters:
        parameters = dict(read_parameter_file(args.parameters).as_dict())
    tasks = [
        (case, number, args.ratio)
        for case in rows
        for number in range(math.ceil(approaches / _SITES))
    ]
    found: dict[tuple[str, int], Approached] = {}
    with progress("recordings", len(tasks)) as advance:
        for (case, number, _), trial in completed(
            run_approaches, tasks, parameters, jobs=args.jobs
        ):
            found[case.name, number] = trial
            advance()
    trials = {
        case.name: [found[case.name, number] for own, number, _ in tasks if own is case]
        for case in rows
    }
    figures = {case.name: figures_of(trials[case.name]) for case in rows}
    return Report(
        goals=_goals(figures, args.ratio),
        figures={"ratio": args.ratio, "cases": figures},
        tables=[_table(rows, figures)],
        draw=lambda figure: _draw(figure, rows, trials),
    )


# Trials


def run_approaches(
    case: Case, number: int, ratio: float, parameters: Mapping[str, Any]
) -> Approached:
    """Simulate recording `number` of a case, look for contacts, and judge them."""
    scenario = approaches_of(case, number, ratio)
    recording = simulate(scenario)
    own = dict(recording.truth["identifier_parameters"])
    own.pop("displacement.delay", None)
    config = pipeline_config(check({**parameters, **own}))
    detector = ContactDetector(config.contact, config.estimator.prior.fractional_order)
    rejected: Counter[str] = Counter()
    found: list[tuple[float, Onset]] = []
    ends: list[float] = []

    def detect(pair: Pair) -> None:
        event = detector.add(pair)
        now = (pair.stamp_ns - START_NS) * _NANO
        if isinstance(event, Onset):
            found.append((now, event))
        elif isinstance(event, Release):
            ends.append(now)

    synchronizer = Synchronizer(config.synchronize, detect, rejected)
    for is_force, stamp_ns, value, place in streams_of(recording):
        if is_force:
            synchronizer.add_force(stamp_ns, value)
        else:
            synchronizer.add_displacement(stamp_ns, value, place)
    ends.append(math.inf)
    return _judged(
        presses_of(recording), found, ends, rejected, recording.truth["surface_displacement_m"]
    )


def approaches_of(case: Case, number: int, ratio: float) -> Scenario:
    """Return three approaches whose presses take `ratio` times the largest noise."""
    press = Ramp(0.2, 0.25, 0.4)
    scenario = scenario_of(replace(case, presses=(press,), sites=_SITES), number)
    quiet = replace(
        scenario,
        sites=scenario.sites[:1],
        disturbances=Disturbances(),
        force=replace(scenario.force, noise_n=0.0),
    )
    peak = float(simulate(quiet).force.value.max())
    geometry = scenario.geometry
    assert geometry.radius_m is not None
    radius = geometry.radius_m * math.sqrt(ratio * case.largest_noise_n / peak)
    return replace(scenario, geometry=replace(geometry, radius_m=radius))


def _judged(
    presses: Sequence[tuple[float, float]],
    found: Sequence[tuple[float, Onset]],
    ends: Sequence[float],
    rejected: Counter[str],
    surface: float,
) -> Approached:
    hits: Counter[int] = Counter()
    delays, surfaces = [], []
    invented = unseen = off = 0
    for (now, onset), end in zip(found, ends, strict=False):
        start = (onset.samples[0].stamp_ns - START_NS) / NANOSECONDS
        number = next(
            (
                n
                for n, (touch, release) in enumerate(presses)
                if start < release + _SLACK and end > touch - _SLACK and now > touch
            ),
            None,
        )
        if number is None:
            invented += 1
            continue
        hits[number] += 1
        if hits[number] > 1:
            continue
        delays.append(now - presses[number][0])
        if not onset.seen:
            unseen += 1
            continue
        error = onset.displacement - surface
        deviation = ORIGIN_WIDENING * onset.displacement_sd
        surfaces.append(error / deviation)
        off += abs(error) > max(_DEVIATIONS * deviation, _LEAST_ERROR)
    return Approached(
        presses=len(presses),
        invented=invented,
        missed=len(presses) - len(hits),
        split=sum(hits.values()) - len(hits),
        stuck=rejected["force.stuck"],
        spikes=rejected["force.spike"] + rejected["displacement.spike"],
        unseen=unseen,
        delays=tuple(delays),
        surfaces=tuple(surfaces),
        off=off,
    )


# Figures


def figures_of(trials: Sequence[Approached]) -> dict[str, Any]:
    """Return the figures of a row, by name."""
    delays = np.array([delay for trial in trials for delay in trial.delays])
    surfaces = np.array([ratio for trial in trials for ratio in trial.surfaces])
    counted = ("presses", "invented", "missed", "split", "stuck", "spikes", "unseen", "off")
    return {name: sum(getattr(trial, name) for trial in trials) for name in counted} | {
        "delay": float(np.median(delays)) if delays.size else math.nan,
        "longest_delay": float(delays.max()) if delays.size else math.nan,
        "surface_rms": float(np.sqrt(np.mean(surfaces**2))) if surfaces.size else math.nan,
    }


def _goals(figures: Mapping[str, Mapping[str, Any]], ratio: float) -> list[Goal]:
    counted = {
        "contacts invented": "invented",
        "presses missed": "missed",
        "presses split": "split",
        "samples dropped as stuck": "stuck",
    }
    return [
        within(
            f"{words}, {ratio:g} times the noise: worst row",
            max(row[name] for row in figures.values()),
            (-math.inf, 0.0),
        )
        for words, name in counted.items()
    ]


def _table(rows: Sequence[Case], figures: Mapping[str, Mapping[str, Any]]) -> Table:
    from rich.box import MARKDOWN
    from rich.table import Table

    headings = ("presses", "invented", "missed", "split", "stuck", "spikes", "unseen", "off")
    table = Table(box=MARKDOWN)
    table.add_column("condition", no_wrap=True)
    for heading in (*headings, "delay [ms]", "surface/sd"):
        table.add_column(heading, justify="right", no_wrap=True)
    for case in rows:
        row = figures[case.name]
        table.add_row(
            case.says,
            *(str(row[name]) for name in headings),
            f"{1e3 * row['delay']:.0f} to {1e3 * row['longest_delay']:.0f}",
            f"{row['surface_rms']:.2g}",
        )
    return table


def _draw(
    figure: Figure, rows: Sequence[Case], trials: Mapping[str, Sequence[Approached]]
) -> None:
    """Draw how long after the touch each contact was found, a line a row."""
    figure.set_size_inches(9.0, 2.0 + 0.32 * len(rows))
    axes = figure.subplots()
    places = np.arange(len(rows))[::-1]
    for place, case in zip(places, rows, strict=True):
        delays = [1e3 * delay for trial in trials[case.name] for delay in trial.delays]
        axes.plot(delays, np.full(len(delays), place), "|", color="#2166ac")
    axes.set_yticks(places, [case.says for case in rows])
    axes.set_xlabel("found after the touch [ms]")
