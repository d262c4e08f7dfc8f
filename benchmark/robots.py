# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a real robot adds (breathing, compliance, friction, hum, ...), and what the estimate says.

Simulated presses on a disturbed rig go through the whole pipeline, with a wide prior. Bad columns
come first: *undetected* presses have a summary that is converged, without a warning flag, and off
by more than five stated deviations and 3 % (0.01 of alpha); *live* are unflagged CONVERGED states
that are off likewise; then root mean square of error over stated deviation of ln G, ln Gn and
alpha. *Invented*: contacts where there was none; *missed*: of the presses; *split*: further
contacts within a press; *measured*: slopes of force over displacement, of loading and of
unloading, whose 95 % interval holds that of the motion without noise.

Tissue: G log-uniform from 2,000 to 8,000, Gn 6 to 10, alpha 0.08 to 0.32, 20 mm thick to 2 %; a
punch of 10 mm radius, so that a press to 25 % takes 0.2 to 0.9 N (20 mm where the noise is
largest: moving vibration, liver). 500 Hz, 10 mN and 5 um of noise.
"""

from __future__ import annotations

import argparse
import math
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from benchmark.harness import (
    Benchmark,
    Goal,
    Report,
    Table,
    at_least,
    at_most,
    by_case,
    few,
    within,
)
from benchmark.score import NAMES, TWO_SIDED_95, Outcome, Share, figures_of, share, total
from benchmark.trial import feed, last_summaries, outcome_of, soft_tissue, through
from fden_ros.core.arrays import Array
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

EPILOG = """\
examples:
  fden benchmark robots --quick
  fden benchmark robots --cases compliance_0.5,friction_20mN --contacts 20
"""

RATE_HZ = 500.0
#: As stated to the identifier.
_THICKNESS_M = 0.02
#: The true thickness is off by a share uniform between these two: a deviation of
#: 2 %, which is the default of `geometry.thickness_sd`.
_MOST_THICKER = 0.02 * math.sqrt(3.0)
#: Seeds with the number of the recording, so that these draws are none of the simulation's own.
_DRAWS = 19

HOLD: Press = RampHold(0.2, 0.25, 2.0, 0.4)
PRESS: Press = Ramp(0.2, 0.25, 0.4)
_FAST: Press = Ramp(0.4, 0.25, 0.4)
_REFERENCE = ("undisturbed", "undisturbed_press")
_THREE: Press = Palpation(0.2, 0.25, 0.5, 0.4, presses=3, lift_m=0.002, pause_s=0.5)

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
    radius_m: float = 0.01
    noise_n: float = 0.010
    delay_s: float = 0.0
    liver: bool = False  #: The tissue is the paper's liver
    detection: bool = False  #: A test of the contact detection, whose presses are clear
    beyond: bool = False  #: Far beyond a usual rig: may be reported as changed tissue

    @property
    def press_count(self) -> int:
        """Presses planned in a recording."""
        at_each = sum(getattr(press, "presses", 1) for press in self.presses)
        return self.sites - 1 + at_each if self.preload.depth_m else self.sites * at_each

    @property
    def held_s(self) -> float:
        """Time from the touch to the end of the first press's hold [s]."""
        press: Any = self.presses[0]
        return float(press.max_strain / press.strain_rate + getattr(press, "hold_s", 0.0))


def _case(name: str, says: str, *presses: Press, **given: Any) -> Case:
    """Return a case of its own fields and of disturbances."""
    own = {one.name: given.pop(one.name) for one in fields(Case) if one.name in given}
    return Case(name, says, presses or (HOLD,), Disturbances(**given), **own)


_BREATH = SurfaceMotion(1e-3, rate_variation=0.1)
_CLEAR: dict[str, Any] = {"detection": True}
_WIDE: dict[str, Any] = {"detection": True, "radius_m": 0.02}

_ALL = (
    _case("undisturbed", "nothing; press and hold"),
    _case("undisturbed_press", "nothing; no hold", PRESS),
    _case("breathing_1mm_press", "breathing 1 mm, 8 mm/s", _FAST, breathing=_BREATH, beyond=True),
    _case("breathing_0.3mm", "breathing 0.3 mm, hold", breathing=SurfaceMotion(3e-4, 0.25, 0.1)),
    _case("breathing_1mm", "breathing 1 mm, hold", breathing=_BREATH, beyond=True),
    _case("heartbeat_0.2mm", "heartbeat 0.2 mm, hold", heartbeat=SurfaceMotion(2e-4, 1.2, 0.1)),
    _case("compliance_0.2", "compliance 0.2 mm/N", compliance_m_per_n=2e-4),
    _case("compliance_0.5", "compliance 0.5 mm/N", compliance_m_per_n=5e-4),
    _case("compliance_1.0", "compliance 1.0 mm/N", compliance_m_per_n=1e-3, beyond=True),
    # 20 mN after 2 s of contact.
    _case("creep_20mN", "creep 20 mN in 2 s", creep_n=0.0316),
    _case("friction_20mN", "friction 20 mN", PRESS, friction_n=0.02),
    _case("preload_2mm", "begins in contact, 2 mm", PRESS, PRESS, preload=Preload(0.002), sites=2),
    _case("plastic_0.1mm", "plastic set 0.1 mm", _THREE, plastic_set_m=1e-4),
    _case("delay_5ms", "delay 5 ms", delay_s=0.005),
    _case("delay_10ms", "delay 10 ms", delay_s=0.01),
    _case("filter_30Hz", "low-pass 30 Hz", filter_hz=30.0),
    _case("backlash_50um", "backlash 0.05 mm", backlash_m=5e-5),
    _case("thermal_100mN", "thermal 0.1 N, 20 s", thermal_n=0.1),
    *(
        _case(
            f"vibration_moving_{name}",
            f"{rate:g} Hz, {size * 1e3:g} mN, moving",
            **{"vibration_n": size, "vibration_hz": rate, **_WIDE},
        )
        for name, rate, size in (
            *(("50mN", 12.0, 0.05), ("100mN", 12.0, 0.1), ("5Hz", 5.0, 0.05)),
            *(("8Hz", 8.0, 0.05), ("20Hz", 20.0, 0.05), ("35Hz", 35.0, 0.05)),
        )
    ),
    _case("liver_white_15mN", "white 15 mN, liver", PRESS, liver=True, noise_n=0.015, **_WIDE),
    _case("liver_white_20mN", "white 20 mN, liver", PRESS, liver=True, noise_n=0.02, **_WIDE),
    _case("hum_20mN", "hum 50 Hz, 20 mN", hum_n=0.02, **_CLEAR),
    *(
        _case(
            f"vibration_{rate:g}Hz_20mN",
            f"{rate:g} Hz, 20 mN, always",
            **{"vibration_n": 0.02, "vibration_hz": rate, "vibration_at_rest": True, **_CLEAR},
        )
        for rate in (12.0, 30.0)
    ),
    _case("encoder_50um", "encoder of 50 um", displacement_step_m=5e-5, **_CLEAR),
    _case("force_steps_10mN", "force in 10 mN", force_step_n=0.01, noise_n=0.001, **_CLEAR),
    _case("grid_3mm", "3 mm grid, virgin", PRESS, sites=10, pitch_m=0.003, **_CLEAR),
)
CASES = {case.name: case for case in _ALL}


