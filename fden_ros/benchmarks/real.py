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

"""Measured tissue: from the ramp and the first 2 s of the hold, predict the rest of the hold.

Every test goes through the online pipeline sample by sample, and the same samples go to the
estimators of others. Nothing is fitted afterwards. A table of tests (CSV) has the columns test,
material, time_s, force_N, displacement_mm and gap_mm; each test is a ramp and a hold, the
displacement is 0 at contact, and the gap at contact is the thickness. The indenter's shape is not
known, so G comes in force units: N s^alpha.

FDEN appears three times: with wide priors, with the prior of alpha learned from the other
specimens of the same material, and with that alpha given. A specimen is the first word of a test's
name, so that other places of one piece of meat do not count as others.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fden_ros.benchmarks import TWO_SIDED_95, Goal, Report, progress, within
from fden_ros.benchmarks.hold_order import hold_order
from fden_ros.benchmarks.measured_tests import SEEN_HOLD, Test, read_tests
from fden_ros.benchmarks.peers import (
    DiolaitiHuntCrossley,
    HaddadiHuntCrossley,
    KelvinVoigt,
    LastValue,
    LinearFractional,
    Peer,
)
from fden_ros.control.prediction import Predictor
from fden_ros.control.tissue_memory import TissueMemory
from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact.detector import ContactConfig
from fden_ros.core.estimation.estimate import Estimate, StateIndex
from fden_ros.core.estimation.estimator_config import EstimatorConfig, Prior, Uncertainty
from fden_ros.core.law.geometry import FlatPunch
from fden_ros.core.outputs import ContactSummary, Flag, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.errors import InputError
from fden_ros.simulation.closed_form import FdenModel, stress_of_piecewise_linear_strain
from fden_ros.tissues.library import load_library

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.table import Table


EPILOG = """\
examples:
  fden benchmark real measured/                     every CSV in the folder that is such a table
  FDEN_DATA=measured fden benchmark real --quick    a few tests of each material
  fden benchmark real measured/ --json | jq '.figures.methods'

