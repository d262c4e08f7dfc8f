# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Simulated presses on a disturbed rig: the cases of `robots` and `invariance`.

Tissue: G log-uniform from 2,000 to 8,000, Gn 6 to 10, alpha 0.08 to 0.32, 20 mm thick to 2 %; a
punch of 10 mm radius, so that a press to 25 % takes 0.2 to 0.9 N (20 mm where the noise is
largest: moving vibration, liver). 500 Hz, 10 mN and 5 um of noise.
"""

from __future__ import annotations

import math
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmark.score import TWO_SIDED_95, Outcome, Share, share
from benchmark.trial import feed, last_summaries, outcome_of, through
from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.outputs import Output
from fden_ros.core.streams import Pair, StaticLinks, Synchronizer
from fden_ros.parameters import check, pipeline_config
from simulation.disturbance import Disturbances, SurfaceMotion
from simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Preload,
    Press,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import EXACT, Recording, simulate
from simulation.trajectory import Approach, Palpation, Ramp, RampHold

RATE_HZ = 500.0
#: As stated to the identifier.
_THICKNESS_M = 0.02
#: The true thickness is off by a share uniform between these two: a deviation of
#: 2 %, which is the default of `geometry.thickness_sd`.
_MOST_THICKER = 0.02 * math.sqrt(3.0)
_RADIUS_M, _WIDE_RADIUS_M = 0.01, 0.02
#: Seeds with the number of the recording, so that these draws are none of the simulation's own.
_DRAWS = 19

HOLD: Press = RampHold(0.2, 0.25, 2.0, 0.4)
PRESS: Press = Ramp(0.2, 0.25, 0.4)
_FAST: Press = Ramp(0.4, 0.25, 0.4)
_THREE = (Palpation(0.2, 0.25, 0.5, 0.4, presses=3, lift_m=0.002, pause_s=0.5),)

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
    """One kind of rig and press."""

    #: The disturbance, short and in words
    name: str
    says: str
    presses: tuple[Press, ...] = (HOLD,)  #: At each site
    #: As in a scenario
    disturbances: Disturbances = field(default_factory=Disturbances)
    preload: Preload = field(default_factory=Preload)
    sites: int = 1  #: How many are touched, all of one tissue
    pitch_m: float = 0.0  #: From one site to the next; 0: places are not recorded
    #: Of the punch; white noise of the force; delay of the displacement that is not corrected
    radius_m: float = _RADIUS_M
    noise_n: float = 0.010
    delay_s: float = 0.0
    liver: bool = False  #: The tissue is the paper's liver
    detection: bool = False  #: A test of the contact detection
    beyond: bool = False  #: Far beyond a usual rig: may be reported as changed tissue

    @property
    def press_count(self) -> int:
        """Presses planned in a recording."""
        at_each = sum(getattr(press, "presses", 1) for press in self.presses)
        return self.sites - 1 + at_each if self.preload.depth_m else self.sites * at_each

    @property
    def largest_noise_n(self) -> float:
        """The noise that a press has to exceed, in N."""
        d = self.disturbances
        return max(self.noise_n, d.hum_n, d.vibration_n, d.force_step_n)

    @property
    def held_s(self) -> float:
        """Time from the touch to the end of the first press's hold [s]."""
        press: Any = self.presses[0]
        return float(press.max_strain / press.strain_rate + getattr(press, "hold_s", 0.0))


def _disturbed(name: str, says: str, **disturbances: Any) -> Case:
    return Case(name, says, disturbances=Disturbances(**disturbances))


def _fooling(name: str, says: str, radius_m: float = _RADIUS_M, **disturbances: Any) -> Case:
    return replace(_disturbed(name, says, **disturbances), radius_m=radius_m, detection=True)


def _moving(name: str, says: str, vibration_n: float, vibration_hz: float = 12.0) -> Case:
    shaken = {"vibration_n": vibration_n, "vibration_hz": vibration_hz}
    return _fooling(f"vibration_moving_{name}", says, _WIDE_RADIUS_M, **shaken)


_BREATHES = Disturbances(breathing=SurfaceMotion(1e-3, rate_variation=0.1))

