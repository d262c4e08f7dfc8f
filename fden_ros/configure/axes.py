# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Axis and sign of force and displacement: the directions of a contact's force and motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.session import DRIFT_PART, Contact, Lines, Session, changes
from fden_ros.configure.signs import LEAST_RATIO
from fden_ros.core.arrays import Array

#: An axis is claimed up to this standard deviation of its direction [rad]: 5 degrees,
#: 0.4 % of force or depth, are then 2.45 deviations, the 95 % of an error in two directions.
LARGEST_SD = math.radians(5.0) / 2.45
#: Force and motion of a contact are compared by their changes over this part of it, and belong
#: together from this correlation on.
_CHANGES, _TOGETHER = 20, 0.5
#: The quarters of a single contact show the scatter of its direction.
_QUARTERS = 4
#: No drive runs straighter than this [m]: a short stroke shows no direction.
_STRAIGHT = 5e-6


class Axis(NamedTuple):
    """A direction, its uncertainty, and its source."""

    direction: Array  #: unit vector (3,), or a sign (1,)
    sd: float  #: of each of its two angles [rad]
    basis: str = ""


@dataclass(frozen=True)
class Axes:
    """Axes of force and displacement; None where the recording does not show them."""

    force: Axis | None = None
    displacement: Axis | None = None
    reason: str = ""  #: why one of them is not known
    probability: float | None = None  #: of the signs, from the data; None: not looked for

    def findings(self) -> tuple[Finding, ...]:
        """Return what to report of the force's axis and of the displacement's."""
        axes = (("force", self.force), ("displacement", self.displacement))
        return tuple(replace(self._finding(*one), probability=self.probability) for one in axes)

    def _finding(self, stream: str, axis: Axis | None) -> Finding:
        subject = f"{stream} axis"
        if axis is None:
            return unknown(subject, self.reason)
        sure = f"; the sign with a probability of {_probability_words(self.probability or 0.0)}"
        value = tuple(float(v) for v in axis.direction)
        if len(value) == 1:
            verb = "falls" if value[0] < 0.0 else "grows"
            evidence = f"the {stream} {verb} as the probe presses; {axis.basis}{sure}"
            inverted = {f"{stream}.inverted": value[0] < 0.0}
            return Finding(subject, value[0], 0.0, evidence, parameters=inverted)
        degrees = math.degrees(axis.sd)
        if axis.sd > LARGEST_SD:
            evidence = f"known only to {degrees:.1f} degrees, from {axis.basis}"
            return unknown(subject, evidence, "", value, axis.sd)
        evidence = f"within {degrees:.2g} degrees, from {axis.basis}{sure}"
        rounded = {f"{stream}.axis": [round(v, 4) for v in value]}
        return Finding(subject, value, axis.sd, evidence, parameters=rounded)


def find_axes(sessions: Sequence[Session]) -> Axes:
    """Find both axes from the contacts of one rig's recordings."""
    touched = [session for session in sessions if session.contacts]
    lines = touched[0].lines if touched else None
    if lines is None:
        return Axes(reason="no contact was seen")
    if not lines.signs.is_stated:
        return Axes(reason=_two_readings(lines), probability=lines.signs.probability)
    left = [session for session in touched if session.leaves]
    contacts = [(session, contact) for session in left or touched for contact in session.contacts]
    basis = (
        f"{len(contacts)} contacts compared with the air" if left else "a contact that never ends"
    )
    pushes = [session.net[contact.span] for session, contact in contacts]
    main = np.linalg.svd(np.concatenate(pushes), full_matrices=False)[2][0]
    grows = main * math.copysign(1.0, float(main @ lines.grows)) if left else lines.grows
    return Axes(
        _combined([part for one in contacts for part in _force_parts(*one, grows)], basis),
        _motion_axis(contacts, lines, grows, basis),
        "the force does not rise with any motion of the probe",
        lines.signs.probability,
    )


def _two_readings(lines: Lines) -> str:
    """Return both readings in words, and how far they are from excluding each other."""
    grows, into = (", ".join(f"{v:.2f}" for v in one) for one in (lines.grows, lines.into))
    return (
        f"two readings fit: the force grows along [{grows}] and the displacement along [{into}] "
        f"into the tissue, or both against; the first is {math.exp(lines.signs.log_ratio):.2g} "
        f"times as likely (a probability of {_probability_words(lines.signs.probability)}), and "
        f"{LEAST_RATIO:g} times would rule out the other"
    )


