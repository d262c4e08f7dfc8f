# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The inner loops: compiled against numpy, against differences, and against the closed form."""

from __future__ import annotations

import importlib
from dataclasses import dataclass, replace

import loops_in_numpy
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.loops import (
    By,
    Columns,
    LawState,
    ResponseState,
    Steps,
    WalkState,
)
from fden_ros.core.law import RATE_COUNT as RATES
from fden_ros.simulation import FdenModel
from simulation.closed_form import stress_of_piecewise_linear_strain

SPACING = 0.77
RATES_OF_KERNEL = np.exp(np.log(1e-6) + SPACING * np.arange(RATES))
KNOTS = 7


def weights_of(alpha: float) -> Array:
    """Of t^-alpha / Gamma(1 - alpha); then of slower and of faster exponentials."""
    factor = SPACING * np.sin(np.pi * alpha) / np.pi
    slow = RATES_OF_KERNEL[0] ** alpha / np.expm1(SPACING * alpha)
    fast = RATES_OF_KERNEL[-1] ** (alpha - 1.0) / np.expm1(SPACING * (1.0 - alpha))
    return factor * np.array([*RATES_OF_KERNEL**alpha, slow, fast])


BASE = LawState(
    linear_stiffness=1.0,
    nonlinear_stiffness=8.0,
    exponent=1.0,
    is_one_sided=True,
    compliance=0.0,
    weights=weights_of(0.15),
    bend=np.zeros(0),
    last_knot=0.35,
)


@dataclass(frozen=True)
class Column:
    """One derivative of the response."""

    kind: int = By.NOTHING
    motion: Array | None = None
    surface: Array | None = None
    weights: Array | None = None


def stacked(columns: list[Column], part: slice, size: int) -> Columns:
    """Columns as the loops take them, for a part of the points."""

    def rows(name: str, width: int) -> Array:
        given = [getattr(column, name) for column in columns]
        return np.array([np.zeros(width) if g is None else g for g in given]).reshape(-1, width)

    return Columns(
        np.array([c.kind for c in columns], dtype=np.int64),
        np.ascontiguousarray(rows("motion", size)[:, part]),
        np.arange(len(columns), dtype=np.int64),
        rows("weights", RATES + 2),
        np.ascontiguousarray(rows("surface", size)[:, part]),
    )


@dataclass(frozen=True)
class Case:
    """A motion under a law, from steps of uneven durations."""

    law: LawState
    durations: Array
    compressions: Array
    surface: Array | None = None

    def columns(self) -> list[Column]:
        """Derivatives of every kind."""
        size = self.compressions.size
        found = [
            Column(By.LOG_G),
            Column(By.LOG_GN),
            Column(By.COMPLIANCE),
            Column(motion=np.full(size, -1.0)),
            Column(motion=np.gradient(self.compressions)),
            Column(weights=(weights_of(0.150001) - weights_of(0.149999)) / 2e-6),
            *(Column(By.FIRST_KNOT + knot) for knot in range(self.law.bend.size)),
        ]
        if self.surface is not None:
            found.append(Column(surface=self.surface * np.cos(np.arange(size))))
        return found


def motion_of(*levels: float) -> tuple[Array, Array]:
    """Ramps between levels and short holds at them, over uneven steps; durations and motion."""
    random = np.random.default_rng(3)
    durations, motion = [0.0], [levels[0]]
    for level in levels[1:]:
        steps = random.uniform(0.002, 0.03, 25)
        durations += [*steps, 0.05, 0.4]
        motion += [*(motion[-1] + (level - motion[-1]) * np.cumsum(steps) / steps.sum())]
        motion += [level, level]
    return np.array(durations), np.array(motion)


PRESS = motion_of(-0.03, 0.3, 0.12, 0.25, -0.05, -0.02, 0.28)
DIPS = motion_of(-0.01, 0.2, -0.02, -0.04, 0.22)
FROM_CONTACT = motion_of(0.05, 0.2, 0.1)
BEND = 0.2 * np.cos(np.arange(KNOTS))


def surface_of(size: int) -> Array:
    """A free surface that rises, stands and falls, from zero."""
    return 0.15 * np.interp(np.arange(size), [0, 20, 90, 150, 170], [0, 0, 1, 0.4, 0.3])


