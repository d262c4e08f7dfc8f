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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from benchmark.harness import Benchmark, Goal, Report, Table, at_least, at_most, by_case
from benchmark.other_laws import (
    Law,
    Relaxation,
    poroelastic,
    quasi_linear,
    springpot,
    standard_linear_solid,
    stress_of_law,
)
from benchmark.score import TWO_SIDED_95, Share, mean_of, rms, share, total, warns
from benchmark.trial import elapsed, fed, last_summaries
from fden_ros.control import LiveTissue
from fden_ros.core.arrays import Array
from fden_ros.core.law import Geometry
from fden_ros.core.outputs import Flag, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams import NANOSECONDS
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation import FdenModel
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

GEOMETRIES: Mapping[str, Mapping[str, Any]] = {
    "flat punch": {
        "geometry.kind": "flat_punch",
        "geometry.area": math.pi * 0.01**2,
        "geometry.thickness": 0.02,
    },
    "punch in a wide layer": {
        "geometry.kind": "flat_punch",
        "geometry.area": math.pi * 0.005**2,
        "geometry.thickness": 0.02,
        "geometry.hayes": True,
    },
    "sphere": {"geometry.kind": "sphere", "geometry.radius": 0.01},
    "sphere on a layer": {
        "geometry.kind": "sphere",
        "geometry.radius": 0.01,
        "geometry.thickness": 0.01,
    },
}
#: How long the small motion lasts [s], and its size in parts of the compression [1].
TIME_SCALE, _SIZE = 0.1, 1e-3
#: Resolution of the simulation: its step is a fiftieth of the time scale [1].
_RESOLUTION = 0.005


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


@dataclass(frozen=True)
class Recording:
    """Samples of force and displacement at the same instants, arrays of shape (n,)."""

    times: Array  #: [s]
    forces: Array  #: with noise [N]
    displacements: Array  #: [m]
    peak_n: float  #: largest force without noise [N]
    moments: tuple[tuple[str, float], ...]  #: which of MOMENTS, time [s]


class Predicted(NamedTuple):
    """The result at one moment; shares of the peak."""

    moment: str
    refusal: str = ""  #: why nothing is predicted; empty: there is a prediction
    inside: float = math.nan  #: share of the samples of the next 3 s in the 95 % interval
    half_width: float = math.nan  #: of that interval, median
    error: float = math.nan  #: root mean square


class Trial(NamedTuple):
    """One recording."""

    predictions: tuple[Predicted, ...]
    mismatch: Share  #: of the contacts in summaries
    changed: Share


def _drawn(name: str, number: int) -> tuple[np.random.Generator, FdenModel]:
    """Return the generator of recording `number` of a case, and its model; the seed is fixed."""
    generator = np.random.default_rng([zlib.crc32(name.encode()), number])
    model = FdenModel(
        math.exp(generator.uniform(math.log(500.0), math.log(8000.0))),
        float(generator.uniform(6.0, 10.0)),
        float(generator.uniform(0.08, 0.32)),
    )
    return generator, model


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
    generator, model = _drawn(case.name, number)
    rate = math.exp(generator.uniform(math.log(0.1), math.log(0.5)))
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
    recording = recorded(CASES[name], number)
    geometry = {"geometry.area": _AREA_M2, "geometry.thickness": _THICKNESS_M}
    config = pipeline_config(check({"geometry.kind": "flat_punch", **geometry, **_RIG[rig]}))
    live = LiveTissue(config.geometry, uncertainty=config.estimator.uncertainty, real_time=False)
    outputs: list[Output] = []
    heard = [-math.inf]

    def hear(output: Output) -> None:
        outputs.append(output)
        if isinstance(output, TissueState):
            live.add(output, output.stamp_ns / NANOSECONDS)
            heard[0] = elapsed(output.stamp_ns)

    pipeline = Pipeline(config, hear)
    predictions: list[Predicted] = []
    waiting = list(recording.moments)
    samples = (recording.times, recording.forces, recording.displacements)
    for _ in fed(pipeline, *samples, placed=True):
        if waiting and heard[0] >= waiting[0][1]:
            predictions.append(_predicted(recording, live, heard[0], waiting.pop(0)[0]))
    pipeline.finish()
    flags = [summary.flags for summary in last_summaries(outputs).values()]
    return Trial(
        tuple(predictions),
        share(f & Flag.MODEL_MISMATCH for f in flags),
        share(f & Flag.TISSUE_CHANGED for f in flags),
    )


