# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings: scenario files, what the sensors see, and disturbances of a rig."""

from __future__ import annotations

import copy
import itertools
import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from pipeline_helpers import refusal

from fden_ros.parameters import check
from fden_ros.simulation import FdenModel
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
    load_scenario,
    ramp_scenario,
    scenario_names,
    scenario_of_mapping,
)
from simulation.simulate import START_NS, simulate
from simulation.trajectory import Approach, Ramp, RampHold

# Scenario files: those that come along, and what is said about wrong ones


GOOD = {
    "name": "trial",
    "geometry": {"kind": "flat_punch", "area_m2": 1e-4, "thickness_m": 0.02},
    "sites": [
        {
            "tissue": {
                "linear_stiffness": 520,
                "nonlinear_stiffness": 8.5,
                "fractional_order": 0.131,
            },
            "position_m": [0.0, 0.01],
            "presses": [{"kind": "ramp", "strain_rate": 0.1, "max_strain": 0.3}],
        }
    ],
}


def changed(path, value):
    """GOOD with one value changed, or removed where it is None."""
    data = copy.deepcopy(GOOD)
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    if value is None:
        del inner[path[-1]]
    else:
        inner[path[-1]] = value
    return data


def test_every_disturbance_is_a_key_of_a_scenario_file_that_comes_along():
    text = (Path(__file__).parents[1] / "bags" / "robot_arm.yaml").read_text()
    for field in fields(Disturbances):
        assert f"  {field.name}:" in text
    assert load_scenario("robot_arm").disturbances.moves_tissue


def test_scenario_is_found_in_a_sourced_workspace(tmp_path, monkeypatch):
    folder = tmp_path / "share" / "fden_ros" / "bags"
    folder.mkdir(parents=True)
    (folder / "my_own.yaml").write_text(yaml.safe_dump(GOOD))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert "my_own" in scenario_names()
    assert load_scenario("my_own").name == "trial"


@pytest.mark.parametrize(
    "path, value, complaint",
    [
        (("sead",), 3, "key 'sead' is unknown; did you mean 'seed'"),
        (("sites", 0, "presses", 0, "kind"), "rmp", "did you mean 'ramp'"),
        (("sites", 0, "stiffening"), {"strain": 0.1, "ratio": 0.5}, "at least 1"),
        (("sites", 0, "presses", 0, "strain_rate"), "fast", "must be a finite number"),
        (("sites", 0, "position_m"), [1.0], "must have 2"),
        (("sites", 0, "tissue", "linear_stiffness"), None, "linear_stiffness is missing"),
        (("geometry", "kind"), "sphere", "sphere needs radius_m"),
        (("seed",), 1.5, "whole number"),
        (("force",), {"axis": [0.0, 0.0, 2.0]}, "unit vector"),
        (("force",), {"noise_n": 1.0, "noise_stress_pa": 1.0}, "give one of them"),
        (("approach",), {"slow_distance_m": 1.0}, "slow_distance_m"),
        (("disturbances",), {"hum_n": -1.0}, "hum_n is -1.0; it must be 0 or positive"),
    ],
)
def test_wrong_value_is_refused_in_one_line_that_says_what_is_right(path, value, complaint):
    assert complaint in refusal(scenario_of_mapping, changed(path, value))


@pytest.mark.parametrize(
    "text, complaint",
    [
        ("name: [1\n", "line 2: is not valid YAML"),
        ("- 1\n", "must be a mapping"),
    ],
)
def test_file_that_is_no_scenario_is_named_with_its_fault(tmp_path, text, complaint):
    path = tmp_path / "broken.yaml"
    path.write_text(text)
    line = refusal(load_scenario, path)
    assert complaint in line and str(path) in line


# Recordings: what the sensors see, reproducibly, and the truth beside it


LIVER = Tissue(linear_stiffness=520.0, nonlinear_stiffness=8.5, fractional_order=0.131)
AREA_M2 = np.pi * 0.01**2


def quiet_ramp(**changes):
    return replace(ramp_scenario(tissue=LIVER, noise_stress_pa=0.0), **changes)


def seconds(stream):
    return (stream.stamp_ns - START_NS) * 1e-9


def contact_times(recording):
    return [
        ((c["start_ns"] - START_NS) * 1e-9, (c["end_ns"] - START_NS) * 1e-9)
        for c in recording.truth["contacts"]
    ]


@pytest.mark.parametrize("name", scenario_names())
def test_scenario_that_comes_along_makes_sound_streams_and_truth(name):
    scenario = load_scenario(name)
    assert scenario.name == name and scenario.description
    recording = simulate(scenario)
    for stream in (recording.force, recording.displacement):
        assert stream.stamp_ns.dtype == np.int64
        assert np.all(np.diff(stream.stamp_ns) > 0)
        assert np.all(np.isfinite(stream.value))
        assert stream.value.shape == stream.stamp_ns.shape
    truth = json.loads(json.dumps(recording.truth))
    assert truth == recording.truth
    assert [site["site"] for site in truth["sites"]] == list(range(1, len(scenario.sites) + 1))
    contacts = truth["contacts"]
    assert [c["contact"] for c in contacts] == list(range(1, len(contacts) + 1))
    assert {c["site"] for c in contacts} == {s["site"] for s in truth["sites"]}
    assert np.all(np.diff(np.ravel(contact_times(recording))) > 0.0)
    assert check(truth["identifier_parameters"])
    # Time in the air tells sites from presses.
    for before, after in itertools.pairwise(contacts):
        air = (after["start_ns"] - before["end_ns"]) * 1e-9
        if after["site"] == before["site"]:
            assert air < 2.0
        elif recording.displacement.position is None:
            assert air > 3.0


def test_noise_bias_and_drift_have_the_stated_size():
    sensor = ForceSensor(noise_stress_pa=3.0, bias_n=0.05, drift_n_per_s=0.01)
    scenario = ramp_scenario(tissue=LIVER)
    displaced = DisplacementSensor(noise_m=2e-6)
    noisy = simulate(replace(scenario, force=sensor, displacement=displaced))
    clean = simulate(quiet_ramp())
    times = seconds(noisy.force)
    residual = noisy.force.value - clean.force.value - 0.05 - 0.01 * times
    count = times.size
    assert np.std(residual) == pytest.approx(3.0 * AREA_M2, rel=5.0 / np.sqrt(2.0 * count))
    assert abs(np.mean(residual)) < 5.0 * 3.0 * AREA_M2 / np.sqrt(count)
    assert abs(np.corrcoef(residual[1:], residual[:-1])[0, 1]) < 5.0 / np.sqrt(count)
    assert noisy.truth["force_noise_n"] == pytest.approx(3.0 * AREA_M2)
    moved = noisy.displacement.value - clean.displacement.value
    assert np.std(moved) == pytest.approx(2e-6, rel=5.0 / np.sqrt(2.0 * count))


# Disturbances of a rig: each does what it says, by closed form or by simple physics


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


def added(**disturbances):
    """Return times, what disturbances add to the force, and the only contact."""
    clean = recorded()
    disturbed = recorded(disturbances=Disturbances(**disturbances))
    return (
        seconds(clean.force),
        disturbed.force.value - clean.force.value,
        contact_times(clean)[0],
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
    np.testing.assert_allclose(contact_times(stepped), contact_times(exact), atol=2e-3)
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
    start, stop = contact_times(disturbed)[0]
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
