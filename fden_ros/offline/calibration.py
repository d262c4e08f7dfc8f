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

r"""The delay between force and displacement, from oscillations of the probe on tissue.

Where the probe oscillates about a mean, the force leads the displacement by

.. math:: \psi(\omega) = \frac{\pi\alpha}{2} + \omega\,\tau,

the first part by the tissue's order alpha (the phase of the paper's eq. Phase, corrected), the
second by the delay tau with which the displacement is stamped. The law's nonlinearity does not
move the phase of the fundamental: phi is instantaneous, and so in phase with the strain. One
frequency cannot tell the two parts apart; two can, or a known alpha.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import find_peaks

from fden_ros.core.streams.rotation import Quaternion
from fden_ros.core.streams.samples import Position
from fden_ros.errors import InputError
from fden_ros.parameters import Parameters
from fden_ros.recording.source import Selection, open_source

Array = NDArray[np.float64]

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

    @property
    def angular_frequency(self) -> float:
        """Frequency in radians per second."""
        return 2.0 * math.pi * self.frequency

    def delay(self, order: float) -> float:
        """Return the delay [s] if alpha is `order`."""
        return (self.lead - 0.5 * math.pi * order) / self.angular_frequency


@dataclass(frozen=True)
class DelayResult:
    """What oscillations say of the delay.

    `delay` and `order` are None where one frequency leaves them undecided.
    """

    oscillations: tuple[Oscillation, ...]
    delay: float | None  #: of the displacement's stamps behind the force's [s]
    delay_sd: float | None  #: [s]
    order: float | None  #: alpha [1], found or given
    order_sd: float | None  #: [1]
    order_given: bool
    warnings: tuple[str, ...] = ()


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
    if order is not None:
        return _with_order(found, order, order_sd, warnings)
    frequencies = [oscillation.frequency for oscillation in found]
    if max(frequencies) < _DIFFERENT * min(frequencies):
        return DelayResult(found, None, None, None, None, False, tuple(warnings))
    return _with_frequencies(found, warnings)


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
        lambda f: _harmonic_fit(motion, start, end, f, harmonics)[2],
        bounds=(frequency * (1.0 - bound), frequency * (1.0 + bound)),
        method="bounded",
        options={"xatol": 1e-7 * frequency},
    )
    frequency = float(refined.x)
    of_motion, motion_sd, _ = _harmonic_fit(motion, start, end, frequency, harmonics)
    of_force, force_sd, _ = _harmonic_fit(response, start, end, frequency, harmonics)
    lead = float(np.angle(of_force / of_motion))
    # What the noise does not explain shows in the difference of the halves.
    middle = start + math.ceil(0.5 * cycles) / frequency
    halves = []
    for low, high in ((start, middle), (middle, end)):
        phases = [
            _harmonic_fit(_between(s, low, high), low, high, frequency, harmonics)[0]
            for s in (response, motion)
        ]
        halves.append(float(np.angle(phases[0] / phases[1])))
    scatter = abs(float(np.angle(np.exp(1j * (halves[1] - halves[0]))))) / 2.0
    return Oscillation(
        start=start,
        end=end,
        frequency=frequency,
        amplitude=float(abs(of_motion)),
        lead=lead,
        lead_sd=max(math.hypot(motion_sd, force_sd), scatter, 1e-6),
    )


def _between(stream: Samples, start: float, end: float) -> Samples:
    inside = (stream.times >= start) & (stream.times <= end)
    return Samples(stream.times[inside], stream.values[inside])


def _harmonic_fit(
    stream: Samples, start: float, end: float, frequency: float, harmonics: int
) -> tuple[complex, float, float]:
    """Fit harmonics and a slow trend; return the fundamental, its phase's sd and the misfit."""
    phase = 2.0 * math.pi * frequency * (stream.times - start)
    scaled = 2.0 * (stream.times - start) / (end - start) - 1.0
    columns = [np.polynomial.legendre.legvander(scaled, _TREND_DEGREE)]
    for harmonic in range(1, harmonics + 1):
        columns += [np.cos(harmonic * phase)[:, None], np.sin(harmonic * phase)[:, None]]
    design = np.hstack(columns)
    coefficients = np.linalg.lstsq(design, stream.values, rcond=None)[0]
    residual = stream.values - design @ coefficients
    misfit = float(residual @ residual)
    cosine, sine = coefficients[_TREND_DEGREE + 1 : _TREND_DEGREE + 3]
    fundamental = complex(cosine, -sine)
    noise = math.sqrt(misfit / max(stream.times.size - design.shape[1], 1))
    amplitude = max(abs(fundamental), 1e-300)
    return fundamental, noise * math.sqrt(2.0 / stream.times.size) / amplitude, misfit


# Recordings


@dataclass
class _Collector:
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

    def add_transform(self, *transform: object, is_static: bool) -> None:
        """Leave it out."""

    def add_surface(self, stamp_ns: int, surface: float) -> None:
        """Leave it out: what is rigid does not breathe."""

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
