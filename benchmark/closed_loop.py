# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The force controller in closed loop: gains scheduled by the live stiffness, and fixed ones.

Simulated tissue and the real identification, without ROS, on tissues from the softest to the
stiffest of the paper's Table II. On each the probe touches, rests at a light force, steps to a
working force and back, and then to a higher one, on the way to which it meets an inclusion that
makes the tissue several times stiffer. The rig's deviations are 0.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmark.harness import Benchmark, Report, Table, at_most, measured
from fden_ros.control.force_control import ForceControlConfig, ForceController, Gains
from fden_ros.control.live_tissue import LiveTissue
from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import apparent_stiffness_factor
from fden_ros.core.outputs import Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.samples import NANOSECONDS
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.model import FdenModel
from fden_ros.simulation.rig import Command, Rig, RigConfig
from fden_ros.simulation.tissue import Column, Inclusion
from simulation.simulate import EXACT

EPILOG = """\
examples:
  fden benchmark closed_loop                      # ten tissues
  fden benchmark closed_loop --contacts 3
"""

#: Range over the specimens of Table II, from the softest to the stiffest; alpha from the dynamic
#: test.
SOFTEST = FdenModel(341.8, 5.26, 0.118)
STIFFEST = FdenModel(1294.0, 13.18, 0.146)
_CONTROL_STEPS, _SENSOR_STEPS = 5, 2
FIXED, SCHEDULED = "fixed gains", "scheduled gains"


