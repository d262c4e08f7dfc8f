# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How far kernel and curve are from the law: stated with its interval, and told by a threshold."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from fden_ros.core.estimation.contact_record import ContactRecord
from fden_ros.core.estimation.estimator import Block
from fden_ros.core.estimation.estimator_config import NOTHING_UNKNOWN, Prior, Uncertainty
from fden_ros.core.estimation.law_deviation import LawDeviation
from fden_ros.core.estimation.law_fit import LawFit
from fden_ros.core.estimation.nearest_curve import nearest_curve
from fden_ros.core.law.geometry import FlatPunch

Array = NDArray[np.float64]

WIDE = Prior(3000.0, 1.5, 8.0, 0.5, 0.2, 0.15)
STEP = 0.01
RAMP, HOLD, STRAIN = 1.5, 4.0, 0.3
TIMES: Array = np.arange(STEP, RAMP + HOLD, STEP)


def power_law(times: Array) -> Array:
    return times**-0.15 / math.gamma(0.85)


def exponential(strains: Array) -> Array:
    return np.where(strains < 0.125, strains, 0.125 * np.exp(8.0 * strains - 1.0))


def fitted(
    kernel: Callable[[Array], Array],
    characteristic: Callable[[Array], Array],
    seed: int,
    uncertainty: Uncertainty = NOTHING_UNKNOWN,
    relative_noise: float = 1e-3,
    surface: Array | float = 0.0,
    start_order: float = 0.15,
) -> LawDeviation:
    """Fit to a ramp and a hold, whose stress is a discrete convolution.

    `surface`: how far the surface goes away from the probe, as compression; `start_order`: alpha
    where the fit begins.
    """
    strains = np.minimum(STRAIN * TIMES / RAMP, STRAIN)
    pressed = np.maximum(strains - surface, 0.0)
    change = np.diff(2000.0 * characteristic(pressed), prepend=0.0)
    # The mean of the kernel over a step, by its middle; over the first, where it is singular, by
    # many.
    weights = kernel(TIMES - 0.5 * STEP)
    weights[0] = kernel((np.arange(2000) + 0.5) * STEP / 2000.0).mean()
    stresses = np.convolve(change, weights)[: TIMES.size]
    noise = relative_noise * stresses.max()
    stresses += np.random.default_rng(seed).normal(0.0, noise, TIMES.size)
    record = ContactRecord()
    for time, strain, stress in zip(TIMES, strains, stresses, strict=True):
        age = max(time - RAMP, 0.0) + 0.3
        record.add(Block(strain, stress, time, 1, STEP, np.zeros(1)), age)
    start = np.array([math.log(2000.0), math.log(8.0), start_order, 0.0])
    geometry = FlatPunch(area=1e-4, thickness=0.02)
    fit = LawFit(record, noise, geometry, WIDE, uncertainty, start, 0.002)
    for _ in fit.steps():
        pass
    return fit.result()


@pytest.mark.parametrize("seed", range(10))
def test_a_tissue_that_is_the_law_is_no_mismatch(seed: int) -> None:
    deviation = fitted(power_law, exponential, seed)
    assert not deviation.is_mismatch
    assert deviation.kernel.error < 0.03 and deviation.characteristic.error < 0.05


@pytest.mark.parametrize("seed", range(10))
def test_noise_of_a_tenth_of_the_peak_is_no_mismatch(seed: int) -> None:
    deviation = fitted(power_law, exponential, seed, relative_noise=0.1)
    assert not deviation.is_mismatch
    assert deviation.curve_evidence < 10.0


def test_a_curve_that_a_line_was_fitted_to_is_nearest_to_the_exponential_that_it_is() -> None:
    strains = np.linspace(0.15, 0.3, 30)
    wanted = np.log(exponential(strains))
    below_the_bend = math.log(0.8 / 0.3)
    assert nearest_curve(strains, wanted, below_the_bend, None) == pytest.approx(math.log(8.0))


@pytest.mark.parametrize("time_constant", [1.0, 1.5, 2.0])
def test_a_relaxation_that_ends_is_told_from_a_power_law(time_constant: float) -> None:
    def ends(times: Array) -> Array:
        return 0.4 + 0.6 * np.exp(-times / time_constant)

    deviation = fitted(ends, exponential, 1)
    assert deviation.is_mismatch


def test_a_curve_that_bends_where_it_is_loaded_is_told_from_the_exponential() -> None:
    def softens(strains: Array) -> Array:
        return np.minimum(exponential(strains), 0.35 + 0.5 * (strains - 0.25))

    deviation = fitted(power_law, softens, 1)
    assert deviation.is_mismatch
    assert deviation.loaded.error > 0.02


