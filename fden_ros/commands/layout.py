# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden layout``: the Foxglove layout for an identifier of another name."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from typing import Any

from fden_ros.commands.command import Command

DESCRIPTION = """\
Print the Foxglove layout (config/foxglove_layout.json) for topics under a namespace, or of other
names. Import it in Foxglove: Layouts, Import from file.
"""

EPILOG = """\
examples:
  fden layout --namespace /left > left.json
  fden layout --force /ft/wrench --displacement /arm/pose > probe.json

RViz needs none: the topics of config/identifier.rviz follow its own namespace,
  rviz2 -d config/identifier.rviz -f FRAME --ros-args -r __ns:=/left
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    parser.add_argument(
        "--namespace", default="", metavar="NS", help="of the identifier and its inputs"
    )
    for what in ("force", "displacement"):
        parser.add_argument(
            f"--{what}", metavar="TOPIC", help=f"topic of the {what} (default: NS/{what})"
        )


def run(args: argparse.Namespace) -> int:
    """Print the layout; return the exit code."""
    from fden_ros.commands.shipped import config_file

    parts = [part for part in args.namespace.split("/") if part]
    namespace = "".join(f"/{part}" for part in parts)
    names = {
        "/identifier": f"{namespace}/identifier",
        "/force": args.force or f"{namespace}/force",
        "/displacement": args.displacement or f"{namespace}/displacement",
        # The name of a status on /diagnostics has no slash before it.
        "identifier:": "/".join([*parts, "identifier:"]),
    }
    layout = json.loads(config_file("foxglove_layout.json").read_text(encoding="utf-8"))
    json.dump(_renamed(layout, names), sys.stdout, indent=2)
    print()
    return 0


def _renamed(value: Any, names: Mapping[str, str]) -> Any:
    """Return a layout with other names wherever a string begins with one."""
    if isinstance(value, dict):
        return {_renamed(key, names): _renamed(item, names) for key, item in value.items()}
    if isinstance(value, list):
        return [_renamed(item, names) for item in value]
    if isinstance(value, str):
        for name, other in names.items():
            rest = value.removeprefix(name)
            if rest != value and (not rest or rest[0] in "/. "):
                return other + rest
    return value


COMMAND = Command(
    "layout",
    "the Foxglove layout for topics under a namespace",
    DESCRIPTION,
    EPILOG,
    add_arguments,
    run,
)
