# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The delay between force and displacement: from turns, rigid presses, or oscillations.

A tool's weight turns with the poses at once, and a rigid plate answers at once: both show the
delay alone. Where the probe oscillates on tissue, the force leads the displacement by

.. math:: \psi(\omega) = \frac{\pi\alpha}{2} + \omega\,\tau,

the first part by the tissue's order alpha (the phase of the paper's eq. Phase, corrected), the
second by the delay tau with which the displacement is stamped. The law's nonlinearity does not
move the phase of the fundamental: phi is instantaneous, and so in phase with the strain. One
frequency cannot tell the two parts apart; two can, as far as alpha is the same at both.

A fractional order also says how the force grows with the frequency, as :math:`\omega^\alpha`. Some
tissue has a larger phase than that slope says (Kobayashi et al., arXiv:1804.00979). What its phase
is at each frequency is then not known, and cannot be told from a delay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import find_peaks

from fden_ros.configure.axes import Axes
from fden_ros.configure.finding import Finding, Seconds, unknown
from fden_ros.configure.rigid import Press
from fden_ros.configure.session import Session
from fden_ros.configure.statistics import pooled
from fden_ros.configure.weight import Weight
from fden_ros.core.arrays import Array

#: A delay is claimed up to this deviation [s]: 1 ms is then two of them.
_LARGEST_SD = 5e-4
#: Least deviation of a source, and in the file [s]; how far alpha may differ between frequencies.
_LEAST_SD, _FILE_SD = 2e-5, 1e-4
_ALPHA_CHANGE = 0.005
#: What a tool may give way where that is not known [m/N].
_LARGEST_COMPLIANCE = 1e-3
#: Sources that are further apart than this many deviations contradict each other.
_APART = 4.0
#: alpha beyond which no tissue is: the delay that is left is then real.
_LARGEST_ALPHA = 0.5

#: A turning point of the displacement stands out by this share of its whole range ...
_PROMINENCE = 0.02
#: ... and half periods and strokes of one oscillation differ by no more than this share.
_EVEN = 0.15
_LEAST_CYCLES = 4
#: At the beginning the memory of the way there is still in the force.
_SKIPPED_CYCLES = 1.0
_HARMONICS = 6
_TREND_DEGREE = 4
#: Frequencies count as different from this ratio on.
_DIFFERENT = 1.2
#: Least force of an oscillation, as a share of its stroke, for the probe to be in contact.
_LEAST_FORCE = 0.02
#: Slope and phase contradict each other beyond this many deviations, and this difference of alpha.
_CONTRADICTION, _NEGLIGIBLE_ORDER = 3.5, 0.01
#: Forces at two frequencies compare where the means differ by less than this share of the strokes.
_SAME_MEAN = 0.2


class Samples(NamedTuple):
    """A stream as arrays of shape (n,)."""

    times: Array  #: [s]
    values: Array

    def between(self, start: float, end: float) -> Samples:
        """Return those from `start` to `end` [s]."""
        inside = (self.times >= start) & (self.times <= end)
        return Samples(self.times[inside], self.values[inside])


class Measured(NamedTuple):
    """A number and its standard deviation."""

    value: float
    sd: float


@dataclass(frozen=True)
class Oscillation:
    """A steady oscillation of the probe in contact."""

    start: float  #: [s]
    end: float  #: [s]
    frequency: float  #: [Hz]
    amplitude: float  #: of the displacement [m]
    lead: float  #: of the force before the displacement [rad]
    lead_sd: float  #: [rad]
    mean: float  #: of the displacement [m]
    stiffness: float  #: amplitude of the force over that of the displacement [N/m]
    stiffness_sd: float  #: of its logarithm

    @property
    def angular_frequency(self) -> float:
        """Frequency in radians per second."""
        return 2.0 * math.pi * self.frequency

    def delay(self, order: float) -> float:
        """Return the delay [s] if alpha is `order`."""
        return (self.lead - 0.5 * math.pi * order) / self.angular_frequency


