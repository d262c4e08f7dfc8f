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

"""Presses on a simulated rig that is disturbed, identified by the pipeline and judged."""

from __future__ import annotations

import math
import zlib
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import Estimate
from fden_ros.core.outputs import ContactSummary, Flag, Output, Status, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.samples import Position
from fden_ros.errors import InputError
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.disturbance import Disturbances, SurfaceMotion
from fden_ros.simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Preload,
    Press,
    Scenario,
    Site,
    SurfaceSensor,
    Tissue,
)
from fden_ros.simulation.simulate import EXACT, START_NS, Recording, simulate
from fden_ros.simulation.trajectory import Approach, Palpation, Ramp, RampHold

#: Summaries and states with another flag than these say that something is wrong.
_HARMLESS = Flag.INPUT_REJECTED
#: An error counts from this many stated deviations ...
_DEVIATIONS = 5.0
#: ... and these sizes of ln G, ln Gn, alpha.
_SIZES = np.array([0.03, 0.03, 0.01])
_NANO = 1e-9
_NOISE_N = 0.010
_RATE_HZ = 500.0
#: As stated to the identifier.
_THICKNESS_M = 0.02
#: The tissue is thicker or thinner than that by a share uniform between these two: a deviation of
#: 2 %, which is what `geometry.thickness_sd` states by default.
_MOST_THICKER = 0.02 * math.sqrt(3.0)
#: Radius of the punch: its forces are those of the rigs that the rows were taken from.
_RADIUS_M = 0.01
#: Radius where the noise is so large that only a wide punch has ten times its force.
_WIDE_RADIUS_M = 0.02
#: Presses are apart by at least this [s]; contact lost for a shorter time is the same press.
_SHORTEST_AIR = 0.15
#: A summary belongs to a press that it overlaps, give or take this [s].
_SLACK = 0.05
#: A press this many times the noise is not to be missed.
_CLEAR = 10.0
#: Beside the number of the recording, so that these draws are none of the simulation's own.
_DRAWS = 19

_HOLD: Press = RampHold(0.2, 0.25, 2.0, 0.4)
_PRESS: Press = Ramp(0.2, 0.25, 0.4)
_FAST: Press = Ramp(0.4, 0.25, 0.4)

#: So wide that the data decide.
PRIOR: Mapping[str, Any] = {
    "alpha.learn": True,
    "prior.linear_stiffness": 4000.0,
    "prior.linear_stiffness_log_sd": 1.0,
    "prior.nonlinear_stiffness": 8.0,
    "prior.nonlinear_stiffness_log_sd": 0.5,
    "prior.alpha": 0.2,
    "prior.alpha_sd": 0.1,
}


@dataclass(frozen=True)
class Case:
    """One row of a table.

    Parameters
    ----------
    name, says : str
        What is disturbed, short and in words.
    presses : tuple of Press
        At each site.
    disturbances, preload
        As in a scenario.
    sites : int
        How many are touched, all of one tissue.
    pitch_m : float
        From one site to the next; 0: places are not told.
    radius_m : float
        Of the punch.
    noise_n, delay_s : float
        White noise of the force; delay of the displacement that is not corrected.
    liver : bool
        The tissue is the paper's liver.
    detection : bool
        Of the lower table.
    reference : bool
        Nothing is disturbed: the row of the sharpness.
    surface : SurfaceSensor, optional
        Measures the surface's place.
    beyond : bool
        Far beyond what a rig is expected to do: may be told as changed tissue.
    """

    name: str
    says: str
    presses: tuple[Press, ...] = (_HOLD,)
    disturbances: Disturbances = field(default_factory=Disturbances)
    preload: Preload = field(default_factory=Preload)
    sites: int = 1
    pitch_m: float = 0.0
    radius_m: float = _RADIUS_M
    noise_n: float = _NOISE_N
    delay_s: float = 0.0
    liver: bool = False
    detection: bool = False
    reference: bool = False
    beyond: bool = False
    surface: SurfaceSensor | None = None

    @property
    def press_count(self) -> int:
        """Presses planned in a recording."""
        at_each = sum(getattr(press, "presses", 1) for press in self.presses)
        return self.sites - 1 + at_each if self.preload.depth_m else self.sites * at_each

    @property
    def largest_noise_n(self) -> float:
        """What a press has to stand out from, in N."""
        d = self.disturbances
        return max(self.noise_n, d.hum_n, d.vibration_n, d.force_step_n)


def _breathing(peak_to_peak_m: float) -> Disturbances:
    return Disturbances(breathing=SurfaceMotion(peak_to_peak_m, rate_variation=0.1))


_THREE = (Palpation(0.2, 0.25, 0.5, 0.4, presses=3, lift_m=0.002, pause_s=0.5),)

