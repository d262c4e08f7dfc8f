# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Errors of simulated contacts over the Bayesian Cramér-Rao bound, and honesty of the intervals.

Tissue drawn from the paper's Table II is pressed in simulation, the samples go through the whole
pipeline, and every contact's estimate is held against its truth and its own bound: same priors,
with alpha, strain origin and force bias unknown in it where the identifier does not know them. The
rig is known; the law's error has its default, which the data have to find to be 0.
"""

from __future__ import annotations

import argparse
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from benchmark.bound import contact_bounds
from benchmark.harness import Benchmark, Goal, Report, Table, at_most, by_case
from benchmark.score import NAMES, TWO_SIDED_95, Judged, Share, bootstrapped, share
from benchmark.trial import elapsed, identified, outcome_from, truth_of
from fden_ros.core.arrays import Array
from fden_ros.core.outputs import Output, TissueState
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.closed_form import FdenModel
from fden_ros.simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Press,
    Scenario,
    Site,
    Tissue,
)
from fden_ros.simulation.simulate import END_PAUSE_S, Recording, simulate
from fden_ros.simulation.trajectory import Approach, Palpation, Path, Ramp, RampHold, Sinusoid

EPILOG = """\
examples:
  fden benchmark accuracy --quick
  fden benchmark accuracy --cases ramp,hold_alpha_0.32 --contacts 200 --parameters mine.yaml

Fewer contacts leave goals undecided where the confidence interval of the figure (95 %, bootstrap)
reaches across its limit.
"""

_GEOMETRY = Geometry("flat_punch", radius_m=0.01, thickness_m=0.02)
#: The last 0.3 s of the approach are at the rate of the press [s].
_SLOW_TIME = 0.3
#: Beside the seed, so that these draws are none of the simulation's own.
_DRAWS = 17
#: alpha of the paper's Table II, from which the tissue is drawn then.
_LIVER_ORDER = 0.131


@dataclass(frozen=True)
class Case:
    """One kind of contact.

    Parameters
    ----------
    name : str
    press : Press
        The motion.
    alpha : float
        Mean of the truth; 0.131 is drawn from the paper's Table II, others with 0.02.
    learns_alpha : bool
        alpha is not given but learned, from a prior as wide as 0.05, or as Table II.
    rate_hz, noise_pa, jitter_s : float
        Of the force; displacement has the same rate and jitter.
    alpha_off_sd : float
        alpha is given with this standard deviation, and just as far from the truth.
    limit : float
        Largest error over the bound that is wanted; inf: there is little to learn.
    parameters : mapping
        Further parameters of the identifier.
    """

    name: str
    press: Press
    alpha: float = _LIVER_ORDER
    learns_alpha: bool = False
    rate_hz: float = 200.0
    noise_pa: float = 3.0
    jitter_s: float = 0.0
    alpha_off_sd: float = 0.0
    limit: float = 1.25
    parameters: Mapping[str, Any] = field(default_factory=lambda: {"estimate.period": 0.03})


_FAST: Mapping[str, Any] = {"rate_hz": 1000.0, "parameters": {}}
_RAMP, _HOLD = Ramp(1.0, 0.25), RampHold(0.5, 0.25, 2.0)
_TEN = Palpation(0.5, 0.25, 0.3, presses=10, pause_s=0.3)
_SINUSOID = Sinusoid(0.5, 0.2, 0.02, 1.0, 3)
#: Noise of a stress that is 1 mN on the punch [Pa].
_MILLINEWTON = 1e-3 / _GEOMETRY.force_per_stress

CASES = {
    case.name: case
    for case in (
        Case("ramp", _RAMP, **_FAST),
        Case("ramp_alpha_0.32", _RAMP, 0.32, **_FAST),
        Case(
            "slow_sensor",
            Ramp(0.5, 0.25),
            rate_hz=100.0,
            noise_pa=1.0,
            jitter_s=1e-3,
            parameters={},
        ),
        Case("palpation", Palpation(0.5, 0.25, 0.3, presses=3, pause_s=0.3)),
        Case("sinusoid_alpha_0.32", _SINUSOID, 0.32),
        Case("hold", _HOLD, learns_alpha=True),
        Case("hold_alpha_0.32", _HOLD, 0.32, learns_alpha=True),
        *(
            Case(f"hold_{size:g}mN", _HOLD, learns_alpha=True, noise_pa=size * _MILLINEWTON)
            for size in (10.0, 1.0, 0.1)
        ),
        Case("ten_palpations", _TEN, learns_alpha=True, rate_hz=100.0),
        Case("below_boundary", Ramp(0.5, 0.06), limit=math.inf, **_FAST),
        Case(
            "ten_samples",
            Ramp(2.5, 0.25),
            rate_hz=100.0,
            noise_pa=1.0,
            limit=math.inf,
            parameters={},
        ),
        Case("alpha_one_sd_wrong", _RAMP, alpha_off_sd=0.011, limit=math.inf, **_FAST),
    )
}


class Trial(NamedTuple):
    """One recording: its bound, and what came out; judged is None where nothing did."""

    bound: Array  #: of (ln G, ln Gn, alpha, origin, bias [Pa]), shape (5,)
    judged: Judged | None
    origin: float  #: error of the strain origin [1]


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify and judge."""
    tasks = [(case.name, number) for case in args.cases for number in args.numbers]
    found = by_case(run_trial, tasks, args.parameters, jobs=args.jobs)
    rows = {name: row_of(trials) for name, trials in found.items()}
    drawn = {"error over the bound": (0.0, 1.2), "NEES": (0.9, 1.1), "in 95 %": (0.9, 1.0)}
    title = "Root mean square error over the Cramér-Rao bound: ln G, ln Gn, alpha, origin"
    return Report(goals_of(found), {"cases": Table(title, rows, drawn)})


