# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A contact that has not converged says why, in numbers, and what would help."""

from __future__ import annotations

import math
import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from output_helpers import ESTIMATE, summary
from pipeline_helpers import identified, items_of, summaries_of

from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation.budget import SOURCES, Budget
from fden_ros.core.estimation.claims import Reservations, reserved
from fden_ros.core.estimation.estimate import ParameterSet
from fden_ros.core.estimation.estimator_config import EstimatorConfig, Uncertainty
from fden_ros.core.law.geometry import FlatPunch
from fden_ros.core.outputs import ContactSummary, apparent_stiffness_of
from fden_ros.offline.advice import next_press, shortfall
from fden_ros.offline.remarks import remarks
from fden_ros.parameters import check, pipeline_config
from fden_ros.planning.remedies import WORDS
from fden_ros.report.sentence import next_step
from simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Scenario,
    Site,
    Tissue,
)
from simulation.simulate import simulate
from simulation.trajectory import RampHold

RADIUS = 0.01


@cache
def pressed(
    g: float, noise: float, strain: float, **more: Any
) -> tuple[ContactSummary, PipelineConfig]:
    """Return the contact of a press of tissue with a Gn of 8.5, and the configuration."""
    scenario = Scenario(
        seed=1,
        geometry=Geometry(radius_m=RADIUS, thickness_m=0.02),
        sites=(Site(tissue=Tissue(g, 8.5, 0.131), presses=(RampHold(0.1, strain, 1.0),)),),
        force=ForceSensor(rate_hz=100.0, noise_n=noise),
        displacement=DisplacementSensor(rate_hz=100.0, noise_m=5e-6),
    )
    parameters = {
        "geometry.kind": "flat_punch",
        "geometry.area": math.pi * RADIUS**2,
        "geometry.thickness": 0.02,
        **{name.replace("__", "."): value for name, value in more.items()},
    }
    (contact,) = summaries_of(identified(items_of(simulate(scenario)), parameters)[1])
    return contact, pipeline_config(check(parameters))


def lacking(source: str, index: int, deviation: float, **more: Any) -> tuple[str, ContactSummary]:
    """Return what is said where one source makes all of the variance of ln G or ln Gn."""
    covariance = np.diag([1e-4, 1e-4, 1e-4])
    covariance[index, index] = deviation**2
    known = ParameterSet.ALL & ~(1 << index)
    variances = covariance[0, 0], covariance[1, 1]
    parts = {name: (0.0, 0.0) for name in SOURCES}
    parts[source] = (0.9 * variances[0], 0.9 * variances[1])
    contact = summary(
        converged=False,
        estimate=ESTIMATE._replace(covariance=covariance, known=known),
        max_force=0.016,
        end_ns=1_000_000_000,
        start_ns=0,
        sample_count=100,
        budget=Budget(variances, parts, stress_noise=160.0, surface_sd=0.02),
        **more,
    )
    rig = Uncertainty(
        surface_motion_sd=1e-4,
        force_drift_sd=0.005,
        friction_sd=0.007,
        compliance_sd=1e-4,
        delay_sd=0.0025,
        thickness_sd=0.02,
    )
    config = PipelineConfig(
        None,
        geometry=FlatPunch(math.pi * RADIUS**2, 0.02),
        estimator=EstimatorConfig(uncertainty=rig),
    )
    words = shortfall(contact, config)
    assert "\n" not in words
    return words, contact


@pytest.mark.parametrize(
    ("source", "remedy"),
    [
        (
            "friction",
            "friction of 7.0 mN is assumed and the press had 16 mN: state force.friction_sd, use "
            "config/bench.yaml on a rigid rig, or press to 56 mN",
        ),
        ("noise", "with 50 mN of noise it takes a face of 38 mm or a strain of 0.46"),
        (
            "drift",
            "drift of 5.0 mN in a second is assumed and the press had 16 mN: state "
            "force.drift_sd, press faster, or press to 56 mN",
        ),
        (
            "motion",
            "0.10 mm of motion of the surface in a second is assumed: state surface.motion_sd, "
            "or press faster",
        ),
        ("compliance", "a compliance of 0.10 mm/N is assumed: state displacement.compliance_sd"),
        ("delay", "a delay of 2.5 ms is assumed: fden configure measures it"),
        ("surface", "the surface was found to 0.40 mm: touch it slower"),
        ("thickness", "a thickness known to 2 % is assumed: state geometry.thickness_sd"),
    ],
)
def test_the_largest_source_is_named_with_its_share_and_its_remedy(source, remedy) -> None:
    words, _ = lacking(source, 1, 0.12)
    assert words == f"Gn is known to 12 % only (of the variance: {WORDS[source]} 90 %); {remedy}"


def test_what_is_as_uncertain_as_large_is_known_to_a_factor() -> None:
    words, _ = lacking("noise", 0, 1.2)
    assert words.startswith("G is known to a factor of 3.3 only")


def test_the_exit_line_the_remark_and_the_sentence_say_the_same() -> None:
    _, contact = lacking("friction", 1, 0.12)
    config = PipelineConfig(None, geometry=FlatPunch(math.pi * RADIUS**2, 0.02))
    words = shortfall(contact, config)
    assert f"{words[0].upper()}{words[1:]}." in list(remarks(contact, config))
    assert next_step(contact, config) in words


def test_a_hidden_surface_leaves_the_slope_of_the_force() -> None:
    hidden = reserved(EstimatorConfig(), ESTIMATE, Reservations(is_surface_hidden=True))
    geometry = FlatPunch(math.pi * RADIUS**2, 0.02)
    seen, open_ = (apparent_stiffness_of(e, geometry, 0.3, 0.1) for e in (ESTIMATE, hidden))
    assert seen is not None and open_ is not None
    assert hidden.deviations[0] > 2.0
    assert open_.value == seen.value
    # Gn times the stress: what is open of ln Gn, 0.23, counts once.
    assert open_.sd / open_.value == pytest.approx(math.hypot(seen.sd / seen.value, 0.23))
    # Below 1/Gn the slope is that of G.
    shallow = apparent_stiffness_of(hidden, geometry, 0.1, 0.1)
    assert shallow is not None
    assert shallow.sd > 2.0 * shallow.value


def test_a_press_that_is_not_deep_enough_ends_with_the_press_that_is() -> None:
    contact, config = pressed(2000.0, 0.002, 0.06)
    words = shortfall(contact, config)
    assert "Gn is not observable" in words
    assert re.search(r"; press to [\d.]+ mm at .* the target with \d+ %", words)
    following = next_press(contact, config)
    assert following is not None and words.endswith(following.line())
    assert following.motion.depth > 0.1 * 0.02  # beyond 1/Gn


@pytest.mark.parametrize("source", ["drift", "motion"])
def test_a_part_is_what_the_variance_loses_where_the_source_is_stated_as_none(source) -> None:
    stated = {
        "drift": {"force__drift_sd": 0.0},
        "motion": {"surface__motion_sd": 0.0},
    }
    shallow = 2000.0, 0.002, 0.06
    budget = pressed(*shallow)[0].budget
    without = pressed(*shallow, **stated[source])[0].budget
    assert budget is not None and without is not None
    part, left = budget.parts[source][0], without.variances[0]
    # The drift's zero at the touch is not stated, but measured.
    assert budget.variances[0] - part == pytest.approx(left, rel=0.15)
