# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tissue that does not obey the law: how often the next force lies in the predicted interval.

Poroelastic and linear solids, other relaxations, other stress-strain curves, and tissue that wears
from press to press are simulated apart from the identifier. A listener, as in a controller, gets
the states, and predicts the force of the motion of the next 3 s at five moments of each press:
three fifths of the way on the ramp, at its end, 0.5 s later, half way through the hold and 3 s
before its end. What is converged without a warning flag, or reported as of another law, is
predicted and counts: the share of the samples in the 95 % interval, and its half width in percent
of the peak; the others are refused.

N/m is compared apart, for laws without relaxation too. Each law is pressed with three probes, on
two rigs. At each moment of a press what is published, converged or not, is compared with the
simulation itself: with a step of a thousandth of the depth and without, after the time scale. What
is flagged does not count.
"""

from __future__ import annotations

import argparse
import math
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from benchmark.harness import Benchmark, Goal, Report, Table, at_least, at_most, by_case
from benchmark.score import TWO_SIDED_95, Share, mean_of, rms, share, total, warns
from benchmark.trial import begun, elapsed, fed, last_of, last_summaries, log_uniform, soft_tissue
from fden_ros.control import LiveTissue
from fden_ros.core.arrays import Array
from fden_ros.core.law import Geometry
from fden_ros.core.outputs import Flag, TissueState
from fden_ros.core.streams import NANOSECONDS
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation import Column, FdenModel, Relaxation, Tissue
from simulation.simulate import KNOWN_RIG, START_NS

EPILOG = """\
examples:
  fden benchmark laws --quick
  fden benchmark laws --cases poroelastic_2,linear_solid_1 --contacts 24

G log-uniform from 500 to 8,000 Pa, Gn 6 to 10, alpha 0.08 to 0.32 where a law has them. A punch of
10 mm radius on 20 mm of tissue, pressed to 25 % at 0.1 to 0.5/s and held for 8 to 12 s, 50 Hz,
noise of 0.1 % of the peak; three presses of one place where the tissue wears. Wide priors, the
law's error at its default; the rig's deviations 0 (testing machine) or an arm's defaults.
"""

RIGID, ARM = "testing machine", "arm's defaults"
_RIG: Mapping[str, Mapping[str, float]] = {RIGID: KNOWN_RIG, ARM: {}}
_THICKNESS_M, _AREA_M2 = 0.02, math.pi * 0.01**2
_RATE_HZ = 50.0
#: Steps of the simulation for each sample, and their length [s].
_CUTS = 10
_STEP = 1.0 / (_RATE_HZ * _CUTS)
#: Of the peak.
_NOISE_SHARE = 1e-3
_MAX_STRAIN = 0.25
#: Before the first press, between two, and after the last; the probe starts at this height [m],
#: at the rate of the press.
_AIR_S, _HEIGHT_M = 2.0, 0.002
_RETRACT_RATE = 0.5
#: What is predicted [s].
AHEAD_S = 3.0
#: Times of the predictions on the ramp, as a share of its part in contact.
_ON_RAMP = 0.6
_LATER_S = 0.5
#: Of a press, in the order of time.
MOMENTS = ("on the ramp", "its end", "0.5 s later", "half way", "3 s before the end")

#: From the strains of the probe at the end of each step to stresses.
Stress = Callable[[Array], Array]

_FLAT = {
    "geometry.kind": "flat_punch",
    "geometry.area": _AREA_M2,
    "geometry.thickness": _THICKNESS_M,
}
_SPHERE = {"geometry.kind": "sphere", "geometry.radius": 0.01}
GEOMETRIES: Mapping[str, Mapping[str, Any]] = {
    "flat punch": _FLAT,
    "punch in a wide layer": {
        **_FLAT,
        "geometry.area": math.pi * 0.005**2,
        "geometry.hayes": True,
    },
    "sphere": _SPHERE,
    "sphere on a layer": {**_SPHERE, "geometry.thickness": 0.01},
}
#: How long the small motion lasts [s], and its size in parts of the compression [1].
TIME_SCALE, _SIZE = 0.1, 1e-3
#: Resolution of the simulation: its step is a fiftieth of the time scale [1].
_RESOLUTION = 0.005


#: Terms of the series of one-dimensional consolidation; the next is 1e-4 of the first.
_CONSOLIDATION_TERMS = 50
#: Exponentials of a box spectrum for each factor e of time: a ripple of 1e-5.
_PER_E_FOLD = 4.0


# Laws


def springpot(order: float) -> Relaxation:
    """Return the relaxation of the FDEN law."""
    return Relaxation(springpots=((1.0, order),))


def standard_linear_solid(time_s: float, left: float = 0.5) -> Relaxation:
    """Return a relaxation to the fraction `left` with one time constant [s]."""
    return Relaxation(exponentials=((left, 0.0), (1.0 - left, 1.0 / time_s)))


def poroelastic(time_s: float, drop: float = 1.0) -> Relaxation:
    """Return that of a layer that drains under pressure, its slowest time `time_s` [s].

    Terzaghi's one-dimensional consolidation: 1 in the end and 1 + `drop` at first.
    """
    odd = 2.0 * np.arange(_CONSOLIDATION_TERMS) + 1.0
    weights = drop * 8.0 / (math.pi * odd) ** 2
    series = zip(weights.tolist(), (odd**2 / time_s).tolist(), strict=True)
    return Relaxation(exponentials=((1.0, 0.0), *series))


def quasi_linear(strength: float, shortest_s: float, longest_s: float) -> Relaxation:
    """Return Fung's relaxation: a spectrum `strength`/tau between two times [s]."""
    span = math.log(longest_s / shortest_s)
    count = math.ceil(_PER_E_FOLD * span)
    # Midpoints in ln(tau).
    times = shortest_s * np.exp(span * (np.arange(count) + 0.5) / count)
    scale = 1.0 / (1.0 + strength * span)
    weight = scale * strength * span / count
    return Relaxation(exponentials=((scale, 0.0), *((weight, 1.0 / t) for t in times.tolist())))


