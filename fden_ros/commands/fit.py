# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden fit``: the paper's experiments on a CSV file of your own."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from fden_ros.commands.command import print_json
from fden_ros.experiments.kinds import EXPERIMENTS, Options, fit_file
from fden_ros.written import written

if TYPE_CHECKING:
    from rich.table import Table

    from fden_ros.experiments.result import Fit, Parameter

_ROWS = "\n".join(
    f"  {'' if index else name:14}{columns:50}{gives}"
    for name, experiment in EXPERIMENTS.items()
    for index, (columns, gives) in enumerate(experiment.files)
)

DESCRIPTION = f"""\
Identify alpha, G and Gn from one of the paper's experiments. FILE is a table
with a line of column names, or of headings with units such as "Time (s)":

  {"KIND":14}{"columns":50}gives
{_ROWS}

The command prints a table with standard deviations and 95 % intervals, or one
object with --json.
"""

EPILOG = """\
examples:
  fden fit dynamic sweep.csv
  fden fit creep creep.csv --stress 50
  fden fit relaxation relaxation.csv --strain 0.1
  fden fit nonlinearity coefficients.csv --alpha 0.131 --alpha-sd 0.011
  fden fit nonlinearity creep_tests/ --json | jq '.g, .g_sd'
"""

_UNITS = {
    "alpha": ("α", ""),
    "g": ("G", "Pa s^α"),
    "g_n": ("Gn", ""),
    "g_i": ("Gi", "Pa s^α"),
    "x_b": ("xb", ""),
    "x_c": ("xc", "s^-α"),
    "f_c": ("fc", "Pa s^α"),
}


def run(args: argparse.Namespace) -> int:
    """Fit and print; return the exit code."""
    options = _options(args)
    fit = fit_file(args.kind, args.file, options)
    if args.json:
        return print_json({"file": str(args.file), **fit.as_object()})
    _print(fit, args.file)
    return 0


def _options(args: argparse.Namespace) -> Options:
    for option in sorted({name for one in EXPERIMENTS.values() for name in one.options}):
        kinds = [kind for kind, one in EXPERIMENTS.items() if option in one.options]
        given = getattr(args, {"from": "start"}.get(option, option.replace("-", "_")))
        if given is not None and args.kind not in kinds:
            args.parser.error(f"--{option} is for {' and '.join(kinds)}, not for {args.kind}")
    if args.alpha_sd is not None and args.alpha is None:
        args.parser.error("--alpha-sd needs --alpha")
    return Options(
        stress=args.stress,
        strain=args.strain,
        start=args.start,
        alpha=args.alpha,
        alpha_sd=args.alpha_sd or 0.0,
    )


def _print(fit: Fit, path: Path) -> None:
    from rich.console import Console

    console = Console()
    quality = f"R² {fit.r_squared:.4f}" if math.isfinite(fit.r_squared) else "R² undefined"
    title = f"{fit.kind}: {path.name}, {fit.samples} rows, {quality}"
    console.print(_table(title, fit.parameters))
    for warning in fit.warnings:
        console.print(f"[yellow]warning:[/yellow] {warning}", soft_wrap=True)


def _table(title: str, parameters: Mapping[str, Parameter]) -> Table:
    from fden_ros.report.table import table_of

    columns = {"": 1, "value": 0, "sd": 0, "95 %": 0, "unit": 1}
    return table_of(columns, (_cells(name, p) for name, p in parameters.items()), title)


def _cells(name: str, p: Parameter) -> tuple[str, ...]:
    symbol, unit = _UNITS.get(name, (name, ""))
    ends = f"{written(p.low, 5)} to {written(p.high, 5)}"
    interval = ends if math.isfinite(p.low + p.high) else "–"
    sd = written(p.sd, 2) if math.isfinite(p.sd) else "–"
    return symbol, written(p.value, 5), sd, interval, unit
