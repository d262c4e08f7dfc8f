# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden monitor``: a running identifier in the terminal."""

from __future__ import annotations

import argparse
import contextlib
import math
import signal
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fden_ros.nodes.monitor import Monitor
    from fden_ros.report.monitor import MonitorView

DESCRIPTION = """\
Show the state of a running identifier in the terminal: rates, status, contact,
G, Gn and alpha with intervals of two standard deviations, the classification,
the last contacts, and warnings. Ctrl-C ends it. If the output is not a
terminal, the command prints one line per second.
"""

EPILOG = """\
examples:
  fden monitor                       the node /identifier
  fden monitor /left/identifier      a node in a namespace
"""

_PERIOD = 0.2
#: Without a terminal one line is printed per this time [s].
_LINE_PERIOD = 1.0


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
    """Show an identifier until `duration` [s] is over; call `look` with each view.

    Raises
    ------
    KeyboardInterrupt
        After SIGINT or SIGTERM.
    """
    from fden_ros.nodes.monitor import Monitor

    end = time.monotonic() + duration if duration is not None else None
    with _signals_noted() as noted, Monitor(identifier) as monitor, _shown() as show:
        while not noted and (end is None or time.monotonic() < end):
            monitor.spin(_PERIOD)
            look(monitor)
            show(monitor.view())
    if noted:
        raise KeyboardInterrupt


@contextlib.contextmanager
def _shown() -> Iterator[Callable[[MonitorView], object]]:
    """Show views in a terminal; otherwise print a line from time to time, and the last in full."""
    from rich.console import Console
    from rich.live import Live

    from fden_ros.report.monitor import monitor_line, monitor_view

    console = Console()
    if console.is_terminal:
        with Live(console=console, auto_refresh=False, transient=False) as live:
            yield lambda view: live.update(monitor_view(view), refresh=True)
        return
    last: list[MonitorView] = []
    newest = -math.inf

    def note(view: MonitorView) -> None:
        nonlocal newest
        last[:] = [view]
        if time.monotonic() - newest >= _LINE_PERIOD:
            newest = time.monotonic()
            print(monitor_line(view), flush=True)

    try:
        yield note
    finally:
        for view in last:
            console.print(monitor_view(view))


def ending_signals() -> list[signal.Signals]:
    """Return the signals that end a command, with SIGHUP unless that is ignored."""
    found = [signal.SIGINT, signal.SIGTERM]
    # As with nohup.
    is_ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return found if is_ignored else [*found, signal.SIGHUP]


@contextlib.contextmanager
def _signals_noted() -> Iterator[list[int]]:
    """Record the signal: an exception within rclpy would come out as another one."""
    noted: list[int] = []
    before = {
        number: signal.signal(number, lambda caught, _: noted.append(caught))
        for number in ending_signals()
    }
    try:
        yield noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
