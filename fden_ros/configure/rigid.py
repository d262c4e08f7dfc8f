# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Presses on something rigid, and the compliance in series with the tissue that they show."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from fden_ros.configure.axes import Axes
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.sampling import step_of
from fden_ros.configure.session import Contact, Session
from fden_ros.configure.statistics import pooled
from fden_ros.core.arrays import Array
from fden_ros.experiments.regression import linear

#: Delays that are tried [s], and the steps of Gauss and Newton from the best of them.
_DELAYS = np.linspace(-0.03, 0.08, 12)
_STEPS = 4
#: The part of a press that counts: above this part of its largest force.
_LEAST_PUSH = 0.1
#: The force is averaged over this time [s], and at least over 5 of its steps, so that reading it
#: between samples adds no ripple.
_SMOOTH, _SMOOTH_STEPS = 0.06, 5.0
#: Fewer samples of a press make no line.
_LEAST_SAMPLES = 15
#: What a line may leave: 1.5 deviations of the noise, or 2 % of the stroke.
_MOST_NOISE, _MOST_PART = 1.5, 0.02
#: The probe comes and leaves within this time [s], by more than 10 deviations of the noise, and
#: the recording goes on around it for some chunks.
_COMES = 1.0
_CLEAR = 10.0
_AROUND = 5
#: A rigid press is this many times as stiff as the softest contact of the recordings.
STIFFER = 3.0
#: A compliance is stated as such up to this relative deviation: 10 % are then 2.5 deviations.
_LARGEST_PART = 0.04
#: Least deviation, relative, in the file: a tool bends differently at other places.
_LEAST_PART = 0.02


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
    is_rigid : bool
        Whether the line is all there is (no relaxation, no bend, no loop), and the probe came,
        pressed and left: a surface that comes to a probe at rest shows nothing of the tool.
    stiffness : float
        Largest force over stroke [N/m].
    """

    session: Session
    contact: Contact
    compliance: float
    compliance_sd: float
    delay: float
    delay_sd: float
    is_rigid: bool
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
    if axes.force is None or axes.displacement is None:
        return ()
    contacts = [(s, contact) for s in sessions if s.leaves for contact in s.contacts]
    presses = [press for one in contacts if (press := _press(*one, axes)) is not None]
    softest = min((press.stiffness for press in presses), default=math.inf)

    def is_stiff(press: Press) -> bool:
        softer = max(press.compliance + 2.0 * press.compliance_sd, 1e-12)
        return press.session.streams.name in named or 1.0 / softer > STIFFER * softest

    return tuple(press for press in presses if press.is_rigid and is_stiff(press))


def _press(session: Session, contact: Contact, axes: Axes) -> Press | None:
    assert axes.force is not None and axes.displacement is not None
    streams, into = session.streams, axes.displacement.direction
    near = np.abs(streams.force_times - 0.5 * (contact.start + contact.end))
    near = near < 0.5 * (contact.end - contact.start) + 0.3
    times = streams.force_times[near]
    level = np.interp(times, session.times, session.baseline @ axes.force.direction)
    push = session.unloaded[near] @ axes.force.direction - level
    inside = (streams.motion_times > contact.start) & (streams.motion_times < contact.end)
    stamps, moved = streams.motion_times[inside], streams.position[inside] @ into
    if stamps.size < 20 or push.size < 20:
        return None
    grid, smooth = _smoothed(times, push)
    rate = np.gradient(smooth, grid)

    def design(delay: float, force: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return line, delay and level as columns, and the motion, where the force counts."""
        at = stamps - delay
        chosen = np.interp(at, grid, smooth) > _LEAST_PUSH * float(push.max())
        at = at[chosen]
        columns = [np.interp(at, *force), np.interp(at, grid, rate), np.ones(at.size)]
        return np.stack(columns, axis=1), moved[chosen]

    def misfit(delay: float) -> float:
        columns, motion = design(delay, (grid, smooth))
        return linear(columns[:, ::2], motion).rms if motion.size >= _LEAST_SAMPLES else math.inf

    misfits = [misfit(float(delay)) for delay in _DELAYS]
    if not np.isfinite(misfits).any():
        return None
    delay = float(_DELAYS[int(np.argmin(misfits))])
    for step in range(_STEPS):
        # An average flattens bends, so the slope at last is that over the force as it is.
        force = (grid, smooth) if step < _STEPS - 1 else (times, push)
        columns, motion = design(delay, force)
        if motion.size < _LEAST_SAMPLES:
            return None
        found = linear(columns, motion)
        slope = float(found.values[0])
        late = -float(found.values[1]) / (slope if abs(slope) > 1e-12 else 1e-12)
        delay = min(max(delay + late, float(_DELAYS[0])), float(_DELAYS[-1]))
    sds = found.sds
    noise = float(np.linalg.norm(session.motion_noise * into))
    steps = [step_of(column) or 0.0 for column in streams.position.T]
    noise = max(noise, max(steps) / math.sqrt(12.0))
    limit = max(_MOST_NOISE * noise, _MOST_PART * abs(slope) * float(np.ptp(push)))
    return Press(
        session,
        contact,
        slope,
        float(sds[0]),
        delay,
        float(sds[1]) / max(abs(slope), 1e-12),
        found.rms < limit and _is_whole(session, contact, into, noise),
        float(push.max()) / max(float(np.ptp(moved)), 1e-9),
    )


def _smoothed(times: Array, push: Array) -> tuple[Array, Array]:
    """Return an even grid of times, and the force averaged there."""
    step = float(np.median(np.diff(times)))
    fine = min(step, 1e-3)
    grid = np.arange(times[0], times[-1], fine)
    width = max(round(max(_SMOOTH, _SMOOTH_STEPS * step) / fine), 1)
    return grid, uniform_filter1d(np.interp(grid, times, push), width, mode="nearest")


def _is_whole(session: Session, contact: Contact, into: Array, noise: float) -> bool:
    along = session.position @ into
    before = (session.times > contact.start - _COMES) & (session.times <= contact.start + 0.1)
    after = (session.times >= contact.end - 0.1) & (session.times < contact.end + _COMES)
    if contact.first < _AROUND or contact.last > session.times.size - _AROUND:
        return False
    return bool(min(np.ptp(along[before]), np.ptp(along[after])) > _CLEAR * noise)


def compliance_finding(presses: Sequence[Press]) -> Finding:
    """Return the compliance, or its bound where it is too small to measure."""
    if not presses:
        return unknown("compliance", "no press on something rigid was seen")
    found = [press.compliance for press in presses]
    value, sd = pooled(found, [press.compliance_sd for press in presses])
    seconds = tuple(press.session.seconds((press.contact,))[0] for press in presses)
    evidence = f"{len(presses)} presses in which the displacement is a line of the force"
    least_sd = max(sd, _LEAST_PART * value, 1e-7)
    if sd > _LARGEST_PART * abs(value):
        value = max(value, 0.0)
        limit = 1e3 * (value + 2.0 * sd)
        evidence = f"too small to measure: below {limit:.2g} mm/N, by {evidence}"
    elif value < 0.0:
        evidence = f"the probe goes back as the force rises, by {evidence}: not one axis"
        return unknown("compliance", evidence)
    values = {
        "displacement.compliance": float(f"{value:.5g}"),
        "displacement.compliance_sd": float(f"{least_sd:.3g}"),
    }
    return Finding("compliance", value, sd, evidence, seconds, parameters=values)
