# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Simulated tissue and recordings: exact, stepped, of other laws, of a disturbed rig, live."""

from __future__ import annotations

import copy
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from live_helpers import Ears, node_process
from pipeline_helpers import refusal
from scipy.integrate import quad
from scipy.special import gamma
from sensor_msgs.msg import JointState

from benchmark.trial import elapsed, presses_of
from fden_ros.simulation import Column, FdenModel
from fden_ros.simulation import Tissue as SteppedTissue
from simulation.closed_form import moves_of_knots, stress_of_piecewise_linear_strain
from simulation.contact import contacts_of_moves
from simulation.disturbance import Disturbances, Phases, SurfaceMotion
from simulation.scenario import (
    DisplacementSensor,
    ForceSensor,
    Geometry,
    Scenario,
    Site,
    Tissue,
    scenario_of_mapping,
)
from simulation.simulate import simulate
from simulation.trajectory import Approach, RampHold


def reference_stress(knot_times, knot_strains, time, model):
    """The closed form by adaptive quadrature over (time - s)^(1 - alpha), piece by piece."""
    gn, power, parts = model.nonlinear_stiffness, 1.0 - model.fractional_order, []
    for (t0, x0), (t1, x1) in itertools.pairwise(zip(knot_times, knot_strains, strict=True)):
        rate = (x1 - x0) / (t1 - t0) or 1e-300

        def slope(v, t0=t0, x0=x0, rate=rate):
            strain = x0 + rate * (time - v ** (1.0 / power) - t0)
            return rate * np.exp(max(gn * abs(strain) - 1.0, 0.0))

        bends = (t0 + (level - x0) / rate for level in (-1.0 / gn, 0.0, 1.0 / gn))
        edges = sorted([t0, t1, *(t for t in bends if t0 < t < t1)])
        for start, stop in itertools.pairwise(np.maximum(time - edges, 0.0) ** power):
            parts.append(quad(slope, stop, start, epsabs=0.0, epsrel=1e-13, limit=200)[0])
    return model.linear_stiffness * math.fsum(parts) / gamma(power + 1.0)


def random_motion(generator):
    count = generator.integers(2, 7)
    knot_times = np.cumsum(np.r_[0.0, 10.0 ** generator.uniform(-1.0, 1.0, count)])
    knot_strains = np.r_[0.0, generator.uniform(-0.4, 0.4, count)]
    if count > 3:
        knot_strains[2] = knot_strains[1]
    return knot_times, knot_strains


@pytest.mark.parametrize("seed", range(12))
def test_stress_is_exact_under_random_piecewise_linear_strain(seed):
    generator = np.random.default_rng(seed)
    model = FdenModel(520.0, generator.uniform(4.0, 14.0), generator.uniform(0.02, 0.6))
    knot_times, knot_strains = random_motion(generator)
    first, last = knot_times[1], knot_times[-1] - knot_times[-2]
    times = np.r_[
        generator.uniform(0.0, 1.2 * knot_times[-1], 4),
        first * np.array([1.0, 1.0 + 1e-9, 1.149]),
        knot_times[-1] + last * np.array([0.0, 0.151, 0.99, 1.01]),
    ]
    dense = np.linspace(0.0, knot_times[-1], 2000)
    peak = np.abs(stress_of_piecewise_linear_strain(knot_times, knot_strains, dense, model)).max()

    stress = stress_of_piecewise_linear_strain(knot_times, knot_strains, times, model)
    exact = [reference_stress(knot_times, knot_strains, t, model) for t in times]
    assert np.abs(stress - exact).max() <= 1e-12 * peak


LIVER = FdenModel(544.8, 8.547, 0.131)
STEP = 1e-3
#: Of the peak; the promise.
TOLERANCE = 1e-4


@pytest.mark.parametrize("model", [LIVER, FdenModel(500.0, 8.0, 0.32)])
@pytest.mark.parametrize(
    ("times", "strains"),
    [
        ([0.0, 0.3, 1.3], [0.0, 0.3, 0.3]),
        ([0.0, 0.2, 1.0, 2.0, 4.0, 4.5, 6.0], [-0.01, -0.01, 0.24, 0.24, -0.06, 0.19, 0.24]),
    ],
    ids=["ramp and hold", "release and second touch"],
)
def test_stepping_follows_the_closed_form(model, times, strains):
    instants = np.arange(1, int(times[-1] / STEP)) * STEP
    exact = contacts_of_moves(moves_of_knots(times, strains), model).stress(instants)
    tissue = SteppedTissue([Column(model)], STEP)
    stepped = [tissue.press(x) for x in np.interp(instants, times, strains)]
    assert np.abs(stepped - exact).max() <= TOLERANCE * exact.max()


