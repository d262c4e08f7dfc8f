# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden benchmark``: measure, and compare the figures with their goals."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from fden_ros.commands.checkout import checkout, module
from fden_ros.commands.command import Parser
from fden_ros.commands.options import JSON, add_options

DESCRIPTION = """\
Measure accuracy and speed, and compare the figures with their goals. Each
benchmark prints tables and writes its figures to NAME.json in the output
folder. Benchmarks are not installed: this needs a checkout.
"""

EPILOG = """\
examples:
  fden benchmark robots --quick             a minute or two; goals may stay undecided
  fden benchmark robots -o results          at full length
  fden benchmark robots --quick --json | jq '.goals[] | select(.met == false)'
  fden benchmark robots --help              arguments of this benchmark

A goal is met, missed, or undecided if the run was too short.
"""

#: What its exit codes say next to those of all commands.
EXIT_CODES = {0: "measured, whether the goals are met or not"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmarks, each with its own arguments."""
    if checkout() is None:
        words = "needs a checkout of fden_ros"
        parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="NAME", help=words)
        return
    names = parser.add_subparsers(
        dest="benchmark", required=True, metavar="NAME", parser_class=_BenchmarkParser
    )
    for name, summary in module("benchmark").BENCHMARKS.items():
        one = names.add_parser(
            name, help=summary, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        one.benchmark = name
        one.set_defaults(parser=one)
        words = "at most a minute or two; goals may stay undecided"
        one.add_argument("--quick", action="store_true", help=words)
        add_options(one, [JSON])
        words = f"folder of {name}.json (default: results)"
        one.add_argument(
            "-o", "--output", type=Path, default=Path("results"), metavar="DIR", help=words
        )


def run(args: argparse.Namespace) -> int:
    """Measure, print and write; return the exit code."""
    return int(module("benchmark.harness").main(args))


class _BenchmarkParser(Parser):
    """Parser of one benchmark, which imports it only when it is run."""

    benchmark = ""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, after the benchmark has added its own arguments."""
        if self.benchmark:
            own = module(f"benchmark.{self.benchmark}")
            self.description = own.__doc__
            self.benchmark = ""
            own.BENCHMARK.add_arguments(self)
        return super().parse_known_args(args, namespace)
