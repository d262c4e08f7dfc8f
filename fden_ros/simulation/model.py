# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The parameters of simulated tissue, and its elastic characteristic phi."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fden_ros.errors import InputError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class FdenModel:
    """Parameters of one tissue, and its elastic characteristic phi.

    Parameters
    ----------
    linear_stiffness
        G in Pa·s^alpha, positive.
    nonlinear_stiffness
        Gn, dimensionless, positive; its inverse is the boundary strain.
    fractional_order
        alpha, in (0, 1).

    Raises
    ------
    InputError
        If a parameter is outside its range.
    """

    linear_stiffness: float
    nonlinear_stiffness: float
    fractional_order: float

    def __post_init__(self) -> None:
        for name in ("linear_stiffness", "nonlinear_stiffness"):
            value = getattr(self, name)
            if not (value > 0.0 and np.isfinite(value)):
                raise InputError(f"tissue: {name} is {value}; it must be positive")
        if not 0.0 < self.fractional_order < 1.0:
            raise InputError(
                f"tissue: fractional_order is {self.fractional_order}; it must lie between 0 and 1"
            )

    @property
    def boundary_strain(self) -> float:
        """Strain 1/Gn at which the characteristic turns from linear to exponential."""
        return 1.0 / self.nonlinear_stiffness

    def phi(self, strain: ArrayLike) -> FloatArray:
        """Return phi(strain) in Pa·s^alpha (eqs. 1 and 2)."""
        x = np.asarray(strain, dtype=float)
        excess = np.maximum(self.nonlinear_stiffness * np.abs(x) - 1.0, 0.0)
        limited = np.clip(x, -self.boundary_strain, self.boundary_strain)
        return self.linear_stiffness * limited * np.exp(excess)

    def phi_derivative(self, strain: ArrayLike) -> FloatArray:
        """Return dphi/dstrain in Pa·s^alpha; continuous at the boundary strain."""
        x = np.asarray(strain, dtype=float)
        excess = np.maximum(self.nonlinear_stiffness * np.abs(x) - 1.0, 0.0)
        return self.linear_stiffness * np.exp(excess)

    def strain_of_phi(self, value: ArrayLike) -> FloatArray:
        """Return the strain at which phi takes `value`: the inverse of :meth:`phi`."""
        scaled = np.asarray(value, dtype=float) / self.linear_stiffness
        inside = np.clip(scaled, -self.boundary_strain, self.boundary_strain)
        ratio = np.maximum(np.abs(scaled) * self.nonlinear_stiffness, 1.0)
        return inside * (1.0 + np.log(ratio))

    def branch(self, strain: float) -> int:
        """Return 0 where the characteristic is linear at `strain`, else the sign of the strain."""
        if abs(strain) <= self.boundary_strain:
            return 0
        return 1 if strain > 0.0 else -1

    def slope_on_branch(self, strain: FloatArray, branch: int) -> FloatArray:
        """Return dphi/dstrain of one branch of phi, continued analytically beyond its range."""
        if branch == 0:
            return np.full_like(strain, self.linear_stiffness)
        exponent = branch * self.nonlinear_stiffness * strain - 1.0
        return self.linear_stiffness * np.exp(exponent)