def test_the_node_publishes_as_a_driver_does_and_takes_commands():
    with Ears() as ears:
        forces = ears.hear(WrenchStamped, "/force")
        poses = ears.hear(PoseStamped, "/displacement")
        command = ears.node.create_publisher(JointState, "/command", 10)
        with node_process("tissue_simulator", {"force.bias": 0.02}) as simulator:
            ears.wait_for(lambda: len(forces) > 200 and len(poses) > 100, "samples")
            air = [message.wrench.force.z for message in forces[:200]]
            assert np.mean(air) == pytest.approx(0.02, abs=5e-4)
            ears.wait_for(command.get_subscription_count, "the simulator's subscription")
            command.publish(JointState(name=["z"], position=[0.004]))
            ears.wait_for(lambda: poses[-1].pose.position.z > 0.0039, "the commanded depth")
            ears.wait_for(lambda: forces[-1].wrench.force.z > 0.05, "the force there")
            command.publish(JointState(name=["x"], position=[0.01]))
            ears.wait_for(lambda: poses[-1].pose.position.x > 0.0099, "the commanded place")
            command.publish(JointState(name=["z"], position=[0.0], velocity=[0.0]))
            command.publish(JointState(name=["z"], effort=[0.02]))
            ears.wait_for(
                lambda: abs(np.mean([m.wrench.force.z for m in forces[-50:]]) - 0.04) < 5e-3,
                "the commanded force",
            )
        assert simulator.returncode == 0
        assert "fill exactly one" in simulator.output


TISSUE = {"linear_stiffness": 520, "nonlinear_stiffness": 8.5, "fractional_order": 0.131}
FACE = {"kind": "flat_punch", "area_m2": 1e-4, "thickness_m": 0.02}
PRESS = {"kind": "ramp", "strain_rate": 0.1, "max_strain": 0.3}


def changed(path, value):
    """A good scenario with one value changed, or removed where it is None."""
    good = inner = copy.deepcopy(
        {"geometry": FACE, "sites": [{"tissue": TISSUE, "presses": [PRESS]}]}
    )
    for key in path[:-1]:
        inner = inner[key]
    if value is None:
        del inner[path[-1]]
    else:
        inner[path[-1]] = value
    return good


@pytest.mark.parametrize(
    "path, value, complaint",
    [
        (("sead",), 3, "key 'sead' is unknown; did you mean 'seed'"),
        (("sites", 0, "presses", 0, "kind"), "rmp", "did you mean 'ramp'"),
        (("sites", 0, "tissue", "linear_stiffness"), None, "linear_stiffness is missing"),
        (("force",), {"axis": [0.0, 0.0, 2.0]}, "unit vector"),
        (("disturbances",), {"hum_n": -1.0}, "hum_n is -1.0; it must be 0 or positive"),
    ],
)
def test_wrong_value_is_refused_in_one_line_that_says_what_is_right(path, value, complaint):
    assert complaint in refusal(scenario_of_mapping, changed(path, value))


AREA = np.pi * 0.01**2


MODEL = FdenModel(4000.0, 8.0, 0.2)
THICKNESS = 0.02


def recorded(**changes):
    """Return a press and hold without noise at 500 Hz, disturbed or not."""
    tissue = Tissue(MODEL.linear_stiffness, MODEL.nonlinear_stiffness, MODEL.fractional_order)
    given = Scenario(
        geometry=Geometry("flat_punch", radius_m=0.01, thickness_m=THICKNESS),
        sites=(Site(tissue, (RampHold(0.2, 0.25, 1.0, 0.4),)),),
        approach=Approach(0.005, 0.01, 0.002, start_pause_s=0.5),
        force=ForceSensor(rate_hz=500.0),
        displacement=DisplacementSensor(rate_hz=500.0),
        seed=3,
    )
    return simulate(replace(given, **changes))


@pytest.mark.parametrize("kind", ["breathing", "compliance"])
def test_disturbed_motion_changes_the_strain_and_not_the_reading(kind):
    motion = SurfaceMotion(1e-3, 0.5, 0.3)
    given = {
        "breathing": Disturbances(breathing=motion),
        "compliance": Disturbances(compliance_m_per_n=1e-3),
    }[kind]
    disturbed, clean = recorded(disturbances=given), recorded()
    assert disturbed.displacement.value.tobytes() == clean.displacement.value.tobytes()
    times, force = elapsed(disturbed.force.stamp_ns), disturbed.force.value
    # The seed gives the phases. The force is what the law gives for the strain that the surface,
    # or this very force, leaves.
    phases = Phases.draw(np.random.Generator(np.random.PCG64(np.random.SeedSequence([3, 3]))))
    lost = given.surface(times, phases) + given.compliance_m_per_n * force
    start, stop = presses_of(disturbed)[0]
    inside = (times > start) & (times < stop)
    knots = np.append(start, times[inside])
    strains = np.append(0.0, (clean.displacement.value - lost)[inside]) / THICKNESS
    expected = AREA * stress_of_piecewise_linear_strain(knots, strains, knots, MODEL)[1:]
    np.testing.assert_allclose(force[inside], expected, rtol=0, atol=5e-3 * force.max())
    assert np.abs(force - clean.force.value).max() > 0.1 * clean.force.value.max()
    if kind == "breathing":
        assert np.ptp(lost) == pytest.approx(1e-3, rel=0.02)


def test_friction_pushes_against_the_motion_and_ends_with_the_contact():
    clean, disturbed = recorded(), recorded(disturbances=Disturbances(friction_n=0.02))
    times, (start, stop) = elapsed(clean.force.stamp_ns), presses_of(clean)[0]
    inward, outward = (times > start) & (times < start + 1.25), times > start + 2.25
    expected = 0.02 * ((times < stop) * (1.0 * inward - outward))
    edges = np.array([start, start + 1.25, start + 2.25, stop])
    away = np.all(np.abs(times[:, None] - edges) > 0.01, axis=1)
    error = disturbed.force.value - clean.force.value
    np.testing.assert_allclose(error[away], expected[away], atol=1e-7)
