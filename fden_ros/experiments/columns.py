# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables of experiments: named columns in, or one line that says what is wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
#: A strain above this can only be percent.
_MOST_STRAIN = 3.0


@dataclass(frozen=True)
class Table:
    """A file of named columns.

    Parameters
    ----------
    path : Path
    headings : tuple of Heading
    columns : mapping
        Numbers of the columns that experiments read, by their index (n,).
    lines : tuple of int
        Line of each row in the file, counted from 1.
    """

    path: Path
    headings: tuple[Heading, ...]
    columns: Mapping[int, Array]
    lines: tuple[int, ...]

    def __contains__(self, name: str) -> bool:
        return bool(_places(self.headings, name))

    def notes(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return a line on each of the columns `names` whose unit was not stated."""
        lines = []
        for name in names:
            for index, _ in _places(self.headings, name)[:1]:
                heading = self.headings[index]
                if name not in ("strain", heading.text) and not heading.has_unit:
                    taken = f"it is taken to be in {UNITS[name]}"
                    lines.append(f"{heading.text} states no unit: {taken}")
        return tuple(lines)

    def column(self, name: str) -> Array:
        """Return a column as numbers, shape (n,).

        Raises
        ------
        InputError
            If it is missing, or holds nothing in a row.
        """
        places = _places(self.headings, name)
        if not places:
            raise InputError(self._missing(name))
        if len(places) > 1:
            several = ", ".join(repr(self.headings[index].text) for index, _ in places)
            raise InputError(
                f"{self.path}: several columns could be {name}: {several}; convert one to "
                f"{UNITS[name]} and name it {name}"
            )
        ((index, factor),) = places
        values = factor * self.columns[index]
        for line, value in zip(self.lines, values, strict=True):
            if not np.isfinite(value):
                raise InputError(
                    f"{self.path}, line {line}: {name} is no finite number; leave the row out or "
                    "correct it"
                )
        return np.asarray(values)

    def positive(self, name: str) -> Array:
        """Return a column whose values must all be positive."""
        return self.require_positive(name, self.column(name))

    def require_positive(self, name: str, values: Array) -> Array:
        """Return `values`, a row each, or say which row is not positive."""
        for line, value in zip(self.lines, values, strict=True):
            if not value > 0.0:
                raise InputError(
                    f"{self.path}, line {line}: {name} is {value:g}; it must be positive, "
                    "because its logarithm is taken"
                )
        return values

    def require_rows(self, count: int, user: str) -> None:
        """Raise unless there are `count` rows."""
        have = len(self.lines)
        if have < count:
            rows = f"{have} row{'s' if have != 1 else ''}"
            raise InputError(f"{self.path} has {rows}; {user} needs at least {count}")

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
        if largest > _MOST_STRAIN:
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
        lines = tuple(np.array(self.lines)[kept].tolist())
        return kept, replace(self, lines=lines, columns={})

    def _missing(self, name: str) -> str:
        words = ("omega", "freq", "f") if name == "omega_rad_s" else (name.split("_")[0],)
        texts = [heading.text for heading in self.headings]
        others = [text for text in texts if text not in UNITS]
        alike = [n for n in others if n.lower().split("_")[0].split(" ")[0].startswith(words)]
        found = f"found: {', '.join(texts)}"
        if alike:
            found = f"convert {alike[0]!r} to {UNITS[name]} and name it {name}"
        return f"{self.path}: column {name} is missing; {found}"


def _places(headings: Sequence[Heading], name: str) -> list[tuple[int, float]]:
    """Return the columns that can be `name`, with their factors to its unit.

    It is the column of this name, or one whose heading has the quantity. A table that states no
    unit at all is in SI units, see :meth:`Table.notes`; a strain may have none.
    """
    texts = [heading.text for heading in headings]
    if name in texts:
        return [(texts.index(name), 1.0)]
    quantity = _QUANTITIES.get(name)
    if quantity is None:
        return []
    found = candidates(headings, quantity, unit="stress" if quantity == "modulus" else quantity)
    are_bare = not any(heading.has_unit for heading in headings)
    return [
        (index, factor or 1.0)
        for index, factor in found
        if factor is not None
        or are_bare
        or (quantity == "strain" and not headings[index].has_unit)
    ]


def read_table(path: str | Path) -> Table:
    """Read a table with a line of names, as :mod:`fden_ros.recording.text` finds it written.

    Raises
    ------
    InputError
        If the file cannot be read, is empty, or has names only.
    """
    path = Path(path)
    layout: Layout = layout_of(path)
    names = [heading.text for heading in layout.headings]
    if not any(names) or all(map(is_number, names)):
        raise InputError(f"{path} has a line of numbers where it must have the column names")
    doubled = next((name for name in names if name and names.count(name) > 1), None)
    if doubled is not None:
        raise InputError(f"{path}: there are two columns {doubled}; keep one")
    if not layout.lines:
        raise InputError(f"{path} has names but no rows of numbers")
    wanted = sorted({index for name in UNITS for index, _ in _places(layout.headings, name)})
    values, lines, _ = layout.numbers(wanted)
    columns = {index: values[:, place] for place, index in enumerate(wanted)}
    return Table(path, layout.headings, columns, tuple(number for number, _ in lines))


def csv_files(folder: str | Path) -> list[Path]:
    """Return the CSV files of a folder, by name."""
    paths = sorted(p for p in Path(folder).iterdir() if looks_like_a_table(p))
    if not paths:
        raise InputError(f"{folder} holds no .csv file")
    return paths
