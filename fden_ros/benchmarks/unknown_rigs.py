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

"""Simulated rigs of which nothing is known: axes, signs, units, rates, delay, compliance, weight.

A simulator of its own, which shares nothing with the core, the findings, or the package's other
simulation: the tissue is a sum of Maxwell elements behind an exponential spring, in contact that
can only push; the tool gives way in series; the sensor turns with the tool, has bias, drift,
noise and steps; each stream has its own clock rate, and one lags the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fden_ros.configure.streams import Streams
from fden_ros.core.arrays import Array

Generator = np.random.Generator

GRAVITY = 9.80665
GRAM_FORCE_N = 9.80665e-3
#: Step of the simulated mechanics [s].
_STEP = 2e-3
_START = 100.0


@dataclass(frozen=True)
class RigTruth:
    """What was drawn for a rig; SI units."""

    seed: int
    force_axis: Array  #: unit vector (3,), or (1,) of a sign
    displacement_axis: Array
    force_unit: float  #: one unit of the recorded force [N]
    displacement_unit: float  #: one unit of the recorded position [m]
    force_rate: float  #: [Hz]
    displacement_rate: float
    force_noise: float  #: per sample and axis [N]
    displacement_noise: float  #: [m]
    force_step: float  #: quantisation [N], 0: none
    displacement_step: float
    bias: Array  #: of each axis at the beginning [N]
    drift: Array  #: of each axis [N/s]
    delay: float  #: of the displacement's stamps behind the force's [s]
    compliance: float  #: [m/N]
    mass: float  #: that the sensor shows [kg]; 0: taken off by the driver
    centre: Array  #: of mass in the sensor's frame [m]
    sensor_turned: bool  #: the poses are not the sensor's orientation
    sensor_sign: float  #: 1: the sensor measures what acts on the tool
    area: float  #: of the flat punch [m^2]
    thickness: float  #: of the tissue [m]
    linear_stiffness: float  #: G [Pa s^alpha]
    nonlinear_stiffness: float  #: Gn
    alpha: float
    breathing: float  #: amplitude of the surface [m]
    turns: bool  #: the tool turned in the air
    rigid: bool  #: something rigid was pressed
    tissue: bool  #: tissue was pressed
    leaves: bool  #: the probe left the surface
    frequencies: tuple[float, ...]  #: of oscillations in contact [Hz]
    touches: tuple[tuple[float, float], ...] = ()  #: planned contacts [s]
    normal: Array | None = None  #: of the surface, in the frame of the poses; None: not known


@dataclass(frozen=True)
class SimulatedRig:
    """A recording and what is true of it."""

    streams: Streams
    truth: RigTruth


class _Plan:
    """The probe's planned motion: depth [m], place across [m], turn [rad] about axes, by time."""

    def __init__(self) -> None:
        self.depth: list[Array] = []
        self.across: list[Array] = []
        self.turn: list[Array] = []
        self.push: list[Array] = []
        self.kind: list[Array] = []
        self.at_depth, self.at_across, self.at_turn = 0.0, np.zeros(2), np.zeros(3)
        self.count = 0

    def move(
        self,
        duration: float,
        depth: float | None = None,
        across: Array | None = None,
        turn: Array | None = None,
        kind: int = 0,
        push: tuple[float, float] = (0.0, 0.0),
        wave: tuple[float, float] | None = None,
    ) -> None:
        """Go on for `duration` s to what is given; `push` is from and to on something rigid."""
        n = max(round(duration / _STEP), 1)
        share = np.arange(1, n + 1) / n
        smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        to_depth = self.at_depth if depth is None else depth
        line = self.at_depth + (to_depth - self.at_depth) * smooth
        if wave is not None:
            amplitude, frequency = wave
            t = share * n * _STEP
            fade = np.minimum(1.0, 2.0 * frequency * np.minimum(t, t[-1] - t))
            line = line + amplitude * np.sin(2.0 * np.pi * frequency * t) * fade
        self.depth.append(line)
        goal = self.at_across if across is None else across
        self.across.append(self.at_across + np.outer(smooth, goal - self.at_across))
        facing = self.at_turn if turn is None else turn
        self.turn.append(self.at_turn + np.outer(smooth, facing - self.at_turn))
        self.push.append(push[0] + (push[1] - push[0]) * smooth)
        self.kind.append(np.full(n, kind))
        self.at_depth, self.at_across, self.at_turn = to_depth, goal, facing
        self.count += n


