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

"""A sample through the pipeline and its stages, beside other fractional integrals and a filter.

The integral of order 0.131 of a ramp and hold, sample by sample at 1 kHz, by

fden          the sum of exponentials of this package, fixed and jittered steps
fracmem       the streaming filter of the package fracmem, for this history and a fixed step
GL            full-memory Gruenwald-Letnikov in numpy: a scalar product over the history
differint     the point function of the package `differint`
filterpy EKF  a step of an extended Kalman filter with four states, for comparison of times

over histories of 1e3 to 1e6 samples. Needs the extra `benchmark`.
"""

from __future__ import annotations

import argparse
import importlib
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import gamma

from fden_ros.benchmarks import Goal, Report, progress, within
from fden_ros.core.arrays import Array
from fden_ros.core.contact.detector import ContactConfig, ContactDetector
from fden_ros.core.estimation.estimator_config import Prior
from fden_ros.core.law.fractional_integral import FractionalIntegral
from fden_ros.core.law.geometry import FlatPunch
from fden_ros.core.law.interpolation import LogStiffnessGrid
from fden_ros.core.law.kernel import order_nodes
from fden_ros.core.law.stress_response import StressBasis
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.samples import Pair
from fden_ros.core.streams.synchronize import SynchronizeConfig, Synchronizer
from fden_ros.errors import InputError
from fden_ros.parameters import check, pipeline_config

if TYPE_CHECKING:
    from matplotlib.figure import Figure


EPILOG = """\
examples:
  fden benchmark core --quick               histories to 1e4
  fden benchmark core -o results            to 1e6, some minutes

Times are those of the process, the least of several, so that other work on the machine counts
little.
"""

_ORDER, _STEP = 0.131, 1e-3
_HISTORIES, _QUICK_HISTORIES = (1_000, 10_000, 100_000, 1_000_000), (1_000, 10_000)
_RAMP_SHARE, _JITTER = 0.3, 0.1
#: Samples of a timing, and timings of which the least counts.
_TIMED, _REPEATS = 200, 40
_DIFFERINT_POINTS = 100_000
FDEN, JITTERED, FRACMEM, GL, DIFFERINT = "fden", "fden, jitter", "fracmem", "GL", "differint"
_COLOURS = {FDEN: "C0", JITTERED: "C0", FRACMEM: "C1", GL: "C2", DIFFERINT: "0.5"}


@dataclass(frozen=True)
class Measured:
    """One method after one history."""

    method: str
    history: int  #: samples
    microseconds: float  #: per sample
    kilobytes: float  #: of state
    error: float  #: at the end, over the peak


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmark's arguments."""
    parser.epilog = EPILOG


def run(args: argparse.Namespace) -> Report:
    """Measure.

    Raises
    ------
    InputError
        If the packages to compare with are not installed.
    """
    try:
        differint = importlib.import_module("differint.differint")
        fracmem = importlib.import_module("fracmem")
    except ImportError as error:
        raise InputError(
            f"{error.name} is not installed: pip install fden_ros[benchmark]"
        ) from None
    histories = _QUICK_HISTORIES if args.quick else _HISTORIES
    figures: list[Measured] = []
    with progress("histories", 5 * len(histories)) as step:
        for history in histories:
            for measured in (
                lambda n: _own(n, 0.0),
                lambda n: _own(n, _JITTER),
                lambda n: _fracmem(n, fracmem),
                _full_memory,
                lambda n: _differint(n, differint),
            ):
                if (figure := measured(history)) is not None:
                    figures.append(figure)
                step()
    growth = _growth(histories[0], histories[-1])
    stages = _stages()
    return Report(
        _goals(figures, growth, args.quick),
        {
            "methods": [asdict(figure) for figure in figures],
            "stages_microseconds": stages,
            "growth": growth,
            "histories": histories,
        },
        lambda figure: _draw(figures, figure),
        [_method_table(figures), _stage_table(stages)],
    )


# Signals