CASES = (
    Case("undisturbed", "nothing; press and hold", reference=True),
    Case("undisturbed_press", "nothing; no hold", (_PRESS,)),
    Case("breathing_1mm_press", "breathing 1 mm, 8 mm/s", (_FAST,), _breathing(1e-3), beyond=True),
    Case("breathing_0.3mm", "breathing 0.3 mm, hold", disturbances=_breathing(3e-4)),
    Case("breathing_1mm", "breathing 1 mm, hold", disturbances=_breathing(1e-3), beyond=True),
    Case(
        "breathing_1mm_measured",
        "breathing 1 mm, hold, measured",
        disturbances=_breathing(1e-3),
        surface=SurfaceSensor(60.0, noise_m=2e-5, jitter_s=1e-3, delay_s=0.02, offset_m=0.3),
    ),
    Case(
        "heartbeat_0.2mm",
        "heartbeat 0.2 mm, hold",
        disturbances=Disturbances(heartbeat=SurfaceMotion(2e-4, 1.2, 0.1)),
    ),
    *(
        Case(
            f"compliance_{size}",
            f"compliance {size} mm/N",
            disturbances=Disturbances(compliance_m_per_n=size * 1e-3),
            beyond=size >= 1.0,
        )
        for size in (0.2, 0.5, 1.0)
    ),
    # 20 mN after 2 s of contact.
    Case("creep_20mN", "creep 20 mN in 2 s", disturbances=Disturbances(creep_n=0.0316)),
    Case("friction_20mN", "friction 20 mN", (_PRESS,), Disturbances(friction_n=0.02)),
    Case(
        "preload_2mm",
        "begins in contact, 2 mm",
        (_PRESS, _PRESS),
        preload=Preload(0.002),
        sites=2,
    ),
    Case("plastic_0.1mm", "plastic set 0.1 mm", _THREE, Disturbances(plastic_set_m=1e-4)),
    Case("delay_5ms", "delay 5 ms", delay_s=0.005),
    Case("delay_10ms", "delay 10 ms", delay_s=0.01),
    Case("filter_30Hz", "low-pass 30 Hz", disturbances=Disturbances(filter_hz=30.0)),
    Case("backlash_50um", "backlash 0.05 mm", disturbances=Disturbances(backlash_m=5e-5)),
    Case("thermal_100mN", "thermal 0.1 N, 20 s", disturbances=Disturbances(thermal_n=0.1)),
    Case(
        # 0.15 mm/N, 7 mN and 2.5 ms at all of them.
        "ten_sites",
        "ten sites, one rig",
        disturbances=Disturbances(compliance_m_per_n=1.5e-4, friction_n=0.007),
        delay_s=0.0025,
        sites=10,
    ),
    *(
        Case(
            f"vibration_moving_{size}mN",
            f"12 Hz, {size} mN, moving",
            disturbances=Disturbances(vibration_n=size * 1e-3),
            radius_m=_WIDE_RADIUS_M,
            detection=True,
        )
        for size in (50, 100)
    ),
    *(
        Case(
            f"liver_white_{size}mN",
            f"white {size} mN, liver",
            (_PRESS,),
            noise_n=size * 1e-3,
            radius_m=_WIDE_RADIUS_M,
            liver=True,
            detection=True,
        )
        for size in (15, 20)
    ),
    Case("hum_20mN", "hum 50 Hz, 20 mN", disturbances=Disturbances(hum_n=0.02), detection=True),
    *(
        Case(
            f"vibration_{rate}Hz_20mN",
            f"{rate} Hz, 20 mN, always",
            disturbances=Disturbances(
                vibration_n=0.02, vibration_hz=float(rate), vibration_at_rest=True
            ),
            detection=True,
        )
        for rate in (12, 30)
    ),
    Case(
        "encoder_50um",
        "encoder of 50 um",
        disturbances=Disturbances(displacement_step_m=5e-5),
        detection=True,
    ),
    Case(
        "force_steps_10mN",
        "force in 10 mN",
        disturbances=Disturbances(force_step_n=0.01),
        noise_n=0.001,
        detection=True,
    ),
    Case("grid_3mm", "3 mm grid, virgin", (_PRESS,), sites=10, pitch_m=0.003, detection=True),
)


class Judged(NamedTuple):
    """What the summary of one contact says, beside the truth."""

    converged: bool
    flags: Flag
    error: Array  #: of (ln G, ln Gn, alpha), shape (3,); NaN: there is no estimate
    deviation: Array  #: as stated, shape (3,)
    number: int  #: of the press, from 0; -1: there was none

    @property
    def has_estimate(self) -> bool:
        """Whether there is something to judge."""
        return bool(np.all(np.isfinite(self.error)))

    @property
    def is_off(self) -> bool:
        """Whether a parameter is off by more than the stated deviation allows."""
        return is_off(self.error, self.deviation)

    @property
    def is_silent(self) -> bool:
        """Whether nothing says that it is off."""
        return self.converged and not warns(self.flags) and self.is_off


