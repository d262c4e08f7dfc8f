"""The nodes as programs: signals are noted before what a node needs is imported.

``python -m fden_ros.nodes.programs identifier`` is the program ``identifier``. The imports take a
second; a terminal and a launch file both send Ctrl-C to a process, at any time.
"""

from __future__ import annotations

import importlib
import sys

from fden_ros.nodes.signals import note_signals


def identifier() -> int:
    """Run the node ``identifier``."""
    return _run("identifier")


def tissue_simulator() -> int:
    """Run the node ``tissue_simulator``."""
    return _run("tissue_simulator")


def force_controller() -> int:
    """Run the node ``force_controller``."""
    return _run("force_controller")


def _run(name: str) -> int:
    note_signals()
    return int(importlib.import_module(f"fden_ros.nodes.{name}").main())


if __name__ == "__main__":
    sys.exit(_run(sys.argv.pop(1)))