def _predicted(recording: Recording, live: LiveTissue, heard: float, moment: str) -> Predicted:
    """Return a listener's prediction at `heard` [s] for the motion that follows."""
    now = START_NS / NANOSECONDS + heard
    predictor = live.predictor(now)
    if predictor is None:
        refusal = live.refusal(now)
        return Predicted(moment, refusal.cause.name if refusal is not None else "NOT_HEARD")
    half = 0.5 / _RATE_HZ
    first, last = np.searchsorted(recording.times, [heard + half, heard + AHEAD_S + half])
    times, depths = recording.times[first:last], recording.displacements[first:last]
    start = float(np.interp(heard, recording.times, recording.displacements))
    prediction = predictor.force(times - heard, depths - start)
    off = prediction.value - recording.forces[first:last]
    width = TWO_SIDED_95 * prediction.sd
    inside = float(np.mean(np.abs(off) <= width))
    width_of, error = float(np.median(width)), float(rms(off))
    return Predicted(moment, "", inside, width_of / recording.peak_n, error / recording.peak_n)


# N/m


class Press(NamedTuple):
    """A simulated motion, and how it is sampled."""

    strains: Array  #: of the probe at the end of each step, negative in the air
    noise: Array  #: of the samples, in parts of the largest force
    instants: tuple[float, ...]  #: of the N/m [s]


class Found(NamedTuple):
    """N/m at one moment."""

    is_known: bool
    is_flagged: bool = False
    is_inside: bool = False  #: the truth lies in the 95 % interval
    ratio: float = math.nan  #: to the truth
    half_width: float = math.nan  #: of the interval, in parts of the value


def found_at(press: Press, stress: Stress, parameters: Mapping[str, Any]) -> list[Found]:
    """Return the published N/m at the moments of a press, and the truth.

    The strains are pressed whatever the geometry: the path follows from them.
    """
    config = pipeline_config(check(parameters))
    geometry = config.geometry
    strains, per_force = press.strains, geometry.stress_per_force
    compressions = np.sign(strains) * [geometry.compression(x) for x in np.abs(strains)]
    forces = stress(strains)[_CUTS - 1 :: _CUTS] / per_force
    forces = forces + press.noise * forces.max()
    depths = geometry.length * compressions[_CUTS - 1 :: _CUTS]
    times = _STEP * _CUTS * np.arange(1.0, depths.size + 1.0)
    newest: list[TissueState] = []

    def hear(output: Output) -> None:
        if isinstance(output, TissueState):
            newest[:] = [output]

    pipeline, waiting, found = Pipeline(config, hear), list(press.instants), []
    for _ in fed(pipeline, times, forces, depths, placed=True):
        if waiting and newest and elapsed(newest[0].stamp_ns) >= waiting[0]:
            waiting.pop(0)
            truth = _truth(press, stress, geometry, elapsed(newest[0].stamp_ns))
            found.append(_compared(newest[0], truth))
    pipeline.finish()
    return found


def _compared(state: TissueState, truth: float) -> Found:
    one = state.apparent_stiffness
    if one is None:
        return Found(False)
    reach = TWO_SIDED_95 * one.sd
    is_inside = abs(one.value - truth) <= reach + _RESOLUTION * truth
    return Found(True, warns(state.flags), is_inside, one.value / truth, reach / one.value)


def _truth(press: Press, stress: Stress, geometry: Geometry, at: float) -> float:
    """Return what a small step meets after the time scale [N/m], from a time on [s]."""
    before = press.strains[: round(at / _STEP)]
    compression = geometry.compression(float(before[-1]))
    count, forces = round(TIME_SCALE / _STEP), []
    for moved in (compression, compression * (1.0 + _SIZE)):
        stays = np.full(count, geometry.strain(moved))
        after = stress(np.concatenate([before, stays]))[-1]
        forces.append(float(after) / geometry.stress_per_force)
    return (forces[1] - forces[0]) / (_SIZE * compression * geometry.length)


