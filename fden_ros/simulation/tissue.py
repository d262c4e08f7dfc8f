# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Tissue in time steps: what a probe meets whose motion is not known beforehand.

:mod:`simulation.closed_form` needs the whole motion; a closed loop has only the past. The
law :math:`f = D^\alpha \varphi(x)` is stepped with :math:`\varphi` linear in between (the L1
scheme; Oldham and Spanier, The Fractional Calculus, 1974), the newest step with the true kernel
and the past in one number per exponential of

.. math:: \frac{t^{-\alpha}}{\Gamma(1-\alpha)} = \frac{\sin\pi\alpha}{\pi}
          \int_{-\infty}^{\infty} e^{\alpha u}\, e^{-t e^u}\, du ,

which the trapezoidal rule sums to eight digits (Beylkin and Monzón, Appl. Comput. Harmon. Anal.
28 (2010) 131). Nothing is shared with :mod:`fden_ros.core`. A column may relax otherwise, by any
sum of springpots and exponentials, and have any characteristic.

Contact pushes and never pulls. With the stress of a step :math:`f_n = q + c\,(\varphi_n -
\varphi_{n-1})`, q of the past, the free surface is at :math:`\varphi_s = \varphi_{n-1} - q/c`:
the probe is in contact where its own :math:`\varphi` is larger.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fden_ros.errors import InputError
from fden_ros.simulation.model import FdenModel, FloatArray

#: Step of ln(rate): the rule's error falls as exp(-pi^2 / step), here 3e-9.
_LOG_STEP = 0.5
#: Longest time [s] that is remembered exactly.
_LONGEST_MEMORY = 1e5
_SLOW = 1e-7
_FAST = 40.0
#: Nothing overflows: far beyond any tissue.
_MAX_EXPONENT = 60.0


@dataclass(frozen=True)
class Inclusion:
    """A stiff body under the surface, loaded in parallel with the tissue from some strain on.

    Parameters
    ----------
    strain
        Strain of the tissue at which it is met, not negative.
    linear_stiffness
        G in Pa·s^alpha, of the body over the strain since it was met; not negative.
    """

    strain: float
    linear_stiffness: float

    def __post_init__(self) -> None:
        if not (self.strain >= 0.0 and self.linear_stiffness >= 0.0):
            raise InputError(
                f"inclusion: strain {self.strain} and linear_stiffness {self.linear_stiffness} "
                "must not be negative"
            )


@dataclass(frozen=True)
class Relaxation:
    """The stress that a unit step of the elastic response leaves, over time.

    Parameters
    ----------
    springpots
        (weight, order) of each: weight t^-order / Gamma(1 - order), t in s.
    exponentials
        (weight, rate [1/s]) of each: weight exp(-rate t); rate 0 is a spring.
    """

    springpots: tuple[tuple[float, float], ...] = ()
    exponentials: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if not (self.springpots or self.exponentials):
            raise InputError("relaxation: there is neither a springpot nor an exponential")

    def at(self, times: FloatArray) -> FloatArray:
        """Return the relaxation at positive `times` [s], (n,)."""
        value = np.zeros_like(times)
        for weight, order in self.springpots:
            value += weight * times**-order / math.gamma(1.0 - order)
        for weight, rate in self.exponentials:
            value += weight * np.exp(-rate * times)
        return value

    def mean(self, duration: float) -> float:
        """Return its mean over the first `duration` in s."""
        mean = 0.0
        for weight, order in self.springpots:
            mean += weight * duration**-order / math.gamma(2.0 - order)
        for weight, rate in self.exponentials:
            reach = rate * duration
            mean += weight * (-math.expm1(-reach) / reach if reach > 0.0 else 1.0)
        return mean


@dataclass(frozen=True)
class Column:
    """The tissue under the probe at one place.

    Parameters
    ----------
    model
        FDEN parameters.
    inclusions
        Stiff bodies in it. They relax as it does, so they add to its elastic characteristic.
    position
        Where it is, across the approach axis, in m.
    relaxation
        None: that of FDEN, a springpot of the model's alpha.
    characteristic
        phi/G of a strain that is not negative, increasing from 0; None: that of FDEN.
    scale
        By which phi is larger than that of the model.
    """

    model: FdenModel
    inclusions: tuple[Inclusion, ...] = ()
    position: tuple[float, float] = (0.0, 0.0)
    relaxation: Relaxation | None = None
    characteristic: Callable[[float], float] | None = None
    scale: float = 1.0

    @property
    def relaxes(self) -> Relaxation:
        """Its relaxation."""
        return self.relaxation or Relaxation(springpots=((1.0, self.model.fractional_order),))

    def phi(self, strain: float) -> float:
        """Return the elastic characteristic in Pa·s^alpha, inclusions included."""
        model = self.model
        if self.characteristic is not None:
            value = self.characteristic(abs(strain)) * model.linear_stiffness
            return math.copysign(self.scale * value, strain)
        excess = model.nonlinear_stiffness * abs(strain) - 1.0
        value = model.linear_stiffness * strain
        if excess > 0.0:
            scale = model.linear_stiffness / model.nonlinear_stiffness
            value = math.copysign(scale * math.exp(min(excess, _MAX_EXPONENT)), strain)
        for inclusion in self.inclusions:
            value += inclusion.linear_stiffness * max(strain - inclusion.strain, 0.0)
        return self.scale * value


