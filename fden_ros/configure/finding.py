# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One thing that a recording says of the probe, or does not, and all that it may be of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fden_ros.parameters import Value

Number = float | tuple[float, ...]
Seconds = tuple[tuple[float, float], ...]

_AIR = "begin with 2 s in the air, and lift off between presses"
_STILL = "hold still in the air for 2 s"
PRESS = (
    "press tissue three times by 3 mm or more, along one line, and lift off by as much in between"
)
TURN = (
    "turn the tool in the air, slowly, through three orientations 60 degrees apart about two "
    "axes, with a second of rest at each"
)


@dataclass(frozen=True)
class Subject:
    """What a finding is of.

    Parameters
    ----------
    unit : str
        SI unit; empty where there is none.
    group : str
        Of the parameters that it sets; empty where it sets none of its own.
    motion : str
        What to do so that a recording tells.
    """

    unit: str = ""
    group: str = ""
    motion: str = ""


#: In the order in which they are said.
SUBJECTS: Mapping[str, Subject] = {
    "force axis": Subject("rad", "force", PRESS),
    "displacement axis": Subject("rad", "displacement", PRESS),
    "force unit": Subject(),
    "displacement unit": Subject(),
    "force rate": Subject("Hz"),
    "force noise": Subject("N", motion=_STILL),
    "force resolution": Subject("N"),
    "force filter": Subject("s"),
    "displacement rate": Subject("Hz"),
    "displacement noise": Subject("m", motion=_STILL),
    "displacement resolution": Subject("m"),
    "lift-off": Subject(motion="press tissue, and lift off"),
    "force bias": Subject("N", motion=_AIR),
    "force drift": Subject("N/s", "force", _AIR),
    "tool mass": Subject("kg", "tool", TURN),
    "tool centre of mass": Subject("m", "tool", TURN),
    "delay": Subject(
        "s",
        "displacement",
        "turn the tool in the air at half a turn in 2 s, press a rigid plate twice, or press "
        "tissue fast, stop at once and hold for 2 s",
    ),
    "compliance": Subject(
        "m/N",
        "displacement",
        "press a rigid plate twice, slowly, to the largest force of your presses, and press "
        "tissue in the same recording (or state --rigid for a recording of a plate)",
    ),
    "place": Subject("", "site", "state --one-place where all presses are of one"),
    "indenter": Subject(
        "", "geometry", "state the indenter: --flat-punch AREA, or --sphere R, with --thickness H"
    ),
}


@dataclass(frozen=True)
class Finding:
    """What was found, how sure it is, and where from.

    Parameters
    ----------
    subject : str
        One of `SUBJECTS`.
    value : float, tuple of float, str or None
        In the unit of the subject; None where nothing is known.
    deviation : float, optional
        Standard deviation, of each component (of an axis: of its direction, in rad).
    evidence : str
        What shows it, in one line.
    seconds : tuple of (float, float)
        Of the recording that it rests on, as from and to since its first stamp [s].
    motion : str
        What to do so that the next recording tells.
    parameters : mapping
        Values of the parameter file, by dotted name.
    probability : float, optional
        Of a sign, from the data.
    own_unit : str
        That of value and deviation where it is the recording's own; empty: the SI unit.
    claim : bool
        Whether it is stated; False: the recording cannot tell, and `motion` says what would.
    """

    subject: str
    value: Number | str | None = None
    deviation: float | None = None
    evidence: str = ""
    seconds: Seconds = ()
    motion: str = ""
    parameters: Mapping[str, Value] = field(default_factory=dict)
    claim: bool = True
    probability: float | None = None
    own_unit: str = ""

    @property
    def unit(self) -> str:
        """Unit of value and deviation."""
        return self.own_unit or SUBJECTS[self.subject].unit


def unknown(
    subject: str,
    evidence: str,
    motion: str = "",
    value: Number | None = None,
    deviation: float | None = None,
    seconds: Seconds = (),
) -> Finding:
    """Return the finding that the recording cannot tell; by default with the subject's motion."""
    motion = motion or SUBJECTS[subject].motion
    return Finding(subject, value, deviation, evidence, seconds, motion, claim=False)
