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

"""SIGINT and SIGTERM ask a program to end: noted, however often, and never raised."""

from __future__ import annotations

import signal

_NUMBERS = (signal.SIGINT, signal.SIGTERM)
_noted: list[int] = []


def note_signals() -> list[int]:
    """Note signals from now on; return the list that they go into, with those noted before."""
    for number in _NUMBERS:
        signal.signal(number, lambda caught, _: _noted.append(caught))
    return _noted


def ignore_signals() -> None:
    """Let no signal disturb the end of the process: Python would give them their default again."""
    for number in _NUMBERS:
        signal.signal(number, signal.SIG_IGN)
    _noted.clear()
