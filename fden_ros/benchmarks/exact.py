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

"""Contacts on tissue that obeys the law exactly, over all of its range: what is told, and wrong.

Tissue, motion, rate, noise and prior are drawn (see below), simulated apart from the identifier,
and identified with the noise as it is measured in the air; the rig's deviations are 0 and an arm's
defaults in turn. A *false alarm* is a contact whose summary tells a mismatch or a change; *live*
is one that any state tells. *Silent* is a contact that is converged, without a warning flag, and
off by more than five stated deviations and 3 % (0.01 of alpha).
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fden_ros.benchmarks import TWO_SIDED_95, Goal, Report, progress, within
from fden_ros.benchmarks.exact_contacts import ARM, LARGEST_SAMPLES, MOTIONS, RIGID, Finding, find
from fden_ros.benchmarks.processes import completed
from fden_ros.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

Array = NDArray[np.float64]

EPILOG = """\
examples:
  fden benchmark exact --quick
  fden benchmark exact --first 3000 --contacts 500 --jobs 2
  fden benchmark exact --contacts 3000 --resume -o results      go on with what is in results
  fden benchmark exact --json | jq '.figures.alarms[]'

Drawn log-uniform: G 20 to 50,000, Gn 1 to 40, noise 3 to 300 Pa, 30 Hz to 1 kHz, holds of 0.1 to
600 s, strain rates of 0.02 to 1/s; alpha uniform from 0.02 to 0.6; ramps, staircases, ramps with a
hold, three presses of one place. A press goes to a Gn x of 0.7 to 6, at most to half of the
thickness, takes 20 times the noise or more and at most 63 N; what does not is drawn anew. Half of
the priors are the default one, the others up to two of their deviations off; every other contact
has 1 um of noise in the displacement. Linear part hidden: G/Gn, about the stress at the boundary
strain, is below the noise of a sample.
"""

_CONTACTS, _QUICK_CONTACTS, _QUICK_SAMPLES = 3000, 16, 1500
_NAMES = ("ln G", "ln Gn", "alpha")
#: False alarms and silent errors that are allowed, as a share.
_ALLOWED = 1e-3
_CONFIDENCE = 0.95
#: Where the rows of a table are cut.
_HOLDS_S = (0.0, 0.05, 10.0, 100.0, math.inf)
_RATES_HZ = (0.0, 100.0, 300.0, math.inf)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmark's own arguments."""
    parser.epilog = EPILOG
    parser.add_argument(
        "--contacts", type=int, metavar="N", help=f"how many (default: {_CONTACTS})"
    )
    parser.add_argument(
        "--first", type=int, default=0, metavar="SEED", help="the first of them (default: 0)"
    )
    parser.add_argument(
        "--samples",
        type=int,
        metavar="N",
        help="largest number of samples of a contact, down to 30 Hz: a long hold is sampled "
        f"slowly (default: {LARGEST_SAMPLES})",
    )
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default: 2)")
    parser.add_argument(
        "--resume",
        action="store_true",
        help="contacts in DIR/exact.jsonl are not measured again",
    )


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify and judge."""
    usual = _QUICK_CONTACTS if args.quick else _CONTACTS
    contacts = usual if args.contacts is None else args.contacts
    if contacts < 1 or args.jobs < 1 or args.first < 0:
        raise InputError("--contacts and --jobs must be at least 1, --first not negative")
    samples = args.samples or (_QUICK_SAMPLES if args.quick else LARGEST_SAMPLES)
    numbers = range(args.first, args.first + contacts)
    path = args.output / "exact.jsonl"
    done = {
        finding.number: finding
        for finding in (read_findings(path) if args.resume and path.is_file() else [])
        if finding.largest_samples == samples and finding.number in numbers
    }
    left = [number for number in numbers if number not in done]
    with (
        path.open("w", encoding="utf-8") as file,
        progress("contacts", len(left)) as advance,
    ):
        for finding in done.values():
            _write(file.write, finding)
        for _, finding in completed(find, [(number,) for number in left], samples, jobs=args.jobs):
            done[finding.number] = finding
            _write(file.write, finding)
            file.flush()
            advance()
    return report_of([done[number] for number in numbers])


def read_findings(path: Path) -> list[Finding]:
    """Return what an earlier run has written; its last line may be cut short.

    Raises
    ------
    InputError
        If another line is not a finding.
    """
    lines = path.read_text(encoding="utf-8").splitlines()
    findings = []
    for number, line in enumerate(lines, start=1):
        try:
            findings.append(Finding(**json.loads(line)))
        except (ValueError, TypeError) as error:
            if number < len(lines):
                raise InputError(
                    f"{path}: line {number} is not a contact of this benchmark"
                ) from error
    return findings


def _write(write: Callable[[str], Any], finding: Finding) -> None:
    write(json.dumps(finding.json_object()) + "\n")


# Figures


def report_of(findings: Sequence[Finding]) -> Report:
    """Return goals, figures and tables of what was found."""
    rows = {name: figures_of(some) for name, some in _groups(findings) if some}
    alarms = [f for f in findings if f.told or f.told_live or f.silent or f.wrong_claims]
    return Report(
        goals=goals_of(findings),
        figures={
            "contacts": len(findings),
            "rows": rows,
            "alarms": [finding.json_object() for finding in alarms],
        },
        tables=[_table(rows), *([_alarm_table(alarms)] if alarms else [])],
        draw=lambda figure: _draw(figure, findings),
    )


def _groups(findings: Sequence[Finding]) -> Iterator[tuple[str, list[Finding]]]:
    def some(name: str, belongs: Callable[[Finding], bool]) -> tuple[str, list[Finding]]:
        return name, [finding for finding in findings if belongs(finding)]

    def between(key: str, low: float, high: float) -> Callable[[Finding], bool]:
        return lambda finding: low <= finding.drawn[key] < high

    yield "all", list(findings)
    for rig in (RIGID, ARM):
        yield some(rig, lambda finding, rig=rig: finding.rig == rig)  # type: ignore[misc]
    for motion in MOTIONS:
        yield some(
            motion.replace("_", ", "),
            lambda finding, motion=motion: finding.drawn["motion"] == motion,  # type: ignore[misc]
        )
    for low, high in itertools.pairwise(_HOLDS_S[1:]):
        yield some(f"held for {_range(low, high)} s", between("hold_s", low, high))
    for hidden in (True, False):
        yield some(
            f"linear part {'hidden' if hidden else 'seen'}",
            lambda finding, hidden=hidden: _is_hidden(finding) == hidden,  # type: ignore[misc]
        )
    for low, high in itertools.pairwise(_RATES_HZ):
        yield some(f"{_range(low, high)} Hz", between("rate_hz", low, high))


def _is_hidden(finding: Finding) -> bool:
    """Whether the stress at the boundary strain, about G/Gn, is below the noise of a sample."""
    own = finding.drawn
    stress = float(own["linear_stiffness"]) / float(own["nonlinear_stiffness"])
    return stress < float(own["noise_pa"])


def _range(low: float, high: float) -> str:
    if low < 0.1:
        return f"to {high:g}"
    return f"from {low:g}" if math.isinf(high) else f"{low:g} to {high:g}"


def figures_of(findings: Sequence[Finding]) -> dict[str, Any]:
    """Return the figures of some contacts; shares from 0 to 1, NaN where there are none."""
    known = [finding for finding in findings if finding.error]
    error = np.array([finding.error for finding in known]).reshape(-1, 3)
    deviation = np.array([finding.deviation for finding in known]).reshape(-1, 3)
    ratio = error / np.maximum(deviation, 1e-12)
    claims = sum(finding.claims for finding in findings)
    wrong = sum(finding.wrong_claims for finding in findings)

    def named(values: Array) -> dict[str, float]:
        return dict(zip(_NAMES, values.tolist(), strict=True))

    nothing = np.full(3, np.nan)
    return {
        "contacts": len(findings),
        "mismatch": sum(finding.mismatch for finding in findings),
        "changed": sum(finding.changed for finding in findings),
        "live_mismatch": sum(finding.live_mismatch for finding in findings),
        "live_changed": sum(finding.live_changed for finding in findings),
        "silent": sum(finding.silent > 0 for finding in findings),
        "live_wrong": wrong / claims if claims else math.nan,
        "rms": named(np.sqrt(np.mean(ratio**2, axis=0)) if known else nothing),
        "coverage": named(np.mean(np.abs(ratio) <= TWO_SIDED_95, axis=0) if known else nothing),
        "without_estimate": sum(not finding.error for finding in findings),
        "converged": float(np.mean([finding.converged > 0 for finding in findings])),
    }


def goals_of(findings: Sequence[Finding]) -> list[Goal]:
    """Hold the contacts against the goals."""
    counts = (
        ("false alarms: told as mismatch or change", [f.told for f in findings]),
        ("false alarms: told at any moment", [f.told_live for f in findings]),
        ("silent: converged, unflagged and off", [f.silent > 0 for f in findings]),
    )
    goals = [
        within(name, sum(hits) / len(hits), (-math.inf, _ALLOWED), one_sided(sum(hits), len(hits)))
        for name, hits in counts
    ]
    figures = figures_of(findings)
    goals.append(
        within(
            "live: unflagged CONVERGED states that are off",
            figures["live_wrong"],
            (-math.inf, _ALLOWED),
        )
    )
    for key, words, limits in (
        ("rms", "root mean square of error over deviation", (0.6, 1.4)),
        ("coverage", "share in the 95 % interval", (0.9, math.inf)),
    ):
        goals += [within(f"{words}, {name}", figures[key][name], limits) for name in _NAMES]
    return goals


def one_sided(part: int, whole: int) -> tuple[float, float]:
    """Return exact limits of a share, each with 95 % confidence (Clopper and Pearson 1934)."""
    from scipy.stats import beta

    low = 0.0 if part == 0 else float(beta.ppf(1.0 - _CONFIDENCE, part, whole - part + 1))
    high = 1.0 if part == whole else float(beta.ppf(_CONFIDENCE, part + 1, whole - part))
    return low, high


# Tables


def _table(rows: dict[str, dict[str, Any]]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(
        title="Tissue that obeys the law; worst first: silent, told falsely (at any moment)",
        box=box.MARKDOWN,
        padding=(0, 1),
    )
    table.add_column("")
    headings = (
        *("contacts", "silent", "mismatch", "changed", "live off", "rms G, Gn, alpha"),
        *("in the 95 % interval", "no estimate", "converged"),
    )
    for heading in headings:
        table.add_column(heading, justify="right")
    for name, row in rows.items():
        live = row["live_wrong"]
        table.add_row(
            name,
            str(row["contacts"]),
            str(row["silent"]),
            f"{row['mismatch']} ({row['live_mismatch']})",
            f"{row['changed']} ({row['live_changed']})",
            "–" if math.isnan(live) else f"{100.0 * live:.2g} %",
            ", ".join(f"{value:.2f}" for value in row["rms"].values()),
            ", ".join(f"{100.0 * value:.0f}" for value in row["coverage"].values()) + " %",
            str(row["without_estimate"]),
            f"{100.0 * row['converged']:.0f} %",
        )
    return table


def _alarm_table(alarms: Sequence[Finding]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title="What was told falsely, or silently off", box=box.SIMPLE, padding=(0, 1))
    for heading in ("number", "what", "rig", "motion", "tissue", "hold, rate, signal to noise"):
        table.add_column(heading)
    for alarm in alarms:
        words = {
            "mismatch": alarm.live_mismatch or alarm.mismatch,
            "changed": alarm.live_changed or alarm.changed,
            "silent": alarm.silent > 0,
            f"{alarm.wrong_claims} of {alarm.claims} states off": alarm.wrong_claims > 0,
        }
        own = alarm.drawn
        table.add_row(
            str(alarm.number),
            ", ".join(word for word, is_so in words.items() if is_so),
            alarm.rig,
            own["motion"],
            f"{own['linear_stiffness']:.0f}, {own['nonlinear_stiffness']:.1f}, "
            f"{own['fractional_order']:.2f}",
            f"{own['hold_s']:.1f} s, {own['rate_hz']:.0f} Hz, {own['signal_to_noise']:.0f}",
        )
    return table


def _draw(figure: Figure, findings: Sequence[Finding]) -> None:
    """Draw the errors over their deviations against what may matter; alarms are crosses."""
    figure.set_size_inches(13, 7)
    columns = (
        ("linear_stiffness", "G [Pa s^alpha]"),
        ("nonlinear_stiffness", "Gn"),
        ("hold_s", "hold [s]"),
        ("rate_hz", "rate [Hz]"),
        ("signal_to_noise", "signal to noise"),
        ("fractional_order", "alpha"),
    )
    known = [finding for finding in findings if finding.error]
    told = [finding for finding in known if finding.told_live or finding.told]
    for axes, (key, label) in zip(figure.subplots(2, 3).flat, columns, strict=True):
        for index, (name, colour) in enumerate(zip(_NAMES, ("C0", "C1", "C2"), strict=True)):
            for some, marker, size in ((known, ".", 10), (told, "x", 40)):
                axes.scatter(
                    [max(finding.drawn[key], 0.01) for finding in some],
                    [
                        finding.error[index] / max(finding.deviation[index], 1e-12)
                        for finding in some
                    ],
                    s=size,
                    marker=marker,
                    color=colour,
                    label=name if marker == "." else None,
                )
        axes.set_yscale("symlog", linthresh=3.0)
        axes.axhspan(-5.0, 5.0, color="0.94", zorder=0)
        axes.set_xlabel(label)
        if key != "fractional_order":
            axes.set_xscale("log")
    axes.legend(title="error over deviation; x: told")
