# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The covariance S of the cells of a place: one matrix for all nodes.

.. math::
    S = X P X^T + S_w + S_v, \qquad P = \mathrm{diag}(\sigma_\epsilon^2 C_\epsilon,\;
    \sigma_\delta^2 C_\delta,\; \text{rig})

- X: by what each unknown changes the cells; as Gaussians the unknowns are covariance.
- S_w: random walks: the law's roughness over the change of ln psi and of ln age of the loading,
  the force's zero and the surface against its stiffness, anew in each press.
- S_v: noise of force and motion, and what the two points of a cell miss.

The sizes of the law's errors and of the surface's motion, :class:`Scales`, are weighed on a grid.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.cells import Press
from fden_ros.core.estimation.discrepancy import (
    CURVE,
    KERNEL,
    RIG,
    STRAIN_FLOOR,
    curve_root,
    kernel_root,
)
from fden_ros.core.estimation.estimator_config import Uncertainty
from fden_ros.core.estimation.law import Expansion, Law, Linear

#: An age of the loading below this counts as none [s].
_YOUNG = 0.01
#: The tissue's surface moves against its stiffness after this time [s], as found on breathing.
_SURFACE_TIME = 0.25
#: What the two points of a cell miss of its mean stress, over that stress [1].
_MISSED = 5e-4
#: So that S is positive, of its diagonal [1].
JITTER = 1e-9
#: Sizes of the errors over the stated one: of delta with the logarithm of their prior, of epsilon,
#: and of the roughness; of the surface's motion over the stated one: it may widen, never shrink.
_KERNELS = ((0.001, -2.0), (0.1, -2.0), (1.0, 0.0), (2.0, 0.0), (4.0, -1.0))
_CURVES = (0.001, 0.1, 0.5, 1.0, 2.0)
_ROUGHNESS = (0.0, 0.05, 0.15, 0.5)
_MOTIONS = (1.0, 2.5)


class Noise(NamedTuple):
    """Standard deviations of what is measured, per sample."""

    stress: float  #: [Pa]
    indentation: float = 0.0  #: [1]
    #: Of another law, for the same cells: whose noise and motion of the surface count.
    beside: Covariance | None = None


class Scales(NamedTuple):
    """Sizes of the law's errors and of the surface's motion: one place of their grid."""

    kernel: float
    curve: float
    roughness: float
    motion: float = 1.0
    log_prior: float = 0.0

    @property
    def sizes(self) -> tuple[float, ...]:
        """The sizes."""
        return self[:4]

    @property
    def smooth(self) -> tuple[float, float]:
        """Those of the smooth errors, in the order of :attr:`Covariance.roots`."""
        return self.kernel, self.curve


@functools.lru_cache(maxsize=16)
def scales_of(uncertainty: Uncertainty) -> tuple[Scales, ...]:
    """Return the grid of scales."""
    unit = uncertainty.characteristic_sd
    motions = _MOTIONS if uncertainty.surface_motion_sd else (1.0,)
    if not unit:
        return tuple(Scales(0.0, 0.0, 0.0, motion) for motion in motions)
    found = []
    for (i, (kernel, log_prior)), (j, curve), (r, roughness), motion in itertools.product(
        enumerate(_KERNELS), enumerate(_CURVES), enumerate(_ROUGHNESS), motions
    ):
        # Errors of kernel and curve go together: by one place apart a scale is less likely by
        # e^-0.5. A law with no roughness has no other error either.
        if abs(i - j) <= 2 and not (r == 0 and j > 0) and not (r > 1 and j == 0):
            log = log_prior - 0.5 * (i - j) ** 2
            found.append(Scales(kernel * unit, curve * unit, roughness * unit, motion, log))
    return tuple(found)