def run_trial(name: str, number: int, parameters: Mapping[str, Any]) -> Trial:
    """Simulate contact `number` of a case, and identify it."""
    own = {"model_error.sd": check({}).model_error.sd, **parameters}
    return trial_of(CASES[name], number, own)


def trial_of(case: Case, number: int, own: Mapping[str, Any]) -> Trial:
    """Simulate contact `number` of a case, and identify it with these parameters."""
    seed = zlib.crc32(case.name.encode()) % 1_000_000_000 + number
    scenario = _scenario(case, seed)
    recording = simulate(scenario, seed)
    truth = truth_of(recording)
    parameters = _parameters(case, recording, float(truth[2]))
    pipeline, outputs = identified(recording, parameters | dict(own))
    contacts = outcome_from(recording, pipeline, outputs).contacts
    # Contact that is lost for less than the detector's reaction time is not counted.
    last = contacts[-1] if contacts and contacts[-1].estimate is not None else None
    bound = _bound(case, scenario, recording, truth, parameters)
    return Trial(bound, last, _origin(outputs, recording))


def _scenario(case: Case, seed: int) -> Scenario:
    generator = np.random.default_rng([seed, _DRAWS])
    # Where the touch lies between two samples is chance.
    distance = float(generator.uniform(0.003, 0.0035))
    order = None if case.alpha == _LIVER_ORDER else float(generator.normal(case.alpha, 0.02))
    rate = getattr(case.press, "strain_rate", 1.0)
    approach = Approach(
        distance_m=distance,
        speed_m_per_s=0.01,
        slow_distance_m=min(0.002, _SLOW_TIME * rate * _GEOMETRY.length_m),
        retract_speed_m_per_s=0.02,
        start_pause_s=2.0,
    )
    return Scenario(
        name=case.name,
        geometry=_GEOMETRY,
        approach=approach,
        sites=(Site(Tissue(draw="liver", fractional_order=order), (case.press,)),),
        force=ForceSensor(
            rate_hz=case.rate_hz, noise_stress_pa=case.noise_pa, jitter_s=case.jitter_s
        ),
        displacement=DisplacementSensor(rate_hz=case.rate_hz, jitter_s=case.jitter_s),
    )


def _parameters(case: Case, recording: Recording, order: float) -> dict[str, Any]:
    own: dict[str, Any] = dict(recording.truth["identifier_parameters"])
    if case.learns_alpha:
        own["alpha.learn"] = True
        for name in ("prior.alpha", "prior.alpha_sd"):
            own.pop(name, None)
        if case.alpha != _LIVER_ORDER:
            own |= {"prior.alpha": case.alpha, "prior.alpha_sd": 0.05}
    elif case.alpha_off_sd:
        sign = 1.0 if recording.truth["seed"] % 2 else -1.0
        own["prior.alpha_sd"] = case.alpha_off_sd
        own["prior.alpha"] = order + sign * case.alpha_off_sd
    return own | dict(case.parameters)


