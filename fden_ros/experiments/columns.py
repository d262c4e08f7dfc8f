# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""CSV files of experiments: named columns in, or one line that says what is wrong."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.recording.headings import Heading, candidates
from fden_ros.recording.text import Layout, is_number, layout_of, looks_like_a_table

#: The columns that experiments read, and their units.
UNITS = {
    "time_s": "s",
    "strain": "a ratio",
    "strain_coefficient": "a ratio",
    "stress_pa": "Pa",
    "relaxation_modulus_pa": "Pa",
    "omega_rad_s": "rad/s",
    "storage_modulus_pa": "Pa",
    "loss_modulus_pa": "Pa",
}

#: What each is in the words of an instrument's headings.
_QUANTITIES = {
    "time_s": "time",
    "strain": "strain",
    "stress_pa": "stress",
    "relaxation_modulus_pa": "modulus",
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
    layout : Layout
        How it is written.
    """

    path: Path
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    layout: Layout

    def __contains__(self, name: str) -> bool:
        return bool(self._places(name))

    def _places(self, name: str) -> list[tuple[int, float]]:
        """Return the columns that can be `name`, with their factors to its unit.

        It is the column of this name, or one whose heading has the quantity and its unit. A table
        that states no unit at all is in SI units, see :meth:`notes`.
        """
        if name in self.names:
            return [(self.names.index(name), 1.0)]
        quantity = _QUANTITIES.get(name)
        if quantity is None:
            return []
        units = (*self.layout.units, *[""] * len(self.names))
        headings = [Heading(*one) for one in zip(self.names, units, strict=False)]
        if not any(heading.has_unit for heading in headings):
            named = (i for i, heading in enumerate(headings) if heading.names(quantity))
            return [(index, 1.0) for index in named]
        of_unit = "stress" if quantity == "modulus" else quantity
        every = candidates(headings, quantity, unit=of_unit)
        found = [(index, factor) for index, factor in every if factor is not None]
        if found or quantity != "strain":
            return found
        bare = (i for i, one in enumerate(headings) if one.names(quantity) and not one.has_unit)
        return [(index, 1.0) for index in bare]

    def notes(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return a line on each of the columns `names` whose unit was not stated."""
        lines = []
        for name in names:
            if name == "strain" or name in self.names or name not in self:
                continue
            index, factor = self._places(name)[0]
            heading = Heading(self.names[index], *self.layout.units[index : index + 1])
            if factor == 1.0 and not heading.has_unit:
                lines.append(f"{heading.text} states no unit: it is taken to be in {UNITS[name]}")
        return tuple(lines)

    def column(self, name: str) -> Array:
        """Return a column as numbers, shape (n,).

        Raises
        ------
        InputError
            If it is missing, or holds text, nothing, or a number that is not finite.
        """
        places = self._places(name)
        if not places:
            raise InputError(self._missing(name))
        if len(places) > 1:
            several = ", ".join(repr(self.names[index]) for index, _ in places)
            raise InputError(
                f"{self.path}: several columns could be {name}: {several}; convert one to "
                f"{UNITS[name]} and name it {name}"
            )
        ((index, factor),) = places
        values = []
        for line, row in zip(self.lines, self.rows, strict=True):
            cell = row[index] if index < len(row) else ""
            try:
                value = factor * self.layout.number(cell)
            except ValueError:
                value = math.nan
            if math.isnan(value):
                problem = f"{cell!r} is not a number" if cell else "is empty"
                raise InputError(f"{self.path}, line {line}: {name} {problem}") from None
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

    def held(self, name: str, values: Array, test: str = "a creep test has one stress") -> float:
        """Return the mean of `values`, or raise if they change."""
        mean = float(values.mean())
        if np.ptp(values) > CONSTANT * abs(mean):
            raise InputError(
                f"{self.path}: {name} goes from {values.min():g} to {values.max():g}; {test}: "
                "one file each"
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
    """Read a table with a line of names, as :mod:`fden_ros.recording.text` finds it written.

    Raises
    ------
    InputError
        If the file cannot be read, is empty, or has names only.
    """
    path = Path(path)
    layout = layout_of(path)
    names = layout.headings
    if not names or all(map(is_number, names)):
        line = layout.lines[0][0]
        raise InputError(f"{path}: line {line} holds numbers; it must hold the column names")
    doubled = next((name for name in names if name and names.count(name) > 1), None)
    if doubled is not None:
        raise InputError(f"{path}: there are two columns {doubled}; keep one")
    rows = [(number, tuple(cell.strip() for cell in cells)) for number, cells in layout.rows()]
    if not rows:
        raise InputError(f"{path} has names but no rows of numbers")
    lines, cells = zip(*rows, strict=True)
    return Table(path, names, cells, lines, layout)


def csv_files(folder: str | Path) -> list[Path]:
    """Return the CSV files of a folder, by name."""
    paths = sorted(p for p in Path(folder).iterdir() if looks_like_a_table(p))
    if not paths:
        raise InputError(f"{folder} holds no .csv file")
    return paths
