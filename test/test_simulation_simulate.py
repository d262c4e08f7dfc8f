# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings: what the sensors see, reproducibly, and the truth beside it."""

from __future__ import annotations

import hashlib
import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

from fden_ros.parameters import check
from fden_ros.simulation.model import FdenModel
from simulation.closed_form import stress_of_piecewise_linear_strain
from simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Tissue,
    load_scenario,
    ramp_scenario,
    scenario_names,
)
from simulation.simulate import START_NS, simulate

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
    assert np.all(np.diff(np.ravel(contact_times(truth))) > 0.0)
    assert check(truth["identifier_parameters"])
    # Time in the air tells sites from presses.
    for before, after in itertools.pairwise(contacts):
        air = (after["start_ns"] - before["end_ns"]) * 1e-9
        if after["site"] == before["site"]:
            assert air < 2.0
        elif recording.displacement.position is None:
            assert air > 3.0


def digest(recording):
    parts = [a.tobytes() for s in recording.streams for a in (s.stamp_ns, s.value)]
    return hashlib.sha256(b"".join(parts)).hexdigest()


def test_seed_decides_every_byte():
    scenario = load_scenario("pose_100hz")
    first, again, other = (simulate(scenario, seed=seed) for seed in (11, 11, 12))
    assert first.truth == again.truth and digest(first) == digest(again)
    assert other.truth["sites"] != first.truth["sites"] and digest(other) != digest(first)


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