#: Of a layer as thick as the radius, which its base holds.
THIN = (1.13, 1.3, 2.77, -1.41, 0.32)

CASES = {
    "touch and release": Case(BASE, *PRESS),
    "free surface": Case(BASE, *PRESS, surface_of(PRESS[0].size)),
    "sphere": Case(replace(BASE, exponent=1.5), *PRESS),
    "sphere on a layer": Case(
        replace(BASE, bend=BEND, exponent=1.5, compliance=0.05, series=THIN), *PRESS
    ),
    "another power": Case(replace(BASE, exponent=2.0, series=THIN), *PRESS),
    "two-sided": Case(replace(BASE, is_one_sided=False), *PRESS),
    "compliance": Case(replace(BASE, compliance=0.05), *PRESS),
    "compliance at a free surface": Case(
        replace(BASE, compliance=0.05), *PRESS, surface_of(PRESS[0].size)
    ),
    "begins in contact": Case(replace(BASE, compliance=0.02), *FROM_CONTACT),
    "bent": Case(replace(BASE, bend=BEND), *DIPS),
    "bent beyond its last knot": Case(replace(BASE, bend=BEND, last_knot=0.1), *DIPS),
    "bent sphere with compliance": Case(
        replace(BASE, bend=BEND, exponent=1.5, compliance=0.05), *PRESS
    ),
    "bent, two-sided": Case(replace(BASE, bend=BEND, is_one_sided=False), *PRESS),
    "beyond the largest exponent": Case(
        replace(BASE, linear_stiffness=1e-26, nonlinear_stiffness=400.0), *PRESS
    ),
}
by_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


def response(
    case: Case, columns: list[Column], cut: int = 0
) -> tuple[Array, Array, ResponseState]:
    """The response to a case, in one call or in two that continue each other.

    Stress, elastic response and its slope, (3, points); derivatives, (columns, points); state.
    """
    state = ResponseState(len(columns))
    size = case.durations.size
    by_step = Steps.of(case.durations)
    results = []
    for part in (slice(0, cut), slice(cut, None)):
        places = np.arange(case.durations[part].size)
        steps = Steps(case.durations[part], by_step.moments[part], places, places)
        surface = None if case.surface is None else case.surface[part]
        own, motion = stacked(columns, part, size), case.compressions[part]
        results.append(loops.respond(case.law, steps, motion, surface, own, state))
    found = np.hstack([[r.stress, r.elastic, r.slope] for r in results])
    return found, np.concatenate([r.jacobian for r in results]).T, state


def stress_of(case: Case) -> Array:
    """The stress at every point."""
    result: Array = response(case, [])[0][0]
    return result


def assert_rows_agree(found: Array, expected: Array, tolerance: float) -> None:
    """Rows agree to a part of the largest number of each."""
    peaks = np.abs(expected).max(axis=-1, keepdims=True)
    assert (np.abs(found - expected) <= tolerance * peaks).all()


def test_compiled_moments_are_those_of_numpy():
    durations = np.array([0.0, 1e-6, 1e-3, 0.02, 1.0, 1e3])
    found = loops.moments(durations)
    expected = loops_in_numpy.moments(durations, RATES_OF_KERNEL)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-300)


@by_case
def test_the_compiled_response_is_that_of_numpy(case):
    free = np.zeros_like(case.durations) if case.surface is None else case.surface
    expected = loops_in_numpy.respond(case.law, case.durations, case.compressions, free)
    found = response(case, [])[0]
    assert np.ptp(expected, axis=1).all()
    assert_rows_agree(found[:2], expected[:2], 1e-10)
    # Newton's method leaves 1e-9 of the compression, of which no derivative is made good.
    assert_rows_agree(found[2:], expected[2:], 1e-7)


@by_case
@pytest.mark.parametrize("cut", [1, 60])
def test_a_response_in_two_parts_is_whole(case, cut):
    whole, parts = (response(case, case.columns(), at) for at in (0, cut))
    assert_rows_agree(parts[0][:2], whole[0][:2], 1e-10)
    assert_rows_agree(parts[0][2:], whole[0][2:], 1e-7)
    assert_rows_agree(parts[1], whole[1], 1e-7)
    assert_rows_agree(parts[2].values, whole[2].values, 1e-7)