@dataclass(frozen=True)
class Phases:
    """What the phases of oscillations say of the delay.

    Parameters
    ----------
    oscillations : tuple of Oscillation
    delay, order : Measured or None
        Of the displacement's stamps behind the force's [s], and alpha; None: one frequency alone.
    slope : Measured or None
        Of ln force over ln frequency: alpha of a fractional order; None where it does not show.
    """

    oscillations: tuple[Oscillation, ...]
    delay: Measured | None = None
    order: Measured | None = None
    slope: Measured | None = None

    @property
    def seconds(self) -> Seconds:
        """Where the oscillations are."""
        return tuple((one.start, one.end) for one in self.oscillations)

    @property
    def by_slope(self) -> Measured | None:
        """The delay if alpha is the slope's, where that contradicts the phases."""
        if self.order is None or self.slope is None:
            return None
        sd = math.hypot(self.order.sd, self.slope.sd)
        apart = abs(self.order.value - self.slope.value)
        if apart <= max(_CONTRADICTION * sd, _NEGLIGIBLE_ORDER):
            return None
        delays = [one.delay(self.slope.value) for one in self.oscillations]
        sds = [one.lead_sd / one.angular_frequency for one in self.oscillations]
        weights = 1.0 / np.square(sds)
        per_order = [0.5 * math.pi / one.angular_frequency for one in self.oscillations]
        by_order = float(np.average(per_order, weights=weights)) * self.slope.sd
        sd = math.hypot(1.0 / math.sqrt(float(weights.sum())), by_order)
        return Measured(float(np.average(delays, weights=weights)), sd)


def phases_of(force: Samples, displacement: Samples) -> Phases:
    """Return what oscillations say, where there are any, of samples as recorded [N], [m]."""
    found = find_oscillations(force, displacement)
    frequencies = [one.frequency for one in found]
    if not found or max(frequencies) < _DIFFERENT * min(frequencies):
        return Phases(found)
    design = np.array([[one.angular_frequency, 0.5 * math.pi] for one in found])
    solution, covariance = _weighted(
        design, np.array([one.lead for one in found]), np.array([one.lead_sd for one in found])
    )
    delay, order = (
        Measured(float(value), math.sqrt(float(variance)))
        for value, variance in zip(solution, np.diag(covariance), strict=True)
    )
    return Phases(found, delay, order, _slope(found, displacement))


def _weighted(design: Array, values: Array, sds: Array) -> tuple[Array, Array]:
    """Return solution and covariance of least squares; more scatter than stated counts."""
    columns, target = design / sds[:, None], values / sds
    inverse = np.linalg.inv(columns.T @ columns)
    solution = inverse @ (columns.T @ target)
    misfit = float(np.sum((target - columns @ solution) ** 2))
    return solution, inverse * max(misfit / max(len(values) - len(solution), 1), 1.0)


def _slope(found: tuple[Oscillation, ...], displacement: Samples) -> Measured | None:
    """Return alpha by the growth of the force with the frequency, and its deviation.

    None where the oscillations are not about one mean in one contact: a strain apart, the tissue
    is stiffer, and elsewhere it is another.
    """
    strokes, means = [one.amplitude for one in found], [one.mean for one in found]
    if max(means) - min(means) > _SAME_MEAN * min(strokes):
        return None
    between = displacement.between(found[0].start, found[-1].end).values
    if float(np.max(np.abs(between - means[0]))) > 3.0 * max(strokes):
        return None
    design = np.array([[math.log(one.angular_frequency), 1.0] for one in found])
    logs = np.log([one.stiffness for one in found])
    sds = np.array([one.stiffness_sd for one in found])
    solution, covariance = _weighted(design, logs, sds)
    return Measured(float(solution[0]), math.sqrt(float(covariance[0, 0])))


# Oscillations


def find_oscillations(force: Samples, displacement: Samples) -> tuple[Oscillation, ...]:
    """Return the steady oscillations of the probe in contact that do not lift off, in order."""
    found = []
    air = float(np.percentile(force.values, 1.0)) if force.values.size else 0.0
    for start, end, frequency in _steady_stretches(displacement):
        oscillation = _measure(force, displacement, start, end, frequency)
        pressing = force.between(start, end).values - min(air, 0.0)
        if oscillation is not None and pressing.min() >= _LEAST_FORCE * np.ptp(pressing):
            found.append(oscillation)
    return tuple(found)


