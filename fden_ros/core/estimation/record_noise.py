# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The error of a record's stress: its noise, its roughness, and what the rig leaves out."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.bent_law import BentLaw
from fden_ros.core.estimation.contact_record import ContactRecord
from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.estimator_config import Uncertainty
from fden_ros.core.estimation.unmodelled import (
    FRICTION_SPEED,
    SURFACE_TIME,
    rig_error_variance,
)
from fden_ros.core.law.characteristic import (
    apparent_stiffness_factor,
    elastic_responses,
)
from fden_ros.core.law.geometry import Geometry

#: Error of the stress beside both deviations, as a share of its peak [1]: with 0.003, 8 presses of
#: beef are as far off where they are loaded as all silicone is, instead of 6.
_ROUGHNESS = 0.005
#: Error of the stress of a step, as a share of its change over the step [1]: the motion in between
#: is taken for straight, and a corner in it is not known. Without it fast ramps of tissue that is
#: the law's, in ten steps, are a mismatch.
_STEP_ROUGHNESS = 0.05
#: A breath takes 4 s: its radian [s].
_BREATH = 4.0 / (2.0 * math.pi)


class Whitening(NamedTuple):
    """Turns the errors of a record into independent ones of variance 1."""

    factor: Array  #: lower Cholesky factor of their covariance [Pa], shape (n, n)
    log_volume: float  #: logarithm of its determinant

    def whiten(self, residual: Array, jacobian: Array) -> tuple[Array, Array]:
        """Return residual (n,) and Jacobian (n, m) in standard deviations of the errors."""
        both = np.column_stack([residual, jacobian])
        whitened = solve_triangular(self.factor, both, lower=True, check_finite=True)
        return whitened[:, 0], whitened[:, 1:]


class RecordNoise:
    """The covariance of the error of the stress over a record.

    Parameters
    ----------
    record : ContactRecord
        Of n + 1 points.
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    geometry : Geometry
    uncertainty : Uncertainty
        Of the rig.
    law : BentLaw
        Of the record.
    start : ndarray, shape (4,)
        ln G, ln Gn, alpha and strain origin, where the stiffness that the rig works against is
        taken.
    """

    def __init__(
        self,
        record: ContactRecord,
        noise_sd: float,
        geometry: Geometry,
        uncertainty: Uncertainty,
        law: BentLaw,
        start: Array,
    ) -> None:
        _, compressions, stresses, shares = record.arrays()
        self._geometry, self._uncertainty = geometry, uncertainty
        self._compressions, self._stresses = compressions[1:], stresses[1:]
        self._steps = law.steps
        peak = float(np.max(np.abs(stresses)))
        rough = np.hypot(_ROUGHNESS * peak, _STEP_ROUGHNESS * np.diff(stresses))
        self._white = noise_sd**2 * shares[1:] + rough**2
        elastic = elastic_responses(
            law.strains(start[StateIndex.STRAIN_ORIGIN]),
            math.exp(start[StateIndex.LOG_LINEAR_STIFFNESS]),
            math.exp(start[StateIndex.LOG_NONLINEAR_STIFFNESS]),
        )
        relaxed = apparent_stiffness_factor(
            float(start[StateIndex.FRACTIONAL_ORDER]), SURFACE_TIME
        )
        #: Of the tissue, as memoryless [Pa/m].
        self._stiffness: Array = elastic.by_strain * relaxed / geometry.length

    def whitening(self, walk: float = 1.0, wave: float = 0.0) -> Whitening:
        """Return what whitens the errors, with more motion of the surface than is stated.

        Parameters
        ----------
        walk, wave : float
            Scale of the walk, and deviation of the wave, both in the stated motion [1].
        """
        stated = self._uncertainty.surface_motion_sd
        moving = replace(self._uncertainty, surface_motion_sd=walk * stated)
        covariance = np.diag(self._white) + self._rig_covariance(moving, wave * stated)
        factor = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        return Whitening(factor, float(np.sum(np.log(factor.diagonal()))))

    def _rig_covariance(self, uncertainty: Uncertainty, wave: float) -> Array:
        """Return the covariance of the stress that the rig leaves out, memoryless (n, n)."""
        scale, stiffness = self._geometry.stress_per_force, self._stiffness
        grown = np.cumsum(
            [
                rig_error_variance(uncertainty, self._geometry, step, k)
                for step, k in zip(self._steps.tolist(), stiffness.tolist(), strict=True)
            ]
        )
        speed = np.diff(self._compressions, prepend=0.0) * self._geometry.length / self._steps
        columns = np.array(
            [
                uncertainty.compliance_sd * stiffness * self._stresses / scale,
                uncertainty.delay_sd * stiffness * speed,
                uncertainty.friction_sd * scale * speed / np.hypot(speed, FRICTION_SPEED),
            ]
        )
        covariance: Array = np.minimum.outer(grown, grown) + columns.T @ columns
        if wave > 0.0:
            covariance += np.outer(wave * stiffness, wave * stiffness) * self._wave()
        return covariance

    def _wave(self) -> Array:
        """Return the covariance of a smooth motion since the touch, of deviation 1, (n, n)."""
        times = np.cumsum(self._steps)
        since_touch = np.exp(-0.5 * (times / _BREATH) ** 2)
        between = np.exp(-0.5 * (np.subtract.outer(times, times) / _BREATH) ** 2)
        moved: Array = between - since_touch[:, None] - since_touch + 1.0
        return moved
