# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

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
from typing import Any, NamedTuple

import numpy as np

from benchmark.harness import Benchmark, Report, Table, by_case, worst
from benchmark.presses import CASES, PRESS, Case, peak_n, scenario_of
from benchmark.score import rms
from benchmark.trial import elapsed, presses_of, samples_of
from fden_ros.core.contact.detector import ContactDetector, Onset, Release
from fden_ros.core.site import ORIGIN_WIDENING
from fden_ros.core.streams.samples import Pair
from fden_ros.core.streams.synchronize import Synchronizer
from fden_ros.errors import InputError
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.disturbance import Disturbances
from fden_ros.simulation.scenario import Scenario
from fden_ros.simulation.simulate import Recording, simulate

EPILOG = """\
examples:
  fden benchmark contact                          # 200 approaches a row
  fden benchmark contact --ratio 5 --cases hum_20mN,liver_white_20mN

Rows are those of `fden benchmark robots`, pressed to 25 % in 1.25 s and let go.
"""

#: Approaches in a recording.
_SITES = 3
#: A contact within this of a press [s] is the press's.
_SLACK = 0.05
#: A surface is off beyond this many of the deviations that the estimator takes, and this [m].
_DEVIATIONS, _LEAST_ERROR = 5.0, 1e-4

#: Cases of `presses` by what is added here: slower and faster vibrations of the moving arm.
ROWS = {
    case.name: case
    for case in (
        CASES["undisturbed"],
        *(case for case in CASES.values() if case.detection and not case.pitch_m),
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
        CASES["thermal_100mN"],
    )
}


class Found(NamedTuple):
    """What was found in one recording: counts by name, and what has a median."""

    counts: Mapping[str, int]
    delays: tuple[float, ...]  #: from the touch to the first contact of a press [s]
    surfaces: tuple[float, ...]  #: error of the surface over its deviation


def _more(parser: argparse.ArgumentParser) -> None:
    words = "largest force of a press over the largest noise (default: 10)"
    parser.add_argument("--ratio", type=float, default=10.0, metavar="R", help=words)


def run(args: argparse.Namespace) -> Report:
    """Simulate, detect and judge."""
    if not (math.isfinite(args.ratio) and args.ratio > 0.0):
        raise InputError(f"--ratio is {args.ratio}; it must be positive")
    recordings = range(args.first, args.first + math.ceil(args.contacts / _SITES))
    tasks = [(case.name, number) for case in args.cases for number in recordings]
    found = by_case(run_trial, tasks, args.ratio, args.parameters, jobs=args.jobs)
    rows = {ROWS[name].says: row_of(trials) for name, trials in found.items()}
    drawn = {"delays [ms]": None, "surface over sd": (0.0, 1.3)}
    return Report(
        [
            worst(f"{words}, {args.ratio:g} times the noise: worst row", values, 0.0)
            for words, values in (
                (name, [row[name] for row in rows.values()])
                for name in ("invented", "missed", "split", "stuck")
            )
        ],
        {"cases": Table("Contacts on a disturbed rig", rows, drawn, ("delays [ms]",))},
    )


def run_trial(name: str, number: int, ratio: float, parameters: Mapping[str, Any]) -> Found:
    """Simulate recording `number` of a case, look for contacts, and judge them."""
    recording = simulate(approaches_of(ROWS[name], number, ratio))
    own = dict(recording.truth["identifier_parameters"])
    own.pop("displacement.delay", None)
    config = pipeline_config(check({**parameters, **own}))
    detector = ContactDetector(config.contact, config.estimator.prior.fractional_order)
    rejected: Counter[str] = Counter()
    found: list[tuple[float, Onset]] = []
    ends: list[float] = []

    def detect(pair: Pair) -> None:
        event = detector.add(pair)
        if isinstance(event, Onset):
            found.append((elapsed(pair.stamp_ns), event))
        elif isinstance(event, Release):
            ends.append(elapsed(pair.stamp_ns))

    synchronizer = Synchronizer(config.synchronize, detect, rejected)
    for is_force, stamp_ns, value, place in samples_of(recording):
        if is_force:
            synchronizer.add_force(stamp_ns, value)
        else:
            synchronizer.add_displacement(stamp_ns, value, place)
    return _judged(recording, found, [*ends, math.inf], rejected)


def approaches_of(case: Case, number: int, ratio: float) -> Scenario:
    """Return three approaches whose presses take `ratio` times the largest noise."""
    scenario = scenario_of(replace(case, presses=(PRESS,), sites=_SITES), number)
    geometry = scenario.geometry
    assert geometry.radius_m is not None
    radius = geometry.radius_m * math.sqrt(ratio * case.largest_noise_n / peak_n(scenario))
    return replace(scenario, geometry=replace(geometry, radius_m=radius))


def _judged(
    recording: Recording,
    found: Sequence[tuple[float, Onset]],
    ends: Sequence[float],
    rejected: Counter[str],
) -> Found:
    presses = presses_of(recording)
    hits: Counter[int] = Counter()
    counts: Counter[str] = Counter()
    delays, surfaces = [], []
    for (now, onset), end in zip(found, ends, strict=False):
        start = elapsed(onset.samples[0].stamp_ns)
        number = next(
            (
                n
                for n, (touch, release) in enumerate(presses)
                if start < release + _SLACK and end > touch - _SLACK and now > touch
            ),
            None,
        )
        if number is None:
            counts["invented"] += 1
            continue
        hits[number] += 1
        if hits[number] > 1:
            continue
        delays.append(now - presses[number][0])
        if not onset.seen:
            counts["unseen"] += 1
            continue
        error = onset.displacement - recording.truth["surface_displacement_m"]
        deviation = ORIGIN_WIDENING * onset.displacement_sd
        surfaces.append(error / deviation)
        counts["off"] += abs(error) > max(_DEVIATIONS * deviation, _LEAST_ERROR)
    counts["presses"] = len(presses)
    counts["missed"] = len(presses) - len(hits)
    counts["split"] = sum(hits.values()) - len(hits)
    counts["stuck"] = rejected["force.stuck"]
    counts["spikes"] = rejected["force.spike"] + rejected["displacement.spike"]
    return Found(counts, tuple(delays), tuple(surfaces))


def row_of(trials: Sequence[Found]) -> dict[str, Any]:
    """Return the figures of a row, by name."""
    delays = [1e3 * delay for trial in trials for delay in trial.delays]
    surfaces = np.array([ratio for trial in trials for ratio in trial.surfaces])
    counted = ("presses", "invented", "missed", "split", "off", "unseen", "stuck", "spikes")
    return {name: sum(trial.counts.get(name, 0) for trial in trials) for name in counted} | {
        "delay [ms], median": float(np.median(delays)) if delays else math.nan,
        "longest": max(delays, default=math.nan),
        "surface over sd": float(rms(surfaces)),
        "delays [ms]": delays,
    }


BENCHMARK = Benchmark(run, EPILOG, cases=ROWS, contacts=(200, 9), parameters=True, more=_more)
