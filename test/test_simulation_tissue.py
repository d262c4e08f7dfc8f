# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Simulated tissue: exact, stepped, of other laws, and in a node."""

from __future__ import annotations

import itertools
from itertools import pairwise

import mpmath
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from live_helpers import Ears, node_process
from property_helpers import first
from scipy.special import gamma
from sensor_msgs.msg import JointState

from benchmark.other_laws import (
    Law,
    Relaxation,
    poroelastic,
    quasi_linear,
    standard_linear_solid,
    stress_of_law,
)
from fden_ros.inputs import stamp_ns
from fden_ros.simulation import Column, FdenModel, Inclusion, Tissue
from simulation.closed_form import moves_of_knots, stress_of_piecewise_linear_strain
from simulation.contact import Stiffening, contacts_of_moves
from simulation.trajectory import Approach, Path, RampHold

# The exact stress against arbitrary precision, known limits and another quadrature


DIGITS = 30


def kernel_integral(lam, tau, order):
    """M(tau): the response to a rate exp(lam s) that began tau ago."""
    if tau <= 0:
        return mpmath.mpf(0)
    power = 1 - order
    return tau**power / mpmath.gamma(power + 1) * mpmath.hyp1f1(1, power + 1, lam * tau)


def reference_stress(knot_times, knot_strains, time, model):
    """The closed form by Kummer's function, with digits to spare for its cancellation."""
    stiffness, nonlinear, order, time = map(
        mpmath.mpf,
        (model.linear_stiffness, model.nonlinear_stiffness, model.fractional_order, float(time)),
    )
    total = mpmath.mpf(0)
    knots = [
        (mpmath.mpf(float(t)), mpmath.mpf(float(x)))
        for t, x in zip(knot_times, knot_strains, strict=True)
    ]
    for (t0, x0), (t1, x1) in itertools.pairwise(knots):
        rate = (x1 - x0) / (t1 - t0)
        if rate == 0:
            continue
        crossings = [t0 + (level - x0) / rate for level in (-1 / nonlinear, 0, 1 / nonlinear)]
        edges = sorted([t0, t1, *(t for t in crossings if t0 < t < t1)])
        for start, stop in itertools.pairwise(edges):
            if time <= start:
                continue
            middle = x0 + rate * ((start + stop) / 2 - t0)
            amplitude, lam = stiffness * rate, mpmath.mpf(0)
            if abs(middle) > 1 / nonlinear:
                amplitude *= mpmath.exp(nonlinear * abs(x0 + rate * (start - t0)) - 1)
                lam = mpmath.sign(middle) * nonlinear * rate
            with mpmath.workdps(DIGITS + 10 + int(abs(lam) * (time - start) / 2)):
                part = kernel_integral(lam, time - start, order)
                growth = mpmath.exp(lam * (stop - start))
                part -= growth * kernel_integral(lam, time - stop, order)
            total += amplitude * part
    return total


def random_motion(generator):
    count = generator.integers(2, 7)
    knot_times = np.cumsum(np.r_[0.0, 10.0 ** generator.uniform(-1.0, 1.0, count)])
    knot_strains = np.r_[0.0, generator.uniform(-0.4, 0.4, count)]
    if count > 3:
        knot_strains[2] = knot_strains[1]
    return knot_times, knot_strains


@pytest.mark.parametrize("seed", first(*range(12)))
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

    with mpmath.workdps(DIGITS):
        exact = [reference_stress(knot_times, knot_strains, t, model) for t in times]
        error = max(
            abs(float(f - mpmath.mpf(float(g)))) for f, g in zip(exact, stress, strict=True)
        )
    assert error <= 1e-12 * peak


# Contact that cannot pull: its free surface, and against time stepping on a fine grid


def moves_over_fresh_tissue(trajectory):
    path = Path(strain=-0.1, length_m=0.02)
    path.rest(0.1)
    trajectory.press(path, Approach(distance_m=0.002, slow_distance_m=0.001))
    path.rest(0.2)
    return path.moves


def strain_at(moves, times):
    strain = np.empty_like(times)
    for move in moves:
        during = (times >= move.start) & (times <= move.stop)
        strain[during] = move.strain_at(times[during])
    return strain


@pytest.mark.parametrize("ratio", [1.5, 4.0])
def test_stress_in_a_stiffer_tissue_on_the_way_agrees_with_time_stepping(ratio):
    model = FdenModel(520.0, 8.5, 0.131)
    moves = moves_over_fresh_tissue(RampHold(strain_rate=0.2, max_strain=0.25, hold_s=0.5))
    step = 2.5e-4
    times = np.arange(0.0, moves[-1].stop, step)
    strain = strain_at(moves, times)
    met = times[int(np.argmax(strain >= 0.14))]
    weights = np.diff(np.arange(times.size + 1.0) ** (1.0 - 0.131))
    weights *= step**-0.131 / gamma(2.0 - 0.131)
    phi = np.maximum(model.phi(strain), 0.0) * np.where(times >= met, ratio, 1.0)
    stepped = np.convolve(np.diff(phi, prepend=0.0), weights)[: times.size]
    history = contacts_of_moves(moves, model, Stiffening(0.14, ratio))
    (contact,) = history.contacts
    # Just after the step the stress itself is singular, and stepping is none.
    pressed = (times < contact.stop - 0.01) & (np.abs(times - met - 0.01) > 0.011)
    error = (history.stress(times) - stepped)[pressed]
    assert np.abs(error).max() < 2e-3 * stepped.max()


