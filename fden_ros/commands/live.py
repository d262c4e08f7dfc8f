# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden live``: simulator, identifier, controller and monitor together, without a robot."""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from fden_ros.commands.command import positive
from fden_ros.commands.monitor import ending_signals, watch
from fden_ros.errors import InputError

if TYPE_CHECKING:
    from fden_ros.nodes.monitor import Monitor

DESCRIPTION = """\
Start the tissue simulator, the identifier and the force controller, each in a process of its own,
and show them in this terminal. Ctrl-C stops them all, and so does the end of the terminal or of
the process that has started this one; with nohup they go on.
"""

EPILOG = """\
examples:
  fden live                          the controller presses four sites, one with an inclusion
  fden live --fixed                  the same with fixed gains
  fden live --duration 30            for half a minute
"""

NAMESPACE = "/fden_live"
_STOP_TIMEOUT = 10.0
#: Of prctl(2).
_PR_SET_PDEATHSIG = 1

Processes = dict[str, subprocess.Popen[bytes]]


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
    from fden_ros.shipped import shipped

    path = args.parameters or shipped("config/tissue_simulator.yaml")
    if not path.is_file():
        raise InputError(f"{path}: there is no such parameter file; give one by --parameters")
    settings = {
        "tissue_simulator": "",
        "identifier": "autostart:=true",
        "force_controller": f"scheduled:={str(not args.fixed).lower()}",
    }
    with _running(path, NAMESPACE, settings) as nodes:
        parent, is_bound = os.getppid(), signal.SIGHUP in ending_signals()

        def look(monitor: Monitor) -> None:
            if is_bound and os.getppid() != parent:
                raise KeyboardInterrupt
            for name, process in nodes.items():
                if process.poll() is not None:
                    raise InputError(f"{name} ended early, with exit code {process.returncode}")

        try:
            watch(f"{NAMESPACE}/identifier", duration=args.duration, look=look)
        except KeyboardInterrupt:
            pass
        except OSError as error:
            # Of a terminal or a pipe that is gone: nobody looks any more.
            if error.errno not in (errno.EIO, errno.EPIPE):
                raise
    with contextlib.suppress(OSError):  # of a terminal that is gone
        print("stopped " + ", ".join(nodes), flush=True)
    return 0


@contextlib.contextmanager
def _running(parameters: Path, namespace: str, settings: Mapping[str, str]) -> Iterator[Processes]:
    """Run nodes as long as the context lasts; SIGTERM and SIGHUP end the program as Ctrl-C does.

    However this process ends, they do.

    Parameters
    ----------
    parameters : Path
        Their parameter file.
    namespace : str
    settings : mapping of str to str
        Of each node of :mod:`fden_ros.nodes.programs` to start one parameter more,
        ``name:=value``; empty: none.
    """
    processes: Processes = {}
    before = {
        number: signal.signal(number, signal.default_int_handler)
        for number in ending_signals()
        if number != signal.SIGINT
    }
    try:
        for name, setting in settings.items():
            command = [
                *(sys.executable, "-m", "fden_ros.nodes.programs", name, "--ros-args"),
                *("--params-file", str(parameters), "-r", f"__ns:={namespace}"),
                *("--log-level", "error", *(("-p", setting) if setting else ())),
            ]
            # In a session of their own: Ctrl-C comes to them once, from here.
            processes[name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
                preexec_fn=end_with_parent,
            )
        yield processes
    finally:
        # In reverse, so that nobody commands a rig that is gone.
        for process in reversed(processes.values()):
            _stop(process)
        for number, handler in before.items():
            signal.signal(number, handler)


def end_with_parent(number: int = signal.SIGINT) -> None:
    """Have Linux send the calling process a signal when its parent is gone, even killed."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)


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