def scenario_of(case: Case, number: int) -> Scenario:
    """Return recording `number` of a case; the seed is fixed."""
    seed = zlib.crc32(case.name.encode()) % 1_000_000_000 + number
    generator = np.random.default_rng([seed, _DRAWS])
    model = soft_tissue(generator, 2000.0)
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
    _, outputs = through(recording, own)
    return replace(outcome_of(recording, outputs), measured=slopes_held(scenario, own, outputs))


# Measured slopes of force over displacement, next to those of the same motion without noise

#: Way of the motion whose parabola gives the true slope [m].
_WAY = 5e-4


def slopes_held(
    scenario: Scenario, parameters: Mapping[str, Any], outputs: Sequence[Output]
) -> Share:
    """Return of how many measured slopes of the contacts the 95 % interval holds the true one."""
    config, pairs = pipeline_config(check(parameters)), list[Pair]()
    synchronizer = Synchronizer(config.synchronize, pairs.append, Counter(), StaticLinks())
    feed(synchronizer, simulate(_smooth(scenario)))
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


# All cases


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify and judge."""
    tasks = [
        (case.name, args.first + number)
        for case in args.cases
        for number in range(math.ceil(args.contacts / case.press_count))
    ]
    found = by_case(run_trial, tasks)
    rows = {CASES[name].says: row_of(each) for name, each in found.items()}
    return Report(
        goals_of(found, {case.name: rows[case.says] for case in args.cases}),
        {"cases": Table("Presses on a disturbed rig", rows)},
    )


def run_trial(name: str, number: int) -> Outcome:
    """Simulate recording `number` of a case, identify it, and judge it."""
    return trial_of(CASES[name], number)


def row_of(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the figures of a case over all of its recordings."""
    contacts = [contact for outcome in outcomes for contact in outcome.contacts]
    presses = sum(outcome.presses for outcome in outcomes)
    found = sum(len({c.number for c in o.contacts if c.number >= 0}) for o in outcomes)
    row = figures_of(outcomes) | {
        "invented": sum(contact.number < 0 for contact in contacts),
        "missed": Share(presses - found, presses),
        "split": sum(contact.number >= 0 for contact in contacts) - found,
        "measured": total(outcome.measured for outcome in outcomes),
    }
    return {key: value for key, value in row.items() if key not in ("in 95 %", "live alarm")}


def goals_of(
    found: Mapping[str, Sequence[Outcome]], rows: Mapping[str, Mapping[str, Any]]
) -> list[Goal]:
    """Compare the cases with the goals."""
    lower = [row for name, row in rows.items() if CASES[name].detection]
    usual = [name for name in rows if not CASES[name].beyond]
    over = figures_of([outcome for name in usual for outcome in found[name]])["error over sd"]
    undetected, live, slopes = (
        total(row[key] for row in rows.values()) for key in ("undetected", "live", "measured")
    )
    goals = [
        few("undetected gross errors, all rows", undetected, 0.01),
        at_most("live, all rows", live.value, 0.005),
        *(
            within(f"error over deviation, all but those beyond, {name}", value, (0.6, 1.3))
            for name, value in zip(NAMES, over, strict=True)
        ),
        few("reported as changed tissue", total(rows[name]["changed"] for name in usual), 0.02),
        at_most("contacts invented", sum(row["invented"] for row in lower), 0.0),
        at_most("presses missed", sum(row["missed"].part for row in lower), 0.0),
        at_most("presses split", sum(row["split"] for row in lower), 0.0),
        at_least("measured slopes in their 95 %", slopes.value, 0.9),
    ]
    for name in filter(rows.__contains__, _REFERENCE):
        limits = zip(NAMES, rows[name]["sd"], (0.10, 0.06, 0.04), strict=True)
        goals += [at_most(f"{name}: deviation of {what}", *limit) for what, *limit in limits]
        claimed = rows[name]["unflagged"].value
        goals.append(at_least(f"{name}: converged and unflagged", claimed, 0.85))
    return goals


BENCHMARK = Benchmark(
    run,
    EPILOG,
    cases=CASES,
    quick=("undisturbed", "friction_20mN", "breathing_1mm_press", "vibration_moving_100mN"),
    contacts=(50, 3),
)
