# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Simulated rigs of which nothing is known: axes, signs, units, rates, delay, compliance, weight.

The tissue is that of the stepped simulation, pressed by a tool that gives way in series; the
sensor turns with the tool, has bias, drift, noise and steps; each stream has its own clock rate,
and one lags the other. Nothing is shared with the findings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from fden_ros.configure.finding import Finding
from fden_ros.configure.streams import Streams
from fden_ros.configure.survey import Survey
from fden_ros.core.arrays import Array
from fden_ros.simulation import Column, FdenModel, Tissue

Generator = np.random.Generator

GRAVITY = 9.80665
#: Step of the simulated mechanics [s].
_STEP = 2e-3
_START = 100.0


@dataclass(frozen=True)
class RigTruth:
    """What was drawn for a rig; SI units."""

    seed: int
    force_axis: Array  #: unit vector (3,), or (1,) of a sign
    displacement_axis: Array
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


class SimulatedRig(NamedTuple):
    """A recording and what is true of it."""

    streams: Streams
    truth: RigTruth


class _Plan:
    """The probe's planned motion.

    A row a step: depth [m], place across [m] (2), turn [rad] about axes (3), the force on
    something rigid [N], and what is pressed.
    """

    def __init__(self, depth: float) -> None:
        self.rows: list[Array] = []
        self.at = np.array([depth, 0.0, 0.0, 0.0, 0.0, 0.0])

    def move(
        self,
        duration: float,
        kind: int = 0,
        push: tuple[float, float] = (0.0, 0.0),
        wave: tuple[float, float] | None = None,
        **goals: Any,
    ) -> None:
        """Go on for `duration` s to the `depth`, the place `across` and the `turn` that are given.

        `push` is from and to on something rigid, `wave` an amplitude and a frequency.
        """
        n = max(round(duration / _STEP), 1)
        share = np.arange(1, n + 1) / n
        smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        before, self.at = self.at, self.at.copy()
        for name, goal in goals.items():
            self.at[{"depth": 0, "across": slice(1, 3), "turn": slice(3, 6)}[name]] = goal
        line = before + np.outer(smooth, self.at - before)
        if wave is not None:
            amplitude, frequency = wave
            t = share * n * _STEP
            fade = np.minimum(1.0, 2.0 * frequency * np.minimum(t, t[-1] - t))
            line[:, 0] += amplitude * np.sin(2.0 * np.pi * frequency * t) * fade
        pushed = push[0] + (push[1] - push[0]) * smooth
        self.rows.append(np.column_stack([line, pushed, np.full(n, kind)]))


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
    seed: int, *, along_tool: bool = False, presses: int = 0, **chosen: Any
) -> SimulatedRig:
    """Return the recording of a rig: `chosen` are fields of :class:`RigTruth`, the rest is drawn.

    `along_tool`: the probe presses along the z of its poses; `presses` of tissue, if given.
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
    rows = np.concatenate(plan.rows)
    depth, push, kind = rows[:, [0, 6, 7]].T
    times: Array = np.asarray(_START + _STEP * np.arange(1, depth.size + 1), dtype=np.float64)
    force = _tissue_force(truth, depth, kind == _TISSUE, draw)
    force[kind == _RIGID] = push[kind == _RIGID]
    depth = depth + truth.compliance * np.where(kind == _RIGID, push, 0.0)
    # Lifting slowly to a shallower depth may leave the tissue for a moment, too.
    truth = replace(truth, leaves=truth.leaves or bool(np.mean(force == 0.0) > 0.1))
    motion = _Motion(times, depth, rows[:, 1:3], rows[:, 3:6], force)
    return SimulatedRig(_measure(truth, mount, motion, draw), truth)


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
        facing=_turned(_unit(draw) * draw.uniform(0.0, np.pi)),
        sensor=_turned(_unit(draw) * draw.uniform(0.3, np.pi) * sensor_turned),
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
    )
    return truth, mount


#: Deepest strain of a press; the drawn peak force is that of it after 1 s.
_DEEPEST = 0.22
_HEIGHT = 3e-3


def _draw_motion(truth: RigTruth, draw: Generator, presses: int) -> tuple[_Plan, RigTruth]:
    leaves, deepest = truth.leaves, _DEEPEST * truth.thickness
    rigid = truth.rigid and leaves
    tissue = truth.tissue or not rigid
    turns = truth.turns and leaves
    kind = _AIR if leaves else _TISSUE
    plan = _Plan(-_HEIGHT if leaves else 0.3 * deepest)
    plan.move(draw.uniform(2.0, 4.0), kind=kind)
    if turns:
        _turn(plan, draw)
    if rigid:
        plan.move(1.0, across=draw.uniform(-0.04, 0.04, 2))
        strongest = _log_uniform(draw, 3.0, 15.0)
        for _ in range(int(draw.integers(2, 4))):
            _press_rigid(plan, draw, strongest)
    if tissue:
        usual = int(draw.integers(2, 5))
        for _ in range(presses or usual):
            _press(plan, draw, deepest, leaves)
        if _chance(draw, 0.4):
            frequencies = (1.0, 4.0) if _chance(draw, 0.6) else (2.0,)
            _oscillate(plan, draw, deepest, frequencies, leaves)
    plan.move(draw.uniform(1.0, 3.0), kind=kind)
    return plan, replace(truth, tissue=tissue, rigid=rigid, turns=turns)


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


def _turned(vector: Array) -> Array:
    """Return the matrix (3, 3) of a rotation vector [rad], or (n, 3, 3) of (n, 3)."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def _tissue_force(truth: RigTruth, depth: Array, pressing: Array, draw: Generator) -> Array:
    """Return the force of the tissue at every step [N]; each press is one of fresh tissue."""
    breathing = truth.breathing * np.sin(
        2.0 * np.pi * draw.uniform(0.2, 0.35) * _STEP * np.arange(depth.size)
        + draw.uniform(0.0, 2.0 * np.pi)
    )
    model = FdenModel(truth.linear_stiffness, truth.nonlinear_stiffness, truth.alpha)
    strains = (depth - breathing) / truth.thickness
    gives = truth.compliance * truth.area / truth.thickness
    force = np.zeros_like(depth)
    tissue = Tissue([Column(model)], _STEP)
    for n in np.flatnonzero(pressing).tolist():
        if n and not pressing[n - 1]:
            tissue = Tissue([Column(model)], _STEP)
        strain = float(strains[n])
        # The tool gives way: the stress at the strain that it leaves.
        stress = _balanced(tissue.response(), strain, gives)
        force[n] = tissue.press(strain - gives * stress) * truth.area
    return force


