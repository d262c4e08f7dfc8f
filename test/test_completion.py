# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What may come next on the command line of fden."""

from __future__ import annotations

import os
import subprocess
import sys

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
