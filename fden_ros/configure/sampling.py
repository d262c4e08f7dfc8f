# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Properties of the streams, alone and in the air: rate, noise, filter, bias, drift.

Noise of a sensor is white up to its filter, so the spectrum at rest is that of the filter, over a
floor of later noise. Whittle's likelihood compares filters of several kinds and times
with noise that is white, or falls with a power of the frequency like that of a drift.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import detrend, periodogram
from scipy.special import digamma, polygamma

from fden_ros.configure.axes import Axis
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.session import Mask, Session, runs
from fden_ros.configure.signs import LEAST_RATIO
from fden_ros.configure.streams import apart_from_neighbours, noise_of, pooled
from fden_ros.core.arrays import Array
from fden_ros.core.contact import ContactConfig
from fden_ros.core.parameter import TINY
from fden_ros.core.strokes import REMEDY
from fden_ros.experiments.regression import line_through, linear
from fden_ros.parameters import Value

#: A gap is ten usual steps and at least this long [s].
_GAP_STEPS, _GAP = 10.0, 0.02
#: Values are quantised where at most this part of them are different.
_REPEATED = 0.5
#: The rate that a contact of a second needs [Hz].
_SLOW = 50.0
#: Fewer samples at rest do not show the noise.
_LEAST = 60
#: The air for a bias: the first stretch of at least this length, up to 5 s.
_LEAST_AIR, _MOST = 1.0, 5.0
#: A drift is known from air that covers at least this time [s]; up to this drift [N/s]
#: `force.drift_sd` stays at its default.
_SPREAD, _DEFAULT_DRIFT = 10.0, 0.005
#: Length of the parts whose spectra are averaged [s], at least.
_LENGTH, _LEAST_LENGTH = 2.0, 1.0
#: Frequencies that count, as a part of the rate: above, sampling folds the spectrum.
_HIGHEST = 0.3
#: Floors behind the filter, relative to its passband.
_FLOORS = np.array([0.0, *np.geomspace(1e-8, 0.3, 16)])
#: Slopes of unfiltered noise, and their floors, relative to it at the lowest frequency.
_SLOPES = np.linspace(0.0, 4.0, 17)
#: Parts of the periodogram that are independent, with Hann's window.
_INDEPENDENT = 0.67
#: A filter below this number of steps of the stamps has no effect.
_LEAST_STEPS = 2.0
#: Largest residual of a spectrum by the kind of its filter, in ln of the power.
_MISFIT = 0.05
#: A vibration is a line of this number of frequencies.
_LINE = 5
#: Relative deviation of a time by the kind of filter.
_KIND_SD = 0.2


class Filter(NamedTuple):
    """A low-pass filter."""

    delay: float  #: of slow signals [s]
    sd: float  #: [s]
    cutoff: float  #: at half the power [Hz]


def _values(stream: str, session: Session) -> tuple[Array, Array]:
    streams = session.streams
    if stream == "force":
        return streams.force_times, streams.force
    return streams.motion_times, streams.position


def rate_finding(stream: str, sessions: Sequence[Session]) -> Finding:
    """Return the rate of ``force`` or ``displacement``."""
    steps = np.concatenate([np.diff(_values(stream, session)[0]) for session in sessions])
    # Samples that come in bursts have a usual step of nearly 0.
    usual = max(float(np.median(steps)), float(steps.mean()))
    is_gap = (steps > _GAP_STEPS * usual) & (steps > _GAP)
    mean, jitter = float(steps[~is_gap].mean()), float(steps[~is_gap].std())
    evidence = f"jitter {1e3 * jitter:.2g} ms" if jitter > 1e-9 else "no jitter"
    if is_gap.any():
        evidence += f", {is_gap.sum()} gaps, the longest {steps[is_gap].max():.2g} s"
    if 1.0 / mean < _SLOW:
        evidence += f"; below {_SLOW:g} Hz touches are seen late: raise the rate"
    sd = jitter / mean**2 / math.sqrt(steps.size)
    return Finding(f"{stream} rate", 1.0 / mean, sd, evidence)