class Loading(NamedTuple):
    """How the tissue is loaded at a cell: its load with what counts as none, and mean age [s]."""

    load: float
    age: float

    def after(self, load: float, seconds: float) -> tuple[Loading, float]:
        """Return the loading at the next cell, and by how much the clock of the roughness goes."""
        age = max((self.age + seconds) * min(self.load / load, 1.0), 0.5 * seconds)
        turned = abs(math.log((age + _YOUNG) / (self.age + _YOUNG)))
        return Loading(load, age), abs(math.log(load / self.load)) + turned


@dataclass(eq=False)
class Clocks:
    """How far the walks have gone at each cell, (N,): in variances, at scales of 1."""

    press: Array  #: the number of the press
    roughness: Array  #: [Pa^2]
    force: Array  #: [Pa^2]
    surface: Array  #: [1]
    gain: Array  #: stress by indentation of the surface [Pa]


class Covariance:
    """S about one node, by its parts."""

    def __init__(self, law: Law, about: Expansion, linear: Linear, noise: Noise) -> None:
        self.law, self.about, self.linear = law, about, linear
        self._noise = noise
        log_gn = round(float(about.theta[law.kernels]), 2)
        #: Places of the smooth errors in a state, and roots of their covariance at scales of 1.
        self.roots = (
            (KERNEL, kernel_root(_order_of(law, about))),
            (CURVE, curve_root(math.exp(log_gn), law.last_knot)),
        )
        self.variances = about.rig
        self.floor = STRAIN_FLOOR * math.exp(about.log_g)
        self.loading = Loading(self.floor, 0.0)
        self.clocks = self._clocks()
        self.noise: Array = noise.beside.noise if noise.beside else self._noise_of_cells()
        columns, clocks, least = linear.columns, self.clocks, np.minimum.outer
        #: Their columns, likewise.
        self.smooth = tuple(columns[:, at] @ root for at, root in self.roots)
        same = clocks.press[:, None] == clocks.press
        rig = columns[:, RIG:] * np.sqrt(self.variances)
        self.fixed = np.diag(self.noise) + rig @ rig.T
        self.fixed += same * least(clocks.force, clocks.force)
        self._rough = same * least(clocks.roughness, clocks.roughness)
        self._motion = (
            same * np.outer(clocks.gain, clocks.gain) * least(clocks.surface, clocks.surface)
        )

    def _clocks(self) -> Clocks:
        law, stresses = self.law, self.linear.stresses
        parts = []
        for q, (press, cells) in enumerate(
            zip(law.place.presses, law.place.cell_slices, strict=True)
        ):
            seconds = np.diff(press.middles, prepend=press.start)
            self.loading, clock = Loading(self.floor, 0.0), np.empty(seconds.size)
            loads = self.linear.loads[cells] + self.floor
            for k, (load, step) in enumerate(zip(loads.tolist(), seconds.tolist(), strict=True)):
                self.loading, clock[k] = self.loading.after(load, step)
            rough = np.cumsum(stresses[cells] ** 2 * clock)
            parts.append((np.full(seconds.size, q), rough, *self.walked(press)))
        number, rough, force, surface = map(np.concatenate, zip(*parts, strict=True))
        beside = self._noise.beside
        gains = beside.clocks.gain if beside else self.linear.gains * self.surface_factor
        return Clocks(number, rough, force, surface, gains)

    @functools.cached_property
    def surface_factor(self) -> float:
        """The stiffness that the surface meets over that without relaxation [1/s^alpha]."""
        return float(self.law.relaxed(self.about.theta, np.array([_SURFACE_TIME]))[0])

    def walked(self, press: Press) -> tuple[Array, Array]:
        """Return the variances of force [Pa^2] and surface [1] at the cells of a press, (N,)."""
        elapsed, rig = press.middles - press.start, self.law.rig
        force = rig.force_walk_sd**2 * elapsed + rig.zero_sd**2
        return force, rig.surface_walk_sd**2 * elapsed

    def _noise_of_cells(self) -> Array:
        place, linear = self.law.place, self.linear
        columns = linear.gains, linear.steepest, linear.stresses
        each = [
            self.noise_of(press, *(column[cells] for column in columns))
            for press, cells in zip(place.presses, place.cell_slices, strict=True)
        ]
        return np.concatenate(each)

    def noise_of(self, press: Press, gains: Array, steepest: Array, stresses: Array) -> Array:
        """Return the variances of the cells of a press that are theirs alone [Pa^2]."""
        durations = np.maximum(press.durations, 1e-4)
        widths = np.maximum(press.times[press.last] - press.times[press.first], press.steps)
        fast, slow = (self.law.relaxed(self.about.theta, v) for v in (durations, widths))
        sample = self._noise.stress**2 + (gains * fast * self._noise.indentation) ** 2
        off = press.missed * steepest * slow
        return np.asarray(sample / press.counts + off**2 + (_MISSED * stresses) ** 2)

    def at(self, scales: Scales) -> Array:
        """Return S, (N, N)."""
        found = self.without_smooth(scales)
        for columns, size in zip(self.smooth, scales.smooth, strict=True):
            if size:
                found += size**2 * (columns @ columns.T)
        return found

    def without_smooth(self, scales: Scales) -> Array:
        """Return S with a law that has no smooth errors."""
        found: Array = self.fixed + scales.motion**2 * self._motion
        if scales.roughness:
            found += scales.roughness**2 * self._rough
        found[np.diag_indices_from(found)] *= 1.0 + JITTER
        return found

    def prior(self, scales: Scales) -> Array:
        """Return the covariance P of a state, (k, k)."""
        found = np.zeros((self.law.size, self.law.size))
        for (places, root), size in zip(self.roots, scales.smooth, strict=True):
            found[places, places] = size**2 * root @ root.T
        at = np.arange(RIG, self.law.size)
        found[at, at] = self.variances
        return found

    def parts(self, scales: Scales) -> dict[str, Array]:
        """Return S by its sources, of which it is the sum; each (N, N)."""
        clocks, least = self.clocks, np.minimum.outer
        same = clocks.press[:, None] == clocks.press
        smooth = scales._replace(roughness=0.0)
        law = self.at(smooth) - self.without_smooth(smooth) + scales.roughness**2 * self._rough
        found = {"noise": np.diag(self.noise), "law": law}
        found["drift"] = same * least(clocks.force, clocks.force)
        found["motion"] = scales.motion**2 * self._motion
        for k, (one, _) in enumerate(self.law.slots):
            column = self.linear.columns[:, RIG + k]
            own = self.variances[k] * np.outer(column, column)
            found[one.source] = found.get(one.source, 0.0) + own
        return found

    def shifts(self) -> Array:
        """Return X z0, what is known of the unknowns: at the node, and by theta, (N, 1 + d)."""
        return np.asarray(self.linear.columns @ self.expected)

    @functools.cached_property
    def expected(self) -> Array:
        """The unknowns z0, at the node and by theta, (k, 1 + d).

        Of what enters the stress linearly only the prior's mean counts: responses are without it.
        """
        found = np.column_stack([np.clip(self.about.state, -8.0, 8.0), self.about.by_theta])
        for k, (one, _) in enumerate(self.law.slots, RIG):
            if not one.moves:
                found[k] = 0.0
                found[k, 0] = -one.mean
        return found


def _order_of(law: Law, about: Expansion) -> float:
    return max(round(float(about.theta[0]), 3), 1e-3) if law.has_kernel_error else 0.3


@functools.lru_cache(maxsize=256)
def near(uncertainty: Uncertainty, scales: Scales) -> list[Scales]:
    """Return the places of the grid of scales that are next to one in each size, with itself."""
    grid = scales_of(uncertainty)
    sizes = np.array([one.sizes for one in grid])
    places = np.array([np.unique(column, return_inverse=True)[1].ravel() for column in sizes.T]).T
    apart = np.abs(places - places[grid.index(scales)])
    return [one for one, far in zip(grid, apart.max(axis=1).tolist(), strict=True) if far <= 1]
