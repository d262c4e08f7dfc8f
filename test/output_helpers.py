# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Outputs made by hand, for what is said, sent and shown of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fden_ros.core.estimation import Estimate, ParameterSet
from fden_ros.core.outputs import ContactSummary, Flag, OrderSource

ESTIMATE = Estimate(
    math.log(500.0),
    math.log(8.0),
    0.13,
    np.diag([0.01, 0.0004, 0.0001]),
    contact_point=0.0,
    contact_point_sd=0.0,
    probability_beyond_boundary=1.0,
    observable=ParameterSet.ALL,
    known=ParameterSet.ALL,
    sample_count=1000,
)


def summary(**changes: Any) -> ContactSummary:
    """A converged contact with liver."""
    values: dict[str, Any] = {
        "stamp_ns": 2,
        "start_ns": 0,
        "end_ns": 2,
        "site_id": 1,
        "contact_id": 1,
        "flags": Flag.NONE,
        "converged": True,
        "complete": True,
        "position": None,
        "order_source": OrderSource.LEARNED,
        "estimate": ESTIMATE,
        "max_strain": 0.3,
        "max_stress": 900.0,
        "max_force": 0.3,
        "sample_count": 100,
        "rejected_count": 0,
        "classes": None,
    }
    return ContactSummary(**values | changes)
