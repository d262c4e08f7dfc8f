# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The maximum of the posterior of a press at given scales.

A step solves the normal equations

.. math::
    (J^T S^{-1} J + \Lambda + \mu D)\,\Delta = J^T S^{-1} r + \Lambda (m - \theta)

(Levenberg and Marquardt); it is taken where it lowers the misfit with S as it is, and ends where
S, taken at the solution itself, wants no further step. So the maximum depends on the record alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.density import EVALUATION_COST, Density, Maximum
from fden_ros.core.estimation.error_model import Errors
from fden_ros.core.estimation.loops import Evaluation
from fden_ros.core.estimation.parts import Parts
from fden_ros.core.estimation.scales import Scales
from fden_ros.core.estimation.unknowns import LAW, ORDER
from fden_ros.core.law import HIGHEST_ORDER, LOWEST_ORDER

#: Steps of one maximum [1], and damped tries of one step [1].
MOST_STEPS, _MOST_TRIES = 60, 8
#: A maximum is found, to a twentieth of a standard deviation, where a step would lower minus twice
#: the log posterior by less than this [1]. With a fourteenth the last live state was up to 0.2 off
#: the summary.
CONVERGED = 2.5e-3
#: For so many steps [1] the variances are taken at the state; then they follow it by this part of
#: the distance [1], so that both cannot take turns; from 15 steps on by 15 over their count of it:
#: where a kink lies between two states each is the better one by its own variances.
_QUICK_STEPS, _FOLLOWING, _PATIENCE = 5, 0.5, 15
#: Stiffness by which a touch is held at a sample, over the stiffest of what moves it [1]: beside
#: that of all unknowns rounding would leave no positive definite normal equations.
_HELD = 1e4
#: Largest step of ln G, ln Gn and alpha [1].
LARGEST_STEP = np.array([3.0, 0.7, 0.15])
#: Damping at first [1], and by which factors it falls and rises.
_DAMPING, _EASED, _DAMPED = 1e-4, 0.1, 8.0


class _Metric(NamedTuple):
    """By what residuals and the distance from the prior's mean are weighed."""

    errors: Errors
    precision: Array


class _Equations(NamedTuple):
    """Normal equations of a step."""

    normal: Array
    damped: Array  #: what damping multiplies, the diagonal
    towards: Array
    misfit: float
    is_at_bound: bool  #: alpha wants beyond what there is


class _Tried(NamedTuple):
    """Where a step leads."""

    state: Array
    misfit: float
    evaluation: Evaluation | None  #: None: not known yet


