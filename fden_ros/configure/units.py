# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Units that are off: millimetres for metres, grams for newtons, by the range of the plausible.

Each clue is a quantity with its usual size and spread among palpating probes; the unit under
which all clues together are likelier is named, where the odds are large.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fden_ros.configure.axes import Axes
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.session import Session
from fden_ros.configure.weight import Weight

GRAM_FORCE = 9.80665e-3
#: Odds from which a unit is named, and those before any clue for the unit of REP 103.
_ODDS = math.log(100.0)
_PRIOR = math.log(10.0)


@dataclass(frozen=True)
class _Usual:
    """Usual size of a quantity in SI units, and the spread of its logarithm."""

    name: str
    size: float
    spread: float
    below: bool = True  #: whether a smaller one is less usual, too


# Motion: lift and press of a probe, travel of a recording. Force: the peaks that probes are held
# to, the noise of sensors of 10 to 200 N, tissue under a face of 1 to 4 square centimetres, a
# tool of 50 g to 2 kg.
_EXCURSION = _Usual("lift and press", 8e-3, 1.0)
_TRAVEL = _Usual("travel", 0.1, 2.0)
_PEAK = _Usual("largest force", 2.5, 1.2)
_NOISE = _Usual("noise", 6e-3, 1.1)
_STIFFNESS = _Usual("stiffness", 300.0, 2.0)
_WEIGHT = _Usual("tool's weight", 4.0, 1.3)
# Tare and tools leave up to some 10 N; a sensor that was zeroed shows nothing.
_LEVEL = _Usual("level in the air", 5.0, 1.3, below=False)


@dataclass(frozen=True)
class Units:
    """One unit of the recorded force [N] and position [m]; 1 where they are not told."""

    newton: float
    metre: float
    force: Finding
    displacement: Finding


def find_units(sessions: Sequence[Session], axes: Axes, weight: Weight | None) -> Units:
    """Tell newtons from grams and metres from millimetres."""
    metre, displacement = _position_unit(sessions, axes)
    newton, force = _force_unit(sessions, axes, weight, metre)
    return Units(newton, metre, force, displacement)


def _position_unit(sessions: Sequence[Session], axes: Axes) -> tuple[float, Finding]:
    travel = max((float(np.ptp(s.position, axis=0).max()) for s in sessions), default=0.0)
    clues = [(_TRAVEL, travel)]
    excursion = _excursion(axes)
    if excursion > 0.0:
        clues.append((_EXCURSION, excursion))
    odds = _odds(clues, {"m": 1.0, "mm": 1e-3})
    described = ", ".join(f"{usual.name} of {value:.3g}" for usual, value in clues)
    return _named(
        "displacement unit",
        odds,
        described,
        "m",
        "mm",
        1e-3,
        _seconds(sessions),
        "the positions are millimetres (or degrees of a joint that turns), not metres: "
        "divide by 1000 in the driver; a table takes *1e-3",
    )


def _force_unit(
    sessions: Sequence[Session], axes: Axes, weight: Weight | None, metre: float
) -> tuple[float, Finding]:
    clues = []
    noise = float(np.mean([s.force_noise.mean() for s in sessions])) if sessions else 0.0
    if noise > 0.0:
        clues.append((_NOISE, noise))
    if axes.force is not None and axes.sessions:
        push: list[Any] = [s.net @ axes.force.direction for s in axes.sessions if s.leaves]
        push += [np.ptp(s.force @ axes.force.direction) for s in axes.sessions if not s.leaves]
        if push:
            clues.append((_PEAK, max(float(np.max(p)) for p in push)))
        level = max(
            (
                float(np.linalg.norm(np.median(s.baseline, axis=0)))
                for s in axes.sessions
                if s.leaves
            ),
            default=0.0,
        )
        if level > 0.0:
            clues.append((_LEVEL, level))
        stiffness = _softest(axes, metre)
        if stiffness > 0.0:
            clues.append((_STIFFNESS, stiffness))
    if weight is not None and weight.holds and weight.weight > 20.0 * weight.weight_sd:
        clues.append((_WEIGHT, weight.weight))
    odds = _odds(clues, {"N": 1.0, "g": GRAM_FORCE})
    described = ", ".join(f"{usual.name} of {value:.3g}" for usual, value in clues)
    return _named(
        "force unit",
        odds,
        described,
        "N",
        "g",
        GRAM_FORCE,
        _seconds(sessions),
        "the forces are grams, not newtons: multiply by 9.80665e-3 in the driver; a table takes "
        "*9.80665e-3",
    )


def _named(
    subject: str,
    odds: float,
    described: str,
    usual: str,
    other: str,
    factor: float,
    seconds: tuple[tuple[float, float], ...],
    mend: str,
) -> tuple[float, Finding]:
    odds += _PRIOR
    if abs(odds) < _ODDS:
        return 1.0, unknown(
            subject,
            f"{described}: {usual} or {other}, taken for {usual}",
            f"say which: {usual} is what ROS prescribes (REP 103)",
        )
    if odds > 0.0:
        return 1.0, Finding(subject, True, usual, None, "", seconds, f"{described} [{usual}]")
    return factor, Finding(subject, True, other, None, "", seconds, f"{described}: {mend}")


def _odds(clues: Sequence[tuple[_Usual, float]], units: dict[str, float]) -> float:
    """Return the logarithm of the likelihood of the first unit over that of the second."""
    sums = [0.0, 0.0]
    for usual, value in clues:
        if value <= 0.0:
            continue
        for number, factor in enumerate(units.values()):
            away = math.log(value * factor / usual.size) / usual.spread
            if not usual.below:
                away = max(away, 0.0)
            # Beyond 5 spreads a clue says no more: rigs are stranger than a normal law.
            sums[number] -= 0.5 * min(away**2, 25.0)
    return sums[0] - sums[1]


def _excursion(axes: Axes) -> float:
    """Return the largest way along the axis in a contact and the second before and after."""
    if axes.displacement is None:
        return 0.0
    ways = []
    for session in axes.sessions:
        along = session.position @ axes.displacement.direction
        for contact in session.contacts:
            near = (session.times > contact.start - 1.0) & (session.times < contact.end + 1.0)
            near &= ~session.turning
            ways.append(float(np.ptp(along[near])) if near.any() else 0.0)
    return max(ways, default=0.0)


def _softest(axes: Axes, metre: float) -> float:
    """Return the least stiffness of a contact, in units of force per metre."""
    if axes.displacement is None or axes.force is None or axes.by_approach:
        return 0.0
    found = []
    for session in axes.sessions:
        along = metre * (session.position @ axes.displacement.direction)
        push = session.net @ axes.force.direction
        for contact in session.contacts:
            span = slice(contact.first, contact.last)
            way = float(np.ptp(along[span]))
            if way > 0.0:
                found.append(float(np.ptp(push[span])) / way)
    return min(found, default=0.0)


def _seconds(sessions: Sequence[Session]) -> tuple[tuple[float, float], ...]:
    return tuple((0.0, s.streams.end - s.streams.start) for s in sessions)
