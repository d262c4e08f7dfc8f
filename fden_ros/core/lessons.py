# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a site tells of the rig: its delay and friction, and how little the surface moves."""

from __future__ import annotations

from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation import Estimator, RigKnowledge


class Lessons:
    """What one site tells of the rig.

    Attributes
    ----------
    known : RigKnowledge
        What was known of the rig before the first touch.
    count : bool
        Other sites may use them.
    """

    def __init__(self, config: PipelineConfig, known: RigKnowledge) -> None:
        self._config = config
        self.known, self.count = known, True
        #: Evidence for the surface's motion: of the newest contact, and of the newest that told.
        self._motion: list[float] | None = None
        self._told_motion: list[float] | None = None

    def motion_factor(self, estimator: Estimator) -> float:
        """Take the end of a contact; return by what its motion widens the covariance."""
        teaches = self._config.learns_motion and self.count
        is_asked = teaches or self.known.motion_share < 1.0
        motion = self._motion = estimator.motion_evidence() if is_asked else None
        return self.known.motion_factor(motion) if motion is not None else 1.0

    def rig(self, estimator: Estimator) -> RigKnowledge | None:
        """Return what is known of the rig after a contact; None where it tells nothing."""
        if not self.count or estimator.is_doubtful:
            return None
        known = estimator.rig() if self._config.learns_rig else None
        if not self._config.learns_motion:
            return known
        self._told_motion = self._motion or self._told_motion
        if self._told_motion is None:
            return known
        return (known or self.known).moved(self._told_motion)
