# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""For controllers: reliable estimates, predicted forces, and a force controller on them.

Free of ROS, like :mod:`fden_ros.core`.
"""

from fden_ros.control.force_control import ForceControlConfig, ForceController, Gains
from fden_ros.control.live_tissue import Cause, LiveTissue, Refusal
from fden_ros.control.prediction import Prediction, Predictor, TissueMemory

__all__ = [
    "Cause",
    "ForceControlConfig",
    "ForceController",
    "Gains",
    "LiveTissue",
    "Prediction",
    "Predictor",
    "Refusal",
    "TissueMemory",
]
