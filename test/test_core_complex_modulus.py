# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A dither as a dynamic test, a hold as a relaxation test, from streams of samples."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fden_ros.core.oscillation.complex_modulus import ComplexModulusMeter
from fden_ros.simulation.model import FdenModel
from simulation.closed_form import SineMove, moves_of_knots, stress_of_moves

MODEL = FdenModel(545.0, 8.55, 0.131)


def dithered_hold(mean, amplitude, frequency, times, settle=3.0):
    """Press to `mean` in 1 s, hold until `settle`, then dither."""
    knots = moves_of_knots([0.0, 1.0, settle], [0.0, mean, mean])
    sine = SineMove(settle, times[-1] + 1.0, mean, amplitude, frequency, settle)
    strain = np.interp(times, [0.0, 1.0], [0.0, mean])
    later = times > settle
    strain[later] = sine.strain_at(times[later])
    return strain, stress_of_moves([*knots, sine], times, MODEL)


def moduli(meter, times, strain, stress):
    return [m for sample in zip(times, strain, stress, strict=True) for m in meter.add(*sample)]


def test_dither_beyond_the_boundary_strain_gives_the_tangent():
    times = np.arange(3.0, 13.0, 0.005)
    strain, stress = dithered_hold(0.25, 0.005, 1.0, times)

    last = moduli(ComplexModulusMeter([1.0]), times, strain, stress)[-1]

    assert last.stiffness == pytest.approx(545.0 * math.exp(8.55 * 0.25 - 1.0), rel=5e-3)
    assert last.fractional_order == pytest.approx(0.131, abs=2e-3)


def test_two_frequencies_at_once_are_told_apart():
    meter = ComplexModulusMeter([1.0, 3.0], periods=3)
    times = np.arange(0.0, 3.02, 0.01)
    strain, stress = np.zeros((2, times.size)) + np.array([[0.1], [60.0]])
    stress -= 3.0 * times
    wanted = []
    for frequency, amplitude in ((1.0, 0.01), (3.0, 0.004)):
        omega = 2.0 * math.pi * frequency
        truth = 400.0 * (1j * omega) ** 0.3
        wanted.append(truth)
        strain += amplitude * np.cos(omega * times)
        stress += amplitude * (truth * np.exp(1j * omega * times)).real

    found = moduli(meter, times, strain, stress)

    assert [complex(m.storage, m.loss) for m in found] == pytest.approx(wanted, rel=1e-9)


def test_distortion_tells_a_dither_that_crosses_the_boundary_strain():
    times = np.arange(3.0, 13.0, 0.005)
    found = {}
    for mean, amplitude in ((0.06, 0.02), (0.117, 0.05)):
        strain, stress = dithered_hold(mean, amplitude, 1.0, times)
        found[mean] = moduli(ComplexModulusMeter([1.0]), times, strain, stress)[-1].distortion
    assert found[0.06] < 0.01 < 0.03 < found[0.117]


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
        found = moduli(ComplexModulusMeter([1.0, 2.0, 4.0]), times, strain, stress)
        assert len(found) == 3
        slopes.append((found[0].slope - slope) / found[0].slope_sd)
        phases += [
            (m.fractional_order - 2.0 / math.pi * phase) / m.fractional_order_sd for m in found
        ]
    for errors in (slopes, phases):
        assert 0.9 < math.sqrt(np.mean(np.square(errors))) < 1.1
        assert 0.92 <= np.mean(np.abs(errors) < 1.96) <= 0.98
