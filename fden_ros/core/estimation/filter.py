# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The extended Kalman filter between two solutions of the posterior.

The state x holds the unknowns and the two walks. A block of stress z is

.. math::
    z = f(\hat\theta) + J(\theta - \hat\theta) + w + k s + v = h(x) + v,

linear about the maximum of the last solution; what it lacks there is variance of w
(:class:`LinearRange`). Predict and update as in the book (Bar-Shalom,
Li and Kirubarajan 2001, section 5.2):

.. math::
    P \leftarrow P + Q, \quad y = z - h(x), \quad S = H P H^T + R, \quad
    K = P H^T S^{-1}, \quad x \leftarrow x + K y, \quad P \leftarrow P - K S K^T .
"""

from __future__ import annotations

import copy
import math
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.block import BLOCK_TIME, Points
from fden_ros.core.estimation.error_model import ErrorModel, Errors, Row
from fden_ros.core.estimation.maximum import LARGEST_STEP
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.solution import Solution
from fden_ros.core.estimation.unknowns import LAW_PLACES, LOG_G, LOG_GN, ORDER
from fden_ros.core.law import log_phi


class Update(NamedTuple):
    """How a block compared with its prediction, and the errors of all blocks of the step."""

    prediction: float  #: [Pa]
    innovation: float  #: observed less predicted [Pa]
    variance: float  #: S, of the innovation [Pa^2]
    log_likelihood: float  #: of all blocks of the step [1]
    errors: Errors


class LinearRange:
    r"""What a model that is linear about a state lacks at other states, for some blocks.

    The stress of a block goes with :math:`\varphi(x;\, G, G_n)\,A^{-\alpha}`, A the mean age of
    its loading. With :math:`\Delta` the change of that logarithm from one state to another, and
    :math:`\Delta_1` its linear part, a model that is linear about the first lacks
    :math:`e^{\Delta} - 1 - \Delta_1` of the stress there: what a second-order filter would correct
    for (Bar-Shalom, Li and Kirubarajan 2001, section 10.3.2). The smooth errors of the law do not
    count.

    Parameters
    ----------
    about : ndarray, shape (size,)
    age : float
        Mean time since the loading was built up [s].
    """

    def __init__(self, model: PressModel, points: Points, about: Array, age: float) -> None:
        self._geometry, self._about = model.geometry, about
        self._compressions, self._by_state = model.motion.ends(points, about)
        self._log_age = math.log(max(age, BLOCK_TIME))

    def lacking(self, block: int, state: Array) -> float:
        """Return what the model lacks at a block, in parts of its stress [1]."""
        off = state - self._about
        before, moved = float(self._compressions[block]), float(self._by_state[block] @ off)
        if before <= 0.0 or before + moved <= 0.0:
            return 0.0
        first, second = self._geometry.strain(before), self._geometry.strain(before + moved)
        excess = max(math.exp(self._about[LOG_GN]) * first - 1.0, 0.0)
        by_compression = self._geometry.strain_slope(before) / first * (1.0 + excess)
        relaxed = -self._log_age * float(off[ORDER])
        linear = off[LOG_G] + excess * off[LOG_GN] + by_compression * moved + relaxed
        change = _log_phi(second, state) - _log_phi(first, self._about) + relaxed
        # A factor of e^20 is far enough.
        return math.expm1(min(change, 20.0)) - float(linear)


def _log_phi(strain: float, state: Array) -> float:
    # From a Gn that is 0 to rounding no filter goes on.
    with np.errstate(divide="raise"):
        return float(log_phi(np.array(strain), state[LOG_G], state[LOG_GN]))


class PressFilter:
    """Goes on from a solution, block by block.

    Attributes
    ----------
    x, P : ndarray, shapes (n + 2,), (n + 2, n + 2)
        Mean and covariance of the unknowns, the stress's walk and the surface's.
    held : int or None
        Place of an unknown that the solution holds; None: it is about a maximum.
    """

    def __init__(self, solution: Solution, model: PressModel, error_model: ErrorModel) -> None:
        self._model, self._error_model = model, error_model
        self.held = solution.held
        self._about = solution.maximum.state
        self._scales = solution.best_scales
        self._response = copy.deepcopy(solution.maximum.evaluation.state)
        self._loading = solution.maximum.errors.loading
        self._lacking = self._counted = 0.0
        n = model.size
        self._free = np.ones(n)
        self._free[: len(model.unknowns)] = [u.sd != 0.0 for u in model.unknowns]
        # Given the unknowns the walks are what the residuals less their columns leave.
        by_unknowns = -solution.walk.means[:, 1:]
        p00, p01, p11 = solution.walk.covariance
        self.x = np.empty(n + 2)
        self.x[:n] = solution.mean
        self._solved = (
            solution.mean[LAW_PLACES].copy(),
            solution.covariance.diagonal()[LAW_PLACES].copy(),
        )
        self.x[n:] = solution.walk.means[:, 0] + by_unknowns @ (solution.mean - self._about)
        self.P = np.empty((n + 2, n + 2))
        self.P[:n, :n] = solution.covariance
        by_unknowns *= self._free
        self.P[n:, :n] = by_unknowns @ solution.covariance
        self.P[:n, n:] = self.P[n:, :n].T
        self.P[n:, n:] = self.P[n:, :n] @ by_unknowns.T + np.array([[p00, p01], [p01, p11]])

    @property
    def mean(self) -> Array:
        """Mean of the unknowns, (n,)."""
        return self.x[:-2]

    @property
    def covariance(self) -> Array:
        """Covariance of the unknowns, (n, n)."""
        return self.P[:-2, :-2]

    @property
    def is_near(self) -> bool:
        """Whether it is still about where it is linear: within one step of a solution."""
        off = np.abs(self.x[LAW_PLACES] - self._about[LAW_PLACES])
        return bool(np.all(off <= LARGEST_STEP))

    @property
    def is_linear(self) -> bool:
        """Whether the model that is linear about the last solution says what the stress is."""
        # It may lack a tenth of the stress: with tissue of the law it is below 0.08, and with a
        # prior that excluded the tissue above 0.3 where Gn was 22 for 9.
        return self._lacking <= 0.1

    @property
    def has_moved(self) -> bool:
        """Whether it is a standard deviation from where it was solved.

        It went on by four of them in a hold of a minute.
        """
        mean, variances = self._solved
        return bool(np.any(np.square(self.x[LAW_PLACES] - mean) > variances))

    @property
    def mean_dwell_time(self) -> float:
        """Mean time since the present elastic response was built up [s]."""
        return self._loading.age

    def step(self, points: Points, under: Errors | None = None) -> Update:
        """Take blocks, one at least; return how the last of them compared with its prediction.

        `under`: the errors of the filter that it is weighed against; None: its own.
        """
        found = self._model.evaluate(points, self._about, self._response)
        errors = self._error_model.errors(points, self._about, found, self._loading)
        self._loading = errors.loading
        if under is not None:
            errors = errors.under(under)
        reach = LinearRange(self._model, points, self._about, self._loading.age)
        scales = self._scales.roughness, self._scales.motion
        # What was given out stays as it was.
        self.x, self.P = self.x.copy(), self.P.copy()
        log_likelihood = 0.0
        for k in range(points.stresses.size):
            self._lacking = abs(reach.lacking(k, self.mean))
            # What the walk gains in variance where so much stress is lacking.
            stress = self._lacking * float(found.stress[k])
            gained = max(stress**2 - self._counted, 0.0)
            self._counted += gained
            one = slice(k, k + 1)
            own = np.ascontiguousarray(errors.rows[:, one])
            own[Row.DRIFT] += gained
            block = loops.Followed(
                points.stresses[one],
                found.stress[one],
                self._about,
                self._free,
                found.jacobian[one],
            )
            update = Update(*loops.follow(block, own, *scales, self.x, self.P), errors)
            log_likelihood += update.log_likelihood
        return update._replace(log_likelihood=log_likelihood)