Columns: test, material, time_s, force_N, displacement_mm, gap_mm (others are ignored).
"""

DATA_VARIABLE = "FDEN_DATA"
#: Materials by the beginning of their name: which the model describes, and which it does not.
TISSUE, NOT_TISSUE = "beef", "silicone"

#: The force noise of these tests, as their README states it [N].
_FORCE_NOISE = 1e-3
#: The default prior, for G in N s^alpha as of a face of 1 cm^2.
_WIDE = replace(Prior(), linear_stiffness=1e-4 * Prior().linear_stiffness)
_LEAST_ORDER_SD = 0.005
#: Deviation of a parameter that is given [1]: it does not move.
_TINY_DEVIATION = 1e-9
#: Deviation of ln Gn of a converged estimate [1]: the default of `converged.log_sd`.
_CONVERGED_LOG_SD = 0.1
#: And that of an order that counts as known [1]: the default of `converged.alpha_sd`.
_KNOWN_ORDER_SD = 0.05
#: A testing machine: its rig leaves nothing out, the law does as on any tissue.
_MACHINE = Uncertainty(kernel_sd=0.05, characteristic_sd=0.2)
_NANOSECONDS = 1_000_000_000
#: Tests of each material, and simulated contacts, with --quick and without.
_QUICK_TESTS, _QUICK_SIMULATED, _SIMULATED = 4, 20, 300
#: Largest share of presses with a mismatch where the model is right [1].
FALSE_ALARMS = 0.01
#: Forgetting of the estimators that forget: a time constant of 1 s.
_FORGETTING_TIME = 1.0

FREE, LEARNED, GIVEN = (
    "FDEN, wide priors",
    "FDEN, alpha's prior of others",
    "FDEN, alpha given by others",
)


@dataclass(frozen=True)
class Outcome:
    """What FDEN made of one test."""

    predicted: Array  #: [N], shape (m,)
    predicted_sd: Array  #: [N], shape (m,)
    error: float  #: RMS, in percent of the peak force
    coverage: float  #: share of the rest of the hold within the 95 % interval
    is_mismatch: bool  #: told as a mismatch from the whole record
    is_changed: bool  #: told as a tissue that changed within the contact, from the whole record
    is_converged: bool  #: by the whole record
    half_width: float  #: of the 95 % interval, median, in percent of the peak force
    #: (ln G, ln Gn, alpha) by what is seen less by the whole record, over the deviations of the
    #: former [1], shape (3,)
    moved: Array
    estimate: Estimate
    #: alpha by the whole record less that of the hold itself (`hold_order`), over the deviation of
    #: the former [1]
    order_off: float
    knows_order: bool  #: alpha has converged by the whole record
    #: The same of the relaxation's own order, and whether that is known as closely as alpha is to
    #: be: NaN where it is not.
    relaxation_off: float
    knows_relaxation: bool

    @property
    def order(self) -> float:
        """Fractional order [1]."""
        return self.estimate.fractional_order

    @property
    def order_sd(self) -> float:
        """Its standard deviation [1]."""
        return math.sqrt(self.estimate.covariance[2, 2])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmark's own arguments."""
    parser.epilog = EPILOG
    parser.add_argument(
        "data",
        nargs="?",
        type=Path,
        metavar="DIR",
        default=os.environ.get(DATA_VARIABLE),
        help=f"folder with the measured tests (default: the variable {DATA_VARIABLE})",
    )


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    if args.data is None:
        raise InputError(
            f"no data: name the folder with the measured tests, or set {DATA_VARIABLE}"
        )
    tests = read_tests(Path(args.data))
    if args.quick:
        tests = _some(tests)
    simulated = _QUICK_SIMULATED if args.quick else _SIMULATED
    with progress("measured tests", 4 * len(tests) + simulated) as advance:
        outcomes = _outcomes(tests, advance)
        errors = _peer_errors(tests)
        alarms = sum(_false_alarm(tests, seed, advance) for seed in range(simulated))
    for method, by_test in outcomes.items():
        errors[method] = {name: outcome.error for name, outcome in by_test.items()}
    return Report(
        goals=_goals(tests, outcomes, errors, (alarms, simulated), args.quick),
        figures=_figures(tests, outcomes, errors, (alarms, simulated)),
        draw=lambda figure: _draw(figure, tests, outcomes, errors),
        tables=[_table(kind, tests, outcomes, errors) for kind in _kinds(tests)],
    )


# Measuring


def _some(tests: Sequence[Test]) -> list[Test]:
    """Return a few tests of each kind, of as many specimens as possible."""
    chosen: list[Test] = []
    for kind in _kinds(tests):
        own = [test for test in tests if test.kind == kind]
        chosen += own[:: math.ceil(len(own) / _QUICK_TESTS)]
    return chosen


def _kinds(tests: Sequence[Test]) -> list[str]:
    return sorted({test.kind for test in tests})


# FDEN


def _outcomes(tests: Sequence[Test], advance: Callable[[], None]) -> dict[str, dict[str, Outcome]]:
    outcomes: dict[str, dict[str, Outcome]] = {FREE: {}, LEARNED: {}, GIVEN: {}}
    orders: dict[str, float] = {}
    for test in tests:
        orders[test.name] = identify(test, _WIDE, test.times.size)[0].fractional_order
        advance()
        outcomes[FREE][test.name] = predict(test, _WIDE)
        advance()
    for test in tests:
        others = [
            orders[other.name]
            for other in tests
            if other.kind == test.kind and other.specimen != test.specimen
        ]
        for method in (LEARNED, GIVEN):
            if len(others) > 1:
                prior = learned_prior(others)
                outcomes[method][test.name] = predict(test, prior, given=method == GIVEN)
            advance()
    return outcomes


