# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Force control on soft tissue: one law, with gains from the live stiffness.

The probe is moved by its velocity. With k the tissue's stiffness in N/m, the force follows its
target as a first-order system of the bandwidth w, whatever the tissue:

.. math:: v = \frac{1}{k} \min\Bigl( w\,(F_{target} - F),\;
          \frac{F_{limit} - F}{\rho\,T} \Bigr)

The second term limits the rise of the force per second, so that it stays below its limit if the
tissue turns :math:`\rho` times stiffer and the loop takes T to respond. Near the target an
integral of the error is added, because tissue never stops relaxing.

Where the tissue resists more than k predicts, the measured ratio of the last moments to k counts
at once: an inclusion stiffens before an estimate shows it. Without a stiffness k is the fixed,
safe one, or the last one in use where that is larger.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from fden_ros.errors import InputError


class Gains(enum.Enum):
    """Where the gains in use come from."""

    SAFE = "safe"  #: no stiffness is known
    LIVE = "live"


@dataclass(frozen=True)
class ForceControlConfig:
    """One force controller; SI units."""

    safe_stiffness: float  #: k of the safe gains [N/m]: the stiffest tissue that is expected
    force_limit: float  #: limit of the force [N]
    bandwidth: float = 12.0  #: w [rad/s]: at most a third of 1 / (delay + lag of the axis)
    reaction_time: float = 0.06  #: T [s]: from a change of the force to the axis answering
    touch_force: float = 0.01  #: below it the probe is in the air [N]
    approach_speed: float = 0.005  #: in the air [m/s]
    force_noise: float = 1e-3  #: standard deviation of the force of a step [N]

    def __post_init__(self) -> None:
        for name in ("safe_stiffness", "force_limit", "bandwidth", "reaction_time"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} is {getattr(self, name)}; it must be positive")


#: rho: the ratio by which tissue may suddenly stiffen [1].
GUARDED_STIFFENING = 6.0
#: Largest speed in contact [m/s].
_MAX_SPEED = 0.05
#: The softest tissue for the gains [N/m].
_LEAST_STIFFNESS = 0.1
#: The secant is taken over 25 ms [s] and 20 um [m] at least, less a multiple of its deviation.
_WINDOW, _LEAST_MOTION, _CERTAIN = 0.025, 2e-5, 3.0
#: Up to this ratio to it the estimate is trusted; a larger one decays at this rate [1/s].
_BELIEVED, _FORGETTING = 1.5, 2.0
#: The integral acts within this part of the target, at this part of the bandwidth.
_NEAR, _INTEGRAL_PART = 0.1, 0.25


class ForceController:
    """Velocity of the probe from force, depth and the tissue's stiffness.

    `gains` says where those of the last step came from, `stiffness` is its k [N/m].
    """

    def __init__(self, config: ForceControlConfig) -> None:
        self.config = config
        self._recent: deque[tuple[float, float, float]] = deque()
        self._time: float | None = None
        self._target = 0.0
        self._forget()

    def step(
        self,
        time: float,
        force: float,
        depth: float,
        target: float,
        known: tuple[float, float] | None,
    ) -> float:
        """Return the velocity into the tissue [m/s].

        `force` [N] and `depth` [m] were measured at `time` [s]. With a `target` of 0 N or less the
        probe leaves the tissue. `known` is the stiffness at 1 / bandwidth and its deviation [N/m].
        """
        config = self.config
        elapsed = 0.0 if self._time is None else time - self._time
        self._time = time
        if force < config.touch_force:
            self._forget()
            return config.approach_speed if target > 0.0 else -config.approach_speed
        self._schedule(self._measured_stiffness(time, force, depth), known, elapsed)
        error = target - force
        rate = config.bandwidth * error + self._integrate(error, target, elapsed)
        guard = GUARDED_STIFFENING * config.reaction_time
        velocity = min(rate, (config.force_limit - force) / guard) / self.stiffness
        return min(max(velocity, -_MAX_SPEED), _MAX_SPEED)

    def _forget(self) -> None:
        """In the air: the next touch is on new tissue."""
        self._recent.clear()
        self._stiffening, self._integral = 1.0, 0.0
        self.gains, self.stiffness = Gains.SAFE, self.config.safe_stiffness
        self._known = self.stiffness

    def _integrate(self, error: float, target: float, elapsed: float) -> float:
        """Return the rate that balances the tissue's relaxation [N/s]; only near the target."""
        if target != self._target:
            self._target, self._integral = target, 0.0
        if abs(error) < _NEAR * abs(target):
            self._integral += self.config.bandwidth * _INTEGRAL_PART * error * elapsed
        return self.config.bandwidth * self._integral

    def _schedule(
        self, measured: float | None, known: tuple[float, float] | None, elapsed: float
    ) -> None:
        safe = self.config.safe_stiffness
        if known is None:
            # No faster than the safe speed, and no faster than before the loss.
            self.gains, self._known = Gains.SAFE, max(safe, self._known)
        else:
            # Conservative: the value and its deviation.
            least = min(_LEAST_STIFFNESS, safe)
            self.gains, self._known = Gains.LIVE, max(known[0] + known[1], least)
        if measured is not None:
            forgotten = 1.0 + (self._stiffening - 1.0) * math.exp(-_FORGETTING * elapsed)
            self._stiffening = max(measured / self._known / _BELIEVED, forgotten)
        self.stiffness = self._known * self._stiffening

    def _measured_stiffness(self, time: float, force: float, depth: float) -> float | None:
        """Return the secant dF/dd of the last moments [N/m]; None unless the probe goes in."""
        self._recent.append((time, force, depth))
        while time - self._recent[0][0] > _WINDOW:
            self._recent.popleft()
        _, forces, depths = np.array(self._recent).T
        if depths.size < 3 or depths[-1] - depths[0] < _LEAST_MOTION:
            return None
        centred = depths - depths.mean()
        spread = float(centred @ centred)
        # Conservative the other way: noise must not look like an inclusion.
        doubt = _CERTAIN * self.config.force_noise / math.sqrt(spread)
        return float(centred @ forces) / spread - doubt
