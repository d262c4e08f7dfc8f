# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""What is known of the rig: one delay and one friction for all contacts.

The compliance is one for all contacts too, but not learned: what contacts tell of it is too little
where the tissue is soft, and wrong where it is stiff, since the displacement's noise then looks
like a stiffer tool. The thickness cannot be learned: ln G and ln Gn are off together by its error,
and nothing else is.

How far surface and zero of the force move is learned as scales of what is stated, which holds for
any patient and any sensor. What both are on these is the same for all contacts: each gives the
evidence for several scales of what is stated (MacKay, Neural Computation 4 (1992) 415); the
logarithms add up.

- The motion by a contact's record, with the law taken for exact, so that all it leaves out counts
  as motion. A random walk stands for smooth motion here, and smooth motion is mostly absorbed by
  G, Gn and alpha: the scale that is likely is 3 times too small for their errors.
  (Breathing of 0.3 and of 1 mm wants 0.06 and 0.2 mm in a second by the evidence, and 0.2 and
  0.6 mm for errors of one deviation.)
- The drift by the change d of the air's force over a contact,
  :math:`d \sim N(0, s^2 \sigma_d^2 T + \sigma^2)`, with s the scale and :math:`\sigma` what the
  noise leaves of d. A contact that contradicts what the ones before have told outweighs them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimator_config import EstimatorConfig, Uncertainty

#: Scales [1] of the stated motion and drift that are compared.
MOTION_SCALES = (1.0, 0.5, 0.25, 0.125, 0.0625)
DRIFT_SCALES = (4.0, 2.0, 1.0, 0.5, 0.25)
#: Least share of the stated motion that is believed [1]: below it creep of 20 mN in 2 s, which no
#: contact shows, would be the larger error.
LEAST_SHARE = 0.25

Evidence = tuple[float, ...]
#: Before any contact nothing is known of the motion, and more drift than is stated takes evidence.
NO_MOTION_EVIDENCE: Evidence = (0.0,) * len(MOTION_SCALES)
NO_DRIFT_EVIDENCE: Evidence = (-6.0, -3.0, 0.0, 0.0, 0.0)
#: What is learned of a rig, by the names of its unknowns.
RIG = ("delay", "friction")


def pooled(before: Evidence, contact: Sequence[float]) -> Evidence:
    """Return the logarithms of the evidence of all contacts, relative to the largest."""
    total = [a + b for a, b in zip(before, contact, strict=True)]
    highest = max(total)
    # No more than this speaks against a scale, so that one or two contacts under which the surface
    # moves outweigh any number before.
    return tuple(max(value - highest, -12.0) for value in total)


def motion_share(evidence: Sequence[float]) -> float:
    """Return the share of the stated motion that counts [1]: the largest that is likely."""
    return min(max(3.0 * largest_likely(MOTION_SCALES, evidence), LEAST_SHARE), 1.0)


def drift_evidence(change: float, noise_variance: float, stated_variance: float) -> Evidence:
    """Return the logarithms of the evidence of a change of the air's force for each scale.

    Parameters
    ----------
    change : float
        Of the air after a contact from that before it [N].
    noise_variance : float
        Of the change, without any drift in contact [N^2].
    stated_variance : float
        Of the stated drift over the time between [N^2].
    """
    variances = [noise_variance + scale**2 * stated_variance for scale in DRIFT_SCALES]
    return tuple(-0.5 * (change**2 / v + math.log(v)) for v in variances)


def largest_likely(scales: Sequence[float], evidence: Sequence[float]) -> float:
    """Return the first of the scales, which fall, whose log evidence is near the largest."""
    least = max(evidence) - 2.0
    return next(s for s, value in zip(scales, evidence, strict=True) if value >= least)


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

        `mean`, `covariance`: the contact's posterior, started from this knowledge, in the stated
        deviations, (2,), (2, 2).
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
