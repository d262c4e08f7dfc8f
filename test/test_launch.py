# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The launch files, run by ``ros2 launch`` as a user runs them; there are no wheels of it."""

from __future__ import annotations

import shutil
import signal
import subprocess
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from live_helpers import LIMIT, Ears, process_of

pytest.importorskip("launch_ros", reason="ros2 launch is not to be had as a wheel")
pytest.importorskip("ros2launch", reason="ros2 launch is not to be had as a wheel")
CLEANLY = "process has finished cleanly"


def launched(*arguments: str) -> AbstractContextManager[subprocess.Popen[str]]:
    """Run the launch file of the identifier; Ctrl-C it at the end, and keep its output."""
    program = shutil.which("ros2")
    assert program is not None
    return process_of([program, "launch", "fden_ros", "identifier.launch.py", *arguments])


def process_ids(namespace: str) -> list[int]:
    """Processes whose command line has this namespace."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if f"__ns:={namespace}".encode() in words:
            found.append(int(folder.name))
    return found


def is_up(ears: Ears, namespace: str) -> Callable[[], int]:
    return lambda: ears.node.count_publishers(f"{namespace}/identifier/estimate")


def test_a_wrong_parameter_file_starts_nothing_and_is_one_line(tmp_path):
    path = tmp_path / "probe.yaml"
    path.write_text("identifier: {ros__parameters: {geometry.thicknes: 0.02}}")
    # With respawn too: a node that refuses its file must not be started again and again.
    with launched(f"parameters:={path}", "respawn:=true") as launch:
        assert launch.wait(LIMIT) == 1
    assert launch.output.count("there is no parameter geometry.thicknes; did you mean") == 1
    assert "process started" not in launch.output and "Traceback" not in launch.output


def test_ctrl_c_of_the_terminal_and_of_the_launch_file_ends_the_node_cleanly():
    with Ears() as ears, launched("namespace:=/launched") as launch:
        ears.wait_for(is_up(ears, "/launched"), "the identifier")
        # A terminal sends it to the node too.
        for process_id in process_ids("/launched"):
            subprocess.run(["kill", "-INT", str(process_id)], check=False)
        launch.send_signal(signal.SIGINT)
    assert CLEANLY in launch.output
    assert "process has died" not in launch.output and "Traceback" not in launch.output
