# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is learned of the rig, and what is not."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from pipeline_helpers import feed, identified, items_of, summaries_of
from property_helpers import counts

from benchmark.presses import CASES, PRIOR, scenario_of, trial_of
from fden_ros.core.estimation.estimator_config import EstimatorConfig, Uncertainty
from fden_ros.core.estimation.rig_knowledge import RigKnowledge
from fden_ros.core.outputs import Flag, Phase, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.parameters import check, pipeline_config
from simulation.scenario import (
    DisplacementSensor,
    Disturbances,
    ForceSensor,
    Geometry,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import simulate
from simulation.trajectory import RampHold

ARM = Uncertainty(compliance_sd=1.5e-4, delay_sd=0.0025, friction_sd=0.007)
CONFIG = EstimatorConfig(uncertainty=ARM)


def test_a_long_hold_in_which_nothing_is_learned_does_not_move_alpha():
    """Noise spoke of the compliance: alpha went on by a deviation in 30 s, 6 off after 200 s."""
    tissue = Tissue(linear_stiffness=2234.0, nonlinear_stiffness=3.83, fractional_order=0.344)
    scenario = Scenario(
        geometry=Geometry("flat_punch", radius_m=0.01, thickness_m=0.02),
        sites=(Site(tissue, (RampHold(0.28, 0.25, 90.0, 0.6),)),),
        force=ForceSensor(rate_hz=30.0, noise_stress_pa=6.2),
        displacement=DisplacementSensor(rate_hz=30.0),
    )
    parameters = {
        "geometry.area": math.pi * 1e-4,
        "geometry.thickness": 0.02,
        "prior.linear_stiffness": 185.0,
        "prior.linear_stiffness_log_sd": 1.75,
        "prior.nonlinear_stiffness": 7.2,
        "prior.nonlinear_stiffness_log_sd": 0.6,
        "prior.alpha": 0.46,
        "prior.alpha_sd": 0.11,
    }
    _, outputs = identified(items_of(simulate(scenario, 1)), parameters)
    held = [o.estimate for o in outputs if isinstance(o, TissueState) and o.phase is Phase.HOLDING]
    early, late = held[900], held[-1]
    moved = (late.fractional_order - early.fractional_order) / early.deviations[2]
    assert abs(moved) < 0.3


def test_knowledge_narrows_to_half_of_what_is_stated_and_forgets_what_another_rig_contradicts():
    known = RigKnowledge.stated(CONFIG)
    for _ in range(9):
        mean, covariance = known.scaled(ARM)
        known = known.taught(mean, 0.5 * covariance, CONFIG)
    assert known.contacts == 9
    for value, stated in zip(known.values.values(), ARM.rig_sd, strict=True):
        assert value.sd == pytest.approx(0.5 * stated)
    mean, covariance = known.scaled(ARM)
    other = known.taught(mean + np.array([0.0, 2.0]), covariance, CONFIG)
    assert other == RigKnowledge.stated(CONFIG)


@functools.cache
def touches():
    """Return items and parameters of two sites on one rig, at 100 Hz."""
    case = CASES["ten_sites"]
    scenario = scenario_of(replace(case, sites=2), 3)
    scenario = replace(
        scenario,
        geometry=replace(scenario.geometry, thickness_m=0.02),
        force=replace(scenario.force, rate_hz=100.0),
        displacement=replace(scenario.displacement, rate_hz=100.0),
    )
    recording = simulate(scenario)
    own = recording.truth["identifier_parameters"]
    parameters = {name: own[name] for name in own if name.startswith("geometry.")}
    parameters.pop("geometry.thickness_sd", None)
    return items_of(recording), {**parameters, **PRIOR, "rig.learn": True}


@pytest.mark.parametrize("numbers", counts(1, 3))
@pytest.mark.parametrize(
    ("case", "contradicts"),
    [
        (CASES["undisturbed"], False),
        (replace(CASES["undisturbed"], delay_s=0.02), None),
        (replace(CASES["friction_20mN"], disturbances=Disturbances(friction_n=0.04)), True),
    ],
    ids=["as stated", "delay", "friction"],
)
def test_unloading_beyond_what_is_stated_of_the_rig_is_flagged_and_counts(
    case, contradicts, numbers
):
    """A delay of 20 ms may as well be an error of the law: then that is in the deviations."""
    for number in range(numbers):
        (contact,) = trial_of(case, number, {}).contacts
        is_said = bool(contact.flags & Flag.HYSTERESIS) or not contact.converged
        assert contradicts is None or is_said == contradicts
        assert np.all(np.abs(contact.error) < 3.0 * contact.deviation)


def test_what_a_contact_tells_of_the_rig_the_next_site_knows_also_after_a_reset():
    items, parameters = touches()
    outputs = []
    pipeline = Pipeline(pipeline_config(check(parameters)), outputs.append)
    assert pipeline.rig.contacts == 0
    feed(pipeline, items)
    pipeline.finish()
    known = [summary.rig for summary in summaries_of(outputs)]
    assert [rig.contacts for rig in known] == [1, 2]
    frictions = [rig.values["friction"].sd for rig in known]
    assert frictions[0] < ARM.friction_sd
    for quantity in known[0].values:
        assert known[1].values[quantity].sd <= known[0].values[quantity].sd
    pipeline.reset()
    assert pipeline.rig == replace(known[-1], drift=pipeline.rig.drift)
    pipeline.forget_rig()
    assert pipeline.rig == RigKnowledge.stated(pipeline.config.estimator)


def test_a_contact_that_is_cut_short_or_not_to_be_learned_from_teaches_nothing():
    items, parameters = touches()
    half, first = items[: len(items) // 5], items[: len(items) // 2]
    for own, some in (({"rig.learn": False}, first), ({}, half)):
        _, outputs = identified(some, {**parameters, **own})
        summaries = summaries_of(outputs)
        assert summaries and all(summary.rig.contacts == 0 for summary in summaries)


def test_forgetting_the_rig_before_the_air_was_judged_lets_that_contact_teach_nothing():
    items, parameters = touches()
    outputs = []
    pipeline = Pipeline(pipeline_config(check(parameters)), outputs.append)
    stated = RigKnowledge.stated(pipeline.config.estimator)
    remaining = iter(items)
    while not summaries_of(outputs):
        feed(pipeline, [next(remaining)])
    pipeline.forget_rig()
    for item in remaining:
        feed(pipeline, [item])
        if pipeline.newest_ns > summaries_of(outputs)[0].end_ns + 1_800_000_000:
            break
    assert len(summaries_of(outputs)) == 1
    pipeline.finish()
    assert pipeline.rig == stated
