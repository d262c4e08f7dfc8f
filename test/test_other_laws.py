# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Forces that are predicted by another law, where the tissue has one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from property_helpers import first

from benchmark.law_stiffness import GEOMETRIES, hunt_crossley
from benchmark.laws import ARM, MOMENTS, RIGID, run_stiffness, run_trial
from fden_ros.control import Predictor, TissueMemory
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Estimate, OtherLaw, OtherLawKind, other_along
from fden_ros.core.law import FlatPunch

GEOMETRY = FlatPunch(area=1e-4, thickness=0.02)
STEP = 0.002
LAW = np.array([math.log(2000.0), math.log(7.0), 0.2])
PLATEAU = OtherLaw(
    OtherLawKind.PLATEAU,
    np.array([math.log(1500.0), math.log(7.0), 0.8, math.log(0.7)]),
    np.diag([1e-4, 1e-4, 4e-4, 1e-2]),
)
HUNT_CROSSLEY = OtherLaw(
    OtherLawKind.HUNT_CROSSLEY,
    np.array([math.log(800.0), math.log(1.4), 0.5, 0.0]),
    np.diag([1e-4, 1e-4, 1e-4, 0.0]),
)


def strains(hold: float = 1.0) -> Array:
    """Return a ramp of 1 s to 20 %, a hold [s], and the way out of half of it in 1 s."""
    knots = np.cumsum([0.0, 1.0, hold, 1.0])
    times = np.arange(STEP, knots[-1] + 0.5 * STEP, STEP)
    return np.interp(times, knots, [0.0, 0.2, 0.2, 0.1])


def stress_of(other: OtherLaw, motion: Array) -> Array:
    law = other_along(GEOMETRY, other, other.mean)
    steps, moments = np.full(motion.size, STEP), np.zeros((motion.size, 32))
    return law.stress(steps, motion, moments)


def test_a_relaxation_with_a_plateau_is_a_spring_beside_a_maxwell_element():
    motion = strains()
    ln_g, ln_gn, ratio, ln_rate = PLATEAU.mean
    g, gn = math.exp(ln_g), math.exp(ln_gn)
    spring = np.where(motion < 1.0 / gn, g * motion, g / gn * np.exp(gn * motion - 1.0))
    # The element's stress s: ds/dt = r df/dt - rate s, in small steps.
    cuts, passing, expected = 200, 0.0, []
    for before, after in zip(np.append(0.0, spring[:-1]), spring, strict=True):
        for _ in range(cuts):
            passing += ratio * (after - before) / cuts - math.exp(ln_rate) * passing * STEP / cuts
        expected.append(after + passing)
    assert stress_of(PLATEAU, motion) == pytest.approx(np.array(expected), rel=1e-4, abs=0.05)


def test_after_hunt_and_crossley_the_stress_follows_the_speed():
    motion = strains()
    value, power, resistance, _ = HUNT_CROSSLEY.mean
    stiffness = math.exp(value) / 0.1 ** math.exp(power)
    expected = hunt_crossley(stiffness, math.exp(power), resistance)(motion, STEP)
    assert stress_of(HUNT_CROSSLEY, motion) == pytest.approx(expected, rel=1e-6)


def predicted(estimate: Estimate, stresses: Array) -> tuple[Array, Array]:
    """Return mean and sd of the force [N] in the last second of the motion, after the others."""
    motion, seen = strains(), int(2.0 / STEP)
    memory = TissueMemory(GEOMETRY)
    for strain, stress in zip(motion[:seen], stresses[:seen], strict=True):
        memory.press(STEP, float(strain), float(stress))
    predictor = Predictor(GEOMETRY, estimate, memory, float(stresses[seen - 1]))
    times = STEP * np.arange(1, motion.size - seen + 1)
    found = predictor.force(times, GEOMETRY.length * (motion[seen:] - motion[seen - 1]))
    return found.value, found.sd


def estimate(other: OtherLaw | None, probability: float) -> Estimate:
    covariance = np.diag([1e-4, 1e-4, 1e-6])
    return Estimate(*LAW, covariance, other_law=other, other_law_probability=probability)


@pytest.mark.parametrize("other", [PLATEAU, HUNT_CROSSLEY])
def test_tissue_of_another_law_is_predicted_by_that(other):
    stresses = stress_of(other, strains())
    value, sd = predicted(estimate(other, 1.0), stresses)
    expected = stresses[int(2.0 / STEP) :] / GEOMETRY.stress_per_force
    assert value == pytest.approx(expected, rel=2e-3, abs=1e-4)
    by_law, _ = predicted(estimate(other, 0.0), stresses)
    assert np.max(np.abs(by_law - expected)) > 20.0 * np.max(np.abs(value - expected))
    assert np.all(sd >= 0.0)


def test_what_is_predicted_is_the_mixture_of_both_laws():
    stresses = stress_of(PLATEAU, strains())
    (law, law_sd), (other, other_sd) = (
        predicted(estimate(PLATEAU, share), stresses) for share in (0.0, 1.0)
    )
    value, sd = predicted(estimate(PLATEAU, 0.3), stresses)
    assert value == pytest.approx(0.7 * law + 0.3 * other)
    variance = 0.7 * law_sd**2 + 0.3 * other_sd**2 + 0.7 * 0.3 * (law - other) ** 2
    assert sd == pytest.approx(np.sqrt(variance))


@pytest.mark.parametrize("number", first(*range(8)))
@pytest.mark.parametrize(
    ("name", "rig"),
    [
        ("linear_solid_1", RIGID),
        ("poroelastic_2", RIGID),
        pytest.param("poroelastic_20", RIGID, marks=pytest.mark.statistics),
        ("linear_solid_10", ARM),
        pytest.param("linear_solid_10", RIGID, marks=pytest.mark.statistics),
    ],
)
def test_the_interval_holds_the_force_to_come_before_another_law_is_told_as_after(
    name, rig, number
):
    """At the end of the ramp nothing has shown the relaxation, and in the hold all of it."""
    trial = run_trial((name, rig), number)
    found = [one for one in trial.predictions if not one.refusal]
    # On an arm all of a press may be refused.
    assert np.mean([one.inside for one in found] or [float(rig == ARM)]) > 0.9
    if rig == RIGID:
        assert trial.mismatch.part == 1
        assert [one.moment for one in found][-2:] == list(MOMENTS[-2:])
        assert all(one.half_width < 0.05 for one in found[-2:])


def test_the_stiffness_of_a_spring_and_dashpot_lies_in_its_interval_from_the_ramp_on():
    found = [
        one
        for rig in (RIGID, ARM)
        for geometry in list(GEOMETRIES)[1:]
        for number in range(2)
        for one in run_stiffness(("kelvin_voigt", geometry, rig), number)
        if one.is_known and not one.is_flagged
    ]
    assert len(found) >= 10
    # Where a filter counts that has gone on deeper than its solution's record, half are.
    assert np.mean([one.is_inside for one in found]) >= 0.9