@pytest.mark.parametrize("start_order", [0.05, 0.15, 0.3, 0.6])
def test_the_order_of_the_relaxation_is_found_whatever_the_curve_and_the_start(
    start_order: float,
) -> None:
    def bent(strains: Array) -> Array:
        return exponential(strains) * np.exp(0.2 * np.sin(20.0 * strains))

    found = [fitted(power_law, bent, seed, start_order=start_order) for seed in range(5)]
    off = np.array([fit.fractional_order - 0.15 for fit in found])
    assert np.all(np.abs(off) < 0.01)
    assert np.all(np.abs(off) < 3.0 * np.array([fit.fractional_order_sd for fit in found]))


def test_where_a_relaxation_is_no_power_law_its_order_says_how_far_it_changes() -> None:
    def steeper(times: Array) -> Array:
        return power_law(times) * np.exp(-0.05 * np.log(np.maximum(times, 0.1) / 0.1) ** 2)

    straight, bent = fitted(power_law, exponential, 1), fitted(steeper, exponential, 1)
    # The slope is 0.15 at first, and 0.5 in the end.
    assert 0.15 < bent.fractional_order < 0.5
    assert bent.fractional_order_sd > 5.0 * straight.fractional_order_sd


def test_what_the_rig_may_leave_out_is_not_the_tissues() -> None:
    """A drift of 10 %, with a rig said to drift so much and with one said not to."""
    drifting = Uncertainty(force_drift_sd=0.05)

    def drifts(times: Array) -> Array:
        return power_law(times) * (1.0 + 0.15 * np.clip(times - 2.0, 0.0, 2.0))

    assert fitted(drifts, exponential, 1).kernel.error > 0.05
    widened = fitted(drifts, exponential, 1, drifting)
    assert widened.kernel.error - 1.645 * widened.kernel.error_sd < 0.03


RESTS = Uncertainty(surface_motion_sd=1e-4)


@pytest.mark.parametrize("seed", range(20))
def test_a_surface_that_rests_widens_nothing(seed: int) -> None:
    deviation = fitted(power_law, exponential, seed, RESTS, relative_noise=0.01)
    assert deviation.motion_covariance is None


@pytest.mark.parametrize("phase", np.arange(8) * math.pi / 4.0)
def test_a_surface_that_moves_more_than_is_stated_widens_the_covariance(phase: float) -> None:
    """1 mm of breathing, over 20 mm."""
    phases = 2.0 * math.pi * 0.25 * TIMES + phase
    surface = (np.sin(phases) - math.sin(phase)) * 0.5e-3 / 0.02
    deviation = fitted(power_law, exponential, 1, RESTS, 0.01, surface)
    assert deviation.motion_covariance is not None
    deviations = np.sqrt(deviation.motion_covariance.diagonal())
    # By a batch computation 0.05 and 0.02 where 0.1 mm a second counts.
    assert deviations[0] > 0.05 and deviations[2] > 0.02


@pytest.mark.parametrize("relative_noise", [1e-3, 1e-2, 3e-2])
def test_a_surface_that_moves_is_not_taken_for_tissue_that_is_not_the_laws(
    relative_noise: float,
) -> None:
    """Breathing of 1 mm was a mismatch in 6 to 7 of 8 phases."""
    for phase in np.arange(8) * math.pi / 4.0:
        phases = 2.0 * math.pi * 0.25 * TIMES + phase
        surface = (np.sin(phases) - math.sin(phase)) * 0.5e-3 / 0.02
        assert not fitted(power_law, exponential, 1, RESTS, relative_noise, surface).is_mismatch


@pytest.mark.parametrize("relative_noise", [1e-3, 1e-2, 3e-2])
def test_a_relaxation_that_ends_is_not_taken_for_a_surface_that_moves(
    relative_noise: float,
) -> None:
    hardly = Uncertainty(surface_motion_sd=2e-5)
    for time_constant in (1.0, 1.5, 2.0, 4.0):

        def ends(times: Array, time_constant: float = time_constant) -> Array:
            return 0.4 + 0.6 * np.exp(-times / time_constant)

        assert fitted(ends, exponential, 1, hardly, relative_noise).is_mismatch


def test_a_rig_that_is_said_to_rest_is_not_asked_for_motion() -> None:
    surface = 0.5e-3 / 0.02 * np.sin(2.0 * math.pi * 0.25 * TIMES)
    deviation = fitted(power_law, exponential, 1, NOTHING_UNKNOWN, 0.01, surface)
    assert deviation.motion_covariance is None


def test_a_record_stays_short_however_long_the_contact() -> None:
    record = ContactRecord()
    for time in np.arange(0.01, 3600.0, 0.05):
        strain = min(0.4 * time, 0.4)
        record.add(Block(strain, 1.0, time, 1, 0.05, np.zeros(1)), max(time - 1.0, 0.3))
    assert 50 < len(record) <= 160
    assert record.duration > 3000.0


def test_a_short_record_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 20 make a fit"):
        LawFit(
            ContactRecord(),
            1.0,
            FlatPunch(area=1e-4, thickness=0.02),
            WIDE,
            NOTHING_UNKNOWN,
            np.zeros(4),
            0.0,
        )
