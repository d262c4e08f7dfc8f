# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Gn from the harmonics of a palpation, where the whole stroke is beyond the boundary strain.

There :math:`\varphi` grows by :math:`e^{z \cos\omega t}` with :math:`z = G_n A / h`, A being the
amplitude and h the length by which the displacement is a strain: neither the depth nor the origin
counts. With the modified Bessel functions :math:`I_n` the harmonics of the force are

.. math:: F_n \propto I_n(z)\,(j n \omega)^\alpha ,

so the second tells z, and the third and the second's phase tell whether the law holds: a stroke
that passes the boundary has a third harmonic several times larger (2 % too small a z goes with one
larger by a fifth of itself), any other curve one of its own. Without that evidence nothing is
said. The displacement's own harmonics are taken off.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np
from scipy.special import ive

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Uncertainty
from fden_ros.core.oscillation.complex_modulus import Phasors
from fden_ros.core.oscillation.palpation import Palpated

#: Harmonics that are looked at.
HARMONICS = (1.0, 2.0, 3.0)
#: A larger z is of no palpation; nor is more force times amplitude, squared [N^2 m^2].
_LARGEST, _MOST_INFORMATION = 3.5, 1e100
#: z is told from this many of its deviations on; what the law says of the third harmonic and
#: of the second's phase may be off by this many of theirs, which are at most these shares of it.
_PRESENT, _OFF = 6.0, 3.0
_MOST_THIRD, _MOST_PHASE = 0.25, 0.2
#: A stroke that passes the boundary unseen makes z too small by at most twice this share of z
#: times what the third harmonic may be off, in shares of itself; computed from phi.
_UNSEEN = 0.1
#: Part of its weight that a window keeps when the next one comes, and least degrees of
#: freedom for a standard deviation.
_KEPT, _LEAST_FREEDOM = 0.97, 6.0


class Nonlinearity(NamedTuple):
    """What the harmonics tell of Gn."""

    value: float  #: Gn over the geometry's length [1/m]
    sd: float  #: [1/m]


class _Average:
    """The mean of what windows tell, the newest 33 or so, and its deviation by their scatter."""

    def __init__(self) -> None:
        self.mean = 0j
        self._information = self._spread = self._freedom = 0.0
        # Of normalised surprises, real and imaginary, and of each times the one before.
        self._squares, self._products, self._last = np.zeros(2), np.zeros(2), np.zeros(2)

    def add(self, value: complex, information: float) -> None:
        """Take a window; its variance is inverse to `information`."""
        error = value - self.mean
        if self._information > 0.0:
            scale = math.sqrt(1.0 / self._information + 1.0 / information)
            surprise = np.array([error.real, error.imag]) / scale
            self._squares = _KEPT * self._squares + surprise**2
            self._products = _KEPT * self._products + surprise * self._last
            self._freedom = _KEPT * self._freedom + 1.0
            self._last = surprise
        self._information = _KEPT * self._information + information
        self._spread = _KEPT**2 * self._spread + information
        self.mean += information / self._information * error

    @property
    def sd(self) -> Array:
        """Standard deviations of both parts (2,); infinite before there are enough windows.

        Windows that resemble those before them count for less: it drifts along the path.
        """
        if self._freedom < _LEAST_FREEDOM:
            return np.full(2, np.inf)
        alike = np.clip(self._products / np.maximum(self._squares, 1e-300), 0.0, 0.9)
        variance = self._squares / (self._freedom - 2.0) * (1.0 + alike) / (1.0 - alike)
        return np.asarray(np.sqrt(variance * self._spread) / self._information)


class PalpatedNonlinearity:
    """Follows Gn along the path, window after window."""

    def __init__(self) -> None:
        self._second = _Average()  # z over A [1/m]; imaginary: its phase
        self._third = _Average()  # the third harmonic over A^2 [1/m^2]
        self._amplitude = 0.0

    def add(self, phasors: Phasors, order: float) -> None:
        """Take a window.

        `phasors` are of displacement [m] and force [N] at the three harmonics, `order` is alpha
        [1].
        """
        motion, force = phasors.strain, phasors.stress
        amplitude = abs(complex(motion[0]))
        information = (abs(complex(force[0])) * amplitude) ** 2
        if not 0.0 < information < _MOST_INFORMATION:
            return
        stiffness = force[0] / motion[0]
        own = force - stiffness * np.array(HARMONICS) ** order * motion
        turn = cmath.exp(-1j * cmath.phase(force[0]))
        half = cmath.exp(0.5j * math.pi * order)
        second = own[1] * turn**2 * half / abs(force[0]) * 2.0**-order
        third = own[2] * turn**3 * half**2 / abs(force[0]) * 3.0**-order
        z = math.copysign(_z_of(abs(second.real)), second.real)
        slope = z / second.real if abs(z) > 1e-6 else 4.0
        self._amplitude = amplitude
        self._second.add(complex(z, slope * second.imag) / amplitude, information)
        self._third.add(third / amplitude**2, information * amplitude**2)

    def value(self, palpated: Palpated, uncertainty: Uncertainty) -> Nonlinearity | None:
        """Return it; None where the harmonics do not show the law."""
        second, third = self._second.mean, self._third.mean
        value = second.real
        order, order_sd = palpated.estimate.fractional_order, palpated.estimate.deviations[2]
        by_rig = math.hypot(
            2.0 * uncertainty.compliance_sd * abs(palpated.stiffness.value),
            math.log(2.0) * float(order_sd),
        )
        own_sd, across_sd = self._second.sd.tolist()
        phase_sd = math.hypot(across_sd, 0.5 * math.pi * float(order_sd) * value)
        is_shown = value > _PRESENT * own_sd and phase_sd < _MOST_PHASE * value
        # What is not a number shows nothing.
        if not (is_shown and abs(second.imag) < _OFF * phase_sd):
            return None
        if value * self._amplitude > _LARGEST:
            return None
        expected = _ratio(3, value * self._amplitude) / self._amplitude**2
        # Friction has a third harmonic too, at a right angle to the displacement's.
        lean = math.tan(0.5 * math.pi * order)
        off = abs(third.real - lean * third.imag - expected) / expected
        third_sd = self._third.sd @ np.diag([1.0, lean]) / expected
        off_sd = math.hypot(*third_sd.tolist(), 2.0 * own_sd / value, by_rig)
        if not (off_sd < _MOST_THIRD and off < min(_OFF * off_sd, 2.0 * _MOST_THIRD)):
            return None
        unseen = _UNSEEN * value * self._amplitude * (off + off_sd)
        return Nonlinearity(value, value * math.hypot(own_sd / value, by_rig, unseen))


def _ratio(harmonic: int, z: float) -> float:
    """Return the ratio of a harmonic to the first, less (j n)^alpha."""
    return float(ive(harmonic, z) / ive(1, z))


def _z_of(ratio: float) -> float:
    """Return z by the ratio of the second harmonic; beyond any palpation's it stops."""
    most, least = 2.0 * _LARGEST, float(np.finfo(float).eps)
    ratio = min(ratio, _ratio(2, most))
    # Importing it takes as long as all else here, and few recordings oscillate.
    from scipy.optimize import brentq

    return float(brentq(lambda z: _ratio(2, z) - ratio, least, most))
