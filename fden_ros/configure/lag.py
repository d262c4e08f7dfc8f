# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The delay between force and displacement that presses of tissue show, where they do.

Springs and Maxwell elements with weights that are not negative (:mod:`fden_ros.configure.signs`)
follow any relaxation, and answer at each bend of the motion at once: at the touch, at the end of a
ramp, in a sine. So the delay with which they fit best is that of the stamps, where the others are
excluded. What they lack of a power law moves it by up to 10 ms.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fden_ros.configure.axes import Axes
from fden_ros.configure.finding import Seconds
from fden_ros.configure.session import Contact, Session
from fden_ros.configure.signs import LEAST_RATIO, contact_fit, independent
from fden_ros.configure.statistics import pooled
from fden_ros.core.arrays import Array

#: Delays that are tried, and the steps between them near the best [s].
_DELAYS = np.arange(-0.14, 0.161, 0.02)
_STEP = 0.005
#: A delay so far from the best [s] is excluded, or relaxation cannot be told from it.
_EXCLUDED = 0.04
#: Times of relaxation [s], and knots of the depth.
_RELAXATION, _KNOTS = (0.01, 0.05, 0.3, 2.0), 7
#: Presses that are looked at, for so long each [s], and samples a second of it.
_PRESSES, _LONGEST, _RATE = 2, 8.0, 200.0
#: Air before and after a press [s].
_AIR = 0.5
#: What a fit may leave: deviations of the noise, or a part of the force's range.
_MOST_NOISE, _MOST_PART = 3.0, 0.005
#: What the relaxation of a power law over these elements moves the delay [s].
_LAW_SD = 0.007


class Lag(NamedTuple):
    """A delay of the displacement's stamps behind the force's."""

    value: float  #: [s]
    sd: float  #: [s]
    presses: int
    seconds: Seconds


def find_lag(sessions: Sequence[Session], axes: Axes) -> Lag | None:
    """Return the delay that presses of tissue show; None: they tell it not from relaxation."""
    if axes.force is None or axes.displacement is None:
        return None
    contacts = ((s, contact) for s in sessions if s.leaves for contact in s.contacts)
    chosen = tuple(itertools.islice(contacts, _PRESSES))
    found = [_of_press(session, contact, axes) for session, contact in chosen]
    delays = [delay for delay in found if delay is not None]
    if not delays or len(delays) < len(found):
        return None
    value, sd = pooled(delays, [_LAW_SD] * len(delays))
    seconds = tuple(session.seconds((contact,))[0] for session, contact in chosen)
    return Lag(value, max(sd, _LAW_SD), len(delays), seconds)


def _of_press(session: Session, contact: Contact, axes: Axes) -> float | None:
    """Return the delay of one press [s]; None where another fits nearly as well."""
    assert axes.force is not None and axes.displacement is not None
    streams = session.streams
    rate = min(_RATE, 1.0 / float(np.median(np.diff(streams.force_times))))
    margin = float(_DELAYS[-1])
    start = max(contact.start - _AIR, streams.start + margin)
    end = min(contact.end + _AIR, contact.start + _LONGEST, streams.end - margin)
    times = np.arange(start, end, 1.0 / rate)
    if times.size < 2 * _KNOTS * len(_RELAXATION):
        return None
    force = session.unloaded @ axes.force.direction
    push = np.interp(times, streams.force_times, force)
    depth = streams.position @ axes.displacement.direction
    inside = depth[(streams.motion_times > contact.start) & (streams.motion_times < end)]
    touch = np.interp(contact.start, streams.motion_times, depth)
    reach = float(inside.max() - touch) if inside.size else 0.0
    knots = touch + reach * np.linspace(-0.15, 1.0, _KNOTS, endpoint=False)

    def fitted(delay: float) -> Array:
        moved = np.interp(times + delay, streams.motion_times, depth)
        return contact_fit(times, push, moved, knots, _RELAXATION)[0]

    tried = {float(delay): fitted(float(delay)) for delay in _DELAYS}
    best = min(tried, key=lambda delay: float(tried[delay] @ tried[delay]))
    if best in (float(_DELAYS[0]), float(_DELAYS[-1])):
        return None
    for more in np.arange(-3.0, 4.0) * _STEP:
        tried[best + float(more)] = fitted(best + float(more))
    misfits = {delay: float(left @ left) for delay, left in tried.items()}
    best = min(misfits, key=lambda delay: misfits[delay])
    # A press that the elements do not describe shows no delay.
    noise = float(np.linalg.norm(session.force_noise * axes.force.direction))
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
