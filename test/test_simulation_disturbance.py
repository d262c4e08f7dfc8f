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

"""Disturbances of a rig: each does what it says, by closed form or by simple physics."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from fden_ros.errors import InputError
from fden_ros.simulation.closed_form import FdenModel, stress_of_piecewise_linear_strain
from fden_ros.simulation.disturbance import (
    Disturbances,
    Phases,
    SurfaceMotion,
    low_pass,
    quantised,
    with_backlash,
)
from fden_ros.simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Preload,
    Scenario,
    Site,
    Tissue,
    load_scenario,
    scenario_of_mapping,
)
from fden_ros.simulation.simulate import START_NS, simulate
from fden_ros.simulation.trajectory import Approach, Palpation, Ramp, RampHold

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


def test_by_default_nothing_is_disturbed():
    plain, zero = recorded(), recorded(disturbances=Disturbances(), preload=Preload(0.0))
    assert plain.force.value.tobytes() == zero.force.value.tobytes()
    assert plain.displacement.value.tobytes() == zero.displacement.value.tobytes()
    assert "disturbances" not in plain.truth and "preload" not in plain.truth


def test_steps_of_time_agree_with_the_closed_form():
    exact = recorded()
    # A dent after the press changes nothing in it, but the tissue is stepped.
    stepped = recorded(disturbances=Disturbances(plastic_set_m=1e-9))
    assert stepped.truth["disturbances"]["plastic_set_m"] == 1e-9
    peak = exact.force.value.max()
    np.testing.assert_allclose(stepped.force.value, exact.force.value, rtol=0, atol=2e-3 * peak)
    np.testing.assert_allclose(spans(stepped), spans(exact), atol=2e-3)
    assert stepped.displacement.value.tobytes() == exact.displacement.value.tobytes()


def test_every_disturbance_is_a_key_of_a_scenario_file():
    given = load_scenario("robot_arm")
    written = scenario_of_mapping(
        {
            "geometry": {"area_m2": 1e-4, "thickness_m": 0.02},
            "sites": [
                {
                    "tissue": {"draw": "liver"},
                    "presses": [{"kind": "ramp", "strain_rate": 1, "max_strain": 0.2}],
                }
            ],
            "disturbances": {"breathing": {"peak_to_peak_m": "1e-3"}, "vibration_at_rest": True},
            "preload": {"depth_m": 0.001},
        }
    )
    assert written.disturbances.breathing == SurfaceMotion(1e-3)
    assert written.disturbances.heartbeat.rate_hz == 1.2
    assert written.disturbances.vibration_at_rest is True
    assert written.preload == Preload(0.001, 10.0)
    text = (Path(__file__).parents[1] / "bags" / "robot_arm.yaml").read_text()
    assert given.disturbances.moves_tissue
    for field in fields(Disturbances):
        assert f"  {field.name}:" in text


@pytest.mark.parametrize(
    ("disturbances", "complaint"),
    [
        ({"hum": 1.0}, "did you mean 'hum_n'"),
        ({"hum_n": -1.0}, "hum_n is -1.0; it must be 0 or positive"),
        ({"creep_s": 0.0}, "creep_s is 0.0; it must be positive"),
        ({"vibration_at_rest": 1}, "must be true or false"),
        ({"breathing": {"rate_variation": 1.0}}, "must be below 1"),
        ({"heartbeat": {"rate_hz": 0.0}}, "rate_hz is 0.0; it must be positive"),
    ],
)
def test_wrong_disturbance_is_refused_in_a_line(disturbances, complaint):
    site = {
        "tissue": {"draw": "liver"},
        "presses": [{"kind": "ramp", "strain_rate": 0.1, "max_strain": 0.2}],
    }
    with pytest.raises(InputError) as refused:
        scenario_of_mapping(
            {
                "geometry": {"area_m2": 1e-4, "thickness_m": 0.02},
                "sites": [site],
                "disturbances": disturbances,
            }
        )
    assert complaint in str(refused.value) and "\n" not in str(refused.value)


def test_stiffening_does_not_go_with_a_disturbed_motion():
    site = {
        "tissue": {"draw": "liver"},
        "presses": [{"kind": "ramp", "strain_rate": 0.1, "max_strain": 0.2}],
        "stiffening": {"strain": 0.1, "ratio": 3.0},
    }
    data = {"geometry": {"area_m2": 1e-4, "thickness_m": 0.02}, "sites": [site]}
    scenario_of_mapping(data | {"disturbances": {"friction_n": 0.01}})
    with pytest.raises(InputError, match="a stiffening does not go with"):
        scenario_of_mapping(data | {"disturbances": {"backlash_m": 1e-4}})


# The motion


def test_breathing_changes_the_strain_and_not_the_reading():
    motion = SurfaceMotion(1e-3, 0.5, 0.3)
    disturbed = recorded(disturbances=Disturbances(breathing=motion))
    clean = recorded()
    assert disturbed.displacement.value.tobytes() == clean.displacement.value.tobytes()
    # The seed gives the phases; the law along the true strain gives the force.
    phases = Phases.draw(np.random.Generator(np.random.PCG64(np.random.SeedSequence([3, 3]))))
    times = seconds(disturbed.force)
    surface = Disturbances(breathing=motion).surface(times, phases)
    assert np.ptp(surface) == pytest.approx(1e-3, rel=0.02)
    depth = clean.displacement.value - surface
    start, stop = spans(disturbed)[0]
    inside = (times > start) & (times < stop)
    knots = np.concatenate([[start], times[inside]])
    strain = np.concatenate([[0.0], depth[inside] / THICKNESS])
    expected = exact_force(knots, strain)[1:]
    force = disturbed.force.value
    np.testing.assert_allclose(force[inside], expected, rtol=0, atol=5e-3 * force.max())
    assert np.abs(force - clean.force.value).max() > 0.1 * clean.force.value.max()


def test_rate_of_breathing_varies_slowly_by_the_stated_share():
    times = np.linspace(0.0, 200.0, 200_001)
    height = SurfaceMotion(2e-3, 0.5, 0.2).height(times, 0.0, 0.0)
    upward = times[1:][(height[:-1] < 0.0) & (height[1:] >= 0.0)]
    rates = 1.0 / np.diff(upward)
    assert rates.max() == pytest.approx(0.6, rel=0.02)
    assert rates.min() == pytest.approx(0.4, rel=0.03)
    assert upward.size == pytest.approx(100, abs=1)


def test_tool_gives_way_by_compliance_times_the_true_force():
    compliance = 1e-3
    disturbed = recorded(disturbances=Disturbances(compliance_m_per_n=compliance))
    clean = recorded()
    assert disturbed.displacement.value.tobytes() == clean.displacement.value.tobytes()
    times, force = seconds(disturbed.force), disturbed.force.value
    start, stop = spans(disturbed)[0]
    inside = (times > start) & (times < stop)
    depth = disturbed.displacement.value - compliance * force
    knots = np.concatenate([[start], times[inside]])
    strain = np.concatenate([[0.0], depth[inside] / THICKNESS])
    # The force is what the law gives for the strain that this very force leaves.
    np.testing.assert_allclose(
        exact_force(knots, strain)[1:], force[inside], rtol=0, atol=5e-3 * force.max()
    )
    assert force.max() < 0.9 * clean.force.value.max()


def test_drive_with_play_follows_late_on_every_reversal():
    places = np.array([0.0, 1.0, 2.0, 1.8, 1.4, 1.0, 1.2, 1.4, 1.6, 2.0])
    expected = [0.0, 1.0, 2.0, 2.0, 1.9, 1.5, 1.5, 1.5, 1.6, 2.0]
    np.testing.assert_allclose(with_backlash(places, 0.5), expected)
    assert with_backlash(places, 0.0) is places


def test_play_keeps_the_tip_in_the_tissue_when_the_probe_turns():
    play = 5e-4
    ramp = Ramp(0.2, 0.25, 0.4)
    clean, disturbed = recorded(ramp), recorded(ramp, disturbances=Disturbances(backlash_m=play))
    times = seconds(clean.force)
    turn = spans(clean)[0][0] + 1.25
    after = (times > turn) & (times < turn + play / (0.4 * THICKNESS))
    # The tip rests, so the force only relaxes while the clean probe lets go.
    loss = -np.diff(disturbed.force.value[after])
    assert np.all(loss > 0.0) and loss.sum() < 0.3 * -np.diff(clean.force.value[after]).sum()
    before = times < turn - 0.01
    np.testing.assert_allclose(
        disturbed.force.value[before], clean.force.value[before], rtol=0, atol=2e-3
    )


def test_each_press_leaves_the_surface_lower():
    palpation = Palpation(0.2, 0.25, 0.2, 0.4, presses=3, lift_m=0.003, pause_s=1.5)
    # All but elastic: nothing else is left of a press.
    sites = (Site(Tissue(4000.0, 8.0, 1e-3), (palpation,)),)
    clean = recorded(sites=sites)
    disturbed = recorded(sites=sites, disturbances=Disturbances(plastic_set_m=2e-4))
    late = [b[0] - a[0] for a, b in zip(spans(clean), spans(disturbed), strict=True)]
    # At 4 mm/s the second touch is 50 ms later, the third 100 ms.
    np.testing.assert_allclose(late, [0.0, 0.05, 0.10], atol=4e-3)


# The force


def test_friction_is_against_the_motion_and_only_in_contact():
    times, error, (start, stop) = added(friction_n=0.02)
    inward = (times > start + 0.01) & (times < start + 1.24)
    held = (times > start + 1.26) & (times < start + 2.24)
    outward = (times > start + 2.26) & (times < stop - 0.01)
    np.testing.assert_allclose(error[inward], 0.02, atol=1e-12)
    np.testing.assert_allclose(error[held], 0.0, atol=1e-12)
    np.testing.assert_allclose(error[outward], -0.02, atol=1e-12)
    np.testing.assert_allclose(error[(times < start) | (times > stop)], 0.0, atol=1e-12)


def test_force_creeps_in_contact_and_back_in_the_air():
    times, error, (start, stop) = added(creep_n=0.03, creep_s=0.7)
    rising = 0.03 * (1.0 - np.exp(-np.maximum(times - start, 0.0) / 0.7))
    reached = 0.03 * (1.0 - np.exp(-(stop - start) / 0.7))
    falling = reached * np.exp(-(times - stop) / 0.7)
    expected = np.where(times < stop, rising, falling)
    np.testing.assert_allclose(error, expected, atol=1e-7)


def test_thermal_error_settles_from_the_beginning():
    times, error, _ = added(thermal_n=-0.05, thermal_s=2.0)
    np.testing.assert_allclose(error, -0.05 * np.exp(-times / 2.0), atol=1e-12)


def test_hum_is_a_sine_of_the_stated_amplitude_and_frequency():
    times, error, _ = added(hum_n=0.02, hum_hz=50.0)
    design = np.column_stack([f(2.0 * np.pi * 50.0 * times) for f in (np.sin, np.cos)])
    found, *_ = np.linalg.lstsq(design, error, rcond=None)
    assert np.hypot(*found) == pytest.approx(0.02, rel=1e-9)
    np.testing.assert_allclose(design @ found, error, atol=1e-12)


@pytest.mark.parametrize("always", [False, True])
def test_arm_vibrates_while_it_moves_or_always(always):
    times, error, (start, _) = added(vibration_n=0.05, vibration_hz=12.0, vibration_at_rest=always)
    for span in ((0.0, 0.49), (start + 1.26, start + 2.24)):
        still = (times > span[0]) & (times < span[1])
        amplitude = np.abs(error[still]).max()
        assert amplitude == pytest.approx(0.05, rel=0.02) if always else amplitude == 0.0
    moving = (times > start) & (times < start + 1.2)
    assert np.abs(error[moving]).max() == pytest.approx(0.05, rel=0.02)


def test_filter_delays_a_ramp_by_its_time_constant_and_damps_a_sine():
    times = np.sort(np.random.default_rng(0).uniform(0.0, 4.0, 3000))
    constant = 1.0 / (2.0 * np.pi * 5.0)
    start = times - times[0]
    np.testing.assert_allclose(
        low_pass(times, start, 5.0),
        start - constant * (1.0 - np.exp(-start / constant)),
        atol=1e-12,
    )
    even = np.arange(4000) * 1e-3
    sine = low_pass(even, np.sin(2.0 * np.pi * 5.0 * even), 5.0)
    assert np.abs(sine[2000:]).max() == pytest.approx(np.sqrt(0.5), rel=1e-3)
    assert low_pass(times, start, 0.0) is start


def test_filter_takes_the_noise_as_well():
    noisy = replace(scenario(), force=ForceSensor(rate_hz=500.0, noise_n=0.01))
    filtered = replace(noisy, disturbances=Disturbances(filter_hz=30.0))
    still = slice(50, 250)
    raw, smooth = (simulate(s).force.value[still] for s in (noisy, filtered))
    decay = np.exp(-2.0 * np.pi * 30.0 / 500.0)
    assert np.std(raw) == pytest.approx(0.01, rel=0.2)
    assert np.std(smooth) < 0.7 * np.std(raw)
    assert np.corrcoef(smooth[1:], smooth[:-1])[0, 1] == pytest.approx(decay, abs=0.2)


# The readings


def test_readings_come_in_steps():
    disturbed = recorded(disturbances=Disturbances(force_step_n=0.01, displacement_step_m=5e-5))
    clean = recorded()
    for stream, exact, step in (
        (disturbed.force, clean.force, 0.01),
        (disturbed.displacement, clean.displacement, 5e-5),
    ):
        steps = stream.value / step
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
        assert np.abs(stream.value - exact.value).max() <= 0.5 * step + 1e-12
    values = np.linspace(0.0, 1.0, 7)
    assert quantised(values, 0.0) is values


def test_positions_come_in_steps_too():
    sensor = DisplacementSensor(rate_hz=500.0, message="point", noise_m=1e-5)
    stream = recorded(
        displacement=sensor, disturbances=Disturbances(displacement_step_m=5e-5)
    ).displacement
    steps = stream.position / 5e-5
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    np.testing.assert_allclose(stream.position @ np.array(stream.axis), stream.value)


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


def test_preloaded_probe_leaves_only_after_its_last_press():
    press = Ramp(0.2, 0.25, 0.4)
    given = scenario(press, preload=Preload(0.002))
    (site,) = given.sites
    both = simulate(replace(given, sites=(replace(site, presses=(press, press)), site)))
    reading = both.displacement.value
    first_out = int(np.argmax(reading < 0.0019))
    peaks = (reading[1:-1] > reading[:-2]) & (reading[1:-1] >= reading[2:])
    turns = np.flatnonzero(peaks & (reading[1:-1] > 0.0045))
    assert np.sum(turns < first_out) == 2
    assert np.sum(turns > first_out) == 1
    assert reading[:first_out].min() >= 0.0019
