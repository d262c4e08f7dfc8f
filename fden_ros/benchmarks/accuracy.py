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

"""Errors of simulated contacts over the Bayesian Cramér-Rao bound, and honesty of the intervals.

Tissue drawn from the paper's Table II is pressed in simulation, the samples go through the whole
pipeline, and every contact's estimate is held against its truth and its own bound: same priors,
with alpha, strain origin and force bias unknown in it where the identifier does not know them.
Both observations of the identifier, the stress with the model's error learned from the data, and
the paper's own filter (Appendix D) stand beside each other.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fden_ros.benchmarks import TWO_SIDED_95, Goal, Report, progress, within
from fden_ros.benchmarks.processes import completed
from fden_ros.benchmarks.selection import chosen
from fden_ros.benchmarks.simulated import (
    APPENDIX_D,
    FRACTIONAL_STRESS,
    MODEL_ERROR_LEARNED,
    STRESS,
    Case,
    Group,
    Outcome,
    Trial,
    run_trial,
)
from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.errors import InputError
from fden_ros.simulation.trajectory import Palpation, Ramp, RampHold, Sinusoid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.table import Table


EPILOG = """\
examples:
  fden benchmark accuracy --quick
  fden benchmark accuracy --cases ramp,hold_alpha_0.32 --contacts 200
  fden benchmark accuracy --methods stress --json | jq '.figures.cases[].name'

