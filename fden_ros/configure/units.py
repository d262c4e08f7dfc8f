# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Units are stated, by headings, by types of messages or by the user, and never guessed by size.

Where none is stated, each unit is shown with its result for the tissue.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fden_ros.configure.axes import Axes
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.session import Session
from fden_ros.core.law import Geometry
from fden_ros.recording.headings import UNITS
from fden_ros.written import written

#: Units of recordings that state none; the first is that of SI.
_POSSIBLE = {"force": ("N", "mN", "g", "kgf", "lbf"), "displacement": ("m", "mm")}
_STATE = (
    "state it: in --columns as a factor, such as force*9.80665e-3 for grams; for a bag, publish a "
    "type that has a unit, such as WrenchStamped"
)


class Unit(NamedTuple):
    """The unit of a recorded stream, and its factor to SI; without a name it is not stated."""

    name: str
    factor: float = 1.0


NOT_STATED = Unit("")
STATED_SI: Mapping[str, Unit] = {stream: Unit(names[0]) for stream, names in _POSSIBLE.items()}


def unit_of(stream: str, factor: float) -> Unit:
    """Return the unit of ``force`` or ``displacement`` with a factor to SI."""
    known = UNITS[stream].items()
    names = (name for name, size in known if abs(size - factor) < 1e-9 * size)
    return Unit(next(names, f"{factor:g} {_POSSIBLE[stream][0]}"), factor)


def unit_findings(
    sessions: Sequence[Session], axes: Axes, geometry: Geometry | None, units: Mapping[str, Unit]
) -> tuple[Finding, ...]:
    """Return the stated units of force and displacement, or the result of each unit."""
    deepest = _deepest(sessions, axes)
    return tuple(
        Finding(f"{stream} unit", units[stream].name, None, "as stated")
        if units[stream].name
        else unknown(f"{stream} unit", _possible(stream, deepest, geometry, units), _STATE)
        for stream in _POSSIBLE
    )


def _possible(
    stream: str,
    deepest: tuple[float, float] | None,
    geometry: Geometry | None,
    units: Mapping[str, Unit],
) -> str:
    """Return the result of each unit for the tissue."""
    if deepest is None:
        return f"none is stated: {_POSSIBLE[stream][0]} is assumed"
    made = []
    for name in _POSSIBLE[stream]:
        factors = {"force": 1.0, "displacement": 1.0, stream: UNITS[stream][name]}
        force, depth = factors["force"] * deepest[0], factors["displacement"] * deepest[1]
        if geometry is None:
            made.append(f"{name} {written(force / depth, 2)} N/m")
        else:
            strain = geometry.strain(depth / geometry.length)
            made.append(f"{name} {written(geometry.stress_per_force * force / strain, 2)} Pa")
    other = "displacement" if stream == "force" else "force"
    given = "" if units[other].name else f", with the {other} in {_POSSIBLE[other][0]}"
    kind = "stiffness" if geometry is None else "modulus"
    return f"none is stated; {kind} of the tissue{given}: {', '.join(made)}"


def _deepest(sessions: Sequence[Session], axes: Axes) -> tuple[float, float] | None:
    """Return force and depth of the softest contact, as recorded."""
    if axes.force is None or axes.displacement is None:
        return None
    grows, into = axes.force.direction, axes.displacement.direction
    found = [
        (float(np.ptp(s.net[one.span] @ grows)), float(np.ptp(s.position[one.span] @ into)))
        for s in sessions
        for one in s.contacts
    ]
    return min((p for p in found if p[1] > 0.0), key=lambda p: p[0] / p[1], default=None)


def in_own_unit(finding: Finding, units: Mapping[str, Unit]) -> Finding:
    """Return a finding in the recording's unit; one with an unknown unit is not claimed."""
    stream = finding.subject.partition(" ")[0]
    if finding.unit in ("N", "N/s", "m") and stream in units:
        unit, value, sd = units[stream], finding.value, finding.deviation
        name = unit.name or "units"
        # The floor is a tenth of the noise in whatever unit a replay reads both.
        kept = unit.name or finding.subject == "force noise"
        return replace(
            finding,
            value=value / unit.factor if isinstance(value, float) else value,
            deviation=None if sd is None else sd / unit.factor,
            own_unit=f"{name}/s" if finding.unit == "N/s" else name,
            parameters=finding.parameters if kept else {},
        )
    needed = {"kg": ("force",), "m/N": ("force", "displacement")}.get(finding.unit, ())
    if not finding.claim or all(units[one].name for one in needed):
        return finding
    evidence = f"{finding.evidence}; the unit is not known"
    return replace(finding, claim=False, evidence=evidence, parameters={}, motion=_STATE)
