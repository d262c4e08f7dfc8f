# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Axis and sign of force and displacement: where the force of a contact points, and the motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.session import DRIFT_PART, Contact, Lines, Session
from fden_ros.configure.signs import LEAST_RATIO
from fden_ros.core.arrays import Array

#: An axis is claimed from a standard deviation of its direction of this size on [rad]: 5 degrees,
#: 0.4 % of force or depth, are then 2.45 deviations, the 95 % of an error in two directions.
LARGEST_SD = math.radians(5.0) / 2.45
#: Force and motion of a contact go together from this correlation on.
_TOGETHER = 0.5
#: Force and motion of a contact are compared by their changes over this part of it.
_CHANGES = 20
#: A single contact shows by its quarters how far its direction holds.
_QUARTERS = 4
#: No drive runs straighter than this [m]: a short stroke shows no direction.
_STRAIGHT = 5e-6
#: What is said of directions from a probe that was never seen in the air.
_NEVER = "contact that never ends for sure"
#: Approach to a contact and retreat are looked at for this time [s], and count from this many
#: deviations of the position's noise on.
_APPROACH, _LEAST_APPROACH, _LEAST_CHUNKS = 0.8, 20.0, 5


@dataclass(frozen=True)
class Axis:
    """A direction, how well it is known, and from what."""

    direction: Array  #: unit vector (3,), or a sign (1,)
    sd: float  #: of each of its two angles [rad]
    basis: str = ""

    @property
    def is_stated(self) -> bool:
        """Whether it is known well enough."""
        return self.sd <= LARGEST_SD


@dataclass(frozen=True)
class Axes:
    """Axes of force and displacement; None where the recording does not tell."""

    force: Axis | None
    displacement: Axis | None
    sessions: tuple[Session, ...]
    reason: str = ""  #: why one of them is not known
    by_approach: bool = False  #: the displacement's is that of approaches and retreats
    probability: float | None = None  #: of the signs, from the data; None: not looked for

    def findings(self) -> tuple[Finding, Finding]:
        """Return what to say of the force's axis and of the displacement's."""
        force, displacement = (
            replace(self._finding(stream, axis), probability=self.probability)
            for stream, axis in (("force", self.force), ("displacement", self.displacement))
        )
        return force, displacement

    def _finding(self, stream: str, axis: Axis | None) -> Finding:
        subject = f"{stream} axis"
        if axis is None:
            return unknown(subject, self.reason)
        seconds = tuple(span for session in self.sessions for span in session.seconds())
        value = tuple(float(v) for v in axis.direction)
        if len(value) == 1:
            verb = "falls" if value[0] < 0.0 else "grows"
            sure = self._sureness()
            evidence = f"the {stream} {verb} as the probe presses; {axis.basis}{sure}"
            values = {f"{stream}.inverted": value[0] < 0.0}
            return Finding(subject, value[0], 0.0, evidence, seconds, parameters=values)
        degrees = math.degrees(axis.sd)
        if not axis.is_stated:
            evidence = f"only known to {degrees:.1f} degrees from {axis.basis}"
            return unknown(subject, evidence, "", value, axis.sd, seconds)
        evidence = f"within {degrees:.2g} degrees, from {axis.basis}{self._sureness()}"
        rounded = {f"{stream}.axis": [round(v, 4) for v in value]}
        return Finding(subject, value, axis.sd, evidence, seconds, parameters=rounded)

    def _sureness(self) -> str:
        if self.probability is None:
            return ""
        return f"; the sign with a probability of {_probability_words(self.probability)}"


def find_axes(sessions: Sequence[Session]) -> Axes:
    """Find both axes from the contacts of one rig's recordings."""
    lines = next((session.lines for session in sessions if session.lines is not None), None)
    found = _found_axes(sessions, lines)
    return found if lines is None else replace(found, probability=lines.signs.probability)


def _found_axes(sessions: Sequence[Session], lines: Lines | None) -> Axes:
    touched = tuple(session for session in sessions if session.contacts)
    if lines is None or not touched:
        return Axes(None, None, (), "no contact was seen")
    if not lines.signs.is_stated:
        return Axes(None, None, touched, _two_readings(lines))
    chosen = tuple(session for session in touched if session.leaves)
    if chosen:
        return _from_touches(chosen, lines)
    return Axes(
        _split_axis([s.force[~s.turning] for s in touched], lines.grows),
        _motion_axis(touched, lines),
        touched,
    )


