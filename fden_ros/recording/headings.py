# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The headings of a table: which column is which quantity; units and their factors."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

_GRAVITY = 9.80665
_POUND = 4.4482216152605

#: Bracketed text in a heading, such as a unit.
BRACKETED = re.compile(r"[(\[{<]\s*([^)\]}>]*?)\s*[)\]}>]")
#: By quantity: unit and its factor to s, N, m, Pa, a ratio.
UNITS: dict[str, dict[str, float]] = {
    "time": {
        "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "sek": 1.0,
        "sekunden": 1.0, "ms": 1e-3, "msec": 1e-3, "millis": 1e-3, "milliseconds": 1e-3,
        "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0,
    },
    "force": {
        "N": 1.0, "pN": 1e-12, "nN": 1e-9, "uN": 1e-6, "mN": 1e-3, "cN": 1e-2, "dN": 0.1,
        "kN": 1e3, "MN": 1e6, "newton": 1.0, "newtons": 1.0, "millinewton": 1e-3,
        "millinewtons": 1e-3, "dyn": 1e-5, "g": 1e-3 * _GRAVITY, "gf": 1e-3 * _GRAVITY,
        "kg": _GRAVITY, "kgf": _GRAVITY, "kp": _GRAVITY, "lb": _POUND, "lbs": _POUND,
        "lbf": _POUND, "oz": _POUND / 16.0, "ozf": _POUND / 16.0,
    },
    "displacement": {
        "m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "pm": 1e-12, "micron": 1e-6,
        "microns": 1e-6, "micrometer": 1e-6, "micrometers": 1e-6, "micrometre": 1e-6,
        "micrometres": 1e-6, "millimeter": 1e-3, "millimeters": 1e-3, "millimetre": 1e-3,
        "millimetres": 1e-3, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0,
        "in": 0.0254, "inch": 0.0254, "inches": 0.0254,
    },
    "stress": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "psi": 6894.757293168},
    "strain": {
        "1": 1.0, "-": 1.0, "mm/mm": 1.0, "m/m": 1.0, "%": 0.01, "percent": 0.01, "pct": 0.01,
    },
    "area": {"m2": 1.0, "cm2": 1e-4, "mm2": 1e-6, "in2": 0.0254**2},
}  # fmt: skip
#: In small letters alone a torque would look like a length.
_TORQUE = "Nm"
#: Micro is spelled u, a square 2.
_SPELLING = str.maketrans("µμ²", "uu2", "^ ")
#: Words of headings, English and German.
WORDS = {
    "time": {"time", "t", "stamp", "timestamp", "clock", "elapsed", "zeit", "uhrzeit"},
    "force": {"force", "f", "fz", "load", "kraft", "last"},
    "displacement": {
        "displacement", "depth", "position", "indentation", "penetration", "x", "y", "z", "pos",
        "press", "disp", "displ", "stroke", "extension", "compression", "deflection", "travel",
        "deformation", "distance", "crosshead", "weg", "eindringtiefe", "verformung",
    },
    "stress": {"stress", "spannung"},
    "modulus": {"modulus"},
    "strain": {"strain", "dehnung"},
}  # fmt: skip
#: German compounds end so: Standardkraft, Prüfzeit.
_ENDINGS = {"time": "zeit", "force": "kraft", "displacement": "weg"}
#: Letters that are a quantity only where the heading begins with them.
_LETTERS = {"t", "f", "x", "y", "z"}
#: Words of what is derived from a quantity, in its unit.
_DERIVED = {
    "error", "sd", "std", "noise", "rate", "speed", "velocity", "offset", "bias", "threshold",
    "limit", "max", "min", "peak",
}  # fmt: skip
_MEASURED = {"measured", "actual", "real", "feedback", "meas", "act", "sensed", "encoder", "ist"}
#: Words of commanded values, in headings and in names of topics.
COMMANDED = {
    "setpoint", "goal", "command", "commanded", "desired", "target", "reference", "servo", "cmd",
    "demand", "nominal", "planned", "set", "ref", "wanted", "soll",
}  # fmt: skip
#: Words of the size of a vector, which other directions and a bias enter.
_MAGNITUDES = {"magnitude", "mag", "norm", "resultant", "abs"}
#: German compounds begin so: Istkraft, Sollweg.
_GERMAN = re.compile(r"(ist|soll)(?:\w*(?:kraft|weg)|position|wert|last)")
#: A heading with one of these is a field of a message, in SI units.
_FIELDS = ("wrench", "pose", "position", "force", "point", "transform")
_MEGA = 1e6


