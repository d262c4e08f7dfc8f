# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Changes that must not move an estimate: how far they do, in stated deviations.

20 presses on simulated rigs, each with something disturbed, go through the pipeline as they are
and again with one thing changed. A *move* is the largest
change of ln G, ln Gn and alpha over the deviation that the unchanged record states. The live state
is the last before the recording ends, of a rig in the hold: there is no air after it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from benchmark.harness import Benchmark, Goal, Report, Table, at_most, measured
from benchmark.robots import CASES, parameters_of, scenario_of
from benchmark.score import share
from benchmark.trial import begun, feed, last_of, presses_of
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Estimate
from fden_ros.core.outputs import ContactSummary, TissueState
from fden_ros.core.streams import NANOSECONDS
from simulation.simulate import START_NS, Recording, Stream, simulate

EPILOG = """\
examples:
  fden benchmark invariance --quick                 a few presses
  fden benchmark invariance --json | jq '.figures.rigs'
"""

#: Recordings end this long before the retract [s], which only the summary may use.
_BEFORE_RETREAT = 0.05
#: Deviation of a parameter that is given [1]: it does not move.
_TINY = 1e-9
#: Stands for an infinite move in a goal [deviations].
_LARGEST = 1e9


class Record(NamedTuple):
    """A recording, and the identifier's parameters."""

    number: int
    recording: Recording
    parameters: Mapping[str, Any]

    def with_streams(self, change: Callable[[Stream], Stream]) -> Record:
        """Return the same with its streams changed."""
        force, moved = map(change, self.recording.streams)
        return self._replace(recording=replace(self.recording, force=force, displacement=moved))


def _noisy(record: Record, size: float) -> Record:
    moved = record.recording.displacement
    generator = np.random.default_rng([record.number, 29])
    noisy = replace(moved, value=moved.value + generator.normal(0.0, size, moved.value.size))
    return record._replace(recording=replace(record.recording, displacement=noisy))


def _shifted(record: Record) -> Record:
    return record.with_streams(lambda one: replace(one, stamp_ns=one.stamp_ns + 12_345_678_901))


def _halved(record: Record) -> Record:
    return record.with_streams(
        lambda one: replace(one, stamp_ns=one.stamp_ns[::2], value=one.value[::2])
    )


def _with_period(record: Record, period: float) -> Record:
    return record._replace(parameters={**record.parameters, "estimate.period": period})


class Change(NamedTuple):
    """A change, and the largest allowed move of the estimate in deviations."""

    change: Callable[[Record], Record]
    most: float


#: 10 ms is the default period.
CHANGES = {
    "noise of 1 nm": Change(lambda record: _noisy(record, 1e-9), 0.1),
    "stamps shifted": Change(_shifted, 0.1),
    "noise of 0.1 um": Change(lambda record: _noisy(record, 1e-7), 0.2),
    "period of 20 ms": Change(lambda record: _with_period(record, 0.02), 0.5),
    "period of 50 ms": Change(lambda record: _with_period(record, 0.05), 0.5),
    "every second sample left out": Change(_halved, 2.0),
}
LIVE = "last live state against the summary"
_LIVE_LIMIT = 0.1

#: Moves of one record's estimate by each change, (3,) each; empty: there is none.
Moves = Mapping[str, Array]


def run(args: argparse.Namespace) -> Report:
    """Identify every record as it is and changed, and compare the moves with their goals."""
    found = measured(run_trial, [(n,) for n in args.numbers], "rigs")
    rows: dict[str, dict[str, Any]] = {}
    goals: list[Goal] = []
    for name, most in [*((name, c.most) for name, c in CHANGES.items()), (LIVE, _LIVE_LIMIT)]:
        values = np.array([moves[name] for moves in found if name in moves]).reshape(-1, 3)
        largest = np.minimum(values.max(axis=1), _LARGEST)
        worst = float(largest.max()) if values.size else math.nan
        goals.append(at_most(f"{name}: largest move", worst, most))
        if values.size:
            rows[name] = {
                "records": len(values),
                "median": np.median(values, axis=0),
                "95 %": np.quantile(values, 0.95, axis=0, method="inverted_cdf"),
                "largest": values.max(axis=0),
                "beyond 1": share(largest > 1.0),
            }
    return Report(goals, {"rigs": Table("Moves in stated deviations: ln G, ln Gn, alpha", rows)})


def run_trial(number: int) -> Moves:
    """Simulate record `number`, and identify it as it is and after each change."""
    record = simulated(number)
    live, whole = identify(record)
    if whole is None:
        return {}
    estimates = {name: identify(one.change(record))[1] for name, one in CHANGES.items()}
    if live is not None:
        estimates[LIVE] = live
    scale = np.maximum(whole.deviations, _TINY)
    return {
        # A lost estimate has moved infinitely far.
        name: np.full(3, np.inf) if one is None else np.abs(one.mean - whole.mean) / scale
        for name, one in estimates.items()
    }


def simulated(number: int) -> Record:
    """Return a press on a rig of `robots`, each another one, up to the end of its hold."""
    cases = [case for case in CASES.values() if case.press_count == 1]
    case = cases[number % len(cases)]
    recording = simulate(scenario_of(case, number // len(cases)))
    held = case.held_s - _BEFORE_RETREAT
    last = START_NS + round(NANOSECONDS * (presses_of(recording)[0][0] + held))

    def cut(stream: Stream) -> Stream:
        kept = stream.stamp_ns <= last
        return replace(stream, stamp_ns=stream.stamp_ns[kept], value=stream.value[kept])

    return Record(number, recording, parameters_of(recording)).with_streams(cut)


def identify(record: Record) -> tuple[Estimate | None, Estimate | None]:
    """Return the last live estimate, and that of the last summary."""
    pipeline, outputs = begun(record.parameters)
    feed(pipeline, record.recording)
    live = last_of(TissueState, outputs)
    pipeline.finish()
    whole = last_of(ContactSummary, outputs)
    return live.estimate if live else None, whole.estimate if whole else None


BENCHMARK = Benchmark(run, EPILOG, contacts=(20, 3))
