# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a real robot adds (breathing, compliance, friction, hum, ...), and what the estimate says.

Simulated presses on a disturbed rig go through the whole pipeline, with a wide prior. Bad columns
come first: *undetected* presses have a summary that is converged, without a warning flag, and off
by more than five stated deviations and 3 % (0.01 of alpha); *live* are unflagged CONVERGED states
that are off likewise; then root mean square of error over stated deviation of ln G, ln Gn and
alpha. *Invented*: contacts where there was none; *missed*: of presses of ten times the noise;
*split*: further contacts within a press; *measured*: slopes of force over displacement, of loading
and of unloading, whose 95 % interval holds that of the motion without noise.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmark.harness import (
    Benchmark,
    Goal,
    Report,
    Table,
    at_least,
    at_most,
    by_case,
    few,
    within,
    worst,
)
from benchmark.presses import CASES, Case, peak_n, scenario_of, trial_of
from benchmark.score import NAMES, Outcome, Share, figures_of, median, rms, share, total
from fden_ros.core.outputs import Flag

EPILOG = """\
examples:
  fden benchmark robots --quick
  fden benchmark robots --cases compliance_0.5,friction_20mN --contacts 20
"""

#: A press this many times the noise must not be missed.
_CLEAR = 10.0
_REFERENCE = ("undisturbed", "undisturbed_press")


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify and judge."""
    tasks = [
        (case.name, args.first + number)
        for case in args.cases
        for number in range(math.ceil(args.contacts / case.press_count))
    ]
    found = by_case(run_trial, tasks, jobs=args.jobs)
    rows = {CASES[name].says: row_of(CASES[name], each) for name, each in found.items()}
    return Report(
        goals_of(found, {case.name: rows[case.says] for case in args.cases}),
        {"cases": Table("Presses on a disturbed rig", rows)},
    )


def run_trial(name: str, number: int) -> Outcome:
    """Simulate recording `number` of a case, identify it, and judge it."""
    return trial_of(CASES[name], number)


def row_of(case: Case, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the figures of a case over all of its recordings."""
    contacts = [contact for outcome in outcomes for contact in outcome.contacts]
    presses = sum(outcome.presses for outcome in outcomes)
    found = sum(len({c.number for c in o.contacts if c.number >= 0}) for o in outcomes)
    is_clear = case.detection and (peak_n(scenario_of(case, 0)) >= _CLEAR * case.largest_noise_n)
    fine = [
        bool(c.flags & Flag.MODEL_MISMATCH) and not c.is_off for c in contacts if c.number >= 0
    ]
    row = figures_of(outcomes) | {
        "fine, but mismatch": share(fine),
        "invented": sum(contact.number < 0 for contact in contacts),
        "missed": Share(presses - found, presses) if is_clear else None,
        "split": sum(contact.number >= 0 for contact in contacts) - found,
        "measured": total(outcome.measured for outcome in outcomes),
    }
    return {key: value for key, value in row.items() if key not in ("in 95 %", "live alarm", "sd")}


def goals_of(
    found: Mapping[str, Sequence[Outcome]], rows: Mapping[str, Mapping[str, Any]]
) -> list[Goal]:
    """Compare the cases with the goals."""
    lower = {name: row for name, row in rows.items() if CASES[name].detection}
    expected = [
        contact
        for name, outcomes in found.items()
        if not CASES[name].beyond
        for outcome in outcomes
        for contact in outcome.contacts
        if contact.number >= 0 and contact.estimate is not None
    ]
    ratios = np.array([c.error / np.maximum(c.deviation, 1e-12) for c in expected])
    goals = [
        few(
            "undetected gross errors, all rows",
            total(row["undetected"] for row in rows.values()),
            0.01,
        ),
        at_most("live, all rows", total(row["live"] for row in rows.values()).value, 0.005),
        *(
            within(f"error over deviation, all but those beyond, {name}", value, (0.6, 1.3))
            for name, value in zip(NAMES, rms(ratios.reshape(-1, 3)), strict=True)
        ),
        worst(
            "reported as changed tissue: worst row",
            (row["changed"].value for name, row in rows.items() if not CASES[name].beyond),
            0.02,
        ),
    ]
    quiet = [contact for name in _REFERENCE for o in found.get(name, ()) for contact in o.contacts]
    goals += [
        at_most(f"undisturbed: deviation of {name}", value, limit)
        for name, value, limit in zip(
            NAMES, median(np.array([c.deviation for c in quiet])), (0.10, 0.06, 0.04), strict=True
        )
    ]
    claimed = share(contact.claims for contact in quiet)
    goals += [
        within("undisturbed: converged and unflagged", claimed.value, (0.85, 1.0)),
        worst("contacts invented: worst row", (row["invented"] for row in lower.values()), 0.0),
        worst(
            "clear presses missed: worst row",
            (row["missed"].part for row in lower.values() if row["missed"] is not None),
            0.0,
        ),
        worst("presses split: worst row", (row["split"] for row in lower.values()), 0.0),
        worst(
            "fine, but reported as mismatch: worst row",
            (row["fine, but mismatch"].value for row in lower.values()),
            0.02,
        ),
    ]
    measured = total(outcome.measured for outcomes in found.values() for outcome in outcomes)
    goals.append(at_least("measured slopes in their 95 %", measured.value, 0.9))
    lost = [o for o in found.get("preload_2mm", ()) if not _is_last_right(o)]
    of = len(found.get("preload_2mm", ()))
    goals.append(
        at_most("preload: next touches that are off or lost", Share(len(lost), of).value, 0.0)
    )
    return goals


def _is_last_right(outcome: Outcome) -> bool:
    last = [contact for contact in outcome.contacts if contact.number == outcome.presses - 1]
    return any(contact.estimate is not None and not contact.is_off for contact in last)


BENCHMARK = Benchmark(
    run,
    EPILOG,
    cases=CASES,
    quick=("undisturbed", "friction_20mN", "breathing_1mm_press", "vibration_moving_100mN"),
    contacts=(50, 3),
)
