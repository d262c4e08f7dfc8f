# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""The delay between force and displacement, from oscillations of the probe on tissue.

Where the probe oscillates about a mean, the force leads the displacement by

.. math:: \psi(\omega) = \frac{\pi\alpha}{2} + \omega\,\tau,

the first part by the tissue's order alpha (the phase of the paper's eq. Phase, corrected), the
second by the delay tau with which the displacement is stamped. The law's nonlinearity does not
move the phase of the fundamental: phi is instantaneous, and so in phase with the strain. One
frequency cannot tell the two parts apart; two can, or a known alpha.

A fractional order also says how the force grows with the frequency, as :math:`\omega^\alpha`. Some
tissue has a larger phase than that slope says (Kobayashi et al., arXiv:1804.00979). What its phase
is at each frequency is then not known, and cannot be told from a delay.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import find_peaks

from fden_ros.core.arrays import Array
from fden_ros.core.streams.rotation import Quaternion
from fden_ros.core.streams.samples import Position, Sink
from fden_ros.errors import InputError
from fden_ros.parameters import Parameters
from fden_ros.recording.source import Selection, open_source

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
_LARGEST_ALPHA = 0.65
#: Slope and phase contradict each other beyond this many deviations, and this difference of alpha.
_CONTRADICTION, _NEGLIGIBLE_ORDER = 3.5, 0.01
#: Forces at two frequencies compare where the means differ by less than this share of the strokes.
_SAME_MEAN = 0.2


@dataclass(frozen=True)
class Samples:
    """A stream as arrays of shape (n,)."""

    times: Array  #: [s]
    values: Array


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
class Explanation:
    """One reading of the oscillations, where they allow several."""

    words: str
    delay: float  #: [s]
    delay_sd: float  #: [s]


@dataclass(frozen=True)
class DelayResult:
    """What oscillations say of the delay.

    `delay` and `order` are None where one frequency leaves them undecided, and where slope and
    phase contradict each other: `explanations` then are what it could be.
    """

    oscillations: tuple[Oscillation, ...]
    delay: float | None  #: of the displacement's stamps behind the force's [s]
    delay_sd: float | None  #: [s]
    order: float | None  #: alpha [1], found or given
    order_sd: float | None  #: [1]
    order_given: bool
    warnings: tuple[str, ...] = ()
    slope: float | None = None  #: of ln force over ln frequency: alpha of a fractional order [1]
    slope_sd: float | None = None  #: [1]
    explanations: tuple[Explanation, ...] = ()


def find_delay(
    force: Samples,
    displacement: Samples,
    order: float | None = None,
    order_sd: float = 0.0,
) -> DelayResult:
    """Find the delay of the displacement's stamps behind the force's.

    Parameters
    ----------
    force, displacement : Samples
        As recorded [N], [m].
    order, order_sd : float, optional
        alpha of the tissue where it is known, and its standard deviation [1].

    Raises
    ------
    InputError
        If there is no steady oscillation in contact.
    """
    warnings: list[str] = []
    found = find_oscillations(force, displacement, warnings)
    if not found:
        raise InputError(
            f"no steady oscillation of at least {_LEAST_CYCLES} cycles in contact: move the probe "
            "in a sine about a mean, on tissue, best at two frequencies such as 1 and 4 Hz"
        )
    frequencies = [oscillation.frequency for oscillation in found]
    if max(frequencies) < _DIFFERENT * min(frequencies):
        if order is None:
            return DelayResult(found, None, None, None, None, False, tuple(warnings))
        degree = 1e3 * math.radians(1.0) / found[0].angular_frequency
        warnings.append(
            "this holds where the phase of the tissue is pi alpha / 2; some tissue has a larger "
            "one, which one frequency cannot tell from a delay: a degree of it counts as "
            f"{degree:.2g} ms"
        )
        return _with_order(found, order, order_sd, warnings)
    by_phase = _with_frequencies(found, warnings)
    slope = _slope(found, displacement)
    if slope is not None:
        by_phase = replace(by_phase, slope=slope[0], slope_sd=slope[1])
    if order is None:
        return by_phase if slope is None else _against(by_phase, slope, "the slope")
    given = (order, order_sd)
    checked = _against(by_phase, given, "the given alpha")
    if checked.delay is None:
        return checked
    return replace(
        _with_order(found, order, order_sd, warnings),
        slope=by_phase.slope,
        slope_sd=by_phase.slope_sd,
    )


