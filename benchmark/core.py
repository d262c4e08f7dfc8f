# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a sample costs in the pipeline, beside a filter's step; and the fractional integral.

Times are those of the process, the least of several, so that other work on the machine counts
little: a sample at 1 kHz, ten to a block, in the air and in contact, beside a step of filterpy's
extended Kalman filter with four states. Then the integral of order 0.131 of a ramp and hold,
sample by sample at 1 kHz, by this package's sum of exponentials and by the streaming filter of the
package fracmem, which is made for one history and a fixed step. Needs the extra `benchmark`.
"""

from __future__ import annotations

import argparse
import importlib
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.special import gamma

from benchmark.harness import Benchmark, Report, Table, at_least, at_most, undecided
from fden_ros.core.arrays import Array
from fden_ros.core.law.fractional_integral import FractionalIntegral
from fden_ros.core.pipeline import Pipeline
from fden_ros.errors import InputError
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.scenario import ramp_scenario
from fden_ros.simulation.simulate import simulate

EPILOG = """\
examples:
  fden benchmark core --quick               histories to 1e4
  fden benchmark core -o results            to 1e5
"""

_ORDER, _STEP = 0.131, 1e-3
HISTORIES, QUICK_HISTORIES = (1_000, 10_000, 100_000), (1_000, 10_000)
_RAMP_SHARE = 0.3
#: Samples of a timing, and timings of which the least counts.
_TIMED, _REPEATS = 200, 40
FDEN, FRACMEM = "fden", "fracmem"


def run(args: argparse.Namespace) -> Report:
    """Measure.

    Raises
    ------
    InputError
        If the package to compare with is not installed.
    """
    try:
        fracmem = importlib.import_module("fracmem")
    except ImportError:
        raise InputError("fracmem is not installed: pip install fden_ros[benchmark]") from None
    histories = QUICK_HISTORIES if args.quick else HISTORIES
    rows = {
        f"{name}, {history:,} samples": method(history)
        for history in histories
        for name, method in ((FDEN, _own), (FRACMEM, lambda n: _fracmem(n, fracmem)))
    }
    steps = _steps()
    pairs = [[rows[f"{name}, {n:,} samples"] for n in histories] for name in (FDEN, FRACMEM)]
    growth = [pairs[0][-1][key] / pairs[0][0][key] for key in ("us a sample", "state [kB]")]
    ratios = [own["us a sample"] / other["us a sample"] for own, other in zip(*pairs, strict=True)]
    better = [other["error"] / own["error"] for own, other in zip(*pairs, strict=True)]
    times = [
        at_most("integral: time over fracmem's", max(ratios), 1.0),
        at_most("integral: time after the longest history over the shortest", growth[0], 1.05),
    ]
    return Report(
        [
            at_least("integral: fracmem's error over ours", min(better), 1e4),
            at_most("integral: memory, likewise", growth[1], 1.05),
            *(undecided(times) if args.quick else times),
        ],
        {
            "steps": Table("One sample at 1 kHz, ten to a block", steps, {"us": None}),
            "integral": Table(
                "Integral of order 0.131", rows, {"us a sample": None, "error": None}
            ),
        },
    )


def _least(action: Callable[[], object], samples: int = 1, repeats: int = _REPEATS) -> float:
    """Return the least time of an action per sample [us]."""
    least = math.inf
    for _ in range(repeats):
        begin = time.process_time_ns()
        action()
        least = min(least, time.process_time_ns() - begin)
    return 1e-3 * least / samples


def _steps() -> dict[str, dict[str, float]]:
    """Return what a sample and a step cost [us], and how many steps a sample is."""
    recording = simulate(ramp_scenario(strain_rate=0.1, max_strain=0.25, hold_s=1.0, seed=1))
    config = pipeline_config(check(recording.truth["identifier_parameters"]))
    stamps = recording.force.stamp_ns.tolist()
    values = (recording.force.value.tolist(), recording.displacement.value.tolist())
    samples = list(zip(stamps, *values, strict=True))
    air = sum(stamp < recording.truth["contacts"][0]["start_ns"] for stamp in stamps)
    used: dict[str, list[float]] = {"in the air": [], "in contact": []}
    for _ in range(3):
        pipeline = Pipeline(config, lambda output: None)
        parts = (samples[:air], samples[air : air + 2500])
        for name, part in zip(used, parts, strict=True):
            begin = time.process_time_ns()
            for stamp, force, displacement in part:
                pipeline.add_displacement(stamp, displacement)
                pipeline.add_force(stamp, force)
            used[name].append(1e-3 * (time.process_time_ns() - begin) / len(part))
    ekf = ExtendedKalmanFilter(dim_x=4, dim_z=1)
    row = np.ones((1, 4))

    def step() -> None:
        ekf.predict()
        ekf.update(np.zeros(1), lambda x: row, lambda x: row @ x)

    found = {name: min(times) for name, times in used.items()}
    found["step of filterpy's EKF"] = _least(step, 1, 500)
    reference = found["step of filterpy's EKF"]
    return {
        name: {"us": value, "over the EKF": value / reference} for name, value in found.items()
    }


def _ramp_and_hold(history: int) -> tuple[Array, Array]:
    """Return a ramp to 1 in the first part of a history, then constant, and its integral."""
    times = _STEP * np.arange(1.0, history + 1.0)
    turn, exponent = _STEP * round(_RAMP_SHARE * history), _ORDER + 1.0
    ramp = times**exponent - np.maximum(times - turn, 0.0) ** exponent
    return np.minimum(times / turn, 1.0), ramp / (turn * gamma(exponent + 1.0))


def _measured(history: int, take: Callable[[float], float], state: object) -> dict[str, float]:
    values, exact = _ramp_and_hold(history)
    kept = [take(value) for value in values.tolist()][-_TIMED:]
    last = values[-_TIMED:].tolist()
    return {
        "us a sample": _least(lambda: [take(value) for value in last], _TIMED),
        "state [kB]": _state_size(state),
        "error": float(np.max(np.abs(np.array(kept) - exact[-_TIMED:])) / exact.max()),
    }


def _own(history: int) -> dict[str, float]:
    integral = FractionalIntegral([_ORDER])
    integral.start(0.0)
    return _measured(history, lambda value: float(integral.advance(_STEP, value)[0]), integral)


def _fracmem(history: int, fracmem: Any) -> dict[str, float]:
    made = fracmem.CompressedFractionalFilter.from_analytic(
        -_ORDER, _STEP, L=32, p=16, j_max=max(history, 2000)
    )
    stream = made.reset_stream()
    return _measured(history, stream.step, stream)


def _state_size(state: object) -> float:
    """Return the size of an object's arrays and lists of numbers [kB]."""
    values: Sequence[Any] = list(vars(state).values())
    arrays = sum(value.nbytes for value in values if isinstance(value, np.ndarray))
    lists = sum(8 * len(value) for value in values if isinstance(value, list))
    return (arrays + lists) / 1024.0


BENCHMARK = Benchmark(run, EPILOG)
