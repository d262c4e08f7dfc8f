# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The paper's filter: recursive estimation on the fractional stress, in a room of its own.

A Gaussian sum of extended Kalman filters.

The observation is the fractional stress :math:`f'_k = D^{-\alpha} f = \varphi(x_k; G, G_n) + v_k`
(paper, Appendix F). A single filter commits itself before the strain passes :math:`1/G_n`, where
:math:`G_n` is not observable, and never recovers; a sum of filters, each started at its own
:math:`\ln G_n`, does not (Alspach and Sorenson, IEEE Trans. Autom. Control 17 (1972) 439).

State of each member: :math:`(\ln G, \ln G_n, o, b)`, with o the strain origin and b the bias of
the stress, nuisances that are known at best as well as the touch was seen and the sensor was
tared:

.. math::
    f'_k = \varphi\bigl(x(u_k - o); G, G_n\bigr) + b\,\frac{t_k^\alpha}{\Gamma(1+\alpha)} + v_k,
    \qquad R_k = 0.9\,\sigma^2 \frac{t_k^{2\alpha}}{(1+2\alpha)\,\Gamma(1+\alpha)^2}

u is the compression, :math:`t_k` the time since the memory began. :math:`R_k` stands for the
coloured noise that white force noise
:math:`\sigma` per sample becomes; a mean over m samples has :math:`R_k/m`.

alpha is not estimated here (choosing it by the residual of f' is a trap: the noise shrinks with
alpha). Its uncertainty counts all the same: the sensitivity :math:`s = d\hat\theta/d\alpha` of the
estimate is carried along,
:math:`s \leftarrow (I - KH)s + K\,\partial f'/\partial\alpha`, and adds :math:`s s^T
\sigma_\alpha^2` to the covariance (consider analysis: Tapley, Schutz and Born, Statistical Orbit
Determination, 2004, ch. 6).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import ndtr

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.claims import converged, determined
from fden_ros.core.estimation.estimate import Estimate
from fden_ros.core.estimation.estimator import Block, Estimator, Innovation
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.law.characteristic import elastic_response
from fden_ros.core.law.geometry import Geometry
from fden_ros.core.law.relaxation import memory_weights

if TYPE_CHECKING:
    from filterpy.kalman import ExtendedKalmanFilter

#: Places in the state of a member, which has no alpha: not those of StateIndex.
_LOG_G, _LOG_GN, _ORIGIN, _BIAS = range(4)
#: Members stand at most this far apart in ln Gn [1], each with this standard deviation [1]: about
#: half the distance, so that their sum is smooth.
_MEMBER_SPACING = 0.1125
_MEMBER_SD = 0.06
#: Half the range of the members in prior standard deviations of ln Gn [1]: nine members stand for
#: the deviation of 0.2, and their sum has it within 5 % (test_core_estimator).
_GRID_HALF_WIDTH = 2.25
#: A member whose weight is below e to the minus this [1] beside the best one is dropped: it counts
#: nothing, costs time, and may wander to where its numbers lose all meaning.
_HOPELESS = 1000.0
#: ln G and ln Gn [1] of a member that runs away stop here.
_LOG_LIMIT = 50.0
#: Least variance of ln G and ln Gn [1], where rounding has left none.
_LEAST_VARIANCE = 1e-30
#: Added to a standard deviation of ln Gn [1] that may be 0, before it divides.
_TINY_DEVIATION = 1e-12
#: Share of the white-noise variance [1] that remains in f' where the information is, measured on
#: simulated ramps.
_NOISE_SHARE = 0.9
#: Half the distance [1] between the orders whose difference is df'/dalpha, and the least order:
#: 0.5 % of the range of alpha.
_ORDER_STEP, _LEAST_ORDER = 0.005, 1e-6


class _Observed(NamedTuple):
    """What the members take of a block."""

    compression: float  #: u, from the nominal strain origin [1]
    fractional_stress: float  #: f' [Pa s^alpha]
    by_order: float  #: df'/dalpha [Pa s^alpha]


class _Member:
    """One extended Kalman filter with its weight and its sensitivity to alpha."""

    def __init__(self, start: Array, covariance: Array, log_weight: float) -> None:
        # Importing it takes as long as all the rest of the core, and most never need it.
        from filterpy.kalman import ExtendedKalmanFilter

        self.filter = ExtendedKalmanFilter(dim_x=start.size, dim_z=1)
        self.filter.x = start.copy()
        self.filter.P = covariance.copy()
        self.log_weight = log_weight
        self.sensitivity = np.zeros(start.size)
        self.log_weight_sensitivity = 0.0


