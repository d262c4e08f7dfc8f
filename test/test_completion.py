# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What may come next on the command line of fden."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    ("line", "word"), [("fden rep", "replay"), ("fden replay rec --conf", "--config")]
)
def test_a_shell_completes_commands_and_options(line, word):
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line))}
    # argcomplete answers on this descriptor.
    command = f"exec 8>&1; exec {sys.executable} -m fden_ros.cli"
    environment = os.environ | asked
    done = subprocess.run(
        ["bash", "-c", command], env=environment, capture_output=True, text=True, check=False
    )
    assert word in done.stdout


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_line_that_the_installation_gives_makes_a_shell_complete_fden(shell, tmp_path):
    if shutil.which(shell) is None:
        pytest.skip(f"needs {shell}")
    root = Path(__file__).parent.parent
    script = (root / "scripts" / "install").read_text(encoding="utf-8")
    says = script[script.index("shell=") : script.index("\n}\n", script.index("put_on_path()"))]
    path = f"export PATH={Path(sys.executable).parent}:$PATH"
    said = f"{says}\n}}\nput_on_path '{path}' | tail -n 1"
    environment = {"HOME": str(tmp_path), "PATH": os.environ["PATH"], "SHELL": f"/bin/{shell}"}
    run = {"env": environment, "capture_output": True, "text": True, "check": True}
    line = subprocess.run(["bash", "-ec", said], **run).stdout
    subprocess.run(["bash", "-ec", line], **run)
    asked = {"bash": "complete -p fden", "zsh": "print $_comps[fden]"}[shell]
    done = subprocess.run([shell, "-ic", asked], stdin=subprocess.DEVNULL, **run)
    assert "_python_argcomplete" in done.stdout
    assert "fden" not in done.stderr and "not found" not in done.stderr
