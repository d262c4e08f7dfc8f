# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Apparent stiffness and alpha from the complex stiffness under a palpating probe.

With :math:`k = K (j\omega)^\alpha` the stiffness for a motion that lasts tau is

.. math:: k_\tau = |k| \frac{(\omega\tau)^{-\alpha}}{\Gamma(1-\alpha)}, \qquad
   \alpha = \tfrac{2}{\pi} \arg k .

The rig's stated properties count: a delay turns k, a compliance in series softens it, friction
adds 4/(pi |X|) to its imaginary part. If the phase is larger than tissue has, nothing is known.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import digamma

from fden_ros.core.arrays import CLEAR, LIKELY
from fden_ros.core.estimation import (
    Estimate,
    EstimatorConfig,
    ParameterSet,
    converged,
    determined,
    kernel_change,
)
from fden_ros.core.law import HIGHEST_ORDER, LOWEST_ORDER, ApparentStiffness
from fden_ros.core.oscillation.complex_modulus import ComplexModulus, ComplexModulusMeter
from fden_ros.core.oscillation.local_stiffness import LocalStiffness, Stiffness
from fden_ros.core.oscillation.palpation_frequency import PalpationFrequency

#: An alpha by the phase above this counts as a lag [1]: published livers have 0.12 to 0.15,
#: measured beef 0.32 in the median. What is likely of a stated delay may be all of it.
_LARGEST_ORDER = 0.35
#: Periods of a window, harmonics fitted with the trend, without which those of a nonlinear
#: tissue pass for it, and for how many windows a result is current.
_PERIODS, _HARMONICS, _CURRENT = 2, (1.0, 2.0), 2.5


class Palpated(NamedTuple):
    """What palpation shows of a place."""

    stiffness: Stiffness  #: at the palpation's frequency, with the uncertainty of the rig
    #: k_tau; None: no relaxation has this phase, so k_tau is not known.
    apparent: ApparentStiffness | None
    estimate: Estimate  #: G and Gn in it are the prior


def palpated(
    stiffness: Stiffness,
    angular_frequency: float,
    amplitude: float,
    time_scale: float,
    config: EstimatorConfig,
    samples: int,
) -> Palpated | None:
    """Return the result of a complex stiffness for a motion of tau [s]; None: not above 0."""
    if stiffness.value.real <= stiffness.uncertain:
        return None
    value, size, prior = stiffness.value, abs(stiffness.value), config.prior
    rig = (
        1j * angular_frequency * value * config.uncertainty.delay_sd,
        value**2 * config.uncertainty.compliance_sd,
        4j / math.pi / amplitude * config.uncertainty.friction_sd,
    )
    parts = np.array([(one.real, one.imag) for one in rig])
    whole = Stiffness(value, stiffness.covariance + parts.T @ parts)
    rotation = np.array([[value.real, value.imag], [-value.imag, value.real]]) / size**2
    rotation[1] *= 2.0 / math.pi
    measured = rotation @ whole.covariance @ rotation.T  # of ln |k| and alpha
    own_order = 2.0 / math.pi * math.atan2(value.imag, value.real)
    # The prior's alpha as one more observation, which moves ln |k| with it.
    both = float(measured[1, 1]) + prior.fractional_order_sd**2
    gain = measured[:, 1] / max(both, np.finfo(float).tiny)
    off = prior.fractional_order - own_order
    log_size, order = np.array([math.log(size), own_order]) + gain * off
    covariance = measured - np.outer(gain, measured[1])
    lag = math.log(angular_frequency * time_scale)
    slope = np.array([1.0, float(digamma(1.0 - order)) - lag])
    apparent = math.exp(log_size - order * lag) / math.gamma(1.0 - order)
    kernel = kernel_change(config.uncertainty.kernel_sd, abs(lag))
    sd = apparent * math.sqrt(max(float(slope @ covariance @ slope) + kernel, 0.0))
    own_sd = math.sqrt(max(float(measured[1, 1]), 0.0))
    # Where alpha is given, only a lag is too much.
    variance = max(float(covariance[1, 1]), 0.0)
    reach = math.inf if config.is_order_given else CLEAR * math.sqrt(variance)
    is_lag = own_order > max(_LARGEST_ORDER, LIKELY * own_sd)
    is_tissue = own_order >= -reach and not is_lag
    estimate = _estimate(float(order), variance, config, samples, is_tissue)
    found = ApparentStiffness(apparent, sd, time_scale) if is_tissue else None
    return Palpated(whole, found, estimate)


