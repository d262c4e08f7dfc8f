# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is known of the rig: one delay and one friction for all contacts.

The compliance is one for all contacts too, but not learned: what contacts tell of it is too little
where the tissue is soft, and wrong where it is stiff, since the displacement's noise then looks
like a stiffer tool. The thickness cannot be learned: ln G and ln Gn are off together by its error,
and nothing else is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimator_config import EstimatorConfig, Uncertainty
from fden_ros.core.estimation.learned_scales import (
    DRIFT_SCALES,
    NO_DRIFT_EVIDENCE,
    NO_MOTION_EVIDENCE,
    Evidence,
    largest_likely,
    motion_share,
    pooled,
)

#: What is learned of a rig, by the names of its unknowns.
RIG = ("delay", "friction")


class RigValue(NamedTuple):
    """One quantity of the rig."""

    mean: float
    sd: float


@dataclass(frozen=True)
class RigKnowledge:
    """Mean and covariance of (delay [s], friction [N]).

    The tissue is marginalised. A deviation of 0: the quantity is what it is said to be.
    """

    mean: tuple[float, ...]  #: what `displacement.delay` leaves, and the friction
    covariance: tuple[tuple[float, ...], ...]
    contacts: int = 0  #: contacts that have taught it
    #: Logarithms of the evidence for shares of the stated motion of the surface, which is that of
    #: a patient, and one for all contacts as well.
    motion: Evidence = NO_MOTION_EVIDENCE
    #: The same for scales of the stated drift of the force in contact.
    drift: Evidence = NO_DRIFT_EVIDENCE

    @property
    def drift_share(self) -> float:
        """The share of the stated drift of the force that counts [1]; above 1: it drifts more."""
        return largest_likely(DRIFT_SCALES, self.drift)

    def drifted(self, evidence: Sequence[float]) -> RigKnowledge:
        """Return what is known after the air behind a contact has told of its drift."""
        return replace(self, drift=pooled(self.drift, evidence))

    def drift_factor(self, evidence: Sequence[float]) -> float:
        """Return the factor of the variances where a contact tells of more drift than is known."""
        return max(self.drifted(evidence).drift_share / self.drift_share, 1.0)

    @property
    def motion_share(self) -> float:
        """The share of the stated motion of the surface that counts [1]."""
        return motion_share(self.motion)

    def learned(self, stated: Uncertainty) -> Uncertainty:
        """Return what is not known once the scales of motion and drift are learned."""
        return replace(
            stated,
            surface_motion_sd=self.motion_share * stated.surface_motion_sd,
            force_drift_sd=self.drift_share * stated.force_drift_sd,
        )

    def motion_factor(self, evidence: Sequence[float]) -> float:
        """Return the factor of the variances where a contact tells of more motion than is known.

        The deviations of G, Gn and alpha grow with about the root of the motion's.
        """
        return max(motion_share(pooled(self.motion, evidence)) / self.motion_share, 1.0)

    @classmethod
    def stated(cls, config: EstimatorConfig) -> RigKnowledge:
        """Return what is stated before any contact."""
        variances = np.square(config.uncertainty.rig_sd)
        return cls((0.0, config.friction), _rows(np.diag(variances)))

    @property
    def values(self) -> dict[str, RigValue]:
        """Delay [s] and friction [N], each with its standard deviation."""
        deviations = np.sqrt(np.diag(np.array(self.covariance))).tolist()
        return dict(zip(RIG, map(RigValue, self.mean, deviations), strict=True))

    def scaled(self, uncertainty: Uncertainty) -> tuple[Array, Array]:
        """Return mean (2,) and covariance (2, 2) in the stated deviations; 0 where that is 0."""
        scale = np.array(uncertainty.rig_sd)
        per = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
        return np.array(self.mean) * per, np.array(self.covariance) * np.outer(per, per)

    def moved(self, evidence: Sequence[float] | None) -> RigKnowledge:
        """Return what is known after a contact's evidence for shares of the stated motion."""
        if evidence is None:
            return self
        return replace(self, motion=pooled(self.motion, evidence))

    def taught(self, mean: Array, covariance: Array, config: EstimatorConfig) -> RigKnowledge:
        """Return what is known after a contact; where it contradicts this, what is stated.

        Parameters
        ----------
        mean, covariance : ndarray, shape (2,), (2, 2)
            The contact's posterior, started from this knowledge, in the stated deviations.
        """
        uncertainty = config.uncertainty
        stated = RigKnowledge.stated(config)
        open_ = np.flatnonzero(uncertainty.rig_sd)
        before, spread = self.scaled(uncertainty)
        moved = (mean - before)[open_]
        known = spread[np.ix_(open_, open_)]
        # Beyond 3.72 deviations of what was known, where 1e-3 of two normal variables lie, it
        # speaks of another rig.
        if moved @ np.linalg.solve(known, moved) > 3.72**2:
            return stated
        variances = np.diag(covariance)
        # Learned deviations stay above half of the stated ones: the columns are derivatives at a
        # running linearisation, and what they tell is off the same way in each contact.
        least = np.minimum(0.5**2, np.diag(spread))
        # Added to the diagonal, so that the matrix stays positive definite.
        wider = covariance + np.diag(np.maximum(least - variances, 0.0))
        scale = np.array(uncertainty.rig_sd)
        closed = scale == 0.0
        return RigKnowledge(
            tuple(np.where(closed, stated.mean, mean * scale).tolist()),
            _rows(wider * np.outer(scale, scale)),
            self.contacts + 1,
            self.motion,
            self.drift,
        )


def _rows(matrix: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())
