# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Disturbances of a rig: each does what it says, by closed form or by simple physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fden_ros.simulation.model import FdenModel
from simulation.closed_form import stress_of_piecewise_linear_strain
from simulation.disturbance import (
    Disturbances,
    Phases,
    SurfaceMotion,
)
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
from simulation.trajectory import Approach, Ramp, RampHold

MODEL = FdenModel(4000.0, 8.0, 0.2)
AREA = np.pi * 0.01**2
THICKNESS = 0.02


def scenario(press=None, *, disturbances=None, **changes):
    """Return a press and hold without noise at 500 Hz, disturbed or not."""
    tissue = Tissue(MODEL.linear_stiffness, MODEL.nonlinear_stiffness, MODEL.fractional_order)
    given = Scenario(
        geometry=Geometry("flat_punch", radius_m=0.01, thickness_m=THICKNESS),
        sites=(Site(tissue, (press or RampHold(0.2, 0.25, 1.0, 0.4),)),),
        approach=Approach(0.005, 0.01, 0.002, start_pause_s=0.5),
        force=ForceSensor(rate_hz=500.0),
        displacement=DisplacementSensor(rate_hz=500.0),
        disturbances=disturbances or Disturbances(),
        seed=3,
    )
    return replace(given, **changes)


def recorded(press=None, **arguments):
    return simulate(scenario(press, **arguments))


def seconds(stream):
    return (stream.stamp_ns - START_NS) * 1e-9


def spans(recording):
    return [
        ((c["start_ns"] - START_NS) * 1e-9, (c["end_ns"] - START_NS) * 1e-9)
        for c in recording.truth["contacts"]
    ]


def added(**disturbances):
    """Return times, what disturbances add to the force, and the only contact."""
    clean = recorded()
    disturbed = recorded(disturbances=Disturbances(**disturbances))
    return (
        seconds(clean.force),
        disturbed.force.value - clean.force.value,
        spans(clean)[0],
    )


def exact_force(times, strain):
    """Return the force of the law along a strain (n,) that is 0 first, at the same times."""
    return AREA * stress_of_piecewise_linear_strain(times, strain, times, MODEL)


# Nothing


def test_steps_of_time_agree_with_the_closed_form():
    exact = recorded()
    # A dent after the press changes nothing in it, but the tissue is stepped.
    stepped = recorded(disturbances=Disturbances(plastic_set_m=1e-9))
    assert stepped.truth["disturbances"]["plastic_set_m"] == 1e-9
    peak = exact.force.value.max()
    np.testing.assert_allclose(stepped.force.value, exact.force.value, rtol=0, atol=2e-3 * peak)
    np.testing.assert_allclose(spans(stepped), spans(exact), atol=2e-3)
    assert stepped.displacement.value.tobytes() == exact.displacement.value.tobytes()


# The motion


@pytest.mark.parametrize("kind", ["breathing", "compliance"])
def test_disturbed_motion_changes_the_strain_and_not_the_reading(kind):
    motion = SurfaceMotion(1e-3, 0.5, 0.3)
    given = {
        "breathing": Disturbances(breathing=motion),
        "compliance": Disturbances(compliance_m_per_n=1e-3),
    }[kind]
    disturbed, clean = recorded(disturbances=given), recorded()
    assert disturbed.displacement.value.tobytes() == clean.displacement.value.tobytes()
    times, force = seconds(disturbed.force), disturbed.force.value
    # The seed gives the phases. The force is what the law gives for the strain that the surface,
    # or this very force, leaves.
    phases = Phases.draw(np.random.Generator(np.random.PCG64(np.random.SeedSequence([3, 3]))))
    lost = given.surface(times, phases) + given.compliance_m_per_n * force
    start, stop = spans(disturbed)[0]
    inside = (times > start) & (times < stop)
    depth = (clean.displacement.value - lost)[inside]
    expected = exact_force(np.append(start, times[inside]), np.append(0.0, depth) / THICKNESS)[1:]
    np.testing.assert_allclose(force[inside], expected, rtol=0, atol=5e-3 * force.max())
    assert np.abs(force - clean.force.value).max() > 0.1 * clean.force.value.max()
    if kind == "breathing":
        assert np.ptp(lost) == pytest.approx(1e-3, rel=0.02)


# The force


def friction(times, start, stop):
    inward, outward = (times > start) & (times < start + 1.25), times > start + 2.25
    return 0.02 * ((times < stop) * (1.0 * inward - outward))


def creep(times, start, stop):
    rising = 0.03 * (1.0 - np.exp(-np.maximum(times - start, 0.0) / 0.7))
    reached = 0.03 * (1.0 - np.exp(-(stop - start) / 0.7))
    return np.where(times < stop, rising, reached * np.exp(-(times - stop) / 0.7))


def thermal(times, start, stop):
    return -0.05 * np.exp(-times / 2.0)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"friction_n": 0.02}, friction),
        ({"creep_n": 0.03, "creep_s": 0.7}, creep),
        ({"thermal_n": -0.05, "thermal_s": 2.0}, thermal),
    ],
)
def test_force_has_the_error_of_the_stated_course(given, expected):
    times, error, (start, stop) = added(**given)
    edges = np.array([start, start + 1.25, start + 2.25, stop])
    away = np.all(np.abs(times[:, None] - edges) > 0.01, axis=1)
    np.testing.assert_allclose(error[away], expected(times, start, stop)[away], atol=1e-7)


# Preload


@pytest.mark.parametrize("disturbances", [Disturbances(), Disturbances(plastic_set_m=1e-9)])
def test_preloaded_recording_begins_in_the_relaxation_of_a_press_before(disturbances):
    held = scenario(Ramp(0.2, 0.25, 0.4), preload=Preload(0.002, 5.0), disturbances=disturbances)
    recording = simulate(held)
    assert recording.truth["preload"] == {"depth_m": 0.002, "time_s": 5.0}
    times = seconds(recording.force)
    at_rest = times < 0.5
    np.testing.assert_allclose(recording.displacement.value[at_rest], 0.002, atol=1e-12)
    # Into the surface at 10 mm/s, 5 s before the beginning.
    touch = -5.0 - 0.002 / 0.01
    expected = AREA * stress_of_piecewise_linear_strain(
        [touch, -5.0], [0.0, 0.1], times[at_rest], MODEL
    )
    np.testing.assert_allclose(recording.force.value[at_rest], expected, rtol=2e-3)
    assert recording.truth["contacts"][0]["start_ns"] == pytest.approx(
        START_NS + touch * 1e9, abs=2e6
    )
    assert recording.force.value[-1] == 0.0
    assert recording.displacement.value[-1] == pytest.approx(-0.005)
