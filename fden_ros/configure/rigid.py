"""Presses on something rigid: displacement in proportion to force, at once, and far stiffer."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from fden_ros.configure.axes import Axes, Axis
from fden_ros.configure.sampling import step_of
from fden_ros.configure.session import Contact, Session
from fden_ros.configure.statistics import Fit, fit
from fden_ros.configure.streams import Array

#: Delays that are searched [s].
_EARLIEST, _LATEST = -0.03, 0.08
#: The part of a press that counts: above this share of its largest force.
_LEAST_PUSH = 0.1
#: What a line may leave: 1.5 deviations of the noise, or 2 % of the stroke.
_MOST_NOISE, _MOST_SHARE = 1.5, 0.02
#: The probe comes and leaves within this time [s], by more than 10 deviations of the noise, and
#: the recording goes on around it for some chunks.
_COMES = 1.0
_CLEAR = 10.0
_AROUND = 5
#: A rigid press is this many times as stiff as the softest contact of the recordings.
STIFFER = 3.0


@dataclass(frozen=True)
class Press:
    """A contact as a line of displacement over force, the delay fitted with it.

    Parameters
    ----------
    session, contact
        Where it is.
    compliance, compliance_sd : float
        Slope [m/N].
    delay, delay_sd : float
        Of the displacement behind the force [s].
    is_line : bool
        Whether the line is all there is: no relaxation, no bend, no loop.
    is_whole : bool
        Whether the probe came, pressed and left: a surface that comes to a probe at rest shows
        nothing of the tool.
    stiffness : float
        Largest force over stroke [N/m].
    """

    session: Session
    contact: Contact
    compliance: float
    compliance_sd: float
    delay: float
    delay_sd: float
    is_line: bool
    is_whole: bool
    stiffness: float


def rigid_presses(
    sessions: Sequence[Session], axes: Axes, named: Collection[str] = ()
) -> tuple[Press, ...]:
    """Return the presses on something rigid.

    Parameters
    ----------
    sessions : sequence of Session
        In SI units.
    axes : Axes
    named : collection of str
        Recordings of which it is known that something rigid was pressed.
    """
    presses = contact_lines(sessions, axes)
    softest = min((press.stiffness for press in presses), default=math.inf)
    return tuple(
        press
        for press in presses
        if press.is_line
        and press.is_whole
        and (
            press.session.streams.name in named
            or 1.0 / max(press.compliance + 2.0 * press.compliance_sd, 1e-12) > STIFFER * softest
        )
    )


def contact_lines(sessions: Sequence[Session], axes: Axes) -> tuple[Press, ...]:
    """Return every contact from the air on as a line of displacement over force."""
    if axes.force is None or axes.displacement is None:
        return ()
    return tuple(
        press
        for session in sessions
        if session.leaves
        for contact in session.contacts
        if (press := _press(session, contact, axes)) is not None
    )


def _press(session: Session, contact: Contact, axes: Axes) -> Press | None:
    assert axes.force is not None and axes.displacement is not None
    streams = session.streams
    force_times = streams.force_times
    near = (force_times > contact.start - 0.3) & (force_times < contact.end + 0.3)
    times = force_times[near]
    level = np.interp(times, session.times, session.baseline @ axes.force.direction)
    push = session.unloaded[near] @ axes.force.direction - level
    inside = (streams.motion_times > contact.start) & (streams.motion_times < contact.end)
    stamps = streams.motion_times[inside]
    way = streams.position[inside] @ axes.displacement.direction
    if stamps.size < 20 or push.size < 20:
        return None
    least = _LEAST_PUSH * float(push.max())
    thin = max(stamps.size // 3000, 1)

    def line(delay: float, some: int = 1) -> tuple[Fit, NDArray[np.intp]] | None:
        at = np.interp(stamps[::some] - delay, times, push)
        chosen = at > least
        if chosen.sum() < 15:
            return None
        design = np.stack([np.ones(int(chosen.sum())), at[chosen]], axis=1)
        return fit(design, way[::some][chosen]), np.flatnonzero(chosen)

    def misfit(delay: float) -> float:
        found = line(delay, thin)
        return math.inf if found is None else found[0].sd

    grid = np.linspace(_EARLIEST, _LATEST, 12)
    misfits = [misfit(float(delay)) for delay in grid]
    if not np.isfinite(misfits).any():
        return None
    best = int(np.nanargmin(misfits))
    delay = float(
        minimize_scalar(
            misfit,
            bounds=(float(grid[max(best - 1, 0)]), float(grid[min(best + 1, grid.size - 1)])),
            method="bounded",
            options={"xatol": 2e-5},
        ).x
    )
    found = line(delay)
    if found is None:
        return None
    straight, chosen = found
    slope = float(straight.solution[1])
    rate = _rate(times, push, stamps[chosen] - delay)
    design = np.stack([np.ones(chosen.size), np.interp(stamps[chosen] - delay, times, push)], 1)
    beside = fit(design, slope * rate).residual
    spread = float(straight.covariance[1, 1]) / max(
        straight.sd**2 * float(np.linalg.pinv(design.T @ design)[1, 1]), 1e-300
    )
    delay_sd = straight.sd * math.sqrt(spread / max(float(beside @ beside), 1e-300))
    noise = float(np.linalg.norm(session.motion_noise * axes.displacement.direction))
    steps = [step_of(column) or 0.0 for column in streams.position.T]
    noise = max(noise, max(steps) / math.sqrt(12.0))
    stroke = abs(slope) * float(np.ptp(push))
    return Press(
        session,
        contact,
        slope,
        # The delay is fitted beside the slope; they hardly disturb each other over a whole press.
        math.sqrt(float(straight.covariance[1, 1])),
        delay,
        delay_sd,
        straight.sd < max(_MOST_NOISE * noise, _MOST_SHARE * stroke),
        _is_whole(session, contact, axes.displacement, noise),
        float(push.max()) / max(float(np.ptp(way)), 1e-9),
    )


def _is_whole(session: Session, contact: Contact, axis: Axis, noise: float) -> bool:
    along = session.position @ axis.direction
    before = (session.times > contact.start - _COMES) & (session.times <= contact.start + 0.1)
    after = (session.times >= contact.end - 0.1) & (session.times < contact.end + _COMES)
    if contact.first < _AROUND or contact.last > session.times.size - _AROUND:
        return False
    return bool(min(np.ptp(along[before]), np.ptp(along[after])) > _CLEAR * noise)


def _rate(times: Array, push: Array, at: Array) -> Array:
    """Return how fast the force changes [N/s], over 60 ms, at `at`."""
    half = 0.03
    ahead, behind = (np.interp(at + shift, times, push) for shift in (half, -half))
    return np.asarray((ahead - behind) / (2.0 * half))