class Trial(NamedTuple):
    """One recording."""

    presses: int  #: made
    clear: int  #: of these, the ones that stand out from the noise
    clear_missed: int  #: of the clear ones, those without a summary
    contacts: tuple[Judged, ...]
    claims: int  #: unflagged CONVERGED states
    wrong_claims: int  #: of these, those that are off
    held: Array  #: stated deviations at the end of the first press's hold, shape (3,)
    stuck: int  #: samples dropped as stuck


def run_trial(case: Case, number: int, parameters: Mapping[str, Any]) -> Trial:
    """Simulate recording `number` of a case, identify it, and judge it."""
    scenario = scenario_of(case, number)
    recording = simulate(scenario)
    pipeline, outputs = _identified(recording, parameters)
    site = recording.truth["sites"][0]
    truth = np.array(
        [
            math.log(site["linear_stiffness"]),
            math.log(site["nonlinear_stiffness"]),
            site["fractional_order"],
        ]
    )
    presses = presses_of(recording)
    # The last word on each contact counts: a summary may withdraw an earlier one.
    summaries = {o.contact_id: o for o in outputs if isinstance(o, ContactSummary)}
    contacts = tuple(_judged(summary, truth, presses) for summary in summaries.values())
    found = {contact.number for contact in contacts}
    is_clear = _peak_n(scenario) >= _CLEAR * case.largest_noise_n
    states = [o for o in outputs if isinstance(o, TissueState)]
    claims = [
        state.estimate
        for state in states
        if state.status is Status.CONVERGED and state.estimate and not warns(state.flags)
    ]
    return Trial(
        presses=len(presses),
        clear=len(presses) if is_clear else 0,
        clear_missed=sum(n not in found for n in range(len(presses))) if is_clear else 0,
        contacts=contacts,
        claims=len(claims),
        wrong_claims=sum(is_off(*errors_of(claim, truth)) for claim in claims),
        held=_held(states, presses[0], case.presses[0]),
        stuck=pipeline.rejected["force.stuck"] + pipeline.rejected["displacement.stuck"],
    )


def scenario_of(case: Case, number: int) -> Scenario:
    """Return recording `number` of a case; the seed is fixed."""
    seed = zlib.crc32(case.name.encode()) % 1_000_000_000 + number
    generator = np.random.default_rng([seed, _DRAWS])
    firm = Tissue(
        linear_stiffness=math.exp(generator.uniform(math.log(2000.0), math.log(8000.0))),
        nonlinear_stiffness=generator.uniform(6.0, 10.0),
        fractional_order=generator.uniform(0.08, 0.32),
    )
    tissue = _drawn_liver(seed) if case.liver else firm
    thicker = np.random.default_rng([seed, _DRAWS, 2]).uniform(-_MOST_THICKER, _MOST_THICKER)
    thickness_m = _THICKNESS_M * (1.0 + thicker)
    sites = [Site(tissue, case.presses, (case.pitch_m * n, 0.0)) for n in range(case.sites)]
    if case.preload.depth_m:
        # The later site is touched once.
        sites[1:] = [replace(site, presses=case.presses[:1]) for site in sites[1:]]
    return Scenario(
        name=case.name,
        seed=seed,
        geometry=Geometry("flat_punch", radius_m=case.radius_m, thickness_m=thickness_m),
        sites=tuple(sites),
        approach=Approach(
            # Where the touch lies between two samples is chance.
            distance_m=generator.uniform(0.005, 0.0055),
            speed_m_per_s=0.01,
            slow_distance_m=0.002,
            start_pause_s=1.5,
        ),
        force=ForceSensor(rate_hz=_RATE_HZ, noise_n=case.noise_n),
        displacement=DisplacementSensor(
            rate_hz=_RATE_HZ,
            noise_m=5e-6,
            delay_s=case.delay_s,
            message="point" if case.pitch_m else "joint_state",
        ),
        disturbances=case.disturbances,
        preload=case.preload,
        surface=case.surface,
    )


def _drawn_liver(seed: int) -> Tissue:
    model = Tissue(draw="liver").model(np.random.default_rng([seed, _DRAWS, 1]))
    return Tissue(model.linear_stiffness, model.nonlinear_stiffness, model.fractional_order)


def _peak_n(scenario: Scenario) -> float:
    """Return the largest force of an undisturbed press in N."""
    quiet = replace(
        scenario,
        sites=scenario.sites[:1],
        disturbances=Disturbances(),
        preload=Preload(),
        force=replace(scenario.force, noise_n=0.0),
    )
    return float(simulate(quiet).force.value.max())


