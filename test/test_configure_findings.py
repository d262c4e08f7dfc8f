# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Signs of slow presses, as `fden configure` finds them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from fden_ros.configure.streams import Streams
from fden_ros.configure.survey import survey
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
