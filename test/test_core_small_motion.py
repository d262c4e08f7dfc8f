# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""N/m that a posterior predicts for a small motion, held against a step of the model itself."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import NOTHING_UNKNOWN, Component, EstimatorConfig, log_stiffness
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.record import Record
from fden_ros.core.estimation.small_motion import SmallMotion
from fden_ros.core.estimation.unknowns import (
    LOG_G,
    LOG_GN,
    ORDER,
    ORIGIN,
    unknowns_of,
)
from fden_ros.core.law import FlatPunch, Geometry, Sphere

FLAT, SPHERE = FlatPunch(area=1e-4, thickness=0.02), Sphere(radius=0.01)
THIN = Sphere(radius=0.01, thickness=0.015)
ORIGIN_SD, TIME_SCALE = 0.01, 0.1


def bent_model(geometry: Geometry, compliance_sd: float = 2e-4) -> PressModel:
    config = EstimatorConfig(uncertainty=replace(NOTHING_UNKNOWN, compliance_sd=compliance_sd))
    unknowns = unknowns_of(config, geometry, ORIGIN_SD, 0.0)
    return PressModel(unknowns, geometry, is_bent=True, last_knot=0.4)


def by_origin(model: PressModel) -> Array:
    return ORIGIN_SD * np.eye(model.size)[ORIGIN]


def state_of(model: PressModel, seed: int) -> Array:
    """Return a state with errors of the law, of the tool and of the origin."""
    random = np.random.default_rng(seed)
    state = random.normal(0.0, 0.05, model.size)
    state[LOG_G], state[LOG_GN], state[ORDER] = math.log(2000.0), math.log(9.0), 0.2
    state[model.bending != 0.0] = 0.5
    return state


def value_of(model: PressModel, state: Array, stress: float) -> float:
    member = Component(1.0, state, np.zeros((model.size, model.size)))
    found = log_stiffness(
        [SmallMotion(model, (member,), by_origin(model))], 0.25, stress, TIME_SCALE
    )
    assert found is not None
    return found[0]


@pytest.mark.parametrize("geometry", [FLAT, SPHERE, THIN])
def test_the_prediction_is_the_answer_of_the_model_to_a_small_step(geometry):
    model = bent_model(geometry, compliance_sd=0.0)
    state, size = state_of(model, 1), 1e-5

    def stress(step: float) -> float:
        # At 0.25 at once, and after 1000 s further by a step: 0.1 s later.
        times = np.concatenate([np.linspace(0.0, 1000.0, 41), 1000.0 + np.array([1e-4, 0.1])])
        depths = np.full(times.size, 0.25)
        depths[0], depths[-2:] = 0.0, 0.25 + step
        record = Record(0.0, 0.0, is_at_rest=True)
        for time, depth in zip(times, depths, strict=True):
            record.add(time, depth, 0.0, is_observed=True)
        points = record.points()
        return float(model.response(points, state).stress[-1])

    rise = (stress(size) - stress(0.0)) / size
    per_length = geometry.stress_per_force * geometry.length
    assert math.exp(value_of(model, state, 0.0)) == pytest.approx(rise / per_length, rel=0.02)


@pytest.mark.parametrize("geometry", [FLAT, SPHERE, THIN])
def test_its_variance_is_that_of_its_derivatives(geometry):
    model, stress = bent_model(geometry), 2000.0
    state = state_of(model, 2)
    gradient = np.empty(model.size)
    for k in range(model.size):
        step = np.zeros(model.size)
        step[k] = 1e-5
        up, down = (value_of(model, state + sign * step, stress) for sign in (1.0, -1.0))
        gradient[k] = (up - down) / 2e-5
    assert abs(gradient[ORIGIN]) > 1e-3
    root = np.random.default_rng(3).normal(0.0, 0.01, (model.size, model.size))
    covariance = root @ root.T
    member = Component(1.0, state, covariance)
    found = log_stiffness(
        [SmallMotion(model, (member,), by_origin(model))], 0.25, stress, TIME_SCALE
    )
    assert found is not None
    assert found[1] == pytest.approx(gradient @ covariance @ gradient, rel=1e-3)


def test_modes_that_disagree_widen_it():
    model = bent_model(FLAT, compliance_sd=0.0)
    first = state_of(model, 4)
    second = first.copy()
    second[LOG_G] += math.log(2.0)
    nothing = np.zeros((model.size, model.size))
    modes = (Component(0.5, first, nothing), Component(0.5, second, nothing))
    found = log_stiffness([SmallMotion(model, modes, by_origin(model))], 0.25, 0.0, TIME_SCALE)
    assert found is not None
    assert math.sqrt(found[1]) == pytest.approx(0.5 * math.log(2.0), rel=1e-6)


def test_a_relaxation_that_was_not_seen_counts_in_its_variance():
    model = bent_model(FLAT, compliance_sd=0.0)
    mode = Component(1.0, state_of(model, 4), 1e-4 * np.eye(model.size))
    known = SmallMotion(model, (mode,), by_origin(model))
    values = [
        log_stiffness([motion], 0.25, 0.0, TIME_SCALE)
        for motion in (known, replace(known, unseen=0.01))
    ]
    assert values[1] == pytest.approx((values[0][0], values[0][1] + 0.01))


def test_a_tool_that_yields_makes_it_less():
    model = bent_model(FLAT)
    stiff, soft = state_of(model, 5), state_of(model, 5)
    stiff[model.bending != 0.0] = 0.0
    rigid, both = (math.exp(value_of(model, state, 0.0)) for state in (stiff, soft))
    # Half a standard deviation of 0.2 mm/N.
    assert 1.0 / both == pytest.approx(1.0 / rigid + 1e-4, rel=1e-6)


@pytest.mark.parametrize(("geometry", "is_known"), [(FLAT, True), (SPHERE, False)])
def test_at_the_surface_a_sphere_has_none_and_nothing_warns(geometry, is_known):
    model = bent_model(geometry)
    member = Component(1.0, state_of(model, 6), np.eye(model.size))
    motion = SmallMotion(model, (member,), by_origin(model))
    found = log_stiffness([motion], -0.25, 0.0, TIME_SCALE)
    assert (found is not None) is is_known
