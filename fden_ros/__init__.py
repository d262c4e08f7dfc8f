# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Identify soft tissue with the FDEN model: fractional dynamics, exponential nonlinearity.

:func:`fden_ros.fit` identifies the tissue of arrays; ``docs/python.md`` has the rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fden_ros.arrays import fit as fit

__version__: str


def __getattr__(name: str) -> Any:
    # Imported on demand: each takes as long to import as all that the core needs at first.
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    if name == "fit":
        from fden_ros.arrays import fit

        return fit
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
