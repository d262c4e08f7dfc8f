# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden relative``: every site against those around it, from a table of results."""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fden_ros.commands.command import Command, add_json, positive, print_json, write
from fden_ros.commands.inputs import add_config_options, parameters_of
from fden_ros.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DESCRIPTION = """\
Find what is stiffer than its surroundings, without a library: each site of a table of results (CSV
or Parquet, from fden batch or fden report --csv) is compared with all others, or with those near
it. Stiffness is the apparent modulus at a stated strain and time scale. Prints a table with how
many times stiffer each site is, its 95 % interval and P(stiffer by the ratio).
"""

EPILOG = """\
examples:
  fden relative results.parquet --distance 0.025
  fden relative palpation.csv --ratio 1.5 --strain 0.1 --time-scale 0.1 --map map.png
  fden relative palpation.csv --json | jq '.sites[] | select(.probability > 0.9)'

The last converged contact of each site counts. Columns: site, g, g_sd, g_n, g_n_sd, alpha,
alpha_sd, and x, y, z [m] for --distance and --map. Of estimates with a column alpha_source the
estimator's prior is taken out: give the --config that they were made with. Exit codes: 0 done, 1
the input cannot be used, 2 wrong usage.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    parser.add_argument("results", type=Path, metavar="RESULTS", help="CSV or Parquet")
    add_config_options(parser)
    parser.add_argument("--ratio", type=positive, default=1.5, metavar="R", help="default: 1.5")
    parser.add_argument(
        "--strain", type=positive, default=0.1, metavar="X", help="of the comparison (0.1)"
    )
    parser.add_argument(
        "--time-scale", type=positive, default=0.1, metavar="S", help="of the comparison (0.1 s)"
    )
    parser.add_argument(
        "--distance", type=positive, default=0.0, metavar="M", help="of surroundings (all)"
    )
    parser.add_argument("--map", type=Path, metavar="FILE", help="draw a map (.png, .svg, .pdf)")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write the table")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Compare and print; return the exit code."""
    from fden_ros.core.classification.relative import RelativeConfig
    from fden_ros.offline.relative_map import compare_sites

    parameters = parameters_of(args)
    config = RelativeConfig(args.ratio, args.strain, args.time_scale, args.distance)
    rows = compare_sites(args.results, parameters, config)
    if args.map is not None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7, 6), layout="constrained")
        _draw(figure, rows, config)
        write(args.map, lambda path: figure.savefig(path, dpi=130))
    if args.csv is not None:
        write(args.csv, lambda path: _write_csv(path, rows))
    if args.json:
        return print_json({"sites": rows})
    _print(rows, args.ratio)
    return 0


def _write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _print(rows: list[dict[str, Any]], ratio: float) -> None:
    from rich.console import Console

    from fden_ros.report.table import table_of

    columns = ("site", "times stiffer", "95 %", f"P(> {ratio:g})", "deviations", "")
    ordered = sorted(rows, key=lambda row: -(row["ratio"] or 0.0))
    title = "Sites against their surroundings"
    Console().print(table_of(dict.fromkeys(columns, 0), map(_cells, ordered), title))


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    if row["ratio"] is None:
        return str(row["site"]), "–", "–", "–", "–", "too few around"
    return (
        str(row["site"]),
        f"{row['ratio']:.2f}",
        f"{row['ratio_low']:.2f} to {row['ratio_high']:.2f}",
        f"{row['probability']:.3f}",
        f"{row['deviations']:.1f}",
        row["label"],
    )


def _draw(figure: Figure, rows: list[dict[str, Any]], config: Any) -> None:
    import numpy as np

    used = [row for row in rows if row["x"] is not None and row["ratio"] is not None]
    if not used:
        raise InputError("no map: the results hold no positions (x, y, z) of compared sites")
    positions = np.array([[row["x"], row["y"], row["z"] or 0.0] for row in used])
    # Seen along the direction in which the sites spread least: that of the approach.
    _, _, axes_of = np.linalg.svd(positions - positions.mean(axis=0), full_matrices=False)
    flat = int(np.argmax(np.abs(axes_of[-1])))
    shown = [index for index in range(3) if index != flat]
    ratio = np.array([row["ratio"] for row in used])
    axes = figure.add_subplot()
    points = axes.scatter(
        1e3 * positions[:, shown[0]],
        1e3 * positions[:, shown[1]],
        c=np.log2(ratio),
        cmap="RdBu_r",
        vmin=-2.0,
        vmax=2.0,
        s=90.0,
        edgecolors=["k" if row["probability"] > 0.5 else "0.8" for row in used],
    )
    bar = figure.colorbar(points, ax=axes, ticks=(-2, -1, 0, 1, 2), label="times stiffer")
    bar.ax.set_yticklabels(["¼", "½", "1", "2", "4"])
    axes.set_aspect("equal")
    axes.set_xlabel(f"{'xyz'[shown[0]]} [mm]")
    axes.set_ylabel(f"{'xyz'[shown[1]]} [mm]")
    axes.set_title(
        f"At a strain of {config.strain:g} within {config.time_scale:g} s; "
        f"black edge: P(> {config.ratio:g} times) > ½",
        fontsize=10,
    )


COMMAND = Command(
    "relative",
    "find sites that are stiffer than their surroundings",
    DESCRIPTION,
    EPILOG,
    add_arguments,
    run,
)
