# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Axis and sign of force and displacement: where the force of a contact points, and the motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.session import Contact, Lines, Session
from fden_ros.configure.signs import LEAST_RATIO
from fden_ros.core.arrays import Array

#: An axis is claimed from a standard deviation of its direction of this size on [rad]: 2 degrees
#: are then 2.45 deviations, the 95 % of an error in two directions.
LARGEST_SD = math.radians(2.0) / 2.45
#: Force and motion of a contact go together from this correlation on.
_TOGETHER = 0.5
#: Force and motion of a contact are compared by their changes over this part of it.
_CHANGES = 20
#: No drive runs straighter than this [m]: a short stroke shows no direction.
_STRAIGHT = 5e-6
#: The way to a contact and from it is looked at for this time [s], and counts from this many
#: deviations of the position's noise on.
_WAY, _LEAST_WAY, _LEAST_CHUNKS = 0.8, 20.0, 5
_PRESS = (
    "press tissue three times by 3 mm or more, along one line, and lift off by as much in between"
)


@dataclass(frozen=True)
class Axis:
    """A direction, and how well it is known."""

    direction: Array  #: unit vector (3,), or a sign (1,)
    sd: float  #: of each of its two angles [rad]


@dataclass(frozen=True)
class Axes:
    """Axes of force and displacement; None where the recording does not tell."""

    force: Axis | None
    displacement: Axis | None
    sessions: tuple[Session, ...]
    reason: str = ""
    by_approach: bool = False  #: the displacement's is that of the ways to and from contacts

    def findings(self) -> tuple[Finding, Finding]:
        """Return what to say of the force's axis and of the displacement's."""
        return (
            _finding("force", self.force, self.sessions, self.reason),
            _finding(
                "displacement",
                self.displacement,
                self.sessions,
                self.reason,
                by_approach=self.by_approach,
            ),
        )


def find_axes(sessions: Sequence[Session]) -> Axes:
    """Find both axes from the contacts of one rig's recordings."""
    lines = next((session.lines for session in sessions if session.lines is not None), None)
    if lines is None:
        return Axes(None, None, (), "no contact was seen")
    touched = tuple(session for session in sessions if session.contacts)
    if not lines.signs.is_stated:
        return Axes(None, None, touched, _two_readings(lines))
    chosen = tuple(session for session in touched if session.leaves)
    if chosen:
        return _from_touches(chosen, lines)
    return _from_preload(touched, lines)


def _two_readings(lines: Lines) -> str:
    """Say both readings in words, and how far they are from excluding each other."""
    first, second = (
        f"the force grows {_along(sign * lines.grows)} and the displacement "
        f"{_along(sign * lines.into)} into the tissue"
        for sign in (1.0, -1.0)
    )
    ratio = math.exp(lines.signs.log_ratio)
    return (
        f"two readings fit: {first}, or {second}; the first is {ratio:.2g} times as likely, and "
        f"{LEAST_RATIO:g} times would exclude the other"
    )


def _along(direction: Array) -> str:
    if direction.size == 1:
        return "upwards" if direction[0] > 0.0 else "downwards"
    return "along [" + ", ".join(f"{part:.2f}" for part in direction) + "]"