def learned_prior(orders: Sequence[float]) -> Prior:
    """Return the wide prior with the mean and the spread of alpha over other specimens."""
    return Prior(
        _WIDE.linear_stiffness,
        _WIDE.linear_stiffness_log_sd,
        _WIDE.nonlinear_stiffness,
        _WIDE.nonlinear_stiffness_log_sd,
        float(np.mean(orders)),
        max(float(np.std(orders, ddof=1)), _LEAST_ORDER_SD),
    )


def identify(
    test: Test, prior: Prior, count: int, given: bool = False
) -> tuple[Estimate, TissueState]:
    """Run the pipeline over the first `count` samples; return estimate and last state.

    Raises
    ------
    InputError
        If the pipeline finds no contact that it can use.
    """
    last: list[TissueState] = []
    summaries: list[ContactSummary] = []

    def keep(output: Output) -> None:
        if isinstance(output, TissueState):
            last[:] = [output]
        elif isinstance(output, ContactSummary):
            summaries[:] = [output]

    pipeline = Pipeline(_config(test, prior, given), keep)
    stamps = np.round(test.times * _NANOSECONDS).astype(np.int64) + _NANOSECONDS
    for stamp, force, displacement in zip(
        stamps[:count].tolist(), test.forces.tolist(), test.displacements.tolist(), strict=False
    ):
        pipeline.add_displacement(stamp, displacement)
        pipeline.add_force(stamp, force)
    if not last or last[0].estimate is None:
        raise InputError(
            f"{test.name}: no estimate; the displacement must begin at 0, in contact or before it"
        )
    state, estimate = last[0], last[0].estimate
    pipeline.finish()
    # The end of the recording ends the contact: what is known then is in the summary.
    flags = summaries[0].flags if summaries else state.flags
    return estimate, replace(state, flags=flags)


def _config(test: Test, prior: Prior, given: bool) -> PipelineConfig:
    return PipelineConfig(
        library=load_library(),
        # Stress is force and G is in N s^alpha: the indenter's shape is not known.
        geometry=FlatPunch(area=1.0, thickness=test.thickness),
        # The recording begins in contact, so bias and noise cannot be measured in the air.
        contact=ContactConfig(measure_bias=False, force_noise=_FORCE_NOISE),
        estimator=EstimatorConfig(
            prior=prior,
            fractional_order_given=given,
            converged_log_sd=_CONVERGED_LOG_SD,
            uncertainty=_MACHINE,
        ),
        strain_origin=0.0,
    )


def predict(test: Test, prior: Prior, given: bool = False) -> Outcome:
    """Identify from what is seen of a test, and predict the rest from the measured motion."""
    seen = test.seen
    whole, last = identify(test, prior, test.times.size, given)
    estimate, state = identify(test, prior, seen, given)
    now = test.times[seen - 1]
    geometry = FlatPunch(area=1.0, thickness=test.thickness)
    memory = TissueMemory(geometry)
    strains = test.displacements[:seen] / test.thickness - estimate.strain_origin
    for step, strain, force in zip(
        np.diff(test.times[:seen]), strains[1:], test.forces[1:seen], strict=True
    ):
        memory.press(float(step), float(strain), float(force))
    predictor = Predictor(
        geometry,
        estimate,
        memory,
        float(test.forces[seen - 1]),
        state.innovation.variance if state.innovation is not None else _FORCE_NOISE**2,
        _MACHINE,
    )
    plan = test.displacements[seen:] - test.displacements[seen - 1]
    prediction = predictor.force(test.times[seen:] - now, plan)
    order = hold_order(test.times, test.forces, test.hold).order
    relaxation = whole.law_error
    inside = np.abs(prediction.value - test.forces[seen:]) <= TWO_SIDED_95 * prediction.sd
    return Outcome(
        predicted=prediction.value,
        predicted_sd=prediction.sd,
        error=test.error(prediction.value),
        coverage=float(np.mean(inside)),
        is_mismatch=bool(last.flags & Flag.MODEL_MISMATCH),
        is_changed=bool(last.flags & Flag.TISSUE_CHANGED),
        is_converged=whole.converged,
        half_width=TWO_SIDED_95 * 100.0 * float(np.median(prediction.sd)) / test.forces.max(),
        moved=(estimate.mean - whole.mean) / np.maximum(estimate.deviations, _TINY_DEVIATION),
        estimate=estimate,
        order_off=(whole.fractional_order - order)
        / max(whole.fractional_order_sd, _TINY_DEVIATION),
        knows_order=whole.knows(StateIndex.FRACTIONAL_ORDER),
        relaxation_off=(relaxation.order - order) / relaxation.order_sd
        if relaxation is not None
        else math.nan,
        knows_relaxation=relaxation is not None and relaxation.order_sd <= _KNOWN_ORDER_SD,
    )


