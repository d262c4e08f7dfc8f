# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Rate, noise and resolution of a stream."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fden_ros.configure.axes import Axis
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.session import Mask, Session, runs
from fden_ros.configure.statistics import noise_of
from fden_ros.core.arrays import Array

#: A gap is ten usual steps and at least this long [s].
_GAP_STEPS, _GAP = 10.0, 0.02
#: Values are in steps where no more than this share of them are different.
_REPEATED = 0.5
#: The rate that a contact of a second needs [Hz]; below, touches are seen late.
_SLOW = 50.0
#: White noise stays the same within this share where every other sample is left out.
_SAME = 0.15
#: Fewer samples at rest do not tell the noise.
_LEAST = 60


def sampling_findings(
    what: str, sessions: Sequence[Session], axis: Axis | None
) -> tuple[Finding, ...]:
    """Return rate, noise and resolution of ``force`` or ``displacement``."""
    return (
        _rate(what, sessions),
        _noise(what, sessions, axis),
        _resolution(what, sessions),
    )


def _values(what: str, session: Session) -> tuple[Array, Array]:
    streams = session.streams
    if what == "force":
        return streams.force_times, streams.force
    return streams.motion_times, streams.position


def _rate(what: str, sessions: Sequence[Session]) -> Finding:
    steps, gaps, longest = [], 0, 0.0
    for session in sessions:
        step = np.diff(_values(what, session)[0])
        usual = float(np.median(step))
        is_gap = (step > _GAP_STEPS * usual) & (step > _GAP)
        gaps += int(is_gap.sum())
        longest = max(longest, float(step[is_gap].max(initial=0.0)))
        steps.append(step[~is_gap])
    step = np.concatenate(steps)
    mean, jitter = float(step.mean()), float(step.std())
    rate = 1.0 / mean
    evidence = f"jitter {1e3 * jitter:.2g} ms"
    if gaps:
        evidence += f", {gaps} gaps, the longest {longest:.2g} s"
    motion = "" if rate >= _SLOW else f"raise the rate: below {_SLOW:g} Hz touches are seen late"
    sd = rate * jitter / mean / math.sqrt(step.size)
    return Finding(f"{what} rate", True, rate, sd, "Hz", _all(sessions), evidence, motion)


def _noise(what: str, sessions: Sequence[Session], axis: Axis | None) -> Finding:
    subject, unit = f"{what} noise", "N" if what == "force" else "m"
    squares, count = 0.0, 0
    for session in sessions:
        times, values = _values(what, session)
        inside = _at_rest(session, times)
        line = (
            values @ axis.direction
            if axis is not None
            else values.mean(axis=1) * math.sqrt(values.shape[1])
        )
        for start, stop in runs(inside):
            part, at = line[start:stop], times[start:stop]
            if part.size < 8:
                continue
            step = np.diff(at)
            share = step[:-1] / (step[:-1] + step[1:])
            apart = part[1:-1] - (1.0 - share) * part[:-2] - share * part[2:]
            apart /= np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
            squares += float(apart @ apart)
            count += apart.size
    if count >= _LEAST:
        value = math.sqrt(squares / count)
        # Neighbouring distances share samples: the sum of their squared correlations is 1.94.
        sd = value * math.sqrt(1.94 / (2.0 * count))
        evidence = f"{count} samples at rest in the air"
        rounded = max(step_of(c) or 0.0 for s in sessions for c in _values(what, s)[1].T)
        if rounded > 2.0 * value:
            # Such steps hide the noise: what is left is the error of rounding.
            value = rounded / math.sqrt(12.0)
            sd = 0.2 * value
            evidence = "that of rounding: the values come in larger steps than the noise"
        return Finding(subject, True, value, sd, unit, _all(sessions), evidence)
    noises = [_in_motion(*_values(what, session)) for session in sessions]
    if not noises or not math.isfinite(noises[0][0]):
        return unknown(subject, "too few samples", "hold still in the air for 2 s")
    value = float(np.mean([one for one, _ in noises]))
    white = all(is_white for _, is_white in noises)
    return Finding(
        subject,
        white,
        value,
        0.1 * value if white else None,
        unit,
        _all(sessions),
        "from samples in motion, which lie that far from the lines between their neighbours",
        "" if white else "hold still in the air for 2 s",
    )


def _in_motion(times: Array, values: Array) -> tuple[float, bool]:
    """Return the noise of moving samples, and whether it is: the same of every other sample."""
    noise = float(np.median(noise_of(times, values)))
    thinned = float(np.median(noise_of(times[::2], values[::2])))
    return noise, abs(thinned - noise) < _SAME * noise


def _at_rest(session: Session, times: Array) -> Mask:
    """Return which samples are in chunks in the air in which the probe neither moves nor turns."""
    steps = np.zeros(session.times.size)
    moved = np.linalg.norm(np.diff(session.position, axis=0), axis=1)
    steps[1:] = moved
    steps[:-1] = np.maximum(steps[:-1], moved)
    noise = float(np.linalg.norm(session.motion_noise))
    rest = session.air & (steps < 4.0 * noise) & ~session.turning
    chunk = np.searchsorted(session.edges, times, side="right") - 1
    inside = (chunk >= 0) & (chunk < rest.size)
    mask = np.zeros(times.size, dtype=bool)
    mask[inside] = rest[chunk[inside]]
    return mask


def _resolution(what: str, sessions: Sequence[Session]) -> Finding:
    subject, unit = f"{what} resolution", "N" if what == "force" else "m"
    steps = []
    for session in sessions:
        for column in _values(what, session)[1].T:
            step = step_of(column)
            if step is None:
                return Finding(
                    subject,
                    True,
                    None,
                    None,
                    unit,
                    _all(sessions),
                    "no steps are seen: finer than the noise",
                )
            steps.append(step)
    step = float(np.median(steps))
    return Finding(subject, True, step, 0.0, unit, _all(sessions), "values come in steps")


def step_of(values: Array) -> float | None:
    """Return the step in which values come; None where there is none."""
    different = np.unique(values)
    if different.size > _REPEATED * values.size or different.size < 4:
        return None
    gaps = np.diff(different)
    gaps = gaps[gaps > 1e-9 * max(float(np.abs(different).max()), 1e-30)]
    if not gaps.size:
        return None
    step = float(np.quantile(gaps, 0.1))
    # The least gap that is common, refined by all that are whole multiples of it.
    whole = np.round(gaps / step)
    step = float((gaps @ whole) / (whole @ whole))
    off = np.abs(gaps / step - np.round(gaps / step))
    return step if float(np.mean(off < 0.05)) > 0.95 else None


def _all(sessions: Sequence[Session]) -> tuple[tuple[float, float], ...]:
    return tuple((0.0, s.streams.end - s.streams.start) for s in sessions)
