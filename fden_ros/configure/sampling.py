# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the streams are by themselves and in the air: rate, noise, resolution, bias, drift."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import signal

from fden_ros.configure.axes import Axis
from fden_ros.configure.filtering import Filter, find_filter
from fden_ros.configure.finding import Finding, Seconds, unknown
from fden_ros.configure.session import Mask, Session, runs
from fden_ros.configure.statistics import apart_from_neighbours, noise_of, pooled
from fden_ros.core.arrays import Array
from fden_ros.core.contact import ContactConfig
from fden_ros.core.oscillation import PalpationFrequency
from fden_ros.core.parameter import TINY
from fden_ros.core.strokes import REMEDY
from fden_ros.experiments.regression import linear
from fden_ros.parameters import Value

#: A gap is ten usual steps and at least this long [s].
_GAP_STEPS, _GAP = 10.0, 0.02
#: Values are in steps where no more than this part of them are different.
_REPEATED = 0.5
#: The rate that a contact of a second needs [Hz].
_SLOW = 50.0
#: White noise stays the same within this part where every other sample is left out.
_SAME = 0.15
#: Fewer samples at rest do not tell the noise.
_LEAST = 60
#: The air that a bias rests on: the first stretch of at least this long, up to 5 s.
_LEAST_AIR, _MOST = 1.0, 5.0
#: A drift is known from air that is spread over at least this time [s].
_SPREAD = 10.0
#: `force.drift_sd` stays at its default up to this drift [N/s].
_DEFAULT_DRIFT = 0.005


def sampling_findings(
    stream: str, sessions: Sequence[Session], axis: Axis | None
) -> tuple[Finding, ...]:
    """Return rate, noise and resolution of ``force`` or ``displacement``."""
    return _rate(stream, sessions), _noise(stream, sessions, axis), _resolution(stream, sessions)


def _values(stream: str, session: Session) -> tuple[Array, Array]:
    streams = session.streams
    if stream == "force":
        return streams.force_times, streams.force
    return streams.motion_times, streams.position


def _all(sessions: Sequence[Session]) -> Seconds:
    return tuple((0.0, s.streams.end - s.streams.start) for s in sessions)


def _rate(stream: str, sessions: Sequence[Session]) -> Finding:
    steps = np.concatenate([np.diff(_values(stream, session)[0]) for session in sessions])
    # Samples that come in bursts have a usual step of nearly 0.
    usual = max(float(np.median(steps)), float(steps.mean()))
    is_gap = (steps > _GAP_STEPS * usual) & (steps > _GAP)
    mean, jitter = float(steps[~is_gap].mean()), float(steps[~is_gap].std())
    evidence = f"jitter {1e3 * jitter:.2g} ms"
    if is_gap.any():
        evidence += f", {is_gap.sum()} gaps, the longest {steps[is_gap].max():.2g} s"
    slow = f"raise the rate: below {_SLOW:g} Hz touches are seen late"
    motion = "" if 1.0 / mean >= _SLOW else slow
    sd = jitter / mean**2 / math.sqrt(steps.size)
    return Finding(f"{stream} rate", 1.0 / mean, sd, evidence, _all(sessions), motion)


def _noise(stream: str, sessions: Sequence[Session], axis: Axis | None) -> Finding:
    subject, apart = f"{stream} noise", []
    for session in sessions:
        times, values = _values(stream, session)
        # Without an axis all components count, which scatter alike.
        size = math.sqrt(values.shape[1])
        line = values @ (np.full(values.shape[1], 1.0 / size) if axis is None else axis.direction)
        for start, stop in runs(_at_rest(session, times)):
            if stop - start >= 8:
                part = slice(start, stop)
                apart.append(apart_from_neighbours(times[part], line[part, None]).ravel())
    if stream == "force" and find_force_filter(sessions, axis) is not None:
        return _smooth_noise(sessions, axis)
    count = sum(part.size for part in apart)
    if count < _LEAST:
        return _noise_in_motion(stream, sessions)
    value = float(np.sqrt(np.mean(np.concatenate(apart) ** 2)))
    # Neighbouring distances share samples: the sum of their squared correlations is 1.94.
    sd = value * math.sqrt(1.94 / (2.0 * count))
    evidence = f"{count} samples at rest in the air"
    rounded = max(step_of(c) or 0.0 for s in sessions for c in _values(stream, s)[1].T)
    if rounded > 2.0 * value:
        # Such steps hide the noise: what is left is the error of rounding.
        value = rounded / math.sqrt(12.0)
        sd = 0.2 * value
        evidence = "that of rounding: the values come in larger steps than the noise"
    floor: dict[str, Value] = {}
    if stream == "force" and 0.0 < value < ContactConfig.noise_floor:
        floor = {"force.noise_floor": max(float(f"{0.1 * value:.0e}"), TINY)}
        evidence += "; below the default of force.noise_floor, which would hide presses"
    return Finding(subject, value, sd, evidence, _all(sessions), parameters=floor)


