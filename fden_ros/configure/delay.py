# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The delay between force and displacement, from an instant response, or from bends of tissue.

A tool's weight turns with the poses at once, and a rigid plate answers at once: these show it to
half a millisecond. Presses of tissue show it to some 7 ms: the elements of
:mod:`fden_ros.configure.signs` follow any relaxation, and answer at each bend of the motion at
once, so the delay with which they fit best is that of the stamps, where the others are excluded.
Otherwise a filter that the force's noise shows is the least of it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fden_ros.configure.axes import Axes
from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.rigid import Press
from fden_ros.configure.sampling import Filter
from fden_ros.configure.session import Contact, Session
from fden_ros.configure.signs import LEAST_RATIO, contact_fit, independent
from fden_ros.configure.streams import pooled
from fden_ros.configure.weight import Weight
from fden_ros.core.arrays import Array
from fden_ros.parameters import Value

#: A delay is claimed up to this deviation [s]: 1 ms is then two of them.
_LARGEST_SD = 5e-4
#: Least deviation of a source, least and largest in the file [s]: to this the estimator is linear.
_LEAST_SD, _FILE_SD, _MOST_FILE_SD = 2e-5, 1e-4, 0.01
#: A delay of tissue or of a filter is written from this number of deviations on; sources
#: contradict each other beyond the same number.
_CLEAR, _APART = 3.0, 4.0
#: Delays that are tried on tissue, and the steps between them near the best [s].
_DELAYS, _STEP = np.arange(-0.14, 0.161, 0.02), 0.005
#: A delay this far from the best [s] is excluded, or relaxation cannot be separated from it.
_EXCLUDED = 0.04
#: The probe has not turned back above this part of the depth.
_DEEP = 0.98
#: Times of relaxation [s], and knots of the depth.
_RELAXATION, _KNOTS = (0.01, 0.05, 0.3, 2.0), 7
#: Presses that are analysed, the length of each [s], and its samples per second.
_PRESSES, _LONGEST, _RATE = 2, 8.0, 200.0
#: Air before and after a press [s].
_AIR = 0.5
#: Largest residual of a fit: deviations of the noise, or a part of the force's range.
_MOST_NOISE, _MOST_PART = 3.0, 0.005
#: Shift of the delay by the relaxation of a power law over these elements [s].
_LAW_SD = 0.007


class _Source(NamedTuple):
    """A source of the delay, and its delay [s]."""

    name: str
    value: float
    sd: float


def delay_finding(
    weight: Weight | None,
    presses: Sequence[Press],
    sessions: Sequence[Session],
    axes: Axes,
    filtered: Filter | None,
) -> Finding:
    """Return the delay of the displacement's stamps behind the force's."""
    sources = []
    if weight is not None and weight.is_clear:
        sd = math.hypot(weight.delay_sd, _LEAST_SD)
        sources.append(_Source("the tool's weight in turns", weight.delay, sd))
    if presses:
        sds = np.hypot([press.delay_sd for press in presses], _LEAST_SD)
        found = pooled([press.delay for press in presses], sds)
        sources.append(_Source("rigid presses", *found))
    good = [source for source in sources if source.sd < _LARGEST_SD]
    for one, other in itertools.combinations(good, 2):
        if abs(one.value - other.value) > _APART * math.hypot(one.sd, other.sd):
            words = [f"{1e3 * s.value:.2f} ms from {s.name}" for s in (one, other)]
            return unknown("delay", f"{' but '.join(words)}: not constant, or filtered")
    if good:
        found = pooled([one.value for one in good], [one.sd for one in good])
        return _stated(" and ".join(one.name for one in good), *found, least=0.0)
    if of_tissue := _of_tissue(sessions, axes):
        return _stated(*of_tissue)
    if filtered is not None:
        name = "the filter of the force alone, seen in its noise in the air"
        return _stated(name, -filtered.delay, filtered.sd)
    words = [
        f"{1e3 * one.value:.1f} ± {1e3 * one.sd:.1g} ms from {one.name} is too uncertain"
        for one in sources
    ]
    return unknown("delay", "; ".join(words) or "the recording has no sudden motion")


