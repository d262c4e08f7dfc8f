# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The result of a fit: parameters with uncertainty, R² and warnings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import stdtrit

from fden_ros.core.arrays import Array

#: Of an interval that covers the truth in 95 % [standard deviations].
_NORMAL_REACH = 1.959964


class Parameter(NamedTuple):
    """One fitted number; deviation and interval are NaN where the data leave none."""

    value: float
    sd: float  #: standard deviation of the normal law with the same interval
    low: float  #: lower end of the 95 % interval
    high: float  #: upper end of the 95 % interval


@dataclass(frozen=True)
class Fit:
    """The outcome of one experiment."""

    kind: str  #: as in ``fden fit KIND``
    #: ``alpha`` [1], ``g`` [Pa s^alpha], ``g_n`` [1], and what else the experiment gives:
    #: ``x_c`` [s^-alpha], ``f_c``, ``g_i`` [Pa s^alpha], ``x_b`` [1].
    parameters: Mapping[str, Parameter]
    r_squared: float  #: coefficient of determination; NaN if the data do not vary
    samples: int  #: rows that the fit used
    warnings: tuple[str, ...] = ()  #: contradictions of the model or the reading, a line each

    def __getitem__(self, name: str) -> Parameter:
        """Return one parameter."""
        return self.parameters[name]

    def as_object(self) -> dict[str, Any]:
        """Return the JSON object: ``alpha``, ``g``, ``g_n`` with ``_sd`` always; null: unknown."""
        nothing = Parameter(*[math.nan] * 4)
        always = {name: nothing for name in ("alpha", "g", "g_n")}
        return {
            "kind": self.kind,
            "samples": self.samples,
            **_flat({**always, **self.parameters}),
            "r2": _finite(self.r_squared),
            "warnings": list(self.warnings),
        }


def plain(value: float, sd: float = math.nan, dof: float = math.inf) -> Parameter:
    """Return a parameter with the interval of Student's t at `dof` degrees of freedom.

    Its deviation is the interval's, so few degrees of freedom widen that too.
    """
    reach = _quantile(dof) * sd
    return Parameter(float(value), float(reach / _NORMAL_REACH), value - reach, value + reach)


def positive(log_value: float, log_sd: float = math.nan, dof: float = math.inf) -> Parameter:
    """Return a positive parameter from its logarithm; the interval is symmetric in the log."""
    value, reach = math.exp(log_value), _quantile(dof) * log_sd
    with np.errstate(over="ignore"):
        low, high = np.exp([log_value - reach, log_value + reach]).tolist()
    return Parameter(value, float(value * reach / _NORMAL_REACH), low, high)


def undetermined(parameters: Mapping[str, Parameter]) -> tuple[str, ...]:
    """Return a warning for each parameter whose deviation exceeds its magnitude."""
    return tuple(
        f"{name} is {p.value:.3g} with an sd of {p.sd:.3g}: the data do not determine it"
        for name, p in parameters.items()
        if p.sd > abs(p.value)
    )


def r_squared(observed: Array, predicted: Array) -> float:
    """Return 1 - SSR/SST, the columns of (n,) or (n, m) arrays each about its own mean."""
    total = float(np.sum((observed - observed.mean(axis=0)) ** 2))
    return 1.0 - float(np.sum((observed - predicted) ** 2)) / total if total > 0.0 else math.nan


def _quantile(dof: float) -> float:
    if math.isinf(dof):
        return _NORMAL_REACH
    return float(stdtrit(dof, 0.975)) if dof > 0.0 else math.nan


def _flat(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for name, parameter in parameters.items():
        result[name] = _finite(parameter.value)
        result[f"{name}_sd"] = _finite(parameter.sd)
        ends = [_finite(parameter.low), _finite(parameter.high)]
        result[f"{name}_interval"] = None if None in ends else ends
    return result


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
