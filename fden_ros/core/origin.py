# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The strain origin of a site: where its first touch finds the surface, or as it is given."""

from __future__ import annotations

import math
import sys

import numpy as np
from scipy.special import ndtr

from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact import CHUNK_SAMPLES, Onset
from fden_ros.core.streams import Pair

#: The surface found at the touch starts the estimator. Its standard deviation is multiplied by
#: this, since the estimator uses those samples again.
ORIGIN_WIDENING = 3.0


def origin_of(onset: Onset, config: PipelineConfig) -> tuple[float, float]:
    """Return the displacement at zero strain [m] and its standard deviation as compression [1]."""
    if config.contact_point is not None:
        return config.contact_point, 0.0
    origin_sd = math.hypot(found_sd(onset, config), _hidden_depth(onset, config))
    return onset.displacement, origin_sd


def found_sd(onset: Onset, config: PipelineConfig) -> float:
    """Return the deviation of the contact point that the touch shows, as compression [1]."""
    return ORIGIN_WIDENING * onset.displacement_sd / config.geometry.length


def _hidden_depth(onset: Onset, config: PipelineConfig) -> float:
    """Return how much deeper than a line shows the probe may be at the first force [1].

    Where the force exceeds the noise beyond the boundary strain 1/Gn only, a line finds the
    surface too late, by ln(stress Gn/G)/Gn of strain. This is the root of its mean square over
    the prior of G where it is positive, as compression.
    """
    if onset.shows_surface:
        return 0.0
    prior = config.estimator.prior
    gn, sd = prior.nonlinear_stiffness, prior.linear_stiffness_log_sd
    force = float(np.mean([pair.force for pair in onset.samples[-CHUNK_SAMPLES:]])) - onset.bias
    stress = max(force * config.geometry.stress_per_force, sys.float_info.min)
    above = math.log(stress * gn / prior.linear_stiffness)
    square = max(above, 0.0) ** 2
    if sd > 0.0:
        density = math.exp(-0.5 * (above / sd) ** 2) / math.sqrt(2.0 * math.pi)
        square = (above**2 + sd**2) * float(ndtr(above / sd)) + above * sd * density
    return config.geometry.compression(math.sqrt(max(square, 0.0)) / gn)


def begins_at_origin(pair: Pair, config: PipelineConfig) -> bool:
    """Whether the origin is given and a sample exists, so that no press came before it."""
    if config.contact_point is None:
        return False
    compression = (pair.displacement - config.contact_point) / config.geometry.length
    return compression <= config.block_compression