_ALL = (
    Case("undisturbed", "nothing; press and hold"),
    Case("undisturbed_press", "nothing; no hold", (PRESS,)),
    Case("breathing_1mm_press", "breathing 1 mm, 8 mm/s", (_FAST,), _BREATHES, beyond=True),
    _disturbed(
        "breathing_0.3mm", "breathing 0.3 mm, hold", breathing=SurfaceMotion(3e-4, 0.25, 0.1)
    ),
    Case("breathing_1mm", "breathing 1 mm, hold", disturbances=_BREATHES, beyond=True),
    _disturbed(
        "heartbeat_0.2mm", "heartbeat 0.2 mm, hold", heartbeat=SurfaceMotion(2e-4, 1.2, 0.1)
    ),
    _disturbed("compliance_0.2", "compliance 0.2 mm/N", compliance_m_per_n=2e-4),
    _disturbed("compliance_0.5", "compliance 0.5 mm/N", compliance_m_per_n=5e-4),
    replace(
        _disturbed("compliance_1.0", "compliance 1.0 mm/N", compliance_m_per_n=1e-3), beyond=True
    ),
    # 20 mN after 2 s of contact.
    _disturbed("creep_20mN", "creep 20 mN in 2 s", creep_n=0.0316),
    Case("friction_20mN", "friction 20 mN", (PRESS,), Disturbances(friction_n=0.02)),
    Case(
        "preload_2mm", "begins in contact, 2 mm", (PRESS, PRESS), preload=Preload(0.002), sites=2
    ),
    Case("plastic_0.1mm", "plastic set 0.1 mm", _THREE, Disturbances(plastic_set_m=1e-4)),
    Case("delay_5ms", "delay 5 ms", delay_s=0.005),
    Case("delay_10ms", "delay 10 ms", delay_s=0.01),
    _disturbed("filter_30Hz", "low-pass 30 Hz", filter_hz=30.0),
    _disturbed("backlash_50um", "backlash 0.05 mm", backlash_m=5e-5),
    _disturbed("thermal_100mN", "thermal 0.1 N, 20 s", thermal_n=0.1),
    *(_moving(f"{size}mN", f"12 Hz, {size} mN, moving", size * 1e-3) for size in (50, 100)),
    *(
        _moving(f"{rate}Hz", f"{rate} Hz, 50 mN, moving", 0.05, float(rate))
        for rate in (5, 8, 20, 35)
    ),
    *(
        replace(
            Case(f"liver_white_{size}mN", f"white {size} mN, liver", (PRESS,), liver=True),
            noise_n=size * 1e-3,
            radius_m=_WIDE_RADIUS_M,
            detection=True,
        )
        for size in (15, 20)
    ),
    _fooling("hum_20mN", "hum 50 Hz, 20 mN", hum_n=0.02),
    *(
        _fooling(
            f"vibration_{rate}Hz_20mN",
            f"{rate} Hz, 20 mN, always",
            vibration_n=0.02,
            vibration_hz=float(rate),
            vibration_at_rest=True,
        )
        for rate in (12, 30)
    ),
    _fooling("encoder_50um", "encoder of 50 um", displacement_step_m=5e-5),
    replace(_fooling("force_steps_10mN", "force in 10 mN", force_step_n=0.01), noise_n=0.001),
    Case("grid_3mm", "3 mm grid, virgin", (PRESS,), sites=10, pitch_m=0.003, detection=True),
)
CASES = {case.name: case for case in _ALL}


def scenario_of(case: Case, number: int) -> Scenario:
    """Return recording `number` of a case; the seed is fixed."""
    seed = zlib.crc32(case.name.encode()) % 1_000_000_000 + number
    generator = np.random.default_rng([seed, _DRAWS])
    tissue = Tissue(
        linear_stiffness=math.exp(generator.uniform(math.log(2000.0), math.log(8000.0))),
        nonlinear_stiffness=generator.uniform(6.0, 10.0),
        fractional_order=generator.uniform(0.08, 0.32),
    )
    if case.liver:
        model = Tissue(draw="liver").model(np.random.default_rng([seed, _DRAWS, 1]))
        tissue = Tissue(model.linear_stiffness, model.nonlinear_stiffness, model.fractional_order)
    thicker = np.random.default_rng([seed, _DRAWS, 2]).uniform(-_MOST_THICKER, _MOST_THICKER)
    sites = [Site(tissue, case.presses, (case.pitch_m * n, 0.0)) for n in range(case.sites)]
    if case.preload.depth_m:
        # The later site is touched once.
        sites[1:] = [replace(site, presses=case.presses[:1]) for site in sites[1:]]
    return Scenario(
        name=case.name,
        seed=seed,
        geometry=Geometry(
            "flat_punch", radius_m=case.radius_m, thickness_m=_THICKNESS_M * (1.0 + thicker)
        ),
        sites=tuple(sites),
        approach=Approach(
            # The touch lies anywhere between two samples.
            distance_m=generator.uniform(0.005, 0.0055),
            speed_m_per_s=0.01,
            slow_distance_m=0.002,
            start_pause_s=1.5,
        ),
        force=ForceSensor(rate_hz=RATE_HZ, noise_n=case.noise_n),
        displacement=DisplacementSensor(
            rate_hz=RATE_HZ,
            noise_m=5e-6,
            delay_s=case.delay_s,
            message="point" if case.pitch_m else "joint_state",
        ),
        disturbances=case.disturbances,
        preload=case.preload,
    )


