# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Common parts of all benchmarks: arguments, trials in a pool of processes, goals, and output.

``--json`` and NAME.json hold::

    {"benchmark": "robots", "quick": false,
     "goals": [{"name": ..., "value": ..., "goal": ..., "met": true}, ...],
     "figures": {TABLE: {ROW: {COLUMN: VALUE, ...}, ...}, ...}}
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import math
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from rich.box import MARKDOWN
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Printed

from benchmark.score import Share
from fden_ros.errors import InputError
from fden_ros.progress import progress

Result = TypeVar("Result")

#: Names the folder with measured tests by default.
DATA_VARIABLE = "FDEN_DATA"
#: Of a pool.
PROCESSES = os.cpu_count() or 1
#: Columns of a table that goes into a file.
_WIDTH = 400


class Goal(NamedTuple):
    """One figure and its target; `met` is None where this run cannot decide."""

    name: str
    value: float | int | str | None
    goal: str
    met: bool | None


def within(
    name: str,
    value: float,
    limits: tuple[float, float],
    interval: tuple[float, float] | None = None,
) -> Goal:
    """Return the goal that a figure lies within limits, ends included.

    A value that is not finite was not measured: undecided. A given confidence interval decides:
    inside the limits the goal is met, beyond them missed, across one undecided.
    """
    low, high = limits
    words = f"{low:g} to {high:g}"
    if math.isinf(low) or math.isinf(high):
        words = f"<= {high:g}" if math.isinf(low) else f">= {low:g}"
    if not math.isfinite(value):
        return Goal(name, None, words, None)
    least, largest = (value, value) if interval is None else interval
    is_inside, is_beyond = low <= least and largest <= high, largest < low or least > high
    return Goal(name, float(value), words, bool(is_inside) if is_inside or is_beyond else None)


def at_most(
    name: str, value: float, limit: float, interval: tuple[float, float] | None = None
) -> Goal:
    """Return the goal of a largest figure."""
    return within(name, value, (-math.inf, limit), interval)


def at_least(name: str, value: float, limit: float) -> Goal:
    """Return the goal of a least figure."""
    return within(name, value, (limit, math.inf))


def few(name: str, share: Share, limit: float) -> Goal:
    """Return the goal of a largest share, decided by its 95 % interval."""
    return at_most(name, share.value, limit, share.interval() if share.whole else None)


class Table(NamedTuple):
    """Rows of figures: the name of each, and its cells by column."""

    title: str
    rows: Mapping[str, Mapping[str, Any]]


class Report(NamedTuple):
    """The results of a benchmark: goals, and tables by name."""

    goals: Sequence[Goal]
    tables: Mapping[str, Table]

    def json_object(self, benchmark: str, quick: bool) -> dict[str, Any]:
        """Return what ``--json`` prints; numbers that are not finite become null."""
        goals = [goal._asdict() for goal in self.goals]
        figures = {name: _plain(table.rows) for name, table in self.tables.items()}
        return {"benchmark": benchmark, "quick": quick, "goals": goals, "figures": figures}


