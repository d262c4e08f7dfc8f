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

"""Contacts on tissue that obeys the law exactly: drawn, simulated, identified and judged."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fden_ros.benchmarks.disturbed import errors_of, is_off, streams_of, warns
from fden_ros.core.outputs import ContactSummary, Flag, Status, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.closed_form import FdenModel, stress_of_piecewise_linear_strain
from fden_ros.simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Scenario,
    Site,
    Tissue,
)
from fden_ros.simulation.simulate import EXACT, KNOWN_RIG, Recording, simulate
from fden_ros.simulation.trajectory import Approach, Palpation, Ramp, RampHold, Staircase

Array = NDArray[np.float64]

#: Ranges of what is drawn, log-uniform but for alpha.
LINEAR_STIFFNESS = (20.0, 50_000.0)  # [Pa s^alpha]
NONLINEAR_STIFFNESS = (1.0, 40.0)
ORDER = (0.02, 0.6)
NOISE_PA = (3.0, 300.0)
RATE_HZ = (30.0, 1000.0)
HOLD_S = (0.1, 600.0)
STRAIN_RATE = (0.02, 1.0)  # [1/s], in and out
#: Gn x at the deepest, where the stress is up to e^5 times that at the boundary strain: farther
#: nobody presses, and not beyond LARGEST_STRAIN.
EXPONENT, LARGEST_STRAIN = (0.7, 6.0), 0.5
#: The largest stress of a press is so many times its noise, and at most so large [Pa]: 60 N.
SIGNAL_TO_NOISE, LARGEST_STRESS = 20.0, 2e5
#: A ramp lasts so many samples.
RAMP_SAMPLES = 5
#: Largest number of samples of a contact, unless the slowest rate takes more.
LARGEST_SAMPLES = 12_000
#: Half of the priors are the default one, the others are this wide [1] and up to so many of their
#: deviations off.
PRIOR_LOG_G, PRIOR_LOG_GN, PRIOR_ORDER = (0.1, 2.0), (0.1, 0.9), (0.01, 0.14)
PRIOR_OFF = 2.0
#: The largest median of Gn that may be stated [1].
MOST_PRIOR_NONLINEAR = 100.0
#: Every other pair of contacts has this noise of the displacement [m].
DISPLACEMENT_NOISE = 1e-6

Press = Ramp | RampHold | Staircase | Palpation
RIGID, ARM = "rig known", "arm's defaults"
MOTIONS = ("ramp", "staircase", "ramp_hold", "palpation")
_GEOMETRY = Geometry("flat_punch", radius_m=0.01, thickness_m=0.02)
_PRESSES = 3
#: The last of the approach is at the rate of the press, for so long [s].
_SLOW_TIME = 0.3
#: In the air before a touch and after the last [s], about.
_AIR_S = 3.5
_DRAWS = 23
#: A tissue that no motion of so many makes pressable is drawn anew.
_TRIES = 50


@dataclass(frozen=True)
class Contact:
    """What is pressed, how, and what the identifier is told.

    Parameters
    ----------
    number : int
        From 0; it is the seed.
    model : FdenModel
    press : Press
    rate_hz, noise_pa, displacement_noise_m : float
    rig : str
        RIGID: its deviations are 0 (`config/bench.yaml`); ARM: they are the defaults.
    prior : mapping
        Parameters of the identifier; empty: the default prior.
    """

    number: int
    model: FdenModel
    press: Press
    rate_hz: float
    noise_pa: float
    displacement_noise_m: float
    rig: str
    prior: Mapping[str, float]

    @property
    def held_s(self) -> float:
        """Time of all holds of a press [s]."""
        held = float(getattr(self.press, "hold_s", 0.0))
        return held * getattr(self.press, "steps", 1)

    @property
    def signal_to_noise(self) -> float:
        """Stress at the end of the first ramp over the noise of a sample."""
        return _peak_stress(self.model, self.press) / self.noise_pa


@dataclass(frozen=True)
class Finding:
    """One recording, judged; ready for JSON.

    Parameters
    ----------
    number, largest_samples : int
        Of the contact, and the limit it was drawn with.
    drawn : mapping
        The tissue, the motion and the sensors, to look at.
    presses, contacts, with_estimate, converged, silent : int
        Planned; told in a summary; of these, with an estimate, converged, and silently off.
    mismatch, changed : bool
        Told in a summary.
    live_mismatch, live_changed : bool
        Told in any state.
    claims, wrong_claims : int
        Unflagged CONVERGED states, and those that are off.
    flags : list of str
        Of all summaries.
    error, deviation : list
        Of (ln G, ln Gn, alpha) in the last summary, (3,); empty: there is no estimate.
    """

    number: int
    largest_samples: int
    drawn: dict[str, Any]
    presses: int
    contacts: int
    with_estimate: int
    converged: int
    silent: int
    mismatch: bool
    changed: bool
    live_mismatch: bool
    live_changed: bool
    claims: int
    wrong_claims: int
    flags: list[str]
    error: list[float]
    deviation: list[float]

    @property
    def rig(self) -> str:
        """RIGID or ARM."""
        return str(self.drawn["rig"])

    @property
    def told(self) -> bool:
        """Whether a summary tells a mismatch or a change, and is wrong."""
        return self.mismatch or self.changed

    @property
    def told_live(self) -> bool:
        """Whether any state or summary does."""
        return self.live_mismatch or self.live_changed or self.told

    def json_object(self) -> dict[str, Any]:
        """Return the fields."""
        return asdict(self)


def drawn(number: int, largest_samples: int = LARGEST_SAMPLES) -> Contact:
    """Return contact `number`: the same for the same limit of samples."""
    generator = np.random.default_rng([number, _DRAWS])
    motion = MOTIONS[number // 4 % len(MOTIONS)]
    while True:
        model = FdenModel(
            _log_uniform(generator, LINEAR_STIFFNESS),
            _log_uniform(generator, NONLINEAR_STIFFNESS),
            float(generator.uniform(*ORDER)),
        )
        for _ in range(_TRIES):
            press, duration = _press(generator, motion, model)
            fastest = max(min(RATE_HZ[1], largest_samples / duration), RATE_HZ[0])
            contact = Contact(
                number,
                model,
                press,
                _log_uniform(generator, (RATE_HZ[0], fastest)),
                _log_uniform(generator, NOISE_PA),
                DISPLACEMENT_NOISE if number % 2 else 0.0,
                ARM if number // 2 % 2 else RIGID,
                _prior(generator, model),
            )
            if _is_pressable(contact):
                return contact


def _log_uniform(generator: np.random.Generator, limits: tuple[float, float]) -> float:
    return float(math.exp(generator.uniform(math.log(limits[0]), math.log(limits[1]))))


def _press(generator: np.random.Generator, motion: str, model: FdenModel) -> tuple[Press, float]:
    """Return a motion and how long it takes with the air around it [s]."""
    rate, back = (_log_uniform(generator, STRAIN_RATE) for _ in range(2))
    strain = min(_log_uniform(generator, EXPONENT) / model.nonlinear_stiffness, LARGEST_STRAIN)
    hold = _log_uniform(generator, HOLD_S)
    moved = _AIR_S + strain / rate + strain / back
    if motion == "ramp":
        return Ramp(rate, strain, back), moved
    if motion == "ramp_hold":
        return RampHold(rate, strain, hold, back), moved + hold
    if motion == "palpation":
        each = hold / _PRESSES
        press = Palpation(rate, strain, each, back, presses=_PRESSES, pause_s=0.5)
        return press, _PRESSES * moved + hold
    steps = int(generator.integers(2, 5))
    return Staircase(rate, strain, steps, hold / steps, back), moved + hold


def _peak_stress(model: FdenModel, press: Press) -> float:
    """Return the stress at the end of a ramp to the largest strain [Pa]."""
    strain = press.max_strain
    end = strain / press.strain_rate
    return float(stress_of_piecewise_linear_strain([0.0, end], [0.0, strain], end, model))


def _is_pressable(contact: Contact) -> bool:
    peak = _peak_stress(contact.model, contact.press)
    ramp = contact.press.max_strain / contact.press.strain_rate
    return (
        SIGNAL_TO_NOISE * contact.noise_pa <= peak <= LARGEST_STRESS
        and ramp * contact.rate_hz >= RAMP_SAMPLES
    )


def _prior(generator: np.random.Generator, model: FdenModel) -> dict[str, float]:
    """Return the parameters of a prior; empty: the default one."""
    is_default = bool(generator.integers(2))
    sds = [_log_uniform(generator, w) for w in (PRIOR_LOG_G, PRIOR_LOG_GN, PRIOR_ORDER)]
    off = generator.uniform(-PRIOR_OFF, PRIOR_OFF, 3) * sds
    if is_default:
        return {}
    return {
        "prior.linear_stiffness": model.linear_stiffness * math.exp(off[0]),
        "prior.linear_stiffness_log_sd": sds[0],
        "prior.nonlinear_stiffness": min(
            model.nonlinear_stiffness * math.exp(off[1]), MOST_PRIOR_NONLINEAR
        ),
        "prior.nonlinear_stiffness_log_sd": sds[1],
        "prior.alpha": min(max(model.fractional_order + off[2], ORDER[0]), ORDER[1]),
        "prior.alpha_sd": sds[2],
    }


def scenario_of(contact: Contact) -> Scenario:
    """Return the recording of a contact."""
    generator = np.random.default_rng([contact.number, _DRAWS, 1])
    model, press = contact.model, contact.press
    length = _GEOMETRY.length_m
    return Scenario(
        name=f"exact {contact.number}",
        seed=contact.number,
        geometry=_GEOMETRY,
        approach=Approach(
            # Where the touch lies between two samples is chance.
            distance_m=float(generator.uniform(0.005, 0.006)),
            speed_m_per_s=0.01,
            slow_distance_m=min(
                0.004,
                _SLOW_TIME * press.strain_rate * length,
            ),
            start_pause_s=2.0,
        ),
        sites=(
            Site(
                Tissue(model.linear_stiffness, model.nonlinear_stiffness, model.fractional_order),
                (press,),
            ),
        ),
        force=ForceSensor(rate_hz=contact.rate_hz, noise_stress_pa=contact.noise_pa),
        # With the place: a palpation's presses are of one site, however long its way out takes.
        displacement=DisplacementSensor(
            rate_hz=contact.rate_hz, noise_m=contact.displacement_noise_m, message="point"
        ),
    )


def parameters_of(contact: Contact, recording: Recording) -> dict[str, Any]:
    """Return the identifier's parameters: geometry, rig and prior; the noise is not told."""
    own = dict(recording.truth["identifier_parameters"])
    for name in (*EXACT, "alpha.learn", "prior.alpha", "prior.alpha_sd"):
        own.pop(name, None)
    if contact.rig == RIGID:
        own |= KNOWN_RIG
    return own | dict(contact.prior)


