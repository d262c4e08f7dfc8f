# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contacts as flat rows, for tables: one row per contact, SI units."""

from __future__ import annotations

import math
from typing import Any

from fden_ros.core.estimation import KEYS
from fden_ros.core.outputs import ContactSummary
from fden_ros.offline.replay import MEASURED_KEYS, contact_object

#: The columns, in their order. x, y, z: place of the touch [m] in `frame`; mean_nis: mean of the
#: normalised innovation squared, 1 where model and noise are right. apparent_stiffness [N/m]: for
#: a motion of its time scale [s] at the deepest point; measured_slope [N/m]: slope of force
#: over displacement at a depth [m]. Correlations: of ln G, ln Gn and alpha.
COLUMNS: tuple[str, ...] = (
    "contact_id", "site", "start_ns", "end_ns", "x", "y", "z", "frame", "g", "g_sd", "g_n",
    "g_n_sd", "alpha", "alpha_sd", "alpha_source", "boundary_strain", "exponential_scale",
    "converged", "complete", "flags", "max_strain", "max_stress", "max_force", "samples",
    "rejected", "label", "probability", "mean_nis", "p_value", "decision_time",
    "decision_strain", "ratio", "ratio_low", "ratio_high", "apparent_stiffness",
    "apparent_stiffness_sd", "apparent_stiffness_time_scale", "g_g_n_correlation",
    "g_alpha_correlation", "g_n_alpha_correlation", "observable_parameters",
    "converged_parameters", "prior_limit_parameters",
)  # fmt: skip
COLUMNS += tuple(key for key in KEYS if key not in COLUMNS)
COLUMNS += tuple(f"{key}{part}" for key in MEASURED_KEYS for part in ("", "_sd", "_depth"))

#: Columns of several words.
LISTS = ("flags", "observable_parameters", "converged_parameters", "prior_limit_parameters")
#: Columns of the correlations, and which of (ln G, ln Gn, alpha) each is of.
CORRELATIONS = {
    "g_g_n_correlation": (0, 1),
    "g_alpha_correlation": (0, 2),
    "g_n_alpha_correlation": (1, 2),
}


def contact_row(summary: ContactSummary, mean_nis: float | None) -> dict[str, Any]:
    """Return a contact as a flat row with `COLUMNS`; None where there is nothing."""
    row = contact_object(summary)
    row |= {name: " ".join(row[name]) for name in LISTS}
    row["x"], row["y"], row["z"] = row["position"] or (None, None, None)
    row["rejected"] = summary.rejected_count
    row["probability"] = max(row["probabilities"].values(), default=None)
    row["mean_nis"] = mean_nis
    estimate = summary.estimate
    for name in ("boundary_strain", "exponential_scale"):
        row[name] = getattr(estimate, name, None)
    for name, (i, j) in CORRELATIONS.items():
        row[name] = None
        if estimate is not None:
            scale = math.sqrt(estimate.covariance[i, i] * estimate.covariance[j, j])
            row[name] = float(estimate.covariance[i, j]) / scale if scale > 0.0 else 0.0
    return {name: row[name] for name in COLUMNS}
