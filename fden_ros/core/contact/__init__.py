# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""When and where the probe touched."""

from fden_ros.core.contact.air import CHUNK_SAMPLES, LEAST_SAMPLES, SLOW_NS, ContactConfig
from fden_ros.core.contact.detector import SLIGHT, ContactDetector, Onset, Release
from fden_ros.core.contact.surface import SMALL

__all__ = [
    "CHUNK_SAMPLES",
    "LEAST_SAMPLES",
    "SLIGHT",
    "SLOW_NS",
    "SMALL",
    "ContactConfig",
    "ContactDetector",
    "Onset",
    "Release",
]
