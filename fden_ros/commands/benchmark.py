# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden benchmark``: measure, and hold the figures against their goals."""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path
from typing import Any

import fden_ros
from fden_ros.commands.command import Command, Parser, add_json
from fden_ros.errors import InputError

DESCRIPTION = """\
Measure how good the package is, and hold the figures against their goals. Each benchmark prints
tables and leaves its figures in the output folder: NAME.json. They are not installed: this works
from a checkout.
"""

EPILOG = """\
examples:
  fden benchmark robots --quick             a minute or two; may answer undecided
  fden benchmark robots -o results          the whole of it
  fden benchmark robots --quick --json | jq '.goals[] | select(.met == false)'
  fden benchmark robots --help              arguments of this benchmark

A goal is met, missed, or undecided where the run was too short to tell. Exit codes: 0 measured,
whatever came out; 1 the input cannot be used; 2 wrong usage.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmarks, each with its own arguments."""
    if _checkout() is None:
        words = "needs a checkout of fden_ros"
        parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="NAME", help=words)
        return
    names = parser.add_subparsers(
        dest="benchmark", required=True, metavar="NAME", parser_class=_BenchmarkParser
    )
    for name, summary in _module().BENCHMARKS.items():
        one = names.add_parser(
            name, help=summary, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        one.benchmark = name
        words = "less than a minute or two; goals may stay undecided"
        one.add_argument("--quick", action="store_true", help=words)
        add_json(one)
        words = f"folder of {name}.json (default: results)"
        one.add_argument(
            "-o", "--output", type=Path, default=Path("results"), metavar="DIR", help=words
        )


def run(args: argparse.Namespace) -> int:
    """Measure, print and write; return the exit code."""
    return int(_module("harness").main(args))


class _BenchmarkParser(Parser):
    """Parser of one benchmark, which imports it only when it is asked for."""

    benchmark = ""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, after the benchmark has added its own arguments."""
        if self.benchmark:
            module = _module(self.benchmark)
            self.description = module.__doc__
            self.benchmark = ""
            module.BENCHMARK.add_arguments(self)
        return super().parse_known_args(args, namespace)


def _checkout() -> Path | None:
    """Return the folder with the package and its benchmarks, if there is one."""
    for root in (Path(fden_ros.__file__).resolve().parents[1], Path.cwd()):
        if (root / "benchmark" / "harness.py").is_file() and (root / "fden_ros").is_dir():
            return root
    return None


def _module(name: str = "") -> Any:
    """Return a module of the benchmarks, or their package."""
    root = _checkout()
    if root is None:
        raise InputError("benchmarks need a checkout of fden_ros: run this in its folder")
    if str(root) not in sys.path:
        sys.path.insert(0, str(root))
    return importlib.import_module(f"benchmark.{name}" if name else "benchmark")


COMMAND = Command(
    "benchmark",
    "measure accuracy and speed against their goals",
    DESCRIPTION,
    EPILOG,
    add_arguments,
    run,
)
