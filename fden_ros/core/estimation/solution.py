# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The posterior of a press: its maximum, Laplace covariance and evidence, averaged over scales.

.. math::
    -2 \ln p(\theta \mid y) = r^T S^{-1} r + \ln|S| + (\theta - m)^T \Lambda\,(\theta - m) + \dots

with r = y - f(theta). A step solves the normal equations

.. math::
    (J^T S^{-1} J + \Lambda + \mu D)\,\Delta = J^T S^{-1} r + \Lambda (m - \theta)

(Levenberg and Marquardt); it is taken where it lowers the misfit with S as it is, and ends where
S, taken at the solution itself, wants no further step. So the solution depends on the record
alone.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.error_model import ErrorModel, Errors
from fden_ros.core.estimation.loop_arguments import ResponseState, WalkState
from fden_ros.core.estimation.press_model import Evaluation, PressModel
from fden_ros.core.estimation.record import Points
from fden_ros.core.estimation.scales import Scales, WeighedScales, beside
from fden_ros.core.estimation.unknowns import (
    CHARACTERISTIC_KNOTS,
    KERNEL_KNOTS,
    LAW,
    LOG_GN,
    ORDER,
    FieldPrior,
    Lifetime,
    characteristic_prior,
    kernel_prior,
)
from fden_ros.core.law.relaxation import HIGHEST_ORDER, LOWEST_ORDER

#: Steps of one maximum [1], and damped tries of one step [1].
_MOST_STEPS, _MOST_TRIES = 60, 8
#: A maximum is found where a step would lower minus twice the log posterior by less than this [1].
_CONVERGED = 1e-4
#: The same where rounding lets no step lower it [1].
_NEARLY_CONVERGED = 1e-3
#: The same while the record grows [1].
_NEARLY_FOUND = 2e-3
#: For so many steps [1] the variances are taken at the state; then they follow it by this part of
#: the distance [1], so that both cannot take turns.
_QUICK_STEPS, _FOLLOWING = 5, 0.5
#: Stiffness by which a touch is held at a sample, over the stiffest of the normal equations [1].
_HELD = 1e4
#: Times that a touch held at a sample is moved on [1], and how far at most, in standard deviations
#: [1].
_MOST_SEARCHES, _REACH = 2, 0.5
#: Degrees of freedom of what is stated of a rig [1].
_TAIL_DEGREES = 2.0
#: Largest step of ln G, ln Gn and alpha [1].
_LARGEST_STEP = np.array([3.0, 0.7, 0.15])
#: Damping at first [1], and by which factors it falls and rises.
_DAMPING, _EASED, _DAMPED = 1e-4, 0.1, 8.0
#: Damping from which on a step is held up by a kink [1].
_KINK_DAMPING = 0.1
#: A smooth error of this scale [1] is none.
_LEAST_SCALE = 1e-4
#: Maxima whose ln G, ln Gn and alpha are all closer than this are one [1].
_SAME = 1e-3
#: Rounds of maximum and choice of the scales [1].
_MOST_ROUNDS = 8
#: Scales and modes less likely than the best by this logarithm do not count [1].
_NEGLIGIBLE = 9.0


@dataclass(frozen=True)
class Belief:
    """A Gaussian prior of the unknowns.

    Attributes
    ----------
    mean : ndarray, shape (n,)
    precision : ndarray, shape (n, n)
        Without the law's errors where the scales decide on these.
    """

    mean: Array
    precision: Array


@dataclass(frozen=True)
class Maximum:
    """A maximum of the posterior at given scales.

    Attributes
    ----------
    state : ndarray, shape (n,)
    evaluation : Evaluation
        Of the model there.
    errors : Errors
        The error processes there.
    scales : Scales
    is_solved : bool
        It wants no further step.
    """

    state: Array
    evaluation: Evaluation
    errors: Errors
    scales: Scales
    is_solved: bool