def _stated(name: str, value: float, sd: float, least: float = _CLEAR) -> Finding:
    """Return a delay; the default of 0 stays within this number of deviations."""
    if abs(value) < least * sd:
        return Finding("delay", value, sd, f"from {name}; the default of 0 agrees with it")
    values: dict[str, Value] = {
        "displacement.delay": round(value, 6),
        "displacement.delay_sd": round(min(max(sd, _FILE_SD), _MOST_FILE_SD), 6),
    }
    return Finding("delay", value, sd, f"from {name}", parameters=values)


def _of_tissue(sessions: Sequence[Session], axes: Axes) -> _Source | None:
    """Return the delay that presses of tissue show; None: it may be relaxation."""
    if axes.force is None or axes.displacement is None:
        return None
    into, grows = axes.displacement.direction, axes.force.direction
    contacts = ((s, contact) for s in sessions if s.leaves for contact in s.contacts)
    found = [_of_press(*one, grows, into) for one in itertools.islice(contacts, _PRESSES)]
    delays = [delay for delay in found if delay is not None]
    if not delays or len(delays) < len(found):
        return None
    value, sd = pooled(delays, [_LAW_SD] * len(delays))
    presses = "press" if len(delays) == 1 else "presses"
    name = f"the bends of {len(delays)} {presses} of tissue"
    return _Source(name, value, max(sd, _LAW_SD))


def _of_press(session: Session, contact: Contact, grows: Array, into: Array) -> float | None:
    """Return the delay of one press [s]; None where another fits nearly as well."""
    streams = session.streams
    rate = min(_RATE, 1.0 / float(np.median(np.diff(streams.force_times))))
    margin = float(_DELAYS[-1])
    start = max(contact.start - _AIR, streams.start + margin)
    end = min(contact.end + _AIR, contact.start + _LONGEST, streams.end - margin)
    times = np.arange(start, end, 1.0 / rate)
    push = np.interp(times, streams.force_times, session.unloaded @ grows)
    depth = streams.position @ into
    inside = depth[(streams.motion_times > contact.start) & (streams.motion_times < end)]
    touch = np.interp(contact.start, streams.motion_times, depth)
    reach = float(inside.max() - touch) if inside.size else 0.0
    knots = touch + reach * np.linspace(-0.15, 1.0, _KNOTS, endpoint=False)
    # Where the probe turns back, play of its drive looks like a delay.
    deep = streams.motion_times[depth > touch + _DEEP * reach]
    times = times[times < deep[deep < end].max(initial=start)]
    push = push[: times.size]
    if times.size < 2 * _KNOTS * len(_RELAXATION):
        return None

    def fitted(delay: float) -> Array:
        moved = np.interp(times + delay, streams.motion_times, depth)
        return contact_fit(times, push, moved, knots, _RELAXATION)[0]

    tried = {float(delay): fitted(float(delay)) for delay in _DELAYS}
    best = min(tried, key=lambda delay: float(tried[delay] @ tried[delay]))
    for more in np.arange(-3.0, 4.0) * _STEP:
        tried[best + float(more)] = fitted(best + float(more))
    misfits = {delay: float(left @ left) for delay, left in tried.items()}
    best = min(misfits, key=lambda delay: misfits[delay])
    # A press that the elements do not describe shows no delay.
    noise = float(np.linalg.norm(session.force_noise * grows))
    most = max(_MOST_NOISE * noise, _MOST_PART * float(np.ptp(push)))
    if math.sqrt(misfits[best] / times.size) > most:
        return None
    count = 0.5 * independent(tried[best])
    apart = [d for d in misfits if abs(d - best) >= _EXCLUDED]
    sides = [[misfits[d] for d in apart if (d > best) is later] for later in (False, True)]
    if not all(sides):
        return None
    odds = count * math.log(min(map(min, sides)) / max(misfits[best], 1e-300))
    return best if odds > math.log(LEAST_RATIO) else None
