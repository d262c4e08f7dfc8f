# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden monitor``: a running identifier in the terminal."""

from __future__ import annotations

import argparse
import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from fden_ros.commands.command import positive

if TYPE_CHECKING:
    from fden_ros.nodes.monitor import Monitor

DESCRIPTION = """\
Show what a running identifier says: rates, status, contact, G, Gn and alpha with intervals of two
standard deviations, the classification, the last contacts, and its warnings. Ctrl-C ends it.
"""

EPILOG = """\
examples:
  fden monitor                       the node /identifier
  fden monitor /left/identifier      another one
"""

_PERIOD = 0.2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    parser.add_argument(
        "identifier", nargs="?", default="/identifier", help="its name (default: /identifier)"
    )
    parser.add_argument("--duration", type=positive, metavar="S", help="stop after this time [s]")


def run(args: argparse.Namespace) -> int:
    """Watch until Ctrl-C; return the exit code."""
    name = args.identifier if args.identifier.startswith("/") else f"/{args.identifier}"
    watch(name, duration=args.duration)
    return 0


def watch(
    identifier: str,
    *,
    duration: float | None = None,
    look: Callable[[Monitor], object] = lambda monitor: None,
) -> None:
    """Show an identifier until `duration` [s] is over; call `look` with what is heard, each time.

    Raises
    ------
    KeyboardInterrupt
        After SIGINT or SIGTERM.
    """
    from rich.console import Console
    from rich.live import Live

    from fden_ros.nodes.monitor import Monitor
    from fden_ros.report.monitor import monitor_view

    console = Console()
    end = time.monotonic() + duration if duration is not None else None
    with (
        _signals_noted() as noted,
        Monitor(identifier) as monitor,
        Live(console=console, auto_refresh=False, transient=False) as live,
    ):
        while not noted and (end is None or time.monotonic() < end):
            monitor.spin(_PERIOD)
            look(monitor)
            live.update(monitor_view(monitor.view()), refresh=True)
    if not console.is_terminal:
        console.line()  # rich ends the last line on terminals only
    if noted:
        raise KeyboardInterrupt


@contextlib.contextmanager
def _signals_noted() -> Iterator[list[int]]:
    """Note SIGINT and SIGTERM: raised in the middle of rclpy they come out as something else."""
    noted: list[int] = []
    before = {
        number: signal.signal(number, lambda caught, _: noted.append(caught))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
