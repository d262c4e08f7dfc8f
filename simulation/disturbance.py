# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Disturbances of a real rig: motion of the surface, friction, creep, hum and the like.

Disturbances of the motion change the strain that the tissue sees, so the force follows from the
law along the disturbed path (:mod:`simulation.stepped_contact`); those of the force and
of the readings are added to what the sensors see. Everything is off by default.

White noise, bias, drift, jitter and delay belong to the sensors: see
:class:`~simulation.scenario.ForceSensor` and
:class:`~simulation.scenario.DisplacementSensor`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from fden_ros.simulation import FloatArray

#: Slower than this [m/s] the probe counts as at rest: there is no friction and no vibration.
REST_SPEED = 1e-4
#: Period [s] over which the rate of a living surface varies.
_VARIATION_PERIOD = 20.0


@dataclass(frozen=True)
class SurfaceMotion:
    """A sine of the tissue's surface, towards the probe and back."""

    peak_to_peak_m: float = 0.0  #: Whole travel
    rate_hz: float = 0.25  #: Mean rate
    #: Amplitude, relative to the mean, of a slow sine of the rate (period 20 s), below 1
    rate_variation: float = 0.0

    def height(self, times: FloatArray, phase: float, slow_phase: float) -> FloatArray:
        """Return how far the surface has moved away from the probe, in m."""
        slow = 2.0 * np.pi / _VARIATION_PERIOD
        swing = self.rate_variation / slow * np.sin(slow * times + slow_phase)
        angle = 2.0 * np.pi * self.rate_hz * (times + swing) + phase
        height: FloatArray = 0.5 * self.peak_to_peak_m * np.sin(angle)
        return height


def _heartbeat() -> SurfaceMotion:
    return SurfaceMotion(rate_hz=1.2)


@dataclass(frozen=True)
class Phases:
    """Random phases of the periodic disturbances, in rad."""

    breathing: float = 0.0
    breathing_rate: float = 0.0
    heartbeat: float = 0.0
    heartbeat_rate: float = 0.0
    hum: float = 0.0
    vibration: float = 0.0

    @classmethod
    def draw(cls, generator: np.random.Generator) -> Phases:
        """Return phases that are uniform over a turn."""
        return cls(*generator.uniform(0.0, 2.0 * np.pi, 6).tolist())