def _from_touches(sessions: tuple[Session, ...], lines: Lines) -> Axes:
    """Contact force against the air, and motion where it rises and falls with it."""
    pushes = [(s, c, s.net[c.first : c.last]) for s in sessions for c in s.contacts]
    moment = sum((push.T @ push for _, _, push in pushes), np.zeros((pushes[0][2].shape[1],) * 2))
    direction = np.linalg.eigh(moment)[1][:, -1]
    if float(direction @ lines.grows) < 0.0:
        direction = -direction
    parts = [push.T @ (push @ direction) for _, _, push in pushes]
    floors = []
    for session, _, push in pushes:
        # Noise of the force, and of the level in the air: that of medians over 2 s.
        chunk = float(np.mean(session.force_noise)) / math.sqrt(_per_chunk(session))
        floors.append(chunk * math.sqrt(float(np.sum((push @ direction) ** 2))))
        floors[-1] = math.hypot(floors[-1], 0.2 * chunk * float(np.sum(push @ direction)))
    force = _combined(parts, floors)
    motion_parts, motion_floors, together = [], [], []
    for session, contact, push in pushes:
        part, floor, correlation = _motion_part(session, contact, push @ direction)
        motion_parts.append(part)
        motion_floors.append(floor)
        together.append((float(np.linalg.norm(part)), correlation))
    displacement = _combined(motion_parts, motion_floors)
    if displacement is not None and displacement.direction.size > 1:
        stroke = max(
            float(np.ptp(s.position[c.first : c.last] @ displacement.direction))
            for s, c, _ in pushes
        )
        bent = _STRAIGHT / max(stroke, 1e-300)
        displacement = Axis(displacement.direction, math.hypot(displacement.sd, bent))
    weight = sum(w for w, _ in together)
    agreed = sum(w * c for w, c in together) / weight if weight > 0.0 else 0.0
    if lines.into.size == 1:
        return Axes(force, Axis(lines.into, 0.0), sessions)
    if agreed < _TOGETHER:
        displacement = None
    if displacement is None or displacement.sd > LARGEST_SD:
        approach = _approach_axis([(session, contact) for session, contact, _ in pushes])
        if approach is not None and approach.sd < LARGEST_SD:
            return Axes(force, approach, sessions, by_approach=True)
    if displacement is None:
        return Axes(force, None, sessions, "the force does not rise with any motion of the probe")
    return Axes(force, displacement, sessions)


def _approach_axis(contacts: Sequence[tuple[Session, Contact]]) -> Axis | None:
    """Return the direction of the ways to the contacts and back, as of a plate that resists all.

    None with less than two contacts, or where the probe rests before or after one of them.
    """
    ways, floors = [], []
    for session, contact in contacts:
        noise = float(np.mean(session.motion_noise)) / math.sqrt(_per_chunk(session, motion=True))
        for touch, start, sign in ((contact.first, -_WAY, 1.0), (contact.last, _WAY, -1.0)):
            end = float(session.edges[touch]) + start
            near = np.abs(session.times - 0.5 * (float(session.edges[touch]) + end)) < 0.5 * _WAY
            if not session.edges[0] < end < session.edges[-1] or near.sum() < _LEAST_CHUNKS:
                continue
            if (session.turning | ~session.air)[near].any():
                continue
            # As it goes on: the way of every chunk weighs by its time.
            position, times = session.position[near], session.times[near]
            since = sign * (times - times.mean())
            ways.append(since @ position / float(since @ since) * _WAY)
            floors.append(noise * _WAY / float(np.linalg.norm(since)))
            if not float(np.linalg.norm(ways[-1])) > _LEAST_WAY * floors[-1]:
                return None
    if len(contacts) < 2 or len(ways) < 3:
        return None
    axis = _combined(ways, floors)
    if axis is None or axis.direction.size == 1:
        return axis
    length = float(np.mean(np.linalg.norm(ways, axis=1)))
    return Axis(axis.direction, math.hypot(axis.sd, _STRAIGHT / length))


