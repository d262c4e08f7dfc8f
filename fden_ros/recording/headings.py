# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the headings of a table say: which column is which quantity, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fden_ros.errors import InputError
from fden_ros.recording.units import BRACKETED, UNITS, factor_of

#: Words of headings.
WORDS = {
    "time": {"time", "t", "stamp", "timestamp", "clock", "elapsed", "zeit", "uhrzeit", "temps",
             "tempo", "tiempo"},
    "force": {"force", "f", "fz", "load", "kraft", "last", "forza", "fuerza"},
    "displacement": {
        "displacement", "depth", "position", "indentation", "penetration", "x", "y", "z", "pos",
        "press", "disp", "stroke", "extension", "compression", "deflection", "deformation",
        "travel", "distance", "crosshead", "weg", "eindringtiefe", "verformung",
        "displ", "déplacement", "deplacement", "profondeur", "spostamento", "desplazamiento",
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
#: What is wanted rather than measured, in headings and in names of topics.
COMMANDED = {
    "setpoint", "goal", "command", "commanded", "desired", "target", "reference", "servo", "cmd",
    "demand", "nominal", "planned", "set", "ref", "wanted", "soll",
}  # fmt: skip
#: German compounds begin so: Istkraft, Sollweg.
_GERMAN = re.compile(r"(ist|soll)(?:\w*(?:kraft|weg)|position|wert|last)")
#: A heading with one of these is a field of a message, in SI units.
_FIELDS = ("wrench", "pose", "position", "force", "point", "transform")
_SECONDS = re.compile(r"(?P<of>(?:.*[./_])?)secs?")
_MEGA = 1e6
#: LabVIEW's measurement files call the time [s] so.
_LABVIEW = "X_Value"

#: Headings of recorders that are known by name: time, force, displacement. Of Universal Robots'
#: real-time interface (its guide: outputs): the compensated force and the pose are in the robot's
#: base, the raw force is in the tool's flange.
RECORDERS = (
    ("timestamp", "actual_TCP_force", "actual_TCP_pose"),
    ("timestamp", "ft_raw_wrench", "actual_TCP_pose"),
    # Less of it: the tool presses downwards.
    ("timestamp", "actual_TCP_force_2", "actual_TCP_pose_2*-1"),
)
#: Forces with one of these words are in a frame that turns with the tool.
_TOOL = {"tool", "tool0", "flange", "ft", "sensor"}
#: How the parts of a vector are called: numbers, as in a list, or letters.
_PARTS = (("_0", "_1", "_2"), ("[0]", "[1]", "[2]"), ("_x", "_y", "_z"), (".x", ".y", ".z"))
#: Of a pose as six numbers the last three are the rotation vector [rad].
_TURNS = (("_3", "_4", "_5"), ("[3]", "[4]", "[5]"))


def parts_of(name: str, headings: Sequence[str]) -> tuple[list[int], list[int]]:
    """Return the columns of a vector of that name, and those of a rotation vector beside it.

    Both are empty where the headings have none.

    Raises
    ------
    InputError
        If it has more than six parts: a matrix, joints, or a pose with a quaternion.
    """
    if name in headings:
        return [], []
    if more := [one for one in (f"{name}_6", f"{name}[6]") if one in headings]:
        third = more[0].replace("6", "2")
        raise InputError(
            f"{name} has more than six parts, so it is no vector: name one of them, such as "
            f"{third}"
        )
    places, turns = (
        next((each for parts in kinds if (each := _columns_of(name, parts, headings))), [])
        for kinds in (_PARTS, _TURNS)
    )
    return places, turns if places else []


def _columns_of(name: str, parts: Sequence[str], headings: Sequence[str]) -> list[int]:
    wanted = [name + part for part in parts]
    return [headings.index(one) for one in wanted] if set(wanted) <= set(headings) else []


def nanoseconds_beside(index: int, headings: Sequence[str]) -> int | None:
    """Return the column that holds the nanoseconds of a stamp whose seconds are at `index`.

    As ``stamp.sec`` and ``stamp.nanosec``, or ``secs`` and ``nsecs`` of ROS 1.
    """
    match = _SECONDS.fullmatch(headings[index]) if 0 <= index < len(headings) else None
    if match is None:
        return None
    names = [f"{match['of']}{word}" for word in ("nanosec", "nsecs", "nsec", "nanosecs")]
    return next((headings.index(name) for name in names if name in headings), None)


def is_in_tool(name: str) -> bool:
    """Return whether a force is in a frame that turns with the tool, by its heading."""
    return bool(set(Heading(name).words) & _TOOL)


@dataclass(frozen=True)
class Heading:
    """A heading with the unit that stands in it or below it.

    Parameters
    ----------
    text : str
    unit : str
        Of a row of units; "" where there is none.
    """

    text: str
    unit: str = ""

    @property
    def words(self) -> list[str]:
        """Its words in small letters, without what stands in brackets."""
        text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", BRACKETED.sub(" ", self.text))
        return [word for word in re.split(r"[\W_]+", text.lower()) if word]

    def names(self, quantity: str) -> bool:
        """Return whether its words name a quantity."""
        words = self.words
        if self.text == _LABVIEW:
            return quantity == "time"
        if not words or set(words) & _DERIVED - {words[-1]} or words[-1] in _DERIVED - {"min"}:
            return False
        found = self._found(quantity)
        ending = _ENDINGS.get(quantity)
        return bool(
            found - _LETTERS
            or words[0] in found
            or (ending and any(word.endswith(ending) for word in words))
        )

    def names_by_letter(self, quantity: str) -> bool:
        """Return whether a letter alone names it: x may be the depth, or another direction."""
        return self.names(quantity) and self._found(quantity) <= _LETTERS

    def _found(self, quantity: str) -> set[str]:
        return set(self.words) & WORDS[quantity]

    def factor(self, quantity: str) -> float | None:
        """Return the factor to SI of its unit, stated or by a convention, or None."""
        factor = self.stated(quantity)
        if factor is not None or self.unit or not self._is_of_a_message(quantity):
            return factor
        # `rostopic echo -p` writes %time in ns.
        return 1e-9 if quantity == "time" and self.text.startswith("%") else 1.0

    def stated(self, quantity: str) -> float | None:
        """Return the factor to SI of the unit that it states, or None if it states none.

        In capitals alone MN may be mN too, and states none.
        """
        factor = self._of_its_words(quantity)
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
        """Whether it states a unit of whatever quantity."""
        return any(self.factor(quantity) is not None for quantity in UNITS)

    @property
    def is_silent(self) -> bool:
        """Whether nothing stands where a unit would."""
        return not (self.unit or BRACKETED.search(self.text) or self.has_unit)

    def _is_of_a_message(self, quantity: str) -> bool:
        path = re.split(r"[/.]", self.text.lower())
        if quantity == "time" and self.text == _LABVIEW:
            return True
        if quantity == "time":
            return self.text.lstrip("%_") in ("time", "timestamp") and self.text[0] in "%_"
        return len(path) > 2 and any(part.startswith(_FIELDS) for part in path)

    @property
    def rank(self) -> int:
        """2: measured by its words, 0: commanded, 1: neither is said."""
        words = set(self.words)
        words |= {match[1] for match in map(_GERMAN.fullmatch, words) if match}
        if words & COMMANDED:
            return 0
        return 2 if words & _MEASURED else 1


def candidates(
    headings: Sequence[Heading],
    quantity: str,
    is_usable: Callable[[int], bool] = lambda index: True,
    clock_of: Callable[[int], float | None] = lambda index: None,
    unit: str = "",
) -> list[tuple[int, float]]:
    """Return the columns that can be a quantity, and their factors to SI, the best of them.

    Measured is better than what does not say, and that better than commanded. A time of day, or
    since 1970, needs no unit.

    Parameters
    ----------
    headings : sequence of Heading
    quantity : str
    is_usable : callable
        Whether the column at an index holds numbers.
    clock_of : callable
        Factor to s of the column at an index, where it holds times of day or since 1970.
    unit : str
        Quantity whose unit it has, where that is not its own.
    """
    found: list[tuple[int, float]] = []
    for index, heading in enumerate(headings):
        if not heading.names(quantity):
            continue
        factor = heading.factor(unit or quantity)
        clock = clock_of(index) if quantity == "time" else None
        if clock is not None:
            found.append((index, heading.stated(quantity) or clock))
        elif factor is not None and is_usable(index):
            found.append((index, factor))
    best = max((headings[index].rank for index, _ in found), default=0)
    return [one for one in found if headings[one[0]].rank == best]


def rivals(
    headings: Sequence[Heading],
    quantity: str,
    chosen: Sequence[int],
    is_usable: Callable[[int], bool] = lambda index: True,
) -> list[int]:
    """Return columns without a unit whose words speak for a quantity more than those chosen do.

    Such a column is better measured (``press_actual`` beside ``x_mm``), or named by a word where
    the chosen are by a letter (``depth`` beside ``x_mm``).
    """
    if not chosen:
        return []
    rank = max(headings[index].rank for index in chosen)
    is_weak = all(headings[index].names_by_letter(quantity) for index in chosen)
    return [
        index
        for index, heading in enumerate(headings)
        if heading.is_silent
        and heading.names(quantity)
        and is_usable(index)
        and (
            heading.rank > rank
            or (heading.rank == rank and is_weak and not heading.names_by_letter(quantity))
        )
    ]
