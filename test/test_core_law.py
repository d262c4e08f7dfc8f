# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The constitutive law, its memory, the geometries, and the complex modulus."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_helpers import examples
from scipy.special import gamma

from fden_ros.core.law import (
    FlatPunch,
    PassThrough,
    Sphere,
    StressMemory,
    TorsionalRheometer,
    apparent_stiffness_factor,
    elastic_response,
    hayes_factor,
    log_phi,
    log_strain,
    memory_weights,
    phi,
    strain_of_phi,
)
from fden_ros.core.oscillation import ComplexModulusMeter

# The constitutive law: smooth at the boundary strain, odd, and what its derivatives say


#: No test depends on the time it takes, nor on chance.
steady = examples(100)

stiffnesses = st.floats(1.0, 1e5)
nonlinear_stiffnesses = st.floats(0.5, 50.0)
strains = st.floats(-1.0, 1.0)


@steady
@given(x=st.floats(0.0, 1.0), G=stiffnesses, Gn=nonlinear_stiffnesses)
def test_value_is_the_paper_s_two_branches(x, G, Gn):
    expected = G * x if x <= 1.0 / Gn else G / Gn * math.exp(Gn * x - 1.0)
    assert elastic_response(x, G, Gn).value == pytest.approx(expected, rel=1e-12)


@steady
@given(x=strains, G=stiffnesses, Gn=nonlinear_stiffnesses)
def test_slope_is_that_of_the_value(x, G, Gn):
    step = 1e-6
    after, before = (elastic_response(x + s, G, Gn).value for s in (step, -step))
    # Central differences err by step^2 f'''/6, below 1e-12 Gn^3 of the value's scale; rounding by
    # 1e-16 / 1e-6. At the boundary the second derivative jumps: step G Gn / 2 more.
    scale = G * math.exp(max(Gn * abs(x) - 1.0, 0.0))
    by_strain = (after - before) / (2.0 * step)
    assert by_strain == pytest.approx(elastic_response(x, G, Gn).by_strain, abs=1e-4 * scale)


@steady
@given(x=strains, G=stiffnesses, Gn=nonlinear_stiffnesses)
def test_the_inverses_give_the_strain_back(x, G, Gn):
    found = strain_of_phi(phi(np.array([x]), G, Gn), G, Gn)
    assert found == pytest.approx([x], rel=1e-9, abs=1e-12)
    logs = math.log(G), math.log(Gn)
    log_x = np.log(np.array([abs(x) + 1e-6]))
    assert log_strain(log_phi(np.exp(log_x), *logs), *logs) == pytest.approx(log_x, abs=1e-9)


def test_apparent_stiffness_is_the_relaxation_of_a_step():
    # A step of strain held for tau: stress G x tau^-alpha / Gamma(1 - alpha), the corrected E1.
    assert apparent_stiffness_factor(0.32, 0.1) == pytest.approx(0.1**-0.32 / gamma(0.68))
    # The design's example: from 1 ms to 1 s it changes 2.4 times at 0.125, 9 times at 0.32.
    for order, ratio in ((0.125, 2.37), (0.32, 9.12)):
        change = apparent_stiffness_factor(order, 1e-3) / apparent_stiffness_factor(order, 1.0)
        assert change == pytest.approx(ratio, rel=0.01)


# Geometries: force and displacement to stress and strain


GEOMETRIES = [
    FlatPunch(1e-4, 0.02),
    FlatPunch(1e-4, 0.02, 0.5),
    Sphere(0.005),
    Sphere(0.005, 0.004),
    Sphere(0.01, 0.004, is_bonded=False),
    TorsionalRheometer(0.01, 0.005),
    PassThrough(),
]

# Hayes, Keer, Herrmann and Mockros (1972), table 1: kappa by a/h, at Poisson's ratios
POISSON_RATIOS = (0.30, 0.35, 0.40, 0.45, 0.50)
HAYES_TABLE = {
    0.2: (1.207, 1.218, 1.232, 1.252, 1.281),
    0.4: (1.472, 1.502, 1.542, 1.599, 1.683),
    0.6: (1.784, 1.839, 1.917, 2.031, 2.211),
    1.0: (2.480, 2.603, 2.789, 3.085, 3.609),
}


