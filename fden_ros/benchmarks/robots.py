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

"""What a real robot adds (breathing, compliance, friction, hum, ...), and what the estimate says.

Simulated presses on a disturbed rig go through the whole pipeline, with a wide prior. Bad columns
come first: *silent* is the share of presses whose summary is converged, without a warning flag,
and off by more than five stated deviations and 3 % (0.01 of alpha); *live* is the same share of
the unflagged CONVERGED states. Then root mean square of error over stated deviation, share of
contacts told as changed tissue and as mismatch, and median deviations. A second table holds what
fools the detection of contact.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fden_ros.benchmarks import Goal, Report, progress, within
from fden_ros.benchmarks.disturbed import CASES, Case, Trial, run_trial
from fden_ros.benchmarks.processes import completed
from fden_ros.benchmarks.selection import chosen
from fden_ros.core.arrays import Array
from fden_ros.core.outputs import Flag
from fden_ros.errors import InputError
from fden_ros.parameters import read_parameter_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table


EPILOG = """\
examples:
  fden benchmark robots --quick
  fden benchmark robots --cases compliance_0.5,friction_20mN --contacts 20
  fden benchmark robots --parameters config/bench.yaml --jobs 2
  fden benchmark robots --json | jq '.figures.cases[] | {name, silent, live}'

