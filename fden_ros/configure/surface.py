# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The surface's normal, from where the probe first touched at several places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fden_ros.configure.axes import Axes
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.plane import LEAST_UNSTATED, NoPlaneError, SurfacePlane, fit_plane
from fden_ros.configure.rigid import Press
from fden_ros.configure.session import Contact, Session
from fden_ros.core.arrays import Array
from fden_ros.core.contact.surface import find_surface

_RECORD = "record poses of the probe, and press tissue"
#: A touch this near to an earlier one [m] is of tissue that was pressed.
_SAME_PLACE = 3e-3
#: The approach is looked at for this time [s] before the force shows the contact.
_APPROACH = 1.0
#: The order that the onset is sought with; the same as the default prior's mean.
_ORDER = 0.2
#: Fewer samples of an approach show no onset; places are averaged over this time [s].
_LEAST_SAMPLES, _AVERAGED = 24, 0.03
#: Deviation of a delay that is not known [s]: 0 to 30 ms are usual.
_DELAY_SD = 0.01
#: A surface moves by this with breathing and heartbeat [m], where too few touches show it.
_MOTION_SD = 2e-4
#: A tilt of more than this [rad] is one that costs (0.4 % of the depth).
_ASKEW = math.radians(5.0)


@dataclass(frozen=True)
class Touch:
    """A first touch."""

    place: Array  #: (3,) [m]
    sd: float  #: along the approach [m]
    approach: Array  #: its direction (3,)
    speed: float  #: [m/s]
    seconds: tuple[float, float]  #: of the contact, since the first stamp


@dataclass(frozen=True)
class Scan:
    """The touches of a recording at places of their own, and the plane if they show one."""

    touches: tuple[Touch, ...]
    plane: SurfacePlane | None
    finding: Finding


def find_surface_plane(
    sessions: Sequence[Session],
    axes: Axes,
    presses: Sequence[Press],
    delay: Finding,
    unit: Finding,
) -> Scan:
    """Fit the surface of that recording which holds most touches.

    Parameters
    ----------
    sessions : sequence of Session
        In SI units.
    axes : Axes
    presses : sequence of Press
        Those on something rigid: they are left out.
    delay, unit : Finding
        Of the displacement.
    """
    why, motion = "", _RECORD
    if axes.force is None:
        why = "no touch is placed without the axis of the force"
    elif sessions[0].position.shape[1] != 3:
        why = "no touch is placed without places in space"
    elif not unit.claim:
        why, motion = "the unit is not known", "say which unit it is"
    if why:
        return Scan((), None, unknown("surface normal", why, motion))
    late = delay.value if delay.claim and isinstance(delay.value, float) else 0.0
    late_sd = (delay.deviation or 0.0) if delay.claim else _DELAY_SD
    rigid = {(id(press.session), press.contact) for press in presses}
    touches: list[Touch] = []
    for session in sessions:
        contacts = [one for one in session.contacts if (id(session), one) not in rigid]
        found = [_touch(session, contact, axes, late) for contact in contacts if session.leaves]
        touches = max(touches, _at_own_places([one for one in found if one is not None]), key=len)
    return _fitted(touches, late_sd)


def _fitted(touches: Sequence[Touch], late_sd: float) -> Scan:
    if not touches:
        return Scan((), None, unknown("surface normal", "no touch was seen"))
    into = np.mean([touch.approach for touch in touches], axis=0)
    speeds = np.array([touch.speed for touch in touches])
    # A delay shifts all touches alike as far as they come at one speed.
    sds = np.hypot([touch.sd for touch in touches], late_sd * (speeds - speeds.mean()))
    if len(touches) < LEAST_UNSTATED:
        sds = np.hypot(sds, _MOTION_SD)
    seconds = tuple(touch.seconds for touch in touches)
    try:
        plane = fit_plane([touch.place for touch in touches], into, sds)
    except NoPlaneError as error:
        none = unknown("surface normal", error.reason, error.remedy, seconds=seconds)
        return Scan(tuple(touches), None, none)
    value = tuple(float(part) for part in plane.normal)
    evidence = (
        f"within {math.degrees(plane.sd):.2g} degrees, by a plane through {len(touches)} touches "
        f"that lie {1e3 * plane.flatness:.2g} mm off it; "
        + _askew([plane.tilt(touch.approach) for touch in touches])
    )
    told = {"surface.normal": [round(part, 4) for part in value]}
    found = Finding("surface normal", value, plane.sd, evidence, seconds, parameters=told)
    return Scan(tuple(touches), plane, found)


def _askew(tilts: Sequence[tuple[float, float]]) -> str:
    """Return how far the probe comes from upright, and what that costs."""
    tilt, sd = max(tilts)
    words = f"the probe comes {math.degrees(tilt):.1f} ± {math.degrees(sd):.1f} degrees askew"
    if tilt < _ASKEW:
        return f"{words}, which costs nothing that shows"
    return (
        f"{words}: the depth is {math.cos(tilt):.3f} of its way, and a flat face touches by its "
        "edge first; counts with displacement.along_tool, else set displacement.axis to it"
    )


def _at_own_places(touches: Sequence[Touch]) -> list[Touch]:
    """Return the first touch of every place."""
    chosen: list[Touch] = []
    for touch in touches:
        apart = [touch.place - other.place for other in chosen]
        aside = [away - (away @ touch.approach) * touch.approach for away in apart]
        if all(float(np.linalg.norm(away)) > _SAME_PLACE for away in aside):
            chosen.append(touch)
    return chosen


def _touch(session: Session, contact: Contact, axes: Axes, late: float) -> Touch | None:
    """Return where a contact began; None where it does not begin in the air."""
    assert axes.force is not None
    shown = float(session.edges[min(contact.first + 2, session.times.size)])
    streams, start = session.streams, contact.start - _APPROACH
    before = (session.times > start) & (session.times < contact.start)
    inside = (streams.force_times >= start) & (streams.force_times < shown)
    if start < streams.start or not session.air[before].all() or inside.sum() < _LEAST_SAMPLES:
        return None
    direction = _direction(session, contact, axes)
    times = streams.force_times[inside]
    base = [np.interp(times, session.times, column) for column in session.baseline.T]
    push = (session.unloaded[inside] - np.stack(base, axis=1)) @ axes.force.direction
    # The stamps of the displacement are late.
    places = streams.position_at(times + late)
    way = places @ direction
    surface = find_surface(times, push, way, _ORDER)
    if surface.first == 0:
        return None
    index = min(surface.first, times.size - 1)
    around = max(2, int(np.sum(np.abs(times - times[index]) <= 0.5 * _AVERAGED)) // 2)
    near = slice(max(index - around, 0), index + around + 1)
    slope, place = np.polyfit(times[near] - times[index], places[near], 1)
    place = place + (surface.displacement - float(place @ direction)) * direction
    noise = float(np.mean(session.motion_noise))
    return Touch(
        place,
        math.hypot(surface.displacement_sd, noise),
        direction,
        float(slope @ direction),
        (contact.start - streams.start, contact.end - streams.start),
    )


def _direction(session: Session, contact: Contact, axes: Axes) -> Array:
    """Return the direction of the approach: the axis, else the way to the deepest point."""
    assert axes.force is not None
    if axes.displacement is not None and axes.displacement.is_stated:
        return axes.displacement.direction
    push = session.net[contact.span] @ axes.force.direction
    deepest = contact.first + int(np.argmax(push))
    way = session.position[deepest] - session.position[max(contact.first - 1, 0)]
    return np.asarray(way / max(float(np.linalg.norm(way)), 1e-12))
