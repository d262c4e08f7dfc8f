# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Disturbances of a real rig: motion of the surface, friction, creep, hum and the like.

Disturbances of the motion change the strain that the tissue sees, so the force follows from the
law along the disturbed path, step by step; those of the force and of the readings are added to
what the sensors see. Everything is off by default. White noise, bias, drift, jitter and delay
belong to the sensors, in :mod:`simulation.scenario`.

The surface moves, the tool yields under the tissue's force, the drive has play, and each press
leaves a dent. The strain of the tissue is

.. math:: x = \mathrm{strain}(u_{tip} - c\,f - s(t) - p) ,

with the tip behind the play, the compliance c, the surface s and the dent p so far. The force f of
the hereditary law depends on x of the same instant, so each step of
:class:`~fden_ros.simulation.tissue.Tissue` is solved for both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from fden_ros.simulation import Column, FdenModel, FloatArray, Tissue
from simulation.closed_form import Move, motion_of

if TYPE_CHECKING:
    from simulation.scenario import Geometry

#: Slower than this [m/s] the probe counts as at rest: there is no friction and no vibration.
REST_SPEED = 1e-4
#: Period [s] over which the rate of a living surface varies.
_VARIATION_PERIOD = 20.0
#: Time constants of creep and of the thermal error [s], and the mains [Hz].
_CREEP_S, _THERMAL_S, _MAINS_HZ = 2.0, 20.0, 50.0
#: Time step [s].
STEP_S = 1e-3
#: A touch shorter than this [s] is no press and leaves no dent.
_SHORTEST_PRESS = 0.1


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


@dataclass(frozen=True)
class Phases:
    """Random phases of the periodic disturbances, in rad."""

    breathing: float
    breathing_rate: float
    heartbeat: float
    heartbeat_rate: float
    hum: float
    vibration: float

    @classmethod
    def draw(cls, generator: np.random.Generator) -> Phases:
        """Return phases that are uniform over a turn."""
        return cls(*generator.uniform(0.0, 2.0 * np.pi, 6).tolist())


@dataclass(frozen=True)
class Disturbances:
    """All disturbances of a rig; by default there are none."""

    #: Motion of the tissue's surface along the approach axis; 0.25 and 1.2 Hz by default
    breathing: SurfaceMotion = field(default_factory=SurfaceMotion)
    heartbeat: SurfaceMotion = field(default_factory=lambda: SurfaceMotion(rate_hz=1.2))
    #: Compliance of the tool, between the reported place and the tip
    compliance_m_per_n: float = 0.0
    #: Play of the drive: on a reversal the reported place moves this far before the tip follows
    backlash_m: float = 0.0
    plastic_set_m: float = 0.0  #: How much lower the surface at rest lies after each press
    #: Force against the motion on the tool in contact, that the sensor sees; none at rest
    friction_n: float = 0.0
    #: In contact the force reading creeps towards this error, in the air back to 0, within 2 s
    creep_n: float = 0.0
    thermal_n: float = 0.0  #: Error of the force at the beginning, which settles within 20 s
    hum_n: float = 0.0  #: Amplitude of the mains in the force, 50 Hz
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
        surface = self.breathing.peak_to_peak_m or self.heartbeat.peak_to_peak_m
        return any((surface, self.compliance_m_per_n, self.backlash_m, self.plastic_set_m))

    def surface(self, times: FloatArray, phases: Phases) -> FloatArray:
        """Return the shift of the surface away from the probe by breathing and heartbeat, in m."""
        breath = self.breathing.height(times, phases.breathing, phases.breathing_rate)
        return breath + self.heartbeat.height(times, phases.heartbeat, phases.heartbeat_rate)

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
            creep += _settled(times - touch) - _settled(times - release)
        shaken = np.ones_like(moving) if self.vibration_at_rest else moving
        error = sensor_error + (
            self.friction_n * np.sign(velocity) * (moving & touching)
            + self.creep_n * creep
            + self.thermal_n * np.exp(-times / _THERMAL_S)
            + self.hum_n * np.sin(2.0 * np.pi * _MAINS_HZ * times + phases.hum)
            + self.vibration_n
            * np.sin(2.0 * np.pi * self.vibration_hz * times + phases.vibration)
            * shaken
        )
        return quantised(low_pass(times, force + error, self.filter_hz), self.force_step_n)