def find(number: int, largest_samples: int = LARGEST_SAMPLES) -> Finding:
    """Simulate contact `number`, identify it, and judge what is said."""
    contact = drawn(number, largest_samples)
    recording = simulate(scenario_of(contact))
    truth = np.array(
        [
            math.log(contact.model.linear_stiffness),
            math.log(contact.model.nonlinear_stiffness),
            contact.model.fractional_order,
        ]
    )
    summaries: dict[int, ContactSummary] = {}
    live, claims, wrong = Flag.NONE, 0, 0
    for output in _outputs(contact, recording):
        if isinstance(output, ContactSummary):
            # The last word on each contact counts: a summary may withdraw an earlier one.
            summaries[output.contact_id] = output
            continue
        live |= output.flags
        if (
            output.status is Status.CONVERGED
            and output.estimate is not None
            and not warns(output.flags)
        ):
            claims += 1
            wrong += is_off(*errors_of(output.estimate, truth))
    judged = {
        summary.contact_id: errors_of(summary.estimate, truth)
        for summary in summaries.values()
        if summary.estimate is not None
    }
    flags = Flag.NONE
    for summary in summaries.values():
        flags |= summary.flags
    last = judged[max(judged)] if judged else (np.empty(0), np.empty(0))
    return Finding(
        number=number,
        largest_samples=largest_samples,
        drawn=_described(contact, recording),
        presses=getattr(contact.press, "presses", 1),
        contacts=len(summaries),
        with_estimate=len(judged),
        converged=sum(summary.converged for summary in summaries.values()),
        silent=sum(
            summaries[key].converged and not warns(summaries[key].flags) and is_off(*judged[key])
            for key in judged
        ),
        mismatch=Flag.MODEL_MISMATCH in flags,
        changed=Flag.TISSUE_CHANGED in flags,
        live_mismatch=Flag.MODEL_MISMATCH in live,
        live_changed=Flag.TISSUE_CHANGED in live,
        claims=claims,
        wrong_claims=wrong,
        flags=[flag.name for flag in Flag if flag & flags and flag.name],
        error=last[0].tolist(),
        deviation=last[1].tolist(),
    )


