# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What all benchmarks share: arguments, trials in a pool of processes, goals, and what comes out.

``--json`` and NAME.json hold::

    {"benchmark": "robots", "quick": false,
     "goals": [{"name": ..., "value": ..., "goal": ..., "met": true}, ...],
     "figures": {TABLE: {ROW: {COLUMN: VALUE, ...}, ...}, ...}}
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from benchmark.score import Share
from fden_ros.errors import InputError
from fden_ros.parameters import read_parameter_file
from fden_ros.progress import progress

Result = TypeVar("Result")
Thing = TypeVar("Thing")

#: Names the folder with measured tests where none is given.
DATA_VARIABLE = "FDEN_DATA"
#: Where no other number is asked for.
PROCESSES = 2
#: Columns of a table that goes into a file.
_WIDTH = 200
_INFINITY = math.inf


@dataclass(frozen=True)
class Goal:
    """One figure and what it ought to be; `met` is None where this run cannot decide."""

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

    A value that is not finite has not been measured: undecided. Where a confidence interval is
    given, it decides: inside the limits the goal is met, beyond them missed, across one undecided.
    """
    low, high = limits
    words = f"{low:g} to {high:g}"
    if math.isinf(low) or math.isinf(high):
        words = f"<= {high:g}" if math.isinf(low) else f">= {low:g}"
    if not math.isfinite(value):
        return Goal(name, None, words, None)
    least, largest = (value, value) if interval is None else interval
    met: bool | None = None
    if low <= least and largest <= high:
        met = True
    elif largest < low or least > high:
        met = False
    return Goal(name, float(value), words, met)


def at_most(
    name: str, value: float, limit: float, interval: tuple[float, float] | None = None
) -> Goal:
    """Return the goal that a figure is at most so large."""
    return within(name, value, (-_INFINITY, limit), interval)


def at_least(name: str, value: float, limit: float) -> Goal:
    """Return the goal that a figure is at least so large."""
    return within(name, value, (limit, _INFINITY))


def few(name: str, share: Share, limit: float) -> Goal:
    """Return the goal that a share is at most so large, decided by its 95 % interval."""
    return at_most(name, share.value, limit, share.interval() if share.whole else None)


def worst(name: str, values: Iterable[float], limit: float) -> Goal:
    """Return the goal that the largest of the values that were measured is at most so large."""
    return at_most(name, max((v for v in values if math.isfinite(v)), default=math.nan), limit)


def undecided(goals: Iterable[Goal]) -> list[Goal]:
    """Return goals of a run that is too short to tell."""
    return [Goal(goal.name, goal.value, goal.goal, None) for goal in goals]


@dataclass(frozen=True)
class Table:
    """Rows of figures.

    Parameters
    ----------
    title : str
    rows : mapping
        Name of a row to its cells by column: words, numbers, :class:`Share`, or sequences.
    hidden : sequence of str
        Columns for JSON alone.
    """

    title: str
    rows: Mapping[str, Mapping[str, Any]]
    hidden: Sequence[str] = ()


@dataclass(frozen=True)
class Report:
    """What a benchmark has found: goals, and tables by name."""

    goals: Sequence[Goal]
    tables: Mapping[str, Table]

    def json_object(self, benchmark: str, quick: bool) -> dict[str, Any]:
        """Return what ``--json`` prints; numbers that are not finite become null."""
        whole = {
            "benchmark": benchmark,
            "quick": quick,
            "goals": [asdict(goal) for goal in self.goals],
            "figures": {name: table.rows for name, table in self.tables.items()},
        }
        plain: dict[str, Any] = _plain(whole)
        return plain


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@dataclass(frozen=True)
class Benchmark:
    """How a benchmark is called.

    Parameters
    ----------
    run : callable
        From its arguments to the :class:`Report`. `args.cases` are cases, `args.parameters` a
        mapping, `args.contacts` a number; seeds are fixed; nothing is printed.
    epilog : str
        Of its help.
    cases, quick : mapping, sequence of str
        All cases by name, and the names of a quick run; empty: there are none to choose.
    contacts : tuple of int
        Usual number, and that of a quick run; 0: not to be chosen.
    parameters, data : bool
        Takes a parameter file; takes a folder of measured tests.
    more : callable, optional
        Adds arguments of its own to a parser.
    """

    run: Callable[[argparse.Namespace], Report]
    epilog: str
    cases: Mapping[str, Any] = field(default_factory=dict)
    quick: Sequence[str] = ()
    contacts: tuple[int, int] = (0, 0)
    parameters: bool = False
    data: bool = False
    more: Callable[[argparse.ArgumentParser], None] | None = None

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the benchmark's arguments."""
        parser.epilog = self.epilog
        if self.data:
            words = f"folder with the measured tests (default: the variable {DATA_VARIABLE})"
            default = os.environ.get(DATA_VARIABLE)
            parser.add_argument(
                "data", nargs="?", type=Path, metavar="DIR", default=default, help=words
            )
        if self.cases:
            parser.add_argument("--cases", metavar="A,B", help="names of the cases")
        if self.contacts[0]:
            words = f"how many of each case (default: {self.contacts[0]})"
            parser.add_argument("--contacts", type=int, metavar="N", help=words)
            words = "number of the first of them, which is its seed (default: 0)"
            parser.add_argument("--first", type=int, default=0, metavar="N", help=words)
            parser.add_argument(
                "--jobs", type=int, default=PROCESSES, metavar="N", help="processes"
            )
        if self.parameters:
            words = "parameters of the identifier; geometry, messages and prior are its own"
            parser.add_argument("--parameters", type=Path, metavar="FILE", help=words)
        if self.more is not None:
            self.more(parser)

    def resolve(self, args: argparse.Namespace) -> None:
        """Put what the arguments name in their place.

        Raises
        ------
        InputError
            If there is no such case, or a number is out of range.
        """
        if self.cases:
            usual = self.quick if args.quick and self.quick else self.cases
            args.cases = chosen(args.cases, self.cases, "case", usual)
        if self.contacts[0]:
            if args.contacts is None:
                args.contacts = self.contacts[1 if args.quick else 0]
            if args.contacts < 1 or args.jobs < 1 or args.first < 0:
                raise InputError("--contacts and --jobs must be at least 1, --first not negative")
            args.numbers = range(args.first, args.first + args.contacts)
        if self.parameters:
            file = args.parameters
            args.parameters = dict(read_parameter_file(file).as_dict()) if file else {}


