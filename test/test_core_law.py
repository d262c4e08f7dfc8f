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
    log_stiffness,
    log_strain,
    memory_weights,
    phi,
    strain_of_phi,
)
from fden_ros.core.oscillation import ComplexModulusMeter

# The constitutive law: smooth at the boundary strain, odd, and what its derivatives say


stiffnesses = st.floats(1.0, 1e5)
nonlinear_stiffnesses = st.floats(0.5, 50.0)
strains = st.floats(-1.0, 1.0)


@examples(100)
@given(x=st.floats(0.0, 1.0), G=stiffnesses, Gn=nonlinear_stiffnesses)
def test_value_is_the_paper_s_two_branches(x, G, Gn):
    expected = G * x if x <= 1.0 / Gn else G / Gn * math.exp(Gn * x - 1.0)
    assert elastic_response(x, G, Gn).value == pytest.approx(expected, rel=1e-12)


@examples(100)
@given(x=strains, G=stiffnesses, Gn=nonlinear_stiffnesses)
def test_slope_is_that_of_the_value(x, G, Gn):
    step = 1e-6
    after, before = (elastic_response(x + s, G, Gn).value for s in (step, -step))
    # Central differences err by step^2 f'''/6, below 1e-12 Gn^3 of the value's scale; rounding by
    # 1e-16 / 1e-6. At the boundary the second derivative jumps: step G Gn / 2 more.
    scale = G * math.exp(max(Gn * abs(x) - 1.0, 0.0))
    by_strain = (after - before) / (2.0 * step)
    assert by_strain == pytest.approx(elastic_response(x, G, Gn).by_strain, abs=1e-4 * scale)


@examples(100)
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


@pytest.mark.parametrize("strain", [0.05, 0.2])
def test_variance_of_the_stiffness_is_that_of_its_differences(strain):
    """Below and beyond the boundary strain of 1/8, at a time other than 1 s."""
    mean, step = np.array([6.0, math.log(8.0), 0.2]), 1e-6 * np.eye(3)
    ahead, behind = (log_stiffness(mean + s * step, np.eye(3), strain, 0.1) for s in (1.0, -1.0))
    gradient = (ahead.value - behind.value) / 2e-6
    for covariance in np.eye(3)[:, :, None] * np.eye(3)[:, None]:
        found = log_stiffness(mean, covariance, strain, 0.1).variance
        assert found == pytest.approx(gradient @ covariance @ gradient, rel=1e-6)


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


def test_geometries_have_the_stress_of_elastic_theory():
    """Hertz and Lee and Radok, torsion with the mean of the sample by Appendix A, a column."""
    size, depth = 0.005, 2e-4
    # For G = 1 the stress is the strain.
    sphere, rod, column = Sphere(size), TorsionalRheometer(0.01, size), FlatPunch(1e-4, size)
    rod_strain, punch = 0.5 * 0.01 * depth / size, FlatPunch(math.pi * 0.002**2, size, 0.4)
    for geometry, force, strain in (
        (sphere, 4.0 / 3.0 * math.sqrt(size) * depth**1.5, (depth / size) ** 1.5),
        (rod, math.pi * 0.01**3 * rod_strain, rod_strain),
        (column, 1e-4 * depth / size, depth / size),
        (punch, 2.0 * 0.002 * HAYES_TABLE[0.4][2] * depth / (1.0 - 0.4**2), depth / size),
    ):
        # The table is good to half a per cent.
        within = 5e-3 if geometry is punch else 1e-6
        assert force * geometry.stress_per_force == pytest.approx(strain, rel=within)
        assert geometry.strain(depth / geometry.length) == pytest.approx(strain)


@pytest.mark.parametrize("geometry", GEOMETRIES, ids=lambda g: type(g).__name__)
@examples(100)
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


orders = st.floats(0.02, 0.65)
#: Of a stress: (step, value).
moves = st.tuples(st.floats(math.log(1e-3), math.log(10.0)).map(math.exp), st.floats(-1e3, 1e3))


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
@given(drawn=st.lists(moves, min_size=1, max_size=30), repeats=st.integers(1, 4), order=orders)
def test_any_data_on_any_steps_equals_the_full_memory(drawn, repeats, order):
    one_by_one, together, found = StressMemory(), StressMemory(), []
    for step, value in drawn * repeats:
        one_by_one.press(step, value)
        found.append(memory_weights(order) @ one_by_one.means(1))
        together.press(step, value)
    times = np.cumsum([0.0, *(step for step, _ in drawn * repeats)])
    values = np.array([0.0, *(value for _, value in drawn * repeats)])
    size = magnitude(order, times, values)
    # A thousandth of a second is some 20 times the fastest memory: of its last step 1 % is lost.
    bound = 1e-5 * size + 0.01 * magnitude(order, times[-1:] - times[-2], values)
    assert abs(found[-1] - product_integral(order, times, values)) <= bound
    mean = memory_weights(order) @ together.means(len(found))
    assert abs(mean - np.mean(found)) <= 1e-11 * size
    assert not np.any(together.means(1))


def test_a_rest_is_a_stress_of_0_for_its_time():
    pressed, rested = StressMemory(), StressMemory()
    for memory in (pressed, rested):
        memory.press(1.0, 100.0)
    rested.rest(3.0)
    pressed.press(1e-3, 0.0)
    pressed.press(2.999, 0.0)
    for order in (0.02, 0.131, 0.32, 0.6):
        free = pressed.free_response(0.1, order)
        assert abs(rested.free_response(0.1, order) / free - 1.0) < 1e-12
        # Of a stress that falls to 0 in this time.
        fresh = StressMemory()
        fresh.press(1.0, 100.0)
        expected = product_integral(order, np.array([0.0, 1.0, 1.1]), np.array([0.0, 100.0, 0.0]))
        assert fresh.free_response(0.1, order) == pytest.approx(expected, rel=1e-4)


# A dither as a dynamic test, a hold as a relaxation test, from streams of samples


def test_slope_and_phase_are_told_apart_with_deviations():
    omegas = 2.0 * math.pi * np.array([1.0, 2.0, 4.0])
    slopes, phases = [], []
    for seed in range(200):
        generator = np.random.default_rng(seed)
        slope, phase = generator.uniform(0.05, 0.3), generator.uniform(0.1, 0.7)
        times = np.arange(0.0, 4.02, 0.01)
        strain = 0.1 + 0.01 * np.cos(np.outer(times, omegas)).sum(axis=1)
        strain += 0.005 * (times - 2.0) ** 2  # the probe drifts
        waves = 300.0 * omegas**slope * np.cos(np.outer(times, omegas) + phase)
        stress = 40.0 + 0.01 * waves.sum(axis=1) + 0.3 * generator.standard_normal(times.size)
        meter = ComplexModulusMeter([1.0, 2.0, 4.0], 4)
        samples = zip(times, strain, stress, strict=True)
        found = [m for sample in samples for m in meter.add(*sample)]
        assert len(found) == 3
        assert found[0].mean_strain == pytest.approx(0.1 + 0.005 * 4.0 / 3.0, abs=1e-4)
        slopes.append((found[0].slope - slope) / found[0].slope_sd)
        phases += [
            (m.fractional_order - 2.0 / math.pi * phase) / m.fractional_order_sd for m in found
        ]
    for errors in (slopes, phases):
        assert 0.9 < math.sqrt(np.mean(np.square(errors))) < 1.1
        assert 0.92 <= np.mean(np.abs(errors) < 1.96) <= 0.98
