# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""From parameters with their covariance to a tissue."""

from fden_ros.core.classification.classifier import (
    UNKNOWN,
    ClassProbabilities,
    Tissue,
    TissueLibrary,
)
from fden_ros.core.classification.labelling import (
    Answer,
    Decided,
    Decision,
    DecisionConfig,
    Labeller,
    Labelling,
)
from fden_ros.core.classification.relative import Comparison, Surroundings

__all__ = [
    "UNKNOWN",
    "Answer",
    "ClassProbabilities",
    "Comparison",
    "Decided",
    "Decision",
    "DecisionConfig",
    "Labeller",
    "Labelling",
    "Surroundings",
    "Tissue",
    "TissueLibrary",
]
