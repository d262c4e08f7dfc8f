# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fuzz what reads parameter files, and what makes a configuration of them."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["fden_ros.parameters", "yaml"]):
    from fden_ros.parameters import pipeline_config, read_parameter_file

from harness import fuzz

from fden_ros.commands.parameters import parameter_file

PATH = Path(tempfile.mkdtemp(prefix="fuzz_parameters")) / "fuzzed.yaml"


def one_input(data: bytes) -> None:
    PATH.write_bytes(data)
    pipeline_config(read_parameter_file(PATH))


SEEDS = {
    "all": "\n".join(
        line for line in parameter_file().splitlines() if not line.lstrip().startswith("#")
    ).encode(),
    "plain": b"/**:\n  ros__parameters: {geometry.area: 1e-4, force.axis: [0, 0, -1]}\n",
    "ros": b"identifier:\n  ros__parameters:\n    geometry: {kind: sphere, radius: 0.01}\n",
}

if __name__ == "__main__":
    sys.exit(fuzz(one_input, SEEDS))