def _false_alarm(tests: Sequence[Test], seed: int, advance: Callable[[], None]) -> bool:
    """Whether a simulated contact with the motion of a test is taken for a mismatch."""
    generator = np.random.default_rng(seed)
    test = tests[seed % len(tests)]
    model = FdenModel(
        linear_stiffness=1.0,
        nonlinear_stiffness=float(generator.uniform(5.0, 11.0)),
        fractional_order=float(generator.uniform(0.1, 0.4)),
    )
    times, thickness = test.times[: test.seen], test.thickness
    strains = np.maximum(test.displacements[: times.size], 0.0) / thickness
    strains[0] = 0.0
    forces = stress_of_piecewise_linear_strain(times, strains, times, model)
    forces *= test.forces.max() / forces.max()
    forces += generator.normal(0.0, _FORCE_NOISE, times.size)
    simulated = Test("simulated", "simulated", times, forces, strains * thickness, thickness)
    _, state = identify(simulated, _WIDE, times.size)
    advance()
    return bool(state.flags & (Flag.MODEL_MISMATCH | Flag.TISSUE_CHANGED))


# The others


def peers(interval: float) -> dict[str, Peer]:
    """Return the estimators of others, for samples so far apart [s]."""
    forgetting = math.exp(-interval / _FORGETTING_TIME)
    return {
        "last value": LastValue(),
        "linear fractional": LinearFractional(),
        "Kelvin-Voigt": KelvinVoigt(),
        "Kelvin-Voigt, forgets": KelvinVoigt(forgetting),
        "Hunt-Crossley, Diolaiti": DiolaitiHuntCrossley(),
        "Hunt-Crossley, Diolaiti, forgets": DiolaitiHuntCrossley(forgetting),
        "Hunt-Crossley, Haddadi": HaddadiHuntCrossley(),
        "Hunt-Crossley, Haddadi, forgets": HaddadiHuntCrossley(forgetting),
    }


def _peer_errors(tests: Sequence[Test]) -> dict[str, dict[str, float]]:
    errors: dict[str, dict[str, float]] = {}
    for test in tests:
        seen = test.seen
        for name, peer in peers(float(np.median(np.diff(test.times)))).items():
            peer.learn(test.times[:seen], test.displacements[:seen], test.forces[:seen])
            predicted = peer.predict(test.times[seen:], test.displacements[seen:])
            errors.setdefault(name, {})[test.name] = test.error(predicted)
    return errors


# What came out

_Errors = Mapping[str, Mapping[str, float]]
_ByMethod = Mapping[str, Mapping[str, Outcome]]


def _errors_of(kind: str, tests: Sequence[Test], by_test: Mapping[str, float]) -> Array:
    return np.array([by_test[t.name] for t in tests if t.kind == kind and t.name in by_test])


def _median(kind: str, tests: Sequence[Test], by_test: Mapping[str, float]) -> float:
    errors = _errors_of(kind, tests, by_test)
    return float(np.median(errors)) if errors.size else math.nan