def moved(case: Case, column: Column, change: float) -> Case:
    """The case with what a column is by moved by `change`."""
    law = case.law
    if column.kind == By.LOG_G:
        law = replace(law, linear_stiffness=law.linear_stiffness * np.exp(change))
    elif column.kind == By.LOG_GN:
        law = replace(law, nonlinear_stiffness=law.nonlinear_stiffness * np.exp(change))
    elif column.kind == By.COMPLIANCE:
        law = replace(law, compliance=law.compliance + change)
    elif column.kind >= By.FIRST_KNOT:
        knot = column.kind - By.FIRST_KNOT
        law = replace(law, bend=law.bend + change * (np.arange(law.bend.size) == knot))
    elif column.weights is not None:
        law = replace(law, weights=law.weights + change * column.weights)
    compressions, surface = case.compressions, case.surface
    if column.motion is not None:
        compressions = compressions + change * column.motion
    if column.surface is not None and surface is not None:
        surface = surface + change * column.surface
    return replace(case, law=law, compressions=compressions, surface=surface)


@by_case
def test_derivatives_are_central_differences(case):
    # Where the response is curved in the step of a touch, its nodes move with the touch.
    tolerance = 2e-3 if case.law.exponent != 1.0 or case.law.bend.size else 1e-7
    columns, step = case.columns(), 1e-6
    _, jacobian, _ = response(case, columns)
    differences = [
        stress_of(moved(case, column, step)) - stress_of(moved(case, column, -step))
        for column in columns
    ]
    assert_rows_agree(jacobian, np.array(differences) / (2.0 * step), tolerance)


def test_the_slope_at_a_touch_does_not_depend_on_rounding():
    law = replace(BASE, compliance=0.05)
    for start in np.linspace(-0.02, -0.01, 40):
        case = Case(law, np.array([0.0, 0.01, 0.01]), np.array([start, 0.01, 0.02]))
        column = Column(motion=np.ones(3))
        _, jacobian, _ = response(case, [column])
        up, down = (stress_of(moved(case, column, change)) for change in (1e-6, -1e-6))
        assert_rows_agree(jacobian[0], (up - down) / 2e-6, 1e-6)


def test_a_step_that_newton_first_takes_for_a_release_is_whole():
    law = replace(BASE, compliance=0.2)
    motion = np.array([0.0, 0.1, 0.3, 0.05, 0.05])
    case = Case(law, np.array([0.0, 0.01, 0.01, 0.01, 0.01]), motion)
    stress = stress_of(case)
    left = motion - law.compliance * stress
    assert motion[3] < law.compliance * stress[2] and left[3] > 0.0
    rigid = stress_of(replace(case, law=BASE, compressions=left))
    assert_rows_agree(stress, rigid, 1e-12)


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_response_that_is_no_number_is_refused(number):
    durations, motion = motion_of(-0.01, 0.2)
    bent = replace(BASE, bend=BEND)
    for law, bad in ((bent, 20), (replace(BASE, linear_stiffness=number), None)):
        compressions = motion.copy()
        if bad is not None:
            compressions[bad] = number
        with pytest.raises(FloatingPointError, match="not finite"):
            response(Case(law, durations, compressions), [])


@pytest.mark.parametrize("alpha", [0.05, 0.15, 0.4])
def test_ramp_and_hold_are_those_of_the_closed_form(alpha):
    times = np.unique([*np.linspace(0.0, 1.0, 201), *(1.0 + np.geomspace(1e-3, 100.0, 60))])
    motion = 0.3 * np.minimum(times, 1.0)
    law = replace(BASE, weights=weights_of(alpha))
    stress = stress_of(Case(law, np.diff(times, prepend=0.0), motion))
    truth = stress_of_piecewise_linear_strain(
        [0.0, 1.0, 200.0], [0.0, 0.3, 0.3], times, FdenModel(1.0, 8.0, alpha)
    )
    np.testing.assert_allclose(stress, truth, atol=1e-5 * truth.max())


def walked_rows() -> tuple[Array, Array, WalkState]:
    """Rows, errors of their blocks, and the walks before."""
    random = np.random.default_rng(7)
    errors = random.uniform(0.5, 2.0, (5, 60))
    errors[1] = random.normal(size=60)
    state = WalkState(np.array([0.8, 0.1, 0.3]), np.zeros((2, 5)))
    return random.normal(size=(60, 5)), errors, state