def noise_finding(
    stream: str, sessions: Sequence[Session], axis: Axis | None, filtered: Filter | None = None
) -> Finding:
    """Return the noise of ``force`` or ``displacement`` a sample, along the axis."""
    subject, apart = f"{stream} noise", []
    if filtered is not None and axis is not None:
        parts = [detrend(part) for _, part in _in_air(sessions, axis) if part.size > _LEAST]
        value = float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
        evidence = "in the air; it is filtered, so neighbouring samples are alike"
        return Finding(subject, value, 0.2 * value, evidence)
    for session in sessions:
        times, values = _values(stream, session)
        # Without an axis all components count, which scatter alike.
        size = math.sqrt(values.shape[1])
        line = values @ (np.full(values.shape[1], 1.0 / size) if axis is None else axis.direction)
        for start, stop in runs(_at_rest(session, times)):
            if stop - start >= 8:
                part = slice(start, stop)
                apart.append(apart_from_neighbours(times[part], line[part, None]).ravel())
    count = sum(part.size for part in apart)
    if count < _LEAST:
        moving = [np.median(noise_of(*_values(stream, session))) for session in sessions]
        evidence = "from samples in motion: their distance from the line between their neighbours"
        return unknown(subject, evidence, "", float(np.mean(moving)))
    value = float(np.sqrt(np.mean(np.concatenate(apart) ** 2)))
    # Neighbouring distances share samples: the sum of their squared correlations is 1.94.
    sd = value * math.sqrt(1.94 / (2.0 * count))
    evidence = f"{count} samples at rest in the air"
    rounded = max(step_of(c) for s in sessions for c in _values(stream, s)[1].T)
    if rounded > 2.0 * value:
        # Such steps hide the noise: the rounding error remains.
        value = rounded / math.sqrt(12.0)
        sd = 0.2 * value
        evidence = "from rounding: the steps of the values are larger than the noise"
    floor: dict[str, Value] = {}
    if stream == "force" and 0.0 < value < ContactConfig.noise_floor:
        floor = {"force.noise_floor": max(float(f"{0.1 * value:.0e}"), TINY)}
        evidence += "; below the default of force.noise_floor, which would hide presses"
    return Finding(subject, value, sd, evidence, parameters=floor)


def _at_rest(session: Session, times: Array) -> Mask:
    """Return which samples are in chunks in the air where the probe neither moves nor turns."""
    moved = np.linalg.norm(np.diff(session.position, axis=0), axis=1)
    is_slow = np.maximum([0.0, *moved], [*moved, 0.0]) < 4.0 * np.linalg.norm(session.motion_noise)
    rest = session.air & is_slow & ~session.turning
    chunk = np.searchsorted(session.edges, times, side="right") - 1
    inside = (chunk >= 0) & (chunk < rest.size)
    return np.asarray(inside & rest[np.clip(chunk, 0, rest.size - 1)])


def step_of(values: Array) -> float:
    """Return the quantisation step of values; 0 where there is none."""
    different = np.unique(values)
    gaps = np.diff(different)
    gaps = gaps[gaps > 1e-9 * max(float(np.abs(different).max()), 1e-30)]
    if different.size > _REPEATED * values.size or gaps.size < 3:
        return 0.0
    step = float(np.quantile(gaps, 0.1))
    # The smallest common gap, refined by all that are whole multiples of it.
    whole = np.round(gaps / step)
    step = float((gaps @ whole) / (whole @ whole))
    off = np.abs(gaps / step - np.round(gaps / step))
    return step if float(np.mean(off < 0.05)) > 0.95 else 0.0


