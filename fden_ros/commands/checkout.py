# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Modules of a checkout that are not installed: benchmarks and simulation."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import fden_ros
from fden_ros.errors import InputError


def checkout() -> Path | None:
    """Return the root of the checkout, if there is one."""
    for root in (Path(fden_ros.__file__).resolve().parents[1], Path.cwd()):
        if (root / "benchmark" / "harness.py").is_file() and (root / "fden_ros").is_dir():
            return root
    return None


def module(name: str) -> Any:
    """Return a module of a checkout, such as ``simulation.scenario``.

    Raises
    ------
    InputError
        If there is no checkout.
    """
    root = checkout()
    if root is None:
        raise InputError(
            f"an installed fden_ros has no {name.partition('.')[0]}: run this in a checkout"
        )
    if str(root) not in sys.path:
        sys.path.insert(0, str(root))
    return importlib.import_module(name)