def _against(by_phase: DelayResult, other: tuple[float, float], words: str) -> DelayResult:
    """Return what the phases say, undecided where another alpha contradicts them."""
    delay, delay_sd, order, order_sd = (
        by_phase.delay,
        by_phase.delay_sd,
        by_phase.order,
        by_phase.order_sd,
    )
    assert delay is not None and delay_sd is not None
    assert order is not None and order_sd is not None
    difference, sd = order - other[0], math.hypot(order_sd, other[1])
    if abs(difference) <= max(_CONTRADICTION * sd, _NEGLIGIBLE_ORDER):
        return by_phase
    rest = _with_order(by_phase.oscillations, *other, ())
    assert rest.delay is not None and rest.delay_sd is not None
    return replace(
        by_phase,
        delay=None,
        delay_sd=None,
        order=None,
        order_sd=None,
        explanations=(
            Explanation(
                f"the tissue's phase is the same at every frequency, that of alpha {order:.3f} ± "
                f"{order_sd:.3f}, though {words} is {other[0]:.3f} ± {other[1]:.3f}",
                delay,
                delay_sd,
            ),
            Explanation(
                f"the tissue's phase is that of {words}, and the rest is delay",
                rest.delay,
                rest.delay_sd,
            ),
        ),
    )


def _slope(found: tuple[Oscillation, ...], displacement: Samples) -> tuple[float, float] | None:
    """Return alpha by the growth of the force with the frequency, and its deviation.

    None where the oscillations are not about one mean in one contact: a strain apart, the tissue
    is stiffer, and elsewhere it is another.
    """
    stroke = min(o.amplitude for o in found)
    if max(o.mean for o in found) - min(o.mean for o in found) > _SAME_MEAN * stroke:
        return None
    between = _between(displacement, found[0].start, found[-1].end).values
    if float(np.max(np.abs(between - found[0].mean))) > 3.0 * max(o.amplitude for o in found):
        return None
    logs = np.log([o.angular_frequency for o in found])
    values = np.log([o.stiffness for o in found])
    weights = np.array([1.0 / max(o.stiffness_sd, 1e-6) ** 2 for o in found])
    logs, values = logs - weights @ logs / weights.sum(), values - weights @ values / weights.sum()
    information = float(weights @ logs**2)
    slope = float(weights @ (logs * values)) / information
    misfit = float(weights @ (values - slope * logs) ** 2) / max(len(found) - 2, 1)
    return slope, math.sqrt(max(misfit, 1.0) / information)


def _with_order(
    found: tuple[Oscillation, ...], order: float, order_sd: float, warnings: Sequence[str]
) -> DelayResult:
    weights = np.array([(o.angular_frequency / o.lead_sd) ** 2 for o in found])
    delays = np.array([o.delay(order) for o in found])
    weights /= weights.sum()
    by_order = float(weights @ [0.5 * math.pi / o.angular_frequency for o in found])
    own = math.sqrt(float(weights**2 @ [(o.lead_sd / o.angular_frequency) ** 2 for o in found]))
    sd = math.hypot(own, by_order * order_sd)
    return DelayResult(found, float(weights @ delays), sd, order, order_sd, True, tuple(warnings))


def _with_frequencies(found: tuple[Oscillation, ...], warnings: Sequence[str]) -> DelayResult:
    """Solve for alpha and the delay by weighted least squares."""
    deviations = np.array([o.lead_sd for o in found])
    design = np.array([[0.5 * math.pi, o.angular_frequency] for o in found])
    solutions = []
    # A phase is known up to whole turns: that which gives a possible alpha and the least delay.
    for turns in itertools.product((0, -1, 1), repeat=min(len(found), 4)):
        lead = np.array([o.lead for o in found])
        lead[: len(turns)] += 2.0 * math.pi * np.array(turns)
        normal = (design / deviations[:, None]).T @ (design / deviations[:, None])
        solution = np.linalg.solve(normal, design.T @ (lead / deviations**2))
        misfit = float(np.sum(((lead - design @ solution) / deviations) ** 2))
        degrees = max(len(found) - 2, 1)
        scale = max(misfit / degrees, 1.0) if len(found) > 2 else 1.0
        impossible = max(-0.05 - solution[0], solution[0] - _LARGEST_ALPHA, 0.0)
        rank = (impossible, round(misfit / (1.0 + degrees)), abs(float(solution[1])))
        solutions.append((rank, solution, np.linalg.inv(normal) * scale))
    rank, solution, covariance = min(solutions, key=lambda item: item[0])
    notes = list(warnings)
    if rank[0] > 0.0 or solution[0] < 0.0:
        notes.append(
            f"alpha comes out as {solution[0]:.3f}, which no tissue has: the delay is not "
            "constant, or the tool gives way (displacement.compliance)"
        )
    sd = np.sqrt(covariance.diagonal())
    return DelayResult(
        found,
        float(solution[1]),
        float(sd[1]),
        float(solution[0]),
        float(sd[0]),
        False,
        tuple(notes),
    )


