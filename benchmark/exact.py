# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contacts on tissue that obeys the law exactly, over all of its range: alarms and errors.

Tissue, motion, rate, noise and prior are drawn (see below), simulated apart from the identifier,
and identified with the noise as it is measured in the air; the rig's deviations are 0 and an arm's
defaults in turn. A *false alarm* is a contact whose summary reports a mismatch or a change, *live*
where any state does; *undetected* is one that is converged, unflagged, and off by more than five
stated deviations and 3 % (0.01 of alpha). Error over the bound: of what is known exactly but the
tissue (rig, motion, a linear part that is seen) over the least that is possible.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from benchmark.bound import contact_bounds
from benchmark.harness import Benchmark, Goal, Report, Table, at_most, few, measured, within
from benchmark.score import ALARMS, NAMES, Outcome, bootstrapped, figures_of, share
from benchmark.trial import elapsed, outcome_of, through
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Prior
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation import FdenModel
from simulation.closed_form import LinearMove, stress_of_piecewise_linear_strain
from simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import END_PAUSE_S, EXACT, KNOWN_RIG, Recording, simulate
from simulation.trajectory import Approach, Palpation, Path, Ramp, RampHold, Staircase

EPILOG = """\
examples:
  fden benchmark exact --quick
  fden benchmark exact --first 3000 --contacts 500 --jobs 2
  fden benchmark exact --json | jq '.figures.rows'

Drawn log-uniform: G 20 to 50,000, Gn 1 to 40, noise 3 to 300 Pa, 30 Hz to 1 kHz, holds of 0.1 to
600 s, strain rates of 0.02 to 1/s; alpha uniform from 0.02 to 0.6; ramps, staircases, ramps with a
hold, three presses of one place. A press goes to a Gn x of 0.7 to 6, at most to half of the
thickness, takes 20 times the noise or more and at most 63 N; what does not is drawn anew. Half of
the priors are the default one, the others up to two of their deviations off; every other contact
has 1 um of noise in the displacement. Linear part hidden: G/Gn, about the stress at the boundary
strain, is below the noise of a sample.
"""

#: Ranges of what is drawn, log-uniform but for alpha.
LINEAR_STIFFNESS = (20.0, 50_000.0)  # [Pa s^alpha]
NONLINEAR_STIFFNESS = (1.0, 40.0)
ORDER = (0.02, 0.6)
NOISE_PA = (3.0, 300.0)
RATE_HZ = (30.0, 1000.0)
HOLD_S = (0.1, 600.0)
STRAIN_RATE = (0.02, 1.0)  # [1/s], in and out
#: Gn x at the deepest, where the stress is up to e^5 times that at the boundary strain: no press
#: is deeper in practice, and none exceeds LARGEST_STRAIN.
EXPONENT, LARGEST_STRAIN = (0.7, 6.0), 0.5
#: Largest stress of a press, in multiples of its noise, and in absolute terms [Pa]: 60 N.
SIGNAL_TO_NOISE, LARGEST_STRESS = 20.0, 2e5
#: Samples in a ramp.
RAMP_SAMPLES = 5
#: Largest number of samples of a contact, unless the slowest rate takes more.
LARGEST_SAMPLES, _QUICK_SAMPLES = 12_000, 1500
#: Half of the priors are the default one, the others are this wide [1] and off by up to this many
#: of their deviations.
PRIOR_LOG_G, PRIOR_LOG_GN, PRIOR_ORDER = (0.1, 2.0), (0.1, 0.9), (0.01, 0.14)
PRIOR_OFF = 2.0
#: The largest median of Gn that may be stated [1].
MOST_PRIOR_NONLINEAR = 100.0
#: Every other contact has this noise of the displacement [m].
DISPLACEMENT_NOISE = 1e-6

