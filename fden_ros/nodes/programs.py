# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The nodes as programs: signals are caught before the node's imports.

``python -m fden_ros.nodes.programs identifier`` is the program ``identifier``. The imports take a
second; a terminal and a launch file both send Ctrl-C to a process, at any time.
"""

from __future__ import annotations

import functools
import importlib
import signal
import sys

from fden_ros.errors import without_ros

_NUMBERS = (signal.SIGINT, signal.SIGTERM)
_noted: list[int] = []


def note_signals() -> list[int]:
    """Catch SIGINT and SIGTERM from now on; return the list of those received."""
    for number in _NUMBERS:
        signal.signal(number, lambda caught, _: _noted.append(caught))
    return _noted


def ignore_signals() -> None:
    """Let no signal disturb the end of the process: Python would give them their default again."""
    for number in _NUMBERS:
        signal.signal(number, signal.SIG_IGN)
    _noted.clear()


def _run(name: str) -> int:
    note_signals()
    try:
        node = importlib.import_module(f"fden_ros.nodes.{name}")
    except ModuleNotFoundError as error:
        sys.exit(f"{name}: {without_ros(error)}")
    return int(node.main())


identifier = functools.partial(_run, "identifier")
tissue_simulator = functools.partial(_run, "tissue_simulator")
force_controller = functools.partial(_run, "force_controller")

if __name__ == "__main__":
    sys.exit(_run(sys.argv.pop(1)))