def _balanced(response: Callable[[float], float], strain: float, gives: float) -> float:
    """Return the stress at which a tool that gives way by so much a stress stands [Pa]."""
    most = response(strain)
    if gives == 0.0 or most == 0.0:
        return most
    found = brentq(lambda f: response(strain - gives * f) - f, 0.0, most, rtol=1e-9)
    return float(found)


class _Motion(NamedTuple):
    """What the tip and the tissue did; arrays over the steps."""

    times: Array  #: [s]
    depth: Array  #: [m]
    across: Array  #: [m], shape (n, 2)
    turn: Array  #: rotation vector [rad], shape (n, 3)
    force: Array  #: of the tissue [N]

    def at(self, values: Array, instants: Array) -> Array:
        """Return values, (n, k), at other instants, (m, k)."""
        columns = [np.interp(instants, self.times, column) for column in values.T]
        return np.stack(columns, axis=1)

    def clock(self, rate: float, draw: Generator) -> Array:
        """Return the instants of a stream's samples, unevenly [s]."""
        count = int((self.times[-1] - self.times[0]) * rate)
        steps = np.arange(count) + draw.uniform(0.0, 0.05) * draw.uniform(-1.0, 1.0, count)
        return np.asarray(self.times[0] + (steps + 0.1) / rate)


def _measure(truth: RigTruth, mount: _Mount, motion: _Motion, draw: Generator) -> Streams:
    force_times = motion.clock(truth.force_rate, draw)
    motion_times = motion.clock(truth.displacement_rate, draw)
    force_values = _wrench(truth, mount, motion, force_times, draw)
    position, orientation = _pose(truth, mount, motion, motion_times, draw)
    stamps = motion_times + truth.delay
    name = f"rig {truth.seed}"
    return Streams(name, force_times, force_values, stamps, position, orientation)


