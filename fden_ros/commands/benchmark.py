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

"""``fden benchmark``: measure, and hold the figures against their goals."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fden_ros.benchmarks import BENCHMARKS

DESCRIPTION = """\
Measure how good the package is, and hold the figures against their goals. Each benchmark prints a
table and leaves its figures and a picture in the output folder: NAME.json and NAME.png.
"""

EPILOG = """\
examples:
  fden benchmark accuracy --quick           under a minute; may answer undecided
  fden benchmark accuracy -o results        the whole of it
  fden benchmark accuracy --quick --json | jq '.goals[] | select(.met == false)'
  fden benchmark accuracy --help            arguments of this benchmark

A goal is met, missed, or undecided where the run was too short to tell. Exit codes: 0 measured,
whatever came out; 1 the input cannot be used; 2 wrong usage.
"""


#: Columns of a table that goes into a file.
_WIDTH = 120


class _BenchmarkParser(argparse.ArgumentParser):
    """Parser of one benchmark, which imports it only when it is asked for."""

    benchmark = ""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, after the benchmark has added its own arguments."""
        if self.benchmark:
            module = importlib.import_module(f"fden_ros.benchmarks.{self.benchmark}")
            self.description = module.__doc__
            self.benchmark = ""
            module.add_arguments(self)
        return super().parse_known_args(args, namespace)


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to ``fden``."""
    parser = subparsers.add_parser(
        "benchmark",
        help="measure accuracy and speed against their goals",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    names = parser.add_subparsers(
        dest="benchmark", required=True, metavar="NAME", parser_class=_BenchmarkParser
    )
    for name, summary in BENCHMARKS.items():
        one = names.add_parser(
            name, help=summary, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        one.benchmark = name
        one.add_argument(
            "--quick", action="store_true", help="less than a minute; goals may stay undecided"
        )
        one.add_argument("--json", action="store_true", help="print one JSON object")
        one.add_argument(
            "-o",
            "--output",
            type=Path,
            default=Path("benchmark"),
            metavar="DIR",
            help=f"folder of {name}.json and {name}.png (default: benchmark)",
        )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure, print and write; return the exit code."""
    from matplotlib.figure import Figure
    from rich.console import Console

    from fden_ros.errors import InputError

    module = importlib.import_module(f"fden_ros.benchmarks.{args.benchmark}")
    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{args.output}: {error.strerror}; name a folder for the results with -o"
        ) from error
    report = module.run(args)
    result = report.json_object(args.benchmark, args.quick)
    figures, picture = (args.output / f"{args.benchmark}.{end}" for end in ("json", "png"))
    figures.write_text(json.dumps(result, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    figure = Figure(figsize=(12, 7), layout="constrained")
    report.draw(figure)
    figure.savefig(picture, dpi=110)
    if args.json:
        json.dump(result, sys.stdout, allow_nan=False)
        print()
        return 0
    console = Console()
    if not console.is_terminal:
        console.width = _WIDTH
    for table in report.tables:
        console.print(table)
    console.print(_goal_table(report.goals))
    console.print(f"wrote {picture} and {figures}")
    return 0


_ANSWERS = {True: "[green]met[/green]", False: "[red]missed[/red]", None: "undecided"}


def _goal_table(goals: Sequence[Any]) -> Any:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    table = Table(title="Goals", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("")
    table.add_column("measured", justify="right", no_wrap=True)
    table.add_column("goal", justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for goal in goals:
        value = f"{goal.value:.4g}" if isinstance(goal.value, float) else str(goal.value or "–")
        if goal.value == 0 and not isinstance(goal.value, float):
            value = "0"
        table.add_row(escape(goal.name), escape(value), escape(goal.goal), _ANSWERS[goal.met])
    return table
