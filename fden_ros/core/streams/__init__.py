# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Samples of two streams in, pairs out: checked, synchronised, the tool's weight subtracted."""

from fden_ros.core.streams.frames import FramesConfig, StaticLinks
from fden_ros.core.streams.guard import (
    MIN_STEP_NS,
    USUAL_SAMPLES,
    Resolution,
    StreamGuard,
    gap_before,
)
from fden_ros.core.streams.rotation import (
    Quaternion,
    Transform,
    Vector,
    normalised,
)
from fden_ros.core.streams.samples import (
    BRIEF_NS,
    CHUNK_NS,
    NANOSECONDS,
    Pair,
    Position,
    Reason,
)
from fden_ros.core.streams.synchronize import SynchronizeConfig, Synchronizer
from fden_ros.core.streams.tool import ToolWeight

__all__ = [
    "BRIEF_NS",
    "CHUNK_NS",
    "MIN_STEP_NS",
    "NANOSECONDS",
    "USUAL_SAMPLES",
    "FramesConfig",
    "Pair",
    "Position",
    "Quaternion",
    "Reason",
    "Resolution",
    "StaticLinks",
    "StreamGuard",
    "SynchronizeConfig",
    "Synchronizer",
    "ToolWeight",
    "Transform",
    "Vector",
    "gap_before",
    "normalised",
]