def _times(count: int, jitter: float) -> Array:
    times = _STEP * np.arange(1.0, count + 1.0)
    if jitter:
        times += jitter * _STEP * np.random.default_rng(1).uniform(-1.0, 1.0, count)
    return times


def _ramp_and_hold(times: Array) -> Array:
    """Up to 1 in the first part of the history, rounded to a sample, then constant."""
    return np.minimum(times / _turn(times.size), 1.0)


def _turn(count: int) -> float:
    return _STEP * round(_RAMP_SHARE * count)


def _exact(times: Array) -> Array:
    """Return the integral of the ramp and hold."""
    turn, exponent = _turn(times.size), _ORDER + 1.0
    ramp = times**exponent - np.maximum(times - turn, 0.0) ** exponent
    result: Array = ramp / (turn * gamma(exponent + 1.0))
    return result


def _error(values: Sequence[float] | Array, times: Array) -> float:
    exact = _exact(times)
    tail = np.asarray(values)
    return float(np.max(np.abs(tail - exact[-tail.size :])) / np.max(np.abs(exact)))


def _least(action: Callable[[], object], samples: int = 1, repeats: int = _REPEATS) -> float:
    """Return the least time of an action per sample [us]."""
    least = math.inf
    for _ in range(repeats):
        begin = time.process_time_ns()
        action()
        least = min(least, time.process_time_ns() - begin)
    return 1e-3 * least / samples


# Methods


def _own(history: int, jitter: float) -> Measured:
    times = _times(history, jitter)
    integral = FractionalIntegral([_ORDER])
    integral.start(0.0)
    if jitter:
        # The corner of the ramp is a sample: between samples no method knows of it.
        times[np.searchsorted(times, _turn(history))] = _turn(history)
    values = _ramp_and_hold(times)
    steps = np.diff(times, prepend=0.0) if jitter else np.full(history, _STEP)
    kept = [
        float(integral.advance(step, value)[0])
        for step, value in zip(steps.tolist(), values.tolist(), strict=True)
    ][-_TIMED:]
    last = list(zip(steps[-_TIMED:].tolist(), values[-_TIMED:].tolist(), strict=True))

    def again() -> None:
        for step, value in last:
            integral.advance(step, value)

    size = _state_size(integral)
    name = JITTERED if jitter else FDEN
    return Measured(name, history, _least(again, _TIMED), size, _error(kept, times))


def _state_size(state: object) -> float:
    """Return the size of an object's arrays and lists of numbers [kB]."""
    values = vars(state).values()
    arrays = sum(value.nbytes for value in values if isinstance(value, np.ndarray))
    lists = sum(8 * len(value) for value in values if isinstance(value, list))
    return (arrays + lists) / 1024.0


def _fracmem(history: int, fracmem: Any) -> Measured:
    times = _times(history, 0.0)
    stream = fracmem.CompressedFractionalFilter.from_analytic(
        -_ORDER, _STEP, L=32, p=16, j_max=max(history, 2000)
    ).reset_stream()
    values = _ramp_and_hold(times).tolist()
    kept = [stream.step(value) for value in values][-_TIMED:]
    last = values[-_TIMED:]
    used = _least(lambda: [stream.step(value) for value in last], _TIMED)
    return Measured(FRACMEM, history, used, _state_size(stream), _error(kept, times))


def _full_memory(history: int) -> Measured:
    """Gruenwald-Letnikov: sum of w_j f_{n-j}, w_j = w_{j-1} (1 - (1 - beta)/j)."""
    times = _times(history, 0.0)
    values = _ramp_and_hold(times)
    weights = np.cumprod(
        np.concatenate([[1.0], 1.0 - (1.0 - _ORDER) / np.arange(1.0, float(history))])
    )
    scale = _STEP**_ORDER
    used = _least(lambda: scale * (weights @ values[::-1]), 1, 10)
    result = scale * float(weights @ values[::-1])
    size = (values.nbytes + weights.nbytes) / 1024.0
    return Measured(GL, history, used, size, _error([result], times))


