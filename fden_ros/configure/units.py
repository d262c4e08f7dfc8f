# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Units are stated, by headings, by types of messages or by the user: sizes assert none.

Where none is stated, each unit stands with what it would make of the tissue.
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

#: Units that a recording may be in where it states none.
_POSSIBLE = {"force": ("N", "mN", "g", "kgf", "lbf"), "displacement": ("m", "mm")}
_SI = {"force": "N", "displacement": "m"}
_STATE = (
    "state it: a factor in --columns, as force*9.80665e-3 of grams; of a bag publish a type that "
    "has a unit, as WrenchStamped"
)


class Unit(NamedTuple):
    """The unit of a recorded stream, and its factor to SI; without a name it is not stated."""

    name: str
    factor: float = 1.0


NOT_STATED = Unit("")
STATED_SI: Mapping[str, Unit] = {stream: Unit(name) for stream, name in _SI.items()}


def unit_of(stream: str, factor: float) -> Unit:
    """Return the unit of ``force`` or ``displacement`` with a factor to SI."""
    known = UNITS[stream].items()
    names = (name for name, size in known if abs(size - factor) < 1e-9 * size)
    return Unit(next(names, f"{factor:g} {_SI[stream]}"), factor)


def unit_findings(
    sessions: Sequence[Session], axes: Axes, geometry: Geometry | None, units: Mapping[str, Unit]
) -> tuple[Finding, Finding]:
    """Return what is stated of the units of force and displacement, or what each would make."""
    force, displacement = (
        Finding(f"{stream} unit", units[stream].name, None, "as stated")
        if units[stream].name
        else unknown(f"{stream} unit", _possible(stream, sessions, axes, geometry, units), _STATE)
        for stream in ("force", "displacement")
    )
    return force, displacement


def _possible(
    stream: str,
    sessions: Sequence[Session],
    axes: Axes,
    geometry: Geometry | None,
    units: Mapping[str, Unit],
) -> str:
    """Say what each unit would make of the tissue."""
    deepest = _deepest(sessions, axes)
    if deepest is None:
        return f"none is stated: {_SI[stream]} is taken"
    said = []
    for name in _POSSIBLE[stream]:
        force, depth = deepest
        factor = UNITS[stream][name]
        force, depth = (factor * force, depth) if stream == "force" else (force, factor * depth)
        if geometry is None:
            said.append(f"{name} {written(force / depth, 2)} N/m")
            continue
        strain = geometry.strain(depth / geometry.length)
        said.append(f"{name} {written(geometry.stress_per_force * force / strain, 2)} Pa")
    other = "displacement" if stream == "force" else "force"
    assumed = "" if units[other].name else f", with the {other} in {_SI[other]}"
    kind = "stiffness" if geometry is None else "modulus"
    return f"none is stated; {kind} of the tissue{assumed}: {', '.join(said)}"


def _deepest(sessions: Sequence[Session], axes: Axes) -> tuple[float, float] | None:
    """Return force and depth of the softest contact, as recorded."""
    if axes.force is None or axes.displacement is None:
        return None
    found = []
    for session in sessions:
        for contact in session.contacts:
            force = session.net[contact.span] @ axes.force.direction
            depth = session.position[contact.span] @ axes.displacement.direction
            if np.ptp(depth) > 0.0:
                found.append((float(np.ptp(force)), float(np.ptp(depth))))
    return min(found, key=lambda pair: pair[0] / pair[1], default=None)


def in_own_unit(finding: Finding, units: Mapping[str, Unit]) -> Finding:
    """Return a finding in the recording's unit; what rests on an unknown one is not stated."""
    force, displacement = units["force"], units["displacement"]
    stream = finding.subject.partition(" ")[0]
    if finding.unit in ("N", "N/s", "m") and stream in units:
        unit = units[stream]
        value, deviation, name = finding.value, finding.deviation, unit.name or "units"
        # The floor is a tenth of the noise in whatever unit a replay reads both.
        kept = unit.name or finding.subject == "force noise"
        return replace(
            finding,
            value=value / unit.factor if isinstance(value, float) else value,
            deviation=None if deviation is None else deviation / unit.factor,
            own_unit=f"{name}/s" if finding.unit == "N/s" else name,
            parameters=finding.parameters if kept else {},
        )
    needed = {"kg": (force,), "m/N": (force, displacement)}.get(finding.unit, ())
    if not finding.claim or all(unit.name for unit in needed):
        return finding
    evidence = f"{finding.evidence}; the unit is not known"
    return replace(finding, claim=False, evidence=evidence, parameters={}, motion=_STATE)
