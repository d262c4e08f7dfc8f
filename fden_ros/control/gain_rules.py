# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Gains of controllers that exist, from the tissue's stiffness by the force controller's rule.

The rule is :math:`v = w (F_{target} - F) / k`: a force loop of the bandwidth w on tissue of the
stiffness k. An admittance controller moves by :math:`M \ddot x + D \dot x + S x = F`, which is the
rule where D is k / w; and D is no less than what keeps the loop with the tissue from ringing,

.. math:: D = \max\Bigl( \frac{k}{w},\; 2 \sqrt{M (S + k)} \Bigr), \qquad
          \zeta = \frac{D}{2 \sqrt{M S}}

A Cartesian compliance controller moves by p times the force that is left; with its own stiffness
S the loop gain is p (S + k), which stays what it is on the tissue that p is made for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from fden_ros.control.live_tissue import Reading
from fden_ros.errors import InputError


@dataclass(frozen=True)
class StiffnessLimits:
    """Which stiffness gains may be made for; SI units.

    Parameters
    ----------
    safe_stiffness
        Without an estimate [N/m]: that of the stiffest tissue that is expected.
    least_stiffness
        No gain is larger than for tissue as soft as this [N/m].
    softening_rate
        The stiffness in use falls by no more than the factor e per 1 / `softening_rate` [1/s];
        it rises at once, which makes every gain smaller. Infinite: it falls at once, too.
    deviations
        It is the estimate plus this number of its standard deviations.
    time_scale
        Of the motion that the stiffness is for [s]: 1 / bandwidth.
    """

    safe_stiffness: float
    least_stiffness: float = 10.0
    softening_rate: float = 2.0
    deviations: float = 1.0
    time_scale: float = 1.0 / 12.0

    def __post_init__(self) -> None:
        if not 0.0 < self.least_stiffness <= self.safe_stiffness:
            raise InputError(
                f"least_stiffness is {self.least_stiffness:g} and safe_stiffness "
                f"{self.safe_stiffness:g} N/m: the safe one is that of the stiffest tissue, so it "
                "must be the larger"
            )


class StiffnessInUse:
    """The stiffness that gains are made for, from what is known of the tissue.

    Parameters
    ----------
    limits : StiffnessLimits

    Attributes
    ----------
    value : float
        Stiffness in use [N/m].
    is_live : bool
        Whether it rests on an estimate.
    """

    def __init__(self, limits: StiffnessLimits) -> None:
        self._limits = limits
        self._time: float | None = None
        self.value = limits.safe_stiffness
        self.is_live = False

    def step(self, time: float, reading: Reading | None) -> float:
        """Return the stiffness in use [N/m].

        Parameters
        ----------
        time : float
            On a clock that never jumps [s].
        reading : Reading or None
            What may be relied on now, or None.
        """
        limits = self._limits
        elapsed = 0.0 if self._time is None else max(time - self._time, 0.0)
        self._time = time
        if reading is None:
            # No faster than is safe, and no faster than before the loss.
            self.value = max(limits.safe_stiffness, self.value)
            self.is_live = False
            return self.value
        stiffness, sd = reading.stiffness(limits.time_scale)
        wanted = max(stiffness + limits.deviations * sd, limits.least_stiffness)
        least = 0.0
        if math.isfinite(limits.softening_rate):
            least = self.value * math.exp(-limits.softening_rate * elapsed)
        self.value, self.is_live = max(wanted, least), True
        return self.value

    def leave(self) -> None:
        """In the air: whatever is touched next is new, and the last tissue counts no more."""
        self.value, self.is_live = self._limits.safe_stiffness, False


@dataclass(frozen=True)
class AdmittanceRule:
    """Damping ratio of one axis of an admittance controller.

    Parameters
    ----------
    mass, stiffness
        M [kg] and S [N/m] of the axis.
    bandwidth
        w of the force on the tissue [rad/s].

    Raises
    ------
    InputError
        If mass or stiffness is not positive: there is no damping then, whatever the ratio.
    """

    mass: float
    stiffness: float
    bandwidth: float

    def __post_init__(self) -> None:
        for name in ("mass", "stiffness"):
            if not getattr(self, name) > 0.0:
                raise InputError(
                    f"admittance.{name} of the axis is {getattr(self, name):g}: the damping is "
                    "2 damping_ratio sqrt(mass stiffness), so give it a positive one"
                )

    def damping_ratio(self, stiffness: float) -> float:
        """Return the ratio for tissue of a stiffness [N/m]."""
        damping = max(
            stiffness / self.bandwidth, 2.0 * math.sqrt(self.mass * (self.stiffness + stiffness))
        )
        return damping / (2.0 * math.sqrt(self.mass * self.stiffness))


@dataclass(frozen=True)
class CartesianRule:
    """Gains of one axis of a Cartesian force or compliance controller.

    Parameters
    ----------
    gains
        p and d as they are right for tissue of `safe_stiffness`.
    stiffness
        Of the controller's own spring [N/m]; 0 for a force controller.
    safe_stiffness
        [N/m].
    """

    gains: tuple[float, float]
    stiffness: float
    safe_stiffness: float

    def for_tissue(self, stiffness: float) -> tuple[float, float]:
        """Return p and d for tissue of a stiffness [N/m]."""
        ratio = (self.stiffness + self.safe_stiffness) / (self.stiffness + stiffness)
        return self.gains[0] * ratio, self.gains[1] * ratio