def _two_readings(lines: Lines) -> str:
    """Say both readings in words, and how far they are from excluding each other."""
    first, second = (
        f"the force grows {_along(sign * lines.grows)} and the displacement "
        f"{_along(sign * lines.into)} into the tissue"
        for sign in (1.0, -1.0)
    )
    ratio = math.exp(lines.signs.log_ratio)
    return (
        f"two readings fit: {first}, or {second}; the first is {ratio:.2g} times as likely (a "
        f"probability of {_probability_words(lines.signs.probability)}), and {LEAST_RATIO:g} "
        "times would exclude the other"
    )


def _probability_words(probability: float) -> str:
    """Return a probability to the digits in which it is not certain."""
    if probability > 0.9999:
        return "over 0.9999"
    return f"{probability:.4f}" if probability > 0.99 else f"{probability:.2f}"


def _along(direction: Array) -> str:
    if direction.size == 1:
        return "upwards" if direction[0] > 0.0 else "downwards"
    return "along [" + ", ".join(f"{part:.2f}" for part in direction) + "]"


@dataclass(frozen=True)
class _Part:
    """A vector that points along an axis, its noise (of each direction), and what it weighs."""

    vector: Array
    noise: float
    correlation: float = 1.0


def _from_touches(sessions: tuple[Session, ...], lines: Lines) -> Axes:
    """Contact force against the air, and motion where it rises and falls with it."""
    contacts = [(session, contact) for session in sessions for contact in session.contacts]
    basis = f"{len(contacts)} contacts against the air"
    pushes = [session.net[contact.span] for session, contact in contacts]
    direction = np.linalg.svd(np.concatenate(pushes), full_matrices=False)[2][0]
    direction = direction * math.copysign(1.0, float(direction @ lines.grows))
    force = _combined([part for one in contacts for part in _force_parts(*one, direction)], basis)
    if lines.into.size == 1:
        return Axes(force, Axis(lines.into, 0.0, basis), sessions)
    parts = [part for one in contacts for part in _motion_parts(*one, direction)]
    weights = [float(np.linalg.norm(part.vector)) for part in parts]
    together = float(np.average([part.correlation for part in parts], weights=weights))
    displacement = _signed(_combined(parts, basis), lines) if together >= _TOGETHER else None
    if displacement is not None:
        into = displacement.direction
        stroke = max(float(np.ptp(s.position[c.span] @ into)) for s, c in contacts)
        sd = math.hypot(displacement.sd, _STRAIGHT / max(stroke, 1e-300))
        displacement = Axis(into, sd, basis)
    if displacement is None or not displacement.is_stated:
        approach = _approach_axis(contacts)
        if approach is not None and approach.is_stated:
            return Axes(force, approach, sessions, by_approach=True)
    reason = "the force does not rise with any motion of the probe"
    return Axes(force, displacement, sessions, reason)


def _force_parts(session: Session, contact: Contact, direction: Array) -> list[_Part]:
    """Return the force of each quarter of a contact, every chunk weighted by its size."""
    chunk = float(np.mean(session.force_chunk_noise))
    parts = []
    for net, drift in zip(
        np.array_split(session.net[contact.span], _QUARTERS),
        np.array_split(_drift_sd(session, direction)[contact.span], _QUARTERS),
        strict=True,
    ):
        along = net @ direction
        # The level in the air is wrong alike in all quarters, by the noise of two medians over
        # 2 s and by the drift.
        level = float(np.abs(along) @ np.hypot(0.28 * chunk, drift)) * math.sqrt(_QUARTERS)
        parts.append(_Part(net.T @ along, math.hypot(chunk * float(np.linalg.norm(along)), level)))
    return parts


def _drift_sd(session: Session, direction: Array) -> Array:
    """Return how far the force's level may have drifted off since the nearest air (n,)."""
    times, seen = session.times, session.times[session.air]
    after = np.clip(np.searchsorted(seen, times), 1, seen.size - 1)
    away = np.minimum(np.abs(times - seen[after - 1]), np.abs(times - seen[after]))
    return np.asarray(DRIFT_PART * float(np.ptp(session.net[~session.turning] @ direction)) * away)