@dataclass(frozen=True)
class Law:
    r"""A tissue that is not FDEN.

    Its stress is a relaxation behind a characteristic, as in quasi-linear viscoelasticity,

    .. math:: f(t) = \int_0^t g(t - s)\,\frac{d\varphi(x(s))}{ds}\,ds .

    It may also wear from press to press: it softens, or its surface stays lower. Contact pushes
    and never pulls, as in :mod:`fden_ros.simulation.tissue`, whose steps these are.
    """

    model: FdenModel  #: G, and Gn where the characteristic is that of FDEN; its alpha is not used
    relaxation: Relaxation  #:
    #: As in :class:`~fden_ros.simulation.tissue.Column`
    characteristic: Callable[[float], float] | None = None
    softening: float = 0.0  #: Share of the stiffness that each press takes
    set_strain: float = 0.0  #: By how much each press leaves the surface lower, as a strain


def stress_of_law(law: Law, strains: Array, step: float) -> Array:
    """Return the stress (n,) [Pa] at the end of each step [s] of a motion from rest.

    `strains` (n,) are those of the probe, negative in the air; linear in between. A press is over,
    and has worn the tissue, where the probe is above the undisturbed surface again.
    """
    column = Column(law.model, relaxation=law.relaxation, characteristic=law.characteristic)
    tissue = Tissue([column], step)
    stress = np.zeros(len(strains))
    presses, in_press = 0, False
    for n, strain in enumerate(strains.tolist()):
        if in_press and strain < 0.0:
            presses, in_press = presses + 1, False
            tissue.columns = (replace(column, scale=(1.0 - law.softening) ** presses),)
        stress[n] = tissue.press(strain - presses * law.set_strain)
        in_press |= stress[n] > 0.0
    return stress


class Case(NamedTuple):
    """One law: from a model whose numbers are drawn to the tissue, and presses of one place."""

    name: str
    says: str
    law: Callable[[FdenModel], Law]
    presses: int = 1


