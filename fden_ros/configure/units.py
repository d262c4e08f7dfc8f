# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Units that are off: millimetres for metres, grams for newtons, by the range of the plausible.

Each clue is a quantity with its usual size and spread among palpating probes; the unit under
which all clues together are likelier is named, where the odds are large.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fden_ros.configure.axes import Axes
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.session import Session
from fden_ros.configure.weight import Weight
from fden_ros.core.arrays import Array

GRAM_FORCE = 9.80665e-3
#: Odds from which a unit is named, and those before any clue for the unit of REP 103.
_ODDS = math.log(100.0)
_PRIOR = math.log(10.0)
#: Beyond so many spreads a clue says no more: rigs are stranger than a normal law.
_FARTHEST = 5.0
#: Usual sizes in SI units, and the spreads of their logarithms. Motion: lift and press of a probe,
#: travel of a recording. Force: the peaks that probes are held to, the noise of sensors of 10 to
#: 200 N, tissue under a face of 1 to 4 square centimetres, a tool of 50 g to 2 kg, and what tare
#: and tools leave in the air.
_USUAL = {
    "travel": (0.1, 2.0),
    "lift and press": (8e-3, 1.0),
    "noise": (6e-3, 1.1),
    "largest force": (2.5, 1.2),
    "level in the air": (5.0, 1.3),
    "stiffness": (300.0, 2.0),
    "tool's weight": (4.0, 1.3),
}
#: A sensor that was zeroed shows no level: a smaller one is no clue.
_NOT_BELOW = "level in the air"


@dataclass(frozen=True)
class Units:
    """One unit of the recorded force [N] and position [m]; 1 where they are not known."""

    newton: float
    metre: float
    force: Finding
    displacement: Finding


def find_units(sessions: Sequence[Session], axes: Axes, weight: Weight | None) -> Units:
    """Tell newtons from grams and metres from millimetres."""
    metre, displacement = _named(
        "displacement unit",
        ("m", "mm", 1e-3),
        _motion_clues(sessions, axes),
        sessions,
        "the positions are millimetres (or degrees of a joint that turns), not metres: "
        "divide by 1000 in the driver; a table takes *1e-3",
    )
    newton, force = _named(
        "force unit",
        ("N", "g", GRAM_FORCE),
        _force_clues(sessions, axes, weight, metre),
        sessions,
        f"the forces are grams, not newtons: multiply by {GRAM_FORCE:g} in the driver; a table "
        f"takes *{GRAM_FORCE:g}",
    )
    return Units(newton, metre, force, displacement)


def _named(
    subject: str,
    units: tuple[str, str, float],
    clues: Mapping[str, float],
    sessions: Sequence[Session],
    mend: str,
) -> tuple[float, Finding]:
    """Return the size of the likelier unit, and what to say of it."""
    usual, other, factor = units
    odds = _PRIOR + _log_likelihood(clues, 1.0) - _log_likelihood(clues, factor)
    said = ", ".join(f"{name} of {value:.3g}" for name, value in clues.items())
    if abs(odds) < _ODDS:
        evidence = f"{said}: {usual} or {other}, taken for {usual}"
        motion = f"say which: {usual} is what ROS prescribes (REP 103)"
        return 1.0, unknown(subject, evidence, motion)
    seconds = tuple((0.0, s.streams.end - s.streams.start) for s in sessions)
    if odds > 0.0:
        return 1.0, Finding(subject, usual, None, f"{said} [{usual}]", seconds)
    return factor, Finding(subject, other, None, f"{said}: {mend}", seconds)


def _log_likelihood(clues: Mapping[str, float], unit: float) -> float:
    """Return that of the clues where they are in a unit of this size."""
    total = 0.0
    for name, value in clues.items():
        size, spread = _USUAL[name]
        away = math.log(value * unit / size) / spread
        if name == _NOT_BELOW:
            away = max(away, 0.0)
        total -= 0.5 * min(away**2, _FARTHEST**2)
    return total


def _motion_clues(sessions: Sequence[Session], axes: Axes) -> dict[str, float]:
    clues = {"travel": max(float(np.ptp(s.position, axis=0).max()) for s in sessions)}
    if axes.displacement is not None:
        strokes = []
        for session in axes.sessions:
            along = session.position @ axes.displacement.direction
            for contact in session.contacts:
                near = (session.times > contact.start - 1.0) & (session.times < contact.end + 1.0)
                strokes.append(_range(along[near & ~session.turning]))
        clues["lift and press"] = max(strokes, default=0.0)
    return {name: value for name, value in clues.items() if value > 0.0}


def _force_clues(
    sessions: Sequence[Session], axes: Axes, weight: Weight | None, metre: float
) -> dict[str, float]:
    clues = {"noise": float(np.mean([s.force_noise.mean() for s in sessions]))}
    if axes.force is not None:
        grows = axes.force.direction
        clues["largest force"] = max(
            float(np.max(s.net @ grows)) if s.leaves else _range(s.force @ grows)
            for s in axes.sessions
        )
        levels = [np.median(s.baseline, axis=0) for s in axes.sessions if s.leaves]
        clues["level in the air"] = max(map(float, map(np.linalg.norm, levels)), default=0.0)
        clues["stiffness"] = _softest(axes, metre)
    if weight is not None and weight.is_clear:
        clues["tool's weight"] = weight.weight
    return {name: value for name, value in clues.items() if value > 0.0}


def _softest(axes: Axes, metre: float) -> float:
    """Return the least stiffness of a contact, in units of force per metre."""
    if axes.displacement is None or axes.force is None or axes.by_approach:
        return 0.0
    found = []
    for session in axes.sessions:
        for contact in session.contacts:
            stroke = metre * _range(session.position[contact.span] @ axes.displacement.direction)
            if stroke > 0.0:
                found.append(_range(session.net[contact.span] @ axes.force.direction) / stroke)
    return min(found, default=0.0)


def _range(values: Array) -> float:
    return float(np.ptp(values)) if values.size else 0.0
