# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What should not move an estimate: how far it does, in stated deviations.

Measured ramps and holds (a folder, as for `real`), and 20 presses on simulated rigs, each with
something disturbed, go through the pipeline as they are and again with one thing changed. A *move*
is the largest change of ln G, ln Gn and alpha over the deviation that the unchanged record states.
The period is that of `estimate.period` and is changed on the simulated presses, which have 500 Hz.
The live state is the last before the recording ends, in the hold: there is no air after it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from heapq import merge
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmark.harness import Benchmark, Goal, Report, Table, at_least, at_most, measured
from benchmark.measured import Test, read_tests, some_of
from benchmark.presses import CASES, parameters_of, scenario_of
from benchmark.score import NAMES, share
from benchmark.trial import presses_of
from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import Estimate
from fden_ros.core.outputs import ContactSummary, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.samples import NANOSECONDS
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.simulate import START_NS, simulate

EPILOG = """\
examples:
  fden benchmark invariance measured/               every CSV in the folder that is such a table
  fden benchmark invariance --quick                 a few simulated presses
  fden benchmark invariance measured/ --json | jq '.figures.changes'

Without measured tests only the simulated presses are looked at.
"""

Stamps = NDArray[np.int64]

_RIGS, _QUICK = 20, 3
#: All stamps are shifted by this [ns].
_SHIFT_NS = 12_345_678_901
_NANOMETRE, _TENTH_MICROMETRE = 1e-9, 1e-7
#: Deviation of a parameter that is given [1]: it does not move.
_TINY = 1e-9
#: Materials whose whole records are to be as sharp as this: ln G, ln Gn, alpha.
_SHARP = ("beef", (0.13, 0.05, 0.08))


@dataclass(frozen=True)
class Record:
    """Samples of two streams, force and displacement, and the identifier's parameters."""

    name: str
    kind: str  #: material, or SIMULATED
    stamps: tuple[Stamps, Stamps]  #: [ns], shape (n,) each
    values: tuple[Array, Array]  #: [N], [m]
    parameters: Mapping[str, Any]
    seed: int


SIMULATED = "simulated"


def _noisy(size: float) -> Callable[[Record], Record]:
    def change(record: Record) -> Record:
        force, moved = record.values
        noise = np.random.default_rng([record.seed, 29]).normal(0.0, size, moved.size)
        return replace(record, values=(force, moved + noise))

    return change


def _shifted(record: Record) -> Record:
    force, moved = record.stamps
    return replace(record, stamps=(force + _SHIFT_NS, moved + _SHIFT_NS))


def _halved(record: Record) -> Record:
    (force, moved), (forces, depths) = record.stamps, record.values
    return replace(record, stamps=(force[::2], moved[::2]), values=(forces[::2], depths[::2]))


def _with_period(period: float) -> Callable[[Record], Record]:
    return lambda record: replace(
        record, parameters={**record.parameters, "estimate.period": period}
    )


class Change(NamedTuple):
    """What is changed, and how far the estimate may move: in so many of the records, in all."""

    change: Callable[[Record], Record]
    usual: float  #: [deviations]
    quantile: float  #: share of the records within `usual`
    most: float  #: [deviations]
    simulated: bool = False  #: on the simulated presses alone


#: 10 ms is the default.
CHANGES = {
    "noise of 1 nm": Change(_noisy(_NANOMETRE), 0.1, 1.0, 0.1),
    "stamps shifted": Change(_shifted, 0.1, 1.0, 0.1),
    "noise of 0.1 um": Change(_noisy(_TENTH_MICROMETRE), 0.2, 0.95, 0.5),
    "period of 10 ms": Change(_with_period(0.01), 0.2, 0.95, 0.5, simulated=True),
    "period of 20 ms": Change(_with_period(0.02), 0.2, 0.95, 0.5, simulated=True),
    "period of 50 ms": Change(_with_period(0.05), 0.2, 0.95, 0.5, simulated=True),
    "every second sample left out": Change(_halved, 0.5, 0.9, 2.0),
}
LIVE = "last live state against the summary"
_LIVE_LIMIT = 0.1


class Moves(NamedTuple):
    """How far one record's estimate moves, by what is changed, (3,) each; and its deviations."""

    kind: str
    moves: Mapping[str, Array]
    deviations: Array  #: shape (3,); NaN: there is no estimate


def run(args: argparse.Namespace) -> Report:
    """Identify every record as it is and changed, and hold the moves against their goals."""
    tests = read_tests(args.data) if args.data is not None else []
    tests = some_of(tests, _QUICK) if args.quick else tests
    records = [_measured(test, number) for number, test in enumerate(tests)]
    kinds = sorted({record.kind for record in records})
    records += [simulated(number) for number in range(_QUICK if args.quick else _RIGS)]
    found = measured(moves_of, [(record,) for record in records], what="records")
    rows = {
        f"{name}, {kind}": row_of(values)
        for name in (*CHANGES, LIVE)
        for kind in (*kinds, SIMULATED)
        if (values := [m.moves[name] for m in found if m.kind == kind and name in m.moves])
    }
    sharpness = {
        kind: {
            "sd": np.nanmedian([m.deviations for m in found if m.kind == kind], axis=0),
            "no estimate": share(np.isnan(m.deviations[0]) for m in found if m.kind == kind),
        }
        for kind in (*kinds, SIMULATED)
    }
    return Report(
        goals_of(found, sharpness),
        {
            "changes": Table(
                "Moves in stated deviations: ln G, ln Gn, alpha",
                rows,
                {"95 %": (0.0, 0.5), "largest": (0.0, 2.0)},
            ),
            "records": Table("Whole records: median deviations", sharpness),
        },
    )


