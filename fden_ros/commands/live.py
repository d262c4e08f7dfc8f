# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden live``: simulator, identifier, controller and monitor together, without a robot."""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from fden_ros.commands.monitor import watch
from fden_ros.errors import InputError

DESCRIPTION = """\
Start the tissue simulator, the identifier and the force controller, each in
its own process, and show the state of the identifier in this terminal. Ctrl-C
stops them all.
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


def run(args: argparse.Namespace) -> int:
    """Run the live system; return the exit code."""
    import fden_ros.nodes.monitor  # noqa: F401, without ROS 2 nothing is to start
    from fden_ros.shipped import shipped

    path = args.parameters or shipped("config/tissue_simulator.yaml")
    if not path.is_file():
        raise InputError(f"{path}: there is no such parameter file; give one with --parameters")
    settings = {
        "tissue_simulator": "use_sim_time:=false",
        "identifier": "autostart:=true",
        "force_controller": f"scheduled:={str(not args.fixed).lower()}",
    }
    with contextlib.ExitStack() as started:
        # They end in reverse order, so that no node commands a rig that is gone.
        nodes = {n: started.enter_context(_running(n, path, s)) for n, s in settings.items()}

        def look(_: object) -> None:
            for name, process in nodes.items():
                if process.poll() is not None:
                    raise InputError(f"{name} ended early, with exit code {process.returncode}")

        watch(f"{NAMESPACE}/identifier", duration=args.duration, look=look)
    return 0


@contextlib.contextmanager
def _running(name: str, parameters: Path, setting: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a node of :mod:`fden_ros.nodes.programs` with one parameter more, ``name:=value``."""
    command = [
        *(sys.executable, "-m", "fden_ros.nodes.programs", name, "--ros-args"),
        *("--params-file", str(parameters), "-r", f"__ns:={NAMESPACE}"),
        *("--log-level", "error", "-p", setting),
    ]
    # In its own session, so that Ctrl-C reaches it only once, from here.
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=end_with_parent,
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(_STOP_TIMEOUT)
        except (subprocess.TimeoutExpired, KeyboardInterrupt):
            process.kill()


def end_with_parent(number: int = signal.SIGINT) -> None:
    """Have Linux send the calling process a signal when its parent is gone, even killed."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)
