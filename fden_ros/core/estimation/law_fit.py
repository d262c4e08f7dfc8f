# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The fit of a law, of how it is bent and of what the surface does, to one contact from rest.

G, Gn, alpha and strain origin are fitted together with the deviations delta and epsilon
(:mod:`fden_ros.core.estimation.bent_law`), each with a scale found by the evidence (MacKay's fixed
point). What the rig leaves out is part of the noise.

References
----------
Kennedy and O'Hagan, J. R. Statist. Soc. B 63 (2001) 425. MacKay, Neural Computation 4 (1992) 415.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.bent_law import (
    CHARACTERISTIC,
    KERNEL,
    KNOTS,
    LAW,
    BentLaw,
    stepped,
)
from fden_ros.core.estimation.contact_record import ContactRecord
from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.estimator_config import Prior, Uncertainty
from fden_ros.core.estimation.law_deviation import LawDeviation, law_deviation
from fden_ros.core.estimation.motion_search import FoundMotion, MotionSearch
from fden_ros.core.estimation.record_noise import RecordNoise
from fden_ros.core.law.geometry import Geometry

#: Scales at the beginning and their least and largest value [1]: silicone wants 0.9.
_FIRST_SCALES, _LEAST_SCALE, _MOST_SCALE = (0.3, 0.5), 0.005, 1.0
#: Deviation of alpha in the fit [1], whichever is given: where it is wrong, the kernel would bend.
_ORDER_MEAN, _ORDER_SD = 0.2, 0.15
#: Kernel and scales change little after this many rounds of solving for one and the other [1].
_ROUNDS, _STEPS, _TRIALS = 8, 12, 8
#: A round ends when a step lowers minus twice the log-posterior by less than this [1].
_CLOSE = 0.01
#: Least deviation of the strain origin [1], one that is given included: with 1e-6 twice as many
#: presses of beef are a mismatch.
_LEAST_ORIGIN_SD = 0.003
#: Points below which nothing is fitted [1].
_LEAST_POINTS = 20


