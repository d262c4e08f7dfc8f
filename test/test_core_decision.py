# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The label in a whole contact: early enough, never too early, and gone with its tissue."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from pipeline_helpers import LIVER_PARAMETERS, feed, items_of, parameters_of, summaries_of

from fden_ros.core.classification.classifier import TissueLibrary
from fden_ros.core.outputs import Classification, Decision, Output, Status, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.parameters import check, pipeline_config
from fden_ros.tissues.library import load_library
from simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Ramp,
    RampHold,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import simulate
from simulation.trajectory import Approach

BUILT_IN = load_library()
LIVER = BUILT_IN.tissues[0]
#: Alike but for alpha.
SLOW = replace(LIVER, name="slow", mean=LIVER.mean + np.array([0.0, 0.0, 0.15]))
TWINS = TissueLibrary("twins", (LIVER, SLOW), BUILT_IN.unknown)
RAMP = Ramp(strain_rate=0.4, max_strain=0.25)
HOLD = RampHold(strain_rate=0.4, max_strain=0.25, hold_s=1.5)


def pressed(library, press, g=520.0, order=0.131, noise=3.0, repeat=1, **others):
    scenario = Scenario(
        name="one",
        geometry=Geometry("flat_punch", radius_m=0.01, thickness_m=0.02),
        approach=Approach(distance_m=0.002, slow_distance_m=0.001, start_pause_s=1.0),
        sites=(Site(Tissue(g, 8.4, order), (press,) * repeat),),
        force=ForceSensor(rate_hz=200.0, noise_stress_pa=noise),
        displacement=DisplacementSensor(rate_hz=200.0),
    )
    recording = simulate(scenario, 1)
    parameters = (
        parameters_of(recording)
        | LIVER_PARAMETERS
        | {
            "alpha.learn": True,
            "prior.alpha": 0.2,
            "prior.alpha_sd": 0.1,
            "prior.linear_stiffness_log_sd": 1.0,
        }
    )
    parameters |= {name.replace("__", "."): value for name, value in others.items()}
    config = replace(pipeline_config(check(parameters)), library=library)
    outputs: list[Output] = []
    pipeline = Pipeline(config, outputs.append)
    feed(pipeline, items_of(recording))
    pipeline.finish()
    return outputs


def answers(outputs):
    return [output for output in outputs if isinstance(output, Classification)]


def test_no_label_before_the_estimate_has_converged():
    outputs = pressed(BUILT_IN, HOLD)
    first = next(a for a in answers(outputs) if a.decision is not Decision.UNDETERMINED)
    converged = next(
        o for o in outputs if isinstance(o, TissueState) and o.status is Status.CONVERGED
    )
    assert first.stamp_ns >= converged.stamp_ns
    assert (first.decision, first.classes.label) == (Decision.CLASS, "liver")
    # What it took: beyond the boundary strain, and before the end of the ramp.
    assert math.exp(-LIVER.mean[1]) < first.decided.strain <= 0.26
    assert 0.1 < first.decided.time < 1.0
    (summary,) = summaries_of(outputs)
    assert summary.decided == first.decided


def test_label_waits_where_the_data_have_not_shown_what_decides():
    # So much noise that the ramp shows G and Gn, but hardly alpha; the priors favour liver.
    biased = replace(TWINS, tissues=(replace(LIVER, prior=1e3), SLOW))
    outputs = pressed(biased, Ramp(strain_rate=0.4, max_strain=0.3), noise=15.0)
    assert any(o.status is Status.CONVERGED for o in outputs if isinstance(o, TissueState))
    waiting = [a for a in answers(outputs) if a.classes is not None]
    sd = [
        math.sqrt(o.estimate.covariance[2, 2])
        for o in outputs
        if isinstance(o, TissueState) and o.estimate is not None
    ]
    blind = [a for a in waiting if not a.classes.is_observable]
    assert blind and min(sd) > 0.005
    assert all(a.decision is Decision.UNDETERMINED and not a.classes.label for a in blind)
    assert all(max(a.classes.probabilities) > 0.9 for a in blind)


def test_repeated_contact_of_a_site_decides_with_all_that_is_known():
    outputs = pressed(BUILT_IN, HOLD, repeat=2)
    first, second = summaries_of(outputs)
    assert second.site_id == first.site_id
    assert second.classes.label == "liver"
    # The estimate of the second holds the first: no need to press so far again.
    assert second.decided.strain < first.decided.strain
