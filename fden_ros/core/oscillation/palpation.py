# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Apparent stiffness and alpha from the complex stiffness under a palpating probe.

With :math:`k = K (j\omega)^\alpha` the stiffness for a motion that lasts tau is

.. math:: k_\tau = |k| \frac{(\omega\tau)^{-\alpha}}{\Gamma(1-\alpha)}, \qquad
   \alpha = \tfrac{2}{\pi} \arg k .

What is stated of the rig counts: a delay turns k, a compliance in series softens it, friction
against the motion adds :math:`\tfrac{4}{\pi} / |X|` to k''. The law's own error counts for the way
from 1/omega to tau.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import digamma

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import (
    EDGE,
    NO_CHANCE,
    Estimate,
    EstimatorConfig,
    ParameterSet,
    Uncertainty,
    converged,
    determined,
    kernel_change,
)
from fden_ros.core.law import ApparentStiffness
from fden_ros.core.oscillation.local_stiffness import Stiffness
from fden_ros.core.oscillation.out_of_step import is_out_of_step

#: Orders alpha that palpation may show, wider than the range 0.02 to 0.6 of a given one.
_LOWEST_ORDER, _HIGHEST_ORDER = 0.01, 0.65


class Palpated(NamedTuple):
    """What palpation tells of a place."""

    stiffness: Stiffness  #: at the palpation's frequency, with what is not known of the rig
    #: k_tau; None: the phase is none of a relaxation, so that it is not known.
    apparent: ApparentStiffness | None
    estimate: Estimate  #: G and Gn in it are the prior


def palpated(
    stiffness: Stiffness,
    angular_frequency: float,
    amplitude: float,
    time_scale: float,
    config: EstimatorConfig,
    samples: int,
    *,
    grows: bool = False,
) -> Palpated | None:
    """Return what a complex stiffness tells; None where it is not above 0.

    Parameters
    ----------
    stiffness : Stiffness
        Measured.
    angular_frequency, amplitude : float
        Of the palpation [rad/s, m].
    time_scale : float
        tau [s].
    samples : int
        Behind the measurement.
    grows : bool
        Whether the phase was seen to grow with the frequency.
    """
    if stiffness.value.real <= NO_CHANCE * math.sqrt(max(stiffness.covariance[0, 0], 0.0)):
        return None
    whole = _with_rig(stiffness, angular_frequency, amplitude, config.uncertainty)
    value = stiffness.value
    size = abs(value)
    rotation = np.array([[value.real, value.imag], [-value.imag, value.real]]) / size**2
    rotation[1] *= 2.0 / math.pi
    measured = rotation @ whole.covariance @ rotation.T  # of ln |k| and alpha
    own_order = 2.0 / math.pi * math.atan2(value.imag, value.real)
    prior = config.prior
    # The prior's alpha as one more observation, which moves ln |k| with it.
    both = float(measured[1, 1]) + prior.fractional_order_sd**2
    gain = measured[:, 1] / max(both, np.finfo(float).tiny)
    log_size, order = np.array([math.log(size), own_order]) + gain * (
        prior.fractional_order - own_order
    )
    covariance = measured - np.outer(gain, measured[1])
    lag = math.log(angular_frequency * time_scale)
    slope = np.array([1.0, float(digamma(1.0 - order)) - lag])
    kernel = kernel_change(config.uncertainty.kernel_sd, abs(lag))
    apparent = math.exp(log_size - order * lag) / math.gamma(1.0 - order)
    variance = float(slope @ covariance @ slope) + kernel
    estimate = _estimate(float(order), float(covariance[1, 1]), own_order, config, samples)
    if grows or is_out_of_step(own_order, math.sqrt(max(float(measured[1, 1]), 0.0))):
        return Palpated(whole, None, _unknown(estimate))
    if estimate.at_edge:
        return Palpated(whole, None, estimate)
    sd = apparent * math.sqrt(max(variance, 0.0))
    return Palpated(whole, ApparentStiffness(apparent, sd, time_scale), estimate)


def _unknown(estimate: Estimate) -> Estimate:
    """Return an estimate whose alpha is at an edge, so that nothing of it is known."""
    return estimate._replace(
        observable=ParameterSet.NONE,
        known=ParameterSet.NONE,
        at_edge=ParameterSet.FRACTIONAL_ORDER,
    )


def _with_rig(
    stiffness: Stiffness, angular_frequency: float, amplitude: float, uncertainty: Uncertainty
) -> Stiffness:
    """Return a stiffness whose covariance holds what is not known of the rig too."""
    value = stiffness.value
    columns = (
        1j * angular_frequency * value * uncertainty.delay_sd,
        value**2 * uncertainty.compliance_sd,
        4j / math.pi / amplitude * uncertainty.friction_sd,
    )
    parts = np.array([(column.real, column.imag) for column in columns])
    return Stiffness(value, stiffness.covariance + parts.T @ parts)


def _estimate(
    order: float, variance: float, own_order: float, config: EstimatorConfig, samples: int
) -> Estimate:
    """Return the prior with the alpha that was found."""
    prior, deviation = config.prior, math.sqrt(max(variance, 0.0))
    covariance: Array = np.diag(prior.deviations**2)
    covariance[2, 2] = variance
    deviations = np.sqrt(covariance.diagonal())
    is_beyond = not config.is_order_given and (
        own_order + EDGE * deviation < _LOWEST_ORDER
        or own_order - EDGE * deviation > _HIGHEST_ORDER
    )
    valid = determined(config, deviations, 0.0) & ParameterSet.FRACTIONAL_ORDER
    if is_beyond:
        valid = ParameterSet.NONE
    return Estimate(
        log_linear_stiffness=math.log(prior.linear_stiffness),
        log_nonlinear_stiffness=math.log(prior.nonlinear_stiffness),
        fractional_order=min(max(order, _LOWEST_ORDER), _HIGHEST_ORDER),
        covariance=covariance,
        observable=valid,
        known=converged(config, deviations, valid),
        at_edge=ParameterSet.FRACTIONAL_ORDER if is_beyond else ParameterSet.NONE,
        sample_count=samples,
    )