# The stepped tissue, the rig, and the simulator node in its own process


LIVER = FdenModel(544.8, 8.547, 0.131)
STEP = 1e-3
#: Of the peak; the promise.
TOLERANCE = 1e-4


@pytest.mark.parametrize(
    "model",
    [
        FdenModel(341.8, 5.26, 0.118),
        LIVER,
        FdenModel(1294.0, 13.18, 0.146),
        FdenModel(500.0, 8.0, 0.32),
    ],
)
@pytest.mark.parametrize(
    ("times", "strains"),
    [
        ([0.0, 3.0, 8.0], [0.0, 0.3, 0.3]),
        ([0.0, 0.3, 1.3], [0.0, 0.3, 0.3]),
        ([0.0, 0.2, 1.0, 2.0, 4.0, 4.5, 6.0], [-0.01, -0.01, 0.24, 0.24, -0.06, 0.19, 0.24]),
    ],
    ids=["slow ramp and hold", "fast ramp and hold", "release and second touch"],
)
def test_stepping_follows_the_closed_form(model, times, strains):
    instants = np.arange(1, int(times[-1] / STEP)) * STEP
    exact = contacts_of_moves(moves_of_knots(times, strains), model).stress(instants)
    tissue = Tissue([Column(model)], STEP)
    stepped = [tissue.press(x) for x in np.interp(instants, times, strains)]
    assert np.abs(stepped - exact).max() <= TOLERANCE * exact.max()


def test_an_inclusion_adds_its_own_law_from_where_it_is_met():
    plain = Tissue([Column(LIVER)], STEP)
    hard = Tissue([Column(LIVER, (Inclusion(0.1, 5000.0),))], STEP)
    body = Tissue([Column(FdenModel(5000.0, 1e-3, LIVER.fractional_order))], STEP)
    for strain in np.linspace(0.0, 0.25, 400):
        expected = plain.press(strain) + body.press(max(strain - 0.1, 0.0))
        assert hard.press(strain) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_the_node_publishes_as_a_driver_does_and_takes_commands():
    with Ears() as ears:
        forces = ears.hear(WrenchStamped, "/force")
        poses = ears.hear(PoseStamped, "/displacement")
        command = ears.node.create_publisher(JointState, "/command", 10)
        with node_process("tissue_simulator", {"force.bias": 0.02}) as simulator:
            ears.wait_for(lambda: len(forces) > 200 and len(poses) > 100, "samples")
            stamps = [stamp_ns(message.header.stamp) for message in forces]
            assert {b - a for a, b in pairwise(stamps[:50])} == {2_000_000}
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


# Simulated tissue of other laws: relaxations, wear, contact


LINEAR = FdenModel(1000.0, 0.5, 0.2)
COARSE_STEP = 0.002


def ramp_and_hold(strain=0.25, ramp=1.0, stop=5.0):
    times = COARSE_STEP * np.arange(1, round(stop / COARSE_STEP) + 1)
    return times, np.interp(times, [0.0, ramp], [0.0, strain])


@pytest.mark.parametrize(
    "relaxation",
    [
        standard_linear_solid(2.0),
        poroelastic(3.0),
        quasi_linear(0.15, 0.01, 100.0),
        Relaxation(springpots=((0.5, 0.1), (0.5, 0.4)), exponentials=((0.3, 0.0),)),
    ],
)
def test_a_ramp_leaves_the_integral_of_the_relaxation(relaxation):
    # Linear tissue: f(t) = G v int_0^t g.
    times, strains = ramp_and_hold(strain=0.1, ramp=2.0, stop=2.0)
    found = stress_of_law(Law(LINEAR, relaxation), strains, COARSE_STEP)
    # u^5 takes the singularity at 0 away.
    nodes = (np.arange(20_000) + 0.5) / 20_000
    end = times[-1]
    integral = float(np.mean(relaxation.at(end * nodes**5) * 5.0 * nodes**4)) * end
    assert found[-1] == pytest.approx(1000.0 * 0.05 * integral, rel=1e-3)


def test_contact_pushes_and_the_tissue_wears_with_each_press():
    knots = np.cumsum([0.0, 0.5, 0.5, 0.7, 60.0, 0.2, 0.5, 0.5, 0.7])
    strains = [0.0, 0.2, 0.2, -0.05, -0.05, 0.0, 0.2, 0.2, -0.05]
    times = COARSE_STEP * np.arange(1, round(float(knots[-1]) / COARSE_STEP) + 1)
    motion = np.interp(times, knots, strains)
    halves = times < 30.0

    def peaks(**wear):
        stress = stress_of_law(
            Law(LINEAR, standard_linear_solid(0.5), **wear), motion, COARSE_STEP
        )
        assert stress.min() == 0.0
        return stress[halves].max(), stress[~halves].max()

    first, second = peaks()
    assert second == pytest.approx(first, rel=1e-3)
    first, second = peaks(softening=0.1)
    assert second == pytest.approx(0.9 * first, rel=2e-3)
    first, second = peaks(set_strain=0.02)
    assert second == pytest.approx(0.9 * first, rel=0.02)