def _wrench(
    truth: RigTruth, mount: _Mount, motion: _Motion, stamps: Array, draw: Generator
) -> Array:
    pushed = np.interp(stamps, motion.times, motion.force)[:, None]
    if truth.force_axis.size == 1:
        values = pushed * truth.force_axis
    else:
        facing = _turned(motion.at(motion.turn, stamps)) @ mount.facing @ mount.sensor
        down = np.array([0.0, 0.0, -GRAVITY * truth.mass])
        weight = truth.sensor_sign * np.einsum("nji,j->ni", facing, down)
        on_tool = -truth.sensor_sign * np.einsum("nji,j->ni", facing, mount.into)
        values = pushed * on_tool + weight
    noise = draw.normal(0.0, truth.force_noise, values.shape)
    drifted = truth.drift * (stamps - motion.times[0])[:, None]
    return _stepped(values + truth.bias + drifted + noise, truth.force_step)


def _pose(
    truth: RigTruth, mount: _Mount, motion: _Motion, instants: Array, draw: Generator
) -> tuple[Array, Array | None]:
    deep = np.interp(instants, motion.times, motion.depth)[:, None]
    orientation = None
    if truth.displacement_axis.size == 1:
        position = deep * truth.displacement_axis + 0.1
    else:
        facing = _turned(motion.at(motion.turn, instants)) @ mount.facing
        wander = [
            np.sin(2.0 * np.pi * draw.uniform(0.05, 0.5) * instants + draw.uniform(0.0, 6.28))
            for _ in range(2)
        ]
        sideways = motion.at(motion.across, instants) + 1.5e-5 * np.stack(wander, axis=1)
        position = (
            mount.origin
            + deep * mount.into
            # Two unit vectors perpendicular to it and to each other.
            + sideways @ np.linalg.svd(mount.into[None])[2][1:]
            + (facing - mount.facing) @ mount.lever
        )
        orientation = Rotation.from_matrix(facing).as_quat()
    position = position + draw.normal(0.0, truth.displacement_noise, position.shape)
    return _stepped(position, truth.displacement_step), orientation


def _stepped(values: Array, step: float) -> Array:
    return values if step == 0.0 else np.asarray(step * np.round(values / step))


_AXIS_LIMIT = math.radians(2.0)
#: The 95 % interval of an error in one direction, and of one in two, in deviations.
_ONE, _TWO = 1.96, 2.4477
#: A compliance whose deviation is above this share of it is stated as a bound.
_BOUND = 0.04


class Judged(NamedTuple):
    """What the stated findings of one rig are worth."""

    seed: int
    errors: dict[str, list[float]]  #: over the deviation, by subject; of an axis over the 95 %
    misses: list[tuple[str, str]]  #: of their goal, and what they say
    subjects: list[str]  #: of all findings
    unfounded: list[str]  #: stated although the recording does not show it


def judge(found: Survey, truth: RigTruth) -> Judged:
    """Hold the findings of a rig against what is true of it."""
    findings = {finding.subject: finding for finding in found.findings}
    errors: dict[str, list[float]] = {}
    misses: list[tuple[str, str]] = []
    for what, axis in (("force", truth.force_axis), ("displacement", truth.displacement_axis)):
        finding = findings[f"{what} axis"]
        if not finding.claim:
            continue
        off = math.acos(np.clip(np.atleast_1d(np.array(finding.value)) @ axis, -1.0, 1.0))
        if off > _AXIS_LIMIT:
            misses.append((finding.subject, f"{math.degrees(off):.1f} degrees"))
        if axis.size > 1 and finding.deviation:
            errors[finding.subject] = [off / finding.deviation / _TWO * _ONE]
    for name, true, limit in _numbers(findings, truth):
        finding = findings[name]
        if finding.claim and isinstance(finding.value, float) and finding.deviation:
            errors[name] = [(finding.value - true) / finding.deviation]
            if abs(finding.value - true) > limit:
                misses.append((name, f"{finding.value:.4g} for {true:.4g}"))
    shown = {"compliance": truth.rigid, "tool mass": truth.turns}
    unfounded = [name for name, is_so in shown.items() if findings[name].claim and not is_so]
    return Judged(truth.seed, errors, misses, list(findings), unfounded)