@pytest.mark.parametrize("aspect_ratio", HAYES_TABLE)
def test_hayes_factor_is_the_published_table(aspect_ratio):
    found = [hayes_factor(aspect_ratio, nu) for nu in POISSON_RATIOS]
    # The table itself is good to half a per cent.
    assert found == pytest.approx(HAYES_TABLE[aspect_ratio], rel=5e-3)


def test_sphere_keeps_the_memory_of_lee_and_radok():
    # F = 4/3 sqrt(R) E*(t) * d(delta^1.5) with the fractional E*(t) = G t^-alpha/Gamma(1-alpha):
    # for delta^1.5 growing linearly, F = 4/3 sqrt(R) G rate t^(1-alpha)/Gamma(2-alpha). Its
    # fractional integral, as stress, must be G times the strain.
    G, alpha, radius, rate = 800.0, 0.2, 0.005, 3e-5
    sphere = Sphere(radius)
    times = np.linspace(0.0, 2.0, 4001)
    force = 4.0 / 3.0 * math.sqrt(radius) * G * rate * times ** (1 - alpha) / math.gamma(2 - alpha)
    memory = StressMemory()
    for value in (force * sphere.stress_per_force)[1:]:
        memory.press(times[1], float(value))
        last = memory.means(1)
    strain = sphere.strain((rate * times[-1]) ** (2 / 3) / sphere.length)
    # Only the curved first samples of t^0.8 are not linear between samples.
    assert memory_weights(alpha) @ last == pytest.approx(G * strain, rel=1e-5)


def test_torsional_rheometer_is_the_mean_of_the_sample_by_appendix_a():
    # Outer stress 2 T/(pi R^3) and outer strain R theta/d, halved.
    radius, height, torque, angle = 0.01, 0.005, 2e-4, 0.05
    rheometer = TorsionalRheometer(radius, height)
    assert torque * rheometer.stress_per_force == pytest.approx(
        0.5 * 2.0 * torque / (math.pi * radius**3)
    )
    assert rheometer.strain(angle / rheometer.length) == pytest.approx(
        0.5 * radius * angle / height
    )


@pytest.mark.parametrize("geometry", GEOMETRIES, ids=lambda g: type(g).__name__)
@steady
@given(compression=st.floats(1e-3, 0.9))
def test_slope_is_the_derivative_of_the_strain_and_compression_its_inverse(geometry, compression):
    assert geometry.compression(geometry.strain(compression)) == pytest.approx(compression)
    step = 1e-6 * compression
    difference = geometry.strain(compression + step) - geometry.strain(compression - step)
    slope = geometry.strain_slope(compression)
    assert difference / (2.0 * step) == pytest.approx(slope, rel=1e-6)
    many = geometry.strains(np.array([compression]))
    assert (*many.values, *many.slopes) == pytest.approx((geometry.strain(compression), slope))


# The memory of the stress, against the full memory


ORDERS = (0.02, 0.131, 0.25, 0.32, 0.5, 0.6)

orders = st.floats(0.02, 0.65)
steps = st.lists(
    st.floats(math.log(1e-3), math.log(10.0)).map(math.exp),
    min_size=1,
    max_size=30,
)


def values_at(times):
    return st.lists(st.floats(-1e3, 1e3), min_size=len(times), max_size=len(times)).map(np.array)


def integrated(order, times, values):
    """Every output of the memory, from the second time on."""
    memory, results = StressMemory(), []
    for step, value in zip(np.diff(times), values[1:], strict=True):
        memory.press(float(step), float(value))
        results.append(memory_weights(order) @ memory.means(1))
    return np.array(results)


def product_integral(order, times, values):
    """D^-order at the last time of linear pieces, with the full memory.

    Differences of powers are formed without cancellation, since a step may be 1e-6 of its age.
    """
    age, step = times[-1] - times[:-1], np.diff(times)
    slope = np.diff(values) / step
    younger = np.append(times[-1] - times[1:-1], 0.0)
    shrink = np.append(np.log1p(-step[:-1] / age[:-1]), -np.inf)
    zeroth = -(age**order) * np.expm1(order * shrink) / gamma(order + 1.0)
    first = -(age ** (order + 1.0)) * np.expm1((order + 1.0) * shrink) / gamma(order + 2.0)
    first -= step * younger**order / gamma(order + 1.0)
    return math.fsum(values[:-1] * zeroth + slope * first)


