# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Files of the package: in the source tree, or installed with it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from fden_ros.errors import InputError


def shipped(name: str) -> Path:
    """Return a file or folder of the package, such as ``config/robots``.

    Raises
    ------
    InputError
        If it is not installed.
    """
    found = all_shipped(name)
    if not found:
        raise InputError(f"{name} of fden_ros is not installed")
    return found[0]


def robot_names() -> tuple[str, ...]:
    """Return the names of the robots in ``config/robots``."""
    folders = all_shipped("config/robots")[:1]
    return tuple(sorted(path.stem for folder in folders for path in folder.glob("*.yaml")))


def all_shipped(name: str) -> list[Path]:
    """Return every place that a file or folder is in, the source tree first."""
    roots = [Path(__file__).resolve().parents[1]]
    prefixes = [sys.prefix, *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)]
    roots += [Path(prefix, "share", "fden_ros") for prefix in prefixes if prefix]
    return [root / name for root in roots if (root / name).exists()]