class LawFit:
    """The fit to one record.

    Parameters
    ----------
    record : ContactRecord
        Of at least 20 points.
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    geometry : Geometry
    prior : Prior
    uncertainty : Uncertainty
        Of the rig.
    start : ndarray, shape (4,)
        ln G, ln Gn, alpha and strain origin.
    origin_sd : float
        Standard deviation of the strain origin [1].

    Raises
    ------
    ValueError
        If the record is too short.
    """

    def __init__(
        self,
        record: ContactRecord,
        noise_sd: float,
        geometry: Geometry,
        prior: Prior,
        uncertainty: Uncertainty,
        start: Array,
        origin_sd: float,
    ) -> None:
        if not is_enough(record):
            raise ValueError(f"{len(record)} points; at least {_LEAST_POINTS} make a fit")
        self._law = BentLaw(record, geometry)
        self._mean = np.zeros(CHARACTERISTIC.stop)
        self._mean[LAW] = [*prior.mean[:2], _ORDER_MEAN, 0.0]
        deviations = [*prior.deviations[:2], _ORDER_SD, max(origin_sd, _LEAST_ORIGIN_SD)]
        self._precision = np.zeros((self._mean.size, self._mean.size))
        self._precision[LAW, LAW] = np.diag(np.array(deviations) ** -2.0)
        self._state = np.zeros_like(self._mean)
        self._state[LAW] = start
        self._covariance: Array = np.zeros_like(self._precision)
        self._log_evidence = self._curve_evidence = 0.0
        noise = RecordNoise(record, noise_sd, geometry, uncertainty, self._law, start)
        self._whitening = noise.whitening()
        self._motion: FoundMotion | None = None
        self._motion_evidence = math.inf
        self._regards_motion = uncertainty.surface_motion_sd > 0.0
        self._search = MotionSearch(
            self._law,
            noise,
            self._state,
            self._mean[LAW],
            self._precision[LAW, LAW],
            float(prior.deviations[StateIndex.FRACTIONAL_ORDER]),
        )

    def steps(self) -> Iterator[None]:
        """Fit, one Gauss-Newton step at a time.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the normal equations are singular.
        """
        if self._regards_motion:
            self._motion = yield from self._search.steps()
        law = self._law
        kernel_scale, characteristic_scale = _FIRST_SCALES
        for _ in range(_ROUNDS):
            self._precision[KERNEL, KERNEL] = law.kernel_precision / kernel_scale**2
            self._bend_characteristic(characteristic_scale)
            yield from self._solve()
            kernel_scale = self._scale(KERNEL, law.kernel_precision)
            characteristic_scale = self._scale(CHARACTERISTIC, law.characteristic_precision)
        bent, state, covariance = self._log_evidence, self._state, self._covariance
        if self._motion is not None:
            self._motion_evidence = bent - self._motion.log_evidence
        self._bend_characteristic(_LEAST_SCALE)
        yield from self._solve()
        self._curve_evidence = bent - self._log_evidence
        self._state, self._covariance = state, covariance

    def _bend_characteristic(self, scale: float) -> None:
        """Let the characteristic bend by a scale [1]."""
        self._precision[CHARACTERISTIC, CHARACTERISTIC] = (
            self._law.characteristic_precision / scale**2
        )

    def motion_evidence(self, scales: Sequence[float]) -> list[float]:
        """Return the logarithm of the evidence for scales of the surface's motion.

        By Laplace's approximation at the maximum for each, without any deviation from the law: to
        be called instead of the steps.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the normal equations are singular.
        """
        return self._search.log_evidence(scales)

    def result(self) -> LawDeviation:
        """Return the deviations after the last step."""
        return law_deviation(
            self._law,
            self._state,
            self._covariance,
            self._curve_evidence,
            self._motion_evidence,
            None if self._motion is None else self._motion.covariance,
        )

    def _solve(self) -> Iterator[None]:
        """Find the maximum of the posterior at the present scales (Levenberg, Marquardt)."""
        residual, jacobian = self._respond(self._state)
        cost = self._cost(self._state, residual)
        damping = 0.0
        for _ in range(_STEPS):
            hessian = jacobian.T @ jacobian + self._precision
            gradient = jacobian.T @ residual - self._precision @ (self._state - self._mean)
            for _ in range(_TRIALS):
                damped = hessian + damping * np.diag(hessian.diagonal())
                tried = stepped(self._state, cho_solve(cho_factor(damped), gradient))
                tried_residual, tried_jacobian = self._respond(tried)
                tried_cost = self._cost(tried, tried_residual)
                yield
                if tried_cost < cost:
                    break
                damping = max(4.0 * damping, 1e-3)
            else:
                break
            gain, cost = cost - tried_cost, tried_cost
            self._state, residual, jacobian = tried, tried_residual, tried_jacobian
            damping *= 0.25
            if gain < _CLOSE:
                break
        hessian = jacobian.T @ jacobian + self._precision
        self._covariance = np.linalg.inv(hessian)
        # By Laplace's approximation.
        volume = np.linalg.slogdet(self._precision)[1] - np.linalg.slogdet(hessian)[1]
        self._log_evidence = 0.5 * (float(volume) - cost) - self._whitening.log_volume

    def _respond(self, state: Array) -> tuple[Array, Array]:
        """Return residual and Jacobian in standard deviations of the noise, (n,) and (n, 22)."""
        return self._whitening.whiten(*self._law.residual(state))

    def _cost(self, state: Array, residual: Array) -> float:
        off = state - self._mean
        return float(residual @ residual + off @ self._precision @ off)

    def _scale(self, part: slice, unit: Array) -> float:
        """Return the scale of a deviation that the evidence wants."""
        value = self._state[part]
        square = float(value @ unit @ value + np.sum(unit * self._covariance[part, part]))
        return min(max(math.sqrt(square / KNOTS), _LEAST_SCALE), _MOST_SCALE)


def is_enough(record: ContactRecord) -> bool:
    """Whether a record has points enough for a fit."""
    return len(record) >= _LEAST_POINTS
