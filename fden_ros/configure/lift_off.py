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