# Oscillations


def find_oscillations(
    force: Samples, displacement: Samples, warnings: list[str] | None = None
) -> tuple[Oscillation, ...]:
    """Return the steady oscillations of the probe in contact, in order of time."""
    found = []
    air = float(np.percentile(force.values, 1.0)) if force.values.size else 0.0
    for start, end, frequency in _steady_stretches(displacement):
        oscillation = _measure(force, displacement, start, end, frequency)
        if oscillation is None:
            continue
        pressing = _between(force, start, end).values - min(air, 0.0)
        if pressing.min() < _LEAST_FORCE * np.ptp(pressing):
            if warnings is not None:
                warnings.append(
                    f"the oscillation of {frequency:.3g} Hz at {start:.1f} s lifts off the "
                    "tissue: left out"
                )
            continue
        found.append(oscillation)
    return tuple(found)


def _steady_stretches(displacement: Samples) -> list[tuple[float, float, float]]:
    """Return start, end [s] and frequency [Hz] of every run of even strokes."""
    values = displacement.values
    if values.size < 8:
        return []
    prominence = _PROMINENCE * float(np.ptp(values))
    if prominence <= 0.0:
        return []
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
    motion, response = (_between(stream, start, end) for stream in (displacement, force))
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
            _harmonic_fit(_between(s, low, high), low, high, frequency, harmonics).fundamental
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


def _between(stream: Samples, start: float, end: float) -> Samples:
    inside = (stream.times >= start) & (stream.times <= end)
    return Samples(stream.times[inside], stream.values[inside])


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


# Recordings


@dataclass
class _Collector(Sink):
    """Keeps the samples of a recording."""

    forces: list[tuple[int, float]] = field(default_factory=list)
    displacements: list[tuple[int, float]] = field(default_factory=list)
    rejected: int = 0

    def add_force(self, stamp_ns: int, force: float) -> None:
        self.forces.append((stamp_ns, force))

    def add_displacement(
        self,
        stamp_ns: int,
        displacement: float,
        position: Position | None = None,
        load: float = 0.0,
        turn: Quaternion | None = None,
    ) -> None:
        self.displacements.append((stamp_ns, displacement))

    def add_force_vector(self, stamp_ns: int, frame: str, force: Position) -> None:
        """Refuse it: nothing is calibrated in frames that move."""
        raise InputError("calibrate takes signals in fixed frames: unset frames.base")

    def reject(self, stream: str, reason: str) -> None:
        self.rejected += 1


def read_samples(
    recording: str | Path,
    parameters: Parameters,
    selection: Selection | None = None,
    show: Callable[[int, int], None] | None = None,
) -> tuple[Samples, Samples]:
    """Return force and displacement of a bag or table, as stamped, in order of time.

    `show` is called with the steps done and all steps.

    Raises
    ------
    InputError
        If the recording cannot be read, or holds no samples of the one or the other.
    """
    source = open_source(recording, parameters, selection)
    collector = _Collector()
    for done in source.feed(collector, lambda time_ns, message: None):
        if show is not None and done % 1000 == 0:
            show(done, source.total)
    for name, samples in (
        ("force", collector.forces),
        ("displacement", collector.displacements),
    ):
        if not samples:
            raise InputError(f"{recording}: no sample of the {name} ({source.inputs[name]})")
    first = min(collector.forces[0][0], collector.displacements[0][0])
    return _stream(collector.forces, first), _stream(collector.displacements, first)


def _stream(samples: Sequence[tuple[int, float]], first_ns: int) -> Samples:
    stamps = np.array([stamp for stamp, _ in samples], dtype=np.int64) - first_ns
    values = np.array([value for _, value in samples])
    finite = np.isfinite(values)
    stamps, index = np.unique(stamps[finite], return_index=True)
    times: Array = 1e-9 * stamps.astype(np.float64)
    return Samples(times, values[finite][index])
