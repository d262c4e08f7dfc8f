# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Recordings: what the sensors see, reproducibly, and the truth beside it."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

from fden_ros.parameters import check
from fden_ros.simulation.closed_form import FdenModel, stress_of_piecewise_linear_strain
from fden_ros.simulation.scenario import (
    DisplacementSensor,
    Dropout,
    ForceSensor,
    Geometry,
    Tissue,
    load_scenario,
    ramp_scenario,
    scenario_names,
)
from fden_ros.simulation.simulate import START_NS, simulate

LIVER = Tissue(linear_stiffness=520.0, nonlinear_stiffness=8.5, fractional_order=0.131)
AREA_M2 = np.pi * 0.01**2


def quiet_ramp(**changes):
    return replace(ramp_scenario(tissue=LIVER, noise_stress_pa=0.0), **changes)


def seconds(stream):
    return (stream.stamp_ns - START_NS) * 1e-9


def contact_times(truth):
    return [
        ((c["start_ns"] - START_NS) * 1e-9, (c["end_ns"] - START_NS) * 1e-9)
        for c in truth["contacts"]
    ]


@pytest.mark.parametrize("name", scenario_names())
def test_scenario_that_comes_along_makes_sound_streams_and_truth(name):
    scenario = load_scenario(name)
    recording = simulate(scenario)
    for stream in (recording.force, recording.displacement):
        assert stream.stamp_ns.dtype == np.int64
        assert np.all(np.diff(stream.stamp_ns) > 0)
        assert np.all(np.isfinite(stream.value))
        assert stream.value.shape == stream.stamp_ns.shape
    truth = json.loads(json.dumps(recording.truth))
    assert truth == recording.truth
    assert [site["site"] for site in truth["sites"]] == list(range(1, len(scenario.sites) + 1))
    assert [c["contact"] for c in truth["contacts"]] == list(range(1, len(truth["contacts"]) + 1))
    assert {c["site"] for c in truth["contacts"]} == {s["site"] for s in truth["sites"]}
    edges = np.ravel(contact_times(truth))
    assert np.all(np.diff(edges) > 0.0)
    assert check(truth["identifier_parameters"])


@pytest.mark.parametrize("name", scenario_names())
def test_time_in_the_air_tells_sites_from_presses(name):
    scenario = load_scenario(name)
    recording = simulate(scenario)
    contacts = recording.truth["contacts"]
    for before, after in itertools.pairwise(contacts):
        air = (after["start_ns"] - before["end_ns"]) * 1e-9
        if after["site"] == before["site"]:
            assert air < 2.0
        elif recording.displacement.position is None:
            assert air > 3.0


def test_same_scenario_and_seed_give_the_same_bytes():
    scenario = load_scenario("pose_100hz")
    first, again = simulate(scenario, seed=11), simulate(scenario, seed=11)
    assert first.truth == again.truth
    for one, other in ((first.force, again.force), (first.displacement, again.displacement)):
        assert one.stamp_ns.tobytes() == other.stamp_ns.tobytes()
        assert one.value.tobytes() == other.value.tobytes()
    assert first.displacement.position.tobytes() == again.displacement.position.tobytes()


def test_another_seed_gives_another_tissue_and_other_noise():
    scenario = load_scenario("ramp")
    one, other = simulate(scenario, seed=1), simulate(scenario, seed=2)
    assert one.truth["sites"] != other.truth["sites"]
    assert one.force.value[0] != other.force.value[0]


def test_force_noise_does_not_depend_on_the_displacement_sensor():
    scenario = ramp_scenario(tissue=LIVER)
    slower = replace(scenario, displacement=DisplacementSensor(rate_hz=50.0, noise_m=1e-5))
    assert simulate(scenario).force.value.tobytes() == simulate(slower).force.value.tobytes()


def test_force_is_the_exact_stress_times_the_area():
    recording = simulate(quiet_ramp())
    times = seconds(recording.force)
    ((start, stop),) = contact_times(recording.truth)
    loading = (times > start) & (times < start + 3.0)
    stress = stress_of_piecewise_linear_strain(
        [0.0, 3.0], [0.0, 0.3], times[loading] - start, FdenModel(520.0, 8.5, 0.131)
    )
    np.testing.assert_allclose(recording.force.value[loading], stress * AREA_M2, rtol=1e-9)
    assert np.all(recording.force.value[(times < start) | (times > stop)] == 0.0)
    assert np.all(recording.force.value[(times > start) & (times < stop)] > 0.0)


def test_displacement_comes_from_the_air_and_reads_the_surface_at_the_touch():
    scenario = quiet_ramp(displacement=DisplacementSensor(surface_m=0.123))
    recording = simulate(scenario)
    times = seconds(recording.displacement)
    ((start, _),) = contact_times(recording.truth)
    reading = recording.displacement.value
    assert reading[0] == pytest.approx(0.123 - 0.01)
    assert np.interp(start, times, reading) == pytest.approx(0.123, abs=1e-8)
    assert np.interp(start + 1.0, times, reading) == pytest.approx(0.123 + 0.1 * 0.02, abs=1e-8)
    assert recording.truth["surface_displacement_m"] == 0.123
    assert reading.max() == pytest.approx(0.123 + 0.3 * 0.02, abs=1e-6)