ROUGHNESS, MOTION = 0.7, 1.3


def covariance_of(errors: Array, stress: float, both: float, surface: float) -> Array:
    """Return the covariance of all measurements of two walks."""
    noise, gain, rough, drift, motion = errors
    first = np.minimum.outer(np.arange(noise.size), np.arange(noise.size))
    result: Array = (
        np.diag(noise)
        + (stress + np.cumsum(ROUGHNESS**2 * rough + drift))[first]
        + np.outer(gain, gain) * (surface + np.cumsum(MOTION**2 * motion))[first]
        + both * np.add.outer(gain, gain)
    )
    return result


def test_whitening_is_that_by_the_covariance_of_all_measurements():
    rows, errors, state = walked_rows()
    covariance = covariance_of(errors, *state.covariance)
    root = np.linalg.cholesky(covariance)
    expected = np.linalg.solve(root, rows)
    log_determinant = 0.0
    # In two parts that continue each other.
    for part in (slice(0, 25), slice(25, 60)):
        own = np.ascontiguousarray(errors[:, part])
        log_determinant += loops.whiten(rows[part], own, ROUGHNESS, MOTION, state)
    np.testing.assert_allclose(rows, expected, atol=1e-12)
    assert log_determinant == pytest.approx(2.0 * np.log(np.diag(root)).sum(), rel=1e-13)


def test_products_are_those_of_whitened_rows():
    rows, errors, state = walked_rows()
    whitened, copy = rows.copy(), WalkState(state.covariance.copy(), state.means.copy())
    expected = loops.whiten(whitened, errors, ROUGHNESS, MOTION, copy)
    products, found = loops.equations(rows, errors, ROUGHNESS, MOTION, state)
    assert found == expected
    np.testing.assert_array_equal(rows, whitened)
    np.testing.assert_allclose(products, whitened.T @ whitened, rtol=1e-12, atol=1e-12)


def test_a_filter_comes_to_what_all_measurements_say_at_once():
    rows, errors, _ = walked_rows()
    random, free = np.random.default_rng(3), np.array([1.0, 0.0, 1.0])
    observed, predicted = rows[:, :2].T.copy()
    linear = loops.Followed(observed, predicted, random.normal(size=3), free, rows[:, 2:].copy())
    root = random.normal(size=(5, 5))
    before, prior = random.normal(size=5), root @ root.T
    mean, covariance, log_likelihood = before.copy(), prior.copy(), 0.0
    for part in (slice(0, 25), slice(25, 60)):
        own = linear._replace(
            observed=observed[part], predicted=predicted[part], jacobian=linear.jacobian[part]
        )
        of_part = np.ascontiguousarray(errors[:, part])
        _, _, _, logarithm = loops.follow(own, of_part, ROUGHNESS, MOTION, mean, covariance)
        log_likelihood += logarithm
    design = np.column_stack([linear.jacobian * free, np.ones(60), errors[1]])
    expected = predicted + design @ (before - np.append(linear.about, [0.0, 0.0]))
    of_all = design @ prior @ design.T + covariance_of(errors, 0.0, 0.0, 0.0)
    gain = np.linalg.solve(of_all, design @ prior).T
    left = prior - gain @ design @ prior
    np.testing.assert_allclose(mean[:3], (before + gain @ (observed - expected))[:3], atol=1e-10)
    np.testing.assert_allclose(covariance[:3, :3], left[:3, :3], atol=1e-10)
    density = multivariate_normal(expected, of_all).logpdf(observed)
    assert log_likelihood == pytest.approx(density + 30.0 * np.log(2.0 * np.pi), rel=1e-10)


def test_a_filter_without_a_finite_prediction_is_refused():
    _, errors, _ = walked_rows()
    linear = loops.Followed(
        np.full(60, np.nan), np.zeros(60), np.zeros(3), np.ones(3), np.zeros((60, 3))
    )
    with pytest.raises(FloatingPointError, match="not finite"):
        loops.follow(linear, errors, ROUGHNESS, MOTION, np.zeros(5), np.eye(5))