def _differint(history: int, differint: Any) -> Measured | None:
    if history > _DIFFERINT_POINTS:
        return None
    times = np.concatenate([[0.0], _times(history - 1, 0.0)])
    values = np.minimum(times / _turn(history), 1.0)
    result = math.nan

    def point() -> None:
        nonlocal result
        result = float(differint.GLpoint(-_ORDER, values, 0.0, float(times[-1]), history))

    used = _least(point, 1, 2)
    exact = _exact(np.concatenate([times[1:], [times[-1]]]))
    error = abs(result - float(exact[-1])) / float(np.max(np.abs(exact)))
    return Measured(DIFFERINT, history, used, values.nbytes / 1024.0, error)


def _growth(short: int, long: int) -> dict[str, float]:
    """Return time and memory per sample after a long over those after a short history.

    Of both in turn, so that whatever else the machine does counts for both.
    """
    integrals = []
    for history in (short, long):
        integral = FractionalIntegral([_ORDER])
        integral.start(0.0)
        for value in _ramp_and_hold(_times(history, 0.0)).tolist():
            integral.advance(_STEP, value)
        integrals.append(integral)
    least = [math.inf, math.inf]

    def again(integral: FractionalIntegral) -> None:
        for _ in range(_TIMED):
            integral.advance(_STEP, 1.0)

    for _ in range(10 * _REPEATS):
        for which, integral in enumerate(integrals):
            begin = time.process_time_ns()
            again(integral)
            least[which] = min(least[which], time.process_time_ns() - begin)
    return {
        "time": least[1] / least[0],
        "memory": _state_size(integrals[1]) / _state_size(integrals[0]),
    }


# Stages


def _stages() -> dict[str, float]:
    """Return the time of a sample through each stage alone, and through all of it [us]."""
    from fden_ros.simulation.scenario import ramp_scenario
    from fden_ros.simulation.simulate import simulate

    recording = simulate(ramp_scenario(strain_rate=0.1, max_strain=0.25, hold_s=1.0, seed=1))
    parameters = check(recording.truth["identifier_parameters"])
    streams = (recording.force, recording.displacement)
    stamps, forces = (x.tolist() for x in (streams[0].stamp_ns, streams[0].value))
    displacements = streams[1].value.tolist()
    start = recording.truth["contacts"][0]["start_ns"]
    air = sum(stamp < start for stamp in stamps)
    samples = list(zip(stamps, forces, displacements, strict=True))

    def whole() -> tuple[float, float]:
        pipeline = Pipeline(pipeline_config(parameters), lambda output: None)
        used = []
        for part in (samples[:air], samples[air : air + 2500]):
            begin = time.process_time_ns()
            for stamp, force, displacement in part:
                pipeline.add_displacement(stamp, displacement)
                pipeline.add_force(stamp, force)
            used.append(1e-3 * (time.process_time_ns() - begin) / len(part))
        return used[0], used[1]

    runs = [whole() for _ in range(3)]
    return {
        "pairing": _pairing(samples[:air]),
        "contact detection": _detection(samples[:air]),
        "fractional integral, 14 orders": _integral(),
        "response of the law at all nodes": _responses(),
        "all of it in the air": min(run[0] for run in runs),
        "all of it in contact": min(run[1] for run in runs),
        "filterpy EKF step": _ekf(),
    }


def _pairing(samples: Iterable[tuple[int, float, float]]) -> float:
    chosen = list(samples)

    def action() -> None:
        synchronizer = Synchronizer(SynchronizeConfig(), lambda pair: None, Counter())
        for stamp, force, displacement in chosen:
            synchronizer.add_displacement(stamp, displacement)
            synchronizer.add_force(stamp, force)

    return _least(action, len(chosen), 5)


def _detection(samples: Iterable[tuple[int, float, float]]) -> float:
    pairs = [Pair(0, stamp, force, depth, None) for stamp, force, depth in samples]

    def action() -> None:
        detector = ContactDetector(ContactConfig(), _ORDER)
        for pair in pairs:
            detector.add(pair)

    return _least(action, len(pairs), 5)


