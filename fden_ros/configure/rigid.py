# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Presses on something rigid, and the compliance that they show in series with the tissue."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from fden_ros.configure.axes import Axes
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.sampling import step_of
from fden_ros.configure.session import Contact, Session
from fden_ros.configure.streams import pooled
from fden_ros.core.arrays import Array
from fden_ros.experiments.regression import linear

#: Delays that are tried [s], and the steps of Gauss and Newton from the best of them.
_DELAYS = np.linspace(-0.03, 0.08, 12)
_STEPS = 4
#: Only the part of a press above this part of its largest force counts.
_LEAST_PUSH = 0.1
#: The force is averaged over this time [s], and at least over 5 of its steps, so that
#: interpolation between samples adds no ripple.
_SMOOTH, _SMOOTH_STEPS = 0.06, 5.0
#: Fewer samples of a press make no line.
_LEAST_SAMPLES = 15
#: Largest residual of a line: 1.5 deviations of the noise, or 2 % of the stroke.
_MOST_NOISE, _MOST_PART = 1.5, 0.02
#: The probe comes and leaves within this time [s], by more than 10 deviations of the noise, and
#: the recording has some chunks before and after.
_COMES, _CLEAR, _AROUND = 1.0, 10.0, 5
#: A rigid press is this many times as stiff as the softest contact of the recordings.
STIFFER = 3.0
#: A compliance is claimed up to this relative deviation: 10 % are then 2.5 deviations. The file
#: has at least this one: a tool bends differently at other places.
_LARGEST_PART, _LEAST_PART = 0.04, 0.02


class Press(NamedTuple):
    """A contact as a line of displacement over force, the delay fitted with it."""

    session: Session
    compliance: float  #: slope of the line [m/N]
    compliance_sd: float
    delay: float  #: of the displacement behind the force [s]
    delay_sd: float
    #: Whether the line fits fully (no relaxation, no bend, no loop), and the probe came,
    #: pressed and left: a surface that meets a probe at rest does not show the tool's compliance.
    is_rigid: bool
    stiffness: float  #: largest force over stroke [N/m]


def rigid_presses(
    sessions: Sequence[Session], axes: Axes, named: Collection[str] = ()
) -> tuple[Press, ...]:
    """Return the presses on something rigid, of any contact or of the recordings `named`."""
    if axes.force is None or axes.displacement is None:
        return ()
    grows, into = axes.force.direction, axes.displacement.direction
    contacts = [(s, contact) for s in sessions if s.leaves for contact in s.contacts]
    presses = [press for one in contacts if (press := _press(*one, grows, into)) is not None]
    softest = min((press.stiffness for press in presses), default=math.inf)

    def is_stiff(press: Press) -> bool:
        softer = max(press.compliance + 2.0 * press.compliance_sd, 1e-12)
        return press.session.streams.name in named or 1.0 / softer > STIFFER * softest

    return tuple(press for press in presses if press.is_rigid and is_stiff(press))


def _press(session: Session, contact: Contact, grows: Array, into: Array) -> Press | None:
    streams = session.streams
    near = np.abs(streams.force_times - 0.5 * (contact.start + contact.end))
    near = near < 0.5 * (contact.end - contact.start) + 0.3
    times = streams.force_times[near]
    level = np.interp(times, session.times, session.baseline @ grows)
    push = session.unloaded[near] @ grows - level
    inside = (streams.motion_times > contact.start) & (streams.motion_times < contact.end)
    stamps, moved = streams.motion_times[inside], streams.position[inside] @ into
    if stamps.size < 20 or push.size < 20:
        return None
    grid, smooth = _smoothed(times, push)
    rate = np.gradient(smooth, grid)

    def design(delay: float, force: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return line, delay and level as columns, and the motion, where the force counts."""
        chosen = np.interp(stamps - delay, grid, smooth) > _LEAST_PUSH * float(push.max())
        at = stamps[chosen] - delay
        columns = [np.interp(at, *force), np.interp(at, grid, rate), np.ones(at.size)]
        return np.stack(columns, axis=1), moved[chosen]

    def misfit(delay: float) -> float:
        columns, motion = design(delay, (grid, smooth))
        return linear(columns[:, ::2], motion).rms if motion.size >= _LEAST_SAMPLES else math.inf

    delay = float(min(_DELAYS, key=misfit))
    for step in range(_STEPS):
        # An average flattens bends, so the final slope is that over the raw force.
        force = (grid, smooth) if step < _STEPS - 1 else (times, push)
        columns, motion = design(delay, force)
        if motion.size < _LEAST_SAMPLES:
            return None
        found = linear(columns, motion)
        slope, late, _ = found.values.tolist()
        delay -= late / (slope if abs(slope) > 1e-12 else 1e-12)
        delay = min(max(delay, float(_DELAYS[0])), float(_DELAYS[-1]))
    sds = found.sds
    coarse = max(step_of(column) for column in streams.position.T) / math.sqrt(12.0)
    noise = max(float(np.linalg.norm(session.motion_noise * into)), coarse)
    limit = max(_MOST_NOISE * noise, _MOST_PART * abs(slope) * float(np.ptp(push)))
    return Press(
        session,
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
    along, times = session.position @ into, session.times
    if contact.first < _AROUND or contact.last > times.size - _AROUND:
        return False
    before = along[(times > contact.start - _COMES) & (times <= contact.start + 0.1)]
    after = along[(times >= contact.end - 0.1) & (times < contact.end + _COMES)]
    return bool(min(np.ptp(before), np.ptp(after)) > _CLEAR * noise)


def compliance_finding(presses: Sequence[Press]) -> Finding:
    """Return the compliance, or its bound where it is too small to measure."""
    if not presses:
        return unknown("compliance", "no press on something rigid was seen")
    value, sd = pooled([one.compliance for one in presses], [one.compliance_sd for one in presses])
    evidence = f"{len(presses)} presses in which the displacement is linear in the force"
    least_sd = max(sd, _LEAST_PART * value, 1e-7)
    if sd > _LARGEST_PART * abs(value):
        value = max(value, 0.0)
        evidence = (
            f"too small to measure: below {1e3 * (value + 2 * sd):.2g} mm/N, from {evidence}"
        )
    elif value < 0.0:
        evidence = f"the probe moves back as the force rises, in {evidence}: not one axis"
        return unknown("compliance", evidence)
    values = {
        "displacement.compliance": float(f"{value:.5g}"),
        "displacement.compliance_sd": float(f"{least_sd:.3g}"),
    }
    return Finding("compliance", value, sd, evidence, parameters=values)
