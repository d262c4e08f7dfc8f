# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""``fden layout``: the Foxglove layout for an identifier of another name."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from typing import Any

DESCRIPTION = """\
Print the Foxglove layout (config/foxglove_layout.json) for topics under a namespace, or of other
names. Import it in Foxglove: Layouts, Import from file.

  fden layout --namespace /left > left.json
  fden layout --force /ft/wrench --displacement /arm/pose > probe.json

RViz needs none: the topics of config/identifier.rviz follow its own namespace,
  rviz2 -d config/identifier.rviz -f FRAME --ros-args -r __ns:=/left
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to ``fden``."""
    parser = subparsers.add_parser(
        "layout",
        help="the Foxglove layout for topics under a namespace",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--namespace", default="", metavar="NS", help="of the identifier and its inputs"
    )
    for what in ("force", "displacement"):
        parser.add_argument(
            f"--{what}", metavar="TOPIC", help=f"topic of the {what} (default: NS/{what})"
        )
    parser.set_defaults(run=run)


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
