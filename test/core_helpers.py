# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What tests of the core have in common: a truth by convolution, and errors over deviations."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from fden_ros.core.estimation import Estimate
from fden_ros.core.outputs import Output, TissueState


def stress_over_g(strain: np.ndarray, step: float, gn: float, alpha: float) -> np.ndarray:
    """Return the stress of the paper's law for G = 1, by its own convolution, each `step` [s]."""
    phi = np.where(strain < 1 / gn, strain, np.exp(gn * strain - 1.0) / gn)
    lags = np.diff((np.arange(strain.size + 1) * step) ** (1 - alpha))
    lags /= step * math.gamma(2 - alpha)
    return np.maximum(np.convolve(np.diff(phi, prepend=0.0), lags)[: strain.size], 0.0)


def off(estimate: Estimate, tissue: Sequence[float]) -> np.ndarray:
    """Return the errors of ln G, ln Gn and alpha in their deviations; 0 of what is given.

    `tissue` is (G, Gn, alpha).
    """
    truth, sd = [math.log(tissue[0]), math.log(tissue[1]), tissue[2]], estimate.deviations
    return np.divide(estimate.mean - truth, sd, out=np.zeros(3), where=sd > 0.0)


def states_of(outputs: Iterable[Output]) -> list[TissueState]:
    return [output for output in outputs if isinstance(output, TissueState)]
