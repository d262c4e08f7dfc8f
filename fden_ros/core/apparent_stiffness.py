# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The stiffness for a small motion that an estimate predicts, where it is known."""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.estimation import Estimate, log_stiffness
from fden_ros.core.law import ApparentStiffness, Geometry, log_stiffness_at

#: Deviation over the stiffness above which it is not known [1]: then it says no more than a guess
#: of a factor.
_MOST_SPREAD = 0.5
#: A logarithm above this is of no tissue [1]: e^50 N/m.
_LARGEST_LOG = 50.0


def apparent_stiffness_of(
    estimate: Estimate | None,
    geometry: Geometry,
    compression: float | None,
    stress: float,
    time_scale: float,
) -> ApparentStiffness | None:
    """Return the apparent stiffness about a compression for a motion of `time_scale` [s].

    None while one of both is not known, and while the deviation is above half of it.

    `compression` is from the nominal origin [1], `stress` there [Pa].
    """
    if estimate is None or compression is None:
        return None
    if estimate.small_motions:
        found = log_stiffness(estimate.small_motions, compression, stress, time_scale)
    else:
        found = _of_law(estimate, geometry, compression - estimate.contact_point, time_scale)
    if found is None or found[1] > _MOST_SPREAD**2 or found[0] > _LARGEST_LOG:
        return None
    value = math.exp(found[0])
    return ApparentStiffness(value, value * math.sqrt(found[1]), time_scale)


def _of_law(
    estimate: Estimate, geometry: Geometry, compression: float, time_scale: float
) -> tuple[float, float] | None:
    """Return mean and variance of ln dF/dd [ln N/m] at a compression from the origin [1]."""
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = estimate.covariance
    covariance[3, :3] = covariance[:3, 3] = estimate.with_origin
    covariance[3, 3] = estimate.contact_point_sd**2
    return log_stiffness_at(estimate.mean, covariance, geometry, compression, time_scale)
