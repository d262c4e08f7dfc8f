# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fuzz what reads tissue libraries."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["fden_ros.tissues.library", "yaml"]):
    from fden_ros.tissues.library import load_library

from harness import fuzz

import fden_ros

PATH = Path(tempfile.mkdtemp(prefix="fuzz_library")) / "fuzzed.yaml"


def one_input(data: bytes) -> None:
    PATH.write_bytes(data)
    load_library(PATH)


if __name__ == "__main__":
    built_in = Path(fden_ros.__file__).parent / "tissues" / "tissues.yaml"
    sys.exit(fuzz(one_input, {"built_in": built_in.read_bytes()}))
