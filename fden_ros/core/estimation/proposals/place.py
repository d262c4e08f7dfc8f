# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""A touch of which nothing says whether it is where the last one was.

Each is a hypothesis: the tissue pressed before, which still recovers, and tissue at rest. The
tissue of another place may be anything, or as that of the last: with a prior as wide as all tissue
alone, the last place was too likely wherever an organ is pressed at several. Each has a prior of
one half. With the likelihood :math:`e^{s^T\theta - \theta^T \Lambda \theta / 2}` of the press the
evidence under a prior :math:`N(m, C)` is

.. math:: |1 + C\Lambda|^{-1/2}\; e^{(s + C^{-1} m)^T (\Lambda + C^{-1})^{-1} (s + C^{-1} m) / 2
    - m^T C^{-1} m / 2}.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.mixture import positive


class Tissue(NamedTuple):
    """A belief in (ln G, ln Gn, alpha)."""

    mean: Array  #: shape (3,)
    covariance: Array  #: shape (3, 3)


def log_odds_of_another(
    config: EstimatorConfig, last: Tissue, log_wider: float
) -> Callable[[Array, Array], float]:
    """Return the log odds of another place against the last, by what a press tells of the tissue.

    Parameters
    ----------
    config : EstimatorConfig
        With whose prior the press is solved.
    last : Tissue
        Of the last place.
    log_wider : float
        What the prior of the origin makes them less [1].
    """
    prior = Tissue(config.prior.mean, np.diag(config.prior.deviations**2))
    # How far alike tissue is from that of the last place: standard deviations of ln G, ln Gn and
    # alpha, by which simulated touches were told apart best.
    deviations = np.array([0.3, 0.15, 0.04])
    alike = last._replace(covariance=last.covariance + np.diag(deviations**2))
    return partial(_log_odds, prior, alike, log_wider, not config.is_order_given)


def _log_odds(
    prior: Tissue,
    alike: Tissue,
    log_wider: float,
    learns_order: bool,
    mean: Array,
    covariance: Array,
) -> float:
    gain = log_ratio(prior, alike, Tissue(mean, covariance), learns_order=learns_order)
    return log_wider + float(np.logaddexp(0.0, gain)) - math.log(2.0)


def log_ratio(prior: Tissue, other: Tissue, told: Tissue, *, learns_order: bool) -> float:
    """Return the log evidence under another prior over that under the prior of a posterior.

    Parameters
    ----------
    told : Tissue
        The posterior with the first.
    learns_order : bool
        alpha is an unknown.
    """
    learned = slice(0, 3 if learns_order else 2)

    def natural(tissue: Tissue) -> tuple[Array, Array]:
        covariance = tissue.covariance[learned, learned]
        precision = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        return precision, precision @ tissue.mean[learned]

    (before, pull_before), (after, pull_after) = natural(prior), natural(told)
    # What the press itself tells, which is never less than nothing.
    likelihood = positive(after - before)

    def log_evidence(tissue: Tissue) -> float:
        precision, pull = natural(tissue)
        both, pulled = likelihood + precision, pull_after - pull_before + pull
        volume = np.linalg.slogdet(precision)[1] - np.linalg.slogdet(both)[1]
        square = pulled @ np.linalg.solve(both, pulled) - pull @ tissue.mean[learned]
        return 0.5 * float(volume + square)

    return log_evidence(other) - log_evidence(prior)
