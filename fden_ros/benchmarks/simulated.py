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

"""Simulated contacts, identified by the pipeline, and held against the truth and the bound."""

from __future__ import annotations

import enum
import math
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fden_ros.benchmarks.appendix_d import identify
from fden_ros.benchmarks.bound import PriorDeviations, contact_bounds
from fden_ros.core.arrays import Array
from fden_ros.core.law.fractional_integral import fractional_stress
from fden_ros.core.outputs import ContactSummary, OrderSource, Output, Status
from fden_ros.core.outputs import TissueState as State
from fden_ros.core.pipeline import Pipeline
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
from fden_ros.simulation.simulate import END_PAUSE_S, START_NS, Recording, simulate
from fden_ros.simulation.trajectory import Approach, Path

#: The identifier's two observations, and the paper's own filter.
STRESS, FRACTIONAL_STRESS, APPENDIX_D = "stress", "fractional_stress", "appendix_d"
#: The stress, with `model_error.sd` at its default: the data have to find that there is none.
MODEL_ERROR_LEARNED = "model_error_learned"

_GEOMETRY = Geometry("flat_punch", radius_m=0.01, thickness_m=0.02)
#: The last 0.3 s of the approach are at the rate of the press [s].
_SLOW_TIME = 0.3
#: Share of the white noise that remains in f'; see
#: :mod:`fden_ros.core.estimation.fractional_stress_estimator`.
_NOISE_SHARE = 0.9
#: Off by more than this factor an estimate is a failure.
_FAILURE = math.log(1.5)
_NANO = 1e-9
#: Beside the seed, so that these draws are none of the simulation's own.
_CASE_DRAWS = 17


class Group(enum.Enum):
    """Which goals a case is held against."""

    GIVEN = "alpha given"
    LEARNED = "alpha learned from a hold"
    HONEST = "little to learn"


@dataclass(frozen=True)
class Case:
    """One kind of contact.

    Parameters
    ----------
    name : str
    press : Press
        The motion.
    alpha : float
        Mean of the truth; 0.131 is drawn from the paper's Table II.
    alpha_sd : float
        Standard deviation of the truth about it, where it is not Table II's.
    learns_alpha : bool
        alpha is not given but learned, from a prior as wide as `prior_alpha_sd`, or as Table II.
    prior_alpha_sd : float
    rate_hz, noise_pa, jitter_s : float
        Of the force; displacement has the same rate and jitter.
    start_pause_s : float
        In the air before the approach.
    alpha_off_sd : float
        alpha is given with this standard deviation, and just as far from the truth.
    gives_origin : bool
        The strain origin is given.
    parameters : mapping
        Further parameters of the identifier.
    group : Group
        Which goals count.
    is_quick : bool
        Part of a quick run.
    """

    name: str
    press: Press
    alpha: float = 0.131
    alpha_sd: float = 0.02
    learns_alpha: bool = False
    prior_alpha_sd: float = 0.05
    rate_hz: float = 1000.0
    noise_pa: float = 3.0
    jitter_s: float = 0.0
    start_pause_s: float = 2.0
    alpha_off_sd: float = 0.0
    gives_origin: bool = False
    parameters: Mapping[str, Any] = field(default_factory=dict)
    group: Group = Group.GIVEN
    is_quick: bool = False

    @property
    def is_liver(self) -> bool:
        """Whether alpha is drawn from Table II."""
        return self.alpha == 0.131


class Outcome(NamedTuple):
    """What one estimator made of one recording."""

    found: bool  #: there was contact with one site, and it left a finite estimate
    converged: bool
    learned: bool  #: alpha
    time_to_converge: float  #: since the first touch [s]; inf: never
    error: Array  #: of (ln G, ln Gn, alpha, origin), shape (4,)
    covariance: Array  #: of (ln G, ln Gn, alpha), shape (3, 3)
    origin_sd: float

    @property
    def failed(self) -> bool:
        """Whether there is nothing to use: no estimate, or one that is far off."""
        return not (self.found and bool(np.all(np.abs(self.error[:2]) < _FAILURE)))


class Trial(NamedTuple):
    """One recording: its bound, and what each estimator made of it."""

    seed: int
    truth: FdenModel
    bound: Array  #: of (ln G, ln Gn, alpha, origin, bias [Pa]), shape (5,)
    outcomes: dict[str, Outcome]


#: Parameters of the identifier by method.
_OWN_PARAMETERS: dict[str, dict[str, Any]] = {
    STRESS: {"estimator.observation": STRESS},
    FRACTIONAL_STRESS: {"estimator.observation": FRACTIONAL_STRESS},
    MODEL_ERROR_LEARNED: {"model_error.sd": check({}).model_error.sd},
}

