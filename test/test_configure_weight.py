# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The tool's weight from turns in the air: how far what is found holds, and what is lacking."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from property_helpers import first
from scipy.spatial.transform import Rotation, Slerp

from fden_ros.configure.streams import Streams
from fden_ros.configure.weight import find_weight, weight_findings

MASS, CENTRE, GRAVITY = 0.35, np.array([0.01, -0.02, 0.06]), np.array([0.0, 0.0, -9.80665])
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Turns:
    """Force and pose of a sensor with a tool that is turned through orientations and back."""

    force_times: Array
    force: Array
    torque: Array
    pose_times: Array
    quaternions: Array

    def streams(self) -> Streams:
        place = np.zeros((self.pose_times.size, 3))
        return Streams(
            "turns",
            *(self.force_times, self.force, self.pose_times, place),
            torque=self.torque,
            orientation=self.quaternions,
        )


def turned(seed: int, rotations: Rotation | None = None, mass: float = MASS) -> Turns:
    """Two seconds to each orientation, one of rest there; bias, drift, noise, poses 4 ms late."""
    rng = np.random.default_rng(seed)
    if rotations is None:
        first, across = Rotation.random(rng=rng), rng.permutation(3)[:2]
        tilts = [Rotation.from_euler("xyz"[axis], 60.0, degrees=True) for axis in across]
        rotations = Rotation.concatenate([first, first * tilts[0], first * tilts[1], first])
    count = len(rotations)
    knots = np.array([3.0 * i + rest for i in range(count) for rest in (0.0, 1.0)])
    path = Slerp(knots, Rotation.concatenate([rotations[i // 2] for i in range(2 * count)]))
    force_times = np.arange(0.0, knots[-1], 1 / 200)
    pose_times = np.arange(0.003, knots[-1], 1 / 100)
    weight = path(force_times).inv().apply(mass * GRAVITY)
    drift = force_times[:, None] * rng.normal(0.0, 0.003, 3)
    force = weight + rng.normal(0.0, 2.0, 3) + drift + rng.normal(0.0, 0.02, weight.shape)
    torque = np.cross(CENTRE, weight) + rng.normal(0.0, 0.05, 3)
    torque += rng.normal(0.0, 0.001, weight.shape)
    late = np.clip(pose_times - 0.004, 0.0, None)
    return Turns(force_times, force, torque, pose_times, path(late).as_quat())


def about(axis: str, *degrees: float) -> Rotation:
    return Rotation.concatenate([Rotation.from_euler(axis, d, degrees=True) for d in degrees])


def test_mass_and_centre_lie_within_their_deviations() -> None:
    masses, centres = [], []
    for seed in range(60):
        one = turned(seed).streams()
        mass, centre = weight_findings(find_weight([one]), [one])
        assert mass.claim and isinstance(mass.value, float) and mass.deviation
        assert mass.value == pytest.approx(MASS, rel=0.02)
        masses.append((mass.value - MASS) / mass.deviation)
        assert centre.claim and centre.deviation
        centres.append((np.array(centre.value) - CENTRE) / centre.deviation)
    for errors in (np.array(masses), np.concatenate(centres)):
        assert 0.7 < math.sqrt(float(np.mean(errors**2))) < 1.3
        assert np.mean(np.abs(errors) < 1.96) >= 0.9


@pytest.mark.parametrize(
    ("rotations", "said", "motion"),
    [
        (about("x", 0, 0, 0), "did not turn", "three orientations"),
        (about("x", 0, 15, 0), "degrees only", "three orientations"),
        (about("x", 0, 80, 0), "about one axis, (1.0, 0.0, 0.0)", "another axis"),
        (about("z", 0, 90, 180), "about one axis, (0.0, 0.0, 1.0)", "another axis"),
    ],
)
@pytest.mark.parametrize("seed", first(0, 1, 2))
def test_what_the_turns_lack_is_said_with_the_motion(
    rotations: Rotation, said: str, motion: str, seed: int
) -> None:
    one = turned(seed, rotations).streams()
    for finding in weight_findings(find_weight([one]), [one]):
        assert not finding.claim
        assert said in finding.evidence
        assert motion in finding.motion
