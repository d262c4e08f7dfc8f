# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a press tells of the rig: delay and friction, and how the surface moves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fden_ros.core.estimation.mixture import Component, moments
from fden_ros.core.estimation.press_posterior import PressPosterior
from fden_ros.core.estimation.press_setting import rig_places
from fden_ros.core.estimation.rig_knowledge import MOTION_SCALES, RigKnowledge
from fden_ros.core.estimation.search import Solved
from fden_ros.core.estimation.unknowns import Lifetime


def misfit(solved: Solved) -> float:
    """Return how far a press says the rig is from what is stated, in standard deviations [1]."""
    belief, best, off = solved.posterior.belief, solved.best, 0.0
    before = belief.variances()
    for k, unknown in enumerate(solved.model.unknowns):
        if unknown.lifetime is Lifetime.RIG:
            # It tells at least this part of the variance.
            told = max(before[k] - best.covariance[k, k], 0.01 * before[k])
            off = max(off, abs(best.mean[k] - belief.mean[k]) / math.sqrt(told))
    return off


def motion_evidence(press: PressPosterior) -> list[float] | None:
    """Return the log evidence of a press for scales of the surface's stated motion.

    The law counts as exact, so that all it leaves out counts as motion. None: it tells nothing.
    """
    if not press.weighed or any(one.misses for one in press.likely):
        return None
    found = []
    for weight, one in press.weighed:
        stated, solved = one.setting.stated.surface_motion_sd, one.solved
        if not stated or solved is None:
            return None
        now = one.setting.config.uncertainty.surface_motion_sd
        exact = min(weighed.scales for weighed in solved.posterior.grid)
        grid = [exact._replace(motion=scale * stated / now) for scale in MOTION_SCALES]
        points, maximum = one.points(press.intake.record.points()), solved.best.maximum
        own = [solved.posterior.evidence(points, replace(maximum, scales=s)) for s in grid]
        found.append(math.log(weight) + np.array(own) - max(own))
    return np.logaddexp.reduce(found, axis=0).tolist()


def rig_after(press: PressPosterior) -> RigKnowledge | None:
    """Return what is known of the rig after a press, by all its hypotheses; None: nothing new."""
    if not press.weighed:
        return None
    setting = press.setting
    found = []
    for weight, one in press.weighed:
        assert one.solved is not None
        own, places = rig_places(one.solved.model)
        if not own:
            return None
        mean, covariance = setting.rig.scaled(setting.stated)
        best = one.solved.best
        mean[own] = best.mean[places]
        covariance[np.ix_(own, own)] = best.covariance[np.ix_(places, places)]
        found.append(Component(weight, mean, covariance))
    return setting.rig.taught(*moments(found), setting.config)
