# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Speed: a sample in the pipeline beside a filter's step, and the replay of bags.

A sample at 1 kHz, ten to a block, in the air and in contact, stands beside a step of filterpy's
extended Kalman filter with four states: processor time, the least of several.
A simulated palpation of one site, force and displacement at 1 kHz each, is replayed by a process
of its own on one core, which then decodes the same messages with rclpy and does nothing with
them.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from benchmark.harness import Benchmark, Report, Table, at_least, measured
from fden_ros.core.pipeline import Pipeline
from fden_ros.offline.replay import replay
from fden_ros.parameters import check, pipeline_config, read_parameter_file
from fden_ros.recording.reader import BagReader, decode
from simulation.bag import PARAMETER_FILE, write_recording
from simulation.scenario import Scenario, load_scenario, ramp_scenario
from simulation.simulate import simulate

EPILOG = """\
examples:
  fden benchmark replay --quick
  fden benchmark replay --json | jq .goals

An otherwise idle machine is wanted: the speeds are of processor time, but cores share caches.
"""

_ROUNDS, _QUICK_ROUNDS = 3, 1
#: Samples of the contact and steps that are timed, and timings of which the least counts.
_CONTACT_SAMPLES, _STEPS, _REPEATS = 2500, 500, 3
_NS_PER_S = 1_000_000_000


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    with tempfile.TemporaryDirectory() as folder:
        bag = _make(load_scenario("palpation"), Path(folder) / "palpation")
        rounds = [_alone(speed_of, bag) for _ in range(_QUICK_ROUNDS if args.quick else _ROUNDS)]
        speed = min(rounds, key=lambda found: found["replay [s]"])
    return Report(
        [
            at_least("replay at 1 kHz, times real time, one core", speed["times real time"], 25.0),
            at_least("speed of replay over merely decoding", speed["over decoding"], 0.4),
        ],
        {
            "steps": Table("One sample at 1 kHz, ten to a block", _steps()),
            "speed": Table("Replay", {"palpation at 1 kHz": speed}),
        },
    )


def _make(scenario: Scenario, folder: Path) -> Path:
    write_recording(simulate(scenario, scenario.seed), folder)
    return folder


def _alone(function: Callable[[Path], dict[str, float]], bag: Path) -> dict[str, float]:
    """Call a function in a process of its own, whose peak of memory is its alone."""
    # Of two processes one is new for the only task.
    return measured(function, [(bag,)], what=bag.name)[0]


def _recorded_s(reader: BagReader) -> float:
    return ((reader.end_ns or 0) - (reader.start_ns or 0)) / _NS_PER_S


def speed_of(bag: Path) -> dict[str, float]:
    """Return the processor time of a replay, and of decoding the same messages."""
    parameters = read_parameter_file(bag / PARAMETER_FILE)
    start = time.process_time()
    result = replay(bag, parameters)
    replayed = time.process_time() - start
    reader = BagReader(bag)
    count = sum(1 for message in reader.messages(list(result.inputs.values())) if decode(message))
    decoded = time.process_time() - start - replayed
    return {
        "recorded [s]": _recorded_s(reader),
        "messages": count,
        "replay [s]": replayed,
        "decoding [s]": decoded,
        "us a message": 1e6 * replayed / count,
        "times real time": _recorded_s(reader) / replayed,
        "over decoding": decoded / replayed,
    }


def _steps() -> dict[str, dict[str, float]]:
    """Return what a sample and a step cost [us], and how many steps a sample is."""
    recording = simulate(ramp_scenario(strain_rate=0.1, max_strain=0.25, hold_s=1.0, seed=1))
    config = pipeline_config(check(recording.truth["identifier_parameters"]))
    samples = list(
        zip(
            recording.force.stamp_ns.tolist(),
            recording.force.value.tolist(),
            recording.displacement.value.tolist(),
            strict=True,
        )
    )
    touch = recording.truth["contacts"][0]["start_ns"]
    air = sum(stamp < touch for stamp, _, _ in samples)
    parts = {"in the air": samples[:air], "in contact": samples[air : air + _CONTACT_SAMPLES]}
    found: dict[str, float] = {}
    for _ in range(_REPEATS):
        pipeline = Pipeline(config, lambda output: None)

        def take(sample: tuple[int, float, float], pipeline: Pipeline = pipeline) -> None:
            stamp, force, displacement = sample
            pipeline.add_displacement(stamp, displacement)
            pipeline.add_force(stamp, force)

        for name, part in parts.items():
            found[name] = min(found.get(name, math.inf), _mean_time(take, part))
    ekf, row = ExtendedKalmanFilter(dim_x=4, dim_z=1), np.ones((1, 4))

    def step(_: object) -> None:
        ekf.predict()
        ekf.update(np.zeros(1), lambda x: row, lambda x: row @ x)

    reference = min(_mean_time(step, range(_STEPS)) for _ in range(_REPEATS))
    found["step of filterpy's EKF"] = reference
    return {
        name: {"us": value, "over the EKF": value / reference} for name, value in found.items()
    }


def _mean_time(action: Callable[[Any], None], arguments: Sequence[Any]) -> float:
    """Return the processor time of a call [us], the mean over all arguments."""
    begin = time.process_time_ns()
    for argument in arguments:
        action(argument)
    return 1e-3 * (time.process_time_ns() - begin) / len(arguments)


BENCHMARK = Benchmark(run, EPILOG)
