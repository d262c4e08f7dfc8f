# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings of a new user: three presses of one place by an arm, in four layouts.

Tissue, noise and the rig's errors are drawn; the errors as the parameters' defaults say.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from frame_helpers import Place, Vector, place, write_bag
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from unknown_rig_bags import RigBag

from fden_ros.configure.streams import Streams
from simulation.disturbance import Disturbances
from simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import Recording, simulate
from simulation.trajectory import Approach, RampHold

Array = NDArray[np.float64]
FACE, THICKNESS = math.pi * 0.02**2, 0.02
DOWN = np.array([0.0, 0.0, -1.0])


class Truth(NamedTuple):
    """What is true of a press: ln G, ln Gn, alpha."""

    log_g: float
    log_gn: float
    alpha: float


@dataclass(frozen=True)
class Rig:
    """A layout: how often it samples, what a press makes of its axes, and how it is recorded.

    Attributes
    ----------
    rates
        Of force and displacement [Hz].
    force, displacement
        Direction of a growing force, and of a press, where they are recorded.
    options
        What a user adds to ``fden configure``.
    """

    rates: tuple[float, float]
    force: Array
    displacement: Array
    options: tuple[str, ...]
    record: Callable[[Path, Streams], Path]


def pressed(seed: int, noise: float, rates: tuple[float, float]) -> tuple[Recording, Truth]:
    """Return three presses of one place, to 7 mm, and the tissue that was drawn."""
    draw = np.random.default_rng([seed, 12])
    g = float(np.exp(draw.uniform(math.log(400.0), math.log(4000.0))))
    gn, alpha = float(draw.uniform(6.0, 12.0)), float(draw.uniform(0.08, 0.25))
    press = RampHold(strain_rate=0.2, max_strain=0.35, hold_s=2.0, retract_rate=0.4)
    scenario = Scenario(
        seed=seed,
        geometry=Geometry(area_m2=FACE, thickness_m=THICKNESS * (1 + draw.normal(0.0, 0.02))),
        sites=(Site(Tissue(g, gn, alpha), (press,) * 3),),
        approach=Approach(slow_distance_m=0.002),
        force=ForceSensor(
            rate_hz=rates[0],
            noise_n=noise,
            bias_n=float(draw.normal(0.0, 2.0)),
            drift_n_per_s=float(draw.normal(0.0, 0.001)),
        ),
        displacement=DisplacementSensor(
            rate_hz=rates[1], noise_m=1e-5, delay_s=float(draw.normal(0.0, 0.0025))
        ),
        disturbances=Disturbances(
            compliance_m_per_n=abs(float(draw.normal(0.0, 1e-4))),
            friction_n=abs(float(draw.normal(0.0, 0.007))),
        ),
    )
    return simulate(scenario), Truth(math.log(g), math.log(gn), alpha)


def recorded(folder: Path, layout: str, seed: int, noise: float) -> tuple[Path, Truth]:
    """Write a recording in a layout; return it with its truth."""
    rig = LAYOUTS[layout]
    recording, truth = pressed(seed, noise, rig.rates)
    draw = np.random.default_rng([seed, 13])
    seconds = [
        1e-9 * (stream.stamp_ns - recording.force.stamp_ns[0]) + 1.0
        for stream in (recording.force, recording.displacement)
    ]
    force = np.outer(recording.force.value, rig.force)
    # What the other axes read.
    across = np.eye(3) - np.outer(rig.force, rig.force)
    force += draw.normal(0.0, noise, force.shape) @ across
    position = np.outer(recording.displacement.value, rig.displacement)
    position += np.array([0.3, -0.2, 0.1])
    streams = Streams(layout, seconds[0], force, seconds[1], position)
    return rig.record(folder, streams), truth


def _as_table(folder: Path, streams: Streams) -> Path:
    """Write the file of the real-time interface's recorder, separated by blanks."""
    path = folder / "robot_data.csv"
    times = streams.force_times
    newest = np.searchsorted(streams.motion_times[1:], times, side="right")
    rows = np.hstack([times[:, None], streams.force, streams.position[newest]])
    names = [f"actual_TCP_{what}_{k}" for what in ("force", "pose") for k in range(3)]
    np.savetxt(path, rows, "%.6f", header=" ".join(["timestamp", *names]), comments="")
    return path


def _as_bag(force: str, displacement: str) -> Callable[[Path, Streams], Path]:
    def record(folder: Path, streams: Streams) -> Path:
        return RigBag(streams, force, displacement).write(folder / "bag")

    return record


def _as_transforms(folder: Path, streams: Streams) -> Path:
    """Write the motion as transforms alone; the flange and the sensor are turned."""
    turn, mount = Rotation.from_euler("xyz", [0.2, 3.0, 0.4]), Rotation.from_euler("z", 0.8)
    sensor = turn * mount
    samples: list[Place | Vector] = [
        place(_ns(time), "base", "flange", at, turn)
        for time, at in zip(streams.motion_times, streams.position, strict=True)
    ]
    for time, force in zip(streams.force_times, sensor.inv().apply(streams.force), strict=True):
        x, y, z = map(float, force)
        samples.append(Vector(_ns(time), (x, y, z)))
    samples.sort(key=lambda one: one.stamp_ns)
    fixed = [
        place(1, "flange", "sensor", np.zeros(3), mount, static=True),
        place(1, "sensor", "tip", np.array([0.0, 0.0, 0.1]), Rotation.identity(), static=True),
    ]
    return write_bag(folder / "bag", [*fixed, *samples])


def _ns(seconds: float) -> int:
    return round(1e9 * seconds)


_SLANTED = np.array([0.36, 0.48, -0.8])
LAYOUTS = {
    "UR table": Rig((500.0, 500.0), -DOWN, DOWN, ("--robot", "ur", "--one-place"), _as_table),
    "UR bag": Rig(
        (500.0, 500.0),
        DOWN,
        DOWN,
        ("--robot", "ur"),
        _as_bag("/force_torque_sensor_broadcaster/wrench", "/tcp_pose_broadcaster/pose"),
    ),
    "dVRK bag": Rig(
        (200.0, 200.0),
        -DOWN,
        _SLANTED,
        ("--robot", "crtk"),
        _as_bag("/PSM1/body/measured_cf", "/PSM1/measured_cp"),
    ),
    "tf bag": Rig((500.0, 125.0), -_SLANTED, _SLANTED, (), _as_transforms),
}
