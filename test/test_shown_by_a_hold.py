# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a hold has shown goes on in predictions, and tells of a wrong alpha that was stated."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from property_helpers import counts, first

from benchmark.laws import (
    ARM,
    MOMENTS,
    RIGID,
    Case,
    Recording,
    recorded,
    run_trial,
)
from benchmark.other_laws import Law, springpot
from fden_ros.control.tissue_memory import TissueMemory
from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.law.geometry import FlatPunch
from fden_ros.core.outputs import ContactSummary, Flag
from fden_ros.core.pipeline import Pipeline
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation.model import FdenModel
from simulation.closed_form import stress_of_piecewise_linear_strain
from simulation.simulate import KNOWN_RIG, START_NS

IN_THE_HOLD = MOMENTS[2:]
STRAIN, RAMP = 0.25, 1.0
MODEL = FdenModel(2000.0, 8.0, 0.2)


@pytest.mark.parametrize("seeds", counts(2, 8))
@pytest.mark.parametrize(
    ("name", "rig"),
    [
        ("linear_solid_10", RIGID),
        ("linear_solid_10", ARM),
        ("linear_solid_1", RIGID),
        ("poroelastic_20", RIGID),
    ],
)
def test_a_relaxation_that_has_begun_or_ended_is_predicted_in_its_interval(
    name: str, rig: str, seeds: int
) -> None:
    """Or nothing is predicted: what is no FDEN is not known, or said not to follow the law."""
    made = [
        prediction
        for seed in range(40, 40 + seeds)
        for prediction in run_trial((name, rig), seed).predictions
        if prediction.moment in IN_THE_HOLD
    ]
    predicted = [prediction.inside for prediction in made if not prediction.refusal]
    assert len(made) >= 3
    assert np.count_nonzero(predicted) >= 0.9 * len(predicted)


# The slope of what is left out


def held(slope: float, hold: float, step: float = 0.01) -> tuple[TissueMemory, float]:
    """Return the memory of a ramp and a hold of the law, and beside it `slope` ln t [Pa]."""
    times = np.arange(0.0, RAMP + hold, step)
    strains = STRAIN * np.minimum(times / RAMP, 1.0)
    stresses = stress_of_piecewise_linear_strain(times, strains, times, MODEL)
    age = np.maximum(times - RAMP, 0.0) + 0.3
    stresses += slope * np.log(age)
    memory = TissueMemory(FlatPunch(area=1e-4, thickness=0.02))
    for strain, stress in zip(strains[1:], stresses[1:], strict=True):
        memory.press(step, float(strain), float(stress))
    return memory, float(age[-1])


@pytest.mark.parametrize("slope", [-300.0, 0.0, 100.0])
def test_the_slope_of_what_the_law_leaves_out_is_found(slope: float) -> None:
    memory, age = held(slope, hold=3.0)
    logs = np.log([MODEL.linear_stiffness, MODEL.nonlinear_stiffness])
    found = memory.slope(age)
    assert found is not None
    left_out = memory.left_out(found.points, logs, MODEL.fractional_order)
    assert float(found.weights @ left_out) == pytest.approx(slope, abs=5.0)


def test_a_motion_shows_no_slope() -> None:
    memory, age = held(0.0, hold=0.0)
    assert memory.slope(age) is None
    memory, age = held(0.0, hold=3.0)
    memory.press(0.01, 1.1 * STRAIN, 5000.0)
    assert memory.slope(age) is None


# Alpha


def last_summary(recording: Recording, parameters: Mapping[str, object]) -> ContactSummary:
    summaries: list[ContactSummary] = []

    def keep(output: object) -> None:
        if isinstance(output, ContactSummary):
            summaries.append(output)

    area = math.pi * 0.01**2
    stated = {"geometry.kind": "flat_punch", "geometry.area": area, "geometry.thickness": 0.02}
    pipeline = Pipeline(pipeline_config(check({**stated, **KNOWN_RIG, **parameters})), keep)
    for time, force, displacement in zip(
        recording.times.tolist(),
        recording.forces.tolist(),
        recording.displacements.tolist(),
        strict=True,
    ):
        stamp = START_NS + round(1e9 * time)
        pipeline.add_displacement(stamp, displacement, (0.0, 0.0, displacement))
        pipeline.add_force(stamp, force)
    pipeline.finish()
    return summaries[-1]


def pressed(number: int) -> tuple[Recording, float]:
    """Return a recording of tissue that is the law's, and its alpha."""
    drawn: list[FdenModel] = []

    def law(model: FdenModel) -> Law:
        drawn.append(model)
        return Law(model, springpot(model.fractional_order))

    return recorded(Case("fden", "the law itself", law), number), drawn[-1].fractional_order


@pytest.mark.parametrize("learn", [True, False])
@pytest.mark.parametrize("number", first(*range(40, 44)))
def test_a_stated_alpha_is_told_as_wrong_where_it_is(number: int, learn: bool) -> None:
    recording, order = pressed(number)
    stated = {"alpha.learn": learn, "prior.alpha_sd": 0.01}
    right = last_summary(recording, {**stated, "prior.alpha": order})
    assert Flag.ALPHA_CONTRADICTED not in right.flags
    wrong = last_summary(recording, {**stated, "prior.alpha": order + 0.15})
    assert Flag.ALPHA_CONTRADICTED in wrong.flags
    assert wrong.estimate is not None and wrong.estimate.law_error is not None
    assert not wrong.estimate.knows(StateIndex.FRACTIONAL_ORDER)
    assert wrong.estimate.law_error.order == pytest.approx(order, abs=0.02)
