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

"""Presses on tissue that does not obey the law, and what is predicted of their next seconds."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fden_ros.benchmarks import TWO_SIDED_95
from fden_ros.control.live_tissue import LiveTissue
from fden_ros.core.outputs import ContactSummary, Flag, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.closed_form import FdenModel
from fden_ros.simulation.other_laws import (
    Law,
    Relaxation,
    poroelastic,
    quasi_linear,
    springpot,
    standard_linear_solid,
    stress_of_law,
)
from fden_ros.simulation.simulate import KNOWN_RIG, START_NS

Array = NDArray[np.float64]

RIGID, ARM = "testing machine", "arm's defaults"
#: The rig's deviations of a testing machine, as in `config/bench.yaml`: the law's error keeps its
#: default.
_RIG: Mapping[str, Mapping[str, float]] = {
    RIGID: KNOWN_RIG,
    ARM: {},
}
_RADIUS_M, _THICKNESS_M = 0.01, 0.02
_AREA_M2 = math.pi * _RADIUS_M**2
_RATE_HZ = 50.0
#: Steps of the simulation for each sample.
_CUTS = 10
#: Of the peak.
_NOISE_SHARE = 1e-3
_MAX_STRAIN = 0.25
#: Before the first press, between two, and after the last; the probe comes from so high [m] at
#: the rate of the press.
_AIR_S, _HEIGHT_M = 2.0, 0.002
_RETRACT_RATE = 0.5
_WEARING_PRESSES = 3
#: What is predicted [s].
AHEAD_S = 3.0
_NANO = 1e-9
#: Where on the ramp is predicted, as a share of its part in contact.
_ON_RAMP = 0.6
#: Of a press, in the order of time.
MOMENTS = ("on the ramp", "its end", "half way", "3 s before the end")

#: The tissue's numbers: (G, Gn, alpha) drawn once a recording.
_Made = Callable[[FdenModel], Law]


def _relaxing(relaxation: Relaxation) -> _Made:
    return lambda model: Law(model, relaxation)


def _wearing(softening: float = 0.0, set_m: float = 0.0) -> _Made:
    return lambda model: Law(
        model,
        springpot(model.fractional_order),
        softening=softening,
        set_strain=set_m / _THICKNESS_M,
    )


def _shaped(characteristic: Callable[[float], float]) -> _Made:
    return lambda model: Law(
        model, springpot(model.fractional_order), characteristic=characteristic
    )


def _two_springpots(model: FdenModel) -> Law:
    return Law(model, Relaxation(springpots=((0.5, 0.1), (0.5, 0.4))))


def _springpot_and_spring(model: FdenModel) -> Law:
    order = model.fractional_order
    return Law(model, Relaxation(springpots=((0.5, order),), exponentials=((0.5, 0.0),)))


@dataclass(frozen=True)
class Case:
    """One law.

    Parameters
    ----------
    name, says : str
    law : callable
        Of a model whose G is drawn from 500 to 8,000, Gn from 6 to 10, alpha from 0.08 to 0.32.
    presses : int
        Of one place.
    """

    name: str
    says: str
    law: _Made = field(repr=False)
    presses: int = 1


CASES = (
    *(
        Case(f"poroelastic_{t:g}", f"poroelastic, {t:g} s", _relaxing(poroelastic(t)))
        for t in (2.0, 20.0)
    ),
    *(
        Case(
            f"linear_solid_{t:g}",
            f"standard linear solid, {t:g} s",
            _relaxing(standard_linear_solid(t)),
        )
        for t in (1.0, 10.0)
    ),
    Case("quasi_linear", "quasi-linear viscoelastic", _relaxing(quasi_linear(0.15, 0.01, 100.0))),
    Case("two_springpots", "two fractional elements", _two_springpots),
    Case("springpot_and_spring", "fractional and elastic", _springpot_and_spring),
    # Three times the linear stress at the deepest.
    Case("cubic", "cubic stress-strain curve", _shaped(lambda x: x + 32.0 * x**3)),
    Case("power_law", "stress-strain curve of power 1.5", _shaped(lambda x: 2.0 * x**1.5)),
    Case("softens_3", "softens by 3 % a press", _wearing(softening=0.03), _WEARING_PRESSES),
    Case("softens_10", "softens by 10 % a press", _wearing(softening=0.1), _WEARING_PRESSES),
    Case("set_0.1mm", "stays 0.1 mm lower a press", _wearing(set_m=1e-4), _WEARING_PRESSES),
    Case("fden", "the law itself", _wearing()),
    Case("fden_three", "the law itself, three presses", _wearing(), _WEARING_PRESSES),
)


@dataclass(frozen=True)
class Recording:
    """Samples of force and displacement at the same instants, arrays of shape (n,)."""

    times: Array  #: [s]
    forces: Array  #: with noise [N]
    displacements: Array  #: [m]
    peak_n: float  #: largest force without noise [N]
    moments: tuple[tuple[int, str, float], ...]  #: (press, which of MOMENTS, time [s])


class Predicted(NamedTuple):
    """What was made of one moment."""

    press: int
    moment: str
    refusal: str  #: why nothing is predicted; empty: it is
    inside: float  #: share of the samples of the next 3 s in the 95 % interval
    half_width: float  #: of that interval, median, share of the peak
    error: float  #: root mean square, share of the peak


class Trial(NamedTuple):
    """One recording."""

    predictions: tuple[Predicted, ...]
    contacts: int  #: in summaries
    mismatch: int  #: of these
    changed: int
    converged: int  #: and unflagged


def recorded(case: Case, number: int) -> Recording:
    """Return recording `number` of a case; the seed is fixed."""
    generator = np.random.default_rng([zlib.crc32(case.name.encode()), number])
    model = FdenModel(
        math.exp(generator.uniform(math.log(500.0), math.log(8000.0))),
        float(generator.uniform(6.0, 10.0)),
        float(generator.uniform(0.08, 0.32)),
    )
    rate = math.exp(generator.uniform(math.log(0.1), math.log(0.5)))
    hold = float(generator.uniform(8.0, 12.0))
    top = -_HEIGHT_M / _THICKNESS_M * float(generator.uniform(1.0, 1.2))
    knots, strains = [0.0, _AIR_S], [top, top]
    holds: list[tuple[float, float]] = []
    for _ in range(case.presses):
        deepest = knots[-1] + (_MAX_STRAIN - top) / rate
        lifted = deepest + hold
        holds.append((deepest, lifted))
        out = lifted + (_MAX_STRAIN - top) / _RETRACT_RATE
        knots += [deepest, lifted, out, out + _AIR_S]
        strains += [_MAX_STRAIN, _MAX_STRAIN, top, top]
    step = 1.0 / (_RATE_HZ * _CUTS)
    fine: Array = step * np.arange(1.0, int(knots[-1] / step) + 1.0)
    motion = np.interp(fine, knots, strains)
    forces = _AREA_M2 * stress_of_law(case.law(model), motion, step)[_CUTS - 1 :: _CUTS]
    peak = float(forces.max())
    noise = _NOISE_SHARE * peak * generator.standard_normal(forces.size)
    times: Array = fine[_CUTS - 1 :: _CUTS]
    moments = [
        (press, name, instant)
        for press, span in enumerate(holds)
        for name, instant in zip(MOMENTS, _instants(times, forces, *span), strict=True)
    ]
    return Recording(
        times=times,
        forces=forces + noise,
        displacements=_THICKNESS_M * motion[_CUTS - 1 :: _CUTS],
        peak_n=peak,
        moments=tuple(moments),
    )


def _instants(times: Array, forces: Array, deepest: float, lifted: float) -> tuple[float, ...]:
    """Return when is predicted in a press that is held between two times [s]."""
    # The tissue has not come back from the last press: it is met on the way.
    air = times[(times < deepest) & (forces == 0.0)]
    touch = float(air[-1])
    return (
        touch + _ON_RAMP * (deepest - touch),
        deepest,
        0.5 * (deepest + lifted),
        lifted - AHEAD_S,
    )


def run_trial(case: Case, number: int, rig: str) -> Trial:
    """Simulate recording `number` of a case, identify it and predict from its moments."""
    recording = recorded(case, number)
    config = pipeline_config(
        check(
            {
                "geometry.kind": "flat_punch",
                "geometry.area": _AREA_M2,
                "geometry.thickness": _THICKNESS_M,
                **_RIG[rig],
            }
        )
    )
    live = LiveTissue(config.geometry, uncertainty=config.estimator.uncertainty, real_time=False)
    outputs: list[Output] = []
    pipeline = Pipeline(config, outputs.append)
    summaries: dict[int, ContactSummary] = {}
    predictions: list[Predicted] = []
    moments = list(recording.moments)
    newest: TissueState | None = None
    samples = zip(
        recording.times.tolist(),
        recording.forces.tolist(),
        recording.displacements.tolist(),
        strict=True,
    )
    for time, force, displacement in samples:
        stamp = START_NS + round(time / _NANO)
        # All presses are of one place.
        pipeline.add_displacement(stamp, displacement, (0.0, 0.0, displacement))
        pipeline.add_force(stamp, force)
        newest = _heard(outputs, live, summaries) or newest
        if moments and newest is not None:
            heard = (newest.stamp_ns - START_NS) * _NANO
            if heard >= moments[0][2]:
                predictions.append(_predicted(recording, live, heard, *moments.pop(0)[:2]))
    pipeline.finish()
    _heard(outputs, live, summaries)
    told = [summary.flags for summary in summaries.values()]
    return Trial(
        predictions=tuple(predictions),
        contacts=len(told),
        mismatch=sum(Flag.MODEL_MISMATCH in flags for flags in told),
        changed=sum(Flag.TISSUE_CHANGED in flags for flags in told),
        converged=sum(s.converged and not s.flags for s in summaries.values()),
    )


def _heard(
    outputs: list[Output], live: LiveTissue, summaries: dict[int, ContactSummary]
) -> TissueState | None:
    """Let the listener hear what has come, and return the newest state."""
    newest = None
    for output in outputs:
        if isinstance(output, ContactSummary):
            # The last word on each contact counts: a summary may withdraw an earlier one.
            summaries[output.contact_id] = output
        elif isinstance(output, TissueState):
            live.add(output, output.stamp_ns * _NANO)
            newest = output
    outputs.clear()
    return newest


def _predicted(
    recording: Recording, live: LiveTissue, heard: float, press: int, moment: str
) -> Predicted:
    """Return what a listener predicts at `heard` [s] for the motion that follows."""
    now = START_NS * _NANO + heard
    nothing = (math.nan,) * 3
    refusal = live.refusal(now)
    if refusal is not None:
        return Predicted(press, moment, refusal.name, *nothing)
    first, last = np.searchsorted(
        recording.times, [heard + 0.5 / _RATE_HZ, heard + AHEAD_S + 0.5 / _RATE_HZ]
    )
    ahead = slice(int(first), int(last))
    start = float(np.interp(heard, recording.times, recording.displacements))
    prediction = live.predict_force(
        recording.times[ahead] - heard, recording.displacements[ahead] - start, now
    )
    if prediction is None:
        return Predicted(press, moment, "NOT_HEARD", *nothing)
    off = prediction.value - recording.forces[ahead]
    width = TWO_SIDED_95 * prediction.sd
    return Predicted(
        press,
        moment,
        "",
        float(np.mean(np.abs(off) <= width)),
        float(np.median(width)) / recording.peak_n,
        float(np.sqrt(np.mean(off**2))) / recording.peak_n,
    )
