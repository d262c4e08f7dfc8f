# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Hypotheses about a record, one a file; to add one, add a file.

Its function `propose(posterior, points, maxima, strain)` gives, in parts, what it adds to the
maxima of a posterior (:class:`~fden_ros.core.estimation.maxima.Proposed`).
"""

from __future__ import annotations

import functools
import pkgutil
from importlib import import_module
from typing import Any


@functools.cache
def functions(name: str) -> tuple[Any, ...]:
    """Return the functions of a name that files here have, by the order of the files' names."""
    files = sorted(module.name for module in pkgutil.iter_modules(__path__))
    modules = [import_module(f"{__name__}.{file}") for file in files]
    return tuple(getattr(module, name) for module in modules if hasattr(module, name))