def _goals(
    tests: Sequence[Test],
    outcomes: _ByMethod,
    errors: _Errors,
    alarms: tuple[int, int],
    quick: bool,
) -> list[Goal]:
    free, learned, given = (
        _median(TISSUE, tests, errors[method]) for method in (FREE, LEARNED, GIVEN)
    )
    best = min(
        (
            _median(TISSUE, tests, by_test)
            for name, by_test in errors.items()
            if name[:4] != "FDEN"
        ),
        default=math.nan,
    )
    silicone = [
        outcome
        for test in tests
        if test.kind == NOT_TISSUE and (outcome := outcomes[FREE].get(test.name)) is not None
    ]
    told = float(np.mean([o.is_mismatch for o in silicone])) if silicone else math.nan
    changed = float(np.mean([o.is_changed for o in silicone])) if silicone else math.nan
    beef = [
        outcome
        for test in tests
        if test.kind == TISSUE and (outcome := outcomes[FREE].get(test.name)) is not None
    ]
    width = float(np.median([o.half_width for o in beef])) if beef else math.nan
    moved = np.sqrt(np.mean([o.moved**2 for o in beef], axis=0)) if beef else np.full(3, math.nan)
    spread = np.median([o.estimate.deviations for o in beef], axis=0) if beef else moved
    covered = float(np.mean([o.coverage for o in silicone])) if silicone else math.nan
    rate = alarms[0] / alarms[1]
    false_alarms = within(
        "false alarms of mismatch, simulated contacts", rate, (0.0, FALSE_ALARMS)
    )
    if quick:
        # So few contacts cannot show so small a rate, and so few tests no median.
        false_alarms = Goal(false_alarms.name, rate, false_alarms.goal, None)
    return [
        within("beef: share converged, whole record", _share(beef, "is_converged"), (0.9, 1.0)),
        within(
            "beef: share told as changed, whole record", _share(beef, "is_changed"), (0.0, 0.02)
        ),
        within("beef, wide priors: median error, % of peak", free, (0.0, 2.5)),
        within(
            "beef, wide priors: 90th percentile of the error, % of peak",
            float(np.percentile(_errors_of(TISSUE, tests, errors[FREE]), 90.0)),
            (0.0, 5.0),
        ),
        within(
            "beef: coverage of the 95 % interval",
            float(np.mean([o.coverage for o in beef])),
            (0.88, 0.99),
        ),
        within("beef: half width of the interval over the median error", width / free, (0.0, 4.0)),
        *(
            within(
                f"beef: {name}, 2 s against the whole record, rms over deviation",
                value,
                (0.0, 1.5),
            )
            for name, value in zip(("ln G", "ln Gn", "alpha"), moved.tolist(), strict=True)
        ),
        within(
            "beef: alpha where it is known, whole record against the hold itself, rms",
            _order_off(beef),
            (0.0, 1.5),
        ),
        within(
            "beef: order of the relaxation from that of the hold, where known, RMS over deviation",
            _relaxation_off(beef),
            (0.0, 1.5),
        ),
        within("beef: deviation of ln Gn, median", float(spread[1]), (0.0, 0.1)),
        within("beef: deviation of alpha, median", float(spread[2]), (0.0, 0.05)),
        within("beef, alpha of others, given: median error, % of peak", given, (0.0, 3.0)),
        within("beef, alpha of others, learned on: median error, %", learned, (0.0, 3.0)),
        within("beef, wide priors: error over the best peer's", free / best, (0.0, 1.0)),
        within(
            "beef, alpha of others, given: error over the best peer's", given / best, (0.0, 1.0)
        ),
        within("silicone: share told as model mismatch", told, (0.9, 1.0)),
        within("silicone: share told as changed", changed, (0.0, 0.02)),
        within("silicone: coverage of the 95 % interval", covered, (0.9, math.inf)),
        false_alarms,
    ]


def _share(outcomes: Sequence[Outcome], name: str) -> float:
    return float(np.mean([getattr(o, name) for o in outcomes])) if outcomes else math.nan


def _order_off(outcomes: Sequence[Outcome]) -> float:
    """Return the root mean square of `order_off` where alpha is known; NaN: nowhere."""
    off = [outcome.order_off for outcome in outcomes if outcome.knows_order]
    return math.sqrt(float(np.mean(np.square(off)))) if off else math.nan