_AIR, _TISSUE, _RIGID = 0, 1, 2


@dataclass(frozen=True)
class _Mount:
    """How the rig stands: what the recording does not say directly."""

    into: Array  #: direction into the tissue in the frame of the poses (3,)
    facing: Array  #: orientation of the pose while pressing (3, 3)
    sensor: Array  #: from the sensor's frame into the pose's (3, 3)
    origin: Array  #: place above the surface (3,) [m]
    lever: Array  #: from the centre of the turns to the reported point, in the pose's frame [m]


def simulate_rig(
    seed: int,
    *,
    along_tool: bool = False,
    presses: int = 0,
    slope: tuple[float, float] = (0.0, 0.0),
    **chosen: Any,
) -> SimulatedRig:
    """Return the recording of one rig.

    Parameters
    ----------
    seed : int
        Everything is drawn from it ...
    along_tool : bool
        ... but for the directions, if the probe presses along the z of its poses ...
    presses : int
        ... for the number of presses of tissue, if given ...
    slope : tuple of float
        ... for the surface, which sinks away by these shares of the way to each side ...
    **chosen
        ... and for these fields of :class:`RigTruth`.
    """
    draw = np.random.default_rng([seed, 17])
    truth, mount = _draw_rig(seed, draw)
    truth = replace(truth, **chosen)
    if along_tool:
        into = mount.facing[:, 2]
        mount = replace(mount, into=into, sensor=np.eye(3))
        truth = replace(
            truth,
            sensor_turned=False,
            force_axis=-truth.sensor_sign * np.array([0.0, 0.0, 1.0]),
            displacement_axis=into,
            bias=np.resize(truth.bias, 3),
            drift=np.resize(truth.drift, 3),
        )
    plan, truth = _draw_motion(truth, draw, presses)
    depth = np.concatenate(plan.depth)
    kind = np.concatenate(plan.kind)
    push = np.concatenate(plan.push)
    times: Array = np.asarray(_START + _STEP * np.arange(1, depth.size + 1), dtype=np.float64)
    force = _tissue_force(truth, depth, kind == _TISSUE, draw)
    force[kind == _RIGID] = push[kind == _RIGID]
    depth = depth + truth.compliance * np.where(kind == _RIGID, push, 0.0)
    # Lifting slowly to a shallower depth may leave the tissue for a moment, too.
    truth = replace(truth, leaves=truth.leaves or bool(np.mean(force == 0.0) > 0.1))
    across, turn = np.concatenate(plan.across), np.concatenate(plan.turn)
    if truth.displacement_axis.size > 1:
        normal = mount.into - np.array(slope) @ sideways_of(mount.into)
        truth = replace(truth, normal=normal / np.linalg.norm(normal))
        depth = depth + across @ np.array(slope)
    return SimulatedRig(_measure(truth, mount, times, depth, across, turn, force, draw), truth)


def _log_uniform(draw: Generator, low: float, high: float) -> float:
    return float(np.exp(draw.uniform(math.log(low), math.log(high))))


def _unit(draw: Generator) -> Array:
    vector = draw.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def _chance(draw: Generator, probability: float) -> bool:
    return bool(draw.random() < probability)