def stiffness_row(found: list[Found]) -> dict[str, Any]:
    """Return the figures of a law."""
    known = [one for one in found if one.is_known]
    counted = [one for one in known if not one.is_flagged]
    row: dict[str, Any] = {
        "known": Share(len(known), len(found)),
        "flagged": share(one.is_flagged for one in known),
        "in 95 %": share(one.is_inside for one in counted),
    }
    if counted:
        row["ratio, median"] = float(np.median([one.ratio for one in counted]))
        row["half width"] = float(np.median([one.half_width for one in counted]))
    return row


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


def run_stiffness(which: tuple[str, str, str], number: int) -> list[Found]:
    """Press a law once, and return N/m at the moments of the press, and the truth."""
    name, geometry, rig = which
    generator, model = _drawn(f"{name}, {geometry}", number)
    rate = math.exp(generator.uniform(math.log(0.1), math.log(0.5)))
    top = -_HEIGHT_M / _THICKNESS_M
    fine, strains, holds = _motion(rate, top, float(generator.uniform(3.0, 6.0)))
    deepest, lifted = holds[0]
    noise = _NOISE_SHARE * generator.standard_normal(fine.size // _CUTS)
    touch = _AIR_S - top / rate
    instants = touch + _ON_RAMP * (deepest - touch), deepest, 0.5 * (deepest + lifted), lifted
    press, stress = Press(strains, noise, instants), _stress_of(name, generator, model)
    return found_at(press, stress, {**GEOMETRIES[geometry], **_RIG[rig]})


def run(args: argparse.Namespace) -> Report:
    """Simulate, identify, predict and judge."""
    rigs = (RIGID,) if args.quick else (RIGID, ARM)
    tasks = [
        ((case.name, rig), number)
        for rig in rigs
        for case in args.cases
        for number in args.numbers
    ]
    found = by_case(run_trial, tasks, jobs=args.jobs, what="recordings")
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
    trials = by_case(run_stiffness, tasks, jobs=args.jobs, what="presses")
    groups: dict[str, list[Found]] = {}
    for (name, geometry, rig), own in trials.items():
        moments = [moment for trial in own for moment in trial]
        says = CASES[name].says if name in CASES else _OTHERS[name]
        for group in (f"{says}, {rig}", f"all, {geometry}, {rig}", f"all, {rig}"):
            groups.setdefault(group, []).extend(moments)
    return {group: stiffness_row(found) for group, found in groups.items()}


def row_of(trials: Sequence[Trial]) -> dict[str, Any]:
    """Return the figures of a law on a rig."""
    moments = [prediction for trial in trials for prediction in trial.predictions]
    used = [prediction for prediction in moments if not prediction.refusal]
    by_moment = [mean_of([p.inside for p in used if p.moment == name]) for name in MOMENTS]
    return {
        "in 95 %": mean_of([p.inside for p in used]),
        "at each moment": by_moment,
        "half width": float(np.median([p.half_width for p in used])) if used else math.nan,
        "error": float(np.median([p.error for p in used])) if used else math.nan,
        "refused": Share(len(moments) - len(used), len(moments)),
        "mismatch": total(trial.mismatch for trial in trials),
        "changed": total(trial.changed for trial in trials),
    }


def goals_of(
    rows: Mapping[str, Mapping[str, Any]], rigid: Mapping[str, Sequence[Trial]]
) -> list[Goal]:
    """Compare each law with the goals."""
    goals = [
        at_least(f"in the 95 % interval: {name}", row["in 95 %"], 0.9)
        for name, row in rows.items()
    ]
    smooth = total(t.changed for name in _SMOOTH for t in rigid.get(name, ()))
    goals.append(at_most("smooth laws reported as changed", smooth.value, 0.02))
    itself = total(t.changed for name in ("fden", "fden_three") for t in rigid.get(name, ()))
    goals.append(at_most("the law itself reported as changed", itself.value, 1e-3))
    return goals


BENCHMARK = Benchmark(
    run,
    EPILOG,
    cases=CASES,
    quick=("poroelastic_2", "linear_solid_1", "cubic", "fden"),
    contacts=(12, 1),
)