@dataclass(frozen=True)
class Solution:
    """The posterior given a record.

    Attributes
    ----------
    maximum : Maximum
        About which everything is linear.
    mean, covariance : ndarray, shapes (n,), (n, n)
        Of the mixture over the scales.
    scales : dict of Scales to float
        Probabilities of the scales.
    log_evidence : float
    residuals : ndarray, shape (m,)
        Of the maximum, whitened: independent and of variance 1 where the model is right.
    walk : WalkState
        The walks at the end of the record: their means, for the residuals at the maximum and for
        the unknowns' columns, and their covariance, at the best scales.
    considered : ndarray or None, shape (n, n)
        What the uncertainty of an order that is not learned adds to the covariance.
    """

    maximum: Maximum
    mean: Array
    covariance: Array
    scales: dict[Scales, float]
    log_evidence: float
    residuals: Array
    walk: WalkState
    considered: Array | None = None

    @property
    def is_solved(self) -> bool:
        """Whether the maximum wants no further step."""
        return self.maximum.is_solved

    @property
    def response_state(self) -> ResponseState:
        """From which the response goes on."""
        return self.maximum.evaluation.state


class _Priors(NamedTuple):
    """The prior of all unknowns, at any scales."""

    model: PressModel
    base: Array
    kernel: FieldPrior | None
    characteristic: FieldPrior | None

    def precision(self, scales: Scales) -> Array:
        """Return its precision, (n, n)."""
        if self.kernel is None or self.characteristic is None:
            return self.base
        result = self.base.copy()
        kernel, characteristic = self.model.kernel, self.model.characteristic
        result[kernel, kernel] = self.kernel.precision / scales.kernel**2
        result[characteristic, characteristic] = (
            self.characteristic.precision / scales.characteristic**2
        )
        return result

    def log_determinant(self, scales: Scales) -> float:
        """Return the logarithm of the precision's determinant, but for what is the same to all."""
        if self.kernel is None or self.characteristic is None:
            return 0.0
        found = self.kernel.log_determinant + self.characteristic.log_determinant
        found -= 2.0 * KERNEL_KNOTS.size * math.log(scales.kernel)
        return found - 2.0 * CHARACTERISTIC_KNOTS * math.log(scales.characteristic)


