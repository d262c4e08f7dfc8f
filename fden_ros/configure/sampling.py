# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the streams are by themselves and in the air: rate, noise, resolution, bias, drift."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fden_ros.configure.axes import Axis
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.session import Mask, Session, runs
from fden_ros.configure.statistics import fit, noise_of
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


#: The air that a bias rests on: the first stretch of at least this long, up to 5 s.
_LEAST_AIR, _MOST = 1.0, 5.0
#: A drift is told from air that is spread over at least this time [s].
_SPREAD = 10.0
#: `force.drift_sd` stays at its default up to this drift [N/s].
_DEFAULT_DRIFT = 0.005
_AIR = "begin with 2 s in the air, and lift off between presses"


def bias_findings(
    sessions: Sequence[Session], axis: Axis | None, load_sd: float = 0.0
) -> tuple[Finding, Finding]:
    """Return bias and drift; `load_sd` is the deviation of the tool's weight taken off [N]."""
    if axis is None:
        reason = "the force's axis is not known"
        return unknown("force bias", reason, _AIR), unknown("force drift", reason, _AIR)
    seen = [session for session in sessions if session.leaves]
    if not seen:
        reason = "the probe is never seen in the air"
        return unknown("force bias", reason, _AIR), unknown("force drift", reason, _AIR)
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
            found = fit(np.ones((values.size, 1)), values)
            zero = session.streams.start
            return Finding(
                "force bias",
                True,
                float(found.solution[0]),
                math.hypot(math.sqrt(float(found.covariance[0, 0])), load_sd),
                "N",
                ((start - zero, end - zero),),
                "mean force along the axis, the tool's weight taken off; measured anew before "
                "each contact",
            )
    return unknown("force bias", f"no stretch of {_LEAST_AIR:g} s in the air", _AIR)


def _drift(sessions: Sequence[Session], axis: Axis) -> Finding:
    slopes, variances, seconds = [], [], []
    for session in sessions:
        times = session.times[session.air]
        if times.size < 10 or float(np.ptp(times)) < _SPREAD:
            continue
        slope, variance = _slope(times, session.force[session.air] @ axis.direction)
        slopes.append(slope)
        variances.append(variance)
        seconds += list(session.air_seconds())
    if not slopes:
        return unknown(
            "force drift",
            f"the air is not spread over {_SPREAD:g} s",
            "record for a minute, with the probe in the air every few seconds",
        )
    weights = 1.0 / np.array(variances)
    slope = float(weights @ np.array(slopes) / weights.sum())
    sd = math.sqrt(1.0 / float(weights.sum()))
    worst = abs(slope) + 2.0 * sd
    parameters = {"force.drift_sd": round(worst, 5)} if worst > _DEFAULT_DRIFT else {}
    kept = "" if parameters else "; within the default of force.drift_sd, which stays"
    return Finding(
        "force drift",
        True,
        slope,
        sd,
        "N/s",
        tuple(seconds),
        f"line through {len(seconds)} stretches in the air{kept}",
        parameters=parameters,
    )


def _slope(times: Array, values: Array) -> tuple[float, float]:
    since = times - times.mean()
    found = fit(np.stack([np.ones_like(since), since], axis=1), values)
    return float(found.solution[1]), float(found.covariance[1, 1])


def lift_off_finding(sessions: Sequence[Session]) -> Finding:
    """Say whether and when the probe was in the air."""
    subject = "lift-off"
    if not any(session.contacts for session in sessions):
        return unknown(subject, "no contact was seen", "press tissue, and lift off")
    if not all(session.leaves for session in sessions):
        names = ", ".join(s.streams.name for s in sessions if not s.leaves)
        return Finding(
            subject,
            True,
            "never",
            None,
            "",
            tuple(s.seconds()[0] for s in sessions),
            f"in {names} no stretch is in the air for sure: the force does not stay while the "
            "probe travels",
            "begin with 2 s in the air, and lift off by 3 mm after each press",
        )
    count = sum(len(session.contacts) for session in sessions)
    first = min(
        (s.contacts[0].start - s.streams.start for s in sessions if s.contacts), default=0.0
    )
    seconds = tuple(span for s in sessions for span in s.air_seconds())
    motion = (
        "" if first >= _LEAST_AIR else f"begin with 2 s in the air: there is only {first:.1f} s"
    )
    share = float(np.mean(np.concatenate([s.air for s in sessions])))
    return Finding(
        subject,
        True,
        "yes",
        None,
        "",
        seconds,
        f"{count} contacts, in the air for {100.0 * share:.0f} % of the time",
        motion,
    )
