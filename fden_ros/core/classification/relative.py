# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""How many times stiffer a place is than its surroundings, for tissue that no library knows.

Logarithms of the apparent modulus vary as :math:`l_k \sim N(m, t^2 + v_k)` (random effects; R.
DerSimonian and N. Laird, Controlled Clinical Trials 7 (1986) 177), where a share may be lesions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr, stdtrit

from fden_ros.core.classification.classifier import ClassProbabilities, Likelihood
from fden_ros.core.estimation import Estimate
from fden_ros.core.law import LogStiffness, log_stiffness

ANSWERS = ("softer", "alike", "stiffer")
#: Fewer places are no surroundings. Strain of the comparison [1].
LEAST_SURROUNDINGS, _STRAIN = 4, 0.1
#: Share of the surroundings that is something else: initial and least, and most; its spread in l.
_FOREIGN_RANGE, _FOREIGN_SD = (0.02, 0.4), 0.8
#: Least natural spread, and iterations of the fixed point.
_LEAST_SD, _ITERATIONS = 0.02, 30


@dataclass(frozen=True)
class RelativeConfig:
    """Limit of the comparison."""

    #: relative: stiffer, or softer, by this [1].
    ratio: float = 1.5


@dataclass(frozen=True)
class Comparison:
    """ln of how many times stiffer a place is than its surroundings."""

    log_ratio: float
    log_ratio_sd: float
    degrees_of_freedom: float  #: of Student's t

    @property
    def ratio(self) -> float:
        """How many times stiffer than the surroundings."""
        return math.exp(self.log_ratio)

    def interval(self) -> tuple[float, float]:
        """Return the interval that holds the ratio with a probability of 0.95."""
        reach = self.log_ratio_sd * float(stdtrit(self.degrees_of_freedom, 0.975))
        low, high = np.exp(np.clip([self.log_ratio - reach, self.log_ratio + reach], -100, 100))
        return float(low), float(high)

    def classes(self, ratio: float) -> ClassProbabilities:
        """Return the probabilities of being softer, alike and stiffer by `ratio`."""
        limits = (np.log([1.0 / ratio, ratio]) - self.log_ratio) / self.log_ratio_sd
        below, above = stdtr(self.degrees_of_freedom, limits)
        probabilities = (float(below), float(above - below), float(1.0 - above))
        return ClassProbabilities(ANSWERS[int(np.argmax(probabilities))], ANSWERS, probabilities)


def compare(place: LogStiffness, around: LogStiffness) -> Comparison | None:
    """Return how a place compares with those around it, shape (k,); None: too few."""
    values, variances = np.atleast_1d(*around)
    if values.size < LEAST_SURROUNDINGS:
        return None
    mean, foreign = float(np.median(values)), _FOREIGN_RANGE[0]
    natural = (1.4826 * float(np.median(np.abs(values - mean)))) ** 2  # by the median deviation
    for _ in range(_ITERATIONS):
        own = max(natural, _LEAST_SD**2) + variances
        wide, squares = own + _FOREIGN_SD**2, (values - mean) ** 2
        gain = np.minimum(0.5 * squares * (1.0 / own - 1.0 / wide), 500.0)
        belongs = 1.0 / (1.0 + foreign / (1.0 - foreign) * np.sqrt(own / wide) * np.exp(gain))
        foreign = float(np.clip(1.0 - np.mean(belongs), *_FOREIGN_RANGE))
        mean = float(belongs / own @ values / (belongs / own).sum())
        excess = float(belongs @ ((values - mean) ** 2 - variances))
        natural = (excess + natural) / max(float(belongs.sum()), 1.0)  # the mean takes a degree
    count = float(belongs.sum())
    if count < LEAST_SURROUNDINGS - 1:
        return None
    weight = float((belongs / (max(natural, _LEAST_SD**2) + variances)).sum())
    error = math.sqrt(float(place.variance) + 1.0 / weight)
    return Comparison(float(place.value) - mean, error, count - 1.0)


class Surroundings:
    """The stiffness of each site touched so far; `time_scale` is tau of the stiffness [s]."""

    def __init__(self, config: RelativeConfig, time_scale: float) -> None:
        self._config, self._time_scale = config, time_scale
        self._sites: dict[int, LogStiffness] = {}

    def classes(
        self, site_id: int, estimate: Estimate, likelihood: Likelihood
    ) -> tuple[ClassProbabilities | None, Comparison | None]:
        """Compare a site with the others, and keep it; None: there are too few of them."""
        mean, covariance = estimate.mean, estimate.covariance
        # With the prior, for a direction that is not observed.
        if float(np.linalg.eigvalsh(likelihood.information).min()) > 0.0:
            covariance = np.linalg.inv(likelihood.information).astype(np.float64)
            mean = likelihood.centre + covariance @ likelihood.score
        place = log_stiffness(mean, covariance, _STRAIN, self._time_scale)
        others = [other for other_id, other in self._sites.items() if other_id != site_id]
        self._sites[site_id] = place
        numbers = np.array([(float(o.value), float(o.variance)) for o in others]).reshape(-1, 2)
        found = compare(place, LogStiffness(*numbers.T))
        return (found.classes(self._config.ratio) if found is not None else None), found

    def forget(self, site_id: int | None = None) -> None:
        """Forget a site; None: all."""
        self._sites = {k: v for k, v in self._sites.items() if site_id not in (None, k)}