def _settled(elapsed: FloatArray) -> FloatArray:
    """Return the response of the creep's lag to a unit step at 0."""
    return -np.expm1(-np.maximum(elapsed, 0.0) / _CREEP_S)


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


# Contacts of a probe whose motion in the tissue is not the planned one


@dataclass(frozen=True)
class SteppedContact:
    """One stretch of time in which the probe presses, in s, and the largest strain in it."""

    start: float
    stop: float
    largest_strain: float

    def max_strain(self, model: FdenModel) -> float:
        """Return the largest strain of the contact."""
        return self.largest_strain


@dataclass(frozen=True)
class SteppedHistory:
    """The contacts of a disturbed motion with one site of the tissue, in the order of time."""

    #: What :class:`~simulation.contact.ContactHistory` has, too
    contacts: tuple[SteppedContact, ...]
    model: FdenModel  #: The tissue
    #: Of every step, in s, 1 and Pa, shape (n,); the stress is 0 out of contact
    times: FloatArray
    strains: FloatArray
    stresses: FloatArray

    def stress(self, times: ArrayLike) -> FloatArray:
        """Return the stress in Pa at `times`, linear between the steps."""
        stress: FloatArray = np.interp(
            np.asarray(times, dtype=float), self.times, self.stresses, 0.0, 0.0
        )
        return stress


def stepped_contacts_of_moves(
    moves: Sequence[Move],
    model: FdenModel,
    geometry: Geometry,
    disturbances: Disturbances,
    phases: Phases,
    clock: float = 0.0,
) -> SteppedHistory:
    """Follow a disturbed probe over fresh tissue at rest and return the contacts it makes.

    The planned strain of consecutive `moves` is negative above the surface at rest, whose motion
    is at `clock` [s] at time 0. Of the disturbances only those of the motion count.
    """
    start, stop = moves[0].start, moves[-1].stop
    count = max(int(np.ceil((stop - start) / STEP_S - 1e-9)), 1)
    times: FloatArray = start + STEP_S * np.arange(count + 1, dtype=np.float64)
    depths = geometry.depth_of_strain(motion_of(moves, times)[0])
    surface = disturbances.surface(times + clock, phases)
    free = with_backlash(depths, disturbances.backlash_m) - surface
    tissue = Tissue([Column(model)], STEP_S)
    strains, stresses = np.empty_like(times), np.zeros_like(times)
    strains[0] = geometry.strain_of_depth(float(free[0]))
    contacts: list[SteppedContact] = []
    touch, dent = None, 0.0
    for n, depth in enumerate(free[1:].tolist(), start=1):
        strain = _strain_under(tissue, depth - dent, geometry, disturbances.compliance_m_per_n)
        stress = tissue.press(strain)
        strains[n], stresses[n] = strain, stress
        if stress > 0.0 and touch is None:
            touch = n - 1
        if touch is not None and (stress == 0.0 or n == times.size - 1):
            largest = float(strains[touch : n + 1].max())
            contacts.append(SteppedContact(float(times[touch]), float(times[n]), largest))
            if (n - touch) * STEP_S >= _SHORTEST_PRESS:
                dent += disturbances.plastic_set_m
            touch = None
    return SteppedHistory(tuple(contacts), model, times, strains, stresses)


def _strain_under(tissue: Tissue, depth: float, geometry: Geometry, compliance: float) -> float:
    """Return the strain at which the tool, bent by the tissue's force, reaches `depth`."""
    unbent = geometry.strain_of_depth(depth)
    if compliance == 0.0:
        return unbent
    response = tissue.response()
    scale = compliance * geometry.force_per_stress
    if response(unbent) <= 0.0:
        return unbent

    def excess(strain: float) -> float:
        place = float(geometry.depth_of_strain(np.array([strain]))[0])
        return place + scale * response(strain) - depth

    # Without any force the tip would be too high: at the free surface, where the force is 0.
    low = unbent
    while excess(low) > 0.0:
        low -= 0.02
    return float(brentq(excess, low, unbent, xtol=1e-10))