def _draw_rig(seed: int, draw: Generator) -> tuple[RigTruth, _Mount]:
    is_joint, is_number = _chance(draw, 0.2), _chance(draw, 0.12)
    turns = not is_joint and not is_number and _chance(draw, 0.65)
    sensor_turned = _chance(draw, 0.15)
    mount = _Mount(
        into=_unit(draw),
        facing=rotation(_unit(draw) * draw.uniform(0.0, np.pi)),
        sensor=rotation(_unit(draw) * draw.uniform(0.3, np.pi) * sensor_turned),
        origin=draw.uniform(-0.5, 0.5, 3),
        lever=draw.uniform(-0.1, 0.1, 3),
    )
    sign = float(draw.choice([-1.0, 1.0]))
    peak = _log_uniform(draw, 0.3, 8.0)
    nonlinear = draw.uniform(4.0, 14.0)
    area = math.pi * draw.uniform(0.004, 0.012) ** 2
    bend = nonlinear * _DEEPEST
    curve = math.exp(bend - 1.0) / nonlinear if bend > 1.0 else _DEEPEST
    noise = min(_log_uniform(draw, 1e-3, 3e-2), peak / 15.0)
    components = 1 if is_number else 3
    truth = RigTruth(
        seed=seed,
        force_axis=(
            np.array([sign])
            if is_number
            else mount.sensor.T @ mount.facing.T @ (-sign * mount.into)
        ),
        displacement_axis=np.array([draw.choice([-1.0, 1.0])]) if is_joint else mount.into,
        force_unit=GRAM_FORCE_N if _chance(draw, 0.12) else 1.0,
        displacement_unit=1e-3 if _chance(draw, 0.15) else 1.0,
        force_rate=_log_uniform(draw, 30.0, 1000.0),
        displacement_rate=_log_uniform(draw, 30.0, 1000.0),
        force_noise=noise,
        displacement_noise=_log_uniform(draw, 1e-6, 4e-5),
        force_step=_chance(draw, 0.3) * 0.5 * noise,
        displacement_step=_chance(draw, 0.3) * _log_uniform(draw, 1e-6, 2e-5),
        bias=draw.uniform(-5.0, 5.0, components),
        drift=draw.normal(0.0, 1.5e-3, components) * _chance(draw, 0.7),
        delay=float(draw.uniform(-5e-3, 30e-3)),
        compliance=0.0 if _chance(draw, 0.12) else _log_uniform(draw, 5e-6, 1e-3),
        mass=0.0 if is_joint or _chance(draw, 0.25) else float(draw.uniform(0.0, 1.0)),
        centre=draw.uniform(-0.05, 0.05, 3),
        sensor_turned=sensor_turned,
        sensor_sign=sign,
        area=area,
        thickness=float(draw.uniform(0.012, 0.04)),
        linear_stiffness=peak / (area * curve),
        nonlinear_stiffness=float(nonlinear),
        alpha=float(draw.uniform(0.05, 0.3)),
        breathing=_chance(draw, 0.3) * float(draw.uniform(5e-5, 5e-4)),
        turns=turns,
        rigid=_chance(draw, 0.55),
        tissue=_chance(draw, 0.93),
        leaves=_chance(draw, 0.93),
        frequencies=(),
    )
    return truth, mount


#: Deepest strain of a press; the drawn peak force is that of it after 1 s.
_DEEPEST = 0.22
_HEIGHT = 3e-3


def _draw_motion(truth: RigTruth, draw: Generator, presses: int) -> tuple[_Plan, RigTruth]:
    plan = _Plan()
    leaves, deepest = truth.leaves, _DEEPEST * truth.thickness
    rigid = truth.rigid and leaves
    tissue = truth.tissue or not rigid
    turns = truth.turns and leaves
    kind = _AIR if leaves else _TISSUE
    plan.at_depth = -_HEIGHT if leaves else 0.3 * deepest
    plan.move(draw.uniform(2.0, 4.0), kind=kind)
    if turns:
        _turn(plan, draw)
    if rigid:
        plan.move(1.0, across=draw.uniform(-0.04, 0.04, 2))
        strongest = _log_uniform(draw, 3.0, 15.0)
        for _ in range(int(draw.integers(2, 4))):
            _press_rigid(plan, draw, strongest)
    frequencies: tuple[float, ...] = ()
    if tissue:
        usual = int(draw.integers(2, 5))
        for _ in range(presses or usual):
            _press(plan, draw, deepest, leaves)
        if _chance(draw, 0.4):
            frequencies = (1.0, 4.0) if _chance(draw, 0.6) else (2.0,)
            _oscillate(plan, draw, deepest, frequencies, leaves)
    plan.move(draw.uniform(1.0, 3.0), kind=kind)
    return plan, replace(truth, tissue=tissue, rigid=rigid, turns=turns, frequencies=frequencies)


