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

"""Tissue that does not obey the law: how often the next force lies in the predicted interval.

Poroelastic and linear solids, other relaxations, other stress-strain curves, and tissue that wears
from press to press are simulated apart from the identifier. A listener, as in a controller, hears
the states, and predicts the force of the motion of the next 3 s at four moments of each press:
three fifths of the way on the ramp, at its end, half way through the hold and 3 s before its end.
What is converged without a warning flag is predicted and counts: the share of the samples in the
95 % interval, and its half width in percent of the peak; the others are refused.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fden_ros.benchmarks import Goal, Report, progress, within
from fden_ros.benchmarks.law_presses import (
    ARM,
    CASES,
    MOMENTS,
    RIGID,
    Case,
    Predicted,
    Trial,
    run_trial,
)
from fden_ros.benchmarks.processes import completed
from fden_ros.benchmarks.selection import chosen
from fden_ros.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

EPILOG = """\
examples:
  fden benchmark laws --quick
  fden benchmark laws --laws poroelastic_2,linear_solid_1 --seeds 24
  fden benchmark laws --json | jq '.figures.rows[] | {law, rig, inside, refused}'

G log-uniform from 500 to 8,000 Pa, Gn 6 to 10, alpha 0.08 to 0.32 where a law has them. A punch of
10 mm radius on 20 mm of tissue, pressed to 25 % at 0.1 to 0.5/s and held for 8 to 12 s, 50 Hz,
noise of 0.1 % of the peak; three presses of one place where the tissue wears. Wide priors, the
law's error at its default; the rig's deviations 0 (testing machine) or an arm's defaults.
"""

_SEEDS, _QUICK_SEEDS = 12, 1
_BY_NAME = {case.name: case for case in CASES}
_QUICK = ("poroelastic_2", "linear_solid_1", "cubic", "fden")
_LEAST_INSIDE = 0.9


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmark's own arguments."""
    parser.epilog = EPILOG
    parser.add_argument(
        "--seeds", type=int, metavar="N", help=f"recordings each (default: {_SEEDS})"
    )
    parser.add_argument(
        "--first", type=int, default=0, metavar="SEED", help="the first of them (default: 0)"
    )
    parser.add_argument(
        "--laws", metavar="A,B", help="names of the laws (default: all; --quick: a few)"
    )
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default: 2)")


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify, predict and judge."""
    cases = chosen(args.laws, _BY_NAME, "law", _QUICK if args.quick else _BY_NAME)
    usual = _QUICK_SEEDS if args.quick else _SEEDS
    seeds = usual if args.seeds is None else args.seeds
    if seeds < 1 or args.jobs < 1 or args.first < 0:
        raise InputError("--seeds and --jobs must be at least 1, --first not negative")
    rigs = (RIGID,) if args.quick else (RIGID, ARM)
    tasks = [
        (case.name, number, rig)
        for rig in rigs
        for case in cases
        for number in range(args.first, args.first + seeds)
    ]
    done: dict[_Task, Trial] = {}
    with progress("recordings", len(tasks)) as advance:
        for task, trial in completed(_run_task, tasks, jobs=args.jobs):
            done[task] = trial
            advance()
    rows = [
        measure(case, rig, [done[task] for task in tasks if task[0::2] == (case.name, rig)])
        for rig in rigs
        for case in cases
    ]
    return Report(
        goals=goals_of(rows),
        figures={"seeds": seeds, "rows": [row.json_object() for row in rows]},
        tables=[_table(rig, [row for row in rows if row.rig == rig]) for rig in rigs],
        draw=lambda figure: _draw(figure, rows),
    )


_Task = tuple[str, int, str]


def _run_task(name: str, number: int, rig: str) -> Trial:
    # A law is a function, which no process can be sent: its name is.
    return run_trial(_BY_NAME[name], number, rig)


# Figures


@dataclass(frozen=True)
class Row:
    """The figures of one law on one rig; shares from 0 to 1, NaN where nothing is predicted.

    Parameters
    ----------
    case, rig
    moments, predicted : int
        Of all recordings, and of these the ones that are converged and unflagged.
    inside : float
        Share of the samples of the next 3 s in the 95 % interval.
    inside_at : mapping
        The same by the moment.
    half_width, error : float
        Medians, share of the peak.
    contacts, mismatch, changed : int
        Of all recordings; of these, told so in the summary.
    """

    case: Case
    rig: str
    moments: int
    predicted: int
    inside: float
    inside_at: dict[str, float]
    half_width: float
    error: float
    contacts: int
    mismatch: int
    changed: int

    @property
    def refused(self) -> float:
        """Share of the moments that are flagged or not converged."""
        return 1.0 - self.predicted / self.moments

    def json_object(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        names = (
            *("rig", "moments", "predicted", "inside", "inside_at", "half_width", "error"),
            *("refused", "contacts", "mismatch", "changed"),
        )
        return {"law": self.case.name, "says": self.case.says} | {
            name: getattr(self, name) for name in names
        }


def measure(case: Case, rig: str, trials: Sequence[Trial]) -> Row:
    """Return the figures of a law over all of its recordings."""
    moments = [prediction for trial in trials for prediction in trial.predictions]
    used = [prediction for prediction in moments if not prediction.refusal]
    return Row(
        case=case,
        rig=rig,
        moments=len(moments),
        predicted=len(used),
        inside=_mean_inside(used),
        inside_at={name: _mean_inside([p for p in used if p.moment == name]) for name in MOMENTS},
        half_width=float(np.median([p.half_width for p in used])) if used else math.nan,
        error=float(np.median([p.error for p in used])) if used else math.nan,
        contacts=sum(trial.contacts for trial in trials),
        mismatch=sum(trial.mismatch for trial in trials),
        changed=sum(trial.changed for trial in trials),
    )


def _mean_inside(predictions: Sequence[Predicted]) -> float:
    return float(np.mean([p.inside for p in predictions])) if predictions else math.nan


def goals_of(rows: Sequence[Row]) -> list[Goal]:
    """Hold each law against the goal."""
    return [
        within(
            f"in the 95 % interval: {row.case.says}, {row.rig}",
            row.inside,
            (_LEAST_INSIDE, math.inf),
        )
        for row in rows
    ]


# Tables


def _percent(share: float) -> str:
    return "–" if math.isnan(share) else f"{100.0 * share:.3g} %"


def _table(rig: str, rows: Sequence[Row]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title=f"Other laws, {rig}", box=box.MARKDOWN, padding=(0, 1))
    table.add_column("")
    headings = (
        *("in the interval", "worst moment", "half width", "error", "refused"),
        *("mismatch", "changed"),
    )
    for heading in headings:
        table.add_column(heading, justify="right")
    for row in rows:
        known = {name: share for name, share in row.inside_at.items() if math.isfinite(share)}
        worst = min(known, key=lambda name: known[name]) if known else None
        table.add_row(
            row.case.says,
            _percent(row.inside),
            f"{_percent(known[worst])}, {worst}" if worst else "–",
            _percent(row.half_width),
            _percent(row.error),
            f"{row.moments - row.predicted} of {row.moments}",
            f"{row.mismatch} of {row.contacts}",
            f"{row.changed} of {row.contacts}",
        )
    return table


def _draw(figure: Figure, rows: Sequence[Row]) -> None:
    """Draw a line a law: how often the interval holds, how wide it is, how much is refused."""
    names = [row.case.says for row in rows if row.rig == rows[0].rig]
    figure.set_size_inches(13, 2.0 + 0.4 * len(names))
    axes = figure.subplots(1, 3, sharey=True)
    for shift, rig in enumerate(dict.fromkeys(row.rig for row in rows)):
        own = [row for row in rows if row.rig == rig]
        places = [index + 0.3 * shift for index in range(len(own))]
        for panel, key in zip(axes, ("inside", "half_width", "refused"), strict=True):
            panel.barh(places, [100.0 * getattr(row, key) for row in own], 0.3, label=rig)
    axes[0].set_yticks(range(len(names)), names)
    axes[0].invert_yaxis()
    axes[0].axvline(100.0 * _LEAST_INSIDE, color="0.5", linestyle="--")
    axes[0].set_xlabel("in the 95 % interval [%]")
    axes[1].set_xlabel("half width [% of the peak]")
    axes[2].set_xlabel("flagged or not converged [%]")
    axes[2].legend()