def _relaxation_off(outcomes: Sequence[Outcome]) -> float:
    """Return the same of `relaxation_off`."""
    off = [outcome.relaxation_off for outcome in outcomes if outcome.knows_relaxation]
    return math.sqrt(float(np.mean(np.square(off)))) if off else math.nan


def _figures(
    tests: Sequence[Test], outcomes: _ByMethod, errors: _Errors, alarms: tuple[int, int]
) -> dict[str, Any]:
    methods: dict[str, Any] = {}
    for kind in _kinds(tests):
        methods[kind] = {}
        for name, by_test in errors.items():
            own = _errors_of(kind, tests, by_test)
            if own.size:
                methods[kind][name] = {
                    "tests": own.size,
                    "median": np.median(own),
                    "percentile_90": np.percentile(own, 90.0),
                } | _own_figures(kind, tests, outcomes.get(name, {}))
    return {
        "methods": methods,
        "false_alarms": {"contacts": alarms[1], "alarms": alarms[0]},
        "force_noise_n": _FORCE_NOISE,
        "seen_hold_s": SEEN_HOLD,
        "tests": [
            {"test": test.name, "material": test.material, "error": errors[FREE][test.name]}
            | {"alpha": outcomes[FREE][test.name].order}
            for test in tests
        ],
    }


#: Figures that only FDEN has, null for the others.
_OF_FDEN = ("converged", "changed", "mismatch", "coverage", "half_width")


def _own_figures(
    kind: str, tests: Sequence[Test], by_test: Mapping[str, Outcome]
) -> dict[str, Any]:
    own = [by_test[t.name] for t in tests if t.kind == kind and t.name in by_test]
    if not own:
        # The others state no deviation, nor whether they have converged.
        return dict.fromkeys(_OF_FDEN)
    return {
        "converged": _share(own, "is_converged"),
        "changed": _share(own, "is_changed"),
        "mismatch": _share(own, "is_mismatch"),
        "coverage": float(np.mean([o.coverage for o in own])),
        "half_width": float(np.median([o.half_width for o in own])),
        "moved": np.sqrt(np.mean([o.moved**2 for o in own], axis=0)).tolist(),
        "order_known": _share(own, "knows_order"),
        "order_off": _order_off(own),
        "relaxation_known": _share(own, "knows_relaxation"),
        "relaxation_off": _relaxation_off(own),
        "alpha": float(np.median([o.order for o in own])),
        "alpha_sd": float(np.median([o.order_sd for o in own])),
    }