1,000 contacts a case take hours; fewer leave goals undecided where the confidence interval of
the figure (95 %, bootstrap) reaches across its limit.
"""

METHODS = (STRESS, MODEL_ERROR_LEARNED, FRACTIONAL_STRESS, APPENDIX_D)

_SPARSE = {"estimate.period": 0.03}
_HOLD = RampHold(0.5, 0.25, 2.0)
_PALPATION = Palpation(0.5, 0.25, 0.3, presses=3, pause_s=0.3)
_SINUSOID = Sinusoid(0.5, 0.2, 0.02, 1.0, 3)
#: So wide that the probe leaves the tissue in every trough.
_WIDE_SINUSOID = Sinusoid(0.5, 0.18, 0.06, 1.0, 3)

CASES = (
    Case("ramp", Ramp(1.0, 0.25), is_quick=True),
    Case("ramp_alpha_0.32", Ramp(1.0, 0.25), 0.32, is_quick=True),
    Case("ramp_origin_given", Ramp(1.0, 0.25), gives_origin=True),
    Case("slow_ramp", Ramp(0.1, 0.25), rate_hz=200.0, parameters=_SPARSE),
    Case("slow_ramp_alpha_0.32", Ramp(0.1, 0.25), 0.32, rate_hz=200.0, parameters=_SPARSE),
    Case(
        "fast_sensor",
        Ramp(1.0, 0.25),
        rate_hz=5000.0,
        noise_pa=5.0,
        jitter_s=2e-5,
        start_pause_s=1.0,
    ),
    Case("slow_sensor", Ramp(0.5, 0.25), rate_hz=100.0, noise_pa=1.0, jitter_s=1e-3),
    Case("hold_given_alpha_0.32", _HOLD, 0.32, rate_hz=200.0, parameters=_SPARSE),
    Case("palpation", _PALPATION, rate_hz=200.0, parameters=_SPARSE),
    Case("palpation_alpha_0.32", _PALPATION, 0.32, rate_hz=200.0, parameters=_SPARSE),
    Case("sinusoid", _SINUSOID, rate_hz=200.0, parameters=_SPARSE),
    Case("sinusoid_alpha_0.32", _SINUSOID, 0.32, rate_hz=200.0, parameters=_SPARSE, is_quick=True),
    Case(
        "contact_lost_alpha_0.32",
        _WIDE_SINUSOID,
        0.32,
        rate_hz=200.0,
        parameters=_SPARSE,
    ),
    Case(
        "hold",
        _HOLD,
        learns_alpha=True,
        rate_hz=200.0,
        parameters=_SPARSE,
        group=Group.LEARNED,
        is_quick=True,
    ),
    Case(
        "hold_alpha_0.32",
        _HOLD,
        0.32,
        learns_alpha=True,
        rate_hz=200.0,
        parameters=_SPARSE,
        group=Group.LEARNED,
        is_quick=True,
    ),
    Case(
        "hold_1_khz",
        RampHold(0.5, 0.25, 1.0),
        learns_alpha=True,
        jitter_s=5e-5,
        group=Group.LEARNED,
    ),
    Case(
        "ten_palpations",
        Palpation(0.5, 0.25, 0.3, presses=10, pause_s=0.3),
        learns_alpha=True,
        rate_hz=100.0,
        parameters=_SPARSE,
        group=Group.LEARNED,
    ),
    Case(
        "ten_palpations_alpha_0.32",
        Palpation(0.5, 0.25, 0.3, presses=10, pause_s=0.3),
        0.32,
        learns_alpha=True,
        rate_hz=100.0,
        parameters=_SPARSE,
        group=Group.LEARNED,
    ),
    Case("below_boundary", Ramp(0.5, 0.06), group=Group.HONEST),
    Case("ramp_alpha_unknown", Ramp(1.0, 0.25), learns_alpha=True, group=Group.HONEST),
    Case("ten_samples", Ramp(2.5, 0.25), rate_hz=100.0, noise_pa=1.0, group=Group.HONEST),
    Case("alpha_one_sd_wrong", Ramp(1.0, 0.25), alpha_off_sd=0.011, group=Group.HONEST),
)

#: A run of at least this number of contacts decides by the figure itself, a shorter one by its
#: interval.
_ENOUGH = 1000
_QUICK_CONTACTS = 6
_TRIALS_PER_TASK = 3
_RESAMPLES = 1000
_CONFIDENCE = 0.95
_WILD_DEVIATIONS = 5.0
_NAMES = ("log_g", "log_gn", "alpha", "origin")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmark's own arguments."""
    parser.epilog = EPILOG
    parser.add_argument(
        "--contacts", type=int, metavar="N", help=f"contacts a case (default: {_ENOUGH})"
    )
    parser.add_argument(
        "--cases", metavar="A,B", help="names of the cases (default: all; --quick: a few)"
    )
    parser.add_argument(
        "--methods",
        metavar="A,B",
        default=",".join(METHODS),
        help=f"estimators to compare (default: {','.join(METHODS)})",
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=os.cpu_count() or 1,
        metavar="N",
        help="processes (default: number of cores)",
    )


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify and judge."""
    default = [case.name for case in CASES if case.is_quick or not args.quick]
    cases = chosen(args.cases, {case.name: case for case in CASES}, "case", default)
    methods = tuple(chosen(args.methods, {name: name for name in METHODS}, "method", METHODS))
    contacts = args.contacts or (_QUICK_CONTACTS if args.quick else _ENOUGH)
    if contacts < 2 or args.workers < 1:
        raise InputError("--contacts must be at least 2 and --workers at least 1")
    trials = _run_trials(cases, methods, contacts, args.workers)
    results = [
        CaseResult(case, {method: measure(case, own, method) for method in methods}, contacts)
        for case, own in zip(cases, trials, strict=True)
    ]
    return Report(
        goals=goals_of(results),
        figures={
            "contacts": contacts,
            "default_observation": EstimatorConfig().observation.value,
            "cases": [result.json_object() for result in results],
        },
        tables=[_table(results, method) for method in methods],
        draw=lambda figure: _draw(figure, results),
    )


# Trials


def _run_trials(
    cases: Sequence[Case], methods: tuple[str, ...], contacts: int, workers: int
) -> list[list[Trial]]:
    """Return the trials of each case, in order, whatever the number of workers."""
    tasks = [
        (case, first, min(first + _TRIALS_PER_TASK, contacts))
        for case in cases
        for first in range(0, contacts, _TRIALS_PER_TASK)
    ]
    done: dict[tuple[str, int], list[Trial]] = {}
    with progress("contacts", len(tasks) * _TRIALS_PER_TASK) as advance:
        for (case, first, _), trials in completed(_run_task, tasks, methods, jobs=workers):
            done[case.name, first] = trials
            for _ in range(_TRIALS_PER_TASK):
                advance()
    return [
        [t for first in range(0, contacts, _TRIALS_PER_TASK) for t in done[case.name, first]]
        for case in cases
    ]


def _run_task(case: Case, first: int, end: int, methods: tuple[str, ...]) -> list[Trial]:
    return [run_trial(case, number, methods) for number in range(first, end)]


# Figures


@dataclass(frozen=True)
class Figure95:
    """A figure with its 95 % bootstrap interval; NaN where there is nothing to measure."""

    value: float
    low: float
    high: float

    @property
    def interval(self) -> tuple[float, float]:
        """Both ends."""
        return self.low, self.high


@dataclass(frozen=True)
class Measured:
    """One estimator on one case.

    Parameters
    ----------
    ratio : mapping
        Parameter to root mean squared error over bound.
    bias : mapping
        Parameter to mean error.
    coverage : mapping
        Parameter to the share of contacts whose 95 % interval holds the truth.
    nees : Figure95
        Normalised estimation error squared, per dimension.
    failures, converged : float
        Shares of the contacts; failed: no estimate, or off by more than a factor of 1.5.
    time_to_converge : float
        Median since the touch [s]; NaN if most never do.
    wild : int
        Contacts that end converged with a parameter more than five of its deviations off.
    """

    ratio: dict[str, Figure95]
    bias: dict[str, Figure95]
    coverage: dict[str, Figure95]
    nees: Figure95
    failures: float
    converged: float
    time_to_converge: float
    wild: int


@dataclass(frozen=True)
class CaseResult:
    """Every estimator on one case."""

    case: Case
    by_method: dict[str, Measured]
    contacts: int

    def json_object(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        case = self.case
        return {
            "name": case.name,
            "group": case.group.value,
            "press": case.press.kind,
            "alpha": case.alpha,
            "learns_alpha": case.learns_alpha,
            "rate_hz": case.rate_hz,
            "noise_pa": case.noise_pa,
            "jitter_s": case.jitter_s,
            "contacts": self.contacts,
            "methods": {name: asdict(measured) for name, measured in self.by_method.items()},
        }


def measure(case: Case, trials: Sequence[Trial], method: str) -> Measured:
    """Return the figures of one estimator over all trials of a case."""
    outcomes = [trial.outcomes[method] for trial in trials]
    found = [(t, o) for t, o in zip(trials, outcomes, strict=True) if o.found]
    names = _estimated(case, method)
    error = np.array([o.error for _, o in found]).reshape(-1, 4)
    deviation = np.array([_deviations(o) for _, o in found]).reshape(-1, 4)
    bound = np.array([t.bound[:4] for t, _ in found]).reshape(-1, 4)
    columns = {name: _NAMES.index(name) for name in names}
    waits = [o.time_to_converge for o in outcomes]
    wait = float(np.median(waits))
    honest = np.array([[_NAMES.index(n)] for n in names if n != "origin"]).ravel()
    far = np.any(np.abs(error[:, honest]) > _WILD_DEVIATIONS * deviation[:, honest], axis=1)
    return Measured(
        ratio={
            n: _bootstrapped(error[:, i] ** 2 / bound[:, i] ** 2, np.sqrt)
            for n, i in columns.items()
        },
        bias={n: _bootstrapped(error[:, i]) for n, i in columns.items()},
        coverage={
            n: _bootstrapped(np.abs(error[:, i]) <= TWO_SIDED_95 * deviation[:, i])
            for n, i in columns.items()
        },
        nees=_bootstrapped(np.array([_nees(o, honest.size) for _, o in found])),
        failures=float(np.mean([o.failed for o in outcomes])),
        converged=float(np.mean([o.converged for o in outcomes])),
        time_to_converge=wait if math.isfinite(wait) else math.nan,
        wild=int(np.sum(far & np.array([o.converged for _, o in found], dtype=bool))),
    )


def _estimated(case: Case, method: str) -> tuple[str, ...]:
    names = ["log_g", "log_gn"]
    if case.learns_alpha and method != APPENDIX_D:
        names.append("alpha")
    if not case.gives_origin and method != APPENDIX_D:
        names.append("origin")
    return tuple(names)


def _deviations(outcome: Outcome) -> Array:
    return np.append(np.sqrt(np.maximum(outcome.covariance.diagonal(), 0.0)), outcome.origin_sd)


def _nees(outcome: Outcome, size: int) -> float:
    error, covariance = outcome.error[:size], outcome.covariance[:size, :size]
    try:
        return float(error @ np.linalg.solve(covariance, error)) / size
    except np.linalg.LinAlgError:
        return math.inf


def _bootstrapped(values: Array, transform: Callable[[Any], Any] = lambda mean: mean) -> Figure95:
    """Return the transformed mean with its interval, contacts drawn anew with replacement."""
    if values.size < 2:
        return Figure95(math.nan, math.nan, math.nan)
    generator = np.random.default_rng(0)
    picks = generator.integers(values.size, size=(_RESAMPLES, values.size))
    means = transform(values[picks].mean(axis=1))
    tail = 0.5 * (1.0 - _CONFIDENCE)
    low, high = np.quantile(means, [tail, 1.0 - tail])
    return Figure95(float(transform(values.mean())), float(low), float(high))


# Goals


def goals_of(results: Sequence[CaseResult]) -> list[Goal]:
    """Hold the default observation against the goals, each over the worst of its cases."""
    given = [r for r in results if r.case.group is Group.GIVEN]
    learned = [r for r in results if r.case.group is Group.LEARNED]
    honest = [r for r in results if r.case.group is Group.HONEST]
    palpation = [r for r in results if r.case.name.startswith("ten_palpations")]
    goals = [
        _worst(f"alpha given: RMSE/CRLB of {label}", given, _ratio(name), (-math.inf, 1.10))
        for name, label in (("log_g", "ln G"), ("log_gn", "ln Gn"))
    ]
    goals += [
        _worst("alpha given: largest NEES per dimension", given, _nees_of, (0.9, 1.1)),
        _worst("alpha given: least NEES per dimension", given, _nees_of, (0.9, 1.1), least=True),
    ]
    goals += [
        _worst(f"alpha learned: RMSE/CRLB of {label}", learned, _ratio(name), (-math.inf, 1.15))
        for name, label in (("log_g", "ln G"), ("log_gn", "ln Gn"), ("alpha", "alpha"))
    ]
    goals.append(
        _worst("alpha learned: |bias of alpha|", learned, _bias("alpha"), (-math.inf, 0.001))
    )
    goals.append(
        _worst("strain origin: RMSE/CRLB", given + learned, _ratio("origin"), (-math.inf, 1.2))
    )
    goals += [
        _worst(f"ten palpations: |bias of {label}|", palpation, _bias(name), (-math.inf, 0.003))
        for name, label in (("log_g", "ln G"), ("log_gn", "ln Gn"))
    ]
    goals.append(
        _worst(
            "little to learn: coverage of the 95 % interval",
            honest,
            _coverage,
            (0.9, math.inf),
            least=True,
        )
    )
    goals += [
        _worst(
            f"model's error learned: RMSE/CRLB of {label}",
            given + learned,
            _ratio(name),
            (-math.inf, 1.25),
            method=MODEL_ERROR_LEARNED,
        )
        for name, label in (("log_g", "ln G"), ("log_gn", "ln Gn"), ("alpha", "alpha"))
    ]
    goals.append(_wild_goal(results))
    return goals


_DEFAULT = EstimatorConfig().observation.value


def _worst(
    name: str,
    results: Sequence[CaseResult],
    figure_of: Callable[[Measured], Figure95 | None],
    limits: tuple[float, float],
    *,
    least: bool = False,
    method: str = _DEFAULT,
) -> Goal:
    measured = [(r, m) for r in results if (m := r.by_method.get(method)) is not None]
    figures = [(f, r.contacts) for r, m in measured if (f := figure_of(m)) is not None]
    figures = [(f, n) for f, n in figures if math.isfinite(f.value)]
    if not figures:
        return within(name, math.nan, limits)
    figure, contacts = (min if least else max)(figures, key=lambda pair: pair[0].value)
    interval = None if contacts >= _ENOUGH else figure.interval
    return within(name, figure.value, limits, interval)


def _ratio(name: str) -> Callable[[Measured], Figure95 | None]:
    return lambda measured: measured.ratio.get(name)


def _nees_of(measured: Measured) -> Figure95:
    return measured.nees


def _bias(name: str) -> Callable[[Measured], Figure95 | None]:
    def magnitude(measured: Measured) -> Figure95 | None:
        bias = measured.bias.get(name)
        if bias is None or bias.value >= 0.0:
            return bias
        return Figure95(-bias.value, -bias.high, -bias.low)

    return magnitude


def _coverage(measured: Measured) -> Figure95:
    return min((f for n, f in measured.coverage.items() if n != "origin"), key=lambda f: f.value)


def _wild_goal(results: Sequence[CaseResult]) -> Goal:
    name = "contacts that end converged more than five deviations off"
    measured = [
        result.by_method[method]
        for result in results
        for method in (_DEFAULT, MODEL_ERROR_LEARNED)
        if method in result.by_method
    ]
    if not measured:
        return Goal(name, None, "0", None)
    wild = sum(m.wild for m in measured)
    enough = all(result.contacts >= _ENOUGH for result in results)
    return Goal(name, wild, "0", False if wild else True if enough else None)


# Table and picture


_LABELS = {"log_g": "ln G", "log_gn": "ln Gn", "alpha": "alpha", "origin": "origin"}
_TITLES = {
    STRESS: "observation: stress",
    MODEL_ERROR_LEARNED: "observation: stress; the model's error learned",
    FRACTIONAL_STRESS: "observation: fractional stress",
    APPENDIX_D: "the paper's Appendix D; alpha, origin and bias given",
}


def _table(results: Sequence[CaseResult], method: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(
        title=f"{_TITLES[method]}: RMSE over the Cramér-Rao bound, ± half of the 95 % interval",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("case", no_wrap=True)
    for label in (*_LABELS.values(), "NEES/n"):
        table.add_column(label, justify="right", no_wrap=True)
    for label in ("cover %", "fail %", "conv. %", "after s", "> 5 sd"):
        table.add_column(label, justify="right", no_wrap=True)
    for result in results:
        measured = result.by_method[method]
        limit = 1.15 if result.case.group is Group.LEARNED else 1.10
        table.add_row(
            result.case.name,
            *(
                _cell(measured.ratio.get(name), (0.0, 1.2 if name == "origin" else limit))
                for name in _LABELS
            ),
            _cell(measured.nees, (0.9, 1.1)),
            f"{100.0 * _coverage(measured).value:.1f}",
            f"{100.0 * measured.failures:.1f}",
            f"{100.0 * measured.converged:.0f}",
            "–" if math.isnan(measured.time_to_converge) else f"{measured.time_to_converge:.2f}",
            str(measured.wild) if measured.wild == 0 else f"[red]{measured.wild}[/red]",
        )
    return table


def _cell(figure: Figure95 | None, limits: tuple[float, float]) -> str:
    if figure is None or math.isnan(figure.value):
        return "–"
    if abs(figure.value) >= 100.0:
        return f"[red]{figure.value:.0f}[/red]"
    text = f"{figure.value:.2f} ±{0.5 * (figure.high - figure.low):.2f}"
    if figure.low > limits[1] or figure.high < limits[0]:
        return f"[red]{text}[/red]"
    return text if limits[0] <= figure.value <= limits[1] else f"[yellow]{text}[/yellow]"


_COLOURS = {
    STRESS: "#0b5fa5",
    MODEL_ERROR_LEARNED: "#1b9e77",
    FRACTIONAL_STRESS: "#c2410c",
    APPENDIX_D: "#8a8f98",
}
_MARKERS = {"log_g": "o", "log_gn": "s", "alpha": "D"}
_LARGEST_SHOWN = 100.0


def _draw(figure: Figure, results: Sequence[CaseResult]) -> None:
    figure.set_size_inches(13, 2.2 + 0.42 * len(results))
    figure.suptitle(
        f"Accuracy and honesty on simulated contacts, {results[0].contacts} a case", fontsize=13
    )
    errors, nees, coverage = figure.subplots(
        1, 3, sharey=True, gridspec_kw={"width_ratios": (2.2, 1, 1)}
    )
    rows = np.arange(len(results))[::-1]
    errors.set_yticks(rows, [result.case.name for result in results])
    errors.axvspan(0.0, 1.1, color="#e6f2e6", zorder=0)
    nees.axvspan(0.9, 1.1, color="#e6f2e6", zorder=0)
    coverage.axvspan(90.0, 100.0, color="#e6f2e6", zorder=0)
    for axes, where in ((errors, 1.0), (nees, 1.0), (coverage, 95.0)):
        axes.axvline(where, color="black", linewidth=0.8)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", color="#eeeeee")
        axes.set_axisbelow(True)
    methods = list(results[0].by_method)
    for number, method in enumerate(methods):
        shift = 0.25 * (0.5 * (len(methods) - 1) - number)
        for row, result in zip(rows + shift, results, strict=True):
            measured = result.by_method[method]
            for name, marker in _MARKERS.items():
                if (ratio := measured.ratio.get(name)) is not None:
                    _dot(errors, ratio, row, _COLOURS[method], marker)
            _dot(nees, measured.nees, row, _COLOURS[method], "o")
            covered = _coverage(measured)
            percent = Figure95(*(100.0 * v for v in (covered.value, *covered.interval)))
            _dot(coverage, percent, row, _COLOURS[method], "o")
    for axes, least in ((errors, 0.7), (nees, 0.3)):
        axes.set_xscale("log")
        axes.set_xlim(least, _LARGEST_SHOWN * 1.1)
    errors.set_xticks([1, 2, 5, 10, 100], ["1", "2", "5", "10", "≥ 100"])
    nees.set_xticks([0.5, 1, 2, 10, 100], ["0.5", "1", "2", "10", "≥ 100"])
    for axes in (errors, nees):
        axes.minorticks_off()
    coverage.set_xlim(0.0, 102.0)
    errors.set_xlabel("root mean squared error over the Cramér-Rao bound")
    nees.set_xlabel("NEES per dimension")
    coverage.set_xlabel("coverage of the 95 % interval [%]")
    _legend(figure, methods)


def _dot(axes: Axes, figure: Figure95, row: float, colour: str, marker: str) -> None:
    if math.isnan(figure.value):
        return
    value, low, high = (min(v, _LARGEST_SHOWN) for v in (figure.value, *figure.interval))
    axes.plot([low, high], [row, row], color=colour, linewidth=1.2, alpha=0.6)
    axes.plot([value], [row], marker, color=colour, markersize=5)


def _legend(figure: Figure, methods: Sequence[str]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=_COLOURS[method], linewidth=4, label=_TITLES[method])
        for method in methods
    ]
    handles += [
        Line2D([], [], color="black", linestyle="", marker=marker, label=_LABELS[name])
        for name, marker in _MARKERS.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