def _estimate(
    order: float, variance: float, config: EstimatorConfig, samples: int, is_tissue: bool
) -> Estimate:
    """Return the prior with the alpha that was found, observable only if `is_tissue`."""
    alpha = ParameterSet.FRACTIONAL_ORDER
    log_g, log_gn, _ = config.prior.mean.tolist()
    variances = np.append(config.prior.deviations[:2] ** 2, variance)
    deviations = np.sqrt(variances)
    valid = determined(config, deviations, 0.0) & alpha if is_tissue else ParameterSet.NONE
    return Estimate(
        log_linear_stiffness=log_g,
        log_nonlinear_stiffness=log_gn,
        fractional_order=min(max(order, LOWEST_ORDER), HIGHEST_ORDER),
        covariance=np.diag(variances),
        observable=valid,
        known=converged(config, deviations, valid),
        at_edge=ParameterSet.NONE if is_tissue else alpha,
        sample_count=samples,
    )


class PalpationMeter:
    """Follows stiffness and alpha, sample by sample.

    `frequency` is stated [Hz], or found; below `least_amplitude` [m] nothing palpates;
    `time_scale` is tau of the apparent stiffness [s].
    """

    def __init__(
        self,
        frequency: float | None,
        least_amplitude: float,
        time_scale: float,
        config: EstimatorConfig,
    ) -> None:
        self._stated, self._least_amplitude = frequency, least_amplitude
        self._time_scale, self._config = time_scale, config
        self._finder, self._stiffness = PalpationFrequency(), LocalStiffness()
        self._meter: ComplexModulusMeter | None = None
        self._frequency = self._found_time = 0.0
        self._found: Palpated | None = None
        #: The first phase that no relaxation has, in one line; None: there was none.
        self.out_of_step: str | None = None

    @property
    def begins_window(self) -> bool:
        """Whether the newest sample is the first of a window."""
        return self._meter is not None and self._meter.samples == 1

    def skip(self) -> None:
        """Begin the window anew: samples are missing."""
        if self._meter is not None:
            self._meter.reset()

    def add(
        self, time: float, displacement: float, force: float
    ) -> tuple[ComplexModulus, Palpated | None] | None:
        """Add a sample [s, m, N] of a later time; return the results of a window that it ends.

        Of the window alone, of force by displacement [N/m], and of all windows so far; None: no
        response of the tissue.
        """
        self._finder.add(time, displacement)
        frequency = self._stated or self._finder.value
        if frequency is None:
            self._meter = None
            return None
        if self._meter is None or frequency != self._frequency:
            tones = [frequency * harmonic for harmonic in _HARMONICS]
            self._meter = ComplexModulusMeter(tones, _PERIODS, self._least_amplitude)
            self._frequency = frequency
        for modulus in self._meter.add(time, displacement, force):
            if math.isclose(modulus.angular_frequency, 2.0 * math.pi * frequency):
                self._found, self._found_time = self._update(modulus), time
                return modulus, self._found
        return None

    def _update(self, modulus: ComplexModulus) -> Palpated | None:
        stiffness, amplitude = self._stiffness, modulus.strain_amplitude
        stiffness.add(complex(modulus.storage, modulus.loss), amplitude, modulus.sd)
        whole, frequency = stiffness.value(), modulus.angular_frequency
        if whole is None:
            return None
        samples, value = stiffness.windows * modulus.samples, whole.value
        found = palpated(whole, frequency, amplitude, self._time_scale, self._config, samples)
        # By more than 90 degrees, or too far for a relaxation.
        leads = value.real < -whole.uncertain or (found is not None and found.apparent is None)
        if leads and value.imag > 0.0 and self.out_of_step is None:
            phase = math.atan2(value.imag, value.real)
            self.out_of_step = (
                f"the force leads the displacement by {math.degrees(phase):.0f} degrees at "
                f"{frequency / (2.0 * math.pi):.2g} Hz, more than relaxation explains, so "
                "stiffness and alpha are not known. One of the two is stamped late "
                f"(displacement.delay {phase / frequency:.3f} s if all of it is lag)"
            )
        return found

    def current(self, time: float) -> Palpated | None:
        """Return the result at a time [s]; None where the last window is too long ago."""
        if self._meter is None or time - self._found_time > _CURRENT * self._meter.window:
            return None
        return self._found
