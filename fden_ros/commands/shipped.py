# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Files that come along with the package."""

from __future__ import annotations

from pathlib import Path


def config_file(name: str) -> Path:
    """Return a file of the folder ``config``: of the source tree or as installed."""
    here = Path(__file__).resolve().parents[2] / "config" / name
    if here.is_file():
        return here
    from ament_index_python.packages import get_package_share_directory

    return Path(get_package_share_directory("fden_ros")) / "config" / name
