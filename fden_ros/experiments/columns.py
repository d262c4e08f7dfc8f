# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables of experiments: named columns in, or an error of one line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.recording.headings import Heading, candidates
from fden_ros.recording.text import is_number, layout_of

#: The columns of experiments: unit, and quantity in the words of an instrument's headings.
_COLUMNS = {
    "time_s": ("s", "time"),
    "strain": ("a ratio", "strain"),
    "strain_coefficient": ("a ratio", ""),
    "stress_pa": ("Pa", "stress"),
    "relaxation_modulus_pa": ("Pa", "modulus"),
    "omega_rad_s": ("rad/s", ""),
    "storage_modulus_pa": ("Pa", ""),
    "loss_modulus_pa": ("Pa", ""),
}
#: A held quantity may vary by this part of its mean; a strain above this can only be percent.
_CONSTANT, _MOST_STRAIN = 0.02, 3.0


@dataclass(frozen=True)
class Table:
    """A file of named columns."""

    path: Path
    headings: Sequence[Heading]
    columns: Mapping[str, Array]  #: numbers by the names that experiments read, (n,)
    lines: tuple[int, ...]  #: of each row in the file, counted from 1
    notes: tuple[str, ...]  #: a line on each column whose unit was not stated

    def column(self, name: str) -> Array:
        """Return a column, finite numbers (n,), or raise :class:`InputError`."""
        if name not in self.columns:
            found = ", ".join(heading.text for heading in self.headings)
            raise InputError(
                f"{self.path}: column {name} is missing, or several could be it: name one {name} "
                f"[{_COLUMNS[name][0]}]; found: {found}"
            )
        values = self.columns[name]
        self._require(np.isfinite(values), f"{name} is not a finite number", "correct the row")
        if "strain" in name and float(np.abs(values).max(initial=0.0)) > _MOST_STRAIN:
            raise InputError(
                f"{self.path}: {name} goes up to {np.abs(values).max():g}; it must be a ratio, "
                "not percent (0.1 for 10 %)"
            )
        return values

    def positive(self, name: str) -> Array:
        """Return a column whose values must all be positive."""
        values = self.column(name)
        wrong = f"{name} is {values[np.argmin(values > 0.0)]:g}"
        self._require(values > 0.0, wrong, "it must be positive, because its logarithm is taken")
        return values

    def _require(self, is_good: Any, what: str, remedy: str) -> None:
        if not np.all(is_good):
            line = self.lines[int(np.argmin(is_good))]
            raise InputError(f"{self.path}, line {line}: {what}; {remedy}")

    def require_rows(self, count: int, user: str) -> None:
        """Raise unless there are `count` rows."""
        if len(self.lines) < count:
            raise InputError(f"{self.path}: rows: {len(self.lines)}; {user} needs {count} or more")

    def held(self, name: str, given: float | None, option: str) -> float:
        """Return a quantity that is equal in all rows: as `given`, or by its column."""
        value = given
        if value is None and name in self.columns:
            values = self.column(name)
            value = float(values.mean())
            if np.ptp(values) > _CONSTANT * abs(value):
                raise InputError(
                    f"{self.path}: {name} goes from {values.min():g} to {values.max():g}; a test "
                    "has one: one file each"
                )
        if value is None:
            raise InputError(f"{self.path}: give {option}, or a column {name}")
        if not value > 0.0:
            raise InputError(f"{self.path}: {name} is {value:g}; it must be positive")
        return value

    def since(self, start: float) -> Table:
        """Return the rows from `start` [s] on; time_s must increase."""
        time = self.column("time_s")
        rises = np.diff(time, prepend=-np.inf) > 0.0
        wrong = f"time_s {time[np.argmin(rises)]:g} is not after that of the row before"
        self._require(rises, wrong, "sort the rows by time, each time once")
        kept = time >= start
        if not kept.any():
            raise InputError(
                f"{self.path} ends at {time.max():g} s, before the first row to use at "
                f"{start:g} s; give --from S"
            )
        columns = {name: values[kept] for name, values in self.columns.items()}
        return replace(self, lines=tuple(np.array(self.lines)[kept].tolist()), columns=columns)


def read_table(path: Path) -> Table:
    """Read a table with a line of names, or raise :class:`InputError`."""
    layout = layout_of(path)
    headings = layout.headings
    if all(is_number(heading.text) for heading in headings if heading.text):
        raise InputError(f"{path} has a line of numbers where it must have the column names")
    if not layout.lines:
        raise InputError(f"{path} has names but no rows of numbers")
    places = {name: place for name in _COLUMNS if (place := _place(headings, name))}
    wanted = sorted({index for index, _ in places.values()})
    values, lines, _ = layout.numbers(wanted)
    columns = {name: factor * values[:, wanted.index(i)] for name, (i, factor) in places.items()}
    notes = tuple(
        f"{headings[i].text} states no unit: it is assumed to be in {_COLUMNS[name][0]}"
        for name, (i, _) in places.items()
        if name not in ("strain", headings[i].text) and not headings[i].has_unit
    )
    return Table(path, headings, columns, tuple(number for number, _ in lines), notes)


def _place(headings: Sequence[Heading], name: str) -> tuple[int, float] | None:
    """Return the column that is `name`, with its factor to the unit; None: there is not one.

    It is the column of this name, or one whose heading has the quantity. A table that states no
    unit at all is in SI units; a strain may have none.
    """
    texts = [heading.text for heading in headings]
    if texts.count(name) == 1:
        return texts.index(name), 1.0
    quantity = _COLUMNS[name][1]
    if not quantity:
        return None
    found = candidates(headings, quantity, unit="stress" if quantity == "modulus" else quantity)
    is_bare = not any(heading.has_unit for heading in headings)
    fitting = [
        (index, factor or 1.0)
        for index, factor in found
        if factor is not None or is_bare or (quantity == "strain" and not headings[index].has_unit)
    ]
    return fitting[0] if len(fitting) == 1 else None