Tissue: G log-uniform from 2,000 to 8,000, Gn 6 to 10, alpha 0.08 to 0.32, 20 mm thick; a punch of
10 mm radius, so that a press to 25 % takes 0.2 to 0.9 N (20 mm where the noise is largest: moving
vibration, liver). 500 Hz, 10 mN and 5 um of noise.
"""

_NAMES = ("ln G", "ln Gn", "alpha")
_CONTACTS = 50
_QUICK_CONTACTS = 3
_QUICK = ("undisturbed", "friction_20mN", "breathing_1mm_press", "vibration_moving_100mN")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmark's own arguments."""
    parser.epilog = EPILOG
    parser.add_argument(
        "--contacts", type=int, metavar="N", help=f"presses a case (default: {_CONTACTS})"
    )
    parser.add_argument(
        "--cases", metavar="A,B", help="names of the cases (default: all; --quick: a few)"
    )
    parser.add_argument(
        "--parameters",
        type=Path,
        metavar="FILE",
        help="parameters of the identifier; geometry, messages and prior are the benchmark's own",
    )
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default: 2)")


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify and judge."""
    by_name = {case.name: case for case in CASES}
    cases = chosen(args.cases, by_name, "case", _QUICK if args.quick else by_name)
    usual = _QUICK_CONTACTS if args.quick else _CONTACTS
    contacts = usual if args.contacts is None else args.contacts
    if contacts < 1 or args.jobs < 1:
        raise InputError("--contacts and --jobs must be at least 1")
    parameters: dict[str, Any] = {}
    if args.parameters:
        parameters = dict(read_parameter_file(args.parameters).as_dict())
    rows = [measure(case, own) for case, own in _trials(cases, contacts, parameters, args.jobs)]
    estimates = [row for row in rows if not row.case.detection]
    return Report(
        goals=goals_of(rows),
        figures={"contacts": contacts, "cases": [row.json_object() for row in rows]},
        tables=[
            *([_estimate_table(estimates)] if estimates else []),
            *([_detection_table(rows)] if len(estimates) < len(rows) else []),
        ],
        draw=lambda figure: _draw(figure, rows),
    )


# Trials


def _trials(
    cases: Sequence[Case], contacts: int, parameters: Mapping[str, Any], jobs: int
) -> list[tuple[Case, list[Trial]]]:
    """Return the trials of each case, in order, whatever the number of processes."""
    tasks = [
        (case, number)
        for case in cases
        for number in range(math.ceil(contacts / case.press_count))
    ]
    done: dict[tuple[str, int], Trial] = {}
    with progress("recordings", len(tasks)) as advance:
        for (case, number), trial in completed(run_trial, tasks, parameters, jobs=jobs):
            done[case.name, number] = trial
            advance()
    return [
        (case, [done[own.name, number] for own, number in tasks if own is case]) for case in cases
    ]


# Figures


@dataclass(frozen=True)
class Row:
    """The figures of one case; shares from 0 to 1, NaN where there is nothing to measure.

    Parameters
    ----------
    presses, silent_count, claims, wrong_claims : int
        Behind `silent` and `live`.
    rms : Array
        Root mean square of error over stated deviation of (ln G, ln Gn, alpha), shape (3,).
    squares : Array
        The squares behind it, shape (n, 3).
    changed, mismatch, converged : float
        Shares of the contacts in presses.
    fine_mismatch : float
        Share of the contacts that are told as mismatch although the numbers are fine.
    median_error, deviation, held : Array
        Medians of absolute errors, of stated deviations in summaries, and of those at the end of
        the hold, shape (3,).
    invented, missed, clear, stuck : int
        Contacts where there was none; presses without one, among those that stand out from the
        noise; how many these are; samples dropped as stuck.
    last_off : float
        Share of the recordings whose last press is off, silent or not, or has no estimate.
    narrowing : float
        Median deviation of ln Gn at the last site over that at the first.
    """

    case: Case
    presses: int
    silent_count: int
    claims: int
    wrong_claims: int
    squares: Array
    changed: float
    mismatch: float
    fine_mismatch: float
    converged: float
    median_error: Array
    deviation: Array
    held: Array
    invented: int
    missed: int
    clear: int
    stuck: int
    last_off: float
    narrowing: float

    @property
    def silent(self) -> float:
        """Share of the presses."""
        return _share(self.silent_count, self.presses)

    @property
    def live(self) -> float:
        """Share of the unflagged CONVERGED states."""
        return _share(self.wrong_claims, self.claims)

    @property
    def rms(self) -> Array:
        """See above."""
        return _root_mean(self.squares)

    def json_object(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        scalars = (
            *("presses", "silent", "live", "changed", "mismatch", "fine_mismatch", "converged"),
            *("invented", "missed", "clear", "stuck", "last_off", "narrowing", "claims"),
        )
        vectors = ("rms", "median_error", "deviation", "held")
        return (
            {"name": self.case.name, "says": self.case.says}
            | {name: getattr(self, name) for name in scalars}
            | {
                name: dict(zip(_NAMES, getattr(self, name).tolist(), strict=True))
                for name in vectors
            }
        )


def measure(case: Case, trials: Sequence[Trial]) -> Row:
    """Return the figures of a case over all of its recordings."""
    pressed = [c for t in trials for c in t.contacts if c.number >= 0]
    known = [c for c in pressed if c.has_estimate]
    error = np.array([c.error for c in known]).reshape(-1, 3)
    deviation = np.array([c.deviation for c in known]).reshape(-1, 3)
    firsts = [c.deviation for c in known if c.number == 0]
    lasts = [
        c.deviation for t in trials for c in t.contacts if c.number == t.presses - 1 and t.presses
    ]
    mismatched = [bool(c.flags & Flag.MODEL_MISMATCH) for c in pressed]
    return Row(
        case=case,
        presses=sum(t.presses for t in trials),
        silent_count=sum(c.is_silent for t in trials for c in t.contacts),
        claims=sum(t.claims for t in trials),
        wrong_claims=sum(t.wrong_claims for t in trials),
        squares=(error / np.maximum(deviation, 1e-12)) ** 2,
        changed=_mean([bool(c.flags & Flag.TISSUE_CHANGED) for c in pressed]),
        mismatch=_mean(mismatched),
        fine_mismatch=_mean(
            [m and not c.is_off for m, c in zip(mismatched, pressed, strict=True)]
        ),
        converged=_mean([c.converged for c in pressed]),
        median_error=_median(np.abs(error)),
        deviation=_median(deviation),
        held=_median(np.array([t.held for t in trials])),
        invented=sum(c.number < 0 for t in trials for c in t.contacts),
        missed=sum(t.clear_missed for t in trials),
        clear=sum(t.clear for t in trials),
        stuck=sum(t.stuck for t in trials),
        last_off=_mean([not _is_last_right(trial) for trial in trials]),
        narrowing=float(
            _median(np.reshape(lasts, (-1, 3)))[1] / _median(np.reshape(firsts, (-1, 3)))[1]
        ),
    )


def _is_last_right(trial: Trial) -> bool:
    last = [contact for contact in trial.contacts if contact.number == trial.presses - 1]
    return any(contact.has_estimate and not contact.is_off for contact in last)


def _share(part: int, whole: int) -> float:
    return part / whole if whole else math.nan


def _mean(values: Sequence[bool]) -> float:
    return float(np.mean(values)) if values else math.nan


def _median(values: Array) -> Array:
    finite = values[np.all(np.isfinite(values), axis=1)]
    return np.median(finite, axis=0) if finite.size else np.full(3, np.nan)


def _root_mean(squares: Array) -> Array:
    return np.sqrt(squares.mean(axis=0)) if squares.size else np.full(3, np.nan)


# Goals


def goals_of(rows: Sequence[Row]) -> list[Goal]:
    """Hold the rows against the goals."""
    upper = [row for row in rows if not row.case.detection]
    lower = [row for row in rows if row.case.detection]
    expected = [row for row in upper if not row.case.beyond]
    silent = [(row.silent_count, row.presses) for row in upper]
    live = [(row.wrong_claims, row.claims) for row in upper]
    goals = [
        _pooled("silent: presses converged, unflagged and off", silent, 0.01),
        _worst("silent: worst row", upper, lambda row: row.silent, 0.01),
        _pooled("live: unflagged CONVERGED states that are off", live, 0.02, decides=True),
        _worst("told as changed tissue: worst expected row", expected, lambda r: r.changed, 0.02),
    ]
    squares = np.concatenate([row.squares for row in expected]) if expected else np.empty((0, 3))
    goals += [
        within(f"root mean square of error over deviation, {name}", value, (0.6, 1.4))
        for name, value in zip(_NAMES, _root_mean(squares), strict=True)
    ]
    sharp = next((row for row in rows if row.case.reference), None)
    for label, key, limits in (
        ("after the hold", "held", (0.07, 0.055, 0.03)),
        ("after release", "deviation", (0.055, 0.045, 0.02)),
    ):
        values = getattr(sharp, key) if sharp else np.full(3, np.nan)
        goals += [
            within(f"undisturbed, deviation of {name} {label}", value, (-math.inf, limit))
            for name, value, limit in zip(_NAMES, values, limits, strict=True)
        ]
    by_name = {row.case.name: row for row in rows}
    rig, preload = by_name.get("ten_sites"), by_name.get("preload_2mm")
    goals += [
        within(
            "ten sites: deviation of ln Gn at the tenth over the first",
            rig.narrowing if rig else math.nan,
            (-math.inf, 0.5),
        ),
        within(
            "preload: share of the next touches that are off or lost",
            preload.last_off if preload else math.nan,
            (-math.inf, 0.0),
        ),
        _worst("contacts invented: worst row", lower, lambda row: row.invented, 0.0),
        _worst("clear presses missed: worst row", lower, lambda row: row.missed, 0.0),
        _worst("samples dropped as stuck: worst row", lower, lambda row: row.stuck, 0.0),
        _worst("fine, but told as mismatch: worst row", lower, lambda r: r.fine_mismatch, 0.02),
        _worst(
            "3 mm grid: told as changed tissue",
            [row for row in lower if row.case.pitch_m],
            lambda row: row.changed,
            0.0,
        ),
    ]
    return goals


def _pooled(
    name: str, counts: Sequence[tuple[int, int]], limit: float, *, decides: bool = False
) -> Goal:
    """Return the goal of a share of all; `decides`: by itself, not by its interval."""
    part, whole = (sum(column) for column in zip(*counts, strict=True)) if counts else (0, 0)
    share = _share(part, whole)
    interval = None if decides or not whole else _interval(part, whole)
    return within(name, share, (-math.inf, limit), interval)


def _interval(part: int, whole: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Clopper and Pearson 1934)."""
    from scipy.stats import binomtest

    found = binomtest(part, whole).proportion_ci(0.95)
    return float(found.low), float(found.high)


