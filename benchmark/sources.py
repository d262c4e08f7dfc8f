# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Make the tables of docs/accuracy.md from clones of the repositories that it names.

scripts/ros_env python -m benchmark.sources CLONES -o recordings/   (a folder with the clones)
"""

from __future__ import annotations

import argparse
import csv
import importlib
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.public import COLUMNS as PRESS_COLUMNS
from benchmark.real import COLUMNS as HOLD_COLUMNS
from fden_ros.recording.reader import BagReader, decode

Row = Sequence[object]
Tables = dict[str, Iterable[Row]]

#: Of the phantoms, as their authors state it [kPa].
MODULI = {
    "EF10": {"0T": 56.27, "12_5T": 38.06, "25T": 28.16, "37_5T": 20.14, "50T": 16.29,
             "62_5T": 12.94, "75T": 9.58, "87_5T": 8.68, "100T": 6.19},
    "EF30": {"0T": 103.46, "12_5T": 72.58, "25T": 50.21, "37_5T": 37.16, "50T": 31.85},
    "EF50": {"0T": 158.80, "12_5T": 111.86, "25T": 86.80, "37_5T": 72.76, "50T": 59.25},
}  # fmt: skip
#: Which of ten compressions and of five presses are taken.
_COMPRESSIONS, _PRESSES = ("A1", "A2", "A3", "A5", "B1"), (1, 3, 5)
_PRESS, _DAYS = ("test", *PRESS_COLUMNS), ("230331", "230403")


def phantoms(clone: Path) -> Tables:
    """Return the compressions of silicones, and their moduli."""
    rows: list[Row] = [_PRESS]
    truths: list[Row] = [("test", "phantom", "area_m2", "thickness_m", "modulus_Pa")]
    for family, moduli in MODULI.items():
        for thinner, modulus in moduli.items():
            phantom = f"{family}_{thinner}"
            for number in _COMPRESSIONS:
                test = f"{phantom}_{number}"
                lines = (clone / "data" / phantom / f"{test}.csv").read_text().splitlines()
                numbers = [line.split(",")[:3] for line in lines if re.match(r"[\d.]+,", line)]
                rows += [(test, time, force, depth) for time, depth, force in numbers]
                truths.append((test, phantom, np.pi * 0.025**2, 0.03, 1e3 * modulus))
    return {"phantoms.csv": rows, "phantoms_truth.csv": truths}


def presses(clone: Path) -> Tables:
    """Return the presses of an arm, and the mean slope of their first 0.2 mm of unloading."""
    rows: list[Row] = [_PRESS]
    slopes = []
    for number in _PRESSES:
        bag = BagReader(clone / "matlab" / "test_const_vel" / f"test_soft_{number}")
        table = np.array([decode(m).data[:6] for m in bag.messages(["/data_control"])])
        times, depths, forces = table[:, 0] - table[0, 0], table[:, 1] - table[:, 3], -table[:, 5]
        deepest = int(np.argmax(depths))
        touch = int(np.flatnonzero(depths[:deepest] <= 0.0)[-1]) + 1
        left = deepest + int(np.argmax(depths[deepest:] <= 0.0))
        kept = slice(touch, left if left > deepest else None)
        shown = zip(times[kept], forces[kept], 1e3 * depths[kept], strict=True)
        rows += [(f"press_{number}", *map(float, row)) for row in shown]
        wanted = table[:, 1] - table[:, 2]
        turn = int(np.flatnonzero(wanted == wanted.max())[-1])
        way = np.where(np.arange(depths.size) > turn, depths[turn] - depths, 0.0)
        unloading = (way > 2e-5) & (way < 2.2e-4)
        slopes.append(np.polyfit(depths[unloading], forces[unloading], 1)[0])
    known = ("silicone", np.pi * 0.005**2, 0.03, float(np.mean(slopes)))
    heading = ("test", "phantom", "area_m2", "thickness_m", "stiffness_N_per_m")
    truths = [heading, *((f"press_{number}", *known) for number in _PRESSES)]
    return {"presses.csv": rows, "presses_truth.csv": truths}


def beef(clone: Path) -> Tables:
    """Return the ramps and holds on beef; needs openpyxl."""
    load = importlib.import_module("openpyxl").load_workbook
    return {f"beef_{day}.csv": _beef(clone, day, load) for day in _DAYS}


def _beef(clone: Path, day: str, load: Callable[..., Any]) -> Iterator[Row]:
    yield HOLD_COLUMNS
    name = f"{day}_C_Indentation_relaxation_500N_force.xlsx"
    book = load(clone / "indentation/experiments/zwick/raw_data" / day / name, read_only=True)
    for sheet in book.sheetnames[3:]:  # after parameters, results and statistics
        for row in book[sheet].iter_rows(min_row=4, max_col=4, values_only=True):
            if None not in row:
                yield (f"{day}/{sheet}", f"beef_{sheet[:2]}", *row)


#: By the name of the clone's folder.
SOURCES = {
    "tissue-phantom-material-database": phantoms,
    "Ur3e-experimental-setup": presses,
    "perineal_indentation": beef,
}


def main() -> None:
    """Write the tables of the clones that are there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clones", type=Path, metavar="CLONES")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    for name, read in SOURCES.items():
        if not (args.clones / name).is_dir():
            print(f"{args.clones} has no folder {name}", file=sys.stderr)
            continue
        for table, rows in read(args.clones / name).items():
            with open(args.output / table, "w", newline="", encoding="utf-8") as file:
                csv.writer(file).writerows(rows)
            print(args.output / table)


if __name__ == "__main__":
    main()