_LOST = Outcome(
    False, False, False, math.inf, np.full(4, np.nan), np.full((3, 3), np.nan), math.nan
)


def run_trial(case: Case, number: int, methods: tuple[str, ...]) -> Trial:
    """Simulate contact `number` of a case, and identify it by each method."""
    seed = zlib.crc32(case.name.encode()) % 1_000_000_000 + number
    scenario = _scenario(case, seed)
    recording = simulate(scenario, seed)
    site = recording.truth["sites"][0]
    model = FdenModel(
        site["linear_stiffness"], site["nonlinear_stiffness"], site["fractional_order"]
    )
    parameters = _parameters(case, recording, model)
    outcomes = {}
    for method in methods:
        if method == APPENDIX_D:
            outcomes[method] = _by_appendix_d(case, recording, model, parameters)
        else:
            own = parameters | _OWN_PARAMETERS[method]
            outcomes[method] = _by_pipeline(recording, model, own)
    return Trial(seed, model, _bound(case, scenario, recording, model, parameters), outcomes)


def _scenario(case: Case, seed: int) -> Scenario:
    generator = np.random.default_rng([seed, _CASE_DRAWS])
    # Where the touch lies between two samples is chance.
    distance = float(generator.uniform(0.003, 0.0035))
    order = None
    if not case.is_liver:
        order = float(generator.normal(case.alpha, case.alpha_sd))
    rate = getattr(case.press, "strain_rate", 1.0)
    length = _GEOMETRY.length_m
    approach = Approach(
        distance_m=distance,
        speed_m_per_s=0.01,
        slow_distance_m=min(0.002, _SLOW_TIME * rate * length),
        retract_speed_m_per_s=0.02,
        start_pause_s=case.start_pause_s,
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


def _parameters(case: Case, recording: Recording, model: FdenModel) -> dict[str, Any]:
    parameters: dict[str, Any] = dict(recording.truth["identifier_parameters"])
    if case.learns_alpha:
        parameters["alpha.learn"] = True
        if case.is_liver:
            # Table II's, the defaults.
            for name in ("prior.alpha", "prior.alpha_sd"):
                parameters.pop(name, None)
        else:
            parameters["prior.alpha"] = case.alpha
            parameters["prior.alpha_sd"] = case.prior_alpha_sd
    elif case.alpha_off_sd:
        sign = 1.0 if recording.truth["seed"] % 2 else -1.0
        parameters["prior.alpha_sd"] = case.alpha_off_sd
        parameters["prior.alpha"] = model.fractional_order + sign * case.alpha_off_sd
    if case.gives_origin:
        parameters["origin.source"] = "given"
        parameters["origin.displacement"] = recording.truth["surface_displacement_m"]
    return parameters | dict(case.parameters)


def _bound(
    case: Case,
    scenario: Scenario,
    recording: Recording,
    model: FdenModel,
    parameters: Mapping[str, Any],
) -> Array:
    """Return the bound with the filter's own priors, and the air before the last contact."""
    prior = pipeline_config(check(parameters)).estimator.prior
    stamps = _times(recording.force.stamp_ns)
    spans = _spans(recording)
    in_air = stamps < spans[-1][0]
    for start, end in spans[:-1]:
        in_air &= (stamps < start) | (stamps > end)
    deviations = PriorDeviations(
        log_g=prior.linear_stiffness_log_sd,
        log_gn=prior.nonlinear_stiffness_log_sd,
        alpha=prior.fractional_order_sd,
        origin=0.0 if case.gives_origin else math.inf,
        bias=case.noise_pa / math.sqrt(int(in_air.sum())),
    )
    path = Path(-scenario.approach.distance_m / _GEOMETRY.length_m, _GEOMETRY.length_m)
    path.rest(scenario.approach.start_pause_s)
    case.press.press(path, scenario.approach)
    path.rest(END_PAUSE_S)
    return contact_bounds(path.moves, model, stamps, case.noise_pa, deviations)


def _times(stamp_ns: NDArray[np.int64]) -> Array:
    """Return times since the beginning of the recording [s]."""
    times: Array = (stamp_ns - START_NS).astype(np.float64) * _NANO
    return times


def _spans(recording: Recording) -> list[tuple[float, float]]:
    """Return touch and release of the contacts [s]."""
    return [
        ((contact["start_ns"] - START_NS) * _NANO, (contact["end_ns"] - START_NS) * _NANO)
        for contact in recording.truth["contacts"]
    ]


# The pipeline


def _by_pipeline(recording: Recording, model: FdenModel, parameters: Mapping[str, Any]) -> Outcome:
    outputs: list[Output] = []
    pipeline = Pipeline(pipeline_config(check(parameters)), outputs.append)
    _feed(pipeline, recording)
    pipeline.finish()
    summaries = [output for output in outputs if isinstance(output, ContactSummary)]
    contacts = recording.truth["contacts"]
    # Contact that is lost for less than the detector's reaction time is not counted: only the
    # site must be one.
    if not summaries or summaries[-1].site_id != 1 or summaries[-1].estimate is None:
        return _LOST
    summary, estimate = summaries[-1], summaries[-1].estimate
    error = np.array(
        [
            estimate.log_linear_stiffness - math.log(model.linear_stiffness),
            estimate.log_nonlinear_stiffness - math.log(model.nonlinear_stiffness),
            estimate.fractional_order - model.fractional_order,
            _origin(outputs, recording),
        ]
    )
    if not np.all(np.isfinite(error[:3])):
        return _LOST
    converged_ns = next(_converged_stamps(outputs), None)
    wait = math.inf if converged_ns is None else (converged_ns - contacts[0]["start_ns"]) * _NANO
    return Outcome(
        True,
        summary.converged,
        summary.order_source is OrderSource.LEARNED,
        wait,
        error,
        estimate.covariance,
        estimate.strain_origin_sd,
    )


def _feed(pipeline: Pipeline, recording: Recording) -> None:
    force, displacement = recording.force, recording.displacement
    index = 0
    stamps, values = displacement.stamp_ns.tolist(), displacement.value.tolist()
    for stamp_ns, value in zip(force.stamp_ns.tolist(), force.value.tolist(), strict=True):
        while index < len(stamps) and stamps[index] <= stamp_ns:
            pipeline.add_displacement(stamps[index], values[index])
            index += 1
        pipeline.add_force(stamp_ns, value)
    while index < len(stamps):
        pipeline.add_displacement(stamps[index], values[index])
        index += 1


def _converged_stamps(outputs: list[Output]) -> Iterator[int]:
    return (o.stamp_ns for o in outputs if isinstance(o, State) and o.status is Status.CONVERGED)


def _origin(outputs: list[Output], recording: Recording) -> float:
    """Return the strain origin [1] in the last block with one, as its strain implies it."""
    states = [output for output in outputs if isinstance(output, State)]
    for before, state in zip(reversed(states[:-1]), reversed(states[1:]), strict=True):
        if state.signals is None or before.signals is None:
            continue
        stamps = recording.force.stamp_ns
        first, last = np.searchsorted(stamps, [before.stamp_ns, state.stamp_ns], side="right")
        displacement = np.interp(
            stamps[first:last], recording.displacement.stamp_ns, recording.displacement.value
        )
        strain = float(displacement.mean()) - recording.truth["surface_displacement_m"]
        return strain / _GEOMETRY.length_m - state.signals.strain
    return math.nan


# The paper's filter


def _by_appendix_d(
    case: Case, recording: Recording, model: FdenModel, parameters: Mapping[str, Any]
) -> Outcome:
    prior = pipeline_config(check(parameters)).estimator.prior
    order = model.fractional_order
    stamps = _times(recording.force.stamp_ns)
    spans = _spans(recording)
    kept = (stamps > spans[0][0]) & (stamps < spans[-1][1])
    pressed = np.zeros(stamps.shape, dtype=bool)
    for start, end in spans:
        pressed |= (stamps > start) & (stamps < end)
    times, pressed = stamps[kept], pressed[kept]
    stress: Array = recording.force.value[kept] / _GEOMETRY.force_per_stress * pressed
    displacement: Array = np.interp(
        recording.force.stamp_ns[kept],
        recording.displacement.stamp_ns,
        recording.displacement.value,
    )
    strain = displacement / _GEOMETRY.length_m
    # Appendix F is about indentation: the way in.
    loading = slice(int(np.argmax(strain >= (1.0 - 1e-6) * strain.max())) + 1)
    fractional = fractional_stress(times[loading], stress[loading], order)
    scale = case.noise_pa * math.sqrt(_NOISE_SHARE / (1.0 + 2.0 * order))
    elapsed = times[loading] - spans[0][0]
    deviations = scale / math.gamma(1.0 + order) * elapsed**order
    found = identify(strain[loading], fractional, deviations, prior)
    if found is None:
        return _LOST
    state, own = found
    truth = np.log([model.linear_stiffness, model.nonlinear_stiffness])
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = own
    is_converged = math.sqrt(max(own[1, 1], 0.0)) < 0.05
    return Outcome(
        True,
        is_converged,
        False,
        math.inf,
        np.array([*(state - truth), 0.0, 0.0]),
        covariance,
        0.0,
    )