def _turn(plan: _Plan, draw: Generator) -> None:
    """Turn the tool through orientations in the air, and back."""
    for _ in range(int(draw.integers(3, 6))):
        plan.move(draw.uniform(1.0, 2.0), turn=_unit(draw) * draw.uniform(0.5, 1.4))
        plan.move(draw.uniform(0.3, 1.0))
    plan.move(2.0, turn=np.zeros(3))
    plan.move(1.0)


def _press_rigid(plan: _Plan, draw: Generator, strongest: float) -> None:
    plan.move(1.0, depth=0.0)
    plan.move(draw.uniform(0.8, 2.0), push=(0.0, strongest), kind=_RIGID)
    plan.move(draw.uniform(0.5, 1.5), push=(strongest, strongest), kind=_RIGID)
    plan.move(draw.uniform(0.8, 2.0), push=(strongest, 0.0), kind=_RIGID)
    plan.move(1.0, depth=-_HEIGHT)
    plan.move(1.0)


def _press(plan: _Plan, draw: Generator, deepest: float, leaves: bool) -> None:
    high = -_HEIGHT if leaves else 0.3 * deepest
    if leaves:
        plan.move(1.2, across=draw.uniform(-0.04, 0.04, 2))
    plan.move(draw.uniform(0.8, 2.0), depth=draw.uniform(0.7, 1.0) * deepest, kind=_TISSUE)
    plan.move(draw.uniform(0.5, 3.0), kind=_TISSUE)
    plan.move(draw.uniform(0.6, 1.5), depth=high, kind=_TISSUE)
    plan.move(draw.uniform(1.0, 2.0), kind=_AIR if leaves else _TISSUE)


def _oscillate(
    plan: _Plan, draw: Generator, deepest: float, frequencies: tuple[float, ...], leaves: bool
) -> None:
    if leaves:
        # Another place: every press of the simulator is one of fresh tissue.
        plan.move(1.2, across=draw.uniform(-0.04, 0.04, 2))
    plan.move(1.5, depth=0.7 * deepest, kind=_TISSUE)
    plan.move(2.0, kind=_TISSUE)
    for frequency in frequencies:
        wave = (draw.uniform(0.05, 0.1) * deepest, frequency)
        plan.move(10.5 / frequency, wave=wave, kind=_TISSUE)
        plan.move(0.7, kind=_TISSUE)
    plan.move(1.0, depth=-_HEIGHT if leaves else 0.3 * deepest, kind=_TISSUE)


def sideways_of(into: Array) -> Array:
    """Return two unit vectors (2, 3) perpendicular to one and to each other."""
    return np.asarray(np.linalg.svd(into[None])[2][1:])


def rotation(vector: Array) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector [rad] (Rodrigues' formula)."""
    return rotations(vector[None])[0]


def rotations(vectors: Array) -> Array:
    """Return rotation matrices (n, 3, 3) of rotation vectors [rad] (n, 3)."""
    angles = np.linalg.norm(vectors, axis=1)
    axes = vectors / np.maximum(angles, 1e-12)[:, None]
    cross = np.zeros((angles.size, 3, 3))
    for row, column, part, sign in (
        (0, 1, 2, -1),
        (0, 2, 1, 1),
        (1, 0, 2, 1),
        (1, 2, 0, -1),
        (2, 0, 1, -1),
        (2, 1, 0, 1),
    ):
        cross[:, row, column] = sign * axes[:, part]
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)


