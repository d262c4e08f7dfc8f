# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""How many times stiffer a place is than its surroundings, for tissue that no library knows.

Logarithms of the apparent modulus vary as :math:`l_k \sim N(m, t^2 + v_k)` (random effects; R.
DerSimonian and N. Laird, Controlled Clinical Trials 7 (1986) 177), where a share may be lesions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr, stdtrit

from fden_ros.core.classification.classifier import ClassProbabilities, Likelihood
from fden_ros.core.estimation import Estimate
from fden_ros.core.law import LogStiffness, log_stiffness

#: Fewer places are no surroundings; strain of the comparison, and ratio of the stiffer [1].
LEAST_SURROUNDINGS, _STRAIN, _RATIO = 4, 0.1, 1.5
#: Share of the surroundings that is something else: initial and least, and most; its spread in l.
_FOREIGN_RANGE, _FOREIGN_SD = (0.02, 0.4), 0.8
#: Least natural spread, and iterations of the fixed point.
_LEAST_SD, _ITERATIONS = 0.02, 30


class Comparison(NamedTuple):
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

    @property
    def classes(self) -> ClassProbabilities:
        """The probabilities of being softer, alike and stiffer."""
        limits = (np.log([1.0 / _RATIO, _RATIO]) - self.log_ratio) / self.log_ratio_sd
        shares = np.diff([0.0, *stdtr(self.degrees_of_freedom, limits), 1.0])
        names = ("softer", "alike", "stiffer")
        return ClassProbabilities(names[int(shares.argmax())], names, tuple(shares.tolist()))


def compare(place: LogStiffness, around: LogStiffness) -> Comparison | None:
    """Return how a place compares with those around it, shape (k,); None: too few."""
    values, variances = around
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
    if (count := float(belongs.sum())) < LEAST_SURROUNDINGS - 1:
        return None
    weight = float((belongs / (max(natural, _LEAST_SD**2) + variances)).sum())
    error = math.sqrt(float(place.variance) + 1.0 / weight)
    return Comparison(float(place.value) - mean, error, count - 1.0)


class Surroundings:
    """The stiffness of each site touched so far; `time_scale` is tau of the stiffness [s]."""

    def __init__(self, time_scale: float) -> None:
        self._time_scale, self._sites = time_scale, dict[int, LogStiffness]()

    def compared(self, site_id: int, estimate: Estimate, data: Likelihood) -> Comparison | None:
        """Compare a site with the others, and keep it; None: there are too few of them."""
        mean, covariance = estimate.mean, estimate.covariance
        # With the prior, for a direction that is not observed.
        if float(np.linalg.eigvalsh(data.information).min()) > 0.0:
            covariance = np.linalg.inv(data.information).astype(np.float64)
            mean = data.centre + covariance @ data.score
        place = log_stiffness(mean, covariance, _STRAIN, self._time_scale)
        others = [(o.value, o.variance) for k, o in self._sites.items() if k != site_id]
        self._sites[site_id] = place
        return compare(place, LogStiffness(*np.reshape(others, (-1, 2)).T))

    def forget(self, site_id: int | None = None) -> None:
        """Forget a site; None: all."""
        self._sites = {k: v for k, v in self._sites.items() if site_id not in (None, k)}
