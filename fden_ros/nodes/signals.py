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