def test_nothing_changes_in_the_motion_at_the_touch():
    recording = simulate(quiet_ramp())
    times = seconds(recording.displacement)
    ((start, _),) = contact_times(recording.truth)
    around = np.abs(times - start) < 0.2
    speed = np.diff(recording.displacement.value[around]) / np.diff(times[around])
    np.testing.assert_allclose(speed, 0.1 * 0.02, rtol=1e-6)


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


@pytest.mark.parametrize("jitter_s", [1e-5, 2e-4, 1.0])
def test_jitter_moves_the_samples_with_their_stamps_and_keeps_them_in_order(jitter_s):
    scenario = quiet_ramp(
        force=ForceSensor(jitter_s=jitter_s), displacement=DisplacementSensor(jitter_s=jitter_s)
    )
    recording = simulate(scenario)
    clean = simulate(quiet_ramp())
    assert np.diff(recording.force.stamp_ns).min() > 0
    assert np.std(np.diff(recording.force.stamp_ns)) > 1e9 * min(jitter_s, 2e-4)
    on_clock = np.interp(
        seconds(recording.displacement), seconds(clean.displacement), clean.displacement.value
    )
    np.testing.assert_allclose(recording.displacement.value, on_clock, rtol=0.0, atol=1e-5)
    ((start, _),) = contact_times(clean.truth)
    times = seconds(recording.force)
    loading = (times > start) & (times < start + 3.0)
    exact = stress_of_piecewise_linear_strain(
        [0.0, 3.0], [0.0, 0.3], times[loading] - start, FdenModel(520.0, 8.5, 0.131)
    )
    np.testing.assert_allclose(recording.force.value[loading], exact * AREA_M2, rtol=1e-9)


def test_delay_stamps_the_displacement_late():
    late = simulate(quiet_ramp(displacement=DisplacementSensor(delay_s=0.02)))
    prompt = simulate(quiet_ramp())
    assert np.all(late.displacement.stamp_ns - prompt.displacement.stamp_ns == 20_000_000)
    np.testing.assert_array_equal(late.displacement.value, prompt.displacement.value)
    assert late.truth["identifier_parameters"]["displacement.delay"] == 0.02


def test_dropouts_are_where_they_are_said_to_be():
    dropouts = (Dropout("displacement", 3.0, 0.1), Dropout("both", 4.0, 0.25))
    recording = simulate(quiet_ramp(dropouts=dropouts))
    whole = simulate(quiet_ramp())
    force, moved = seconds(recording.force), seconds(recording.displacement)
    assert not np.any((moved >= 3.0) & (moved < 3.1))
    assert np.any((force >= 3.0) & (force < 3.1))
    for times in (force, moved):
        assert not np.any((times >= 4.0) & (times < 4.25))
    assert whole.force.stamp_ns.size - force.size == 250
    assert whole.displacement.stamp_ns.size - moved.size == 350
    kept = np.isin(whole.force.stamp_ns, recording.force.stamp_ns)
    np.testing.assert_array_equal(whole.force.value[kept], recording.force.value)


def test_poses_move_sideways_between_sites_only_while_in_the_air():
    scenario = load_scenario("pose_100hz")
    recording = simulate(scenario)
    stream = recording.displacement
    np.testing.assert_allclose(stream.position @ np.array(stream.axis), stream.value, atol=1e-15)
    times = seconds(stream)
    for site, (start, stop) in zip(scenario.sites, contact_times(recording.truth), strict=True):
        during = (times >= start - 0.5) & (times <= stop)
        across = stream.position[during, :2]
        np.testing.assert_allclose(across - site.position_m, 0.0, atol=2e-5)
    assert np.ptp(stream.position[:, 0]) > 0.01


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, -0.6, 0.8)])
def test_tip_follows_the_approach_axis(axis):
    sensor = DisplacementSensor(message="point", axis=axis, surface_m=0.2)
    stream = simulate(quiet_ramp(displacement=sensor)).displacement
    np.testing.assert_allclose(stream.position, np.outer(stream.value, axis), atol=1e-15)


def test_sphere_follows_hertz_where_the_tissue_is_linear():
    radius = 0.005
    soft = Tissue(linear_stiffness=520.0, nonlinear_stiffness=4.0, fractional_order=1e-6)
    scenario = replace(
        ramp_scenario(tissue=soft, max_strain=0.2, noise_stress_pa=0.0),
        geometry=Geometry("sphere", radius_m=radius),
    )
    recording = simulate(scenario)
    depth = np.maximum(recording.displacement.value, 0.0)
    hertz = 4.0 / 3.0 * 520.0 * np.sqrt(radius) * depth**1.5
    peak = hertz.max()
    np.testing.assert_allclose(recording.force.value, hertz, rtol=0.0, atol=1e-4 * peak)


def test_pass_through_streams_are_stress_and_strain():
    scenario = quiet_ramp(geometry=Geometry("pass_through"))
    recording = simulate(scenario)
    flat = simulate(quiet_ramp())
    assert recording.displacement.value.max() == pytest.approx(0.3, abs=1e-3)
    assert recording.force.value.max() == pytest.approx(flat.force.value.max() / AREA_M2, rel=1e-3)
