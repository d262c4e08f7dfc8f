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

"""``fden live``: simulator, identifier, controller and monitor together, without a robot."""

from __future__ import annotations

import argparse
import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

DESCRIPTION = """\
Start the tissue simulator, the identifier and the force controller, each in a process of its own,
and show them in this terminal. Ctrl-C stops them all.

  fden live                          the controller presses four sites, one with an inclusion
  fden live --fixed                  the same with fixed gains
  fden live --duration 30            for half a minute
"""

NAMESPACE = "/fden_live"
_NODES = ("tissue_simulator", "identifier", "force_controller")
_STOP_TIMEOUT = 10.0


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to ``fden``."""
    parser = subparsers.add_parser(
        "live",
        help="simulator, identifier, controller and monitor together",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--parameters",
        type=Path,
        metavar="FILE",
        help="parameters of the three nodes (default: config/tissue_simulator.yaml)",
    )
    parser.add_argument("--fixed", action="store_true", help="fixed gains")
    parser.add_argument("--duration", type=float, metavar="S", help="stop after this time [s]")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the live system; return the exit code."""
    from fden_ros.commands.monitor import watch
    from fden_ros.commands.shipped import config_file
    from fden_ros.errors import InputError

    path = args.parameters or config_file("tissue_simulator.yaml")
    if not path.is_file():
        raise InputError(f"{path}: there is no such parameter file; give one by --parameters")
    with _signals(), running(path, fixed=args.fixed) as processes:

        def is_over() -> bool:
            for name, process in processes.items():
                if process.poll() is not None:
                    raise InputError(f"{name} ended early, with exit code {process.returncode}")
            return False

        with contextlib.suppress(KeyboardInterrupt):
            watch(f"{NAMESPACE}/identifier", duration=args.duration, until=is_over)
    print("stopped " + ", ".join(processes))
    return 0


@contextlib.contextmanager
def running(path: Path, *, fixed: bool = False) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Run the three nodes; stop them in reverse, so that nobody commands a rig that is gone."""
    extra = {
        "identifier": ["-p", "autostart:=true"],
        "force_controller": ["-p", f"scheduled:={str(not fixed).lower()}"],
    }
    processes: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name in _NODES:
            command = [
                *(sys.executable, "-m", "fden_ros.nodes.programs", name, "--ros-args"),
                *("--params-file", str(path), "-r", f"__ns:={NAMESPACE}"),
                *("--log-level", "error", *extra.get(name, [])),
            ]
            # In a session of their own: Ctrl-C comes to them once, from here.
            processes[name] = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, start_new_session=True
            )
        yield processes
    finally:
        for process in reversed(processes.values()):
            _stop(process)


def _stop(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    end = time.monotonic() + _STOP_TIMEOUT
    while process.poll() is None:
        if time.monotonic() > end:
            process.kill()
        # A second Ctrl-C must not leave anybody behind.
        with contextlib.suppress(subprocess.TimeoutExpired, KeyboardInterrupt):
            process.wait(0.2)


@contextlib.contextmanager
def _signals() -> Iterator[None]:
    """Let SIGTERM end the program as Ctrl-C does."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