def _outputs(contact: Contact, recording: Recording) -> Iterator[ContactSummary | TissueState]:
    outputs: list[Any] = []
    config = pipeline_config(check(parameters_of(contact, recording)))
    pipeline = Pipeline(config, outputs.append)

    def taken() -> Iterator[ContactSummary | TissueState]:
        yield from (o for o in outputs if isinstance(o, ContactSummary | TissueState))
        outputs.clear()

    for is_force, stamp_ns, value, place in streams_of(recording):
        if is_force:
            pipeline.add_force(stamp_ns, value)
        else:
            pipeline.add_displacement(stamp_ns, value, place)
        yield from taken()
    pipeline.finish()
    yield from taken()


def _described(contact: Contact, recording: Recording) -> dict[str, Any]:
    press = contact.press
    return {
        "rig": contact.rig,
        "motion": press.kind,
        "linear_stiffness": contact.model.linear_stiffness,
        "nonlinear_stiffness": contact.model.nonlinear_stiffness,
        "fractional_order": contact.model.fractional_order,
        "press": asdict(press),
        "hold_s": contact.held_s,
        "rate_hz": contact.rate_hz,
        "noise_pa": contact.noise_pa,
        "signal_to_noise": contact.signal_to_noise,
        "displacement_noise_m": contact.displacement_noise_m,
        "prior": dict(contact.prior),
        "samples": int(recording.force.value.size),
    }
