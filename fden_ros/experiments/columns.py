# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""CSV files of experiments: named columns in, or one line that says what is wrong."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.recording.table import cells_of, delimiter_of, is_number, lines_of

#: The columns that experiments read, and their units.
UNITS = {
    "time_s": "s",
    "strain": "a ratio",
    "strain_coefficient": "a ratio",
    "stress_pa": "Pa",
    "omega_rad_s": "rad/s",
    "storage_modulus_pa": "Pa",
    "loss_modulus_pa": "Pa",
}

#: A held quantity may vary by this part of its mean.
CONSTANT = 0.02


@dataclass(frozen=True)
class Table:
    """A file of named columns, its cells still text.

    Parameters
    ----------
    path : Path
    names : tuple of str
    rows : tuple of tuple of str
    lines : tuple of int
        Line of each row in the file, counted from 1.
    """

    path: Path
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def column(self, name: str) -> Array:
        """Return a column as numbers, shape (n,).

        Raises
        ------
        InputError
            If it is missing, or holds text, nothing, or a number that is not finite.
        """
        if name not in self.names:
            raise InputError(self._missing(name))
        index = self.names.index(name)
        values = []
        for line, row in zip(self.lines, self.rows, strict=True):
            cell = row[index] if index < len(row) else ""
            try:
                value = float(cell)
            except ValueError:
                problem = f"{cell!r} is not a number" if cell else "is empty"
                raise InputError(f"{self.path}, line {line}: {name} {problem}") from None
            if not math.isfinite(value):
                raise InputError(
                    f"{self.path}, line {line}: {name} is {cell}; leave the row out or mend it"
                )
            values.append(value)
        return np.array(values)

    def positive(self, name: str) -> Array:
        """Return a column whose values must all be positive."""
        return self.require_positive(name, self.column(name))

    def require_positive(
        self, name: str, values: Array, why: str = "its logarithm is taken"
    ) -> Array:
        """Return `values`, a row each, or say which row is not positive."""
        for line, value in zip(self.lines, values, strict=True):
            if not value > 0.0:
                raise InputError(
                    f"{self.path}, line {line}: {name} is {value:g}; it must be positive, "
                    f"because {why}"
                )
        return values

    def require_rows(self, count: int, user: str) -> None:
        """Raise unless there are `count` rows."""
        if len(self.rows) < count:
            have = len(self.rows)
            raise InputError(
                f"{self.path} has {have} row{'s' if have != 1 else ''}; {user} needs at least "
                f"{count}"
            )

    def times(self) -> Array:
        """Return time_s, strictly increasing."""
        times = self.column("time_s")
        for index in range(1, times.size):
            if not times[index] > times[index - 1]:
                raise InputError(
                    f"{self.path}, line {self.lines[index]}: time_s {times[index]:g} does not "
                    f"come after {times[index - 1]:g}; sort the rows by time, each time once"
                )
        return times

    def checked_strain(self, values: Array) -> Array:
        """Return `values`, or raise if they can only be percent."""
        largest = float(np.max(np.abs(values), initial=0.0))
        if largest > 3.0:
            raise InputError(
                f"{self.path}: strain goes up to {largest:g}; it must be a ratio, not percent "
                "(0.1 for 10 %)"
            )
        return values

    def held(self, name: str, values: Array) -> float:
        """Return the mean of `values`, or raise if they change."""
        mean = float(values.mean())
        if np.ptp(values) > CONSTANT * abs(mean):
            raise InputError(
                f"{self.path}: {name} goes from {values.min():g} to {values.max():g}; a creep "
                "test has one stress: one file each"
            )
        return mean

    def since(self, time: Array, start: float | None) -> tuple[NDArray[np.bool_], Table]:
        """Return which rows are not before `start` [s], and the table of these."""
        kept = np.ones(time.size, dtype=bool) if start is None else time >= start
        if not kept.any():
            raise InputError(
                f"{self.path} ends at {time.max():g} s, before the first row to use at "
                f"{start:g} s; give --from S"
            )
        rows = tuple(itertools.compress(self.rows, kept))
        lines = tuple(itertools.compress(self.lines, kept))
        return kept, replace(self, rows=rows, lines=lines)

    def _missing(self, name: str) -> str:
        words = ("omega", "freq", "f") if name == "omega_rad_s" else (name.split("_")[0],)
        others = [n for n in self.names if n not in UNITS]
        alike = [n for n in others if n.lower().split("_")[0].split(" ")[0].startswith(words)]
        if alike:
            return (
                f"{self.path}: column {name} is missing; convert {alike[0]!r} to {UNITS[name]} "
                f"and name it {name}"
            )
        return f"{self.path}: column {name} is missing; found: {', '.join(self.names)}"


def read_table(path: str | Path) -> Table:
    """Read a CSV file with a line of names; comma, semicolon or tab, ``#`` begins a comment.

    Raises
    ------
    InputError
        If the file cannot be read, is empty, or has names only.
    """
    path = Path(path)
    kept = list(lines_of(path))
    if not kept:
        raise InputError(f"{path} is empty; give a line of column names and then numbers")
    rows = cells_of([line for _, line in kept], delimiter_of(kept[0][1]))
    cells = [tuple(cell.strip() for cell in row) for row in rows]
    names = cells[0]
    if all(is_number(cell) for cell in names):
        raise InputError(f"{path}: line {kept[0][0]} holds numbers; it must hold the column names")
    doubled = next((name for name in names if name and names.count(name) > 1), None)
    if doubled is not None:
        raise InputError(f"{path}: there are two columns {doubled}; keep one")
    if len(cells) == 1:
        raise InputError(f"{path} has names but no rows of numbers")
    return Table(path, names, tuple(cells[1:]), tuple(number for number, _ in kept[1:]))


def csv_files(folder: str | Path) -> list[Path]:
    """Return the CSV files of a folder, by name."""
    paths = sorted(p for p in Path(folder).iterdir() if p.suffix.lower() in (".csv", ".tsv"))
    if not paths:
        raise InputError(f"{folder} holds no .csv file")
    return paths
