# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""When and where the probe touched."""

from fden_ros.core.contact.air import SLOW_NS, ContactConfig
from fden_ros.core.contact.detector import ContactDetector, Onset, Release

__all__ = [
    "SLOW_NS",
    "ContactConfig",
    "ContactDetector",
    "Onset",
    "Release",
]