def _steady_stretches(displacement: Samples) -> list[tuple[float, float, float]]:
    """Return start, end [s] and frequency [Hz] of every run of even strokes."""
    values = displacement.values
    if values.size < 8 or not np.ptp(values) > 0.0:
        return []
    prominence = _PROMINENCE * float(np.ptp(values))
    peaks = find_peaks(values, prominence=prominence)[0]
    dips = find_peaks(-values, prominence=prominence)[0]
    turns = np.sort(np.concatenate([peaks, dips]))
    times = displacement.times[turns]
    halves, strokes = np.diff(times), np.abs(np.diff(values[turns]))
    stretches = []
    first = 0
    while first < halves.size:
        last = first
        while (
            last + 1 < halves.size
            and abs(halves[last + 1] / np.median(halves[first : last + 1]) - 1.0) < _EVEN
            and abs(strokes[last + 1] / np.median(strokes[first : last + 1]) - 1.0) < _EVEN
        ):
            last += 1
        count = last - first + 1
        if count >= 2 * _LEAST_CYCLES:
            frequency = 0.5 * count / float(times[last + 1] - times[first])
            stretches.append((float(times[first]), float(times[last + 1]), frequency))
        first = last + 1
    return stretches


def _measure(
    force: Samples, displacement: Samples, start: float, end: float, frequency: float
) -> Oscillation | None:
    """Return the phases in whole cycles, the first one left out."""
    cycles = math.floor((end - start) * frequency + 0.25 - _SKIPPED_CYCLES)
    start = end - cycles / frequency
    motion, response = (stream.between(start, end) for stream in (displacement, force))
    harmonics = min(
        _HARMONICS,
        *(
            math.floor(0.4 * s.times.size / max(end - start, 1e-9) / frequency)
            for s in (motion, response)
        ),
    )
    if harmonics < 1 or cycles < _LEAST_CYCLES - 1:
        return None
    bound = 0.5 / cycles
    refined = minimize_scalar(
        lambda f: _harmonic_fit(motion, start, end, f, harmonics).misfit,
        bounds=(frequency * (1.0 - bound), frequency * (1.0 + bound)),
        method="bounded",
        options={"xatol": 1e-7 * frequency},
    )
    frequency = float(refined.x)
    of_motion = _harmonic_fit(motion, start, end, frequency, harmonics)
    of_force = _harmonic_fit(response, start, end, frequency, harmonics)
    ratio = of_force.fundamental / of_motion.fundamental
    noise = math.hypot(of_motion.sd, of_force.sd)
    # What the noise does not explain shows in the difference of the halves.
    middle = start + math.ceil(0.5 * cycles) / frequency
    halves = []
    for low, high in ((start, middle), (middle, end)):
        phases = [
            _harmonic_fit(s.between(low, high), low, high, frequency, harmonics).fundamental
            for s in (response, motion)
        ]
        halves.append(phases[0] / phases[1])
    change = np.log(halves[1] / halves[0])
    scatter = abs(float(change.imag)) / 2.0
    # An exponential law makes the fundamental larger by twice the square of its second harmonic.
    bend = 2.0 * of_force.second**2
    return Oscillation(
        start=start,
        end=end,
        frequency=frequency,
        amplitude=abs(of_motion.fundamental),
        lead=float(np.angle(ratio)),
        lead_sd=max(noise, scatter, 1e-6),
        mean=float(0.5 * (motion.values.max() + motion.values.min())),
        stiffness=abs(ratio),
        stiffness_sd=math.hypot(max(noise, abs(float(change.real)) / 2.0, 1e-6), bend),
    )


class _Harmonics(NamedTuple):
    """Harmonics of one stream over whole cycles."""

    fundamental: complex
    sd: float  #: of the fundamental's phase [rad], and of the logarithm of its magnitude
    misfit: float  #: sum of squares
    second: float  #: magnitude of the second harmonic over that of the fundamental