class FractionalStressEstimator(Estimator):
    """The Gaussian sum.

    The blocks' memory holds all of the past, so that motion, rest and relinearisation are nothing
    to this estimator. The noise of the fractional stress is coloured: its innovations prove
    neither a mismatch nor a change.

    Parameters
    ----------
    config : EstimatorConfig
    geometry : Geometry
        For the strain at a compression.
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    origin_sd : float
        Standard deviation of the strain origin [1]; 0: known.
    """

    def __init__(
        self,
        config: EstimatorConfig,
        geometry: Geometry,
        noise_sd: float,
        origin_sd: float = 0.0,
    ) -> None:
        self._config = config
        self._geometry = geometry
        prior = config.prior
        self._order = order = prior.fractional_order
        above, below = order + _ORDER_STEP, max(order - _ORDER_STEP, _LEAST_ORDER)
        self._at_order = memory_weights(order)
        self._by_order = (memory_weights(above) - memory_weights(below)) / (above - below)
        self._gamma = math.gamma(1.0 + self._order)
        self._noise_variance = (
            _NOISE_SHARE * noise_sd**2 / ((1.0 + 2.0 * self._order) * self._gamma**2)
        )
        spread = prior.nonlinear_stiffness_log_sd
        half_width = _GRID_HALF_WIDTH * spread
        count = 2 * math.ceil(half_width / _MEMBER_SPACING) + 1
        variance = np.diag([prior.linear_stiffness_log_sd**2, _MEMBER_SD**2, origin_sd**2, 0.0])
        centre = math.log(prior.nonlinear_stiffness)
        self._members = [
            _Member(
                np.array([math.log(prior.linear_stiffness), centre + offset, 0.0, 0.0]),
                variance,
                -0.5 * (offset / spread) ** 2 if spread > 0.0 else 0.0,
            )
            for offset in np.linspace(-half_width, half_width, count)
        ]
        self._max_compression = 0.0
        self._sample_count = 0

    def begin_contact(self, bias_sd: float, drift_sd: float) -> None:
        """Let the bias [Pa] be as uncertain as that of the first contact; there is no drift."""
        if self._sample_count == 0:
            for member in self._members:
                member.filter.P[_BIAS, _BIAS] = bias_sd**2

    def update(self, block: Block) -> Innovation:
        """Take one block; return how it compared with the mixture's prediction."""
        observed = _Observed(
            compression=block.compression,
            fractional_stress=float(self._at_order @ block.memory),
            by_order=float(self._by_order @ block.memory),
        )
        growth = block.memory_time**self._order
        noise = self._noise_variance * growth**2 / block.size
        bias_gain = growth / self._gamma
        weights = self._weights()
        members = [self._update_member(m, observed, bias_gain, noise) for m in self._members]
        self._max_compression = max(self._max_compression, block.compression)
        self._sample_count += block.size
        predicted = float(
            sum(w * m.predicted_fractional_stress for w, m in zip(weights, members, strict=True))
        )
        variance = float(
            sum(
                w * (m.variance + (m.predicted_fractional_stress - predicted) ** 2)
                for w, m in zip(weights, members, strict=True)
            )
        )
        self._drop_hopeless_members()
        return Innovation(predicted, None, observed.fractional_stress - predicted, variance)

    def _drop_hopeless_members(self) -> None:
        least = max(member.log_weight for member in self._members) - _HOPELESS
        self._members = [member for member in self._members if member.log_weight >= least]

    def _update_member(
        self, member: _Member, observed: _Observed, bias_gain: float, noise: float
    ) -> Innovation:
        log_g, log_gn, origin, bias = member.filter.x
        compression = observed.compression - origin
        response = elastic_response(
            self._geometry.strain(compression), math.exp(log_g), math.exp(log_gn)
        )
        predicted = response.value + bias * bias_gain
        jacobian = np.array(
            [
                [
                    response.value,
                    response.by_log_nonlinear_stiffness,
                    -response.by_strain * self._geometry.strain_slope(compression),
                    bias_gain,
                ]
            ]
        )
        _keep_positive(member.filter, jacobian[0])
        member.filter.update(
            np.array([observed.fractional_stress]),
            lambda _: jacobian,
            lambda _: np.array([predicted]),
            R=noise,
        )
        _keep_finite(member.filter)
        innovation = float(member.filter.y[0])
        variance = max(float(member.filter.S[0, 0]), noise)
        member.log_weight -= 0.5 * (innovation**2 / variance + math.log(variance))
        by_order = observed.by_order - float(jacobian[0] @ member.sensitivity)
        member.sensitivity = member.sensitivity + member.filter.K[:, 0] * by_order
        member.log_weight_sensitivity -= innovation / variance * by_order
        return Innovation(predicted, None, innovation, variance)

    def _weights(self) -> Array:
        log_weights = np.array([member.log_weight for member in self._members])
        weights: Array = np.exp(log_weights - log_weights.max())
        weights /= weights.sum()
        return weights

    def estimate(self) -> Estimate:
        """Return the mixture's mean and covariance, alpha's own uncertainty included."""
        prior = self._config.prior
        weights = self._weights()
        means = np.array([member.filter.x for member in self._members])
        covariances = np.array([member.filter.P for member in self._members])
        mean = weights @ means
        centred = means - mean
        covariance = np.einsum("i,ijk->jk", weights, covariances)
        covariance += np.einsum("i,ij,ik->jk", weights, centred, centred)
        covariance = 0.5 * (covariance + covariance.T)
        sensitivity = self._sensitivity(weights, centred)
        order_variance = prior.fractional_order_sd**2
        covariance += np.outer(sensitivity, sensitivity) * order_variance
        joint = np.empty((3, 3))
        joint[:2, :2] = covariance[:2, :2]
        joint[:2, 2] = joint[2, :2] = sensitivity[:2] * order_variance
        joint[2, 2] = order_variance
        joint = _positive(joint)
        beyond = self._probability_beyond_boundary(weights, means, covariances)
        config = self._config
        deviations = np.sqrt(joint.diagonal())
        valid = determined(config, deviations, beyond)
        return Estimate(
            log_linear_stiffness=float(mean[_LOG_G]),
            log_nonlinear_stiffness=float(mean[_LOG_GN]),
            fractional_order=prior.fractional_order,
            covariance=joint,
            strain_origin=float(mean[_ORIGIN]),
            strain_origin_sd=math.sqrt(max(covariance[_ORIGIN, _ORIGIN], 0.0)),
            probability_beyond_boundary=beyond,
            valid=valid,
            known=converged(config, deviations, valid),
            sample_count=self._sample_count,
        )

    def _sensitivity(self, weights: Array, centred: Array) -> Array:
        """Return the derivative of the mean by alpha: of the members, and of their weights."""
        own = np.array([member.sensitivity for member in self._members])
        by_weight = np.array([member.log_weight_sensitivity for member in self._members])
        result: Array = weights @ own + (weights * (by_weight - weights @ by_weight)) @ centred
        return result

    def _probability_beyond_boundary(
        self, weights: Array, means: Array, covariances: Array
    ) -> float:
        total = 0.0
        for weight, mean, covariance in zip(weights, means, covariances, strict=True):
            strain = self._geometry.strain(self._max_compression - mean[_ORIGIN])
            if strain > 0.0:
                deviation = math.sqrt(covariance[_LOG_GN, _LOG_GN]) + _TINY_DEVIATION
                total += weight * float(ndtr((math.log(strain) + mean[_LOG_GN]) / deviation))
        return float(min(total, 1.0))