def _table(kind: str, tests: Sequence[Test], outcomes: _ByMethod, errors: _Errors) -> Table:
    from rich import box
    from rich.table import Table

    count = sum(test.kind == kind for test in tests)
    table = Table(
        title=f"{kind}, {count} tests: error of the rest of the hold, RMS in % of the peak force",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("method", no_wrap=True)
    for label in (
        "conv.",
        "changed",
        "mism.",
        "in 95 %",
        "± width",
        "moved",
        "alpha known",
        "off",
        "relaxation",
        "off",
        "median",
        "90 %",
        "alpha",
        "± sd",
    ):
        table.add_column(label, justify="right", no_wrap=True)
    for name, by_test in _by_median(kind, tests, errors):
        own = _errors_of(kind, tests, by_test)
        figures = _own_figures(kind, tests, outcomes.get(name, {}))
        errors_of = [f"{np.median(own):.2f}", f"{np.percentile(own, 90.0):.2f}"]
        if figures["converged"] is None:
            table.add_row(name, *[""] * 10, *errors_of)
            continue
        shares = ("converged", "changed", "mismatch", "coverage")
        cells = [f"{100 * figures[key]:.0f} %" for key in shares]
        cells.append(f"{figures['half_width']:.1f}")
        cells.append(" ".join(f"{value:.1f}" for value in figures["moved"]))
        cells.append(f"{100 * figures['order_known']:.0f} %")
        cells.append(f"{figures['order_off']:.1f}")
        cells.append(f"{100 * figures['relaxation_known']:.0f} %")
        cells.append(f"{figures['relaxation_off']:.1f}")
        last = [f"{figures[key]:.3f}" for key in ("alpha", "alpha_sd")]
        table.add_row(name, *cells, *errors_of, *last)
    return table


def _by_median(
    kind: str, tests: Sequence[Test], errors: _Errors
) -> list[tuple[str, Mapping[str, float]]]:
    """Return the methods that have errors of a kind, the best first."""
    own = [item for item in errors.items() if _errors_of(kind, tests, item[1]).size]
    return sorted(own, key=lambda item: _median(kind, tests, item[1]))


# The picture

_COLORS = {FREE: "#1f77b4", LEARNED: "#d95f02", GIVEN: "#1b9e77"}


def _draw(figure: Figure, tests: Sequence[Test], outcomes: _ByMethod, errors: _Errors) -> None:
    kinds = _kinds(tests)
    figure.set_size_inches(14, 4.4 * len(kinds))
    figure.suptitle(
        "From the ramp and 2 s of the hold, the rest of the hold: measured and predicted",
        fontsize=13,
    )
    axes = figure.subplots(len(kinds), 3, squeeze=False, gridspec_kw={"width_ratios": (1, 1, 1.3)})
    for row, kind in zip(axes, kinds, strict=True):
        own = sorted(
            (test for test in tests if test.kind == kind),
            key=lambda test: errors[FREE][test.name],
        )
        typical, worse = own[len(own) // 2], own[min(9 * len(own) // 10, len(own) - 1)]
        _draw_test(row[0], typical, outcomes, "the median test")
        _draw_test(row[1], worse, outcomes, "one of the worst tenth")
        _draw_errors(row[2], kind, tests, errors)


def _draw_test(axes: Axes, test: Test, outcomes: _ByMethod, which: str) -> None:
    seen = test.seen
    axes.plot(test.times, test.forces, color="0.15", linewidth=1.6, label="measured")
    axes.axvspan(0.0, test.times[seen - 1], color="0.94", zorder=0)
    axes.text(0.02, 0.96, "seen", transform=axes.transAxes, va="top", color="0.45")
    for method, color in _COLORS.items():
        outcome = outcomes[method].get(test.name)
        if outcome is None or method == LEARNED:
            continue
        axes.plot(test.times[seen:], outcome.predicted, color=color, linewidth=1.6, label=method)
        reach = TWO_SIDED_95 * outcome.predicted_sd
        axes.fill_between(
            test.times[seen:],
            outcome.predicted - reach,
            outcome.predicted + reach,
            color=color,
            alpha=0.18,
            linewidth=0.0,
        )
    axes.set_ylim(0.0, 1.15 * test.forces.max())
    axes.set_xlim(0.0, test.times[-1])
    axes.set_title(f"{test.name}: {which}", fontsize=10)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("force [N]")
    axes.legend(fontsize=8, loc="lower right", title="shaded: 95 % interval", title_fontsize=8)


def _draw_errors(axes: Axes, kind: str, tests: Sequence[Test], errors: _Errors) -> None:
    methods = _by_median(kind, tests, errors)[::-1]
    boxes = axes.boxplot(
        [_errors_of(kind, tests, by_test) for _, by_test in methods],
        orientation="horizontal",
        widths=0.6,
        whis=(5.0, 95.0),
        patch_artist=True,
        medianprops={"color": "0.1"},
        flierprops={"markersize": 3},
    )
    for patch, (name, _) in zip(boxes["boxes"], methods, strict=True):
        patch.set_facecolor(_COLORS.get(name, "0.85"))
        patch.set_alpha(0.7)
    axes.set_yticks(range(1, len(methods) + 1), [name for name, _ in methods], fontsize=9)
    axes.set_xlim(left=0.0)
    axes.grid(axis="x", color="0.9")
    axes.set_axisbelow(True)
    axes.set_xlabel("error, RMS in % of the peak force")
    axes.set_title(f"{kind}: every test", fontsize=10)
