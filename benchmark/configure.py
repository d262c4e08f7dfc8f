# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What `fden configure` finds on simulated rigs of which nothing is known.

Each rig is drawn whole: axes, signs, units, rates of 30 Hz to 1 kHz, delays of -5 to 30 ms,
compliances up to 1 mm/N, tools up to 1 kg (or taken off by the driver), bias, drift, noise, steps,
breathing, the tissue, and what its recording holds: turns in the air, presses of a plate,
presses of tissue, oscillations at one or two frequencies, or a probe that never leaves it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmark.harness import Benchmark, Report, Table, at_most, measured, undecided, within
from benchmark.score import Share, rms, share
from benchmark.unknown_rigs import RigTruth, simulate_rig
from fden_ros.configure.finding import Finding
from fden_ros.configure.survey import Survey, survey
from fden_ros.core.arrays import Array

EPILOG = """\
examples:
  fden benchmark configure --quick
  fden benchmark configure --first 4000 --contacts 100
"""

#: Rigs begin here: those below were looked at while the findings were made.
_FIRST_SEED = 1000
#: So many rigs show whether intervals hold.
_ENOUGH = 100
_AXIS_LIMIT = math.radians(2.0)
#: The 95 % interval of an error in one direction, and of one in two, in deviations.
_ONE, _TWO = 1.96, 2.4477
#: A compliance whose deviation is above this share of it is stated as a bound.
_BOUND = 0.04
#: Findings that have a limit, and those that every recording shows.
_LIMITED = {
    "force axis": "within 2 degrees, sign right",
    "displacement axis": "within 2 degrees, sign right",
    "force unit": "right",
    "displacement unit": "right",
    "tool mass": "within 2 %",
    "delay": "within 1 ms",
    "compliance": "within 10 %, or a bound",
}
_ALWAYS = ("force axis", "displacement axis", "force unit", "displacement unit")


@dataclass
class Judged:
    """What the findings of one rig are worth.

    Parameters
    ----------
    errors : dict
        Error over deviation by subject, of stated findings; of an axis as a share of the 95 %.
    misses : list of (str, str)
        Stated findings that miss their goal, and what they say.
    stated : dict
        Whether each subject is stated.
    unfounded : list of str
        Stated although the recording does not show it.
    """

    seed: int
    errors: dict[str, list[float]] = field(default_factory=dict)
    misses: list[tuple[str, str]] = field(default_factory=list)
    stated: dict[str, bool] = field(default_factory=dict)
    unfounded: list[str] = field(default_factory=list)

    def hold(self, finding: Finding, true: float, limit: float = math.inf) -> None:
        """Hold a stated number against the truth and the largest error that is allowed."""
        if not finding.claim or not isinstance(finding.value, float) or not finding.deviation:
            return
        error = finding.value - true
        self.errors[finding.subject] = [error / finding.deviation]
        if abs(error) > limit:
            self.misses.append((finding.subject, f"{finding.value:.4g} for {true:.4g}"))


def judge(found: Survey, truth: RigTruth) -> Judged:
    """Hold the findings of a rig against what is true of it."""
    judged = Judged(truth.seed)
    by_name = {finding.subject: finding for finding in found.findings}
    judged.stated = {name: finding.claim for name, finding in by_name.items()}
    for what, axis in (("force", truth.force_axis), ("displacement", truth.displacement_axis)):
        _judge_axis(judged, by_name[f"{what} axis"], axis)
    for what, usual, other, unit in (
        ("force", "N", "g", truth.force_unit),
        ("displacement", "m", "mm", truth.displacement_unit),
    ):
        finding = by_name[f"{what} unit"]
        if finding.claim and finding.value != (usual if unit == 1.0 else other):
            judged.misses.append((finding.subject, str(finding.value)))
    _judge_numbers(judged, by_name, truth)
    shows_delay = truth.rigid or truth.turns
    shown = {"delay": shows_delay, "compliance": truth.rigid, "tool mass": truth.turns}
    judged.unfounded = [name for name, is_so in shown.items() if by_name[name].claim and not is_so]
    return judged