def _integral() -> float:
    integral = FractionalIntegral((_ORDER, _ORDER + 0.005, _ORDER - 0.005, *order_nodes()))
    integral.start(0.0)

    def action() -> None:
        for k in range(_TIMED):
            integral.add(_STEP, float(k))
            if k % 10 == 9:
                integral.take_sum()

    return _least(action, _TIMED)


def _responses() -> float:
    nodes = LogStiffnessGrid(math.log(Prior().nonlinear_stiffness), 2.0).nodes
    basis = StressBasis(FlatPunch(1e-4, 0.02), nodes, np.linspace(-0.003, 0.003, 3))

    def action() -> None:
        for k in range(_TIMED):
            basis.press(_STEP, 1e-3 * k)
            if k % 10 == 9:
                basis.take_block()

    return _least(action, _TIMED)


def _ekf() -> float:
    from filterpy.kalman import ExtendedKalmanFilter

    ekf = ExtendedKalmanFilter(dim_x=4, dim_z=1)
    row = np.ones((1, 4))

    def action() -> None:
        ekf.predict()
        ekf.update(np.zeros(1), lambda x: row, lambda x: row @ x)

    return _least(action, 1, 500)


# Report


def _by(figures: Sequence[Measured], method: str) -> list[Measured]:
    return [figure for figure in figures if figure.method == method]


def _goals(figures: Sequence[Measured], growth: dict[str, float], quick: bool) -> list[Goal]:
    own, jittered, other = (_by(figures, m) for m in (FDEN, JITTERED, FRACMEM))
    infinity = math.inf
    better = min(o.error / f.error for o, f in zip(other, own, strict=True))
    fixed, jitter = (
        max(f.microseconds / o.microseconds for o, f in zip(other, ours, strict=True))
        for ours in (own, jittered)
    )
    last = "1e4" if quick else "1e6"
    goals = [
        within("fracmem's error over ours", better, (1e4, infinity)),
        within("time over fracmem's, fixed step", fixed, (-infinity, 1.0)),
        within("time over fracmem's, jittered steps", jitter, (-infinity, 2.0)),
    ]
    for what, ratio in growth.items():
        goals.append(within(f"{what} per sample at {last} over 1e3", ratio, (-infinity, 1.05)))
    return goals


def _method_table(figures: Sequence[Measured]) -> Any:
    from rich import box
    from rich.table import Table

    table = Table(title="Fractional integral of order 0.131", box=box.SIMPLE_HEAD)
    table.add_column("")
    for name in ("history", "us/sample", "kB of state", "error"):
        table.add_column(name, justify="right")
    for method in dict.fromkeys(figure.method for figure in figures):
        for figure in _by(figures, method):
            table.add_row(
                method,
                f"{figure.history:.0e}".replace("e+0", "e"),
                f"{figure.microseconds:.3g}",
                f"{figure.kilobytes:.3g}",
                f"{figure.error:.1e}",
            )
    return table


def _stage_table(stages: dict[str, float]) -> Any:
    from rich import box
    from rich.table import Table

    table = Table(title="One sample at 1 kHz, ten to a block", box=box.SIMPLE_HEAD)
    table.add_column("stage")
    table.add_column("us", justify="right")
    for name, used in stages.items():
        table.add_row(name, f"{used:.1f}")
    return table


def _draw(figures: Sequence[Measured], figure: Figure) -> None:
    axes = figure.subplots(1, 3, sharex=True)
    what = (
        ("microseconds", "time per sample [µs]"),
        ("kilobytes", "state [kB]"),
        ("error", "error over peak"),
    )
    for ax, (name, label) in zip(axes, what, strict=True):
        for method in dict.fromkeys(f.method for f in figures):
            chosen = _by(figures, method)
            style = "o-" if method == FDEN else "s--" if method == JITTERED else ".-"
            ax.plot(
                [f.history for f in chosen],
                [max(getattr(f, name), 1e-17) for f in chosen],
                style,
                color=_COLOURS[method],
                label=method,
            )
        ax.set(xscale="log", yscale="log", xlabel="history [samples]", title=label)
        ax.grid(alpha=0.3)
    axes[0].legend()
