# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The delay between force and displacement: from turns, rigid presses, or two oscillations.

A tool's weight turns with the poses at once, and a rigid plate answers at once: both show the
delay alone. Tissue answers with a lead of its own, alpha; two frequencies tell the two apart as
far as alpha is the same at both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fden_ros.configure.axes import Axes
from fden_ros.configure.finding import Finding, Seconds, unknown
from fden_ros.configure.oscillations import DelayResult, Oscillation, Samples, find_delay
from fden_ros.configure.rigid import Press
from fden_ros.configure.session import Session
from fden_ros.configure.weight import Weight
from fden_ros.errors import InputError

#: A delay is claimed up to this deviation [s]: 1 ms is then two of them.
_LARGEST_SD = 5e-4
#: Least deviation that is stated [s], and how far alpha may differ between two frequencies.
_LEAST_SD = 2e-5
_ALPHA_CHANGE = 0.005
#: What a tool may give way where that is not known [m/N].
_LARGEST_COMPLIANCE = 1e-3
#: Sources that are further apart than this many deviations contradict each other.
_APART = 4.0
#: Values in the parameter file: least deviation [s].
_FILE_SD = 1e-4
#: alpha beyond which no tissue is: the delay that is left is then real.
_LARGEST_ALPHA = 0.5
_MOTION = (
    "turn the tool in the air at half a turn in 2 s, or press a rigid plate, or oscillate in "
    "tissue by 0.5 mm at 1 and at 4 Hz, ten cycles each"
)


@dataclass(frozen=True)
class _Source:
    name: str
    delay: float
    sd: float
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
    sources = _sources(weight, presses)
    sure = [source for source in sources if source.sd < _LARGEST_SD]
    assumed = sure[0].delay if sure else 0.0
    results = _oscillations(sessions, axes, compliance or 0.0, assumed)
    softer = results if compliance is not None else _oscillations(sessions, axes, None, assumed)
    for (result, seconds), (other, _) in zip(results, softer, strict=False):
        if result.delay is not None and other.delay is not None:
            sources.append(_from_frequencies(result, seconds, abs(other.delay - result.delay)))
    good = [source for source in sources if source.sd < _LARGEST_SD]
    if good:
        return _combined(good)
    for result, seconds in results:
        if result.explanations:
            said = "; ".join(f"{1e3 * e.delay:.1f} ms if {e.words}" for e in result.explanations)
            return Finding(
                "delay",
                False,
                None,
                None,
                "s",
                seconds,
                f"slope and phase differ: {said}",
                _MOTION,
            )
    singles = [
        (oscillation, seconds)
        for result, seconds in results
        for oscillation in result.oscillations
    ]
    if singles:
        return _undecided(singles, sources)
    if sources:
        best = min(sources, key=lambda source: source.sd)
        return unknown(
            "delay",
            f"{1e3 * best.delay:.1f} ± {1e3 * best.sd:.1g} ms from {best.name} is too uncertain",
            _MOTION,
        )
    return unknown("delay", "nothing in it happens at once", _MOTION)


def _sources(weight: Weight | None, presses: Sequence[Press]) -> list[_Source]:
    sources = []
    if weight is not None and weight.holds and weight.weight > 20.0 * weight.weight_sd:
        sd = math.hypot(weight.delay_sd, _LEAST_SD)
        sources.append(_Source("the tool's weight in turns", weight.delay, sd, weight.seconds))
    if presses:
        values = np.array([press.delay for press in presses])
        sds = np.hypot([press.delay_sd for press in presses], _LEAST_SD)
        weights = 1.0 / sds**2
        value = float(weights @ values / weights.sum())
        chi = float(np.sum(((values - value) / sds) ** 2)) / max(values.size - 1, 1)
        sd = math.sqrt(max(chi, 1.0) / float(weights.sum()))
        seconds = tuple(press.session.seconds((press.contact,))[0] for press in presses)
        sources.append(_Source("rigid presses", value, sd, seconds))
    return sources


