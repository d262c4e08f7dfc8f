# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""What makes ln G and ln Gn uncertain: the part of their variance that each source has.

A source's part is the variance with it less the variance with it known: its unknowns taken out of
the normal equations, its process without variance. Parts do not add up: one hides another.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.error_model import Row
from fden_ros.core.estimation.estimate import Budget
from fden_ros.core.estimation.press_setting import PressSetting
from fden_ros.core.estimation.search import Solved
from fden_ros.core.estimation.unknowns import LAW, LOG_G, LOG_GN

#: Sources, and the names of the unknowns that are theirs.
SOURCES: Mapping[str, tuple[str, ...]] = {
    "noise": (),
    "drift": ("drift",),
    "friction": ("friction",),
    "motion": (),
    "compliance": ("compliance",),
    "delay": ("delay",),
    "surface": ("origin",),
    "law": (),
    "thickness": (),
    "prior": LAW,
}
#: Rows of the errors, and what is left of their variances where they are known [1]: with no noise
#: there would be nothing to weigh by.
_LEFT: Mapping[str, tuple[Row, float]] = {
    "noise": (Row.NOISE, 1e-8),
    "drift": (Row.DRIFT, 0.0),
    "motion": (Row.MOTION, 0.0),
}


def budget_of(setting: PressSetting, solved: Solved) -> Budget:
    """Return the budget of a solution of a press."""
    variances = _without(solved, "")
    thickness = setting.config.uncertainty.thickness_sd**2
    parts = {
        name: tuple(np.maximum(variances - _without(solved, name), 0.0).tolist())
        for name in SOURCES
    }
    considered = solved.best.considered
    if considered is not None:
        order = considered.diagonal()[[LOG_G, LOG_GN]]
        variances = variances + order
        parts["prior"] = tuple(order.tolist())
    parts["thickness"] = (thickness, thickness)
    log_g, log_gn = (variances + thickness).tolist()
    surface_sd = setting.origin_deviation(solved.best.covariance)
    return Budget((log_g, log_gn), parts, setting.stress_sd, surface_sd)


def _without(solved: Solved, source: str) -> Array:
    """Return the variances of ln G and ln Gn about the best maximum, with a source known, (2,)."""
    maximum, error_model = solved.best.maximum, solved.posterior.error_model
    errors, (_, _, roughness, motion) = maximum.errors, maximum.scales
    if source in _LEFT:
        row, left = _LEFT[source]
        rows = errors.rows.copy()
        rows[row] *= left
        errors = replace(errors, rows=rows)
    if source == "drift":
        error_model = replace(error_model, noise=replace(error_model.noise, zero=0.0))
    roughness = 0.0 if source == "law" else roughness
    white = error_model.whitened(maximum.evaluation.jacobian, errors, roughness, motion)
    normal = white.T @ white + solved.posterior.precision(maximum.state, maximum.scales)
    return np.array([_variance(solved, normal, k, source) for k in (LOG_G, LOG_GN)])


def _variance(solved: Solved, normal: Array, place: int, source: str) -> float:
    """Return the variance of an unknown without those of a source but itself."""
    names, model = SOURCES.get(source, ()), solved.model
    gone = {k for k, u in enumerate(model.unknowns) if u.name in names} - {place}
    gone |= set(solved.posterior.known.tolist())
    if source == "law":
        gone |= set(range(model.kernel.start, model.characteristic.stop))
    free = [k for k in range(model.size) if k not in gone]
    if place in gone:
        return 0.0
    towards = np.array([float(k == place) for k in free])
    return float(towards @ loops.solve(normal[np.ix_(free, free)], towards))