Press = Ramp | RampHold | Staircase | Palpation
RIGID, ARM = "rig known", "arm's defaults"
MOTIONS = ("ramp", "staircase", "ramp_hold", "palpation")
_GEOMETRY = Geometry("flat_punch", radius_m=0.01, thickness_m=0.02)
_PRESSES = 3
#: The end of the approach is at the rate of the press, for this time [s].
_SLOW_TIME = 0.3
#: In the air before a touch and after the last [s], about.
_AIR_S = 3.5
_DRAWS = 23
#: The bound is that of contacts held for less [s]: its samples are spread evenly.
_BOUND_HOLD_S = 10.0
#: A tissue that cannot be pressed by this number of drawn motions is drawn anew.
_TRIES = 50


@dataclass(frozen=True)
class Contact:
    """A press, its tissue, and the identifier's settings; `number` is the seed.

    `rig` is RIGID, with deviations of 0, or ARM, with the defaults; `prior` holds parameters of
    the identifier, none for the default prior.
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
        return float(getattr(self.press, "hold_s", 0.0)) * getattr(self.press, "steps", 1)

    @property
    def peak_pa(self) -> float:
        """Stress at the end of a ramp to the largest strain [Pa]."""
        strain = self.press.max_strain
        end = strain / self.press.strain_rate
        return float(stress_of_piecewise_linear_strain([0.0, end], [0.0, strain], end, self.model))

    @property
    def is_hidden(self) -> bool:
        """Whether the stress at the boundary strain is below the noise of a sample."""
        return self.model.linear_stiffness < self.noise_pa * self.model.nonlinear_stiffness

    @property
    def has_bound(self) -> bool:
        """Whether all but the tissue is known, so that the bound exists."""
        is_known = self.rig == RIGID and not self.displacement_noise_m
        return is_known and not self.is_hidden and self.held_s < _BOUND_HOLD_S

    @property
    def is_pressable(self) -> bool:
        """Whether the press is realistic."""
        ramp = self.press.max_strain / self.press.strain_rate
        is_seen = SIGNAL_TO_NOISE * self.noise_pa <= self.peak_pa <= LARGEST_STRESS
        return is_seen and ramp * self.rate_hz >= RAMP_SAMPLES


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
            if contact.is_pressable:
                return contact


def _log_uniform(generator: np.random.Generator, limits: tuple[float, float]) -> float:
    return float(math.exp(generator.uniform(math.log(limits[0]), math.log(limits[1]))))


def _press(generator: np.random.Generator, motion: str, model: FdenModel) -> tuple[Press, float]:
    """Return a motion and its duration with the air around it [s]."""
    rate, back = (_log_uniform(generator, STRAIN_RATE) for _ in range(2))
    strain = min(_log_uniform(generator, EXPONENT) / model.nonlinear_stiffness, LARGEST_STRAIN)
    hold = _log_uniform(generator, HOLD_S)
    moved = _AIR_S + strain / rate + strain / back
    if motion == "ramp":
        return Ramp(rate, strain, back), moved
    if motion == "ramp_hold":
        return RampHold(rate, strain, hold, back), moved + hold
    if motion == "palpation":
        press = Palpation(rate, strain, hold / _PRESSES, back, presses=_PRESSES, pause_s=0.5)
        return press, _PRESSES * moved + hold
    steps = int(generator.integers(2, 5))
    return Staircase(rate, strain, steps, hold / steps, back), moved + hold


def _prior(generator: np.random.Generator, model: FdenModel) -> dict[str, float]:
    """Return the parameters of a prior; empty: the default one."""
    is_default = bool(generator.integers(2))
    sds = [_log_uniform(generator, w) for w in (PRIOR_LOG_G, PRIOR_LOG_GN, PRIOR_ORDER)]
    off = generator.uniform(-PRIOR_OFF, PRIOR_OFF, 3) * sds
    if is_default:
        return {}
    g_n = model.nonlinear_stiffness * math.exp(off[1])
    return {
        "prior.linear_stiffness": model.linear_stiffness * math.exp(off[0]),
        "prior.linear_stiffness_log_sd": sds[0],
        "prior.nonlinear_stiffness": min(g_n, MOST_PRIOR_NONLINEAR),
        "prior.nonlinear_stiffness_log_sd": sds[1],
        "prior.alpha": min(max(model.fractional_order + off[2], ORDER[0]), ORDER[1]),
        "prior.alpha_sd": sds[2],
    }


def scenario_of(contact: Contact) -> Scenario:
    """Return the recording of a contact."""
    generator = np.random.default_rng([contact.number, _DRAWS, 1])
    model, press = contact.model, contact.press
    tissue = Tissue(model.linear_stiffness, model.nonlinear_stiffness, model.fractional_order)
    return Scenario(
        name=f"exact {contact.number}",
        seed=contact.number,
        geometry=_GEOMETRY,
        approach=Approach(
            # The touch lies anywhere between two samples.
            distance_m=float(generator.uniform(0.005, 0.006)),
            speed_m_per_s=0.01,
            slow_distance_m=min(0.004, _SLOW_TIME * press.strain_rate * _GEOMETRY.length_m),
            start_pause_s=2.0,
        ),
        sites=(Site(tissue, (press,)),),
        force=ForceSensor(rate_hz=contact.rate_hz, noise_stress_pa=contact.noise_pa),
        # With the place: a palpation's presses are of one site, however long its retract takes.
        displacement=DisplacementSensor(
            rate_hz=contact.rate_hz, noise_m=contact.displacement_noise_m, message="point"
        ),
    )


def parameters_of(contact: Contact, recording: Recording) -> dict[str, Any]:
    """Return the identifier's parameters: geometry, rig and prior, without the noise."""
    own = dict(recording.truth["identifier_parameters"])
    for name in (*EXACT, "alpha.learn", "prior.alpha", "prior.alpha_sd"):
        own.pop(name, None)
    return own | (KNOWN_RIG if contact.rig == RIGID else {}) | dict(contact.prior)