@dataclass(frozen=True)
class Disturbances:
    """All disturbances of a rig; by default there are none."""

    #: Motion of the tissue's surface along the approach axis; 0.25 and 1.2 Hz by default
    breathing: SurfaceMotion = field(default_factory=SurfaceMotion)
    heartbeat: SurfaceMotion = field(default_factory=_heartbeat)
    #: Compliance of the tool, between the reported place and the tip
    compliance_m_per_n: float = 0.0
    #: Play of the drive: on a reversal the reported place moves this far before the tip follows
    backlash_m: float = 0.0
    plastic_set_m: float = 0.0  #: How much lower the surface at rest lies after each press
    #: Force against the motion on the tool in contact, that the sensor sees; none at rest
    friction_n: float = 0.0
    #: In contact the force reading creeps towards this error, in the air back to 0, with this
    #: time constant
    creep_n: float = 0.0
    creep_s: float = 2.0
    #: Error of the force at the beginning, and the time constant with which it settles
    thermal_n: float = 0.0
    thermal_s: float = 20.0
    #: Amplitude and frequency of the mains in the force
    hum_n: float = 0.0
    hum_hz: float = 50.0
    #: Amplitude and frequency of the robot's vibration in the force, while the axis moves or
    #: always
    vibration_n: float = 0.0
    vibration_hz: float = 12.0
    vibration_at_rest: bool = False
    #: Corner frequency of a low-pass filter of first order on the force, noise included; 0:
    #: none
    filter_hz: float = 0.0
    #: Steps of the readings (quantisation); 0: none
    force_step_n: float = 0.0
    displacement_step_m: float = 0.0

    @property
    def moves_tissue(self) -> bool:
        """Whether the motion in the tissue differs from the planned one."""
        return any(
            (
                self.breathing.peak_to_peak_m,
                self.heartbeat.peak_to_peak_m,
                self.compliance_m_per_n,
                self.backlash_m,
                self.plastic_set_m,
            )
        )

    def surface(self, times: ArrayLike, phases: Phases) -> FloatArray:
        """Return the shift of the surface away from the probe by breathing and heartbeat, in m."""
        instants = np.asarray(times, dtype=float)
        return self.breathing.height(
            instants, phases.breathing, phases.breathing_rate
        ) + self.heartbeat.height(instants, phases.heartbeat, phases.heartbeat_rate)

    def force_reading(
        self,
        times: FloatArray,
        force: FloatArray,
        sensor_error: FloatArray,
        velocity: FloatArray,
        contacts: Sequence[tuple[float, float]],
        phases: Phases,
    ) -> FloatArray:
        """Return the disturbed, filtered and quantised reading of a force [N], shape (n,).

        `sensor_error` [N] is the sensor's own noise, bias and drift, `velocity` [m/s] that of the
        axis into the tissue, both of shape (n,) at `times` [s]; `contacts` have touch and release
        [s].
        """
        moving = np.abs(velocity) > REST_SPEED
        touching = np.zeros(times.shape, dtype=bool)
        creep = np.zeros_like(times)
        for touch, release in contacts:
            touching |= (times > touch) & (times < release)
            creep += _settled(times - touch, self.creep_s) - _settled(
                times - release, self.creep_s
            )
        shaken = np.ones_like(moving) if self.vibration_at_rest else moving
        error = sensor_error + (
            self.friction_n * np.sign(velocity) * (moving & touching)
            + self.creep_n * creep
            + self.thermal_n * np.exp(-times / self.thermal_s)
            + self.hum_n * np.sin(2.0 * np.pi * self.hum_hz * times + phases.hum)
            + self.vibration_n
            * np.sin(2.0 * np.pi * self.vibration_hz * times + phases.vibration)
            * shaken
        )
        return quantised(low_pass(times, force + error, self.filter_hz), self.force_step_n)


def _settled(elapsed: FloatArray, time_constant: float) -> FloatArray:
    """Return the response of a first-order lag to a unit step at 0."""
    return -np.expm1(-np.maximum(elapsed, 0.0) / time_constant)


def low_pass(times: FloatArray, values: FloatArray, corner_hz: float) -> FloatArray:
    """Return `values` (n,) at `times` (n,) behind a first-order low-pass filter.

    Exact where the input is linear between the samples. A `corner_hz` of 0 is no filter.
    """
    if corner_hz == 0.0 or values.size == 0:
        return values
    lags = 2.0 * np.pi * corner_hz * np.diff(times)
    decays = np.exp(-lags)
    # Weights of the two ends of a linear input.
    means = -np.expm1(-lags) / lags
    filtered = np.empty_like(values)
    state = filtered[0] = values[0]
    for n, (decay, mean) in enumerate(zip(decays.tolist(), means.tolist(), strict=True)):
        state = decay * state + (mean - decay) * values[n] + (1.0 - mean) * values[n + 1]
        filtered[n + 1] = state
    return filtered


def quantised(values: FloatArray, step: float) -> FloatArray:
    """Return `values` in whole steps; a step of 0 leaves them alone."""
    return values if step == 0.0 else step * np.round(values / step)


def with_backlash(places: FloatArray, width: float) -> FloatArray:
    """Return the tip's place (n,) behind a drive whose play is `width`.

    While the drive pushes on, the tip follows it; on a reversal it stays until the play is
    used up.
    """
    if width == 0.0 or places.size == 0:
        return places
    tip = np.empty_like(places)
    at = places[0]
    for n, place in enumerate(places.tolist()):
        at = min(max(at, place), place + width)
        tip[n] = at
    return tip
