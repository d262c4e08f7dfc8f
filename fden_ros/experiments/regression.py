# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Least squares with covariances that hold when the noise differs from the assumption.

The covariance is the sandwich estimate HC3 (MacKinnon and White, J. Econometrics 29 (1985) 305),

.. math:: (J^T J)^{-1} \sum_i \frac{r_i^2}{(1-h_i)^2}\, j_i j_i^T\, (J^T J)^{-1} ,

with residuals r, rows j of the Jacobian and leverages h: it does not assume equal noise in all
rows. Where successive residuals are correlated, by the noise or because the
model does not follow the data, n rows contain less information: the covariance is widened by
:math:`(1+\rho)/(1-\rho)` with :math:`\rho` their first autocorrelation, and the degrees of
freedom shrink by as much. Means of 20 blocks show slower correlation.

A logarithm of noisy values is biased by :math:`-\sigma^2/2`: fits of logarithms add it back.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.experiments.result import Parameter, plain, positive

#: Fewer rows show no correlation.
_MIN_ROWS_FOR_CORRELATION = 20
_MAX_LEVERAGE = 0.99
#: With few independent rows the widening is an upper estimate; t need not add much.
_LEAST_DOF = 4.0
#: Blocks whose means show the length of correlation, of at least this many rows. Of white
#: residuals the ratio of variances is 1 with a deviation of 0.32.
_BLOCKS, _LEAST_BLOCK, _WHITE_RATIO = 20, 4, 1.65
#: Residuals here are relative: smaller ones need no warning.
_NEGLIGIBLE_RESIDUAL = 1e-4


class Solution(NamedTuple):
    """Parameters of a least-squares fit."""

    values: Array  #: (p,)
    covariance: Array  #: (p, p); NaN if there are no more rows than parameters
    dof: float  #: degrees of freedom behind the covariance, after correlation
    residuals: Array  #: observed less predicted (n,)
    correlation: float  #: first autocorrelation of the residuals if it is significant, otherwise 0

    @property
    def sds(self) -> Array:
        """Standard deviations (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, by the degrees of freedom."""
        freedom = max(self.residuals.size - self.values.size, 1)
        return math.sqrt(float(self.residuals @ self.residuals) / freedom)

    def plain(self, *gradient: float) -> Parameter:
        """Return the sum of the parameters times `gradient`."""
        return plain(*self._sum(gradient), self.dof)

    def positive(self, *gradient: float, log_value: float | None = None) -> Parameter:
        """Return the value whose logarithm is that sum, or `log_value` with that gradient."""
        value, sd = self._sum(gradient)
        return positive(value if log_value is None else log_value, sd, self.dof)

    def _sum(self, gradient: tuple[float, ...]) -> tuple[float, float]:
        """Return a sum of the parameters and its standard deviation."""
        row = np.pad(np.array(gradient, dtype=float), (0, self.values.size - len(gradient)))
        variance = float(row @ self.covariance @ row)
        sd = math.sqrt(max(variance, 0.0)) if math.isfinite(variance) else math.nan
        return float(row @ self.values), sd

    def warnings(self) -> tuple[str, ...]:
        """Return a warning if the residuals are correlated."""
        size = math.sqrt(float(np.mean(self.residuals**2)))
        if self.correlation < 0.5 or size < _NEGLIGIBLE_RESIDUAL:
            return ()
        factor = math.sqrt(_widening(self.correlation, self.residuals.size, self.values.size))
        return (
            f"neighbouring residuals are correlated ({self.correlation:.2f}): the model does not "
            f"describe all of the data; standard deviations are widened {factor:.1f} times",
        )


def require_positive(**values: Array) -> None:
    """Raise :class:`InputError` unless all values are positive and finite."""
    for name, array in values.items():
        wrong = ~(np.isfinite(array) & (array > 0.0))
        if wrong.any():
            raise InputError(
                f"{name} is {array[np.argmax(wrong)]:g} somewhere; it must be positive, because "
                "its logarithm is taken"
            )