class MaximumSearch:
    """Seeks the maximum of a posterior given a record.

    Parameters
    ----------
    density : Density
    points : Points
    scales : Scales
    held : int or None
        Place of an unknown that stays where it starts.
    most : int
        Steps at most.
    """

    def __init__(
        self,
        density: Density,
        points: Points,
        scales: Scales,
        held: int | None = None,
        most: int = MOST_STEPS,
    ) -> None:
        self._density, self._points, self._scales = density, points, scales
        self._held, self._most = held, most
        self._shortens = self._is_smooth = True
        self._cost = points.times.size + EVALUATION_COST

    def from_start(self, start: Array, known: Evaluation | None = None) -> Parts[Maximum]:
        """Return the maximum that a start leads to; a part is a step.

        `known`: the density's evaluation at the start; None: it is not known yet.

        Raises
        ------
        FloatingPointError
            If the start's stress is beyond floating-point numbers.
        """
        model = self._density.model
        state, damping = start.copy(), _DAMPING
        at = start  # where the variances are taken; it follows the state
        found = known if known is not None else self._density.evaluate(self._points, state)
        metric: _Metric | None = None
        is_solved = is_at_kink = is_at_bound = False
        tried = 0
        if known is None:
            yield self._cost
        for count in range(self._most):
            if self._density.limit.is_reached:
                break
            part = _FOLLOWING * min(1.0, _PATIENCE / max(count, 1))
            at = state if count < _QUICK_STEPS else at + part * (state - at)
            metric = self._metric(at, found if at is state else None)
            free = self._equations(state, found, metric)
            normal, is_at_bound = free.normal, free.is_at_bound
            if is_at_kink:
                touch = model.surface.touch_gradient(self._points, state)
                stiffest = free.damped.max(where=touch != 0.0, initial=0.0)
                normal = normal + _HELD * stiffest * np.outer(touch, touch)
            behind = state - at
            gain = float(free.towards @ loops.solve(normal, free.towards))
            left = gain + float(behind @ free.normal @ behind)
            if left < CONVERGED:
                is_solved = True
                break
            if gain < 0.1 * CONVERGED:
                continue
            if tried > MOST_STEPS:
                break
            equations = free._replace(normal=normal)
            taken, damping, tries = yield from self._step(state, equations, damping, metric)
            tried += tries
            if taken is None:
                # A sample at the surface: its stress begins there, and so does its derivative.
                is_at_kink, damping = True, _DAMPING
                continue
            state, found = taken
            if tries == 1:
                damping *= _EASED
            # So much damping, where it is held up by a kink.
            elif damping > 0.1 and not is_at_kink:
                is_at_kink, damping = True, _DAMPING
        errors = self._metric(state, found).errors if metric is None else metric.errors
        return Maximum(state, found, errors, self._scales, is_solved, is_at_bound)

    def _metric(self, at: Array, found: Evaluation | None) -> _Metric:
        density = self._density
        if found is None:
            found = density.model.response(self._points, at)
        errors = density.error_model.errors(self._points, at, found)
        return _Metric(errors, density.precision(at, self._scales))

    def _equations(self, state: Array, found: Evaluation, metric: _Metric) -> _Equations:
        about = self._density.linear(self._points, found, metric.errors, *self._scales[2:])
        off = self._density.belief.mean - state
        normal = about.normal + metric.precision
        towards = about.towards + metric.precision @ off
        is_at_bound = ORDER not in self._density.known and _leaves(state[ORDER], towards[ORDER])
        for held in (self._held, ORDER if is_at_bound else None):
            if held is not None:
                normal[held], normal[:, held] = 0.0, 0.0
                normal[held, held], towards[held] = 1.0, 0.0
        misfit = about.square + float(off @ metric.precision @ off)
        return _Equations(normal, normal.diagonal(), towards, misfit, is_at_bound)

    def _misfit(self, state: Array, stress: Array, metric: _Metric) -> float:
        left = (self._points.stresses - stress)[:, None]
        model = self._density.error_model
        white = model.whitened(left, metric.errors, *self._scales[2:])[:, 0]
        off = state - self._density.belief.mean
        return float(white @ white + off @ metric.precision @ off)

    def _step(
        self, state: Array, equations: _Equations, damping: float, metric: _Metric
    ) -> Parts[tuple[tuple[Array, Evaluation] | None, float, int]]:
        """Return the first damped step that lowers the misfit, or None; damping and tries."""
        for tries in range(1, _MOST_TRIES + 1):
            normal = equations.normal + damping * np.diag(equations.damped)
            tried = self._try(state, loops.solve(normal, equations.towards), metric)
            yield self._cost if self._is_smooth else self._cost // 3
            if tried is not None:
                tried = self._shortened(state, tried, equations, metric)
            # Derivatives are for steps that are taken: the next first one, too, as it seems.
            self._is_smooth = tried is not None and tried.misfit <= equations.misfit
            if tried is not None and self._is_smooth:
                found = tried.evaluation
                if found is None:
                    yield self._cost
                    found = self._density.evaluate(self._points, tried.state)
                self._is_smooth = tries == 1
                return (tried.state, found), damping, tries
            damping = max(damping, _DAMPING) * _DAMPED
        return None, damping, _MOST_TRIES

    def _shortened(
        self, state: Array, tried: _Tried, equations: _Equations, metric: _Metric
    ) -> _Tried:
        """Return where the misfit is lowest along a step that leads too far, or where it leads.

        Where residuals are large the misfit is more curved than the normal equations say, and
        steps would go to and fro.
        """
        step = tried.state - state
        gain = float(equations.towards @ step)
        curved = tried.misfit - equations.misfit + 2.0 * gain
        # It leads too far where the misfit is lowest before this part of it.
        if not (self._shortens and 0.0 < gain < 0.6 * curved):
            return tried
        shorter = self._try(state, gain / curved * step, metric)
        # At a kink no parabola holds, and a second try at one would be in vain.
        self._shortens = shorter is not None and shorter.misfit <= equations.misfit
        return shorter if shorter is not None and shorter.misfit < tried.misfit else tried

    def _try(self, state: Array, step: Array, metric: _Metric) -> _Tried | None:
        """Return where a step leads, and the misfit there; None: nowhere."""
        largest = float(np.max(np.abs(step[: len(LAW)]) / LARGEST_STEP))
        after = state + step / max(largest, 1.0)
        after[ORDER] = np.clip(after[ORDER], LOWEST_ORDER, HIGHEST_ORDER)
        density, points, found = self._density, self._points, None
        try:
            if self._is_smooth:
                found = density.evaluate(points, after)
            stress = (
                found.stress if found is not None else density.model.response(points, after).stress
            )
        except (FloatingPointError, OverflowError):
            return None
        return _Tried(after, self._misfit(after, stress, metric), found)


def _leaves(order: float, towards: float) -> bool:
    """Whether an order wants beyond where the weights are made for."""
    return towards * (order - (LOWEST_ORDER if towards < 0.0 else HIGHEST_ORDER)) >= 0.0
