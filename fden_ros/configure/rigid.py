# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Presses on something rigid, and the compliance in series with the tissue that they show."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from fden_ros.configure.axes import Axes, Axis
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.sampling import step_of
from fden_ros.configure.session import Contact, Mask, Session
from fden_ros.configure.statistics import Fit, fit, inflation
from fden_ros.core.arrays import Array

#: Delays that are searched [s].
_EARLIEST, _LATEST = -0.03, 0.08
#: The part of a press that counts: above this share of its largest force.
_LEAST_PUSH = 0.1
#: The force is averaged over this time [s], and at least over 5 of its steps.
_SMOOTH, _SMOOTH_STEPS = 0.06, 5.0
#: Fewer samples of a press make no line.
_LEAST_SAMPLES = 15
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
    force = _Smooth(times, push)
    least = _LEAST_PUSH * float(push.max())
    thin = max(stamps.size // 3000, 1)

    def chosen_at(delay: float) -> Mask:
        return np.asarray(force.at(stamps - delay) > least)

    def line(delay: float, chosen: Mask) -> Fit:
        at = force.at(stamps[chosen] - delay)
        return fit(np.stack([np.ones(at.size), at], axis=1), way[chosen])

    def misfit(delay: float, chosen: Mask) -> float:
        some = chosen.copy()
        some[np.arange(some.size) % thin > 0] = False
        return line(delay, some).sd if some.sum() >= _LEAST_SAMPLES else math.inf

    grid = np.linspace(_EARLIEST, _LATEST, 12)
    misfits = [misfit(float(one), chosen_at(float(one))) for one in grid]
    if not np.isfinite(misfits).any():
        return None
    delay, reach = float(grid[int(np.argmin(misfits))]), float(grid[1] - grid[0])
    for _ in range(2):
        # With the same samples throughout: which ones are in would change the misfit as well.
        chosen = chosen_at(delay)
        if chosen.sum() < _LEAST_SAMPLES:
            return None
        bounds = (delay - reach, delay + reach)
        found = minimize_scalar(
            misfit, bounds=bounds, args=(chosen,), method="bounded", options={"xatol": 1e-5}
        )
        delay = float(found.x)
    # An average flattens bends, so the slope is that over the force as it is.
    at = stamps[chosen] - delay
    design = np.stack([np.ones(at.size), np.interp(at, times, push)], axis=1)
    straight = fit(design, way[chosen])
    slope = float(straight.solution[1])
    beside = fit(design, slope * force.rate(at)).residual
    spread = inflation(straight.residual)
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


class _Smooth:
    """A force averaged over a short time, so that reading it between samples adds no ripple.

    Parameters
    ----------
    times, push : Array
        Samples [s], [N], shape (n,).
    """

    def __init__(self, times: Array, push: Array) -> None:
        step = float(np.median(np.diff(times)))
        self._times, self._push = times, push
        self._width = max(_SMOOTH, _SMOOTH_STEPS * step)
        self._grid = np.arange(times[0], times[-1], min(step, 1e-3))
        fine = np.interp(self._grid, times, push)
        steps = 0.5 * (fine[1:] + fine[:-1]) * np.diff(self._grid)
        self._integral = np.concatenate([[0.0], np.cumsum(steps)])

    def at(self, instants: Array) -> Array:
        """Return the mean force about `instants` [N]."""
        return self._difference(instants, self._grid, self._integral)

    def rate(self, instants: Array) -> Array:
        """Return how fast it changes [N/s]."""
        return self._difference(instants, self._times, self._push)

    def _difference(self, instants: Array, times: Array, values: Array) -> Array:
        half = 0.5 * self._width
        ahead, behind = (np.interp(instants + shift, times, values) for shift in (half, -half))
        return np.asarray((ahead - behind) / self._width)


#: A compliance is stated as such up to this relative deviation: 10 % are then 2.5 deviations.
_LARGEST_SHARE = 0.04
#: Least deviation, relative, in the file: a tool bends differently at other places.
_LEAST_SHARE = 0.02
_MOTION = (
    "press a rigid plate twice, slowly, to the largest force of your presses, and in the same "
    "recording press tissue (or say that the recording is of a rigid plate: --rigid)"
)


def compliance_finding(presses: Sequence[Press]) -> Finding:
    """Return the compliance, or its bound where it is too small to measure."""
    subject = "compliance"
    if not presses:
        return unknown(subject, "no press on something rigid was seen", _MOTION)
    values = np.array([press.compliance for press in presses])
    sds = np.array([press.compliance_sd for press in presses])
    weights = 1.0 / sds**2
    value = float(weights @ values / weights.sum())
    sd = math.sqrt(1.0 / float(weights.sum()))
    chi = float(np.sum(((values - value) / sds) ** 2)) / max(len(presses) - 1, 1)
    sd *= math.sqrt(max(chi, 1.0))
    seconds = tuple(press.session.seconds((press.contact,))[0] for press in presses)
    count = f"{len(presses)} presses in which the displacement is a line of the force"
    if sd > _LARGEST_SHARE * abs(value):
        limit = max(value, 0.0) + 2.0 * sd
        return Finding(
            subject,
            True,
            max(value, 0.0),
            sd,
            "m/N",
            seconds,
            f"too small to measure: below {1e3 * limit:.2g} mm/N, by {count}",
            parameters={
                "displacement.compliance": round(max(value, 0.0), 9),
                "displacement.compliance_sd": round(max(sd, 1e-7), 9),
            },
        )
    if value < 0.0:
        return unknown(
            subject, f"the probe goes back as the force rises, by {count}: not one axis", _MOTION
        )
    return Finding(
        subject,
        True,
        value,
        sd,
        "m/N",
        seconds,
        count,
        parameters={
            "displacement.compliance": float(f"{value:.5g}"),
            "displacement.compliance_sd": float(f"{max(sd, _LEAST_SHARE * value):.3g}"),
        },
    )
