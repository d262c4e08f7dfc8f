# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether the tissue is off the probe, sample by sample of one contact."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fden_ros.core.contact import SLIGHT, Onset
from fden_ros.core.estimation import Estimate
from fden_ros.core.law import Geometry, StressMemory, apparent_stiffness_factor, elastic_responses

#: A probe has moved back, or in again, by at least this part of its compression.
_RETREAT = 0.02


class KnownTissue(NamedTuple):
    """Tissue whose estimate has converged, by its law and its past."""

    estimate: Estimate
    memory: StressMemory
    geometry: Geometry

    def is_above_surface(self, step: float, compression: float) -> bool:
        """Whether the tissue would have to pull at the probe `step` seconds from the last."""
        free = self.memory.free_response(step, self.estimate.fractional_order)
        strain = self.geometry.strain(compression - self.estimate.contact_point)
        return self.estimate.is_above_surface(strain, free)

    def change_of_stress(self, before: float, after: float, elapsed: float) -> float:
        """Return by how much the stress changes [Pa] between two compressions [1], in seconds."""
        estimate = self.estimate
        if elapsed <= 0.0:
            return 0.0
        strains = [self.geometry.strain(u - estimate.contact_point) for u in (before, after)]
        elastic = elastic_responses(
            np.array(strains), estimate.linear_stiffness, estimate.nonlinear_stiffness
        )
        step = float(elastic.value[1] - elastic.value[0])
        return step * apparent_stiffness_factor(estimate.fractional_order, elapsed)


class LiftOff:
    """Follows one contact.

    The first touch of a site shows the origin, so the law holds from the origin on. Later touches
    meet a surface that still recovers.

    The probe meets the tissue above the clear force of the `onset`, and leaves it below that of a
    release, so that noise does neither; `is_first`: of the site.
    """

    def __init__(self, onset: Onset, stress_per_force: float, *, is_first: bool) -> None:
        self._release_force, self._clear = onset.release_force, onset.clear_force
        self._stress_per_force = stress_per_force
        self._is_untouched = is_first
        self._is_free = True
        self._deepest = 0.0
        #: Least compression since the lift-off.
        self._lowest = math.inf
        #: Compression and force of the newest sample whose force exceeds the noise, the time
        #: since, and the compression at which the tissue stayed behind.
        self._pressed: tuple[float, float] | None = None
        self._since_pressed = 0.0
        self._left_at: float | None = None

    def see_mean(self, force: float) -> None:
        """Add the mean force of a block [N]: a clear one ends the first touch."""
        self._is_untouched &= force <= self._clear

    def is_free(
        self,
        step: float,
        force: float,
        compression: float,
        tissue: Callable[[], KnownTissue | None],
    ) -> bool:
        """Whether the tissue has left the probe, or has not met it yet, at the next sample.

        `tissue` returns what is known of it; None where the law does not give the surface.
        """
        hidden = 2.0 * self._clear if self._is_free else self._clear
        self._since_pressed += step
        if self._is_untouched:
            self._is_free = False
        elif step > 0.0 and abs(force) <= hidden and (known := tissue()) is not None:
            # Where noise hides the force, the law gives the surface.
            self._is_free = self._is_hidden_free(step, compression, known)
        elif self._is_free:
            self._is_free = force <= self._clear
        else:
            self._is_free = force <= self._release_force and self._has_retreated(compression)
        if force > self._clear:
            self._since_pressed, self._pressed, self._left_at = 0.0, (compression, force), None
        self._lowest = min(self._lowest, compression) if self._is_free else math.inf
        self._deepest = max(self._deepest, compression)
        return self._is_free

    def is_shrinking(self, compression: float) -> bool:
        """Whether the probe has moved back from the deepest.

        Under a round probe tissue comes off at the rim before the force vanishes. Hertz's
        relation, and so the law, holds while the contact grows (T. C. T. Ting, Journal of Applied
        Mechanics 33, 845, 1966): with the retract G was 20 % off.
        """
        return compression < (1.0 - SLIGHT) * self._deepest

    def _is_hidden_free(self, step: float, compression: float, known: KnownTissue) -> bool:
        """Whether the law says that the tissue is off the probe where noise hides the force.

        The law gives the stress to a few standard deviations of the noise. Near the surface its
        answer would alternate from sample to sample, and each time the memory would take noise for
        a touch or a release. So the probe has to move: back since the last force above the noise,
        or in again since the lift-off.
        """
        if self._is_free and not self._has_returned(compression):
            return True
        if self._is_left_behind(compression, known):
            return True
        is_settled = self._is_free or self._has_retreated(compression)
        return is_settled and known.is_above_surface(step, compression)

    def _has_returned(self, compression: float) -> bool:
        """Whether the probe has moved in again since the lift-off."""
        return compression > self._lowest + _RETREAT * abs(self._lowest)

    def _has_retreated(self, compression: float) -> bool:
        """Whether the probe has moved back since a force above the noise.

        Tissue does not leave a probe that holds still. To drop those samples of a hold that noise
        makes small would bias the mean.
        """
        if self._pressed is None:
            return True
        before = self._pressed[0]
        return compression < before - _RETREAT * abs(before)

    def _is_left_behind(self, compression: float, known: KnownTissue) -> bool:
        """Whether the tissue would pull, from the last force above the noise on.

        The law of that motion alone gives the point where the tissue stays behind: with the whole
        past, a stiffness 1 % too low puts the surface 2 % of the depth too far out.
        """
        if self._pressed is None:
            return False
        if self._left_at is None:
            before, force = self._pressed
            change = known.change_of_stress(before, compression, self._since_pressed)
            stress = force * self._stress_per_force + change
            if stress < -self._clear * self._stress_per_force:
                self._left_at = compression
        return self._left_at is not None and compression <= self._left_at