def _in_air(sessions: Sequence[Session], axis: Axis) -> list[tuple[Array, Array]]:
    """Return times [s] and force along the axis in each stretch of air, (n,) each."""
    found = []
    for session in sessions:
        times = session.streams.force_times
        for first, last in runs(session.air) if session.leaves else ():
            inside = (times >= session.edges[first]) & (times < session.edges[last])
            since = times[inside] - session.streams.start
            found.append((since, session.unloaded[inside] @ axis.direction))
    return found


def find_force_filter(sessions: Sequence[Session], axis: Axis | None) -> Filter | None:
    """Return the low-pass filter that the noise of the force in the air shows."""
    if axis is None:
        return None
    steps = np.concatenate([np.diff(session.streams.force_times) for session in sessions])
    rest = [force for _, force in _in_air(sessions, axis)]
    return find_filter(rest, 1.0 / float(np.median(steps)))


def filter_finding(found: Filter) -> Finding:
    """Return what to report of a filter."""
    evidence = (
        f"the noise in the air ends at {found.cutoff:.2g} Hz: the sensor or driver filters the "
        "force, which hides the touch; switch the filter off, or raise its frequency"
    )
    return Finding("force filter", found.delay, found.sd, evidence)


def bias_findings(
    sessions: Sequence[Session], axis: Axis | None, load_sd: float
) -> tuple[Finding, Finding]:
    """Return bias and drift; `load_sd` is the deviation of the weight that was subtracted [N]."""
    seen = [session for session in sessions if session.leaves]
    if axis is None or not seen:
        reason = "the probe is never seen in the air" if axis else "the force's axis is not known"
        return unknown("force bias", reason), unknown("force drift", reason)
    drift = _drift(seen, axis)
    for times, force in _in_air(seen, axis):
        if np.ptp(times) < _LEAST_AIR:
            continue
        first = times < times[0] + _MOST
        found = linear(np.ones((int(first.sum()), 1)), force[first])
        evidence = (
            f"mean force along the axis from {times[0]:.2f} to {times[first][-1]:.2f} s, less the "
            "tool's weight; measured again before each contact"
        )
        sd = math.hypot(float(found.sds[0]), load_sd)
        return Finding("force bias", float(found.values[0]), sd, evidence), drift
    return unknown("force bias", f"no stretch of {_LEAST_AIR:g} s in the air"), drift


def _drift(sessions: Sequence[Session], axis: Axis) -> Finding:
    lines = [
        line_through(session.times[session.air], session.force[session.air] @ axis.direction)
        for session in sessions
        if session.air.sum() >= 10 and np.ptp(session.times[session.air]) >= _SPREAD
    ]
    if not lines:
        return unknown(
            "force drift",
            f"the stretches in the air span less than {_SPREAD:g} s",
            "record for a minute, with the probe in the air every few seconds",
        )
    slope, sd = pooled([one.values[0] for one in lines], [one.sds[0] for one in lines])
    worst, evidence = abs(slope) + 2.0 * sd, "line through the force in the air"
    values = {"force.drift_sd": round(worst, 5)} if worst > _DEFAULT_DRIFT else {}
    evidence += "" if values else "; within the default of force.drift_sd, which is kept"
    return Finding("force drift", slope, sd, evidence, parameters=values)


def lift_off_finding(sessions: Sequence[Session]) -> Finding:
    """Report whether and when the probe was in the air."""
    touched = [session for session in sessions if session.contacts]
    if not touched:
        return unknown("lift-off", "no contact was seen")
    if never := [session.streams.name for session in sessions if not session.leaves]:
        evidence = (
            f"in {', '.join(never)} no stretch is certain to be in the air: the force changes "
            "wherever the probe travels"
        )
        motion = (
            "begin with 2 s in the air, and lift off by 3 mm after each press; free the tool of "
            "friction, cables and drapes; or write "
            f"{REMEDY} for the stiffness in N/m where it palpates without lifting"
        )
        return Finding("lift-off", "never", None, evidence, motion)
    evidence = f"{sum(len(session.contacts) for session in touched)} contacts"
    first = min(s.contacts[0].start - s.streams.start for s in touched)
    late = (
        f"; begin with 2 s in the air: there is only {first:.1f} s" if first < _LEAST_AIR else ""
    )
    return Finding("lift-off", "yes", None, evidence + late)