def magnitude(order, times, values):
    """What an error is measured against: the integral of |f|'s bound."""
    return np.max(np.abs(values)) * times[-1] ** order / gamma(order + 1.0) + 1e-300


@examples(200)
@given(data=st.data(), order=orders, step_list=steps)
def test_any_data_on_any_steps_equals_the_full_memory(data, order, step_list):
    times = np.concatenate([[0.0], np.cumsum(step_list)])
    values = np.concatenate([[0.0], data.draw(values_at(times[1:]))])
    result = integrated(order, times, values)[-1]
    # A thousandth of a second is some 20 times the fastest memory: of its last step 1 % is lost.
    bound = 1e-5 * magnitude(order, times, values) + 0.01 * magnitude(
        order, np.array([step_list[-1]]), values
    )
    assert abs(result - product_integral(order, times, values)) <= bound


@examples(50)
@given(data=st.data(), step_list=steps, repeats=st.integers(1, 4))
def test_samples_taken_together_are_what_they_are_one_by_one(data, step_list, repeats):
    step_list = step_list * repeats
    times = np.concatenate([[0.0], np.cumsum(step_list)])
    values = np.concatenate([[0.0], data.draw(values_at(times[1:]))])
    together = StressMemory()
    for step, value in zip(step_list, values[1:], strict=True):
        together.press(step, float(value))
    means, nothing = together.means(len(step_list)), together.means(1)
    for order in ORDERS:
        bound = 1e-11 * magnitude(order, times, values)
        one_by_one = integrated(order, times, values).mean()
        assert abs(memory_weights(order) @ means - one_by_one) <= bound
    assert not np.any(nothing)


def test_a_rest_is_a_stress_of_0_for_its_time():
    pressed, rested = StressMemory(), StressMemory()
    for memory in (pressed, rested):
        memory.press(1.0, 100.0)
    rested.rest(3.0)
    pressed.press(1e-3, 0.0)
    pressed.press(2.999, 0.0)
    for order in ORDERS:
        free = pressed.free_response(0.1, order)
        assert abs(rested.free_response(0.1, order) / free - 1.0) < 1e-12
        # Of a stress that falls to 0 in this time.
        fresh = StressMemory()
        fresh.press(1.0, 100.0)
        expected = product_integral(order, np.array([0.0, 1.0, 1.1]), np.array([0.0, 100.0, 0.0]))
        assert fresh.free_response(0.1, order) == pytest.approx(expected, rel=1e-4)


# A dither as a dynamic test, a hold as a relaxation test, from streams of samples


def moduli(meter, times, strain, stress):
    return [m for sample in zip(times, strain, stress, strict=True) for m in meter.add(*sample)]


def test_slope_and_phase_are_told_apart_with_deviations():
    omegas = 2.0 * math.pi * np.array([1.0, 2.0, 4.0])
    slopes, phases = [], []
    for seed in range(200):
        generator = np.random.default_rng(seed)
        slope, phase = generator.uniform(0.05, 0.3), generator.uniform(0.1, 0.7)
        times = np.arange(0.0, 4.02, 0.01)
        strain = 0.1 + 0.01 * np.cos(np.outer(times, omegas)).sum(axis=1)
        waves = 300.0 * omegas**slope * np.cos(np.outer(times, omegas) + phase)
        stress = 40.0 + 0.01 * waves.sum(axis=1) + 0.3 * generator.standard_normal(times.size)
        found = moduli(ComplexModulusMeter([1.0, 2.0, 4.0], 4), times, strain, stress)
        assert len(found) == 3
        slopes.append((found[0].slope - slope) / found[0].slope_sd)
        phases += [
            (m.fractional_order - 2.0 / math.pi * phase) / m.fractional_order_sd for m in found
        ]
    for errors in (slopes, phases):
        assert 0.9 < math.sqrt(np.mean(np.square(errors))) < 1.1
        assert 0.92 <= np.mean(np.abs(errors) < 1.96) <= 0.98