class Posterior:
    """The posterior of a press given a record.

    Parameters
    ----------
    model : PressModel
    errors : ErrorModel
    belief : Belief
    grid : sequence of WeighedScales
    has_field_prior : bool
        The law's errors have the priors of the scales, not that of the belief.
    order_sd : float
        Standard deviation of an order that is not learned [1]; it counts in the others'.
    """

    def __init__(
        self,
        model: PressModel,
        errors: ErrorModel,
        belief: Belief,
        grid: Sequence[WeighedScales],
        *,
        has_field_prior: bool,
        order_sd: float = 0.0,
    ) -> None:
        self._order_sd = order_sd
        self._held: int | None = None
        self.model, self.error_model, self.belief, self.grid = model, errors, belief, grid
        self._has_field_prior = has_field_prior
        self._of_rig = np.array([u.lifetime is Lifetime.RIG for u in model.unknowns])
        self._fixed = np.array([u.sd == 0.0 for u in model.unknowns])

    # Prior

    def _priors(self, state: Array) -> _Priors:
        """Return the priors at a state.

        What is stated of a rig has Student's tails: it may be wrong by far, and then counts less.
        """
        base = self.belief.precision
        if self._of_rig.any():
            off = (state - self.belief.mean)[: self._of_rig.size][self._of_rig]
            factor = np.minimum((1.0 + _TAIL_DEGREES) / (off**2 + _TAIL_DEGREES), 1.0)
            root = np.ones(base.shape[0])
            root[: self._of_rig.size][self._of_rig] = np.sqrt(factor)
            base = base * np.outer(root, root)
        if not self._has_field_prior:
            return _Priors(self.model, base, None, None)
        kernel = kernel_prior()
        gn = math.exp(state[LOG_GN])
        characteristic = characteristic_prior(gn, self.model.last_knot)
        return _Priors(self.model, base, kernel, characteristic)

    def _precision(self, state: Array, scales: Scales) -> Array:
        """Return the prior's precision at a state."""
        return self._priors(state).precision(scales)

    # Maximum

    def _evaluate(self, points: Points, state: Array) -> Evaluation:
        found = self.model.evaluate(points, state)
        if self._fixed.any():
            found.jacobian[:, : self._fixed.size][:, self._fixed] = 0.0
        return found

    def maximum(
        self, points: Points, start: Array, scales: Scales, converged: float = _CONVERGED
    ) -> Maximum:
        """Return the maximum that a start leads to.

        `converged`: it is found where a step would lower minus twice the log posterior by less.

        Raises
        ------
        FloatingPointError
            If the start's stress is beyond floating-point numbers.
        """
        state, damping = start.copy(), _DAMPING
        at = start  # where the variances are taken; it follows the state
        found = self._evaluate(points, state)
        is_solved = is_at_kink = False
        tried, searches = 0, _MOST_SEARCHES if converged == _CONVERGED else 0
        for count in range(_MOST_STEPS):
            at = state if count < _QUICK_STEPS else at + _FOLLOWING * (state - at)
            stress = found.stress if at is state else self.model.stress(points, at)
            errors = self.error_model.errors(points, at, stress)
            precision = self._precision(at, scales)
            rows = np.column_stack([points.stresses - found.stress, found.jacobian])
            white, _, _ = self.error_model.whitened(rows, errors, scales.roughness, scales.motion)
            off = self.belief.mean - state
            normal = white[:, 1:].T @ white[:, 1:] + precision
            towards = white[:, 1:].T @ white[:, 0] + precision @ off
            if self._held is not None:
                normal[self._held], normal[:, self._held] = 0.0, 0.0
                normal[self._held, self._held], towards[self._held] = 1.0, 0.0
            misfit = float(white[:, 0] @ white[:, 0] + off @ precision @ off)
            free, held = normal, self.model.touch_gradient(points, state)
            if is_at_kink:
                normal = normal + _HELD * normal.diagonal().max() * np.outer(held, held)
            behind = state - at
            gain = float(towards @ _solved(normal, towards))
            left = gain + float(behind @ normal @ behind)
            if left < converged and is_at_kink and searches:
                searches -= 1
                before = state
                state = self._along_kink(points, state, free, held, scales, errors, precision)
                found = self._evaluate(points, state)
                if state is not before:
                    continue
            if left < converged:
                is_solved = True
                break
            if gain < 0.1 * converged:
                continue
            if tried > _MOST_STEPS:
                break
            taken, damping, tries = self._step(
                points,
                state,
                (normal, free.diagonal(), towards, misfit, damping),
                scales,
                errors,
                precision,
            )
            tried += tries
            if taken is None:
                # A sample at the surface: its stress begins there, and so does its derivative.
                is_solved = is_at_kink and left < max(_NEARLY_CONVERGED, converged)
                is_at_kink = True
                damping = _DAMPING
                if is_solved:
                    break
                continue
            state, found, _ = taken
            if tries == 1:
                damping *= _EASED
            elif damping > _KINK_DAMPING and not is_at_kink:
                is_at_kink, damping = True, _DAMPING
        return Maximum(state, found, errors, scales, is_solved)

    def _along_kink(
        self,
        points: Points,
        state: Array,
        normal: Array,
        held: Array,
        scales: Scales,
        errors: Errors,
        precision: Array,
    ) -> Array:
        """Return the best state as the touch moves, all else with it; or the state itself."""
        along = _solved(normal, held)
        size = float(held @ along)
        if not size > 0.0:
            return state
        along /= math.sqrt(size)

        def misfit(distance: float) -> float:
            after = state + distance * along
            rows = (points.stresses - self.model.stress(points, after))[:, None]
            white, _, _ = self.error_model.whitened(rows, errors, scales.roughness, scales.motion)
            off = after - self.belief.mean
            return float(white[:, 0] @ white[:, 0] + off @ precision @ off)

        best = 0.0
        for reach in (_REACH, 0.2 * _REACH, 0.04 * _REACH):
            best = min((best + reach * part for part in np.linspace(-1.0, 1.0, 9)), key=misfit)
        lowered = misfit(0.0) - misfit(best)
        return state + best * along if lowered > _NEARLY_CONVERGED else state

    def _step(
        self,
        points: Points,
        state: Array,
        equations: tuple[Array, Array, Array, float, float],
        scales: Scales,
        errors: Errors,
        precision: Array,
    ) -> tuple[tuple[Array, Evaluation, float] | None, float, int]:
        """Return the first damped step that lowers the misfit, or None; damping and tries.

        `equations`: normal matrix, what is damped of it, gradient, misfit and damping.
        """
        normal, damped, towards, misfit, damping = equations
        for tries in range(1, _MOST_TRIES + 1):
            step = _solved(normal + damping * np.diag(damped), towards)
            taken = self._try(points, state, step, scales, errors, precision)
            if taken is not None and taken[2] <= misfit:
                return taken, damping, tries
            damping = max(damping, _DAMPING) * _DAMPED
        return None, damping, _MOST_TRIES

    def _try(
        self,
        points: Points,
        state: Array,
        step: Array,
        scales: Scales,
        errors: Errors,
        precision: Array,
    ) -> tuple[Array, Evaluation, float] | None:
        """Return where a step leads, and the misfit there; None: nowhere."""
        largest = float(np.max(np.abs(step[: len(LAW)]) / _LARGEST_STEP))
        after = state + step / max(largest, 1.0)
        after[ORDER] = np.clip(after[ORDER], LOWEST_ORDER, HIGHEST_ORDER)
        try:
            found = self._evaluate(points, after)
        except (FloatingPointError, OverflowError):
            return None
        rows = (points.stresses - found.stress)[:, None]
        white, _, _ = self.error_model.whitened(rows, errors, scales.roughness, scales.motion)
        off = after - self.belief.mean
        return after, found, float(white[:, 0] @ white[:, 0] + off @ precision @ off)

    # Evidence

    def solution(self, points: Points, starts: Sequence[Array], scales: Scales) -> Solution:
        """Return the posterior about the best of the maxima that the starts lead to.

        Raises
        ------
        FloatingPointError
            If no start has a finite stress.
        """
        # A step too far overflows; it is not taken.
        with np.errstate(over="ignore", invalid="ignore"):
            return self._refined(points, self._maxima(points, starts, scales)[0])

    def solutions(self, points: Points, starts: Sequence[Array], scales: Scales) -> list[Solution]:
        """Return the posterior about each of the maxima that the starts lead to.

        Raises
        ------
        FloatingPointError
            If no start has a finite stress.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            found = self._maxima(points, starts, scales)
            errors = found[0].errors
            evidence = [self.log_evidence(points, m, errors) for m in found]
            apart = [
                m
                for k, m in enumerate(found)
                if evidence[k] > evidence[0] - _NEGLIGIBLE
                and all(np.max(np.abs(m.state - o.state)[: len(LAW)]) > _SAME for o in found[:k])
            ]
            return self._all_refined(points, apart)

    def is_known(self, place: int) -> bool:
        """Whether the unknown at a place is none."""
        return bool(self._fixed[place])

    def _all_refined(self, points: Points, maxima: Sequence[Maximum]) -> list[Solution]:
        found: list[Solution] = []
        for maximum in maxima:
            try:
                found.append(self._refined(points, maximum))
            except (FloatingPointError, np.linalg.LinAlgError):
                continue
        if not found:
            raise FloatingPointError("no maximum has a finite evidence")
        return found

    def _refined(self, points: Points, best: Maximum) -> Solution:
        """Return the solution about a maximum once the scales are the best there."""
        seen = [best.scales]
        for _ in range(_MOST_ROUNDS):
            found = self._averaged(points, best)
            chosen = max(found.scales, key=lambda s: found.scales[s])
            if chosen in seen:
                break
            seen.append(chosen)
            best = self.maximum(points, best.state, chosen)
        if not self._order_sd:
            return found
        return replace(found, considered=self._considered(points, found.maximum))

    def tracked(self, points: Points, state: Array, before: Solution) -> Solution:
        """Return the posterior from the state of one of a shorter record, in less time.

        The maximum is found to a twentieth of a standard deviation, and only the scales beside the
        best one before are weighed; where another is better now, all are.

        Raises
        ------
        FloatingPointError
            If the stress is not finite at the state.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            scales = max(before.scales, key=lambda s: before.scales[s])
            best = self.maximum(points, state, scales, _NEARLY_FOUND)
            found = self._averaged(points, best, beside(self.grid, scales))
            if max(found.scales, key=lambda s: found.scales[s]) != scales:
                found = self._averaged(points, best)
        if not self._order_sd:
            return found
        return replace(found, considered=self._considered(points, found.maximum))

    def given(self, place: int, points: Points, state: Array, scales: Scales) -> Solution:
        """Return the posterior given the unknown at a place, at one place of the grid.

        Raises
        ------
        FloatingPointError
            If the stress is not finite at the state.
        """
        other = copy.copy(self)
        other._held = place
        with np.errstate(over="ignore", invalid="ignore"):
            best = other.maximum(points, state, scales, _NEARLY_FOUND)
            return other._averaged(points, best, (WeighedScales(scales, 0.0),))

    def _considered(self, points: Points, maximum: Maximum) -> Array:
        """Return the covariance that the order's own adds (Schmidt and Kalman)."""
        scales = maximum.scales
        by_order = self.model.evaluate(points, maximum.state).jacobian[:, ORDER]
        rows = np.column_stack([by_order, maximum.evaluation.jacobian])
        white, _, _ = self.error_model.whitened(
            rows, maximum.errors, scales.roughness, scales.motion
        )
        normal = white[:, 1:].T @ white[:, 1:] + self._precision(maximum.state, scales)
        shift = -_solved(normal, white[:, 1:].T @ white[:, 0])
        shift[ORDER] = 1.0
        return self._order_sd**2 * np.outer(shift, shift)

    def _maxima(self, points: Points, starts: Sequence[Array], scales: Scales) -> list[Maximum]:
        """Return the maxima, best first; while they are compared the errors are the same."""
        maxima = []
        for start in starts:
            try:
                maxima.append(self.maximum(points, start, scales))
            except (FloatingPointError, OverflowError):
                continue
        if not maxima:
            raise FloatingPointError("the stress is not finite at any start")
        if len(maxima) == 1:
            return maxima
        reference = maxima[0]
        for _ in maxima:
            evidence = [self.log_evidence(points, m, reference.errors) for m in maxima]
            order = np.argsort(evidence)[::-1].tolist()
            if maxima[order[0]] is reference:
                break
            reference = maxima[order[0]]
        return [maxima[k] for k in order]

    def log_evidence(self, points: Points, maximum: Maximum, errors: Errors) -> float:
        """Return the log evidence about a maximum, with the errors of a state to compare by."""
        scales = maximum.scales
        rows = np.column_stack(
            [points.stresses - maximum.evaluation.stress, maximum.evaluation.jacobian]
        )
        white, log_det, _ = self.error_model.whitened(
            rows, errors, scales.roughness, scales.motion
        )
        precision = self._precision(maximum.state, scales)
        off = maximum.state - self.belief.mean
        normal = white[:, 1:].T @ white[:, 1:] + precision
        misfit = white[:, 0] @ white[:, 0] + off @ precision @ off
        return -0.5 * float(misfit + log_det + np.linalg.slogdet(normal)[1])

    def _averaged(
        self, points: Points, maximum: Maximum, grid: Sequence[WeighedScales] = ()
    ) -> Solution:
        """Return the mixture over the scales of a grid, by default all, from one linearisation."""
        rows = np.column_stack(
            [points.stresses - maximum.evaluation.stress, maximum.evaluation.jacobian]
        )
        priors = self._priors(maximum.state)
        off = self.belief.mean - maximum.state
        groups: dict[tuple[float, float], list[WeighedScales]] = {}
        for weighed in grid or self.grid:
            groups.setdefault(weighed.scales[2:], []).append(weighed)
        members: list[_Member] = []
        best_walk, best, residuals = None, -math.inf, rows[:, 0]
        for (roughness, motion), group in groups.items():
            white, log_det, walk = self.error_model.whitened(
                rows, maximum.errors, roughness, motion
            )
            data, towards = white[:, 1:].T @ white[:, 1:], white[:, 1:].T @ white[:, 0]
            square = float(white[:, 0] @ white[:, 0]) + log_det
            precisions = np.array([priors.precision(w.scales) for w in group])
            pulls = precisions @ off
            normals, gradients = data + precisions, towards + pulls
            if self._held is not None:
                normals[:, self._held], normals[:, :, self._held] = 0.0, 0.0
                normals[:, self._held, self._held], gradients[:, self._held] = 1.0, 0.0
            unit = 1.0 / np.sqrt(np.diagonal(normals, axis1=1, axis2=2))
            factors = np.linalg.cholesky(normals * unit[:, :, None] * unit[:, None, :])
            halves = np.linalg.solve(factors, (unit * gradients)[:, :, None])[:, :, 0]
            volumes = np.log(np.diagonal(factors, axis1=1, axis2=2) / unit).sum(axis=1)
            log_priors = [w.log_prior + 0.5 * priors.log_determinant(w.scales) for w in group]
            evidence = log_priors - volumes
            evidence += 0.5 * (np.sum(halves**2, axis=1) - square - pulls @ off)
            members += map(_Member, evidence, [w.scales for w in group], factors, halves, unit)
            if evidence.max() > best:
                best, best_walk, residuals = float(evidence.max()), walk, white[:, 0]
        if best_walk is None:
            raise FloatingPointError("no scale of the errors has a finite evidence")
        return self._mixture(maximum, members, best, residuals, best_walk)

    def evidence(self, points: Points, maximum: Maximum, grid: Sequence[Scales]) -> list[float]:
        """Return the log evidence of single scales, from the linearisation at a maximum."""
        posterior = Posterior(
            self.model, self.error_model, self.belief, (), has_field_prior=self._has_field_prior
        )
        found = []
        for scales in grid:
            posterior.grid = (WeighedScales(_floored(scales), 0.0),)
            found.append(posterior._averaged(points, maximum).log_evidence)
        return found

    def _mixture(
        self,
        maximum: Maximum,
        members: list[_Member],
        best: float,
        residuals: Array,
        walk: WalkState,
    ) -> Solution:
        members = [m for m in members if m.log_evidence > best - _NEGLIGIBLE]
        weights = np.exp([m.log_evidence - best for m in members])
        total = float(weights.sum())
        weights /= total
        inverses = np.linalg.inv(np.array([m.factor for m in members]))
        inverses *= np.array([m.unit for m in members])[:, None, :]
        halves = np.array([m.half for m in members])
        about = maximum.state + np.einsum("kij,ki->kj", inverses, halves)
        mean: Array = weights @ about
        spread = np.sqrt(weights)[:, None, None] * inverses
        flat = spread.reshape(-1, self.model.size)
        apart = np.sqrt(weights)[:, None] * (about - mean)
        covariance = flat.T @ flat + apart.T @ apart
        known = np.flatnonzero(self._fixed)
        covariance[known], covariance[:, known] = 0.0, 0.0
        return Solution(
            maximum,
            mean,
            covariance,
            {m.scales: float(w) for w, m in zip(weights, members, strict=True)},
            best + math.log(total),
            residuals,
            walk,
        )


def _floored(scales: Scales) -> Scales:
    """Return scales of which the smooth errors have a prior of their own."""
    return scales._replace(
        kernel=max(scales.kernel, _LEAST_SCALE),
        characteristic=max(scales.characteristic, _LEAST_SCALE),
    )


class _Member(NamedTuple):
    """The posterior at one place of the grid of scales."""

    log_evidence: float
    scales: Scales
    factor: Array  #: Cholesky's, of the scaled normal matrix
    half: Array  #: the factor's solution for the gradient
    unit: Array  #: scales of the unknowns


def _solved(normal: Array, towards: Array) -> Array:
    """Return the solution of scaled normal equations."""
    scale = 1.0 / np.sqrt(normal.diagonal())
    result: Array = scale * np.linalg.solve(normal * np.outer(scale, scale), scale * towards)
    return result
