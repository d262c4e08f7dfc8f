# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A finding of a recording about the probe, or its absence, and the list of subjects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from fden_ros.parameters import Value

Number = float | tuple[float, ...]

_AIR = "begin with 2 s in the air, and lift off between presses"
_STILL = "hold still in the air for 2 s"
_PRESS = "press tissue three times by 3 mm or more, along one line, and lift off in between"
_TURN = (
    "turn the tool in the air, slowly, through three orientations 60 degrees apart about two "
    "axes, with a second of rest at each"
)


class Subject(NamedTuple):
    """The quantity of a finding; empty where it has none."""

    unit: str = ""  #: SI unit
    group: str = ""  #: of the parameters that it sets
    motion: str = ""  #: what to do so that a recording shows it


#: In their order of output.
SUBJECTS: Mapping[str, Subject] = {
    "force axis": Subject("rad", "force", _PRESS),
    "displacement axis": Subject("rad", "displacement", _PRESS),
    "force unit": Subject(),
    "displacement unit": Subject(),
    "force rate": Subject("Hz"),
    "force noise": Subject("N", motion=_STILL),
    "force filter": Subject("s"),
    "displacement rate": Subject("Hz"),
    "displacement noise": Subject("m", motion=_STILL),
    "lift-off": Subject(motion="press tissue, and lift off"),
    "force bias": Subject("N", motion=_AIR),
    "force drift": Subject("N/s", "force", _AIR),
    "tool mass": Subject("kg", "tool", _TURN),
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
    "indenter": Subject(
        "", "geometry", "state the indenter: --flat-punch AREA, or --sphere R, with --thickness H"
    ),
}


@dataclass(frozen=True)
class Finding:
    """A value, its uncertainty, and its source."""

    subject: str  #: one of `SUBJECTS`
    value: Number | str | None = None  #: None where nothing is known
    #: Standard deviation of each component (of an axis: of its direction [rad]).
    deviation: float | None = None
    evidence: str = ""  #: what shows it, in one line
    motion: str = ""  #: what to do so that the next recording shows it
    parameters: Mapping[str, Value] = field(default_factory=dict)  #: by dotted name
    claim: bool = True  #: False: the recording does not show it, and `motion` would
    probability: float | None = None  #: of a sign, from the data
    own_unit: str = ""  #: of value and deviation in the recording's unit

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
) -> Finding:
    """Return the finding of a recording that does not show it, by default with its motion."""
    motion = motion or SUBJECTS[subject].motion
    return Finding(subject, value, deviation, evidence, motion, claim=False)
