# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the pipeline is configured with."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field

from fden_ros.core.classification.classifier import TissueLibrary
from fden_ros.core.classification.labelling import DecisionConfig, Labeller, Surroundings
from fden_ros.core.classification.relative import RelativeConfig
from fden_ros.core.contact.detector import ContactConfig
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.law.geometry import FlatPunch, Geometry
from fden_ros.core.plausibility import PlausibilityConfig
from fden_ros.core.streams.samples import lateral_distance
from fden_ros.core.streams.synchronize import SynchronizeConfig


@dataclass(frozen=True)
class PipelineConfig:
    """Configuration of all steps; times in seconds, SI units throughout.

    Parameters
    ----------
    library : TissueLibrary or None
        Tissues to classify into; None: nothing is classified.
    geometry : Geometry
        From force and displacement to stress and strain. It must be stated: with the default
        nothing is converged.
    synchronize, contact, estimator, plausibility
        Configuration of those steps.
    strain_origin : float or None
        Displacement at which the tissue is free of load [m]; None: found from the force.
    block_duration : float
        One estimate per this time [s].
    block_compression : float
        A block is cut short when the compression changes by more than this [1].
    apparent_stiffness_time_scale : float
        tau of the apparent stiffness [s].
    decision : DecisionConfig
        When a tissue is named.
    relative : RelativeConfig or None
        Compare each site with those around it that were touched before, not with the library.
    dither_frequencies : tuple of float
        Frequencies of the probe's oscillation [Hz], different; empty: there is none.
    is_continuous : bool
        The probe stays on the tissue and palpates: no touch is looked for, and what its
        oscillation tells is put out. `dither_frequencies` then is the palpation's, empty: found.
    learns_rig : bool
        What a contact tells of the rig, the next site knows.
    learns_motion, learns_drift : bool
        The same of how far the surface moves, and of how far the force's zero drifts.
    dither_periods : int
        Periods of the lowest frequency per complex modulus.
    """

    library: TissueLibrary | None
    geometry: Geometry = field(default_factory=lambda: FlatPunch(1e-4, 0.02, is_stated=False))
    synchronize: SynchronizeConfig = field(default_factory=SynchronizeConfig)
    contact: ContactConfig = field(default_factory=ContactConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    strain_origin: float | None = None
    block_duration: float = 0.01
    block_compression: float = 0.005
    apparent_stiffness_time_scale: float = 0.1
    decision: DecisionConfig = field(default_factory=DecisionConfig)
    relative: RelativeConfig | None = None
    dither_frequencies: tuple[float, ...] = ()
    dither_periods: int = 4
    learns_rig: bool = False
    learns_motion: bool = False
    learns_drift: bool = False
    is_continuous: bool = False
    plausibility: PlausibilityConfig = field(default_factory=PlausibilityConfig)


def labeller_of(config: PipelineConfig) -> Labeller:
    """Return how contacts are labelled."""
    if config.relative is None:
        return Labeller(config.library, config.estimator, config.decision)
    apart = functools.partial(lateral_distance, config.contact.approach_axis)
    surroundings = Surroundings(config.relative, apart)
    ratio = config.relative.ratio
    return Labeller(config.library, config.estimator, config.decision, ratio, surroundings)
