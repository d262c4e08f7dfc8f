# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What an estimator takes from the pipeline and gives it."""

from __future__ import annotations

from typing import NamedTuple

from fden_ros.core.arrays import Array


class Touch(NamedTuple):
    """What is known at a touch."""

    bias_sd: float  #: of the stress's zero [Pa]
    drift_sd: float  #: of its slope [Pa/s]
    #: Motion before the first sample: times, counted from that [s], indentations [1] and stresses
    #: [Pa], (3, n).
    approach: Array


class CellInnovation(NamedTuple):
    """How the newest block compares with its prediction [Pa, Pa, Pa^2]."""

    predicted: float
    innovation: float
    variance: float

    @property
    def normalized_squared(self) -> float:
        """Normalised innovation squared (NIS) [1]."""
        return self.innovation**2 / self.variance