def chosen(
    names: str | None, known: Mapping[str, Thing], kind: str, default: Iterable[str]
) -> list[Thing]:
    """Return what has these names, separated by commas, in their order.

    Raises
    ------
    InputError
        If there is none of a name, or none is named.
    """
    wanted = list(default) if names is None else [name for name in names.split(",") if name]
    for name in wanted:
        if name not in known:
            raise InputError(f"there is no {kind} {name!r}; there are {', '.join(known)}")
    if not wanted:
        raise InputError(f"no {kind} is named; there are {', '.join(known)}")
    return [known[name] for name in wanted]


def measured(
    function: Callable[..., Result],
    tasks: Sequence[tuple[Any, ...]],
    *shared: object,
    jobs: int | None = None,
    what: str = "contacts",
) -> list[Result]:
    """Return what a function makes of all tasks, in their order.

    Parameters
    ----------
    function : callable
        Of a module, so that a process can be sent its name.
    tasks : sequence of tuple
        The first arguments of each call.
    *shared
        The last arguments, the same for all.
    jobs : int, optional
        Processes, by default :data:`PROCESSES`; 1: this one.
    what : str
        Beside the bar of progress.
    """
    results: dict[int, Result] = {}
    jobs = jobs or PROCESSES
    with progress(what, len(tasks)) as show:
        if jobs == 1:
            for index, task in enumerate(tasks):
                results[index] = function(*task, *shared)
                show(len(results))
        else:
            pool = ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"))
            try:
                futures = {pool.submit(function, *t, *shared): i for i, t in enumerate(tasks)}
                for future in as_completed(futures):
                    results[futures[future]] = future.result()
                    show(len(results))
            finally:
                pool.shutdown(cancel_futures=True)
    return [results[index] for index in range(len(tasks))]


def by_case(
    function: Callable[..., Result],
    tasks: Sequence[tuple[Any, ...]],
    *shared: object,
    jobs: int | None = None,
    what: str = "contacts",
) -> dict[Any, list[Result]]:
    """Return the same by the first argument of each task, which names its case."""
    found: dict[Any, list[Result]] = {}
    results = measured(function, tasks, *shared, jobs=jobs, what=what)
    for task, result in zip(tasks, results, strict=True):
        found.setdefault(task[0], []).append(result)
    return found


# The command


def main(args: argparse.Namespace) -> int:
    """Measure, print and write; return the exit code."""
    from rich.console import Console

    benchmark: Benchmark = importlib.import_module(f"benchmark.{args.benchmark}").BENCHMARK
    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{args.output}: {error.strerror}; name a folder for the results with -o"
        ) from error
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
    for table in report.tables.values():
        console.print(_printed(table))
    rows = {
        goal.name: {"measured": goal.value, "goal": goal.goal, "": _ANSWERS[goal.met]}
        for goal in report.goals
    }
    console.print(_printed(Table("Goals", rows)))
    console.print(f"wrote {figures}")
    return 0


_ANSWERS = {True: "met", False: "missed", None: "undecided"}


def _printed(table: Table) -> Any:
    from rich.box import MARKDOWN
    from rich.markup import escape
    from rich.table import Table as Printed

    printed = Printed(title=table.title, box=MARKDOWN)
    printed.add_column("", no_wrap=True)
    every = dict.fromkeys(column for row in table.rows.values() for column in row)
    columns = [column for column in every if column not in table.hidden]
    for column in columns:
        printed.add_column(escape(column), justify="right", no_wrap=True)
    for name, row in table.rows.items():
        printed.add_row(escape(name), *(escape(words_of(row.get(c, ""))) for c in columns))
    return printed


def words_of(value: Any) -> str:
    """Return a cell of a table: three digits of a number, – where nothing was measured."""
    if isinstance(value, Share):
        return f"{value.part} of {value.whole}"
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return " ".join(words_of(item) for item in value)
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
