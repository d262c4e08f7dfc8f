# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""When and where the probe touched."""

from fden_ros.core.contact.air import CHUNK_SAMPLES, SLOW_NS, ContactConfig
from fden_ros.core.contact.detector import SLIGHT, ContactDetector, Onset, Release
from fden_ros.core.contact.surface import BRIEF

__all__ = [
    "BRIEF",
    "CHUNK_SAMPLES",
    "SLIGHT",
    "SLOW_NS",
    "ContactConfig",
    "ContactDetector",
    "Onset",
    "Release",
]
