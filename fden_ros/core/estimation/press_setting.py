# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is known of a press before its first sample, and the posterior that this makes."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.density import Belief
from fden_ros.core.estimation.error_model import ErrorModel, Noise
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.mixture import Component, moments
from fden_ros.core.estimation.posterior import Posterior
from fden_ros.core.estimation.press_model import FreeSurface, PressModel
from fden_ros.core.estimation.scales import carried_scales, scales_of
from fden_ros.core.estimation.smooth_errors import strain_range
from fden_ros.core.estimation.unknowns import (
    ORIGIN,
    Lifetime,
    unknowns_of,
)
from fden_ros.core.law import Geometry


def is_sound(component: Component) -> bool:
    """Whether no variance is negative."""
    return bool((component.covariance.diagonal() >= 0.0).all())


@dataclass(frozen=True)
class Carried:
    """The posterior of the last press of a site, or one Gaussian of it."""

    model: PressModel
    components: tuple[Component, ...]  #: of its unknowns, with their parts of the whole

    @functools.cached_property
    def moments(self) -> tuple[Array, Array]:
        """Mean and covariance of all, (n,), (n, n)."""
        return moments(self.components)

    @property
    def parts(self) -> tuple[Carried, ...]:
        """Each of its Gaussians by itself, as the prior of one hypothesis."""
        return tuple(replace(self, components=(one,)) for one in self.components)

    @property
    def weight(self) -> float:
        """Its part in the whole posterior [1]."""
        return sum(one.weight for one in self.components)

    @property
    def is_sound(self) -> bool:
        """Whether no variance is negative: rounding may do that to one beside huge ones."""
        return all(is_sound(one) for one in self.components)


@dataclass(frozen=True)
class PressSetting:
    """What is known of a press before its first sample."""

    config: EstimatorConfig
    geometry: Geometry
    origin_sd: float  #: standard deviation of the strain origin [1]; 0: known
    #: Standard deviations of a sample's stress [Pa], of its zero [Pa] and of that one's drift
    #: [Pa/s].
    stress_sd: float
    zero_sd: float
    drift_sd: float
    carried: Carried | None = None  #: None: the first press of the site
    #: What earlier presses have left of the tissue; None: it is at rest.
    free: FreeSurface | None = None

    @property
    def is_bent(self) -> bool:
        """Whether the law may have errors."""
        return self.config.uncertainty.characteristic_sd > 0.0

    @property
    def can_tell_mismatch(self) -> bool:
        """Whether a press can tell that another law is likelier: the first that learns alpha."""
        return self.is_bent and self.carried is None and not self.config.is_order_given

    def origin(self, mean: Array) -> float:
        """Return the strain origin of a state, as compression [1]."""
        return float(self.by_origin(mean.size) @ mean)

    def origin_deviation(self, covariance: Array) -> float:
        """Return the standard deviation of the strain origin, as compression [1]."""
        row = self.by_origin(len(covariance))
        return math.sqrt(max(float(row @ covariance @ row), 0.0))

    def by_origin(self, size: int) -> Array:
        """Return by what a state makes the strain origin, (size,)."""
        row = np.zeros(size)
        row[ORIGIN] = self.origin_sd
        return row

    def largest_strain(self, deepest: float, origin: float) -> float:
        """Return the strain of a largest compression [1] from an origin, as compression [1]."""
        return self.geometry.strain(max(deepest - origin, 0.0))

    def posterior(
        self,
        compression_sd: float,
        deepest: float,
        kind: type[PressModel] = PressModel,
    ) -> Posterior:
        """Return the posterior, given a record.

        Parameters
        ----------
        compression_sd : float
            Standard deviation of a sample's compression [1].
        deepest : float
            Largest compression of the site [1].
        kind : type
            Of the model.
        """
        config = self.config
        unknowns = unknowns_of(config, self.geometry, self.origin_sd, self.drift_sd)
        last_knot = strain_range(self.geometry.strain(max(deepest + self.origin_sd, 0.0)))
        model = kind(
            unknowns, self.geometry, is_bent=self.is_bent, last_knot=last_knot, free=self.free
        )
        noise = Noise(self.stress_sd, compression_sd, self.zero_sd)
        belief, grid, has_fields = self._first_belief(model), scales_of(config.uncertainty), True
        if self.carried is not None and self.carried.is_sound:
            belief, has_fields = _taken_over(self.carried, model, belief)
            if not has_fields:
                grid = carried_scales(config.uncertainty)
        return Posterior(
            model,
            ErrorModel(self.geometry, config.uncertainty, noise, model.order),
            belief,
            grid,
            has_field_prior=has_fields and self.is_bent,
            order_sd=0.0 if config.learns_fractional_order else config.prior.fractional_order_sd,
        )

    def _first_belief(self, model: PressModel) -> Belief:
        """Return the belief at the first press of a site: as stated."""
        mean, precision = np.zeros(model.size), np.zeros((model.size, model.size))
        for k, unknown in enumerate(model.unknowns):
            mean[k] = unknown.mean
            precision[k, k] = 1.0 / unknown.unit**2 if unknown.unit else 1.0
        return Belief(mean, precision)


def _taken_over(carried: Carried, model: PressModel, first: Belief) -> tuple[Belief, bool]:
    """Return the belief after an earlier press; and whether the law's errors are open anew."""
    before = carried.model
    names = [u.name for u in before.unknowns if u.lifetime is not Lifetime.CONTACT]
    places = [[u.name for u in model.unknowns].index(name) for name in names]
    sources = [[u.name for u in before.unknowns].index(name) for name in names]
    has_fields = model.is_bent and before.last_knot == model.last_knot
    if has_fields:
        places += range(model.kernel.start, model.size)
        sources += range(before.kernel.start, before.size)
    mean, precision = first.mean.copy(), first.precision.copy()
    before_mean, before_covariance = carried.moments
    mean[places] = before_mean[sources]
    covariance = before_covariance[np.ix_(sources, sources)]
    scale = np.sqrt(covariance.diagonal())
    scale[scale == 0.0] = 1.0
    # So that rounding leaves the variances positive.
    scaled = covariance / np.outer(scale, scale) + 1e-9 * np.eye(scale.size)
    precision[np.ix_(places, places)] = np.linalg.inv(scaled) / np.outer(scale, scale)
    return Belief(mean, precision), model.is_bent and not has_fields