def parameters_of(recording: Recording) -> dict[str, Any]:
    """Return the identifier's parameters, without thickness, delay, or the rig."""
    own = {**recording.truth["identifier_parameters"], **PRIOR}
    own["geometry.thickness"] = _THICKNESS_M
    for name in ("displacement.delay", *EXACT):
        own.pop(name, None)
    return own


def trial_of(case: Case, number: int, parameters: Mapping[str, Any] = {}) -> Outcome:
    """Simulate recording `number` of a case, identify it, and judge it."""
    scenario = scenario_of(case, number)
    recording = simulate(scenario)
    own = {**parameters, **parameters_of(recording)}
    config = pipeline_config(check(own))
    _, outputs = through(recording, config)
    return replace(outcome_of(recording, outputs), measured=slopes_held(scenario, config, outputs))


def peak_n(scenario: Scenario) -> float:
    """Return the largest force of an undisturbed press in N."""
    quiet = replace(
        scenario,
        sites=scenario.sites[:1],
        disturbances=Disturbances(),
        preload=Preload(),
        force=replace(scenario.force, noise_n=0.0),
    )
    return float(simulate(quiet).force.value.max())


# Measured slopes of force over displacement, next to those of the same motion without noise

#: Way of the motion whose parabola gives the true slope [m].
_WAY = 5e-4


def slopes_held(scenario: Scenario, config: PipelineConfig, outputs: Sequence[Output]) -> Share:
    """Return of how many measured slopes of the contacts the 95 % interval holds the true one."""
    pairs: list[Pair] = []
    feed(
        Synchronizer(config.synchronize, pairs.append, Counter(), StaticLinks()),
        simulate(_smooth(scenario)),
    )
    free = config.contact.compliance_free
    motion = np.array([(pair.stamp_ns, free(pair, pair.force), pair.force) for pair in pairs])
    return share(
        abs(found.value - _slope(motion, found.stamp_ns, sign)) <= TWO_SIDED_95 * found.sd
        for summary in last_summaries(outputs).values()
        for sign, found in zip((1, -1), summary.measured, strict=True)
        if found is not None
    )


def _slope(motion: Array, stamp_ns: int, sign: int) -> float:
    """Return the slope of a motion of (stamp, place, force) [N/m], shape (n, 3), at a stamp.

    By a parabola over half a millimetre: before the end of a loading, or from it on.
    """
    at = int(np.searchsorted(motion[:, 0], stamp_ns))
    _, places, forces = motion[at::-sign].T
    ways = places[0] - places
    # Samples beyond all earlier ones; the last step may be part of the hold.
    further = np.diff(np.maximum.accumulate(ways), prepend=-np.inf) > 0.0
    inside = further & (ways > 0.0) & (ways <= _WAY)
    line = np.polynomial.Polynomial.fit(-ways[inside], forces[inside], 2)
    return float(line.deriv()(0.0))


def _smooth(scenario: Scenario) -> Scenario:
    """Return the scenario without white noise, hum, vibration and steps of the readings."""
    noises = ("hum_n", "vibration_n", "force_step_n", "displacement_step_m")
    steady: dict[str, Any] = dict.fromkeys(noises, 0.0)
    return replace(
        scenario,
        # A signal without any noise would count as stuck.
        force=replace(scenario.force, noise_n=1e-7),
        displacement=replace(scenario.displacement, noise_m=1e-10),
        disturbances=replace(scenario.disturbances, **steady),
    )