class Trial(NamedTuple):
    """One contact, its estimate, and the least deviations of ln G, ln Gn, alpha (3,)."""

    contact: Contact
    outcome: Outcome
    bound: Array | None

    @property
    def over_bound(self) -> Array | None:
        """Errors over the bound (3,); None: no bound or no estimate."""
        last = self.outcome.contacts[-1] if self.outcome.contacts else None
        if self.bound is None or last is None or last.estimate is None:
            return None
        ratio: Array = last.error / self.bound
        return ratio


def run_trial(number: int, samples: int) -> Trial:
    """Simulate contact `number`, identify it, and judge the result."""
    contact = drawn(number, samples)
    recording = simulate(scenario_of(contact))
    parameters = parameters_of(contact, recording)
    config = pipeline_config(check(parameters))
    bound = _bound(contact, recording, config.estimator.prior) if contact.has_bound else None
    outcome = outcome_of(recording, through(recording, config)[1])
    return Trial(contact, outcome, bound)


def _bound(contact: Contact, recording: Recording, prior: Prior) -> Array:
    """Return the bound with the identifier's own prior, and the air before the touch."""
    stamps = np.array([elapsed(stamp) for stamp in recording.force.stamp_ns.tolist()])
    in_air = int(np.sum(stamps < elapsed(recording.truth["contacts"][0]["start_ns"])))
    deviations = (
        *(prior.linear_stiffness_log_sd, prior.nonlinear_stiffness_log_sd),
        *(prior.fractional_order_sd, math.inf, contact.noise_pa / math.sqrt(in_air)),
    )
    approach = scenario_of(contact).approach
    path = Path(-approach.distance_m / _GEOMETRY.length_m, _GEOMETRY.length_m)
    path.rest(approach.start_pause_s)
    contact.press.press(path, approach)
    path.rest(END_PAUSE_S)
    moves = [move for move in path.moves if isinstance(move, LinearMove)]
    prior_sds = np.array(deviations)
    return contact_bounds(moves, contact.model, stamps, contact.noise_pa, prior_sds)[:3]


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify and judge."""
    usual = _QUICK_SAMPLES if args.quick else LARGEST_SAMPLES
    samples = args.samples or usual
    tasks = [(number,) for number in args.numbers]
    found = measured(run_trial, tasks, samples, jobs=args.jobs)
    return report_of(found)


def report_of(found: Sequence[Trial]) -> Report:
    """Return goals and tables of the trials."""
    contacts = [trial.contact for trial in found]
    groups: dict[str, list[bool]] = {
        "all": [True for _ in contacts],
        **{rig: [c.rig == rig for c in contacts] for rig in (RIGID, ARM)},
        **{motion: [c.press.kind == motion for c in contacts] for motion in MOTIONS},
        "held 10 to 100 s": [10.0 <= c.held_s < 100.0 for c in contacts],
        "held for longer": [c.held_s >= 100.0 for c in contacts],
        "linear part hidden": [c.is_hidden for c in contacts],
        "linear part seen": [not c.is_hidden for c in contacts],
        "below 100 Hz": [c.rate_hz < 100.0 for c in contacts],
        "above 300 Hz": [c.rate_hz >= 300.0 for c in contacts],
    }
    rows = {
        name: figures_of([trial.outcome for trial, one in zip(found, some, strict=True) if one])
        for name, some in groups.items()
        if any(some)
    }
    tables = {"rows": Table("Tissue that obeys the law", rows)}
    over = [trial.over_bound for trial in found if trial.over_bound is not None]
    if over:
        tables["bound"] = Table("Error over the Cramér-Rao bound", _over_bound(np.array(over)))
    return Report(goals_of(found, rows), tables)


def _over_bound(ratios: Array) -> dict[str, dict[str, Any]]:
    """Return root mean squares of ratios (n, 3), and their 95 % intervals, by parameter."""
    rows = {}
    for name, values in zip(NAMES, ratios.T, strict=True):
        rms, low, high = bootstrapped(np.square(values), np.sqrt)
        rows[name] = {"contacts": len(values), "rms": rms, "95 %": (low, high)}
    return rows


def goals_of(found: Sequence[Trial], rows: Mapping[str, Mapping[str, Any]]) -> list[Goal]:
    """Compare the contacts with the goals."""
    every = rows["all"]
    undetected = share(any(c.is_undetected for c in trial.outcome.contacts) for trial in found)
    alarms = share(
        any(c.number >= 0 and c.flags & ALARMS for c in trial.outcome.contacts) for trial in found
    )
    goals = [
        few("undetected gross errors: converged, unflagged and off", undetected, 1e-3),
        few("false alarms: reported as mismatch or change", alarms, 1.0 / 300.0),
        few("false alarms: reported at any moment", every["live alarm"], 1.0 / 300.0),
        at_most("live: unflagged CONVERGED states that are off", every["live"].value, 1e-3),
    ]
    for index, name in enumerate(NAMES):
        goals.append(
            within(f"error over deviation, {name}", every["error over sd"][index], (0.6, 1.3))
        )
        goals.append(within(f"in the 95 % interval, {name}", every["in 95 %"][index], (0.9, 1.0)))
        if hidden := rows.get("linear part hidden"):
            words = f"linear part hidden: error over deviation, {name}"
            goals.append(at_most(words, hidden["error over sd"][index], 1.3))
    over = [trial.over_bound for trial in found if trial.over_bound is not None]
    for name, row in _over_bound(np.array(over).reshape(-1, 3)).items():
        goals.append(at_most(f"error over the bound, {name}", row["rms"], 1.25, row["95 %"]))
    return goals


def _more(parser: argparse.ArgumentParser) -> None:
    words = f"most samples of a contact, down to 30 Hz (default: {LARGEST_SAMPLES})"
    parser.add_argument("--samples", type=int, metavar="N", help=words)


BENCHMARK = Benchmark(run, EPILOG, contacts=(300, 16), more=_more)
