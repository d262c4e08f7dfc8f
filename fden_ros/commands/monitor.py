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

"""``fden monitor``: a running identifier in the terminal."""

from __future__ import annotations

import argparse
import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

DESCRIPTION = """\
Show what a running identifier says: rates, status, contact, G, Gn and alpha with intervals of two
standard deviations, curves of the force and of G with its interval over the last 20 s, the
classification, the last contacts, and its warnings. Ctrl-C ends it.

  fden monitor                       the node /identifier
  fden monitor /left/identifier      another one
"""

_PERIOD = 0.2


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to ``fden``."""
    parser = subparsers.add_parser(
        "monitor",
        help="show a running identifier in the terminal",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "identifier", nargs="?", default="/identifier", help="its name (default: /identifier)"
    )
    parser.add_argument("--duration", type=float, metavar="S", help="stop after this time [s]")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Watch until Ctrl-C; return the exit code."""
    name = args.identifier if args.identifier.startswith("/") else f"/{args.identifier}"
    watch(name, duration=args.duration)
    return 0


def watch(
    identifier: str,
    *,
    duration: float | None = None,
    until: Callable[[], bool] = lambda: False,
    console: Any = None,
) -> None:
    """Show an identifier until `until` holds or `duration` [s] is over.

    Raises
    ------
    KeyboardInterrupt
        After SIGINT or SIGTERM.
    """
    from rich.console import Console
    from rich.live import Live

    from fden_ros.nodes.monitor import Monitor
    from fden_ros.report.monitor import monitor_view

    console = console or Console()
    end = time.monotonic() + duration if duration is not None else None
    with (
        _signals_noted() as noted,
        Monitor(identifier) as monitor,
        Live(console=console, auto_refresh=False, transient=False) as live,
    ):
        while not noted and not until() and (end is None or time.monotonic() < end):
            monitor.spin(_PERIOD)
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
