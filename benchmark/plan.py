# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a plan says before a press, and what the identifier says after it.

Tissues are drawn from an organ's prior, and pressed on a rig of which nothing is told, at three
noises of the force: by the usual motion, by the planned one, and by a second press that is planned
from a shallow first. *Achieved* are the deviations that the identifier states.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from benchmark.harness import Benchmark, Goal, Report, Table, at_least, at_most, by_case, within
from benchmark.score import rms, share
from benchmark.trial import identified, last_summaries
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Estimate, ended
from fden_ros.parameters import check, pipeline_config
from fden_ros.planning.forecast import Forecast
from fden_ros.planning.motion import FREQUENCY, Motion, Sensors
from fden_ros.planning.plan import Plan, Target, plan
from fden_ros.planning.tissue import TissueBelief
from simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Press,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import simulate
from simulation.trajectory import Approach, RampHold, Sinusoid

EPILOG = """\
examples:
  fden benchmark plan --quick
  fden benchmark plan --cases 20mN --contacts 60    60 tissues, each pressed four times
"""

RADIUS_M, THICKNESS_M, _RATE_HZ, _MOTION_NOISE_M = 0.02, 0.02, 500.0, 5e-6
#: The tissue is thicker or thinner by a share uniform between these two: a deviation of 2 %.
_MOST_THICKER = 0.02 * math.sqrt(3.0)
PARAMETERS = {
    "geometry.kind": "flat_punch",
    "geometry.area": math.pi * RADIUS_M**2,
    "geometry.thickness": THICKNESS_M,
    "prior.linear_stiffness": 520.0,
    "prior.linear_stiffness_log_sd": 0.3,
    "prior.nonlinear_stiffness": 8.4,
    "prior.nonlinear_stiffness_log_sd": 0.2,
    "prior.alpha": 0.131,
    "prior.alpha_sd": 0.03,
}
#: As without a plan, and too shallow for Gn.
USUAL = Motion(5e-3, 4e-3, 2.0, 8e-3)
_SHALLOW = Motion(1.8e-3, 4e-3, 1.0, 8e-3)
_TARGET = Target((0.1, 0.1, math.inf))
#: Targets for "possible or not" are this much more or less than what is usual [1].
_SPREAD = 2.0


@dataclass(frozen=True)
class Case:
    """A noise of the force [N]."""

    name: str
    noise_n: float


CASES = {f"{size}mN": Case(f"{size}mN", size * 1e-3) for size in (5, 20, 50)}


class Trial(NamedTuple):
    """What was planned and found of one tissue; deviations are of (ln G, ln Gn, alpha), (3,)."""

    predicted: Array
    usual: Array
    planned: Array
    times: tuple[float, float]  #: of the usual and the planned motion [s]
    expected_usual: Array
    is_right: bool  #: it was possible as was said
    second: tuple[Array, Array, Array]  #: predicted, achieved, and the error
    cost: float  #: of a plan, processor time [s]


def run(args: argparse.Namespace) -> Report:
    """Plan, simulate, identify and compare."""
    tasks = [(case.name, number) for case in args.cases for number in args.numbers]
    found = by_case(trial_of, tasks, jobs=args.jobs, what="tissues")
    rows = {name: _row(trials) for name, trials in found.items()}
    every = [trial for trials in found.values() for trial in trials]
    return Report(_goals(every), {"noises": Table("Planned presses", rows)})


def trial_of(name: str, number: int) -> Trial:
    """Plan for tissue `number` without knowing it, press it, and compare."""
    case, config = CASES[name], pipeline_config(check(PARAMETERS))
    draw = np.random.default_rng([number, 23])
    prior = config.estimator.prior
    tissue = np.clip(draw.normal(prior.mean, prior.deviations), [-9.0, -9.0, 0.03], 99.0)
    sensors = Sensors(_RATE_HZ, case.noise_n, _MOTION_NOISE_M)
    start = time.process_time()
    planned = plan(config, sensors, _TARGET)
    cost = time.process_time() - start
    belief = TissueBelief.stated(prior)
    usual = ended(Forecast(config, sensors, belief).stated(USUAL, belief.draws(8)))
    expected_usual = np.median([one.deviations for one in usual], axis=0)
    asked = Target((*(planned.deviations[:2] * _SPREAD ** draw.uniform(-1, 1, 2)), math.inf))
    answer = plan(config, sensors, asked)
    achieved = _deviations(_pressed(case, number, tissue, (answer.motion,)))
    is_met = bool(np.all(asked.ratios(achieved) <= 1.0))
    return Trial(
        predicted=planned.deviations,
        usual=_deviations(_pressed(case, number, tissue, (USUAL,))),
        planned=_deviations(_pressed(case, number, tissue, (planned.motion,))),
        times=(USUAL.seconds, planned.motion.seconds),
        expected_usual=expected_usual,
        is_right=is_met == (answer.probability >= 0.5),
        second=_second(case, number, tissue),
        cost=cost,
    )