def _motion_parts(session: Session, contact: Contact, direction: Array) -> list[_Part]:
    """Return the motion that goes with the force, of each quarter of a contact."""
    push, position = session.net[contact.span] @ direction, session.position[contact.span]
    # Changes over a short time: in a hold the force relaxes without any motion.
    lag = max(2, len(push) // _CHANGES)
    turning = session.turning[contact.span]
    still = ~(turning[lag:] | turning[:-lag])
    moved, rose = (position[lag:] - position[:-lag])[still], (push[lag:] - push[:-lag])[still]
    rose = rose / max(float(np.sqrt(np.mean(rose**2))), 1e-300)
    whole: Array = moved.T @ rose
    length = float(np.linalg.norm(whole))
    along = moved @ (whole / max(length, 1e-300))
    correlation = length / max(rose.size * float(np.sqrt(np.mean(along**2))), 1e-300)
    noise = float(np.mean(session.motion_chunk_noise))
    quarters = zip(np.array_split(moved, _QUARTERS), np.array_split(rose, _QUARTERS), strict=True)
    return [
        _Part(some.T @ part, noise * math.sqrt(2.0 * part.size), correlation)
        for some, part in quarters
    ]


def _approach_axis(contacts: Sequence[tuple[Session, Contact]]) -> Axis | None:
    """Return the direction of the approaches and retreats, as of a plate that resists all.

    None with less than two contacts, or where the probe rests before or after one of them.
    """
    motions = []
    for session, contact in contacts:
        noise = float(np.mean(session.motion_chunk_noise))
        for touch, sign in ((contact.first, 1.0), (contact.last, -1.0)):
            middle = float(session.edges[touch]) - 0.5 * sign * _APPROACH
            near = np.abs(session.times - middle) < 0.5 * _APPROACH
            if near.sum() < _LEAST_CHUNKS or (session.turning | ~session.air)[near].any():
                continue
            # As it goes on: the motion of every chunk weighs by its time.
            since = sign * (session.times[near] - session.times[near].mean())
            motion = since @ session.position[near] / float(since @ since) * _APPROACH
            motions.append(_Part(motion, noise * _APPROACH / float(np.linalg.norm(since))))
    lengths = [float(np.linalg.norm(motion.vector)) for motion in motions]
    moves = [
        length > _LEAST_APPROACH * motion.noise
        for length, motion in zip(lengths, motions, strict=True)
    ]
    if len(contacts) < 2 or len(motions) < 3 or not all(moves):
        return None
    axis = _combined(
        motions, f"approach and retreat of {len(contacts)} contacts, which do not yield"
    )
    if axis is None:
        return None
    sd = math.hypot(axis.sd, _STRAIGHT / float(np.mean(lengths)))
    return Axis(axis.direction, sd, axis.basis)


def _combined(parts: Sequence[_Part], basis: str) -> Axis | None:
    """Return the direction of the sum, its deviation from the scatter of the parts."""
    vectors = np.array([part.vector for part in parts])
    total = vectors.sum(axis=0)
    length = float(np.linalg.norm(total))
    if length <= 0.0:
        return None
    direction = total / length
    if direction.size == 1:
        return Axis(np.sign(direction), 0.0, basis)
    across = vectors - np.outer(vectors @ direction, direction)
    scatter = math.sqrt(float(np.sum(across**2)) / 2.0) / length
    count = len(parts)
    if count > 1:
        # Few contacts tell their own scatter badly: Student's factor, two directions each.
        scatter *= math.sqrt(count / (count - 1))
        scatter *= float(student.ppf(0.975, 2 * (count - 1))) / 1.96
    noise = math.sqrt(sum(part.noise**2 for part in parts)) / length
    return Axis(direction, max(scatter, noise), basis)


def _motion_axis(sessions: Sequence[Session], lines: Lines) -> Axis:
    """Return the direction of the motion that goes with the force of a probe never in the air."""
    if lines.into.size == 1:
        return Axis(lines.into, 0.0, _NEVER)
    contacts = [(session, contact) for session in sessions for contact in session.contacts]
    parts = [part for one in contacts for part in _motion_parts(*one, lines.grows)]
    return _signed(_combined(parts, _NEVER), lines) or Axis(lines.into, math.inf, _NEVER)


def _signed(axis: Axis | None, lines: Lines) -> Axis | None:
    """Return the axis with the sign of the likeliest reading: a drift may outdo the contact."""
    if axis is None:
        return None
    sign = math.copysign(1.0, float(axis.direction @ lines.into))
    return replace(axis, direction=sign * axis.direction)


def _split_axis(values: Sequence[Array], direction: Array) -> Axis:
    """Return the main direction of eight parts of values from a probe never seen in the air."""
    if direction.size == 1:
        return Axis(direction, 0.0, _NEVER)
    parts = []
    for block in values:
        for some in np.array_split(block, 8):
            centred = some - some.mean(axis=0)
            parts.append(_Part(centred.T @ (centred @ direction), 0.0))
    return _combined(parts, _NEVER) or Axis(direction, math.inf, _NEVER)
