# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The exact stress against arbitrary precision, known limits and another quadrature."""

from __future__ import annotations

import itertools

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_helpers import first

from fden_ros.simulation.model import FdenModel
from simulation.closed_form import stress_of_piecewise_linear_strain

DIGITS = 30

models = st.builds(FdenModel, st.floats(100.0, 2000.0), st.floats(4.0, 14.0), st.floats(0.02, 0.6))


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


@given(models, st.floats(-0.5, 0.5))
def test_phi_is_odd_smooth_and_inverted(model, strain):
    np.testing.assert_array_equal(model.phi(-strain), -model.phi(strain))
    assert model.strain_of_phi(model.phi(strain)) == pytest.approx(strain, rel=1e-12, abs=1e-15)
    for place in (strain, model.boundary_strain, -model.boundary_strain):
        slope = (model.phi(place + 1e-7) - model.phi(place - 1e-7)) / 2e-7
        assert model.phi_derivative(place) == pytest.approx(slope, rel=1e-5)