def linear(design: Array, y: Array) -> Solution:
    """Fit `y` (n,) by the columns of `design` (n, p)."""
    values = np.asarray(np.linalg.lstsq(design, y, rcond=None)[0], dtype=float)
    return _solution(values, y - design @ values, design)


def line_through(x: Array, y: Array) -> Solution:
    """Fit ``y = values[0] x + values[1]``, both of shape (n,), by linear regression."""
    return linear(np.column_stack([x, np.ones_like(x)]), y)


def line_through_logarithms(x: Array, y: Array) -> Solution:
    """Fit ``log y = values[0] log x + values[1]``, corrected for the bias of log y."""
    first = line_through(np.log(x), np.log(y))
    return first._replace(
        values=first.values + np.array([0.0, _half_variance(first.residuals, 2)])
    )


def minimise(
    residuals: Callable[[Array], Array], start: Array, bounds: tuple[Array, Array]
) -> Solution:
    """Minimise the squares of `residuals` (n,), predicted less observed, from `start` (p,)."""
    found = least_squares(
        residuals, start, bounds=bounds, x_scale="jac",
        xtol=1e-11, ftol=1e-12, gtol=1e-14, max_nfev=200,
    )  # fmt: skip
    return _solution(found.x, -residuals(found.x), found.jac)


def minimise_logarithms(
    predicted: Callable[[Array], Array], logs: Array, start: Array, low: Array, high: Array
) -> Solution:
    """Fit `predicted` to logarithms (n,) within bounds, corrected for their bias."""
    start, shift = np.clip(start, low + 1e-3, high - 1e-3), 0.0
    for _ in range(2):
        solution = minimise(lambda v, s=shift: predicted(v) - logs - s, start, (low, high))  # type: ignore[misc]
        start, shift = solution.values, _half_variance(solution.residuals, start.size)
    return solution


def _half_variance(residuals: Array, parameters: int) -> float:
    """Return sigma²/2 of the residuals of a fit of logarithms; 0 without degrees of freedom."""
    dof = residuals.size - parameters
    return 0.5 * float(residuals @ residuals) / dof if dof > 0 else 0.0


def _first_correlation(residuals: Array) -> float:
    """Return the first autocorrelation of `residuals` (n,); 0 if white noise could cause it."""
    power = max(float(residuals @ residuals), 1e-300)
    correlation = float(residuals[1:] @ residuals[:-1]) / power
    is_clear = correlation > 2.0 / math.sqrt(residuals.size)
    return correlation if is_clear and residuals.size >= _MIN_ROWS_FOR_CORRELATION else 0.0


def _widening(correlation: float, rows: int, parameters: int) -> float:
    factor = (1.0 + correlation) / max(1.0 - correlation, 1e-12)
    return min(factor, rows / (parameters + 1.0))


def _slow_widening(residuals: Array) -> float:
    """Return the ratio of the variance of block means to that of white residuals."""
    size, variance = residuals.size // _BLOCKS, float(np.var(residuals))
    if size < _LEAST_BLOCK or variance <= 0.0:
        return 1.0
    means = residuals[: size * _BLOCKS].reshape(_BLOCKS, size).mean(axis=1)
    ratio = size * float(np.var(means)) / variance
    return ratio if ratio > _WHITE_RATIO else 1.0


def _solution(values: Array, residuals: Array, jacobian: Array) -> Solution:
    rows, parameters = residuals.size, values.size
    try:
        bread = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        rows = 0
    if rows <= parameters:
        return Solution(values, np.full((parameters,) * 2, np.nan), 0.0, residuals, 0.0)
    leverage = np.minimum(np.einsum("ij,jk,ik->i", jacobian, bread, jacobian), _MAX_LEVERAGE)
    weighted = jacobian * (residuals / (1.0 - leverage))[:, None]
    correlation = _first_correlation(residuals)
    factor = max(_widening(correlation, rows, parameters), _slow_widening(residuals))
    meat = factor * weighted.T @ weighted
    dof = max(rows / factor - parameters, min(rows - parameters, _LEAST_DOF))
    return Solution(values, bread @ meat @ bread, dof, residuals, correlation)
