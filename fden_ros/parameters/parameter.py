# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One parameter: its default, unit, meaning and range, and the check of a value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fden_ros.core.parameter import Described
from fden_ros.errors import InputError

Value = bool | int | float | str | list[float]
Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Parameter(Described):
    """One parameter of the identifier, with its default as a parameter file has it."""

    default: Value

    @property
    def type_name(self) -> str:
        """Name of the type, as a user would say it."""
        names = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}
        count = f"1 to {self.most}" if self.most else "three"
        return names.get(type(self.default), f"a list of {count} numbers")

    @property
    def constraint(self) -> str:
        """What values are allowed, in words; empty if anything of the type is."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if isinstance(self.default, list) and not self.most:
            return "three numbers" if self.may_be_zero else "three numbers, not all 0"
        low, high = math.isfinite(self.minimum), math.isfinite(self.maximum)
        if low and high:
            each = f"1 to {self.most} numbers, each " if self.most else ""
            zero = "0, or " if self.may_be_zero else ""
            return f"{each}{zero}{self.minimum:g} to {self.maximum:g}"
        return f"at least {self.minimum:g}" if low else f"at most {self.maximum:g}" if high else ""

    def check(self, value: Any) -> Value:
        """Return `value` in the parameter's type."""
        default = self.default
        if isinstance(default, list):
            return self._list(value)
        kinds = (int, float) if isinstance(default, float) else type(default)
        if not isinstance(value, kinds) or isinstance(value, bool) != isinstance(default, bool):
            raise self._refused(value, self.type_name)
        if not (value in self.choices if self.choices else self._may_be(value)):
            raise self._refused(value, self.constraint + self._other_unit(value))
        return float(value) if isinstance(default, float) else value

    def _list(self, value: Any) -> list[float]:
        is_list = isinstance(value, Sequence) and not isinstance(value, str)
        numbers = list(value) if is_list else []
        is_full = 1 <= len(numbers) <= self.most if self.most else len(numbers) == 3
        if not is_full or any(type(v) not in (int, float) for v in numbers):
            raise self._refused(value, self.type_name)
        may_be_zero = self.may_be_zero or self.most or any(numbers)
        if not (may_be_zero and all(map(self._may_be, numbers))):
            raise self._refused(value, self.constraint)
        return [float(v) for v in numbers]

    def _may_be(self, value: Any) -> bool:
        """Return whether a value of the right type is in the range."""
        if isinstance(value, (bool, str)) or (self.may_be_zero and value == 0):
            return True
        return math.isfinite(value) and self.minimum <= value <= self.maximum

    def _refused(self, value: object, expected: str) -> InputError:
        return InputError(f"parameter {self.name} is {value!r}, must be {expected}")

    def _other_unit(self, value: Any) -> str:
        """Return what a value beyond the range would be if it was meant in a usual unit."""
        name, factor = _OTHER_UNITS.get(self.unit, ("", 0.0))
        if not name or not self.minimum <= factor * value <= self.maximum < value:
            return ""
        return f" [{self.unit}]: {value:g} {name} are {factor * value:g} {self.unit}"


#: Units that values are often given in, and their factor to those of the parameters.
_OTHER_UNITS = {"m": ("mm", 1e-3), "m^2": ("mm^2", 1e-6), "s": ("ms", 1e-3)}
