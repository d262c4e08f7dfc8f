# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Force control on soft tissue: one law, with gains from the live stiffness or fixed.

The probe is moved by its velocity. With k the tissue's stiffness in N/m, the force follows its
target as a first-order system of the bandwidth w, whatever the tissue:

.. math:: v = \frac{1}{k} \min\Bigl( w\,(F_{target} - F),\;
          \frac{F_{limit} - F}{\rho\,T} \Bigr)

The second term is what the force may rise by per second so that it stays below its limit if the
tissue turns :math:`\rho` times stiffer and the loop takes T to answer.

Near the target an integral of the error is added, because tissue relaxes for ever.

Where the tissue resists more than the estimate says, the ratio of what is measured over the last
moments to what the estimate says counts at once: an inclusion stiffens before any estimate can
know of it. Without an estimate k is the fixed, safe one, or the last one in use where that is
larger.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from fden_ros.control.live_tissue import Reading
from fden_ros.errors import InputError


class Gains(enum.Enum):
    """Where the gains in use come from."""

    FIXED = "fixed"
    SAFE = "safe"  #: scheduled control without an estimate
    LIVE = "live"


@dataclass(frozen=True)
class ForceControlConfig:
    """One force controller; SI units.

    Parameters
    ----------
    safe_stiffness
        k in N/m for which the fixed gains are made: the stiffest tissue that is expected.
    force_limit
        The force shall stay below it [N].
    scheduled
        Gains from the live stiffness; false: fixed gains.
    bandwidth
        w in rad/s: at most about a third of 1 / (delay + lag of the axis).
    guarded_stiffening
        The ratio by which tissue may suddenly stiffen.
    reaction_time
        T in s: from a change of the force to the axis answering.
    touch_force
        Below it the probe is taken to be in the air [N].
    approach_speed
        In the air [m/s].
    max_speed
        In contact [m/s].
    deviations
        The stiffness in use is the estimate plus this number of its standard deviations.
    force_noise
        Standard deviation of the force that is given to :meth:`ForceController.step` [N].
    """

    safe_stiffness: float
    force_limit: float
    scheduled: bool = True
    bandwidth: float = 12.0
    guarded_stiffening: float = 6.0
    reaction_time: float = 0.06
    touch_force: float = 0.01
    approach_speed: float = 0.005
    max_speed: float = 0.05
    deviations: float = 1.0
    force_noise: float = 1e-3

    def __post_init__(self) -> None:
        for name in ("safe_stiffness", "force_limit", "bandwidth", "reaction_time", "max_speed"):
            if not getattr(self, name) > 0.0:
                raise InputError(
                    f"force control: {name} is {getattr(self, name)}; it must be positive"
                )


#: No gain is larger than for tissue as soft as this [N/m].
_LEAST_STIFFNESS = 0.1
#: The secant is taken over 25 ms [s] and 20 um [m] at least, less a multiple of its deviation.
_WINDOW = 0.025
_LEAST_MOTION = 2e-5
_CERTAIN = 3.0
#: Up to this ratio of measured to estimated stiffness the estimate is believed.
_BELIEVED = 1.5
#: A measured stiffening is forgotten at this rate while the probe moves [1/s].
_FORGETTING = 2.0
#: The integral acts within this part of the target, at this part of the bandwidth.
_NEAR = 0.1
_INTEGRAL_PART = 0.25


class ForceController:
    """Velocity of the probe from force, depth and what is known of the tissue.

    Parameters
    ----------
    config : ForceControlConfig

    Attributes
    ----------
    gains : Gains
        Where those of the last step came from.
    stiffness : float
        k of the last step [N/m].
    """

    def __init__(self, config: ForceControlConfig) -> None:
        self.config = config
        self.gains = Gains.SAFE if config.scheduled else Gains.FIXED
        self.stiffness = config.safe_stiffness
        self._recent: deque[tuple[float, float, float]] = deque()
        self._time: float | None = None
        self._target = 0.0
        self._forget()

    def step(
        self, time: float, force: float, depth: float, target: float, reading: Reading | None
    ) -> float:
        """Return the velocity into the tissue [m/s].

        Parameters
        ----------
        time : float
            Of the measurement [s].
        force, depth : float
            Measured, on the tissue [N], into it [m].
        target : float
            Force wanted [N]; 0 or less: leave the tissue.
        reading : Reading or None
            What may be relied on now, or None.
        """
        config = self.config
        elapsed = 0.0 if self._time is None else time - self._time
        self._time = time
        if force < config.touch_force:
            self._forget()
            return config.approach_speed if target > 0.0 else -config.approach_speed
        if config.scheduled:
            self._schedule(time, force, depth, reading, elapsed)
        error = target - force
        rate = config.bandwidth * error + self._integrate(error, target, elapsed)
        guard = config.guarded_stiffening * config.reaction_time
        rate = min(rate, (config.force_limit - force) / guard)
        velocity = rate / self.stiffness
        return min(max(velocity, -config.max_speed), config.max_speed)

    def _forget(self) -> None:
        """In the air: whatever is touched next is new."""
        self._recent.clear()
        self._stiffening = 1.0
        self._known = self.config.safe_stiffness
        self._integral = 0.0
        if self.config.scheduled:
            self.gains, self.stiffness = Gains.SAFE, self.config.safe_stiffness

    def _integrate(self, error: float, target: float, elapsed: float) -> float:
        """Return the rate that balances the tissue's relaxation [N/s]; only near the target."""
        if target != self._target:
            self._target, self._integral = target, 0.0
        if abs(error) < _NEAR * abs(target):
            self._integral += self.config.bandwidth * _INTEGRAL_PART * error * elapsed
        return self.config.bandwidth * self._integral

    def _schedule(
        self, time: float, force: float, depth: float, reading: Reading | None, elapsed: float
    ) -> None:
        config = self.config
        if reading is None:
            # No faster than is safe, and no faster than before the loss.
            self.gains, self._known = Gains.SAFE, max(config.safe_stiffness, self._known)
        else:
            stiffness, sd = reading.stiffness(1.0 / config.bandwidth)
            least = min(_LEAST_STIFFNESS, config.safe_stiffness)
            self._known = max(stiffness + config.deviations * sd, least)
            self.gains = Gains.LIVE
        known = self._known
        measured = self._measured_stiffness(time, force, depth)
        if measured is not None:
            ratio = max(measured / known / _BELIEVED, 1.0)
            forgotten = 1.0 + (self._stiffening - 1.0) * math.exp(-_FORGETTING * elapsed)
            self._stiffening = max(ratio, forgotten)
        self.stiffness = known * self._stiffening

    def _measured_stiffness(self, time: float, force: float, depth: float) -> float | None:
        """Return the secant dF/dd of the last moments [N/m]; None unless the probe goes in."""
        self._recent.append((time, force, depth))
        while time - self._recent[0][0] > _WINDOW:
            self._recent.popleft()
        samples = np.array(self._recent)
        forces, depths = samples[:, 1], samples[:, 2]
        if depths.size < 3 or depths[-1] - depths[0] < _LEAST_MOTION:
            return None
        centred = depths - depths.mean()
        spread = float(centred @ centred)
        # Cautious the other way: noise must not look like an inclusion.
        doubt = _CERTAIN * self.config.force_noise / math.sqrt(spread)
        return float(centred @ forces) / spread - doubt
