# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Measures what a palpating probe meets, window after window, at a frequency stated or found."""

from __future__ import annotations

import math
from typing import NamedTuple

from fden_ros.core.estimation import EstimatorConfig
from fden_ros.core.oscillation.complex_modulus import ComplexModulus, ComplexModulusMeter
from fden_ros.core.oscillation.local_stiffness import LocalStiffness
from fden_ros.core.oscillation.out_of_step import PhaseGrowth, leads_beyond_right_angle, sentence
from fden_ros.core.oscillation.palpation import Palpated, palpated
from fden_ros.core.oscillation.palpation_frequency import PalpationFrequency

#: Periods of a window, and harmonics that are fitted beside the trend: with one period, or
#: without the second harmonic, the harmonics of a nonlinear tissue pass for trend.
_PERIODS, _HARMONICS = 2, (1.0, 2.0)
#: What a window says is current for this many windows.
_CURRENT = 2.5


class Measured(NamedTuple):
    """What one window tells."""

    modulus: ComplexModulus  #: of the window alone, of force by displacement [N/m]
    found: Palpated | None  #: of all windows so far; None: no answer of the tissue


class PalpationMeter:
    """Follows stiffness and alpha, sample by sample.

    Parameters
    ----------
    frequency : float or None
        Of the palpation [Hz]; None: it is found.
    least_amplitude : float
        Amplitude of the displacement [m] below which there is no palpation.
    time_scale : float
        tau of the apparent stiffness [s].
    """

    def __init__(
        self,
        frequency: float | None,
        least_amplitude: float,
        time_scale: float,
        config: EstimatorConfig,
    ) -> None:
        self._stated = frequency
        self._least_amplitude = least_amplitude
        self._time_scale = time_scale
        self._config = config
        self._finder = PalpationFrequency()
        self._stiffness = LocalStiffness()
        self._meter: ComplexModulusMeter | None = None
        self._frequency = 0.0
        self._found: Palpated | None = None
        self._found_time = 0.0
        self._phases = PhaseGrowth()
        #: The first phase that no relaxation makes, in one line; None: there was none.
        self.out_of_step: str | None = None

    def move_on(self) -> None:
        """Compare phases anew: this is another place."""
        self._phases = PhaseGrowth()

    @property
    def begins_window(self) -> bool:
        """Whether the newest sample is the first of a window."""
        return self._meter is not None and self._meter.begins_window

    def skip(self) -> None:
        """Begin the window anew: samples are missing."""
        if self._meter is not None:
            self._meter.reset()

    def add(self, time: float, displacement: float, force: float) -> Measured | None:
        """Take a sample; return what the window tells that ended before it, if one did.

        `time` [s] increases; `displacement` [m], `force` [N].
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
                self._found = self._learn(modulus)
                self._found_time = time
                return Measured(modulus, self._found)
        return None

    def _learn(self, modulus: ComplexModulus) -> Palpated | None:
        stiffness, amplitude = self._stiffness, modulus.strain_amplitude
        stiffness.add(complex(modulus.storage, modulus.loss), amplitude, modulus.sd)
        value = stiffness.value()
        if value is None:
            return None
        frequency = modulus.angular_frequency
        self._phases.add(frequency, math.atan2(modulus.loss, modulus.storage))
        found = palpated(
            value,
            frequency,
            amplitude,
            self._time_scale,
            self._config,
            stiffness.windows * modulus.samples,
            grows=self._phases.grows(self._config.uncertainty),
        )
        if found is not None and found.apparent is not None:
            return found
        leads = value.value.imag > 0.0 and found is not None
        if leads or leads_beyond_right_angle(value):
            self.out_of_step = self.out_of_step or sentence(value.value, frequency)
        return found

    def current(self, time: float) -> Palpated | None:
        """Return what is known at a time [s]; None where the last window is too long ago."""
        if self._meter is None or time - self._found_time > _CURRENT * self._meter.window:
            return None
        return self._found
