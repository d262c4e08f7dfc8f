# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Identify soft tissue online with the FDEN model: fractional dynamics, exponential stress."""

__version__: str


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # Only where it is asked for: it takes as long to import as all that the core needs at first.
    from importlib.metadata import version

    return version(__name__)
