"""Whether the probe left the surface, and whether the recording begins in the air."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fden_ros.configure.finding import Finding, unknown
from fden_ros.configure.session import Session

#: Air before the first touch that the node needs for bias and noise [s].
_LEAST = 1.0


def lift_off_finding(sessions: Sequence[Session]) -> Finding:
    """Say whether and when the probe was in the air."""
    subject = "lift-off"
    if not any(session.contacts for session in sessions):
        return unknown(subject, "no contact was seen", "press tissue, and lift off")
    if not all(session.leaves for session in sessions):
        names = ", ".join(s.streams.name for s in sessions if not s.leaves)
        return Finding(
            subject,
            True,
            "never",
            None,
            "",
            tuple(s.seconds()[0] for s in sessions),
            f"in {names} the force follows the motion throughout: nothing is known of the air",
            "begin with 2 s in the air, and lift off by 3 mm after each press",
        )
    count = sum(len(session.contacts) for session in sessions)
    first = min(
        (s.contacts[0].start - s.streams.start for s in sessions if s.contacts), default=0.0
    )
    seconds = tuple(span for s in sessions for span in s.air_seconds())
    motion = "" if first >= _LEAST else f"begin with 2 s in the air: there is only {first:.1f} s"
    share = float(np.mean(np.concatenate([s.air for s in sessions])))
    return Finding(
        subject,
        True,
        "yes",
        None,
        "",
        seconds,
        f"{count} contacts, in the air for {100.0 * share:.0f} % of the time",
        motion,
    )