@dataclass(frozen=True)
class _Step:
    """What depends on the duration of a step alone."""

    decay: FloatArray  #: of each exponential, (m,)
    gain: FloatArray  #: of each exponential, by a change of phi, (m,)
    decayed_weights: FloatArray  #: (columns, m)
    slope: FloatArray  #: stress by a change of phi, (columns,)


class Tissue:
    """Columns of tissue, each with its memory, pressed one at a time.

    Parameters
    ----------
    columns
        At least one.
    step
        Time per :meth:`press` in s, positive.

    Raises
    ------
    InputError
        If there is no column or the step is not positive.

    Examples
    --------
    >>> tissue = Tissue([Column(FdenModel(500.0, 8.0, 0.13))], step=1e-3)
    >>> for n in range(1, 501):
    ...     stress = tissue.press(0.1 * n * 1e-3)
    >>> round(stress, 2)
    28.74
    """

    def __init__(self, columns: Sequence[Column], step: float) -> None:
        if not columns:
            raise InputError("tissue: there is no column; give at least one")
        if not (step > 0.0 and math.isfinite(step)):
            raise InputError(f"tissue: the time step is {step} s; it must be positive")
        self.columns = tuple(columns)
        self.step = step
        self._relaxations = [column.relaxes for column in columns]
        self._rates, self._weights = _exponentials(self._relaxations, step)
        self._whole = self._prepared(step)
        self._memory = np.zeros((len(columns), self._rates.size))
        self._phi = np.zeros(len(columns))
        self._strain = 0.0
        self._column = 0

    def nearest(self, x: float, y: float) -> int:
        """Return the index of the column nearest to a place given in m."""
        distances = [math.hypot(x - c.position[0], y - c.position[1]) for c in self.columns]
        return distances.index(min(distances))

    def press(self, strain: float, column: int = 0) -> float:
        """Move on by one step and return the stress in Pa under the probe.

        Parameters
        ----------
        strain
            Strain of the probe at the end of the step; negative above the undisturbed surface.
        column
            Which one it stands over; the others relax.
        """
        whole = self._whole
        before = self._phi[column] - self.columns[column].phi(self._strain)
        free = self._free(whole)
        after = free[column] - self.columns[column].phi(strain)
        touches = column == self._column and before > 0.0 > after
        self._column, self._strain = column, strain
        if not touches:
            return self._advance(whole, free, strain, column)
        # The stress rises steeply from the touch on: the step is split there.
        before_touch = before / (before - after)
        first = self._prepared(before_touch * self.step)
        self._remember(first, self._free(first))
        rest = self._prepared((1.0 - before_touch) * self.step)
        return self._advance(rest, self._free(rest), strain, column)

    def response(self, column: int = 0) -> Callable[[float], float]:
        """Return the stress in Pa after the next whole step, as a function of its strain."""
        free = float(self._free(self._whole)[column])
        slope = float(self._whole.slope[column])
        phi = self.columns[column].phi
        return lambda strain: slope * max(phi(strain) - free, 0.0)

    def _advance(self, step: _Step, phi: FloatArray, strain: float, column: int) -> float:
        """Take one step in which the columns would move freely to `phi`; return the stress."""
        probe = self.columns[column].phi(strain)
        stress = 0.0
        if probe > phi[column]:
            stress = float(step.slope[column] * (probe - phi[column]))
            phi[column] = probe
        self._remember(step, phi)
        return stress

    def _free(self, step: _Step) -> FloatArray:
        """Return phi of the free surfaces after a step, shape (columns,)."""
        past = np.einsum("ij,ij->i", step.decayed_weights, self._memory)
        return self._phi - past / step.slope

    def _remember(self, step: _Step, phi: FloatArray) -> None:
        self._memory *= step.decay
        self._memory += (phi - self._phi)[:, None] * step.gain
        self._phi = phi

    def _prepared(self, duration: float) -> _Step:
        decay = np.exp(-self._rates * duration)
        gain = np.ones_like(self._rates)
        gain[1:] = -np.expm1(-self._rates[1:] * duration) / (self._rates[1:] * duration)
        # Not 0, where the probe is on the surface at the end of the step.
        slope = np.array([one.mean(max(duration, 1e-12)) for one in self._relaxations])
        return _Step(decay, gain, self._weights * decay, slope)

    def surface(self, column: int = 0) -> float:
        """Return phi of a column's surface in Pa·s^alpha: 0 when fully recovered."""
        return float(self._phi[column])


def _exponentials(relaxations: Sequence[Relaxation], step: float) -> tuple[FloatArray, FloatArray]:
    """Return rates (m,), the first 0, and weights (columns, m) of the kernels of the past."""
    first, last = math.log(_SLOW / _LONGEST_MEMORY), math.log(_FAST / step)
    logs = np.arange(first, last + _LOG_STEP, _LOG_STEP)
    own = sorted({rate for one in relaxations for _, rate in one.exponentials if rate > 0.0})
    if not any(one.springpots for one in relaxations):
        logs = logs[:0]
    rates = np.concatenate([[0.0], np.exp(logs), own])
    weights = np.zeros((len(relaxations), rates.size))
    for row, one in zip(weights, relaxations, strict=True):
        for weight, order in one.springpots:
            scale = math.sin(math.pi * order) / math.pi * _LOG_STEP
            row[1 : logs.size + 1] += weight * scale * np.exp(order * logs)
            # All slower rates together: a geometric series.
            slower = scale * math.exp(order * first) / math.expm1(order * _LOG_STEP)
            row[0] += weight * slower
        for weight, rate in one.exponentials:
            row[logs.size + 1 + own.index(rate) if rate > 0.0 else 0] += weight
    return rates, weights
