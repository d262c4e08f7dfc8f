# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What several commands of ``fden`` share: types of arguments, JSON, complete files."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fden_ros.errors import InputError


class Parser(argparse.ArgumentParser):
    """A parser that says what is wrong in one line, and where the rest is explained."""

    def error(self, message: str) -> Any:
        """End the program with exit code 2."""
        self.exit(2, f"{self.prog}: error: {message}; see {self.prog} --help\n")


def number(
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    below: float = math.inf,
    whole: bool = False,
) -> Callable[[str], float]:
    """Return a type of argument: a finite number within bounds, of which `least` is allowed."""
    expected = "a whole number" if whole else "a number"
    bounds = (("above", above), ("of at least", least), ("below", below))
    limits = " and ".join(f"{word} {value:g}" for word, value in bounds if math.isfinite(value))
    words = f"{expected} {limits}".rstrip()

    def convert(text: str) -> float:
        try:
            value = int(text) if whole else float(text)
        except ValueError:
            value = math.nan
        if above < value < below and least <= value:
            return value
        raise argparse.ArgumentTypeError(f"expected {words}, got {text!r}")

    return convert


positive = number(above=0.0)
count = number(least=1, whole=True)


def print_json(value: Any) -> int:
    """Print one JSON object; return the exit code of success."""
    json.dump(value, sys.stdout, allow_nan=False)
    print()
    return 0


def write(path: Path, save: Callable[[Path], object]) -> None:
    """Let `save` write a file, which appears only when it is complete.

    Raises
    ------
    InputError
        If it cannot.
    """
    draft = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        save(draft)
        draft.replace(path)
    except (OSError, ValueError) as error:
        draft.unlink(missing_ok=True)
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise InputError(f"{path} cannot be written: {reason}") from None
