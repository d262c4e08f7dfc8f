# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""A phase of the force before the displacement that no relaxation of tissue makes.

A relaxation leads by :math:`\tfrac{\pi}{2}\alpha`, at every frequency alike. A lag between two
clocks leads by :math:`\omega\tau`. One frequency cannot tell the two apart; what tissue does not
show can: a large phase, one beyond a right angle, one that grows with the frequency.
"""

from __future__ import annotations

import math

from fden_ros.core.estimation import EDGE, NO_CHANCE, Uncertainty, kernel_change
from fden_ros.core.oscillation.local_stiffness import Stiffness

#: alpha by the phase above which it is taken for a lag [1]: published livers have 0.12 to 0.15,
#: measured beef 0.32 in the median.
LARGEST_ORDER = 0.35
#: Standard deviations within which a stated delay may be all of a phase [1].
_STATED = 2.0
#: Windows at a frequency before its phase is compared with that at another [1]: 14 degrees of
#: freedom of both make three deviations as rare as one in 200.
_WINDOWS = 8
#: Frequencies are one within a step; so many make an octave [1].
_STEPS = 3


def is_out_of_step(order: float, deviation: float) -> bool:
    """Return whether alpha by the phase is too large, and not by what is stated of the rig."""
    return order > max(LARGEST_ORDER, _STATED * deviation)


def leads_beyond_right_angle(stiffness: Stiffness) -> bool:
    """Return whether the force leads the displacement by more than 90 degrees, for sure."""
    sd = math.sqrt(max(float(stiffness.covariance[0, 0]), 0.0))
    return stiffness.value.real < -NO_CHANCE * sd and stiffness.value.imag > 0.0


def sentence(value: complex, angular_frequency: float) -> str:
    """Return in one line what a complex stiffness is whose phase no relaxation makes."""
    phase = math.atan2(value.imag, value.real)
    return (
        f"the force leads the displacement by {math.degrees(phase):.0f} degrees at "
        f"{angular_frequency / (2.0 * math.pi):.2g} Hz, which no relaxation of tissue makes, so "
        f"stiffness and alpha are not known. One of the two is stamped late (displacement.delay "
        f"{phase / angular_frequency:.3f} s if all of it is lag)"
    )


class PhaseGrowth:
    """Compares the phases of one place at its lowest and highest frequency of palpation."""

    def __init__(self) -> None:
        self._phases: dict[int, _Phases] = {}

    def add(self, angular_frequency: float, phase: float) -> None:
        """Take the phase [rad] of a window at a frequency [rad/s]."""
        key = round(_STEPS * math.log2(angular_frequency))
        self._phases.setdefault(key, _Phases(angular_frequency)).add(phase)

    def grows(self, uncertainty: Uncertainty) -> bool:
        """Return whether the phase grows with the frequency.

        By what is stated of the delay and of the law's kernel it may grow, too.
        """
        seen = [phases for _, phases in sorted(self._phases.items()) if phases.count >= _WINDOWS]
        if len(seen) < 2:
            return False
        slow, fast = seen[0], seen[-1]
        way = math.log(fast.angular_frequency / slow.angular_frequency)
        delay = (fast.angular_frequency - slow.angular_frequency) * uncertainty.delay_sd
        kernel = kernel_change(uncertainty.kernel_sd, way)
        of_law = kernel * (0.5 * math.pi / way) ** 2
        variance = slow.variance + fast.variance + delay**2 + of_law
        return fast.mean - slow.mean > EDGE * math.sqrt(variance)


class _Phases:
    """Mean of the phases of windows [rad], and its variance."""

    def __init__(self, angular_frequency: float) -> None:
        self.angular_frequency = angular_frequency
        self.count, self.mean, self._squares = 0, 0.0, 0.0

    def add(self, phase: float) -> None:
        self.count += 1
        off = phase - self.mean
        self.mean += off / self.count
        self._squares += off * (phase - self.mean)

    @property
    def variance(self) -> float:
        return self._squares / (self.count - 1) / self.count
