# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What tissue tells of the delay: an estimate, since its relaxation looks like one.

A press tells by its bends, an oscillation by its phase. Both take the tissue for one of the prior,
so what comes out is proposed with its deviation, and stated nowhere.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fden_ros.configure.axes import Axes
from fden_ros.configure.finding import Seconds
from fden_ros.configure.session import Contact, Session
from fden_ros.configure.statistics import pooled
from fden_ros.core import ContactSummary, Pipeline
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import NOTHING_UNKNOWN, EstimatorConfig, Prior
from fden_ros.core.oscillation import PalpationMeter
from fden_ros.core.outputs import Output
from fden_ros.core.streams import NANOSECONDS
from fden_ros.parameters import check, pipeline_config

#: Least standard deviation of a lag that tissue alone shows [s].
_TISSUE_SD = 0.01
#: Standard deviation of the delay before the recording tells [s]: drivers that stamp apart are up
#: to 100 ms apart.
_PRIOR_SD = 0.1
#: A press is looked at from so long before it to so long behind, and for so long at most [s]: a
#: hold of more adds nothing at its bends.
_BEFORE, _BEHIND, _LONGEST = 3.0, 1.5, 8.0
#: Presses that are looked at [1], each some seconds of work.
_PRESSES = 2
#: Samples a second that are enough for either [Hz].
_RATE = 200.0
#: An oscillation is of at least this amplitude over the noise of the motion [1], in so many
#: windows of two periods [1].
_CLEAR, _WINDOWS = 10.0, 4
#: Standard deviation of a phase beside its scatter [rad]: 5 % of error of a relaxation's kernel
#: over a decade.
_PHASE_SD = 0.03
#: Frequencies are one within 4 % [1], as for who finds them.
_SAME_FREQUENCY = 0.04


class Lag(NamedTuple):
    """A delay of the displacement behind the force, as far as tissue tells it."""

    value: float  #: [s]
    sd: float  #: [s]
    basis: str
    seconds: Seconds
    is_told_apart: bool  #: from relaxation, by its growth with the frequency


def find_lag(
    sessions: Sequence[Session], axes: Axes, indenter: Mapping[str, float | str] | None
) -> Lag | None:
    """Return what tissue tells best; None: nothing.

    Parameters
    ----------
    sessions : sequence of Session
        In SI units.
    axes : Axes
    indenter : mapping or None
        Values of ``geometry.*`` as they are stated.
    """
    if axes.force is None or axes.displacement is None:
        return None
    pairs = [(one, _along(one, axes)) for one in sessions]
    found = [lag for lag in (_of_presses(pairs, indenter or {}), _of_sines(pairs)) if lag]
    return min(found, key=lambda lag: lag.sd, default=None)


class _Motion(NamedTuple):
    """Force and depth of a recording on one clock; times from its beginning [s], [N], [m]."""

    times: Array
    force: Array
    depth: Array

    def between(self, start: float, end: float) -> _Motion:
        inside = (self.times >= start) & (self.times <= end)
        return _Motion(*(values[inside] for values in self))


def _along(session: Session, axes: Axes) -> _Motion:
    assert axes.force is not None and axes.displacement is not None
    streams = session.streams
    rate = min(_RATE, 1.0 / float(np.median(np.diff(streams.force_times))))
    times = np.arange(streams.start, streams.end, 1.0 / rate)
    force, position = (
        values @ axis.direction
        for values, axis in (
            (session.unloaded, axes.force),
            (streams.position, axes.displacement),
        )
    )
    return _Motion(
        times,
        np.interp(times, streams.force_times, force),
        np.interp(times, streams.motion_times, position),
    )


# Presses


def _of_presses(
    pairs: Sequence[tuple[Session, _Motion]], indenter: Mapping[str, float | str]
) -> Lag | None:
    """Return what the estimator learns of the delay in the first presses."""
    contacts = ((s, m, contact) for s, m in pairs if s.leaves for contact in s.contacts)
    lags: list[tuple[float, float]] = []
    seconds: list[tuple[float, float]] = []
    for session, motion, contact in itertools.islice(contacts, _PRESSES):
        lag = _of_press(motion, contact, indenter)
        if lag is not None:
            lags.append(lag)
            seconds += session.seconds((contact,))
    if not lags:
        return None
    value, sd = pooled(*zip(*lags, strict=True))
    # Until a bend is known within a block the estimator claims nothing either.
    presses = "a press" if len(lags) == 1 else f"{len(lags)} presses"
    return Lag(value, max(sd, _TISSUE_SD), f"by {presses} of tissue", tuple(seconds), False)


