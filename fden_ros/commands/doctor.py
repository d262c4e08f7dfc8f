# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden doctor``: what a running identifier hears and lacks, and what to do next."""

from __future__ import annotations

import argparse

DESCRIPTION = """\
Listen to a running identifier for 3 s and print one page. It has what the identifier hears and
at which rates, what it lacks, what it refused last, and the one next step.
"""

EPILOG = """\
examples:
  fden doctor                        the node /identifier
  fden doctor /left/identifier       another one
"""

_UNWELL = 3
#: What its exit codes say beside those of all commands.
EXIT_CODES = {0: "all is well", _UNWELL: "something is wrong"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    parser.add_argument(
        "identifier", nargs="?", default="/identifier", help="its name (default: /identifier)"
    )


def run(args: argparse.Namespace) -> int:
    """Examine the node; return the exit code."""
    from fden_ros.nodes.doctor import examine

    found = examine("/" + args.identifier.lstrip("/"))
    print(found.page())
    return 0 if found.is_well else _UNWELL
