# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Nodes in processes of their own, and a plain node that hears them."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor

from benchmark.node import end_with_parent

ROOT = Path(__file__).parent.parent
PARAMETERS = ROOT / "config" / "tissue_simulator.yaml"
#: How long a condition is waited for, on a machine that does much else beside [s]. Only what fails
#: takes so long.
LIMIT = 180.0


def wait_for(
    condition: Callable[[], Any],
    what: str,
    timeout: float = LIMIT,
    meanwhile: Callable[[], object] = lambda: time.sleep(0.01),
) -> Any:
    """Wait until `condition` holds; return its value."""
    end = time.monotonic() + timeout
    while not (value := condition()):
        assert time.monotonic() < end, f"waited {timeout:g} s in vain for {what}"
        meanwhile()
    return value


class Ears:
    """A plain node with its executor, in a context of its own."""

    node_name = "ears"

    def __enter__(self) -> Ears:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node(self.node_name, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        return self

    def __exit__(self, *_: object) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def hear(self, kind: type, topic: str, qos: Any = 1000) -> list[Any]:
        """Return a list that every message of a topic goes into."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, qos)
        return heard

    def spin_for(self, seconds: float) -> None:
        """Spin for so long, to show that nothing comes."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)

    def wait_for(self, condition: Callable[[], Any], what: str, timeout: float = LIMIT) -> Any:
        """Spin until `condition` holds; return its value."""
        return wait_for(condition, what, timeout, lambda: self.executor.spin_once(0.02))


def command_of(
    name: str,
    parameters: Mapping[str, Any],
    *,
    file: Path | None = None,
    remap: Mapping[str, str] | None = None,
) -> list[str]:
    """Return the command line that runs a node."""
    command = [sys.executable, "-m", "fden_ros.nodes.programs", name, "--ros-args"]
    if file is not None:
        command += ["--params-file", str(file)]
    for key, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        command += ["-p", f"{key}:={text}"]
    for old, new in (remap or {}).items():
        command += ["-r", f"{old}:={new}"]
    return command


@contextlib.contextmanager
def node_process(
    name: str, parameters: Mapping[str, Any] | None = None, *, file: Path | None = None
) -> Iterator[subprocess.Popen[str]]:
    """Run a node; stop it by SIGINT, and keep its output."""
    with process_of(command_of(name, parameters or {}, file=file)) as process:
        yield process


@contextlib.contextmanager
def process_of(command: list[str]) -> Iterator[subprocess.Popen[str]]:
    """Run a program; continue, stop and reap it whatever was done to it."""
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=end_with_parent,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.send_signal(signal.SIGINT)
        try:
            output, _ = process.communicate(timeout=LIMIT)
        except subprocess.TimeoutExpired:
            process.kill()
            output, _ = process.communicate()
            raise
        finally:
            process.output = output  # type: ignore[attr-defined]
            # Shown by pytest if the test fails.
            print(output)