def _numbers(
    findings: Mapping[str, Finding], truth: RigTruth
) -> Iterator[tuple[str, float, float]]:
    """Give subjects, true values and the largest errors that are allowed."""
    steps = math.sqrt(12.0)
    yield "force noise", math.hypot(truth.force_noise, truth.force_step / steps), math.inf
    motion_noise = math.hypot(truth.displacement_noise, truth.displacement_step / steps)
    yield "displacement noise", motion_noise, math.inf
    # What answers at once tells it to half a millisecond; the bends of tissue to some.
    delay = findings["delay"]
    is_at_once = delay.deviation is not None and delay.deviation < 1e-3
    yield "delay", truth.delay, 1e-3 if is_at_once else 0.03
    if findings["tool mass"].value:
        yield "tool mass", truth.mass, 0.02 * truth.mass
    compliance = findings["compliance"]
    if isinstance(compliance.value, float) and compliance.deviation:
        # What is too small to measure is stated as a bound: only its interval counts.
        is_bound = compliance.deviation > _BOUND * abs(compliance.value)
        yield "compliance", truth.compliance, math.inf if is_bound else 0.1 * truth.compliance
    axis = findings["force axis"]
    if axis.claim and not (truth.mass and not truth.turns):
        along = np.atleast_1d(np.array(axis.value))
        yield "force drift", float(truth.drift @ along), math.inf


ROBOT_STATES = """std_msgs/Header header
int16 state
int16 mode
int16 cmdnum
int16 mt_brake
int16 mt_able
int16 err
int16 warn
float32[] angle
float32[6] pose
float32[6] offset
"""


class RigBag:
    """Writes streams as a bag in the layout of a robot."""

    def __init__(
        self,
        streams: Streams,
        force_topic: str = "/ft/wrench",
        displacement_topic: str = "/arm/pose",
        kind: str = "pose",
    ) -> None:
        self.streams = streams
        self.topics = (force_topic, displacement_topic)
        self.kind = kind
        self.store = get_typestore(Stores.ROS2_HUMBLE)
        self.store.register(get_types_from_msg(ROBOT_STATES, "xarm_msgs/msg/RobotMsg"))

    def write(self, folder: Path) -> Path:
        """Write the bag."""
        s = self.streams
        rows = [(t, 0, i) for i, t in enumerate(s.force_times)]
        rows += [(t, 1, i) for i, t in enumerate(s.motion_times)]
        rows.sort()
        with Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            makers = (self.force, self.displacement)
            connections = [
                writer.add_connection(topic, make(0, 1.0).__msgtype__, typestore=self.store)
                for topic, make in zip(self.topics, makers, strict=True)
            ]
            for time, which, index in rows:
                message = makers[which](index, time)
                data = self.store.serialize_cdr(message, message.__msgtype__)
                writer.write(connections[which], round(time * 1e9) + 500_000, data)
        return folder

    def header(self, time: float, frame: str) -> Any:
        t = self.store.types
        second, rest = divmod(round(time * 1e9), 1_000_000_000)
        stamp = t["builtin_interfaces/msg/Time"](sec=second, nanosec=rest)
        return t["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)

    def force(self, index: int, time: float) -> Any:
        t = self.store.types
        vector = t["geometry_msgs/msg/Vector3"]
        values = [float(v) for v in self.streams.force[index]]
        if len(values) == 1:
            return self.joints(time, [], [0.0, values[0]])
        wrench = t["geometry_msgs/msg/Wrench"](force=vector(*values), torque=vector(0.0, 0.0, 0.0))
        return t["geometry_msgs/msg/WrenchStamped"](self.header(time, "sensor"), wrench)

    def joints(self, time: float, positions: list[float], efforts: list[float]) -> Any:
        return self.store.types["sensor_msgs/msg/JointState"](
            header=self.header(time, ""),
            name=["slide", "probe"],
            position=np.array(positions),
            velocity=np.array([]),
            effort=np.array(efforts),
        )

    def displacement(self, index: int, time: float) -> Any:
        t = self.store.types
        place = [float(v) for v in self.streams.position[index]]
        if len(place) == 1:
            # A second joint that moves, too, but not with the force.
            return self.joints(time, [0.1 * np.sin(0.7 * time), place[0]], [])
        turned = self.streams.orientation
        turn = (0.0, 0.0, 0.0, 1.0) if turned is None else turned[index]
        quaternion = t["geometry_msgs/msg/Quaternion"](*(float(v) for v in turn))
        point = t["geometry_msgs/msg/Point"](*place)
        header = self.header(time, "base")
        if self.kind == "xarm":
            pose = np.array([*(1e3 * v for v in place), 0.0, 0.0, 0.0], dtype=np.float32)
            zeros = np.zeros(6, dtype=np.float32)
            return t["xarm_msgs/msg/RobotMsg"](header, *[0] * 7, zeros, pose, zeros)
        pose = t["geometry_msgs/msg/Pose"](point, quaternion)
        return t["geometry_msgs/msg/PoseStamped"](header, pose)
