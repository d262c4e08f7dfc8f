# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden live``: simulator, identifier, controller and monitor together, without a robot."""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path

from fden_ros.commands.command import positive
from fden_ros.commands.processes import running

DESCRIPTION = """\
Start the tissue simulator, the identifier and the force controller, each in a process of its own,
and show them in this terminal. Ctrl-C stops them all.
"""

EPILOG = """\
examples:
  fden live                          the controller presses four sites, one with an inclusion
  fden live --fixed                  the same with fixed gains
  fden live --duration 30            for half a minute
"""

NAMESPACE = "/fden_live"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    parser.add_argument(
        "--parameters",
        type=Path,
        metavar="FILE",
        help="parameters of the three nodes (default: config/tissue_simulator.yaml)",
    )
    parser.add_argument("--fixed", action="store_true", help="fixed gains")
    parser.add_argument("--duration", type=positive, metavar="S", help="stop after this time [s]")


def run(args: argparse.Namespace) -> int:
    """Run the live system; return the exit code."""
    from fden_ros.commands.monitor import watch
    from fden_ros.errors import InputError
    from fden_ros.shipped import shipped

    path = args.parameters or shipped("config/tissue_simulator.yaml")
    if not path.is_file():
        raise InputError(f"{path}: there is no such parameter file; give one by --parameters")
    scheduled = str(not args.fixed).lower()
    settings = {
        "tissue_simulator": "",
        "identifier": "autostart:=true",
        "force_controller": f"scheduled:={scheduled}",
    }
    with running(path, NAMESPACE, settings) as nodes:

        def look() -> None:
            for name, process in nodes.items():
                if process.poll() is not None:
                    raise InputError(f"{name} ended early, with exit code {process.returncode}")

        with contextlib.suppress(KeyboardInterrupt):
            watch(f"{NAMESPACE}/identifier", duration=args.duration, look=look)
    print("stopped " + ", ".join(nodes))
    return 0
