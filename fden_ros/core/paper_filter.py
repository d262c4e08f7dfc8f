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

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import (
    Block,
    Component,
    Estimate,
    Estimator,
    EstimatorConfig,
    Innovation,
    converged,
    determined,
    moments,
    positive,
    probability_beyond,
)
from fden_ros.core.law import (
    MAX_EXPONENT,
    Geometry,
    elastic_response,
    memory_slopes,
    memory_weights,
)

#: Places in the state of a member, which has no alpha: not those of StateIndex.
_LOG_G, _LOG_GN, _ORIGIN, _BIAS = range(4)
#: Standard deviation of ln Gn of a member [1]; they are at most twice that apart, so that their
#: sum is smooth.
_MEMBER_SD = 0.06
#: Half the range of the members in prior standard deviations of ln Gn [1]: nine members stand for
#: the deviation of 0.2, and their sum has it within 5 % (test_core_paper_filter).
_GRID_HALF_WIDTH = 2.25
#: Share of the white-noise variance [1] that remains in f' where the information is, measured on
#: simulated ramps.
_NOISE_SHARE = 0.9


class _Kalman:
    """One extended Kalman filter with its weight and its sensitivity to alpha."""

    def __init__(self, start: Array, covariance: Array, log_weight: float) -> None:
        # Importing it takes as long as all the rest of the core, and most never need it.
        from filterpy.kalman import ExtendedKalmanFilter

        self.filter = ExtendedKalmanFilter(dim_x=start.size, dim_z=1)
        self.filter.x, self.filter.P = start, covariance.copy()
        self.log_weight = log_weight
        self.sensitivity = np.zeros(start.size)
        self.log_weight_sensitivity = 0.0

    def update(
        self, predicted: float, jacobian: Array, observed: tuple[float, float], noise: float
    ) -> float:
        """Take f' and its derivative by alpha; return the variance of the prediction."""
        own = self.filter
        variances = own.P.diagonal()
        if variances.min() < 0.0 or jacobian @ own.P @ jacobian < 0.0:
            # A stiffness far beyond tissue makes the Jacobian enormous, and rounding the
            # covariance indefinite: the member loses its weight, but must not stop the others.
            own.P = np.diag(np.maximum(variances, 0.0))
        own.update(
            np.array([observed[0]]),
            lambda _: jacobian[None],
            lambda _: np.array([predicted]),
            R=noise,
        )
        logs = own.x[: _LOG_GN + 1]
        np.clip(logs, -MAX_EXPONENT, MAX_EXPONENT, out=logs)
        innovation, variance = observed[0] - predicted, max(float(own.S[0, 0]), noise)
        self.log_weight -= 0.5 * (innovation**2 / variance + math.log(variance))
        by_order = observed[1] - float(jacobian @ self.sensitivity)
        self.sensitivity = self.sensitivity + own.K[:, 0] * by_order
        self.log_weight_sensitivity -= innovation / variance * by_order
        return variance