def _harmonic_fit(
    stream: Samples, start: float, end: float, frequency: float, harmonics: int
) -> _Harmonics:
    """Fit harmonics and a slow trend."""
    phase = 2.0 * math.pi * frequency * (stream.times - start)
    scaled = 2.0 * (stream.times - start) / (end - start) - 1.0
    columns = [np.polynomial.legendre.legvander(scaled, _TREND_DEGREE)]
    for harmonic in range(1, harmonics + 1):
        columns += [np.cos(harmonic * phase)[:, None], np.sin(harmonic * phase)[:, None]]
    design = np.hstack(columns)
    coefficients = np.linalg.lstsq(design, stream.values, rcond=None)[0]
    residual = stream.values - design @ coefficients
    misfit = float(residual @ residual)
    cosine, sine, *others = coefficients[_TREND_DEGREE + 1 :]
    fundamental = complex(cosine, -sine)
    noise = math.sqrt(misfit / max(stream.times.size - design.shape[1], 1))
    amplitude = max(abs(fundamental), 1e-300)
    return _Harmonics(
        fundamental,
        noise * math.sqrt(2.0 / stream.times.size) / amplitude,
        misfit,
        math.hypot(*others[:2]) / amplitude,
    )


# The finding


@dataclass(frozen=True)
class _Source:
    name: str
    delay: Measured
    seconds: Seconds


def delay_finding(
    sessions: Sequence[Session],
    axes: Axes,
    weight: Weight | None,
    presses: Sequence[Press],
    compliance: float | None,
) -> Finding:
    """Return the delay of the displacement's stamps behind the force's.

    `compliance` [m/N] is None where it is not known: the lead of tissue is then less certain.
    """
    sources = _at_once(weight, presses)
    assumed = next((s.delay.value for s in sources if s.delay.sd < _LARGEST_SD), 0.0)
    found = [_phases(session, axes, compliance or 0.0, assumed) for session in sessions]
    for session, phases in zip(sessions, found, strict=True):
        if phases.delay is not None and phases.by_slope is None:
            other = phases
            if compliance is None:
                other = _phases(session, axes, _possible_compliance(session, axes), assumed)
            sources += _by_phases(phases, other)
    good = [source for source in sources if source.delay.sd < _LARGEST_SD]
    if good:
        return _combined(good)
    for phases in found:
        if phases.by_slope is not None and phases.delay is not None:
            return _contradicted(phases, phases.by_slope)
    singles = [one for phases in found for one in phases.oscillations]
    if singles:
        return _undecided(max(singles, key=lambda one: one.end - one.start))
    if not sources:
        return unknown("delay", "nothing in it happens at once")
    best = min(sources, key=lambda source: source.delay.sd)
    value, sd = best.delay
    said = f"{1e3 * value:.1f} ± {1e3 * sd:.1g} ms from {best.name} is too uncertain"
    return unknown("delay", said)


def _at_once(weight: Weight | None, presses: Sequence[Press]) -> list[_Source]:
    """Return what answers at once: the weight in turns, and something rigid."""
    sources = []
    if weight is not None and weight.is_clear:
        delay = Measured(weight.delay, math.hypot(weight.delay_sd, _LEAST_SD))
        sources.append(_Source("the tool's weight in turns", delay, weight.seconds))
    if presses:
        sds = np.hypot([press.delay_sd for press in presses], _LEAST_SD)
        delay = Measured(*pooled([press.delay for press in presses], sds))
        seconds = tuple(press.session.seconds((press.contact,))[0] for press in presses)
        sources.append(_Source("rigid presses", delay, seconds))
    return sources