def _bound(
    case: Case,
    scenario: Scenario,
    recording: Recording,
    truth: Array,
    parameters: Mapping[str, Any],
) -> Array:
    """Return the bound with the identifier's own priors, and the air before the last contact."""
    prior = pipeline_config(check(parameters)).estimator.prior
    stamps = np.array([elapsed(stamp) for stamp in recording.force.stamp_ns.tolist()])
    spans = [(elapsed(c["start_ns"]), elapsed(c["end_ns"])) for c in recording.truth["contacts"]]
    in_air = stamps < spans[-1][0]
    for start, end in spans[:-1]:
        in_air &= (stamps < start) | (stamps > end)
    deviations = (
        *(prior.linear_stiffness_log_sd, prior.nonlinear_stiffness_log_sd),
        *(prior.fractional_order_sd, math.inf),
        case.noise_pa / math.sqrt(int(in_air.sum())),
    )
    path = Path(-scenario.approach.distance_m / _GEOMETRY.length_m, _GEOMETRY.length_m)
    path.rest(scenario.approach.start_pause_s)
    case.press.press(path, scenario.approach)
    path.rest(END_PAUSE_S)
    model = FdenModel(math.exp(truth[0]), math.exp(truth[1]), float(truth[2]))
    return contact_bounds(path.moves, model, stamps, case.noise_pa, np.array(deviations))


def _origin(outputs: Sequence[Output], recording: Recording) -> float:
    """Return the error of the strain origin [1] in the last block, as its strain implies it."""
    states = [output for output in outputs if isinstance(output, TissueState)]
    for before, state in zip(reversed(states[:-1]), reversed(states[1:]), strict=True):
        if state.signals is None or before.signals is None:
            continue
        stamps, moved = recording.force.stamp_ns, recording.displacement
        first, last = np.searchsorted(stamps, [before.stamp_ns, state.stamp_ns], side="right")
        depths = np.interp(stamps[first:last], moved.stamp_ns, moved.value)
        strain = float(depths.mean()) - recording.truth["surface_displacement_m"]
        return strain / _GEOMETRY.length_m - state.signals.strain
    return math.nan


def row_of(trials: Sequence[Trial]) -> dict[str, Any]:
    """Return the figures of a case and method."""
    known = [trial for trial in trials if trial.judged is not None]
    contacts = [trial.judged for trial in known if trial.judged is not None]
    deviation = np.array([contact.deviation for contact in contacts]).reshape(-1, 3)
    error = np.array([contact.error for contact in contacts]).reshape(-1, 3)
    inside = np.abs(error) <= TWO_SIDED_95 * deviation
    estimated = deviation > 0.0
    return {
        "error over the bound": [ratio_of(trials, index)[0] for index in range(4)],
        "NEES": float(np.mean([_nees(contact) for contact in contacts])) if known else math.nan,
        "in 95 %": [
            float(inside[:, i].mean()) if np.all(estimated[:, i]) and known else math.nan
            for i in range(3)
        ],
        "no estimate": Share(len(trials) - len(known), len(trials)),
        "converged": share(contact.converged for contact in contacts),
        "silent": share(contact.is_silent for contact in contacts),
    }


def ratio_of(trials: Sequence[Trial], index: int) -> tuple[float, float, float]:
    """Return the rms error over the bound with its 95 % interval; NaN of what is given."""
    squares = []
    for trial in trials:
        if trial.judged is None or trial.bound[index] == 0.0:
            continue
        error = trial.origin if index == 3 else trial.judged.error[index]
        squares.append((error / trial.bound[index]) ** 2)
    return bootstrapped(np.array(squares), np.sqrt)


def _nees(contact: Judged) -> float:
    """Return the normalised estimation error squared, a dimension."""
    assert contact.estimate is not None
    kept = contact.deviation > 0.0
    covariance = contact.estimate.covariance[np.ix_(kept, kept)]
    error = contact.error[kept]
    return float(error @ np.linalg.lstsq(covariance, error, rcond=None)[0]) / int(kept.sum())


def goals_of(found: Mapping[str, Sequence[Trial]]) -> list[Goal]:
    """Hold every case against its goals."""
    goals = []
    for name, trials in found.items():
        limit = CASES[name].limit
        for index, word in enumerate((*NAMES, "origin") if math.isfinite(limit) else ()):
            ratio, *interval = ratio_of(trials, index)
            if math.isfinite(ratio):
                words = f"{name}: error over the bound, {word}"
                goals.append(at_most(words, ratio, limit, (interval[0], interval[1])))
        silent = sum(t.judged is not None and t.judged.is_silent for t in trials)
        goals.append(at_most(f"{name}: silent", float(silent), 0.0))
    return goals


BENCHMARK = Benchmark(
    run,
    EPILOG,
    cases=CASES,
    quick=("ramp", "hold_alpha_0.32"),
    contacts=(200, 6),
    parameters=True,
)