def quaternions(matrices: Array) -> Array:
    """Return quaternions x, y, z, w (n, 4) of rotation matrices (n, 3, 3)."""
    # The eigenvector of Bar-Itzhack's symmetric matrix of the largest eigenvalue.
    m = matrices
    k = np.empty((m.shape[0], 4, 4))
    k[:, 0, 0] = m[:, 0, 0] - m[:, 1, 1] - m[:, 2, 2]
    k[:, 1, 1] = m[:, 1, 1] - m[:, 0, 0] - m[:, 2, 2]
    k[:, 2, 2] = m[:, 2, 2] - m[:, 0, 0] - m[:, 1, 1]
    k[:, 3, 3] = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    for (i, j), value in {
        (0, 1): m[:, 1, 0] + m[:, 0, 1],
        (0, 2): m[:, 2, 0] + m[:, 0, 2],
        (1, 2): m[:, 2, 1] + m[:, 1, 2],
        (0, 3): m[:, 2, 1] - m[:, 1, 2],
        (1, 3): m[:, 0, 2] - m[:, 2, 0],
        (2, 3): m[:, 1, 0] - m[:, 0, 1],
    }.items():
        k[:, i, j] = k[:, j, i] = value
    return np.asarray(np.linalg.eigh(k)[1][:, :, 3])


def _tissue_force(truth: RigTruth, depth: Array, pressing: Array, draw: Generator) -> Array:
    """Return the force of the tissue at every step [N]."""
    alpha = truth.alpha
    spacing = math.log(10.0) / 1.5
    rates = np.exp(np.arange(math.log(1e-4), math.log(2e3), spacing))
    weights = rates**alpha * spacing / (math.gamma(alpha) * math.gamma(1.0 - alpha))
    decay = np.exp(-rates * _STEP)
    gains = weights * (1.0 - decay) / (rates * _STEP)
    # All that is slower than the slowest element stays: a spring.
    slow = (float(rates[0]) * math.exp(-0.5 * spacing)) ** alpha
    slow /= alpha * math.gamma(alpha) * math.gamma(1.0 - alpha)
    decay, gains = np.append(decay, 1.0), np.append(gains, slow)
    at_once = float(gains.sum())
    breathing = truth.breathing * np.sin(
        2.0 * np.pi * draw.uniform(0.2, 0.35) * _STEP * np.arange(depth.size)
        + draw.uniform(0.0, 2.0 * np.pi)
    )
    scale, bend = truth.linear_stiffness, 1.0 / truth.nonlinear_stiffness
    force = np.zeros_like(depth)
    elements, phi_before, stress = np.zeros_like(gains), 0.0, 0.0
    for n in np.flatnonzero(pressing).tolist():
        if n and not pressing[n - 1]:
            elements, phi_before, stress = np.zeros_like(gains), 0.0, 0.0
        memory = float(decay @ elements)
        free = (depth[n] - breathing[n]) / truth.thickness
        gives = truth.compliance * truth.area / truth.thickness
        low, high = 0.0, max(free, 0.0) / gives if gives > 0.0 else math.inf
        for _ in range(40):
            strain = free - gives * stress
            inside = max(strain, 0.0)
            if inside <= bend:
                phi, slope = scale * inside, scale
            else:
                phi = scale * bend * math.exp(inside / bend - 1.0)
                slope = phi / bend
            rest = memory + at_once * (phi - phi_before) - stress
            if rest > 0.0:
                low = max(low, stress)
            else:
                high = min(high, stress)
            step = rest / (1.0 + at_once * slope * gives)
            new = stress + step
            if not low <= new <= high:
                new = 0.5 * (low + high) if math.isfinite(high) else max(new, 0.0)
            done = abs(new - stress) < 1e-9 * (1.0 + abs(new))
            stress = new
            if done or gives == 0.0:
                break
        if memory + at_once * (phi - phi_before) <= 0.0:
            stress, phi = 0.0, phi_before - memory / at_once
        elements = decay * elements + gains * (phi - phi_before)
        phi_before = phi
        force[n] = stress * truth.area
    return force