def _phases(session: Session, axes: Axes, compliance: float, late: float) -> Phases:
    """Return the phases of a recording, what the tool gives way taken off the motion."""
    if axes.force is None or axes.displacement is None:
        return Phases(())
    zero, force_times = session.streams.start, session.streams.force_times
    push = session.unloaded @ axes.force.direction
    if session.leaves:
        level = session.baseline @ axes.force.direction
        push = push - np.interp(force_times, session.times, level)
    else:
        push = push - push.min() + 0.1 * float(np.ptp(push))
    stamps = session.streams.motion_times
    way = session.streams.position @ axes.displacement.direction
    found = Phases(())
    for _ in range(3 if compliance else 1):
        bent = compliance * np.interp(stamps - late, force_times, push)
        # A probe that stands still has strokes of 0, which are no oscillation.
        with np.errstate(invalid="ignore", divide="ignore"):
            found = phases_of(
                Samples(force_times - zero, push), Samples(stamps - zero, way - bent)
            )
        if found.delay is None:
            break
        late = found.delay.value
    return found


def _possible_compliance(session: Session, axes: Axes) -> float:
    """Return half of what would explain the whole contact [m/N]."""
    assert axes.force is not None and axes.displacement is not None
    push = float(np.ptp(session.net @ axes.force.direction))
    moved = float(np.ptp(session.position @ axes.displacement.direction))
    return min(_LARGEST_COMPLIANCE, 0.5 * moved / max(push, 1e-9))


def _by_phases(phases: Phases, other: Phases) -> list[_Source]:
    """Return the delay by two frequencies, if alpha is possible; `other`: with another tool."""
    assert phases.delay is not None and phases.order is not None
    if not 0.0 <= phases.order.value <= _LARGEST_ALPHA or other.delay is None:
        return []
    rates = [one.angular_frequency for one in phases.oscillations]
    law = 0.5 * math.pi * _ALPHA_CHANGE / max(max(rates) - min(rates), 1e-9)
    value, sd = phases.delay
    sd = math.hypot(sd, law, other.delay.value - value)
    return [_Source("oscillations", Measured(value, sd), phases.seconds)]


def _combined(sources: Sequence[_Source]) -> Finding:
    for one in sources:
        for other in sources:
            apart = abs(one.delay.value - other.delay.value)
            if apart > _APART * math.hypot(one.delay.sd, other.delay.sd):
                return unknown(
                    "delay",
                    f"{one.name} say {1e3 * one.delay.value:.2f} ms, {other.name} "
                    f"{1e3 * other.delay.value:.2f} ms: it is not constant, or a filter is on",
                )
    value, sd = pooled([one.delay.value for one in sources], [one.delay.sd for one in sources])
    seconds = tuple(span for source in sources for span in source.seconds)
    told = {
        "displacement.delay": round(value, 6),
        "displacement.delay_sd": round(max(sd, _FILE_SD), 6),
    }
    names = "from " + " and ".join(source.name for source in sources)
    return Finding("delay", value, sd, names, seconds, parameters=told)


def _contradicted(phases: Phases, by_slope: Measured) -> Finding:
    assert phases.delay is not None and phases.order is not None and phases.slope is not None
    evidence = (
        f"slope and phase differ: {1e3 * phases.delay.value:.1f} ms if the tissue's phase is the "
        f"same at every frequency, that of alpha {phases.order.value:.3f}, though the force grows "
        f"with the frequency to the power {phases.slope.value:.3f}; "
        f"{1e3 * by_slope.value:.1f} ms if its phase is that of this slope"
    )
    return unknown("delay", evidence, seconds=phases.seconds)


def _undecided(one: Oscillation) -> Finding:
    order = one.lead / (0.5 * math.pi)
    explained = (
        f"or alpha {order:.2f} if there is none"
        if 0.0 <= order <= _LARGEST_ALPHA
        else f"and no tissue has the alpha of {order:.2f} that no delay would mean"
    )
    evidence = (
        f"at {one.frequency:.3g} Hz the force leads by {math.degrees(one.lead):.1f} degrees: "
        f"a delay of {1e3 * one.delay(0.0):.1f} ms if alpha is 0, {explained}; with an alpha of "
        f"{_LARGEST_ALPHA:g} {1e3 * one.delay(_LARGEST_ALPHA):.1f} ms"
    )
    motion = (
        "oscillate at a second frequency too, four times as fast, or press a rigid plate, or turn "
        "the tool in the air at half a turn in 2 s"
    )
    return unknown("delay", evidence, motion, one.delay(0.0), None, ((one.start, one.end),))