def _in_air(sessions: Sequence[Session], axis: Axis) -> list[Array]:
    """Return the force along the axis in each stretch of air."""
    found = []
    for session in sessions:
        times = session.streams.force_times
        for first, last in runs(session.air) if session.leaves else ():
            inside = (times >= session.edges[first]) & (times < session.edges[last])
            found.append(session.unloaded[inside] @ axis.direction)
    return found


def find_force_filter(sessions: Sequence[Session], axis: Axis | None) -> Filter | None:
    """Return the low-pass filter that the noise of the force in the air shows."""
    if axis is None:
        return None
    steps = np.concatenate([np.diff(session.streams.force_times) for session in sessions])
    return find_filter(_in_air(sessions, axis), 1.0 / float(np.median(steps)))


def filter_findings(found: Filter | None) -> tuple[Finding, ...]:
    """Return what to say of a filter; nothing where none is seen."""
    if found is None:
        return ()
    evidence = (
        f"the noise in the air ends at {found.cutoff:.2g} Hz: a low-pass filter is on the force, "
        "in the sensor or the driver"
    )
    motion = "switch the filter off, or raise its frequency: it hides the touch"
    return (Finding("force filter", found.delay, found.sd, evidence, motion=motion),)


def _smooth_noise(sessions: Sequence[Session], axis: Axis | None) -> Finding:
    """Return the noise of a filtered force, whose neighbours are alike."""
    assert axis is not None
    parts = [signal.detrend(part) for part in _in_air(sessions, axis) if part.size > _LEAST]
    value = float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
    evidence = "in the air; it is filtered, so that neighbouring samples are alike"
    return Finding("force noise", value, 0.2 * value, evidence, _all(sessions))


def _noise_in_motion(stream: str, sessions: Sequence[Session]) -> Finding:
    """Return the noise of moving samples: stated where every other sample shows the same."""
    subject, noises, thinned = f"{stream} noise", [], []
    for times, values in (_values(stream, session) for session in sessions):
        noises.append(float(np.median(noise_of(times, values))))
        thinned.append(float(np.median(noise_of(times[::2], values[::2]))))
    value = float(np.mean(noises))
    if not math.isfinite(value):
        return unknown(subject, "too few samples")
    evidence = "from samples in motion, which lie that far from the lines between their neighbours"
    if np.all(np.abs(np.subtract(thinned, noises)) < _SAME * np.array(noises)):
        return Finding(subject, value, 0.1 * value, evidence, _all(sessions))
    return unknown(subject, evidence, "", value, None, _all(sessions))


def _at_rest(session: Session, times: Array) -> Mask:
    """Return which samples are in chunks in the air in which the probe neither moves nor turns."""
    moved = np.linalg.norm(np.diff(session.position, axis=0), axis=1)
    steps = np.maximum([0.0, *moved], [*moved, 0.0])
    noise = float(np.linalg.norm(session.motion_noise))
    rest = session.air & (steps < 4.0 * noise) & ~session.turning
    chunk = np.searchsorted(session.edges, times, side="right") - 1
    inside = (chunk >= 0) & (chunk < rest.size)
    return np.asarray(inside & rest[np.clip(chunk, 0, rest.size - 1)])


def _resolution(stream: str, sessions: Sequence[Session]) -> Finding:
    subject = f"{stream} resolution"
    found = [step_of(column) for one in sessions for column in _values(stream, one)[1].T]
    steps = [step for step in found if step is not None]
    if len(steps) < len(found):
        evidence = "no steps are seen: finer than the noise"
        return Finding(subject, None, None, evidence, _all(sessions))
    return Finding(subject, float(np.median(steps)), 0.0, "values come in steps", _all(sessions))


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


