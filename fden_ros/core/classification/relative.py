# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""How many times stiffer a place is than its surroundings, for tissue that no library knows.

Places are compared by the logarithm l of their apparent modulus for a small motion that lasts tau
at the strain x (:mod:`fden_ros.core.law.apparent_stiffness`). The surroundings vary by nature:
:math:`l_k \sim N(m, t^2 + v_k)` with :math:`v_k` the variance of each estimate (a random-effects
mean; R. DerSimonian and N. Laird, Controlled Clinical
Trials 7 (1986) 177), where a share, estimated too, may be something else, lesions among them: each
place counts with its probability of not being that. The mean enters with Student's t.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr, stdtrit

from fden_ros.core.arrays import Array
from fden_ros.core.classification.classifier import ClassProbabilities, Likelihood
from fden_ros.core.estimation import Estimate
from fden_ros.core.law import LogStiffness, log_stiffness
from fden_ros.core.parameter import parameter
from fden_ros.core.streams import Position, lateral_distance

#: Answers of the comparison.
ANSWERS = ("softer", "alike", "stiffer")

#: Fewer than 4 places are no surroundings.
LEAST_SURROUNDINGS = 4
#: Share of the surroundings that is something else, at first and at least and at most, and its
#: spread in l.
_FOREIGN, _FOREIGN_RANGE, _FOREIGN_SD = 0.1, (0.02, 0.4), 0.8
#: Tissue that varies less is not believed.
_LEAST_SD = 0.02
#: Turns of the fixed point for mean, spread and share: after half as many nothing moves by
#: more than 5 %.
_ITERATIONS = 30
#: The interval of the logarithm of a ratio ends here, so that its exponential does not overflow.
_LARGEST_LOG = 100.0


@dataclass(frozen=True)
class RelativeConfig:
    """Strain of the comparison, and its limits."""

    ratio: float = parameter(
        "classification.ratio", 1.5, "relative: stiffer, or softer, by this.", "1", 1.0, 1000.0
    )
    #: relative: strain of the comparison [1].
    strain: float = 0.1
    #: relative: surroundings are sites within this distance; 0: all [m].
    distance: float = 0.0


@dataclass(frozen=True)
class Comparison:
    """A place and its surroundings.

    Parameters
    ----------
    log_ratio, log_ratio_sd : float
        ln of how many times stiffer than the mean of the surroundings, and its error.
    """

    log_ratio: float
    log_ratio_sd: float
    degrees_of_freedom: float  #: of Student's t
    count: float  #: how many places of the surroundings count

    @property
    def ratio(self) -> float:
        """How many times stiffer than the surroundings."""
        return math.exp(self.log_ratio)

    def interval(self, probability: float = 0.95) -> tuple[float, float]:
        """Return the interval that holds the ratio with this probability."""
        reach = self.log_ratio_sd * float(
            stdtrit(self.degrees_of_freedom, 0.5 + 0.5 * probability)
        )
        low, high = self.log_ratio - reach, self.log_ratio + reach
        return math.exp(max(low, -_LARGEST_LOG)), math.exp(min(high, _LARGEST_LOG))

    def probability_stiffer(self, ratio: float = 1.0) -> float:
        """Return the probability that the place is more than `ratio` times stiffer."""
        off = (self.log_ratio - math.log(ratio)) / self.log_ratio_sd
        return float(stdtr(self.degrees_of_freedom, off))

    def classes(self, ratio: float) -> ClassProbabilities:
        """Return the probabilities of being softer, alike and stiffer by `ratio`."""
        stiffer = self.probability_stiffer(ratio)
        softer = 1.0 - self.probability_stiffer(1.0 / ratio)
        probabilities = (softer, max(1.0 - softer - stiffer, 0.0), stiffer)
        label = ANSWERS[int(np.argmax(probabilities))]
        return ClassProbabilities(label, ANSWERS, probabilities)


