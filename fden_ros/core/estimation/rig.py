# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""How what is not known of the rig enters the stress, from block to block.

Compliance C, delay tau and friction F shift the stress by

.. math::
    -\frac{C}{L} D^\alpha(\varphi' f), \qquad \tau\,\frac{d}{dt} D^\alpha\varphi, \qquad
    F\,\mathrm{sgn}(\dot u)

A noisy regressor would say that a parameter is near 0, with a deviation that is far too small
(errors in variables). So the velocity counts only where it stands out from the noise of the
displacement, and the force that bends the tool is followed, not taken as measured.

References
----------
Fuller, Measurement Error Models (1987), ch. 1: attenuation by errors in variables.
"""

from __future__ import annotations

import math
from collections import deque

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.estimator import Block
from fden_ros.core.estimation.estimator_config import Uncertainty
from fden_ros.core.law.geometry import Geometry

#: The velocity is taken over this many blocks [1] ...
_VELOCITY_BLOCKS = 2
#: ... and is a motion above this many standard deviations of its noise [1], and this speed [m/s].
_MOVING_DEVIATIONS, _LEAST_SPEED = 4.0, 2e-4
#: A motion goes on above this share of that [1].
_STILL_SHARE = 0.5
#: Where the direction changes, friction acts on an unknown part of this block and of the one
#: before: both are less certain by this many of its deviations [1]. Else a friction of any size
#: would be found to be small.
_TURN_DEVIATIONS = 2.0
#: Share of a block's unexpected stress [1] that the followed force takes up, once settled.
_FOLLOWED_SHARE = 0.1


class RigResponse:
    """The responses to one deviation each of compliance, delay and friction.

    Parameters
    ----------
    uncertainty : Uncertainty
    geometry : Geometry
    motion_noise : float
        Variance of the compression's noise per sample times the time between samples [s].

    Attributes
    ----------
    turn_variance : float
        By which the newest block and the one before are less certain [Pa^2].
    late_delay : float
        To be added to the delay's column of the block before, at G = 1 [1].
    """

    def __init__(self, uncertainty: Uncertainty, geometry: Geometry, motion_noise: float) -> None:
        self._uncertainty = uncertainty
        self._geometry = geometry
        self._motion_noise = motion_noise
        self.begin_contact()

    def begin_contact(self) -> None:
        """Let the next block begin a new motion."""
        self._recent: deque[tuple[float, float]] = deque(maxlen=_VELOCITY_BLOCKS)
        self._has_loaded = self._has_unloaded = False
        self._direction = self.turn_variance = self.late_delay = 0.0
        self._delayed = 0.0
        self._followed = self._still = 0
        self._stress = self._loading = self._relaxing = 0.0

    @property
    def has_reversed(self) -> bool:
        """Whether the probe has gone in and out in this contact: only that tells friction."""
        return self._has_loaded and self._has_unloaded

    def columns(
        self,
        block: Block,
        linearised: Array,
        step: float,
        scale: float,
    ) -> dict[StateIndex, float]:
        """Return the columns for a block [Pa]; those of compliance, delay and jitter at G = 1.

        Parameters
        ----------
        block : Block
        linearised : ndarray, shape (3,)
            D^alpha of dphi/dx at G = 1 times the force [N], times the noise of the motion [1], and
            times 1 in this contact [1].
        step : float
            Of the law's stress from the last block to this one, at G = 1 [1].
        scale : float
            G [Pa s^alpha].
        """
        uncertainty, geometry = self._uncertainty, self._geometry
        rate = self._rate(block)
        direction = math.copysign(1.0, rate) if rate else 0.0
        self._has_loaded |= direction > 0.0
        self._has_unloaded |= direction < 0.0
        friction = uncertainty.friction_sd * geometry.stress_per_force
        self.turn_variance = (
            (_TURN_DEVIATIONS * friction) ** 2 if direction != self._direction else 0.0
        )
        self._direction = direction
        delayed = self._delay(step, block.memory_time) if direction else 0.0
        # A force that is ahead of the motion answers to what comes next: the mean of both steps.
        self.late_delay = 0.5 * (delayed - self._delayed)
        self._delayed = delayed
        self._recent.append((block.compression, block.memory_time))
        by_compression = geometry.strain_slope(block.compression)
        bending, jittering, shifting = (linearised * by_compression).tolist()
        return {
            StateIndex.JITTER: jittering,
            StateIndex.SHIFT: -scale * uncertainty.surface_motion_sd * shifting / geometry.length,
            StateIndex.COMPLIANCE: -uncertainty.compliance_sd * bending / geometry.length,
            StateIndex.DELAY: delayed,
            StateIndex.FRICTION: friction * direction,
        }

    def _rate(self, block: Block) -> float:
        """Return the compression's rate up to a block [1/s]; 0 where it may be noise."""
        if not self._recent or block.duration <= 0.0:
            return 0.0
        before, begun = self._recent[0]
        elapsed = block.memory_time - begun
        rate = (block.compression - before) / elapsed
        noise = math.sqrt(2.0 * self._motion_noise / block.duration) / elapsed
        least = _MOVING_DEVIATIONS * noise + _LEAST_SPEED / self._geometry.length
        if rate * self._direction > 0.0:
            least *= _STILL_SHARE
        return rate if abs(rate) > least else 0.0

    def _delay(self, step: float, time: float) -> float:
        """Return the response to one deviation of the delay, by the step up to a block [1]."""
        elapsed = time - self._recent[-1][1] if self._recent else 0.0
        return self._uncertainty.delay_sd * step / elapsed if elapsed > 0.0 else 0.0

    def bend(self, compression: float, stiffness: float) -> float:
        """Return the force that bends the tool at the end of the block to come [N].

        Parameters
        ----------
        compression : float
            Mean of that block [1].
        stiffness : float
            Of the stress by the compression, for a motion as long as a block [Pa].
        """
        way = compression - self._recent[-1][0] if self._recent else 0.0
        self._loading = stiffness * way
        stress = self._stress + 1.5 * (self._loading + self._relaxing)
        return max(stress, 0.0) / self._geometry.stress_per_force

    def follow(self, stress: float, step: float) -> None:
        """Follow the stress of the block that :meth:`bend` was for.

        While the probe holds still it averages over one block more each time: of a long hold the
        noise that a fixed share takes up would say that the compliance is many deviations off.

        Parameters
        ----------
        stress : float
            Observed [Pa].
        step : float
            From the last block to this one, by the law [Pa].
        """
        self._followed += 1
        self._still = 0 if self._direction else self._still + 1
        expected = self._stress + step
        share = max(1.0 / (1.0 / _FOLLOWED_SHARE + self._still), 1.0 / self._followed)
        self._stress = expected + share * (stress - expected)
        self._relaxing = step - self._loading if self._followed > 1 else 0.0