def bias_findings(
    sessions: Sequence[Session], axis: Axis | None, load_sd: float = 0.0
) -> tuple[Finding, Finding]:
    """Return bias and drift; `load_sd` is the deviation of the tool's weight taken off [N]."""
    seen = [session for session in sessions if session.leaves]
    reason = "the force's axis is not known" if axis is None else ""
    reason = reason or ("" if seen else "the probe is never seen in the air")
    if axis is None or reason:
        return unknown("force bias", reason), unknown("force drift", reason)
    return _bias(seen, axis, load_sd), _drift(seen, axis)


def _bias(sessions: Sequence[Session], axis: Axis, load_sd: float) -> Finding:
    for session in sessions:
        for first, last in runs(session.air):
            start = float(session.edges[first])
            end = min(float(session.edges[last]), start + _MOST)
            if end - start < _LEAST_AIR:
                continue
            inside = (session.streams.force_times >= start) & (session.streams.force_times < end)
            values = session.unloaded[inside] @ axis.direction
            found = linear(np.ones((values.size, 1)), values)
            zero = session.streams.start
            return Finding(
                "force bias",
                float(found.values[0]),
                math.hypot(float(found.sds[0]), load_sd),
                "mean force along the axis, less the tool's weight; measured anew before each "
                "contact",
                ((start - zero, end - zero),),
            )
    return unknown("force bias", f"no stretch of {_LEAST_AIR:g} s in the air")


def _drift(sessions: Sequence[Session], axis: Axis) -> Finding:
    slopes, sds = [], []
    seconds: list[tuple[float, float]] = []
    for session in sessions:
        times = session.times[session.air]
        if times.size < 10 or float(np.ptp(times)) < _SPREAD:
            continue
        design = np.stack([times - times.mean(), np.ones_like(times)], axis=1)
        found = linear(design, session.force[session.air] @ axis.direction)
        slopes.append(float(found.values[0]))
        sds.append(float(found.sds[0]))
        seconds += session.air_seconds()
    if not slopes:
        return unknown(
            "force drift",
            f"the air is not spread over {_SPREAD:g} s",
            "record for a minute, with the probe in the air every few seconds",
        )
    slope, sd = pooled(slopes, sds)
    worst = abs(slope) + 2.0 * sd
    evidence = f"line through {len(seconds)} stretches in the air"
    if worst > _DEFAULT_DRIFT:
        values = {"force.drift_sd": round(worst, 5)}
        return Finding("force drift", slope, sd, evidence, tuple(seconds), parameters=values)
    evidence += "; within the default of force.drift_sd, which stays"
    return Finding("force drift", slope, sd, evidence, tuple(seconds))


def _palpation(session: Session) -> float | None:
    """Return the frequency at which the probe palpated last [Hz]; None: it did not."""
    if session.lines is None:
        return None
    finder, found = PalpationFrequency(), None
    streams = session.streams
    for time, place in zip(
        streams.motion_times - streams.start, streams.position @ session.lines.into, strict=True
    ):
        finder.add(float(time), float(place))
        found = finder.value or found
    return found


def lift_off_finding(sessions: Sequence[Session]) -> Finding:
    """Say whether and when the probe was in the air."""
    touched = [session for session in sessions if session.contacts]
    if not touched:
        return unknown("lift-off", "no contact was seen")
    never = [session for session in sessions if not session.leaves]
    if never:
        names = ", ".join(session.streams.name for session in never)
        evidence = (
            f"in {names} no stretch is in the air for sure: the force does not stay while the "
            "probe travels"
        )
        motion = "begin with 2 s in the air, and lift off by 3 mm after each press"
        if frequency := next(filter(None, map(_palpation, never)), None):
            evidence += f", and palpates at {frequency:.2g} Hz"
            motion += f"; or write {REMEDY} for the stiffness in N/m where it palpates"
        return Finding("lift-off", "never", None, evidence, _all(never), motion)
    count = sum(len(session.contacts) for session in touched)
    first = min(s.contacts[0].start - s.streams.start for s in touched)
    late = f"begin with 2 s in the air: there is only {first:.1f} s"
    motion = "" if first >= _LEAST_AIR else late
    in_air = float(np.mean(np.concatenate([session.air for session in sessions])))
    evidence = f"{count} contacts, in the air for {100.0 * in_air:.0f} % of the time"
    seconds = tuple(span for session in sessions for span in session.air_seconds())
    return Finding("lift-off", "yes", None, evidence, seconds, motion)