def _oscillations(
    sessions: Sequence[Session], axes: Axes, compliance: float | None, delay: float
) -> list[tuple[DelayResult, Seconds]]:
    if axes.force is None or axes.displacement is None:
        return []
    results: list[tuple[DelayResult, Seconds]] = []
    for session in sessions:
        zero = session.streams.start
        force_times = session.streams.force_times
        level = np.interp(force_times, session.times, session.baseline @ axes.force.direction)
        push = session.unloaded @ axes.force.direction - (level if session.leaves else 0.0)
        if not session.leaves:
            push = push - push.min() + 0.1 * float(np.ptp(push))
        stamps = session.streams.motion_times
        way = session.streams.position @ axes.displacement.direction
        force = Samples(force_times - zero, push)
        gives = compliance
        if gives is None:
            # Half of what would explain the whole contact.
            inside = session.net @ axes.force.direction
            moved = float(np.ptp(session.position @ axes.displacement.direction))
            gives = min(_LARGEST_COMPLIANCE, 0.5 * moved / max(float(np.ptp(inside)), 1e-9))
        found: DelayResult | None = None
        for _ in range(3):
            assumed = delay if found is None or found.delay is None else found.delay
            bent = gives * np.interp(stamps - assumed, force_times, push)
            try:
                # A probe that stands still has strokes of 0, which are no oscillation.
                with np.errstate(invalid="ignore", divide="ignore"):
                    found = find_delay(force, Samples(stamps - zero, way - bent))
            except InputError:
                break
            if not gives or found.delay is None:
                break
        if found is not None:
            seconds = tuple((o.start, o.end) for o in found.oscillations)
            results.append((found, seconds))
    return results


def _from_frequencies(result: DelayResult, seconds: Seconds, unknown_part: float) -> _Source:
    assert result.delay is not None and result.order is not None
    rates = [oscillation.angular_frequency for oscillation in result.oscillations]
    law = 0.5 * math.pi * _ALPHA_CHANGE / max(max(rates) - min(rates), 1e-9)
    assert result.delay_sd is not None
    sd = math.hypot(result.delay_sd, law, unknown_part)
    if result.warnings or not 0.0 <= result.order <= _LARGEST_ALPHA:
        sd = math.inf
    return _Source("oscillations", result.delay, sd, seconds)


def _combined(sources: Sequence[_Source]) -> Finding:
    for one in sources:
        for other in sources:
            apart = abs(one.delay - other.delay)
            if apart > _APART * math.hypot(one.sd, other.sd):
                return unknown(
                    "delay",
                    f"{one.name} say {1e3 * one.delay:.2f} ms, {other.name} "
                    f"{1e3 * other.delay:.2f} ms: it is not constant, or a filter is on",
                    _MOTION,
                )
    weights = np.array([1.0 / source.sd**2 for source in sources])
    value = float(weights @ [source.delay for source in sources] / weights.sum())
    sd = math.sqrt(1.0 / float(weights.sum()))
    return Finding(
        "delay",
        True,
        value,
        sd,
        "s",
        tuple(span for source in sources for span in source.seconds),
        "from " + " and ".join(source.name for source in sources),
        parameters={
            "displacement.delay": round(value, 6),
            "displacement.delay_sd": round(max(sd, _FILE_SD), 6),
        },
    )


def _undecided(
    singles: Sequence[tuple[Oscillation, Seconds]], sources: Sequence[_Source]
) -> Finding:
    longest = max((o for o, _ in singles), key=lambda o: o.end - o.start)
    seconds = ((longest.start, longest.end),)
    order = longest.lead / (0.5 * math.pi)
    at_least = 1e3 * longest.delay(_LARGEST_ALPHA)
    explained = (
        f"or alpha {order:.2f} if there is none"
        if 0.0 <= order <= _LARGEST_ALPHA
        else f"and no tissue has the alpha of {order:.2f} that no delay would mean"
    )
    return Finding(
        "delay",
        False,
        longest.delay(0.0),
        None,
        "s",
        seconds,
        f"at {longest.frequency:.3g} Hz the force leads by {math.degrees(longest.lead):.1f} "
        "degrees: "
        f"a delay of {1e3 * longest.delay(0.0):.1f} ms if alpha is 0, {explained}; with an alpha "
        f"of {_LARGEST_ALPHA:g} {at_least:.1f} ms",
        "oscillate at a second frequency too, four times as fast, or " + _MOTION,
    )