def _positive(covariance: Array) -> Array:
    """Return the nearest positive semidefinite matrix: rounding may have made it indefinite."""
    values, vectors = np.linalg.eigh(covariance)
    if values[0] >= 0.0:
        return covariance
    nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    result: Array = 0.5 * (nearest + nearest.T)
    return result


def _keep_positive(kalman: ExtendedKalmanFilter, jacobian: Array) -> None:
    """Drop the correlations of a covariance that rounding has made indefinite.

    That happens where a stiffness far beyond tissue makes the Jacobian enormous: such a member
    loses its weight, but must not stop the others.
    """
    variances = kalman.P.diagonal()
    if variances.min() < 0.0 or jacobian @ kalman.P @ jacobian < 0.0:
        kalman.P = np.diag(np.maximum(variances, 0.0))


def _keep_finite(kalman: ExtendedKalmanFilter) -> None:
    """Keep a member that runs away within numbers."""
    logs = kalman.x[: _LOG_GN + 1]
    np.clip(logs, -_LOG_LIMIT, _LOG_LIMIT, out=logs)
    variances = kalman.P.diagonal()
    if variances.min() < 0.0 or variances[: _LOG_GN + 1].min() == 0.0:
        least = [_LEAST_VARIANCE, _LEAST_VARIANCE, 0.0, 0.0]
        kalman.P = np.diag(np.maximum(variances, least))
