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

"""Scheduled and fixed gains in closed loop with simulated tissue and the real pipeline.

Ten tissues from the softest to the stiffest of the paper's Table II. On each the probe touches,
rests at a light force, steps to a working force and back, and then to a higher one, on the way to
which it meets an inclusion that makes the tissue several times stiffer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fden_ros.control.force_control import ForceControlConfig, ForceController, Gains
from fden_ros.control.live_tissue import LiveTissue
from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import apparent_stiffness_factor
from fden_ros.core.outputs import Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.samples import NANOSECONDS
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.closed_form import FdenModel
from fden_ros.simulation.rig import Command, Rig, RigConfig
from fden_ros.simulation.simulate import EXACT
from fden_ros.simulation.tissue import Column, Inclusion

#: Range over the specimens of Table II, from the softest to the stiffest; alpha from the dynamic
#: test.
SOFTEST = FdenModel(341.8, 5.26, 0.118)
STIFFEST = FdenModel(1294.0, 13.18, 0.146)


@dataclass(frozen=True)
class Program:
    """What the probe is to do; forces in N, times in s.

    Parameters
    ----------
    light, working, high
        Forces of the three levels.
    air, rest, work, back
        How long the probe waits in the air, rests at the light force first, works, and rests
        again; the high force lasts as long as the work.
    limit
        Force that must not be passed.
    inclusion_force
        About the force on the way at which the inclusion is met.
    stiffening
        Ratio of the stiffness after and before the inclusion is met.
    """

    light: float = 0.05
    working: float = 0.15
    high: float = 0.3
    air: float = 1.2
    rest: float = 4.0
    work: float = 3.0
    back: float = 3.0
    limit: float = 0.32
    inclusion_force: float = 0.22
    stiffening: float = 6.0

    @property
    def steps(self) -> tuple[tuple[float, float], ...]:
        """Times of the changes of target and the targets."""
        first = self.air + self.rest
        return (
            (0.0, 0.0),
            (self.air, self.light),
            (first, self.working),
            (first + self.work, self.light),
            (first + self.work + self.back, self.high),
        )

    @property
    def duration(self) -> float:
        """Of it all in s."""
        return self.steps[-1][0] + self.work

    def target(self, time: float) -> float:
        """Return the force wanted at a time."""
        return next(force for start, force in reversed(self.steps) if time >= start)


@dataclass(frozen=True)
class Step:
    """How one step of the target was followed."""

    overshoot: float  #: beyond the target, as a share of the step
    settling: float  #: [s] until the force stays within 5 % of the step; inf if it never does


@dataclass(frozen=True)
class Run:
    """One closed loop; arrays over the samples."""

    model: FdenModel
    scheduled: bool
    times: Array  #: [s]
    target: Array  #: [N]
    force: Array  #: true force [N]
    depth: Array  #: [m]
    stiffness: Array  #: that the gains are made for [N/m]
    live: NDArray[np.bool_]  #: the gains are scheduled by the estimate
    working: Step
    high: Step
    largest_force: float  #: [N]
    violated: bool  #: the force limit was passed
    refusals: tuple[str, ...]  #: why estimates were not relied on, in order


def tissues(count: int = 10) -> list[FdenModel]:
    """Return tissues from the softest to the stiffest, evenly in the logarithms of G and Gn."""
    shares = np.linspace(0.0, 1.0, count)
    return [
        FdenModel(
            _between(SOFTEST.linear_stiffness, STIFFEST.linear_stiffness, share),
            _between(SOFTEST.nonlinear_stiffness, STIFFEST.nonlinear_stiffness, share),
            _between(SOFTEST.fractional_order, STIFFEST.fractional_order, share),
        )
        for share in shares
    ]


def safe_stiffness(program: Program, rig: RigConfig, bandwidth: float) -> float:
    """Return the stiffness of the stiffest tissue at the working force [N/m].

    The fixed gains are made for it: no tissue of the range is stiffer at that force.
    """
    return _tangent(STIFFEST, program.working, rig) * apparent_stiffness_factor(
        STIFFEST.fractional_order, 1.0 / bandwidth
    )


def run(
    model: FdenModel,
    *,
    scheduled: bool,
    program: Program | None = None,
    seed: int = 0,
    lose_estimate_at: float = math.inf,
) -> Run:
    """Close the loop over one tissue and return how it went.

    Parameters
    ----------
    model : FdenModel
    scheduled : bool
        Gains from the live stiffness; false: fixed.
    program : Program
    seed : int
        Of the sensors' noise.
    lose_estimate_at : float
        From then on no estimate arrives [s].
    """
    program = program or Program()
    rig_config = _rig_config(model, program, seed)
    config = ForceControlConfig(safe_stiffness=1.0, force_limit=program.limit, scheduled=scheduled)
    config = ForceControlConfig(
        safe_stiffness=safe_stiffness(program, rig_config, config.bandwidth),
        force_limit=program.limit,
        scheduled=scheduled,
    )
    return _close_loop(model, rig_config, config, program, lose_estimate_at)


_CONTROL_STEPS = 5
_SENSOR_STEPS = 2


def _close_loop(
    model: FdenModel,
    rig_config: RigConfig,
    config: ForceControlConfig,
    program: Program,
    lose_estimate_at: float,
) -> Run:
    rig = Rig(rig_config)
    controller = ForceController(config)
    parameters = check(
        # The stepped rig is rigid, and its tissue that of the law.
        {**EXACT, "geometry.area": rig_config.area, "geometry.thickness": rig_config.thickness}
    )
    pipeline_settings = pipeline_config(parameters)
    live = LiveTissue(pipeline_settings.geometry)

    def arrived(output: Output) -> None:
        if isinstance(output, TissueState) and rig.time < lose_estimate_at:
            live.add(output, rig.time)

    pipeline = Pipeline(pipeline_settings, arrived) if config.scheduled else None
    count = round(program.duration / rig_config.step)
    kept = np.empty((count // _CONTROL_STEPS, 6))
    refusals: list[str] = []
    forces: list[float] = []
    bias: list[float] = []
    for n in range(count):
        rig.step()
        if n % _SENSOR_STEPS == 0:
            force, depth = rig.measured_force(), rig.measured_position()[2]
            forces.append(force)
            if pipeline is not None:
                stamp_ns = round(rig.time * NANOSECONDS) + NANOSECONDS
                pipeline.add_displacement(stamp_ns, depth)
                pipeline.add_force(stamp_ns, force)
        if (n + 1) % _CONTROL_STEPS:
            continue
        mean, forces = float(np.mean(forces)), []
        target = program.target(rig.time)
        if target <= 0.0:
            # The controller's own tare, in the air.
            bias.append(mean)
            velocity = 0.0
        else:
            reading = live.reading(rig.time) if config.scheduled else None
            velocity = controller.step(
                rig.time, mean - float(np.mean(bias)), depth, target, reading
            )
        rig.command(Command.VELOCITY, velocity)
        refusal = live.refusal(rig.time)
        name = refusal.name if refusal is not None else ""
        if not refusals or refusals[-1] != name:
            refusals.append(name)
        kept[n // _CONTROL_STEPS] = (
            *(rig.time, target, rig.force, rig.depth, controller.stiffness),
            controller.gains is Gains.LIVE,
        )
    return _run_of(model, config, program, kept, refusals)


def _run_of(
    model: FdenModel,
    config: ForceControlConfig,
    program: Program,
    kept: Array,
    refusals: Sequence[str],
) -> Run:
    times, target, force, depth, stiffness, live = kept.T
    starts = [start for start, _ in program.steps]
    return Run(
        model=model,
        scheduled=config.scheduled,
        times=times,
        target=target,
        force=force,
        depth=depth,
        stiffness=stiffness,
        live=live.astype(bool),
        working=_step(times, force, starts[2], starts[3], program.light, program.working),
        high=_step(times, force, starts[4], math.inf, program.light, program.high),
        largest_force=float(force.max()),
        violated=bool(force.max() > program.limit),
        refusals=tuple(name for name in refusals if name),
    )


def _step(
    times: Array, force: Array, start: float, stop: float, before: float, after: float
) -> Step:
    during = (times >= start) & (times < stop)
    error = (force[during] - after) / (after - before)
    outside = np.flatnonzero(np.abs(error) > 0.05)
    elapsed = times[during] - start
    settled = outside.size == 0 or outside[-1] + 1 < elapsed.size
    settling = (float(elapsed[outside[-1] + 1]) if outside.size else 0.0) if settled else math.inf
    return Step(max(float(error.max()), 0.0), settling)


def _rig_config(model: FdenModel, program: Program, seed: int) -> RigConfig:
    plain = RigConfig((Column(model),))
    strain = float(model.strain_of_phi(program.inclusion_force / plain.area))
    slope = float(model.phi_derivative(strain))
    inclusion = Inclusion(strain, (program.stiffening - 1.0) * slope)
    return RigConfig((Column(model, (inclusion,)),), seed=seed)


def _tangent(model: FdenModel, force: float, rig: RigConfig) -> float:
    """Return phi' at about a force, as N/m."""
    strain = model.strain_of_phi(force / rig.area)
    return float(model.phi_derivative(strain)) * rig.area / rig.thickness


def _between(low: float, high: float, share: float) -> float:
    return low ** (1.0 - share) * high**share