def _second(case: Case, number: int, tissue: Array) -> tuple[Array, Array, Array]:
    """Return predicted and achieved deviations of a press after a shallow one, and its error."""
    config = pipeline_config(check(PARAMETERS))
    sensors = Sensors(_RATE_HZ, case.noise_n, _MOTION_NOISE_M)
    first = _pressed(case, number, tissue, (_SHALLOW,))
    nothing = np.full(3, np.nan)
    if not first or first[-1] is None:
        return nothing, nothing, nothing
    planned: Plan = plan(config, sensors, _TARGET, tissue=TissueBelief.found(first[-1]))
    both = _pressed(case, number, tissue, (_SHALLOW, planned.motion))
    if len(both) < 2 or both[-1] is None:
        return planned.deviations, nothing, nothing
    return planned.deviations, both[-1].deviations, both[-1].mean - tissue


def _deviations(estimates: Sequence[Estimate | None]) -> Array:
    last = estimates[-1] if estimates else None
    return np.full(3, np.inf) if last is None else last.deviations


def _pressed(
    case: Case, number: int, tissue: Array, motions: Sequence[Motion]
) -> list[Estimate | None]:
    """Return what the identifier says after each press of one place."""
    draw = np.random.default_rng([number, 31])
    scenario = Scenario(
        seed=1000 * number + round(1e3 * case.noise_n),
        geometry=Geometry(
            "flat_punch",
            radius_m=RADIUS_M,
            thickness_m=THICKNESS_M * (1.0 + draw.uniform(-_MOST_THICKER, _MOST_THICKER)),
        ),
        sites=(
            Site(
                tissue=Tissue(math.exp(tissue[0]), math.exp(tissue[1]), float(tissue[2])),
                presses=tuple(_press(motion) for motion in motions),
            ),
        ),
        approach=Approach(
            distance_m=draw.uniform(0.01, 0.0105),
            speed_m_per_s=0.02,
            slow_distance_m=0.005,
            site_pause_s=1.0,
        ),
        force=ForceSensor(rate_hz=_RATE_HZ, noise_n=case.noise_n),
        displacement=DisplacementSensor(rate_hz=_RATE_HZ, noise_m=_MOTION_NOISE_M),
    )
    outputs = identified(simulate(scenario), PARAMETERS)[1]
    return [summary.estimate for summary in last_summaries(outputs).values()]


def _press(motion: Motion) -> Press:
    speed, release = motion.speed / THICKNESS_M, motion.release / THICKNESS_M
    strain = motion.depth / THICKNESS_M
    if not motion.cycles:
        return RampHold(speed, strain, motion.hold, release)
    size = motion.amplitude / THICKNESS_M
    return Sinusoid(speed, strain, size, FREQUENCY, motion.cycles, motion.hold, release)


def _ratios(trials: Sequence[Trial]) -> Array:
    """Return achieved over predicted deviations, (trials, 3); NaN where there is no estimate."""
    found = np.array([trial.planned / trial.predicted for trial in trials])
    return np.where(np.isfinite(found), found, np.nan)


def _row(trials: Sequence[Trial]) -> dict[str, Any]:
    ratios = _ratios(trials)
    second = np.array([trial.second[1] / trial.second[0] for trial in trials])
    usual = np.array([trial.usual / trial.expected_usual for trial in trials])
    return {
        "predicted": trials[0].predicted,
        "achieved, median": np.median([trial.planned for trial in trials], axis=0),
        "achieved over predicted": np.nanmedian(ratios, axis=0),
        "scatter of its logarithm": np.nanstd(np.log(ratios), axis=0),
        "usual motion": np.median([trial.usual for trial in trials], axis=0),
        "over expected": np.nanmedian(usual, axis=0),
        "time over usual": trials[0].times[1] / trials[0].times[0],
        "as sharp as usual": share(_is_as_sharp(trial) for trial in trials),
        "right if possible": share(trial.is_right for trial in trials),
        "second press: over predicted": np.nanmedian(second, axis=0),
        "error over sd": _errors(trials),
        "ms": 1e3 * float(np.median([trial.cost for trial in trials])),
    }


def _is_as_sharp(trial: Trial) -> bool:
    """Whether the planned press tells as much of G and Gn together as the usual one."""
    return bool(np.sum(np.log(trial.planned[:2] / trial.usual[:2])) <= 0.0)


def _errors(trials: Sequence[Trial]) -> list[float]:
    errors = np.array([trial.second[2] / trial.second[1] for trial in trials])
    return [float(rms(column[np.isfinite(column)])) for column in errors.T]


def _goals(trials: Sequence[Trial]) -> list[Goal]:
    ratios = _ratios(trials)[:, :2]
    medians, scatter = np.nanmedian(ratios, axis=0), np.nanstd(np.log(ratios), axis=0)
    times = [trial.times[1] / trial.times[0] for trial in trials if _is_as_sharp(trial)]
    return [
        within("achieved over predicted, G", float(medians[0]), (0.9, 1.1)),
        within("achieved over predicted, Gn", float(medians[1]), (0.9, 1.1)),
        at_most("scatter of its logarithm, worse of both", float(scatter.max()), 0.3),
        at_most("time over usual where as sharp", float(np.median(times or [math.nan])), 0.6),
        at_least("right if possible", share(t.is_right for t in trials).value, 0.9),
        at_most("second press: error over sd, worst", max(_errors(trials)), 1.3),
        at_most("processor time of a plan [ms]", 1e3 * np.median([t.cost for t in trials]), 150.0),
    ]


BENCHMARK = Benchmark(run, EPILOG, cases=CASES, contacts=(70, 2))
