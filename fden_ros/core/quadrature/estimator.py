# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The estimator of one site: samples in, estimates out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fden_ros.core.estimation import Estimate, EstimatorConfig
from fden_ros.core.estimation.claims import Evidence, claims_of
from fden_ros.core.law import Geometry
from fden_ros.core.quadrature.filter import Innovation
from fden_ros.core.quadrature.place import PlacePosterior, Setting, Touch
from fden_ros.core.quadrature.posterior import Posterior
from fden_ros.core.quadrature.small_motion import SmallMotion

#: Standard deviation of ln N/m for a relaxation that has not been seen, over the stated
#: discrepancy of the law [1]: on a ramp only the curve is.
_UNSEEN = 0.5


class QuadratureEstimator:
    """The estimator of one site.

    Parameters
    ----------
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    contact_point_sd : float
        Standard deviation of the contact point [1]; 0: known.
    path_variance : float
        Of the indentation per sample, times the time between samples [s].
    """

    def __init__(
        self,
        config: EstimatorConfig,
        geometry: Geometry,
        noise_sd: float,
        contact_point_sd: float = 0.0,
        path_variance: float = 0.0,
    ) -> None:
        setting = Setting(config, geometry, noise_sd, contact_point_sd, path_variance)
        self.place = PlacePosterior(setting)
        self._time = 0.0
        self._count = 0
        self._estimate: Estimate | None = None

    def touch(self, onset: Touch, pause: float) -> None:
        """Begin a press, a time without stress [s] after the last sample."""
        self._time = self.place.now + pause
        self.place.touch(onset, self._time)

    def add(
        self,
        times: Sequence[float],
        indentation: Sequence[float],
        stress: Sequence[float],
        on_tissue: Sequence[bool],
    ) -> Estimate:
        """Take samples of the press; return the estimate by now.

        Parameters
        ----------
        times : sequence of float
            Since the touch [s].
        indentation, stress : sequence of float
            From the nominal contact point [1]; [Pa].
        on_tissue : sequence of bool
            Whether the probe is on the tissue, as far as is known.
        """
        for time, u, f, on in zip(times, indentation, stress, on_tissue, strict=True):
            self.place.add(self._time + time, u, f, on_tissue=on)
        self._count += len(times)
        return self.estimate()

    def release(self) -> Estimate:
        """End the press; return the estimate."""
        self.place.release()
        return self.estimate()

    @property
    def innovation(self) -> Innovation | None:
        """Of the newest block; None: it was not predicted."""
        return self.place.innovation

    def estimate(self) -> Estimate:
        """Return the present estimate."""
        posterior = self.place.posterior()
        found = self._prior() if posterior is None else self._of(posterior)
        return found._replace(sample_count=self._count)

    def _prior(self) -> Estimate:
        setting = self.place.setting
        config = setting.config
        covariance = np.diag(config.prior.deviations**2)
        covariance[:2, :2] += config.uncertainty.thickness_sd**2
        claims = claims_of(
            config, Evidence(config.prior.mean, np.sqrt(covariance.diagonal()), 0.0, False)
        )
        log_g, log_gn, order = config.prior.mean.tolist()
        return Estimate(
            log_g,
            log_gn,
            order,
            covariance=covariance,
            contact_point_sd=setting.contact_point_sd,
            observable=claims.observable,
            known=claims.known,
        )

    def _of(self, posterior: Posterior) -> Estimate:
        config = self.place.setting.config
        mean, covariance = posterior.tissue
        beyond = posterior.probability_beyond(self.place.deepest)
        evidence = Evidence(
            mean[:3], np.sqrt(covariance.diagonal()[:3]), beyond, self.place.is_settled
        )
        claims = claims_of(config, evidence)
        seen = self.place.has_slowed or self.place.presses > 1
        unseen = 0.0 if seen else (_UNSEEN * config.uncertainty.characteristic_sd) ** 2
        grid = posterior.grid
        log_g, log_gn, order, contact_point = mean.tolist()
        with_point = covariance[3, :3].tolist()
        return Estimate(
            log_g,
            log_gn,
            order,
            covariance=covariance[:3, :3],
            contact_point=contact_point,
            contact_point_sd=math.sqrt(float(covariance[3, 3])),
            probability_beyond_boundary=beyond,
            observable=claims.observable,
            known=claims.known,
            at_edge=claims.at_edge,
            model_discrepancy=sum(one.curve * part for one, part in grid.scales),
            mean_dwell_time=grid.covariance.loading.age,
            with_origin=(with_point[0], with_point[1], with_point[2]),
            components=posterior.components,
            small_motions=(SmallMotion(posterior, unseen=unseen),),  # type: ignore[arg-type]
        )