def _worst(name: str, rows: Sequence[Row], value: Any, limit: float) -> Goal:
    values = [float(value(row)) for row in rows]
    largest = max((v for v in values if math.isfinite(v)), default=math.nan)
    return within(name, largest, (-math.inf, limit))


# Tables


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100.0 * share:.0f} %"


def _three(values: Array) -> str:
    return " ".join("-" if math.isnan(v) else _short(v) for v in values)


def _short(value: float) -> str:
    text = f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"
    return text[1:] if text.startswith("0.") else text


def _table(title: str, headings: Sequence[str]) -> Table:
    """Return an empty table that can be pasted into a page."""
    from rich.box import MARKDOWN
    from rich.table import Table

    table = Table(title=title, box=MARKDOWN)
    table.add_column("condition", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _estimate_table(rows: Sequence[Row]) -> Table:
    table = _table(
        "Estimates on a disturbed rig (three figures: ln G, ln Gn, alpha; sd: stated deviation)",
        ("silent", "live", "rms error/sd", "changed", "mismatch", "conv.", "sd"),
    )
    for row in rows:
        table.add_row(
            row.case.says,
            f"{row.silent_count} of {row.presses}",
            _percent(row.live),
            _three(row.rms),
            _percent(row.changed),
            _percent(row.mismatch),
            _percent(row.converged),
            _three(row.deviation),
        )
    return table


def _detection_table(rows: Sequence[Row]) -> Table:
    table = _table(
        "Contact on a disturbed rig (missed: of clear presses; mismatch: though fine)",
        (
            "invented",
            "missed",
            "stuck",
            "mismatch",
            "silent",
            "live",
            "changed",
            "conv.",
            "rms error/sd",
        ),
    )
    for row in rows:
        if not row.case.detection:
            continue
        table.add_row(
            row.case.says,
            f"{row.invented} in {row.presses}",
            f"{row.missed} of {row.clear}",
            str(row.stuck),
            _percent(row.fine_mismatch),
            f"{row.silent_count} of {row.presses}",
            _percent(row.live),
            _percent(row.changed),
            _percent(row.converged),
            _three(row.rms),
        )
    return table


def _draw(figure: Figure, rows: Sequence[Row]) -> None:
    """Draw shares that are wrong, and errors over deviations, a line a case."""
    figure.set_size_inches(12.0, 2.0 + 0.32 * len(rows))
    shares, ratios = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(rows))[::-1]
    shares.barh(places + 0.2, [row.silent for row in rows], 0.38, label="silent", color="#b2182b")
    shares.barh(places - 0.2, [row.live for row in rows], 0.38, label="live", color="#f4a582")
    shares.set_yticks(places, [row.case.says for row in rows])
    shares.set_xlim(0.0, 1.0)
    shares.set_xlabel("converged, unflagged, and off")
    shares.legend()
    for index, (name, marker) in enumerate(zip(_NAMES, "os^", strict=True)):
        ratios.plot([row.rms[index] for row in rows], places, marker, label=name)
    ratios.axvspan(0.6, 1.4, color="0.9")
    ratios.set_xscale("log")
    ratios.set_xlabel("root mean square of error over stated deviation")
    ratios.legend()
