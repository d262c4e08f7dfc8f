# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The delay between force and displacement, from what answers at once: turns and rigid presses.

A tool's weight turns with the poses at once, and a rigid plate answers at once. Tissue does not:
the force of an oscillation leads by the tissue's order and by the delay. So what tissue tells is
proposed, and not stated.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from fden_ros.configure.finding import SUBJECTS, Finding, Seconds, unknown
from fden_ros.configure.lag import Lag
from fden_ros.configure.rigid import Press
from fden_ros.configure.statistics import pooled
from fden_ros.configure.weight import Weight

#: A delay is claimed up to this deviation [s]: 1 ms is then two of them.
_LARGEST_SD = 5e-4
#: Least deviation of a source, and in the file [s].
_LEAST_SD, _FILE_SD = 2e-5, 1e-4
#: Sources that are further apart than this many deviations contradict each other.
_APART = 4.0


class _Source(NamedTuple):
    """What tells the delay, and the delay that it tells [s]."""

    name: str
    value: float
    sd: float
    seconds: Seconds


#: What tells a delay from relaxation, beside what answers at once.
_SINES = "oscillate in tissue at two frequencies, as 1 and 4 Hz"
_ALIKE = "relaxation looks alike; a rigid plate or sines at 1 and 4 Hz tell them apart"


def delay_finding(
    weight: Weight | None, presses: Sequence[Press], in_tissue: Callable[[], Lag | None]
) -> Finding:
    """Return the delay of the displacement's stamps behind the force's.

    `in_tissue` returns what tissue tells, which is asked where nothing answers at once.
    """
    sources = _at_once(weight, presses)
    good = [source for source in sources if source.sd < _LARGEST_SD]
    if good:
        return _combined(good)
    lag = in_tissue()
    if lag is not None:
        return _proposed(lag)
    if not sources:
        return unknown("delay", "nothing in it happens at once")
    best = min(sources, key=lambda source: source.sd)
    said = f"{1e3 * best.value:.1f} ± {1e3 * best.sd:.1g} ms from {best.name} is too uncertain"
    return unknown("delay", said)


def _proposed(lag: Lag) -> Finding:
    """Return what tissue tells, which may be its relaxation."""
    return Finding(
        "delay",
        lag.value,
        lag.sd,
        lag.basis if lag.is_told_apart else f"{lag.basis}: {_ALIKE}",
        lag.seconds,
        SUBJECTS["delay"].motion + ("" if lag.is_told_apart else f", or {_SINES}"),
        proposed={
            "displacement.delay": round(lag.value, 4),
            "displacement.delay_sd": round(lag.sd, 4),
        },
        claim=False,
    )


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
    parameters = {
        "displacement.delay": round(value, 6),
        "displacement.delay_sd": round(max(sd, _FILE_SD), 6),
    }
    names = "from " + " and ".join(source.name for source in sources)
    return Finding("delay", value, sd, names, seconds, parameters=parameters)