def _own(name: str, says: str, presses: int = 1, **changes: Any) -> Case:
    """Return a law whose relaxation is FDEN's own unless it is among the changes."""

    def law(model: FdenModel) -> Law:
        return Law(model, **{"relaxation": springpot(model.fractional_order)} | changes)

    return Case(name, says, law, presses)


def _springpot_and_spring(model: FdenModel) -> Law:
    half = ((0.5, model.fractional_order),)
    return Law(model, Relaxation(springpots=half, exponentials=((0.5, 0.0),)))


_TWO = Relaxation(springpots=((0.5, 0.1), (0.5, 0.4)))
_ALL = (
    _own("poroelastic_2", "poroelastic, 2 s", relaxation=poroelastic(2.0)),
    _own("poroelastic_20", "poroelastic, 20 s", relaxation=poroelastic(20.0)),
    _own("linear_solid_1", "standard linear solid, 1 s", relaxation=standard_linear_solid(1.0)),
    _own("linear_solid_10", "standard linear solid, 10 s", relaxation=standard_linear_solid(10.0)),
    _own("quasi_linear", "quasi-linear viscoelastic", relaxation=quasi_linear(0.15, 0.01, 100.0)),
    _own("two_springpots", "two fractional elements", relaxation=_TWO),
    Case("springpot_and_spring", "fractional and elastic", _springpot_and_spring),
    # Three times the linear stress at the deepest.
    _own("cubic", "cubic stress-strain curve", characteristic=lambda x: x + 32.0 * x**3),
    _own("power_law", "stress-strain curve of power 1.5", characteristic=lambda x: 2.0 * x**1.5),
    _own("softens_3", "softens by 3 % a press", 3, softening=0.03),
    _own("softens_10", "softens by 10 % a press", 3, softening=0.1),
    _own("set_0.1mm", "stays 0.1 mm lower a press", 3, set_strain=1e-4 / _THICKNESS_M),
    _own("fden", "the law itself"),
    _own("fden_three", "the law itself, three presses", 3),
)
CASES = {case.name: case for case in _ALL}
#: Only their N/m is compared: they have no relaxation of their own.
_OTHERS = {"kelvin_voigt": "spring and dashpot", "hunt_crossley": "Hunt and Crossley"}
#: Laws that change smoothly: none of their tissues changes under the probe.
_SMOOTH = ("linear_solid_10", "poroelastic_20", "softens_10")
_ITSELF = ("fden", "fden_three")


@dataclass(frozen=True)
class Recording:
    """Samples of force and displacement at the same instants, arrays of shape (n,)."""

    times: Array  #: [s]
    forces: Array  #: with noise [N]
    displacements: Array  #: [m]
    peak_n: float  #: largest force without noise [N]
    moments: tuple[tuple[str, float], ...]  #: which of MOMENTS, time [s]


class Predicted(NamedTuple):
    """The prediction at one moment; shares of the peak."""

    inside: float  #: share of the samples of the next 3 s in the 95 % interval
    half_width: float  #: of that interval, median
    error: float  #: root mean square


class Trial(NamedTuple):
    """One recording."""

    predictions: tuple[tuple[str, Predicted | None], ...]  #: by moment; None: refused
    mismatch: Share  #: of the contacts in summaries
    changed: Share


def _drawn(name: str, number: int) -> tuple[np.random.Generator, FdenModel, float]:
    """Return the generator of recording `number` of a case, its model and its rate [1/s]."""
    generator = np.random.default_rng([zlib.crc32(name.encode()), number])
    return generator, soft_tissue(generator), log_uniform(generator, 0.1, 0.5)