def test_the_compiled_age_of_a_loading_is_that_of_numpy():
    random = np.random.default_rng(5)
    loaded, seconds = random.uniform(0.1, 2.0, 50), random.uniform(0.01, 0.5, 50)
    states = np.array([0.05, 0.3]), np.array([0.05, 0.3])
    found = loops.clock(loaded, seconds, 0.01, states[0])
    expected = loops_in_numpy.clock(loaded, seconds, 0.01, states[1])
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_allclose(*states, rtol=1e-12)


def normal_equations(held: int) -> tuple[loops.Scaled, Array]:
    """Of nine unknowns, the last three and the three before with priors of scales; these."""
    random = np.random.default_rng(6)
    roots = random.normal(size=(4, 9, 9))
    normal, base, kernel, characteristic = roots.transpose(0, 2, 1) @ roots
    base[3:], base[:, 3:] = 0.0, 0.0
    own = np.ascontiguousarray
    fields = own(kernel[:3, :3]), own(characteristic[:3, :3])
    towards, off = random.normal(size=(2, 9))
    places = np.array([[a, b] for a in (0.5, 2.0) for b in (0.1, 1.0, 3.0)])
    return loops.Scaled(towards, normal, base, off, 3, 6, held, *fields), places


def system_at(scaled: loops.Scaled, place: Array) -> tuple[Array, Array, float]:
    """A, g, and the square of the pull, by numpy."""
    prior = scaled.base.copy()
    assert scaled.kernel_prior is not None and scaled.characteristic_prior is not None
    prior[3:6, 3:6] += place[0] * scaled.kernel_prior
    prior[6:, 6:] += place[1] * scaled.characteristic_prior
    matrix, side = scaled.normal + prior, scaled.towards + prior @ scaled.off
    for held in (place for place in range(9) if scaled.held >> place & 1):
        matrix[held], matrix[:, held] = 0.0, 0.0
        matrix[held, held], side[held] = 1.0, 0.0
    return matrix, side, float(scaled.off @ prior @ scaled.off)


@pytest.mark.parametrize("held", [0, 0b10, 0b110])
def test_places_of_the_scales_are_weighed_and_mixed_as_by_numpy(held):
    scaled, places = normal_equations(held)
    weights = np.linspace(0.1, 1.0, len(places))
    mean, second = np.zeros(9), np.zeros((9, 9))
    gains = loops.weigh(scaled, places)
    loops.mix(scaled, places, weights, mean, second)
    expected = []
    expected_mean, expected_second = np.zeros(9), np.zeros((9, 9))
    for place, weight in zip(places, weights, strict=True):
        matrix, side, pull = system_at(scaled, place)
        step = np.linalg.solve(matrix, side)
        expected.append(0.5 * (side @ step - pull - np.linalg.slogdet(matrix)[1]))
        expected_mean += weight * step
        expected_second += weight * (np.linalg.inv(matrix) + np.outer(step, step))
    np.testing.assert_allclose(gains, expected, rtol=1e-11)
    np.testing.assert_allclose(mean, expected_mean, rtol=1e-10)
    np.testing.assert_allclose(second, expected_second, rtol=1e-9, atol=1e-12)


def test_normal_equations_are_solved_and_indefinite_ones_refused():
    scaled, places = normal_equations(0)
    matrix, side, _ = system_at(scaled, places[0])
    np.testing.assert_allclose(loops.solve(matrix, side), np.linalg.solve(matrix, side), rtol=1e-9)
    with pytest.raises(np.linalg.LinAlgError):
        loops.solve(-matrix, side)
    with pytest.raises(np.linalg.LinAlgError):
        loops.weigh(scaled._replace(normal=-1e3 * scaled.normal), places)


def test_what_does_not_fit_the_compiled_loops_is_refused():
    with pytest.raises(ValueError, match="contiguous array of float64"):
        loops.solve(np.eye(3, dtype=np.float32), np.ones(3))
    with pytest.raises(ValueError, match="9 of them"):
        loops.solve(np.eye(2), np.ones(3))


def test_another_version_of_the_compiled_part_is_refused(monkeypatch):
    monkeypatch.setattr(loops._compiled, "VERSION", -1)
    with pytest.raises(ImportError, match="build-essential"):
        importlib.reload(loops)