def _judge_axis(judged: Judged, finding: Finding, axis: Array) -> None:
    if not finding.claim:
        return
    assert finding.value is not None and not isinstance(finding.value, str)
    value = np.atleast_1d(np.array(finding.value))
    error = math.acos(min(max(float(value @ axis), -1.0), 1.0))
    if error > _AXIS_LIMIT:
        judged.misses.append((finding.subject, f"{math.degrees(error):.1f} degrees"))
    if axis.size > 1 and finding.deviation:
        judged.errors[finding.subject] = [error / finding.deviation / _TWO * _ONE]


def _judge_numbers(judged: Judged, by_name: Mapping[str, Finding], truth: RigTruth) -> None:
    steps = math.sqrt(12.0)
    judged.hold(by_name["force noise"], math.hypot(truth.force_noise, truth.force_step / steps))
    motion_noise = math.hypot(truth.displacement_noise, truth.displacement_step / steps)
    judged.hold(by_name["displacement noise"], motion_noise)
    judged.hold(by_name["delay"], truth.delay, 1e-3)
    if by_name["tool mass"].value:
        judged.hold(by_name["tool mass"], truth.mass, 0.02 * truth.mass)
    centre = by_name["tool centre of mass"]
    if centre.claim and centre.deviation:
        errors = (np.array(centre.value) - truth.centre) / centre.deviation
        judged.errors["tool centre of mass"] = errors.tolist()
    compliance = by_name["compliance"]
    if isinstance(compliance.value, float) and compliance.deviation:
        # What is too small to measure is stated as a bound: only its interval counts.
        is_bound = compliance.deviation > _BOUND * abs(compliance.value)
        judged.hold(compliance, truth.compliance, math.inf if is_bound else 0.1 * truth.compliance)
    axis, bias = by_name["force axis"], by_name["force bias"]
    if not axis.claim or (truth.mass and not truth.turns):
        return
    along = np.atleast_1d(np.array(axis.value))
    if bias.claim:
        start, end = bias.seconds[0]
        judged.hold(bias, float((truth.bias + truth.drift * 0.5 * (start + end)) @ along))
    judged.hold(by_name["force drift"], float(truth.drift @ along))


def judge_rig(number: int) -> Judged:
    """Simulate a rig, look at its recording, and judge what is found."""
    rig = simulate_rig(_FIRST_SEED + number)
    return judge(survey([rig.streams]), rig.truth)


def run(args: argparse.Namespace) -> Report:
    """Simulate, find and judge."""
    tasks = [(number,) for number in args.numbers]
    rigs = measured(judge_rig, tasks, jobs=args.jobs, what="rigs")
    rows = {name: row_of(name, rigs) for name in rigs[0].stated}
    goals = [
        at_most(f"{name}: stated ones not {words}", float(rows[name]["wrong"]), 0.0)
        for name, words in _LIMITED.items()
    ]
    goals += [
        within(f"{name}: stated", rows[name]["stated"].value, (1.0, 1.0)) for name in _ALWAYS
    ]
    unfounded = sum(len(rig.unfounded) for rig in rigs)
    goals.append(at_most("stated without evidence", float(unfounded), 0.0))
    intervals = [
        within(
            f"{name}: 95 % intervals that hold",
            row["95 % hold"].value,
            (0.9, 0.99),
        )
        for name, row in rows.items()
        if row["95 % hold"].whole
    ]
    goals += intervals if len(rigs) >= _ENOUGH else undecided(intervals)
    misses = {
        f"rig {rig.seed}, {name}": {"says": says}
        for rig in rigs
        for name, says in [*rig.misses, *((name, "without evidence") for name in rig.unfounded)]
    }
    tables = {"findings": Table(f"Findings on {len(rigs)} rigs", rows, ("errors over sd",))}
    if misses:
        tables["misses"] = Table("Stated, and wrong", misses)
    return Report(goals, tables)


def row_of(name: str, rigs: Sequence[Judged]) -> dict[str, Any]:
    """Return the figures of a finding."""
    errors = [error for rig in rigs for error in rig.errors.get(name, [])]
    return {
        "stated": share(rig.stated[name] for rig in rigs),
        "wrong": sum(miss == name for rig in rigs for miss, _ in rig.misses),
        "95 % hold": Share(sum(abs(error) <= _ONE for error in errors), len(errors)),
        "rms error over sd": float(rms(np.array(errors))) if errors else math.nan,
        "errors over sd": errors,
    }


BENCHMARK = Benchmark(run, EPILOG, contacts=(200, 12))
