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

"""The nodes as programs: signals are noted before what a node needs is imported.

``python -m fden_ros.nodes.programs identifier`` is the program ``identifier``. The imports take a
second; a terminal and a launch file both send Ctrl-C to a process, at any time.
"""

from __future__ import annotations

import importlib
import sys

from fden_ros.nodes.signals import note_signals


def identifier() -> int:
    """Run the node ``identifier``."""
    return _run("identifier")


def tissue_simulator() -> int:
    """Run the node ``tissue_simulator``."""
    return _run("tissue_simulator")


def force_controller() -> int:
    """Run the node ``force_controller``."""
    return _run("force_controller")


def bridge() -> int:
    """Run the node ``bridge``."""
    return _run("bridge")


def _run(name: str) -> int:
    note_signals()
    return int(importlib.import_module(f"fden_ros.nodes.{name}").main())


if __name__ == "__main__":
    sys.exit(_run(sys.argv.pop(1)))