def _measure(
    truth: RigTruth,
    mount: _Mount,
    times: Array,
    depth: Array,
    across: Array,
    turn: Array,
    force: Array,
    draw: Generator,
) -> Streams:
    force_times = _clock(times, truth.force_rate, draw)
    motion_times = _clock(times, truth.displacement_rate, draw)
    force_values, torque = _wrench(truth, mount, times, turn, force, force_times, draw)
    position, orientation = _pose(truth, mount, times, depth, across, turn, motion_times, draw)
    stamps = motion_times + truth.delay
    return Streams(
        f"rig {truth.seed}", force_times, force_values, stamps, position, torque, orientation
    )


def _clock(times: Array, rate: float, draw: Generator) -> Array:
    count = int((times[-1] - times[0]) * rate)
    steps = np.arange(count) + draw.uniform(0.0, 0.05) * draw.uniform(-1.0, 1.0, count)
    return np.asarray(times[0] + (steps + 0.1) / rate)


def _at(times: Array, values: Array, instants: Array) -> Array:
    return np.stack([np.interp(instants, times, column) for column in values.T], axis=1)


def _wrench(
    truth: RigTruth,
    mount: _Mount,
    times: Array,
    turn: Array,
    force: Array,
    stamps: Array,
    draw: Generator,
) -> tuple[Array, Array | None]:
    pushed = np.interp(stamps, times, force)
    since = (stamps - times[0])[:, None]
    if truth.force_axis.size == 1:
        values = pushed[:, None] * truth.force_axis
        torque = None
    else:
        facing = rotations(_at(times, turn, stamps)) @ mount.facing @ mount.sensor
        down = np.array([0.0, 0.0, -GRAVITY * truth.mass])
        weight = truth.sensor_sign * np.einsum("nji,j->ni", facing, down)
        on_tool = -truth.sensor_sign * np.einsum("nji,j->ni", facing, mount.into)
        torque = np.cross(truth.centre, weight) + draw.normal(0.0, 1e-3, (stamps.size, 3))
        values = pushed[:, None] * on_tool + weight
    noise = draw.normal(0.0, truth.force_noise, values.shape)
    values = values + truth.bias + truth.drift * since + noise
    values = _stepped(values, truth.force_step) / truth.force_unit
    return values, None if torque is None else torque / truth.force_unit


def _pose(
    truth: RigTruth,
    mount: _Mount,
    times: Array,
    depth: Array,
    across: Array,
    turn: Array,
    instants: Array,
    draw: Generator,
) -> tuple[Array, Array | None]:
    deep = np.interp(instants, times, depth)
    if truth.displacement_axis.size == 1:
        position = deep[:, None] * truth.displacement_axis + 0.1
        orientation = None
    else:
        sideways = sideways_of(mount.into)
        turned = rotations(_at(times, turn, instants))
        facing = turned @ mount.facing
        offset = facing @ mount.lever - mount.facing @ mount.lever
        wander = 1.5e-5 * np.stack(
            [
                np.sin(2.0 * np.pi * draw.uniform(0.05, 0.5) * instants + draw.uniform(0.0, 6.28))
                for _ in range(2)
            ],
            axis=1,
        )
        position = (
            mount.origin
            + deep[:, None] * mount.into
            + (_at(times, across, instants) + wander) @ sideways
            + offset
        )
        orientation = quaternions(facing)
    position = position + draw.normal(0.0, truth.displacement_noise, position.shape)
    return _stepped(position, truth.displacement_step) / truth.displacement_unit, orientation


def _stepped(values: Array, step: float) -> Array:
    return values if step == 0.0 else np.asarray(step * np.round(values / step))
