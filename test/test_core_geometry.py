# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Geometries: force and displacement to stress and strain."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_helpers import examples

from fden_ros.core.law.geometry import (
    FlatPunch,
    PassThrough,
    Sphere,
    TorsionalRheometer,
    hayes_factor,
)
from fden_ros.core.law.relaxation import memory_weights
from fden_ros.core.law.stress_memory import StressMemory

#: No test depends on the time it takes, nor on chance.
steady = examples(100)

GEOMETRIES = [
    FlatPunch(1e-4, 0.02),
    FlatPunch(1e-4, 0.02, 0.5),
    Sphere(0.005),
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


@steady
@given(modulus=st.floats(10.0, 1e6), radius=st.floats(1e-4, 0.1), share=st.floats(1e-3, 0.5))
def test_sphere_recovers_the_modulus_of_hertz(modulus, radius, share):
    sphere, depth = Sphere(radius), share * radius
    force = 4.0 / 3.0 * modulus * math.sqrt(radius) * depth**1.5
    ratio = force * sphere.stress_per_force / sphere.strain(depth / sphere.length)
    assert ratio == pytest.approx(modulus, rel=1e-9)


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
    assert difference / (2.0 * step) == pytest.approx(geometry.strain_slope(compression), rel=1e-6)
