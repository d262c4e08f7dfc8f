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
