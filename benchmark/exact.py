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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from benchmark.harness import Benchmark, Goal, Report, Table, at_most, few, measured, within
from benchmark.score import ALARMS, NAMES, Outcome, figures_of, rms, share
from benchmark.trial import elapsed, log_uniform, outcome_of, through
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Prior
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation import FdenModel
from simulation.closed_form import LinearMove, stress_of_piecewise_linear_strain
from simulation.contact import contacts_of_moves
from simulation.scenario import DisplacementSensor, ForceSensor, Geometry, Scenario, Site, Tissue
from simulation.simulate import END_PAUSE_S, EXACT, KNOWN_RIG, Recording, simulate
from simulation.trajectory import Approach, Palpation, Path, Ramp, RampHold, Staircase

EPILOG = """\
examples:
  fden benchmark exact --quick
  fden benchmark exact --first 3000 --contacts 500
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

Rows = Mapping[str, Mapping[str, Any]]
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
_RESAMPLES = 1000
#: Of (ln G, ln Gn, alpha, origin, bias), the order everywhere.
_ORIGIN = 3
_STEP = 1e-4
#: Start of the iteration for the origin's step, and its length.
_FIRST_ORIGIN_STEP, _ITERATIONS = 5e-4, 2
_TIMES = 800


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


def drawn(number: int, largest_samples: int) -> Contact:
    """Return contact `number`: the same for the same limit of samples."""
    generator = np.random.default_rng([number, _DRAWS])
    motion = MOTIONS[number // 4 % len(MOTIONS)]
    while True:
        model = FdenModel(
            log_uniform(generator, *LINEAR_STIFFNESS),
            log_uniform(generator, *NONLINEAR_STIFFNESS),
            float(generator.uniform(*ORDER)),
        )
        for _ in range(_TRIES):
            press, duration = _press(generator, motion, model)
            fastest = max(min(RATE_HZ[1], largest_samples / duration), RATE_HZ[0])
            contact = Contact(
                number,
                model,
                press,
                log_uniform(generator, RATE_HZ[0], fastest),
                log_uniform(generator, *NOISE_PA),
                DISPLACEMENT_NOISE if number % 2 else 0.0,
                ARM if number // 2 % 2 else RIGID,
                _prior(generator, model),
            )
            if contact.is_pressable:
                return contact


def _press(generator: np.random.Generator, motion: str, model: FdenModel) -> tuple[Press, float]:
    """Return a motion and its duration with the air around it [s]."""
    rate, back = (log_uniform(generator, *STRAIN_RATE) for _ in range(2))
    strain = min(log_uniform(generator, *EXPONENT) / model.nonlinear_stiffness, LARGEST_STRAIN)
    hold = log_uniform(generator, *HOLD_S)
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
    sds = [log_uniform(generator, *w) for w in (PRIOR_LOG_G, PRIOR_LOG_GN, PRIOR_ORDER)]
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
    """One contact, its result, and its errors over the bound (3,); None: there is none."""

    contact: Contact
    outcome: Outcome
    over_bound: Array | None


def run_trial(number: int, samples: int) -> Trial:
    """Simulate contact `number`, identify it, and judge the result."""
    contact = drawn(number, samples)
    recording = simulate(scenario_of(contact))
    parameters = parameters_of(contact, recording)
    outcome = outcome_of(recording, through(recording, parameters)[1])
    last = outcome.contacts[-1] if outcome.contacts else None
    if not contact.has_bound or last is None or last.estimate is None:
        return Trial(contact, outcome, None)
    prior = pipeline_config(check(parameters)).estimator.prior
    return Trial(contact, outcome, last.error / _bound(contact, recording, prior))


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


# The bound


def slope(response: Callable[[Array], Array], parameters: Array, index: int, step: float) -> Array:
    """Return the central difference of a response by one parameter, shape (samples,)."""
    offset = np.zeros_like(parameters)
    offset[index] = step
    result: Array = (response(parameters + offset) - response(parameters - offset)) / (2.0 * step)
    return result


def bounds(information: Array, prior: Array) -> Array:
    """Return the least standard deviations, shape (n,).

    `information` of the data, shape (n, n), is the sum of J J^T over the variance of the noise;
    `prior`, shape (n,), has the standard deviations before; 0: known, inf: nothing is known.
    """
    unknown = np.flatnonzero(prior > 0.0)
    total = information[np.ix_(unknown, unknown)] + np.diag(prior[unknown] ** -2.0)
    result = np.zeros(prior.size)
    # Scaled, because a bias in Pa and an origin differ by orders of magnitude.
    scale = total.diagonal() ** -0.5
    inverse = np.linalg.inv(total * np.outer(scale, scale))
    result[unknown] = scale * np.sqrt(inverse.diagonal())
    return result


def contact_bounds(
    moves: Sequence[LinearMove], model: FdenModel, stamps: Array, noise_pa: float, prior: Array
) -> Array:
    r"""Return the least standard deviations after all contacts of a motion, shape (5,).

    Of (ln G, ln Gn, alpha, origin [1], bias [Pa]), as in `prior`, shape (5,); 0: known, inf:
    unknown. `moves` are the probe's, in strain from the true origin; the stress was sampled at
    `stamps` [s], shape (n,), with a standard deviation [Pa].

    No estimator that knows the prior :math:`\theta \sim N(\theta_0, P_0)` and sees the stress in
    white noise :math:`\sigma` has a smaller mean squared error than

    .. math:: \left(\frac{1}{\sigma^2} \sum_k J_k J_k^T + P_0^{-1}\right)^{-1},
              \qquad J_k = \partial f(t_k; \theta) / \partial\theta

    (Van Trees, Detection, Estimation, and Modulation Theory I, 1968, sec. 2.4; the information at
    the true parameters, for each contact its own): unknowns of an estimator are unknown here too.
    The derivative by the origin is singular at the touch, as :math:`(t - t_0)^{-\alpha}`, and a
    sample close to it would weigh more than its information. So it is a difference over the
    origin's own standard deviation to either side, found by iteration.
    """
    inside = np.zeros(stamps.shape, dtype=bool)
    for contact in contacts_of_moves(moves, model).contacts:
        inside |= (stamps > contact.start) & (stamps < contact.stop)
    times = stamps[inside]
    # The stress is smooth: samples at even distances stand for their neighbours.
    stride = max(1, times.size // _TIMES)
    times = times[stride // 2 :: stride]
    weight = math.sqrt(inside.sum() / max(times.size, 1)) / noise_pa

    def response(parameters: Array) -> Array:
        log_gn, alpha, origin = parameters
        tissue = FdenModel(model.linear_stiffness, math.exp(log_gn), float(alpha))
        return weight * contacts_of_moves(_shifted(moves, float(origin)), tissue).stress(times)

    truth = np.array([math.log(model.nonlinear_stiffness), model.fractional_order, 0.0])
    rows = np.array(
        [
            response(truth),  # by ln G
            slope(response, truth, 0, _STEP),
            slope(response, truth, 1, _STEP),
            np.zeros_like(times),
            np.full_like(times, weight),  # by the bias
        ]
    )
    if prior[_ORIGIN] == 0.0:
        return bounds(rows @ rows.T, prior)
    step = _FIRST_ORIGIN_STEP
    for _ in range(_ITERATIONS):
        rows[_ORIGIN] = slope(response, truth, 2, step)
        found = bounds(rows @ rows.T, prior)
        step = float(found[_ORIGIN])
    return found


def _shifted(moves: Sequence[LinearMove], origin: float) -> list[LinearMove]:
    """Return the linear motion in strain from another origin."""
    return [
        replace(m, start_strain=m.start_strain - origin, stop_strain=m.stop_strain - origin)
        for m in moves
    ]


# All contacts


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify and judge."""
    samples = _QUICK_SAMPLES if args.quick else LARGEST_SAMPLES
    found = measured(run_trial, [(number, samples) for number in args.numbers])
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
    over = np.array([trial.over_bound for trial in found if trial.over_bound is not None])
    bound = {name: _over_bound(values) for name, values in zip(NAMES, over.T, strict=False)}
    tables["bound"] = Table("Error over the Cramér-Rao bound", bound)
    return Report(goals_of(found, rows, bound), tables)


def _over_bound(ratios: Array) -> dict[str, Any]:
    """Return the root mean square of ratios (n,), and its 95 % interval by resampling."""
    row: dict[str, Any] = {"contacts": len(ratios), "rms": math.nan, "95 %": (math.nan, math.nan)}
    if len(ratios) > 1:
        picks = np.random.default_rng(0).integers(len(ratios), size=(_RESAMPLES, len(ratios)))
        low, high = np.quantile(np.sqrt(np.square(ratios)[picks].mean(axis=1)), [0.025, 0.975])
        row |= {"rms": float(rms(ratios)), "95 %": (float(low), float(high))}
    return row


def goals_of(found: Sequence[Trial], rows: Rows, bound: Rows) -> list[Goal]:
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
    for name, row in bound.items():
        goals.append(at_most(f"error over the bound, {name}", row["rms"], 1.25, row["95 %"]))
    return goals


BENCHMARK = Benchmark(run, EPILOG, contacts=(300, 16))