def _motion(
    rate: float, top: float, hold: float, presses: int = 1
) -> tuple[Array, Array, list[tuple[float, float]]]:
    """Return times [s] and strains of steps, and from when to when each press is held [s]."""
    knots, strains = [0.0, _AIR_S], [top, top]
    holds: list[tuple[float, float]] = []
    for _ in range(presses):
        deepest = knots[-1] + (_MAX_STRAIN - top) / rate
        lifted = deepest + hold
        holds.append((deepest, lifted))
        out = lifted + (_MAX_STRAIN - top) / _RETRACT_RATE
        knots += [deepest, lifted, out, out + _AIR_S]
        strains += [_MAX_STRAIN, _MAX_STRAIN, top, top]
    times: Array = _STEP * np.arange(1.0, int(knots[-1] / _STEP) + 1.0)
    return times, np.interp(times, knots, strains), holds


def recorded(case: Case, number: int) -> Recording:
    """Return recording `number` of a case."""
    generator, model, rate = _drawn(case.name, number)
    hold = float(generator.uniform(8.0, 12.0))
    top = -_HEIGHT_M / _THICKNESS_M * float(generator.uniform(1.0, 1.2))
    fine, motion, holds = _motion(rate, top, hold, case.presses)
    forces = _AREA_M2 * stress_of_law(case.law(model), motion, _STEP)[_CUTS - 1 :: _CUTS]
    peak = float(forces.max())
    times: Array = fine[_CUTS - 1 :: _CUTS]
    moments = []
    for deepest, lifted in holds:
        # The tissue has not recovered from the last press: the touch is below the surface.
        touch = float(times[(times < deepest) & (forces == 0.0)][-1])
        instants = (
            *(touch + _ON_RAMP * (deepest - touch), deepest, deepest + _LATER_S),
            *(0.5 * (deepest + lifted), lifted - AHEAD_S),
        )
        moments += list(zip(MOMENTS, instants, strict=True))
    noise = _NOISE_SHARE * peak * generator.standard_normal(forces.size)
    depths = _THICKNESS_M * motion[_CUTS - 1 :: _CUTS]
    return Recording(times, forces + noise, depths, peak, tuple(moments))


def run_trial(which: tuple[str, str], number: int) -> Trial:
    """Simulate recording `number` of a law, identify it on a rig and predict from its moments."""
    name, rig = which
    recording, parameters = recorded(CASES[name], number), {**_FLAT, **_RIG[rig]}
    config = pipeline_config(check(parameters))
    live = LiveTissue(config.geometry, uncertainty=config.estimator.uncertainty, real_time=False)
    pipeline, outputs = begun(parameters)
    count, heard = 0, -math.inf
    predictions: list[tuple[str, Predicted | None]] = []
    waiting = list(recording.moments)
    samples = (recording.times, recording.forces, recording.displacements)
    for _ in fed(pipeline, *samples, placed=True):
        for state in outputs[count:]:
            if isinstance(state, TissueState):
                live.add(state, state.stamp_ns / NANOSECONDS)
                heard = elapsed(state.stamp_ns)
        count = len(outputs)
        if waiting and heard >= waiting[0][1]:
            predictions.append((waiting.pop(0)[0], _predicted(recording, live, heard)))
    pipeline.finish()
    flags = [summary.flags for summary in last_summaries(outputs).values()]
    mismatch, changed = (
        share(f & flag for f in flags) for flag in (Flag.MODEL_MISMATCH, Flag.TISSUE_CHANGED)
    )
    return Trial(tuple(predictions), mismatch, changed)


def _predicted(recording: Recording, live: LiveTissue, heard: float) -> Predicted | None:
    """Return a listener's prediction at `heard` [s] for the motion that follows."""
    predictor = live.predictor(START_NS / NANOSECONDS + heard)
    if predictor is None:
        return None
    half = 0.5 / _RATE_HZ
    first, last = np.searchsorted(recording.times, [heard + half, heard + AHEAD_S + half])
    times, depths = recording.times[first:last], recording.displacements[first:last]
    start = float(np.interp(heard, recording.times, recording.displacements))
    prediction = predictor.force(times - heard, depths - start)
    off = prediction.value - recording.forces[first:last]
    width = TWO_SIDED_95 * prediction.sd
    half_width, error = float(np.median(width)), float(rms(off))
    inside = float(np.mean(np.abs(off) <= width))
    return Predicted(inside, half_width / recording.peak_n, error / recording.peak_n)