class FractionalStressEstimator(Estimator):
    """The Gaussian sum.

    The blocks' memory holds all of the past, so that motion, rest and relinearisation are nothing
    to this estimator. The noise of the fractional stress is coloured: its innovations prove
    neither a mismatch nor a change.

    Parameters
    ----------
    geometry : Geometry
        For the strain at a compression.
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    origin_sd : float
        Standard deviation of the strain origin [1]; 0: known.
    """

    def __init__(
        self, config: EstimatorConfig, geometry: Geometry, noise_sd: float, origin_sd: float = 0.0
    ) -> None:
        self._config, self._geometry = config, geometry
        prior, order = config.prior, config.prior.fractional_order
        self._at_order, self._by_order = memory_weights(order), memory_slopes(order)
        self._gamma = math.gamma(1.0 + order)
        self._noise_variance = _NOISE_SHARE * noise_sd**2 / ((1.0 + 2.0 * order) * self._gamma**2)
        spread = prior.nonlinear_stiffness_log_sd
        half_width = _GRID_HALF_WIDTH * spread
        offsets = np.linspace(
            -half_width, half_width, 2 * math.ceil(half_width / (2.0 * _MEMBER_SD)) + 1
        )
        variance = np.diag([prior.linear_stiffness_log_sd**2, _MEMBER_SD**2, origin_sd**2, 0.0])
        log_g, centre = prior.mean[:2]
        self._members = [
            _Kalman(
                np.array([log_g, centre + offset, 0.0, 0.0]),
                variance,
                -0.5 * (offset / spread) ** 2 if spread > 0.0 else 0.0,
            )
            for offset in offsets.tolist()
        ]
        self._max_compression = 0.0
        self._sample_count = 0

    def begin_contact(self, bias_sd: float, drift_sd: float, way: Array | None = None) -> None:
        """Let the bias [Pa] be as uncertain as that of the first contact; there is no drift."""
        if self._sample_count == 0:
            for member in self._members:
                member.filter.P[_BIAS, _BIAS] = bias_sd**2

    def update(self, block: Block) -> Innovation:
        """Take one block; return how it compared with the mixture's prediction."""
        stress = float(self._at_order @ block.memory)
        observed = stress, float(self._by_order @ block.memory)
        growth = block.memory_time**self._config.prior.fractional_order
        noise = self._noise_variance * growth**2 / block.size
        weights, found = self._weights(), []
        for member in self._members:
            predicted, jacobian = self._model(member.filter.x, block.compression, growth)
            found.append((predicted, member.update(predicted, jacobian, observed, noise)))
        self._max_compression = max(self._max_compression, block.compression)
        self._sample_count += block.size
        predictions, variances = np.array(found).T
        middle = float(weights @ predictions)
        variance = float(weights @ (variances + (predictions - middle) ** 2))
        # What has no weight costs time, and may wander to where its numbers lose all meaning.
        weighed = zip(self._weights(), self._members, strict=True)
        self._members = [member for weight, member in weighed if weight > 0.0]
        return Innovation(middle, None, stress - middle, variance)

    def _model(self, state: Array, compression: float, growth: float) -> tuple[float, Array]:
        """Return f' of a member at a compression, and its derivatives."""
        log_g, log_gn, origin, bias = state.tolist()
        compression, gain = compression - origin, growth / self._gamma
        strain = self._geometry.strain(compression)
        response = elastic_response(strain, math.exp(log_g), math.exp(log_gn))
        by_origin = -response.by_strain * self._geometry.strain_slope(compression)
        jacobian = np.array([response.value, response.by_log_nonlinear_stiffness, by_origin, gain])
        return response.value + bias * gain, jacobian

    def _weights(self) -> Array:
        log_weights = np.array([member.log_weight for member in self._members])
        weights: Array = np.exp(log_weights - log_weights.max())
        weights /= weights.sum()
        return weights

    def estimate(self) -> Estimate:
        """Return the mixture's mean and covariance, alpha's own uncertainty included."""
        config, prior, weights = self._config, self._config.prior, self._weights()
        modes = [
            Component(weight, member.filter.x, member.filter.P)
            for weight, member in zip(weights.tolist(), self._members, strict=True)
        ]
        mean, covariance = moments(modes)
        sensitivity = self._sensitivity(weights, np.array([m.mean for m in modes]) - mean)
        order_variance = prior.fractional_order_sd**2
        covariance = covariance + np.outer(sensitivity, sensitivity) * order_variance
        by_order = np.append(sensitivity[:2], 1.0) * order_variance
        joint = np.column_stack([np.vstack([covariance[:2, :2], by_order[:2]]), by_order])
        joint = positive(joint)
        beyond = self._probability_beyond_boundary(modes)
        deviations = np.sqrt(joint.diagonal())
        valid = determined(config, deviations, beyond)
        return Estimate(
            log_linear_stiffness=float(mean[_LOG_G]),
            log_nonlinear_stiffness=float(mean[_LOG_GN]),
            fractional_order=prior.fractional_order,
            covariance=joint,
            contact_point=float(mean[_ORIGIN]),
            contact_point_sd=math.sqrt(max(covariance[_ORIGIN, _ORIGIN], 0.0)),
            probability_beyond_boundary=beyond,
            observable=valid,
            known=converged(config, deviations, valid),
            sample_count=self._sample_count,
        )

    def _sensitivity(self, weights: Array, centred: Array) -> Array:
        """Return the derivative of the mean by alpha: of the members, and of their weights."""
        own = np.array([member.sensitivity for member in self._members])
        by_weight = np.array([member.log_weight_sensitivity for member in self._members])
        result: Array = weights @ own + (weights * (by_weight - weights @ by_weight)) @ centred
        return result

    def _probability_beyond_boundary(self, modes: list[Component]) -> float:
        total = 0.0
        for weight, mean, covariance in modes:
            strain = self._geometry.strain(self._max_compression - mean[_ORIGIN])
            sd = math.sqrt(max(covariance[_LOG_GN, _LOG_GN], 0.0))
            total += weight * probability_beyond(strain, 0.0, float(mean[_LOG_GN]), sd)
        return min(total, 1.0)