@dataclass(frozen=True)
class Heading:
    """A heading with the unit in it or below it."""

    text: str
    unit: str = ""  #: of a row of units; "" where there is none

    @property
    def words(self) -> list[str]:
        """Its words in small letters, without bracketed text."""
        text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", BRACKETED.sub(" ", self.text))
        return [word for word in re.split(r"[\W_]+", text.lower()) if word]

    def names(self, quantity: str) -> bool:
        """Return whether its words name a quantity."""
        words = self.words
        if not words or set(words) & _DERIVED - {words[-1]} or words[-1] in _DERIVED - {"min"}:
            return False
        found = set(words) & WORDS[quantity]
        ending = _ENDINGS.get(quantity)
        return bool(
            found - _LETTERS
            or words[0] in found
            or (ending and any(word.endswith(ending) for word in words))
        )

    def names_by_letter(self, quantity: str) -> bool:
        """Return whether a letter alone names it: x may be the depth, or another direction."""
        return self.names(quantity) and set(self.words) & WORDS[quantity] <= _LETTERS

    def factor(self, quantity: str) -> float | None:
        """Return the factor to SI of its unit, or None.

        In capitals alone MN may be mN too, and states none. Fields of messages are in SI units.
        """
        factor = self._of_its_words(quantity)
        if factor is None and not self.unit and self._is_of_a_message(quantity):
            return 1.0
        is_shouted = quantity == "force" and (self.text + self.unit).isupper()
        return None if is_shouted and factor == _MEGA else factor

    def _of_its_words(self, quantity: str) -> float | None:
        if self.unit:
            return factor_of(quantity, self.unit)
        brackets = BRACKETED.findall(self.text)
        if brackets:
            known = [factor_of(quantity, text) for text in brackets]
            return next((factor for factor in known if factor is not None), None)
        parts = [part for part in re.split(r"[^A-Za-zµμ0-9%]+", self.text) if part]
        if "in" in parts[:-1]:
            # "Weg in mm" is no length in inches.
            parts.remove("in")
        named = [factor_of(quantity, part) for part in parts[1:] if part.lower() not in _LETTERS]
        factors = [factor for factor in named if factor is not None]
        return factors[0] if len(factors) == 1 else None

    @property
    def has_unit(self) -> bool:
        """Whether it states a unit of any quantity."""
        return any(self.factor(quantity) is not None for quantity in UNITS)

    def _is_of_a_message(self, quantity: str) -> bool:
        path = re.split(r"[/.]", self.text.lower())
        return quantity != "time" and len(path) > 2 and any(p.startswith(_FIELDS) for p in path)

    @property
    def is_magnitude(self) -> bool:
        """Whether it is the size of a vector by its words, or between bars."""
        return bool(set(self.words) & _MAGNITUDES) or self.text.strip().startswith("|")

    @property
    def rank(self) -> int:
        """2: measured by its words, 0: commanded, 1: neither."""
        words = set(self.words)
        words |= {match[1] for match in map(_GERMAN.fullmatch, words) if match}
        if words & COMMANDED:
            return 0
        return 2 if words & _MEASURED else 1


def candidates(
    headings: Sequence[Heading],
    quantity: str,
    is_usable: Callable[[int], bool] = lambda index: True,
    unit: str = "",
) -> list[tuple[int, float | None]]:
    """Return the columns that can be a quantity, and their factors to SI, the best of them.

    Measured is better than unspecified, and that better than commanded. A word is better
    than a letter, and of these a column with a unit is better than one without, whose factor is
    None.

    Parameters
    ----------
    headings : sequence of Heading
    quantity : str
    is_usable : callable
        Whether the column at an index holds numbers.
    unit : str
        Quantity whose unit it has, where that is not its own.
    """

    def merit(index: int) -> tuple[int, bool, bool]:
        heading = headings[index]
        is_word = not heading.names_by_letter(quantity)
        return heading.rank, is_word, heading.factor(unit or quantity) is not None

    fitting = [i for i, one in enumerate(headings) if one.names(quantity) and is_usable(i)]
    best = max(map(merit, fitting), default=None)
    return [(i, headings[i].factor(unit or quantity)) for i in fitting if merit(i) == best]


def factor_of(quantity: str, unit: str) -> float | None:
    """Return a unit's factor to SI, or None if it is no unit of that quantity."""
    inner, known = BRACKETED.fullmatch(unit.strip()), UNITS[quantity]
    text = (inner[1] if inner else unit.strip()).translate(_SPELLING)
    if text in known:
        return known[text]
    if text == _TORQUE:
        return None
    small = {name.lower(): factor for name, factor in reversed(list(known.items()))}
    return small.get(text.lower())


def is_unit(text: str) -> bool:
    """Return whether a text is a unit of any quantity."""
    return any(factor_of(quantity, text) is not None for quantity in UNITS)
