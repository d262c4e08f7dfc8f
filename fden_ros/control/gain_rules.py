# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The stiffness that a controller's gains are made for, from what is known of the tissue."""

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
