# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether a block is a surprise: no scale of the model's error foresaw it, whatever alpha is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.innovation_monitor import CHANGE_DEVIATIONS
from fden_ros.core.estimation.posterior import Prediction
from fden_ros.core.estimation.posterior_bank import PosteriorBank

_LOG_G = StateIndex.LOG_LINEAR_STIFFNESS

#: Share of the prior's deviation of ln G [1] below which the data have said something, and
#: deviation of ln G [1] above which the stress is not normal about its prediction.
_KNOWN_SHARE, _KNOWN_LOG_SD = 0.5, 0.5
#: A scale's likelihood ratio against it, -2 ln of its weight [1], counts up to this [1]: it has to
#: be surprised by three deviations all the same, because tissue may begin to leave the law.
_MOST_AGAINST, _TINY_WEIGHT = 27.0, 1e-12
#: A surprise that follows one has to be one by this share of the squared deviations [1], four of
#: them: it has only to show that the first was no outlier. Not where the law is said to be exact:
#: a noise three times as large as stated would be a change instead of a mismatch.
_FOLLOWING = 4.0 / 9.0


def is_surprise(
    bank: PosteriorBank,
    predictions: Sequence[Prediction],
    noise: float,
    prior_log_sd: float,
    *,
    is_first: bool,
) -> bool:
    """Return whether a block is a surprise.

    A scale that the data have spoken against need not be so surprised, but for the exact law; and
    what one scale foresaw is no surprise within the deviation of another.

    Parameters
    ----------
    bank : PosteriorBank
    predictions : sequence of Prediction
        Of the block, by every posterior of the bank.
    noise : float
        Variance of the block's mean stress [Pa^2].
    prior_log_sd : float
        Standard deviation of ln G before the data [1].
    is_first : bool
        The block before was none.
    """
    least = _FOLLOWING * (CHANGE_DEVIATIONS**2 - _MOST_AGAINST) * noise
    if not _is_tissue_known(bank, prior_log_sd) or any(
        p.residual**2 <= least for p in predictions
    ):
        return False
    against = np.minimum(-2.0 * np.log(np.maximum(bank.weights, _TINY_WEIGHT)), _MOST_AGAINST)
    against[0] = 0.0
    share = 1.0 if is_first or bank.is_exact else _FOLLOWING
    thresholds = (share * (CHANGE_DEVIATIONS**2 - against)).tolist()
    squares, spreads = zip(
        *(posterior.foreseen(p) for posterior, p in zip(bank.members, predictions, strict=True)),
        strict=True,
    )
    square = min(squares)
    if any(
        square <= threshold * (noise + spread)
        for threshold, spread in zip(thresholds, spreads, strict=True)
    ):
        return False
    return all(
        square
        > threshold * (noise + spread + posterior.order_variance(prediction, is_first=is_first))
        for posterior, prediction, threshold, spread in zip(
            bank.members, predictions, thresholds, spreads, strict=True
        )
    )


def _is_tissue_known(bank: PosteriorBank, prior_log_sd: float) -> bool:
    """Whether the data say something of the tissue's stiffness: only then can it change."""
    known = _KNOWN_LOG_SD
    if not bank.is_exact:
        known = min(known, _KNOWN_SHARE * prior_log_sd)
    return bool(bank.best.covariance[_LOG_G, _LOG_G] < known**2)
