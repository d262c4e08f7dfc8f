# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What should not move an estimate: how far it does, in stated deviations.

20 presses on simulated rigs, each with something disturbed, go through the pipeline as they are
and again with one thing changed. A *move* is the largest
change of ln G, ln Gn and alpha over the deviation that the unchanged record states. The live state
is the last before the recording ends, of a rig in the hold: there is no air after it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from benchmark.harness import Benchmark, Goal, Report, Table, at_least, at_most, measured
from benchmark.presses import CASES, parameters_of, scenario_of
from benchmark.score import share
from benchmark.trial import feed, presses_of
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Estimate
from fden_ros.core.outputs import ContactSummary, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams import NANOSECONDS
from fden_ros.parameters import check, pipeline_config
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


class Record(NamedTuple):
    """A recording, and the identifier's parameters."""

    number: int
    recording: Recording
    parameters: Mapping[str, Any]

    def with_streams(self, change: Callable[[Stream], Stream]) -> Record:
        """Return the same with its streams changed."""
        force, moved = map(change, self.recording.streams)
        return self._replace(recording=replace(self.recording, force=force, displacement=moved))


def _noisy(size: float) -> Callable[[Record], Record]:
    def change(record: Record) -> Record:
        moved = record.recording.displacement
        generator = np.random.default_rng([record.number, 29])
        noisy = moved.value + generator.normal(0.0, size, moved.value.size)
        displacement = replace(moved, value=noisy)
        return record._replace(recording=replace(record.recording, displacement=displacement))

    return change


def _shifted(record: Record) -> Record:
    return record.with_streams(lambda one: replace(one, stamp_ns=one.stamp_ns + 12_345_678_901))


def _halved(record: Record) -> Record:
    return record.with_streams(
        lambda one: replace(one, stamp_ns=one.stamp_ns[::2], value=one.value[::2])
    )


def _with_period(period: float) -> Callable[[Record], Record]:
    own = {"estimate.period": period}
    return lambda record: record._replace(parameters={**record.parameters, **own})


class Change(NamedTuple):
    """A change, and the allowed move of the estimate: in a share of the records, in all."""

    change: Callable[[Record], Record]
    usual: float  #: [deviations]
    quantile: float  #: share of the records within `usual`
    most: float  #: [deviations]


#: 10 ms is the default period.
CHANGES = {
    "noise of 1 nm": Change(_noisy(1e-9), 0.1, 1.0, 0.1),
    "stamps shifted": Change(_shifted, 0.1, 1.0, 0.1),
    "noise of 0.1 um": Change(_noisy(1e-7), 0.2, 0.95, 0.5),
    "period of 20 ms": Change(_with_period(0.02), 0.2, 0.95, 0.5),
    "period of 50 ms": Change(_with_period(0.05), 0.2, 0.95, 0.5),
    "every second sample left out": Change(_halved, 0.5, 0.9, 2.0),
}
LIVE = "last live state against the summary"
_LIVE_LIMIT = 0.1

#: Moves of one record's estimate by each change, (3,) each; empty: there is none.
Moves = Mapping[str, Array]


def run(args: argparse.Namespace) -> Report:
    """Identify every record as it is and changed, and compare the moves with their goals."""
    found = measured(run_trial, [(n,) for n in args.numbers], jobs=args.jobs, what="rigs")
    table = Table("Moves in stated deviations: ln G, ln Gn, alpha", rows_of(found))
    return Report(goals_of(found), {"rigs": table})


def run_trial(number: int) -> Moves:
    """Simulate record `number`, and identify it as it is and after each change."""
    return moves_of(simulated(number))


def simulated(number: int) -> Record:
    """Return a press on a rig of `presses`, each another one, up to the end of its hold."""
    cases = [case for case in CASES.values() if case.press_count == 1]
    case = cases[number % len(cases)]
    recording = simulate(scenario_of(case, number // len(cases)))
    held = case.held_s - _BEFORE_RETREAT
    last = START_NS + round(NANOSECONDS * (presses_of(recording)[0][0] + held))

    def cut(stream: Stream) -> Stream:
        kept = stream.stamp_ns <= last
        return replace(stream, stamp_ns=stream.stamp_ns[kept], value=stream.value[kept])

    return Record(number, recording, parameters_of(recording)).with_streams(cut)


def moves_of(record: Record) -> Moves:
    """Identify a record as it is, and after each change."""
    live, whole = identify(record)
    if whole is None:
        return {}
    scale = np.maximum(whole.deviations, _TINY)
    moves = {} if live is None else {LIVE: np.abs(live.mean - whole.mean) / scale}
    for name, change in CHANGES.items():
        _, other = identify(change.change(record))
        # A lost estimate has moved infinitely far.
        far = np.full(3, np.inf) if other is None else np.abs(other.mean - whole.mean) / scale
        moves[name] = far
    return moves


def identify(record: Record) -> tuple[Estimate | None, Estimate | None]:
    """Return the last live estimate, and that of the last summary."""
    outputs: list[Output] = []
    pipeline = Pipeline(pipeline_config(check(dict(record.parameters))), outputs.append)
    feed(pipeline, record.recording)
    live = [o.estimate for o in outputs if isinstance(o, TissueState)]
    pipeline.finish()
    whole = [o.estimate for o in outputs if isinstance(o, ContactSummary)]
    return live[-1] if live else None, whole[-1] if whole else None


def rows_of(found: Sequence[Moves]) -> dict[str, dict[str, Any]]:
    """Return the figures of each change: over the records, for each parameter."""
    rows: dict[str, dict[str, Any]] = {}
    for name in (*CHANGES, LIVE):
        values = np.array([moves[name] for moves in found if name in moves])
        if values.size:
            rows[name] = {
                "records": len(values),
                "median": np.median(values, axis=0),
                "95 %": np.quantile(values, 0.95, axis=0, method="inverted_cdf"),
                "largest": values.max(axis=0),
                "beyond 1": share(values.max(axis=1) > 1.0),
            }
    return rows


def goals_of(found: Sequence[Moves]) -> list[Goal]:
    """Compare the moves of all records with the goals."""
    goals = []
    for name, change in CHANGES.items():
        largest = np.array([moves[name].max() for moves in found if name in moves])
        if change.quantile < 1.0:
            within_usual = share(largest <= change.usual).value
            words = f"{name}: records that move by at most {change.usual:g}"
            goals.append(at_least(words, within_usual, change.quantile))
        most = float(min(largest.max(), 1e9)) if largest.size else math.nan
        goals.append(at_most(f"{name}: largest move", most, change.most))
    live = [float(moves[LIVE].max()) for moves in found if LIVE in moves]
    largest_live = max(live, default=math.nan)
    return [*goals, at_most(f"{LIVE}: largest move", largest_live, _LIVE_LIMIT)]


BENCHMARK = Benchmark(run, EPILOG, contacts=(20, 3))