def compare(place: LogStiffness, surroundings: LogStiffness) -> Comparison | None:
    """Return how a place compares with its surroundings.

    Parameters
    ----------
    place : LogStiffness
        Scalars.
    surroundings : LogStiffness
        Shape (k,), the place itself not among them.

    Returns
    -------
    Comparison or None
        None: too few surroundings, or too few of them of one kind.
    """
    values, variances = np.atleast_1d(*surroundings)
    if values.size < LEAST_SURROUNDINGS:
        return None
    mean = float(np.median(values))
    # The deviation of a normal variable is 1.4826 medians of its magnitude.
    natural = (1.4826 * float(np.median(np.abs(values - mean)))) ** 2
    foreign = _FOREIGN
    for _ in range(_ITERATIONS):
        natural = max(natural, _LEAST_SD**2)
        own = natural + variances
        belongs = _belongs((values - mean) ** 2, own, foreign)
        foreign = float(np.clip(1.0 - np.mean(belongs), *_FOREIGN_RANGE))
        weights = belongs / own
        mean = float(weights @ values / weights.sum())
        # The mean takes one degree of freedom.
        excess = float(belongs @ ((values - mean) ** 2 - variances))
        natural = (excess + natural) / max(float(belongs.sum()), 1.0)
    natural = max(natural, _LEAST_SD**2)
    count = float(belongs.sum())
    if count < LEAST_SURROUNDINGS - 1:
        return None
    error = float(place.variance) + 1.0 / float((belongs / (natural + variances)).sum())
    return Comparison(float(place.value) - mean, math.sqrt(error), count - 1.0, count)


def _belongs(squares: Array, variances: Array, foreign: float) -> Array:
    """Return the probability that each of the surroundings is not something else."""
    wide = variances + _FOREIGN_SD**2
    odds = (
        foreign
        / (1.0 - foreign)
        * np.sqrt(variances / wide)
        * np.exp(np.minimum(0.5 * squares * (1.0 / variances - 1.0 / wide), 500.0))
    )
    result: Array = 1.0 / (1.0 + odds)
    return result


class Surroundings:
    """The stiffness of each site touched so far, to compare others with.

    Parameters
    ----------
    time_scale : float
        tau of the stiffness [s].
    axis : tuple of float
        Unit vector into the tissue: distances are perpendicular to it.
    """

    def __init__(self, config: RelativeConfig, time_scale: float, axis: Position) -> None:
        self._config, self._time_scale, self._axis = config, time_scale, axis
        self._sites: dict[int, tuple[Position | None, LogStiffness]] = {}

    def classes(
        self, site_id: int, position: Position | None, estimate: Estimate, likelihood: Likelihood
    ) -> tuple[ClassProbabilities | None, Comparison | None]:
        """Compare a site with those around it, and keep it for those to come.

        `likelihood`: of the estimate, its prior taken out. None: there are too few around it.
        """
        mean, covariance = estimate.mean, estimate.covariance
        # With the prior where a direction is not observed.
        if float(np.linalg.eigvalsh(likelihood.information).min()) > 0.0:
            covariance = np.linalg.inv(likelihood.information).astype(np.float64)
            mean = likelihood.centre + covariance @ likelihood.score
        place = log_stiffness(mean, covariance, self._config.strain, self._time_scale)
        around = [
            other
            for other_id, (other_position, other) in self._sites.items()
            if other_id != site_id and self._is_near(other_position, position)
        ]
        self._sites[site_id] = (position, place)
        found = compare(place, stack(around))
        return (found.classes(self._config.ratio) if found is not None else None), found

    def forget(self, site_id: int | None = None) -> None:
        """Forget a site; None: all."""
        if site_id is None:
            self._sites.clear()
        else:
            self._sites.pop(site_id, None)

    def _is_near(self, a: Position | None, b: Position | None) -> bool:
        reach = self._config.distance
        if reach == 0.0 or a is None or b is None:
            return True
        return lateral_distance(self._axis, a, b) <= reach


def stack(places: Sequence[LogStiffness]) -> LogStiffness:
    """Return scalars as arrays of shape (k,)."""
    return LogStiffness(
        np.array([float(place.value) for place in places]),
        np.array([float(place.variance) for place in places]),
    )