@dataclass(frozen=True)
class Program:
    """What the probe is to do: forces [N] of three levels, times [s] in the air and at each.

    The limit must not be passed; an inclusion is met at about `inclusion_force` on the way to the
    highest level, and makes the tissue `stiffening` times as stiff.
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


PROGRAM = Program()


class Run(NamedTuple):
    """One closed loop; arrays over the samples."""

    times: Array  #: [s]
    force: Array  #: true force [N]
    stiffness: Array  #: that the gains are made for [N/m]
    live: NDArray[np.bool_]  #: where the gains are scheduled by the estimate
    overshoot: tuple[float, float]  #: of the working and of the high step, as a share of it
    settling: float  #: of the working step: [s] until within 5 % of it; inf: it never is
    refusals: tuple[str, ...]  #: why estimates were not relied on, in order


def tissues(count: int) -> list[FdenModel]:
    """Return tissues from the softest to the stiffest, evenly in the logarithms of G and Gn."""
    names = ("linear_stiffness", "nonlinear_stiffness", "fractional_order")
    ends = [(getattr(SOFTEST, name), getattr(STIFFEST, name)) for name in names]
    return [
        FdenModel(*(low ** (1.0 - at) * high**at for low, high in ends))
        for at in np.linspace(0.0, 1.0, count).tolist()
    ]


def close_loop(
    model: FdenModel,
    *,
    scheduled: bool,
    program: Program = PROGRAM,
    seed: int = 0,
    lose_estimate_at: float = math.inf,
) -> Run:
    """Close the loop over one tissue and return how it went.

    Parameters
    ----------
    model : FdenModel
    scheduled : bool
        Gains from the live stiffness; false: fixed, for the stiffest tissue.
    program : Program
    seed : int
        Of the sensors' noise.
    lose_estimate_at : float
        From then on no estimate arrives [s].
    """
    rig_config = _rig_config(model, program, seed)
    rig = Rig(rig_config)
    config = ForceControlConfig(safe_stiffness=1.0, force_limit=program.limit, scheduled=scheduled)
    stiffest = _tangent(STIFFEST, program.working, rig_config)
    stiffest *= apparent_stiffness_factor(STIFFEST.fractional_order, 1.0 / config.bandwidth)
    config = ForceControlConfig(
        safe_stiffness=stiffest, force_limit=program.limit, scheduled=scheduled
    )
    controller = ForceController(config)
    sizes = {"geometry.area": rig_config.area, "geometry.thickness": rig_config.thickness}
    # The stepped rig is rigid, and its tissue that of the law.
    settings = pipeline_config(check({**EXACT, **sizes}))
    live = LiveTissue(settings.geometry)

    def arrived(output: Output) -> None:
        if isinstance(output, TissueState):
            live.add(output, rig.time)

    pipeline = Pipeline(settings, arrived)
    kept, refusals, forces, bias = [], [""], [], []
    for n in range(round(program.duration / rig_config.step)):
        rig.step()
        if n % _SENSOR_STEPS == 0:
            force, depth = rig.measured_force(), rig.measured_position()[2]
            forces.append(force)
            if scheduled and rig.time < lose_estimate_at:
                stamp_ns = round(rig.time * NANOSECONDS) + NANOSECONDS
                pipeline.add_displacement(stamp_ns, depth)
                pipeline.add_force(stamp_ns, force)
        if (n + 1) % _CONTROL_STEPS:
            continue
        mean, forces = float(np.mean(forces)), []
        target, velocity = program.target(rig.time), 0.0
        if target <= 0.0:
            # The controller's own tare, in the air.
            bias.append(mean)
        else:
            reading = live.reading(rig.time) if scheduled else None
            tared = mean - float(np.mean(bias))
            velocity = controller.step(rig.time, tared, depth, target, reading)
        rig.command(Command.VELOCITY, velocity)
        refusal = live.refusal(rig.time)
        if refusal is not None and refusals[-1] != refusal.name:
            refusals.append(refusal.name)
        is_live = controller.gains is Gains.LIVE
        kept.append((rig.time, rig.force, controller.stiffness, float(is_live)))
    times, force_kept, stiffness, lives = np.array(kept).T
    (start, _), (stop, _), (last, _) = program.steps[2:]
    working = _error(times, force_kept, (start, stop), program.light, program.working)
    high = _error(times, force_kept, (last, math.inf), program.light, program.high)
    overshoot = (max(float(working.max()), 0.0), max(float(high.max()), 0.0))
    outside = np.flatnonzero(np.abs(working) > 0.05)
    last_outside = int(outside[-1]) if outside.size else -1
    elapsed = times[times >= start] - start
    is_settled = last_outside + 1 < working.size
    settling = float(elapsed[last_outside + 1]) if is_settled else math.inf
    return Run(
        times, force_kept, stiffness, lives.astype(bool), overshoot, settling, tuple(refusals[1:])
    )


def _error(
    times: Array, force: Array, span: tuple[float, float], before: float, after: float
) -> Array:
    """Return the force over the target during a step, as a share of it."""
    during = (times >= span[0]) & (times < span[1])
    error: Array = (force[during] - after) / (after - before)
    return error


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


def run_trial(number: int, of: int, seed: int) -> tuple[Run, Run]:
    """Close the loop over one of the tissues, with fixed and with scheduled gains."""
    model = tissues(of)[number]
    fixed, scheduled = (close_loop(model, scheduled=s, seed=seed) for s in (False, True))
    return fixed, scheduled


def run(args: argparse.Namespace) -> Report:
    """Run the comparison."""
    count, limit = args.contacts, PROGRAM.limit
    tasks = [(number,) for number in range(count)]
    found = measured(run_trial, tasks, count, args.first, jobs=args.jobs, what="tissues")
    rows: dict[str, dict[str, Any]] = {}
    for model, pair in zip(tissues(count), found, strict=True):
        name = f"G {model.linear_stiffness:.0f}, Gn {model.nonlinear_stiffness:.1f}"
        for gains, one in zip((FIXED, SCHEDULED), pair, strict=True):
            rows[f"{name}, {gains}"] = {
                "settles [s]": one.settling,
                "overshoot [%]": 100.0 * one.overshoot[0],
                "at the inclusion [%]": 100.0 * one.overshoot[1],
                "largest [N]": float(one.force.max()),
                "gains live [%]": 100.0 * float(one.live.mean()),
            }
    own = [row for name, row in rows.items() if name.endswith(SCHEDULED)]
    most = max(row["largest [N]"] for row in own)
    return Report(
        [at_most(f"{SCHEDULED}: largest force [N]", most, limit)],
        {"tissues": Table(f"Two steps of force, limit {limit:g} N", rows)},
    )


BENCHMARK = Benchmark(run, EPILOG, contacts=(10, 2))
