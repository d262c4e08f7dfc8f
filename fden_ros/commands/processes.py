# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Nodes in processes of their own, for commands that show them at work."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

_STOP_TIMEOUT = 10.0

Processes = dict[str, subprocess.Popen[bytes]]


@contextlib.contextmanager
def running(parameters: Path, namespace: str, settings: Mapping[str, str]) -> Iterator[Processes]:
    """Run nodes as long as the context lasts; SIGTERM ends the program as Ctrl-C does.

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
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        for name, setting in settings.items():
            command = [
                *(sys.executable, "-m", "fden_ros.nodes.programs", name, "--ros-args"),
                *("--params-file", str(parameters), "-r", f"__ns:={namespace}"),
                *("--log-level", "error", *(("-p", setting) if setting else ())),
            ]
            # In a session of their own: Ctrl-C comes to them once, from here.
            processes[name] = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, start_new_session=True
            )
        yield processes
    finally:
        # In reverse, so that nobody commands a rig that is gone.
        for process in reversed(processes.values()):
            _stop(process)
        signal.signal(signal.SIGTERM, before)


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