def _of_press(
    motion: _Motion, contact: Contact, indenter: Mapping[str, float | str]
) -> tuple[float, float] | None:
    """Return the delay and its deviation [s]; None: the estimator found no press."""
    end = min(contact.end + _BEHIND, contact.start + _LONGEST)
    part = motion.between(contact.start - _BEFORE, end)
    values: dict[str, object] = {f"geometry.{name}": value for name, value in indenter.items()}
    values["displacement.delay_sd"] = _PRIOR_SD
    outputs: list[Output] = []
    pipeline = Pipeline(pipeline_config(check(values)), outputs.append)
    stamps = NANOSECONDS + np.rint(NANOSECONDS * (part.times - part.times[0])).astype(int)
    for stamp, force, depth in zip(stamps.tolist(), part.force, part.depth, strict=True):
        pipeline.add_displacement(stamp, float(depth))
        pipeline.add_force(stamp, float(force))
    pipeline.finish()
    estimates = [o.estimate for o in outputs if isinstance(o, ContactSummary)]
    delays = [one.delay for one in estimates if one is not None and one.delay is not None]
    return delays[-1] if delays and delays[-1][1] < 0.5 * _PRIOR_SD else None


# Oscillations


class _Phase(NamedTuple):
    """The phase of an oscillation."""

    angular_frequency: float  #: [rad/s]
    value: float  #: of the force before the displacement [rad]
    sd: float  #: [rad]


def _of_sines(pairs: Sequence[tuple[Session, _Motion]]) -> Lag | None:
    """Return alpha's and the delay's best fit to the phases, alpha as by the prior."""
    seen: list[tuple[float, float]] = []
    seconds: list[tuple[float, float]] = []
    for session, motion in pairs:
        for contact in session.contacts:
            inside = motion.between(contact.start, contact.end)
            windows = list(_windows(inside, _noise(session)))
            if len(windows) >= _WINDOWS:
                seen += windows
                seconds += session.seconds((contact,))
    phases = list(_phases(seen))
    if not phases:
        return None
    prior = Prior()
    design = np.array([[0.5 * math.pi, phase.angular_frequency] for phase in phases])
    weights = np.array([phase.sd**-2 for phase in phases])
    normal = design.T @ (weights[:, None] * design) + np.diag([prior.fractional_order_sd**-2, 0.0])
    towards = design.T @ (weights * [phase.value for phase in phases])
    towards[0] += prior.fractional_order / prior.fractional_order_sd**2
    covariance = np.linalg.inv(normal)
    value, sd = float((covariance @ towards)[1]), math.sqrt(covariance[1, 1])
    rates = " and ".join(f"{p.angular_frequency / (2.0 * math.pi):.2g}" for p in phases)
    return Lag(value, sd, f"by an oscillation at {rates} Hz", tuple(seconds), len(phases) > 1)


def _noise(session: Session) -> float:
    return float(np.linalg.norm(session.motion_noise))


def _windows(motion: _Motion, noise: float) -> Iterator[tuple[float, float]]:
    """Yield frequency [rad/s] and phase [rad] of each window of an oscillation in contact."""
    config = EstimatorConfig(uncertainty=NOTHING_UNKNOWN)
    meter = PalpationMeter(None, _CLEAR * max(noise, 1e-7), 0.1, config)
    for time, force, depth in zip(*(values.tolist() for values in motion), strict=True):
        measured = meter.add(time - motion.times[0], depth, force)
        if measured is not None:
            modulus = measured.modulus
            yield modulus.angular_frequency, math.atan2(modulus.loss, modulus.storage)


def _phases(seen: Sequence[tuple[float, float]]) -> Iterator[_Phase]:
    """Yield the mean phase at each frequency that enough windows show, from -90 to 270 degrees.

    100 ms are 180 degrees at 5 Hz.
    """
    left = sorted(seen)
    while left:
        near = [one for one in left if one[0] <= left[0][0] * (1.0 + _SAME_FREQUENCY)]
        left = left[len(near) :]
        if len(near) < _WINDOWS:
            continue
        frequencies, phases = np.array(near).T
        middle = float(np.angle(np.exp(1j * phases).sum()))
        off = np.angle(np.exp(1j * (phases - middle)))
        scatter = float(off.std(ddof=1)) / math.sqrt(len(near))
        # The median: a window may hold the beginning of the oscillation.
        value = middle + float(np.median(off))
        value = (value + 0.5 * math.pi) % (2.0 * math.pi) - 0.5 * math.pi
        yield _Phase(float(frequencies.mean()), value, math.hypot(scatter, _PHASE_SD))
