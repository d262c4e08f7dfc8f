# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Signs of slow presses, and the weight of the tool, as `fden configure` finds them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from property_helpers import first
from scipy.spatial.transform import Rotation, Slerp

from fden_ros.configure.signs import Course, find_signs
from fden_ros.configure.streams import Streams
from fden_ros.configure.survey import survey
from fden_ros.configure.weight import find_weight, weight_finding
from simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Preload,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import START_NS, simulate
from simulation.trajectory import Approach, RampHold

# `fden configure` on slow presses by noisy arms: no sign, axis or unit is stated wrongly


class Verdict(NamedTuple):
    wrong: tuple[str, ...]
    is_open: bool  #: a sign is not told
    is_clear: bool  #: the force exceeds ten times its noise


def axis_of(draw: np.random.Generator) -> np.ndarray:
    if draw.random() < 0.5:
        return np.array([draw.choice([-1.0, 1.0])])
    vector = draw.normal(0.0, 1.0, 3)
    return np.asarray(vector / np.linalg.norm(vector))


def verdict(seed: int) -> Verdict:
    """Press 3 to 8 mm at 0.1 to 1 mm/s, from the air or from within the tissue."""
    draw = np.random.default_rng([seed, 27])
    rate, depth = 0.05 * np.exp(draw.uniform(np.log(0.1), 0.0)), draw.uniform(0.15, 0.4)
    peak, noise = np.exp(draw.uniform(np.log([0.1, 0.002]), np.log([8.0, 0.1])))
    force_rate, motion_rate = draw.uniform(60.0, 500.0, 2)
    press = RampHold(rate, depth, draw.choice([0.1, 2.0, 10.0]), rate * draw.choice([1.0, 20.0]))
    scenario = Scenario(
        geometry=Geometry("flat_punch", radius_m=0.01, thickness_m=0.02),
        sites=(Site(Tissue(2000.0, draw.uniform(2.0, 10.0), draw.uniform(0.05, 0.3)), (press,)),),
        approach=Approach(draw.uniform(0.5, 5.0) * 1e-3, 1e-3, 5e-4, start_pause_s=2.0),
        force=ForceSensor(force_rate),
        displacement=DisplacementSensor(motion_rate, delay_s=draw.uniform(0.0, 0.02)),
        preload=Preload(0.3 * depth * 0.02 if draw.random() < 0.3 else 0.0, 60.0),
    )
    recording = simulate(scenario, seed)
    grows, into = axis_of(draw), axis_of(draw)
    times, motion_times = (
        1e-9 * (s.stamp_ns - START_NS) for s in (recording.force, recording.displacement)
    )
    force = np.outer(peak * recording.force.value / recording.force.value.max(), grows)
    force += np.outer(draw.normal(0.0, 0.003) * times, draw.normal(0.0, 1.0, grows.size))
    force += draw.normal(0.0, 3.0, grows.size) + draw.normal(0.0, noise, force.shape)
    place = np.outer(recording.displacement.value, into)
    place += draw.normal(0.0, 0.3, into.size) + draw.normal(0.0, 1e-5, place.shape)
    found = survey([Streams("slow press", times, force, motion_times, place)])
    wrong, is_open = [], False
    for name, truth in (("force", grows), ("displacement", into)):
        axis = found.finding(f"{name} axis")
        is_open |= axis.value is None
        if axis.claim and float(np.atleast_1d(axis.value) @ truth) < 0.0:
            wrong.append(f"{seed} {name} axis")
    return Verdict(tuple(wrong), is_open, bool(peak > 10.0 * noise))


@pytest.mark.parametrize(
    "seeds",
    [
        range(4),
        # Single presses without a hold, whose force axes were reversed once.
        (239, 5747),
        # A drift that outdoes the contact.
        (20330,),
        pytest.param((*range(200), 245, 296, 570, 858), marks=pytest.mark.statistics),
    ],
)
def test_signs_of_slow_presses_are_right_or_left_open(seeds):
    verdicts = [verdict(seed) for seed in seeds]
    assert [name for one in verdicts for name in one.wrong] == []
    clear = [one.is_open for one in verdicts if one.is_clear]
    assert sum(clear) <= max(1, 0.05 * len(clear))


def test_a_few_chunks_of_noise_tell_no_sign():
    times = 0.2 * np.arange(24)
    motion = np.interp(times, [0.0, 1.2, 2.4, 3.6, 4.8], [0.0, 1.0, 0.0, 1.0, 0.0])
    for seed in range(60):
        draw = np.random.default_rng(seed)
        push = draw.normal(0.0, 1.0, times.size)
        place = motion + draw.normal(0.0, 1e-3, times.size)
        course = Course(times, place, push, np.ones(times.size, bool), 1.0)
        assert not find_signs([course]).is_stated, seed


# The tool's weight from turns in the air: how far what is found holds, and what is lacking


MASS, GRAVITY = 0.35, np.array([0.0, 0.0, -9.80665])
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Turns:
    """Force and pose of a sensor with a tool that is turned through orientations and back."""

    force_times: Array
    force: Array
    pose_times: Array
    quaternions: Array

    def streams(self) -> Streams:
        place = np.zeros((self.pose_times.size, 3))
        return Streams(
            "turns",
            *(self.force_times, self.force, self.pose_times, place),
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
    late = np.clip(pose_times - 0.004, 0.0, None)
    return Turns(force_times, force, pose_times, path(late).as_quat())


def about(axis: str, *degrees: float) -> Rotation:
    return Rotation.concatenate([Rotation.from_euler(axis, d, degrees=True) for d in degrees])


def test_the_mass_lies_within_its_deviation():
    errors = []
    for seed in range(60):
        one = turned(seed).streams()
        mass = weight_finding(find_weight([one]), [one])
        assert mass.claim and mass.value == pytest.approx(MASS, rel=0.02)
        errors.append((mass.value - MASS) / mass.deviation)
    assert 0.7 < math.sqrt(np.mean(np.square(errors))) < 1.3
    assert np.mean(np.abs(errors) < 1.96) >= 0.9


@pytest.mark.parametrize(
    ("rotations", "said", "motion"),
    [
        (about("x", 0, 0, 0), "did not turn", "three orientations"),
        (about("x", 0, 15, 0), "degrees only", "three orientations"),
        (about("x", 0, 80, 0), "about one axis, (1.0, 0.0, 0.0)", "two axes"),
        (about("z", 0, 90, 180), "about one axis, (0.0, 0.0, 1.0)", "two axes"),
    ],
)
@pytest.mark.parametrize("seed", first(0, 1, 2))
def test_what_the_turns_lack_is_said_with_the_motion(rotations, said, motion, seed):
    one = turned(seed, rotations).streams()
    finding = weight_finding(find_weight([one]), [one])
    assert not finding.claim
    assert said in finding.evidence
    assert motion in finding.motion