def _identified(
    recording: Recording, parameters: Mapping[str, Any]
) -> tuple[Pipeline, list[Output]]:
    own = {**recording.truth["identifier_parameters"], **PRIOR}
    # A user knows neither thickness nor delay, nor that a rig is not disturbed.
    own["geometry.thickness"] = _THICKNESS_M
    for name in ("displacement.delay", *EXACT):
        own.pop(name, None)
    outputs: list[Output] = []
    pipeline = Pipeline(pipeline_config(check({**parameters, **own})), outputs.append)
    surfaces = deque[tuple[int, float]]()
    if recording.surface is not None:
        values = recording.surface.value.tolist()
        surfaces.extend(zip(recording.surface.stamp_ns.tolist(), values, strict=True))
    for is_force, stamp_ns, value, place in streams_of(recording):
        while surfaces and surfaces[0][0] <= stamp_ns:
            pipeline.add_surface(*surfaces.popleft())
        if is_force:
            pipeline.add_force(stamp_ns, value)
        else:
            pipeline.add_displacement(stamp_ns, value, place)
    pipeline.finish()
    return pipeline, outputs


def streams_of(recording: Recording) -> Iterator[tuple[bool, int, float, Position | None]]:
    """Give (is a force, stamp, value, place) of all samples by stamp, the displacement first."""
    force, moved = recording.force, recording.displacement
    places: list[Position | None] = [None] * moved.value.size
    if moved.position is not None:
        places = [(x, y, z) for x, y, z in moved.position.tolist()]
    samples = list(zip(moved.stamp_ns.tolist(), moved.value.tolist(), places, strict=True))
    index = 0
    for stamp_ns, value in zip(force.stamp_ns.tolist(), force.value.tolist(), strict=True):
        while index < len(samples) and samples[index][0] <= stamp_ns:
            yield False, *samples[index]
            index += 1
        yield True, stamp_ns, value, None
    for sample in samples[index:]:
        yield False, *sample


def presses_of(recording: Recording) -> list[tuple[float, float]]:
    """Return touch and release of each press [s]; contact lost for a moment is one press."""
    presses: list[tuple[float, float]] = []
    for contact in recording.truth["contacts"]:
        start, end = ((contact[key] - START_NS) * _NANO for key in ("start_ns", "end_ns"))
        if presses and start - presses[-1][1] < _SHORTEST_AIR:
            presses[-1] = (presses[-1][0], end)
        else:
            presses.append((start, end))
    return presses


def _judged(
    summary: ContactSummary, truth: Array, presses: Sequence[tuple[float, float]]
) -> Judged:
    start, end = ((stamp - START_NS) * _NANO for stamp in (summary.start_ns, summary.end_ns))
    overlaps = [min(end, release) - max(start, touch) for touch, release in presses]
    best = int(np.argmax(overlaps))
    error, deviation = np.full(3, np.nan), np.full(3, np.nan)
    if summary.estimate is not None:
        error, deviation = errors_of(summary.estimate, truth)
    return Judged(
        summary.converged,
        summary.flags,
        error,
        deviation,
        best if overlaps[best] > -_SLACK else -1,
    )


def errors_of(estimate: Estimate, truth: Array) -> tuple[Array, Array]:
    """Return errors of (ln G, ln Gn, alpha) and their stated deviations."""
    values = np.array(
        [
            estimate.log_linear_stiffness,
            estimate.log_nonlinear_stiffness,
            estimate.fractional_order,
        ]
    )
    return values - truth, np.sqrt(np.maximum(np.diag(estimate.covariance), 0.0))


def warns(flags: Flag) -> bool:
    """Return whether a flag says that something is wrong."""
    return bool(flags & ~_HARMLESS)


def is_off(error: Array, deviation: Array) -> bool:
    """Return whether errors of (ln G, ln Gn, alpha) are beyond what is stated, each (3,)."""
    return bool(np.any((np.abs(error) > _DEVIATIONS * deviation) & (np.abs(error) > _SIZES)))


def _held(states: Sequence[TissueState], span: tuple[float, float], press: Press) -> Array:
    """Return the deviations that are stated last before a press begins to let go."""
    last = np.full(3, np.nan)
    end = span[0] + press_time(press)
    for state in states:
        elapsed = (state.stamp_ns - START_NS) * _NANO
        if span[0] < elapsed <= end and state.estimate is not None:
            last = np.sqrt(np.maximum(np.diag(state.estimate.covariance), 0.0))
    return last


def press_time(press: Press) -> float:
    """Return how long a press goes in and holds, in s."""
    if isinstance(press, Ramp | RampHold | Palpation):
        return press.max_strain / press.strain_rate + getattr(press, "hold_s", 0.0)
    raise InputError(f"robots: {press.kind} is not used here")
