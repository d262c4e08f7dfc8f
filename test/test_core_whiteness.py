# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What whitened residuals say of the model."""

from __future__ import annotations

import numpy as np

from fden_ros.core.estimation.whiteness import contradicts


def test_white_residuals_contradict_the_model_in_less_than_one_contact_of_a_thousand() -> None:
    # More than 4 of 1,000 would come by chance in 1 of 270 runs only.
    rng = np.random.default_rng(5)
    assert sum(contradicts(rng.standard_normal(1000)) for _ in range(1000)) <= 4


def test_underestimated_noise_and_slow_deviations_below_the_noise_do() -> None:
    rng = np.random.default_rng(1)
    assert contradicts(1.3 * rng.standard_normal(2000))
    slow = 0.5 * np.sin(2.0 * np.pi * np.arange(4000) / 1000)
    assert contradicts(slow + rng.standard_normal(4000))
    assert not contradicts(rng.standard_normal(0))