def _measured(test: Test, number: int) -> Record:
    stamps = START_NS + np.round(test.times * NANOSECONDS).astype(np.int64)
    values = (test.forces, test.displacements)
    return Record(test.name, test.kind, (stamps, stamps), values, test.parameters, number)


def simulated(number: int) -> Record:
    """Return a press on a rig of `presses`, each another one, up to the end of its hold."""
    cases = [case for case in CASES.values() if case.press_count == 1 and case.surface is None]
    case = cases[number % len(cases)]
    recording = simulate(scenario_of(case, number // len(cases)))
    last = START_NS + round(NANOSECONDS * (presses_of(recording)[0][0] + case.held_s))
    force, moved = (
        (stream.stamp_ns[stream.stamp_ns <= last], stream.value[stream.stamp_ns <= last])
        for stream in (recording.force, recording.displacement)
    )
    stamps, values = (force[0], moved[0]), (force[1], moved[1])
    return Record(case.name, SIMULATED, stamps, values, parameters_of(recording), number)


def moves_of(record: Record) -> Moves:
    """Identify a record as it is, and after each change."""
    live, whole = identify(record)
    if whole is None:
        return Moves(record.kind, {}, np.full(3, np.nan))
    scale = np.maximum(whole.deviations, _TINY)
    moves = {}
    if live is not None:
        moves[LIVE] = np.abs(live.mean - whole.mean) / scale
    for name, change in CHANGES.items():
        if change.simulated and record.kind != SIMULATED:
            continue
        _, other = identify(change.change(record))
        # An estimate that is lost is infinitely far.
        far = np.full(3, np.inf) if other is None else np.abs(other.mean - whole.mean) / scale
        moves[name] = far
    return Moves(record.kind, moves, whole.deviations)


def identify(record: Record) -> tuple[Estimate | None, Estimate | None]:
    """Return the last live estimate, and that of the last summary."""
    outputs: list[Output] = []
    pipeline = Pipeline(pipeline_config(check(dict(record.parameters))), outputs.append)
    # Of equal stamps the displacement goes first.
    moved, force = (
        [(stamp, add, value) for stamp, value in zip(stamps.tolist(), some.tolist(), strict=True)]
        for stamps, some, add in (
            (record.stamps[1], record.values[1], pipeline.add_displacement),
            (record.stamps[0], record.values[0], pipeline.add_force),
        )
    )
    for stamp_ns, add, value in merge(moved, force, key=itemgetter(0)):
        add(stamp_ns, value)
    live = [o.estimate for o in outputs if isinstance(o, TissueState)]
    pipeline.finish()
    whole = [o.estimate for o in outputs if isinstance(o, ContactSummary)]
    return live[-1] if live else None, whole[-1] if whole else None


def row_of(moves: Sequence[Array]) -> dict[str, Any]:
    """Return the figures of a change: over the records, for each parameter."""
    values = np.array(moves)
    return {
        "records": len(values),
        "median": np.median(values, axis=0),
        "95 %": np.quantile(values, 0.95, axis=0, method="inverted_cdf"),
        "largest": values.max(axis=0),
        "beyond 1": share(values.max(axis=1) > 1.0),
    }


def goals_of(found: Sequence[Moves], sharpness: Mapping[str, Mapping[str, Any]]) -> list[Goal]:
    """Hold the moves of all records against the goals."""
    goals = []
    for name, change in CHANGES.items():
        largest = np.array([m.moves[name].max() for m in found if name in m.moves])
        if change.quantile < 1.0:
            within_usual = share(largest <= change.usual).value
            words = f"{name}: records that move by at most {change.usual:g}"
            goals.append(at_least(words, within_usual, change.quantile))
        most = float(min(largest.max(), 1e9)) if largest.size else float("nan")
        goals.append(at_most(f"{name}: largest move", most, change.most))
    live = [float(m.moves[LIVE].max()) for m in found if LIVE in m.moves]
    goals.append(at_most(f"{LIVE}: largest move", max(live, default=float("nan")), _LIVE_LIMIT))
    kind, limits = _SHARP
    if kind in sharpness:
        goals += [
            at_most(f"{kind}, whole records: median deviation of {name}", float(value), limit)
            for name, value, limit in zip(NAMES, sharpness[kind]["sd"], limits, strict=True)
        ]
    return goals


BENCHMARK = Benchmark(run, EPILOG, data=True)
