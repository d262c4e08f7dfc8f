# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The delay between force and displacement, from what answers at once, or from bends of tissue.

A tool's weight turns with the poses at once, and a rigid plate answers at once: these tell it to
half a millisecond. Presses of tissue tell it to some 7 ms. Where none of them does, a filter that
the force's noise shows is the least of it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fden_ros.configure.filtering import Filter
from fden_ros.configure.finding import Finding, Seconds, unknown
from fden_ros.configure.lag import Lag
from fden_ros.configure.rigid import Press
from fden_ros.configure.statistics import pooled
from fden_ros.configure.weight import Weight
from fden_ros.parameters import Value

#: A delay is claimed up to this deviation [s]: 1 ms is then two of them.
_LARGEST_SD = 5e-4
#: Least deviation of a source, and in the file [s].
_LEAST_SD, _FILE_SD = 2e-5, 1e-4
#: Largest deviation in the file [s]: to this the estimator is linear in a delay.
_MOST_FILE_SD = 0.01
#: A delay of tissue or of a filter is written from so many deviations on.
_CLEAR = 3.0
#: Sources that are further apart than this many deviations contradict each other.
_APART = 4.0


class _Source(NamedTuple):
    """What tells the delay, and the delay that it tells [s]."""

    name: str
    value: float
    sd: float
    seconds: Seconds


def delay_finding(
    weight: Weight | None,
    presses: Sequence[Press],
    in_tissue: Callable[[], Lag | None],
    filtered: Filter | None,
) -> Finding:
    """Return the delay of the displacement's stamps behind the force's.

    `in_tissue` returns what tissue shows, and is called where nothing answers at once.
    """
    sources = _at_once(weight, presses)
    good = [source for source in sources if source.sd < _LARGEST_SD]
    if good:
        return _combined(good)
    if lag := in_tissue():
        name = f"the bends of {lag.presses} press{'es' * (lag.presses > 1)} of tissue"
        return _stated(_Source(name, lag.value, lag.sd, lag.seconds))
    if filtered is not None:
        name = "the force's filter alone, which its noise in the air shows"
        return _stated(_Source(name, -filtered.delay, filtered.sd, ()))
    if not sources:
        return unknown("delay", "nothing in it happens at once")
    best = min(sources, key=lambda source: source.sd)
    said = f"{1e3 * best.value:.1f} ± {1e3 * best.sd:.1g} ms from {best.name} is too uncertain"
    return unknown("delay", said)


def _stated(source: _Source) -> Finding:
    """Return a delay that is known to some milliseconds: the default stays within its error."""
    found = Finding("delay", source.value, source.sd, f"from {source.name}", source.seconds)
    if abs(source.value) < _CLEAR * source.sd:
        return replace(found, evidence=f"{found.evidence}; within it the default of 0 stays")
    return replace(found, parameters=_values(source.value, source.sd))


def _values(value: float, sd: float) -> dict[str, Value]:
    return {
        "displacement.delay": round(value, 6),
        "displacement.delay_sd": round(min(max(sd, _FILE_SD), _MOST_FILE_SD), 6),
    }


def _at_once(weight: Weight | None, presses: Sequence[Press]) -> list[_Source]:
    """Return what answers at once: the weight in turns, and something rigid."""
    sources = []
    if weight is not None and weight.is_clear:
        sd = math.hypot(weight.delay_sd, _LEAST_SD)
        sources.append(_Source("the tool's weight in turns", weight.delay, sd, weight.seconds))
    if presses:
        sds = np.hypot([press.delay_sd for press in presses], _LEAST_SD)
        delay, sd = pooled([press.delay for press in presses], sds)
        seconds = tuple(press.session.seconds((press.contact,))[0] for press in presses)
        sources.append(_Source("rigid presses", delay, sd, seconds))
    return sources


def _combined(sources: Sequence[_Source]) -> Finding:
    for one, other in itertools.combinations(sources, 2):
        if abs(one.value - other.value) > _APART * math.hypot(one.sd, other.sd):
            return unknown(
                "delay",
                f"{one.name} say {1e3 * one.value:.2f} ms, {other.name} "
                f"{1e3 * other.value:.2f} ms: it is not constant, or a filter is on",
            )
    value, sd = pooled([one.value for one in sources], [one.sd for one in sources])
    seconds = tuple(span for source in sources for span in source.seconds)
    names = "from " + " and ".join(source.name for source in sources)
    return Finding("delay", value, sd, names, seconds, parameters=_values(value, sd))
