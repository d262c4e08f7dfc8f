# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the pipeline is configured with."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field

from fden_ros.core.classification import (
    DecisionConfig,
    Labeller,
    Surroundings,
    TissueLibrary,
)
from fden_ros.core.contact import ContactConfig
from fden_ros.core.estimation import EstimatorConfig
from fden_ros.core.law import Geometry, GeometryConfig
from fden_ros.core.parameter import parameter
from fden_ros.core.plausibility import PlausibilityConfig
from fden_ros.core.streams import Position, SynchronizeConfig

#: Touches farther apart than this part of the probe's radius [1] belong to two sites. These share
#: most of their tissue but not its memory: a scan of 3 mm has a site at each touch. Positions are
#: known to half a millimetre [m] or better.
_SITE_PART, _LEAST_SITE, _LARGEST_SITE = 0.2, 5e-4, 2e-3


@dataclass(frozen=True)
class SiteConfig:
    """When a contact is at a new site."""

    distance: float = parameter(
        "site.distance",
        0.0,
        "Sideways distance at which a new site begins; 0: radius/5, from 0.5 to 2 mm.",
        "m",
        0.0,
        1.0,
    )
    timeout: float = parameter(
        "site.timeout",
        2.0,
        "Without positions, a touch after this time may be at another site.",
        "s",
        0.0,
        1e5,
    )
    without_position: str = parameter(
        "site.without_position",
        "either",
        "Site of a touch without a position: the same, another, or either; then the data decide "
        "after site.timeout.",
        choices=("same", "other", "either"),
    )


@dataclass(frozen=True)
class PipelineConfig:
    """Configuration of all steps; times in seconds, SI units throughout."""

    library: TissueLibrary | None  #: tissues to classify into; None: nothing is classified
    #: From force and displacement to stress and strain. It must be stated: with the default
    #: no estimate converges.
    geometry: Geometry = field(default_factory=lambda: GeometryConfig().build())
    synchronize: SynchronizeConfig = field(default_factory=SynchronizeConfig)
    plausibility: PlausibilityConfig = field(default_factory=PlausibilityConfig)
    origin_source: str = parameter(
        "origin.source",
        "touch",
        "Contact point: found from the force at the touch and refined, or given as a "
        "displacement.",
        choices=("touch", "given"),
    )
    origin_displacement: float = parameter(
        "origin.displacement",
        0.0,
        "Displacement at zero strain, if origin.source is given.",
        "m",
        -10.0,
        10.0,
    )
    mode: str = parameter(
        "contact.mode",
        "touch",
        "touch: contacts begin in the air, with G and Gn; continuous: the probe stays on the "
        "tissue and palpates, and dF/dd along its path is estimated.",
        choices=("touch", "continuous"),
    )
    contact: ContactConfig = field(default_factory=ContactConfig)
    site: SiteConfig = field(default_factory=SiteConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    block_duration: float = parameter(
        "estimate.period", 0.01, "One estimate per this time.", "s", 1e-3, 1.0
    )
    block_compression: float = 0.005  #: a larger change of the compression cuts a block short [1]
    #: Time scale tau of the apparent stiffness [s].
    apparent_stiffness_time_scale: float = 0.1
    stated_frequencies: tuple[float, ...] = parameter(
        "dither.frequencies",
        (0.0,),
        "Frequencies of a small oscillation of the probe at which the complex modulus is "
        "measured; 0: there is none.",
        "Hz",
        0.0,
        1000.0,
        most=8,
    )
    #: One complex modulus per this number of periods of the lowest frequency [1].
    dither_periods: int = 4
    classification: str = parameter(
        "classification.mode",
        "library",
        "Classify by the tissues of the library, or by the ratio of each site's stiffness to "
        "that of earlier sites around it.",
        choices=("library", "relative"),
    )
    decision: DecisionConfig = field(default_factory=DecisionConfig)

    @property
    def contact_point(self) -> float | None:
        """Displacement at which the tissue is free of load [m]; None: found from the force."""
        return self.origin_displacement if self.origin_source == "given" else None

    @property
    def is_continuous(self) -> bool:
        """Whether the probe stays on the tissue and palpates: no touch is detected."""
        return self.mode == "continuous"

    @functools.cached_property
    def site_distance(self) -> float:
        """Lateral distance beyond which a contact is at a new site [m]."""
        own = min(max(_SITE_PART * self.geometry.probe_radius, _LEAST_SITE), _LARGEST_SITE)
        return self.site.distance or own

    def is_apart(self, a: Position, b: Position) -> bool:
        """Whether two positions are of different sites, by their distance across the approach."""
        axis, offset = self.contact.approach_axis, [q - p for p, q in zip(a, b, strict=True)]
        along = sum(o * n for o, n in zip(offset, axis, strict=True))
        return math.dist(offset, [along * n for n in axis]) > self.site_distance

    @property
    def dither_frequencies(self) -> tuple[float, ...]:
        """Frequencies of the probe's oscillation [Hz], ascending; empty: none.

        A continuous palpation has its own; empty: detected.
        """
        return tuple(sorted({f for f in self.stated_frequencies if f > 0.0}))


def labeller_of(config: PipelineConfig) -> Labeller:
    """Return how contacts are labelled."""
    surroundings = None
    if config.classification == "relative":
        surroundings = Surroundings(config.apparent_stiffness_time_scale)
    return Labeller(config.library, config.estimator, config.decision, surroundings)
