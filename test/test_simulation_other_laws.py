# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Simulated tissue of other laws: relaxations, wear, contact."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.other_laws import (
    Law,
    Relaxation,
    poroelastic,
    quasi_linear,
    springpot,
    standard_linear_solid,
    stress_of_law,
)
from fden_ros.simulation.model import FdenModel
from simulation.closed_form import stress_of_piecewise_linear_strain

MODEL = FdenModel(1000.0, 8.0, 0.2)
LINEAR = FdenModel(1000.0, 0.5, 0.2)
STEP = 0.002


def ramp_and_hold(strain=0.25, ramp=1.0, stop=5.0):
    times = STEP * np.arange(1, round(stop / STEP) + 1)
    return times, np.interp(times, [0.0, ramp], [0.0, strain])


def test_a_springpot_is_the_closed_form():
    times, strains = ramp_and_hold()
    exact = stress_of_piecewise_linear_strain([0.0, 1.0], [0.0, 0.25], times, MODEL)
    found = stress_of_law(Law(MODEL, springpot(0.2)), strains, STEP)
    np.testing.assert_allclose(found, exact, atol=1e-4 * exact.max())


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
    found = stress_of_law(Law(LINEAR, relaxation), strains, STEP)
    # u^5 takes the singularity at 0 away.
    nodes = (np.arange(20_000) + 0.5) / 20_000
    end = times[-1]
    integral = float(np.mean(relaxation.at(end * nodes**5) * 5.0 * nodes**4)) * end
    assert found[-1] == pytest.approx(1000.0 * 0.05 * integral, rel=1e-3)


def test_contact_pushes_and_the_tissue_wears_with_each_press():
    knots = np.cumsum([0.0, 0.5, 0.5, 0.7, 60.0, 0.2, 0.5, 0.5, 0.7])
    strains = [0.0, 0.2, 0.2, -0.05, -0.05, 0.0, 0.2, 0.2, -0.05]
    times = STEP * np.arange(1, round(float(knots[-1]) / STEP) + 1)
    motion = np.interp(times, knots, strains)
    halves = times < 30.0

    def peaks(**wear):
        stress = stress_of_law(Law(LINEAR, standard_linear_solid(0.5), **wear), motion, STEP)
        assert stress.min() == 0.0
        return stress[halves].max(), stress[~halves].max()

    first, second = peaks()
    assert second == pytest.approx(first, rel=1e-3)
    first, second = peaks(softening=0.1)
    assert second == pytest.approx(0.9 * first, rel=2e-3)
    first, second = peaks(set_strain=0.02)
    assert second == pytest.approx(0.9 * first, rel=0.02)