def find_filter(rest: Sequence[Array], rate: float) -> Filter | None:
    """Return the filter on a force at `rate` [Hz], from stretches in the air; None: not seen."""
    longest = max((part.size for part in rest), default=0)
    size = min(int(_LENGTH * rate), longest)
    if size < max(_LEAST_LENGTH * rate, 32):
        return None
    parts = [p[i : i + size] for p in rest for i in range(0, p.size - size + 1, size)]
    frequencies, powers = periodogram(np.array(parts), rate, "hann", detrend="linear")
    kept = (frequencies > 1.5 * frequencies[1]) & (frequencies < _HIGHEST * rate)
    frequencies, power = frequencies[kept], powers.mean(axis=0)[kept]
    if frequencies.size < 8 or not power.min() > 0.0:
        return None
    count = _INDEPENDENT * len(parts)
    falling = (frequencies[0] / frequencies) ** _SLOPES[:, None]
    free = max(float(_likelihoods(one, power, count).max()) for one in falling)
    line = slice(max(int(power.argmax()) - _LINE // 2, 0), int(power.argmax()) + _LINE // 2 + 1)
    left = np.delete(power, line)
    with_line = float(_likelihoods(np.ones_like(left), left, count)[0])
    free = max(free, with_line - count * float(np.log(power[line]).sum()))
    # The data must show the passband and its end.
    tried = [
        (_likelihoods(gain, power, count).max(), steps / (2.0 * math.pi * cutoff), half * cutoff)
        for cutoff in np.geomspace(2.0 * frequencies[0], 0.5 * frequencies[-1], 40)
        for gain, steps, half in _filters(frequencies / cutoff)
    ]
    likelihoods, delays, halves = (np.array(column) for column in zip(*tried, strict=True))
    best = int(np.argmax(likelihoods))
    # Residuals of a fitting spectrum are Gamma variables of mean 1: a vibration's line is not.
    size = power.size * count
    misfit = -float(likelihoods[best]) - float(count * np.log(power).sum())
    expected = size * (math.log(len(parts)) - float(digamma(len(parts))))
    scatter = math.sqrt(size * count * float(polygamma(1, len(parts))))
    most = expected + 5.0 * scatter + _MISFIT * size
    if likelihoods[best] - free < math.log(LEAST_RATIO) or misfit > most:
        return None
    if delays[best] < _LEAST_STEPS / rate:
        return None
    weights = np.exp(likelihoods - likelihoods[best])
    delay = float(np.average(delays, weights=weights))
    sd = math.sqrt(float(np.average((delays - delay) ** 2, weights=weights)))
    return Filter(delay, math.hypot(sd, _KIND_SD * delay), float(halves[best]))


def _filters(ratio: Array) -> list[tuple[Array, float, float]]:
    """Return power gain (n,), delay in radians of the cutoff, and the frequency of half power.

    For first-order stages in series, Butterworth's filters, and a mean over a time.
    """
    return [
        *(
            ((1 + ratio**2) ** -n, float(n), math.sqrt(2.0 ** (1.0 / n) - 1.0))
            for n in (1.0, 2.0, 3.0)
        ),
        (1.0 / (1.0 + ratio**4), math.sqrt(2.0), 1.0),
        (1.0 / (1.0 + ratio**8), 2.613, 1.0),
        (np.sinc(0.443 * ratio) ** 2, 0.443 * math.pi, 1.0),
    ]


def _likelihoods(gain: Array, power: Array, count: float) -> Array:
    """Return ln of Whittle's likelihood with each floor, its size at the best (k,)."""
    shape = gain + np.maximum(_FLOORS, 1e-12)[:, None]
    size = np.mean(power / shape, axis=1)
    return np.asarray(-count * (power.size * np.log(size) + np.log(shape).sum(axis=1)))