# N/m


class Found(NamedTuple):
    """N/m at one moment."""

    is_flagged: bool
    is_inside: bool  #: the truth lies in the 95 % interval
    ratio: float  #: to the truth
    half_width: float  #: of the interval, in parts of the value


def run_stiffness(which: tuple[str, str, str], number: int) -> list[Found | None]:
    """Press a law once; return N/m at the moments of the press, None where it is not known.

    The strains are pressed whatever the geometry: the path follows from them.
    """
    name, probe, rig = which
    generator, model, rate = _drawn(f"{name}, {probe}", number)
    top = -_HEIGHT_M / _THICKNESS_M
    fine, strains, holds = _motion(rate, top, float(generator.uniform(3.0, 6.0)))
    deepest, lifted = holds[0]
    noise = _NOISE_SHARE * generator.standard_normal(fine.size // _CUTS)
    touch = _AIR_S - top / rate
    waiting = [touch + _ON_RAMP * (deepest - touch), deepest, 0.5 * (deepest + lifted), lifted]
    stress, parameters = _stress_of(name, generator, model), {**GEOMETRIES[probe], **_RIG[rig]}
    geometry = pipeline_config(check(parameters)).geometry
    compressions = np.sign(strains) * [geometry.compression(x) for x in np.abs(strains)]
    forces = stress(strains)[_CUTS - 1 :: _CUTS] / geometry.stress_per_force
    forces = forces + noise * forces.max()
    depths = geometry.length * compressions[_CUTS - 1 :: _CUTS]
    times = _STEP * _CUTS * np.arange(1.0, depths.size + 1.0)
    pipeline, outputs = begun(parameters)
    found: list[Found | None] = []
    for _ in fed(pipeline, times, forces, depths, placed=True):
        state = last_of(TissueState, outputs)
        if waiting and state is not None and elapsed(state.stamp_ns) >= waiting[0]:
            waiting.pop(0)
            before = strains[: round(elapsed(state.stamp_ns) / _STEP)]
            found.append(_compared(state, _truth(before, stress, geometry)))
    return found


def _compared(state: TissueState, truth: float) -> Found | None:
    one = state.apparent_stiffness
    if one is None:
        return None
    reach = TWO_SIDED_95 * one.sd
    is_inside = abs(one.value - truth) <= reach + _RESOLUTION * truth
    return Found(warns(state.flags), is_inside, one.value / truth, reach / one.value)


def _truth(before: Array, stress: Stress, geometry: Geometry) -> float:
    """Return what a small step after such strains meets after the time scale [N/m]."""
    compression = geometry.compression(float(before[-1]))
    count, forces = round(TIME_SCALE / _STEP), []
    for moved in (compression, compression * (1.0 + _SIZE)):
        stays = np.full(count, geometry.strain(moved))
        after = stress(np.concatenate([before, stays]))[-1]
        forces.append(float(after) / geometry.stress_per_force)
    return (forces[1] - forces[0]) / (_SIZE * compression * geometry.length)


def stiffness_row(found: Sequence[Found | None]) -> dict[str, Any]:
    """Return the figures of a law."""
    known = [one for one in found if one is not None]
    counted = [one for one in known if not one.is_flagged]
    return {
        "known": Share(len(known), len(found)),
        "flagged": share(one.is_flagged for one in known),
        "in 95 %": share(one.is_inside for one in counted),
        "ratio, median": _middle(one.ratio for one in counted),
        "half width": _middle(one.half_width for one in counted),
    }


def _middle(values: Iterable[float]) -> float:
    known = list(values)
    return float(np.median(known)) if known else math.nan


def _stress_of(name: str, generator: np.random.Generator, model: FdenModel) -> Stress:
    """Return the stress of a law, of spring and dashpot, or of Hunt and Crossley, in contact."""
    if name in CASES:
        return lambda strains: stress_of_law(CASES[name].law(model), strains, _STEP)
    is_dashpot = name == "kelvin_voigt"
    if is_dashpot:
        exponent, damping = 1.0, float(generator.uniform(0.02, 0.2))
    else:
        exponent, damping = generator.uniform([1.0, 0.1], [2.0, 1.0]).tolist()
    scale = model.linear_stiffness * (1.0 if is_dashpot else 4.0)

    def stress(strains: Array) -> Array:
        inside = np.maximum(strains, 0.0)
        rates = damping * np.diff(inside, prepend=0.0) / _STEP
        pushed = inside + rates if is_dashpot else inside**exponent * (1.0 + rates)
        return np.maximum(scale * pushed, 0.0) * (strains > 0.0)

    return stress


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify, predict and judge."""
    rigs = (RIGID,) if args.quick else (RIGID, ARM)
    tasks = [
        ((case.name, rig), number)
        for rig in rigs
        for case in args.cases
        for number in args.numbers
    ]
    found = by_case(run_trial, tasks, "recordings")
    rows = {f"{CASES[name].says}, {rig}": row_of(some) for (name, rig), some in found.items()}
    stiffness = _stiffness_rows(args, rigs)
    goals = goals_of(rows, {name: trials for (name, rig), trials in found.items() if rig == RIGID})
    goals += [
        at_least(f"N/m in its 95 % interval: {name}", row["in 95 %"].value, 0.9)
        for name, row in stiffness.items()
        if name.startswith("all")
    ]
    tables = {
        "laws": Table("The force of the next 3 s on tissue of other laws", rows),
        "N/m": Table(f"N/m after {TIME_SCALE:g} s on tissue of other laws", stiffness),
    }
    return Report(goals, tables)


def _stiffness_rows(args: argparse.Namespace, rigs: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the figures of N/m: of each law, and of all on each rig."""
    names = [case.name for case in args.cases if case.presses == 1] + list(_OTHERS)
    tasks = [
        ((name, geometry, rig), number)
        for rig in rigs
        for name in names
        for geometry in GEOMETRIES
        for number in args.numbers
    ]
    trials = by_case(run_stiffness, tasks, "presses")
    groups: dict[str, list[Found | None]] = {}
    for (name, geometry, rig), own in trials.items():
        moments = [moment for trial in own for moment in trial]
        says = CASES[name].says if name in CASES else _OTHERS[name]
        for group in (f"{says}, {rig}", f"all, {geometry}, {rig}", f"all, {rig}"):
            groups.setdefault(group, []).extend(moments)
    return {group: stiffness_row(found) for group, found in groups.items()}


def row_of(trials: Sequence[Trial]) -> dict[str, Any]:
    """Return the figures of a law on a rig."""
    moments = [moment for trial in trials for moment in trial.predictions]
    used = [(name, prediction) for name, prediction in moments if prediction is not None]
    return {
        "in 95 %": mean_of(p.inside for _, p in used),
        "at each moment": [mean_of(p.inside for at, p in used if at == name) for name in MOMENTS],
        "half width": _middle(p.half_width for _, p in used),
        "error": _middle(p.error for _, p in used),
        "refused": Share(len(moments) - len(used), len(moments)),
        "mismatch": total(trial.mismatch for trial in trials),
        "changed": total(trial.changed for trial in trials),
    }


def goals_of(
    rows: Mapping[str, Mapping[str, Any]], rigid: Mapping[str, Sequence[Trial]]
) -> list[Goal]:
    """Compare each law with the goals."""
    smooth, itself = (
        total(trial.changed for name in names for trial in rigid.get(name, ())).value
        for names in (_SMOOTH, _ITSELF)
    )
    return [
        *(
            at_least(f"in the 95 % interval: {name}", row["in 95 %"], 0.9)
            for name, row in rows.items()
        ),
        at_most("smooth laws reported as changed", smooth, 0.02),
        at_most("the law itself reported as changed", itself, 1e-3),
    ]


BENCHMARK = Benchmark(
    run,
    EPILOG,
    cases=CASES,
    quick=("poroelastic_2", "linear_solid_1", "cubic", "fden"),
    contacts=(12, 1),
)