def _probability_words(probability: float) -> str:
    """Return a probability to the digits in which it is not certain."""
    if probability > 0.9999:
        return "over 0.9999"
    return f"{probability:.4f}" if probability > 0.99 else f"{probability:.2f}"


class _Part(NamedTuple):
    """A vector that points along an axis, and its noise in each direction."""

    vector: Array
    noise: float


def _force_parts(session: Session, contact: Contact, direction: Array) -> list[_Part]:
    """Return the force of each quarter of a contact, every chunk weighted by its size."""
    chunk = float(np.mean(session.force_chunk_noise))
    net = np.where(session.turning[:, None] & ~session.leaves, 0.0, session.net)
    parts, drifted = [], _drift_sd(session, direction)
    for chunks in np.array_split(np.arange(contact.first, contact.last), _QUARTERS):
        quarter, drift = net[chunks], drifted[chunks]
        along = quarter @ direction
        # The level in the air has the same error in all quarters: the noise of two medians over
        # 2 s, and the drift.
        level = float(np.abs(along) @ np.hypot(0.28 * chunk, drift)) * math.sqrt(_QUARTERS)
        noise = math.hypot(chunk * float(np.linalg.norm(along)), level)
        parts.append(_Part(quarter.T @ along, noise))
    return parts


def _drift_sd(session: Session, direction: Array) -> Array:
    """Return how far the force's level may have drifted since the nearest air (n,)."""
    times, seen = session.times, session.times[session.air]
    if not seen.size:
        return np.zeros(times.size)
    after = np.clip(np.searchsorted(seen, times), 1, seen.size - 1)
    away = np.minimum(np.abs(times - seen[after - 1]), np.abs(times - seen[after]))
    return np.asarray(DRIFT_PART * float(np.ptp(session.net[~session.turning] @ direction)) * away)


def _motion_axis(
    contacts: Sequence[tuple[Session, Contact]], lines: Lines, grows: Array, basis: str
) -> Axis | None:
    """Return the direction of the motion that follows the force, with the sign of `lines`."""
    if lines.into.size == 1:
        return Axis(lines.into, 0.0, basis)
    found = [_motion_parts(*one, grows) for one in contacts]
    axis = _combined([part for parts, _ in found for part in parts], basis)
    sizes = [sum(float(np.linalg.norm(part.vector)) for part in parts) for parts, _ in found]
    if axis is None or np.average([one for _, one in found], weights=sizes) < _TOGETHER:
        return None
    # A drift may exceed the contact.
    into = math.copysign(1.0, float(axis.direction @ lines.into)) * axis.direction
    stroke = max(float(np.ptp(s.position[c.span] @ into)) for s, c in contacts)
    return Axis(into, math.hypot(axis.sd, _STRAIGHT / max(stroke, 1e-300)), basis)


def _motion_parts(
    session: Session, contact: Contact, direction: Array
) -> tuple[list[_Part], float]:
    """Return the motion that follows the force, of each quarter of a contact, and how well."""
    span = contact.span
    push, position = session.net[span] @ direction, session.position[span]
    # Changes over a short time: in a hold the force relaxes without any motion.
    moved, rose = changes(session, push, position, _CHANGES, span)
    rose = rose / max(float(np.sqrt(np.mean(rose**2))), 1e-300)
    whole: Array = moved.T @ rose
    length = float(np.linalg.norm(whole))
    along = moved @ (whole / max(length, 1e-300))
    correlation = length / max(rose.size * float(np.sqrt(np.mean(along**2))), 1e-300)
    noise = float(np.mean(session.motion_chunk_noise))
    quarters = zip(np.array_split(moved, _QUARTERS), np.array_split(rose, _QUARTERS), strict=True)
    parts = [_Part(some.T @ part, noise * math.sqrt(2.0 * part.size)) for some, part in quarters]
    return parts, correlation


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
        # The scatter of few contacts is uncertain: Student's factor, two directions each.
        scatter *= math.sqrt(count / (count - 1))
        scatter *= float(student.ppf(0.975, 2 * (count - 1))) / 1.96
    noise = math.sqrt(sum(part.noise**2 for part in parts)) / length
    return Axis(direction, max(scatter, noise), basis)