def _motion_part(session: Session, contact: Contact, push: Array) -> tuple[Array, float, float]:
    """Return the motion that goes with the force (j,), its noise, and the correlation."""
    position = session.position[contact.first : contact.last]
    # Changes over a short time: in a hold the force relaxes without any motion.
    lag = max(2, len(push) // _CHANGES)
    moved, rose = position[lag:] - position[:-lag], push[lag:] - push[:-lag]
    rose = rose / max(float(np.sqrt(np.mean(rose**2))), 1e-300)
    part: Array = moved.T @ rose
    noise = float(np.mean(session.motion_noise)) / math.sqrt(_per_chunk(session, motion=True))
    length = float(np.linalg.norm(part))
    along = moved @ (part / max(length, 1e-300))
    correlation = length / max(rose.size * float(np.sqrt(np.mean(along**2))), 1e-300)
    return part, noise * math.sqrt(2.0 * rose.size), correlation


def _per_chunk(session: Session, *, motion: bool = False) -> float:
    times = session.streams.motion_times if motion else session.streams.force_times
    return max(times.size / max(session.times.size, 1), 1.0)


def _combined(parts: Sequence[Array], floors: Sequence[float]) -> Axis | None:
    """Return the direction of the sum, its deviation from the scatter of the parts."""
    total = np.sum(parts, axis=0)
    length = float(np.linalg.norm(total))
    if length <= 0.0:
        return None
    direction = total / length
    if direction.size == 1:
        return Axis(np.sign(direction), 0.0)
    across = [part - (part @ direction) * direction for part in parts]
    scatter = math.sqrt(sum(float(a @ a) for a in across) / 2.0) / length
    if len(parts) > 1:
        # Few contacts tell their own scatter badly: Student's factor, two directions each.
        scatter *= math.sqrt(len(parts) / (len(parts) - 1))
        scatter *= float(student.ppf(0.975, 2 * (len(parts) - 1))) / 1.96
    floor = math.sqrt(sum(f**2 for f in floors)) / length
    return Axis(direction, max(scatter, floor))


def _from_preload(sessions: tuple[Session, ...], lines: Lines) -> Axes:
    """Return the common lines where the probe is never seen in the air."""
    return Axes(
        _split_axis([s.force[~s.turning] for s in sessions], lines.grows),
        _split_axis([s.position[~s.turning] for s in sessions], lines.into),
        sessions,
    )


def _split_axis(values: Sequence[Array], direction: Array) -> Axis:
    """Return the main direction of parts of the values, with the scatter of eight of them."""
    if direction.size == 1:
        return Axis(direction, 0.0)
    parts = []
    for block in values:
        for some in np.array_split(block, 8):
            centred = some - some.mean(axis=0)
            parts.append(centred.T @ (centred @ direction))
    axis = _combined(parts, [0.0])
    return axis if axis is not None else Axis(direction, math.inf)


def _finding(
    what: str,
    axis: Axis | None,
    sessions: tuple[Session, ...],
    reason: str,
    *,
    by_approach: bool = False,
) -> Finding:
    subject = f"{what} axis"
    if axis is None:
        return unknown(subject, reason or "no contact was seen", _PRESS)
    count = sum(len(s.contacts) for s in sessions)
    seconds = tuple(span for s in sessions for span in s.seconds())
    basis = (
        f"{count} contacts against the air"
        if all(s.leaves for s in sessions)
        else "contact that never ends for sure"
    )
    if by_approach:
        basis = f"the ways to and from {count} contacts, which do not give way"
    if axis.direction.size == 1:
        falls = bool(axis.direction[0] < 0.0)
        grows = "the force falls" if what == "force" else "the displacement falls"
        rises = "the force grows" if what == "force" else "the displacement grows"
        return Finding(
            subject,
            True,
            float(axis.direction[0]),
            0.0,
            "",
            seconds,
            f"{grows if falls else rises} as the probe presses; {basis}",
            parameters={f"{what}.inverted": falls},
        )
    value = tuple(float(v) for v in axis.direction)
    degrees = math.degrees(axis.sd)
    if axis.sd > LARGEST_SD:
        return Finding(
            subject,
            False,
            value,
            axis.sd,
            "rad",
            seconds,
            f"only known to {degrees:.1f} degrees from {basis}",
            _PRESS,
        )
    return Finding(
        subject,
        True,
        value,
        axis.sd,
        "rad",
        seconds,
        f"within {degrees:.2g} degrees, from {basis}",
        parameters={f"{what}.axis": [round(v, 4) for v in value]},
    )