def _plain(value: Any) -> Any:
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(frozen=True)
class Benchmark:
    """The arguments of a benchmark; seeds are fixed, and nothing is printed."""

    #: From arguments: `cases`, `contacts` a number with `numbers`
    run: Callable[[argparse.Namespace], Report]
    epilog: str  #: of its help
    cases: Mapping[str, Any] = field(default_factory=dict)  #: all of them by name
    quick: Sequence[str] = ()  #: names of those of a quick run
    contacts: tuple[int, int] = (0, 0)  #: usual number, and that of a quick run
    data: bool = False  #: takes a folder of measured tests
    more: Callable[[argparse.ArgumentParser], None] | None = None  #: adds arguments of its own

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the benchmark's arguments."""
        parser.epilog = self.epilog
        add = parser.add_argument
        if self.data:
            words = f"folder with the measured tests (default: the variable {DATA_VARIABLE})"
            default = os.environ.get(DATA_VARIABLE)
            add("data", nargs="?", type=Path, metavar="DIR", default=default, help=words)
        if self.cases:
            add("--cases", metavar="A,B", help="names of the cases")
        if self.contacts[0]:
            words = f"how many of each case (default: {self.contacts[0]})"
            add("--contacts", type=int, metavar="N", help=words)
            words = "number of the first of them, which is its seed (default: 0)"
            add("--first", type=int, default=0, metavar="N", help=words)
        if self.more is not None:
            self.more(parser)

    def resolve(self, args: argparse.Namespace) -> None:
        """Replace the names in the arguments by their objects, or say what is wrong with them."""
        if self.data and (args.data is None or not args.data.is_dir()):
            given = "no data" if args.data is None else f"{args.data}: no such folder"
            raise InputError(f"{given}; name the one with the tables, or set {DATA_VARIABLE}")
        if self.cases:
            usual = self.quick if args.quick and self.quick else list(self.cases)
            names = usual if args.cases is None else args.cases.split(",")
            if unknown := [name for name in names if name not in self.cases]:
                there = ", ".join(self.cases)
                raise InputError(f"there is no case {unknown[0]!r}; there are {there}")
            args.cases = [self.cases[name] for name in names]
        if self.contacts[0]:
            if args.contacts is None:
                args.contacts = self.contacts[1 if args.quick else 0]
            if args.contacts < 1 or args.first < 0:
                raise InputError("--contacts must be at least 1, --first not negative")
            args.numbers = range(args.first, args.first + args.contacts)


def measured(
    function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]], what: str = "contacts"
) -> list[Result]:
    """Return the results of a function of a module for the arguments of all tasks, in their order.

    They come from a pool of processes; `what` is the label of the progress bar.
    """
    arguments = list(zip(*tasks, strict=True))
    results: list[Result] = []
    with contextlib.ExitStack() as stack:
        found: Iterator[Result] = map(function, *arguments)
        if PROCESSES > 1:
            spawn = multiprocessing.get_context("spawn")
            pool = stack.enter_context(ProcessPoolExecutor(PROCESSES, spawn))
            found = pool.map(function, *arguments)
        show = stack.enter_context(progress(what, len(tasks)))
        for result in found:
            results.append(result)
            show(len(results))
    return results


def by_case(
    function: Callable[..., Result], tasks: Sequence[tuple[Any, ...]], what: str = "contacts"
) -> dict[Any, list[Result]]:
    """Return the same by the first argument of each task, which names its case."""
    found: dict[Any, list[Result]] = {}
    for task, result in zip(tasks, measured(function, tasks, what), strict=True):
        found.setdefault(task[0], []).append(result)
    return found


# The command


def main(args: argparse.Namespace) -> int:
    """Measure, print and write; return the exit code."""
    benchmark: Benchmark = importlib.import_module(f"benchmark.{args.benchmark}").BENCHMARK
    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        words = f"{args.output}: {error.strerror}; name a folder for the results with -o"
        raise InputError(words) from error
    benchmark.resolve(args)
    report = benchmark.run(args)
    result = report.json_object(args.benchmark, args.quick)
    figures = args.output / f"{args.benchmark}.json"
    figures.write_text(json.dumps(result, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if args.json:
        json.dump(result, sys.stdout, allow_nan=False)
        print()
        return 0
    console = Console()
    if not console.is_terminal:
        console.width = _WIDTH
    answers = {True: "met", False: "missed", None: "undecided"}
    goals = {
        name: {"measured": value, "goal": goal, "": answers[met]}
        for name, value, goal, met in report.goals
    }
    for table in (*report.tables.values(), Table("Goals", goals)):
        console.print(_printed(table))
    console.print(f"wrote {figures}")
    return 0


def _printed(table: Table) -> Printed:
    printed = Printed(title=table.title, box=MARKDOWN)
    printed.add_column("", no_wrap=True)
    columns = dict.fromkeys(column for row in table.rows.values() for column in row)
    for column in columns:
        printed.add_column(escape(column), justify="right", no_wrap=True)
    for name, row in table.rows.items():
        printed.add_row(escape(name), *(escape(words_of(row.get(c, ""))) for c in columns))
    return printed


def words_of(value: Any) -> str:
    """Return a cell of a table: three digits of a number, – where nothing was measured."""
    if isinstance(value, Share):
        return f"{value.part} of {value.whole}"
    value = _plain(value)
    if isinstance(value, list):
        return " ".join(map(words_of, value))
    if value is None:
        return "–"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
