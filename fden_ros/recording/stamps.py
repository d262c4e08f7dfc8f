# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The time of a bag's message: its header's, or that of its recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

#: Messages at the beginning of a topic whose stamps are looked at.
LOOKED_AT = 200
#: The least delays of two topics of one clock differ by less than this [s]: no message waits for
#: longer. With 0.4 s between force and displacement a third of N/m remains.
_SAME_CLOCK = 0.1
#: Fewer equal stamps may be coincidence.
_STANDSTILL = 10
#: The clock is too coarse where a smaller part of the stamps is different; a half is a driver that
#: sends each value twice.
_DIFFERENT = 0.4
_REMEDY = (
    "take the times of recording with --stamps recording, live with synchronize.stamp_source: "
    "receive"
)


def carried_stamp(sample: Any) -> Any:
    """Return the stamp of a decoded message: that of its header or its own; None without."""
    header = getattr(sample, "header", None)
    stamp = getattr(header, "stamp", None) or getattr(sample, "stamp", None)
    return stamp if hasattr(stamp, "nanosec") else None


def problems(stamps: Mapping[str, Sequence[tuple[int, int]]]) -> list[str]:
    """Return why header stamps cannot be used as they are, a line each.

    `stamps` are by topic pairs of header stamp and time of recording (ns) of its first messages.
    """
    lines = []
    delays: dict[str, float] = {}
    for topic, pairs in stamps.items():
        headers, times = {header for header, _ in pairs}, {time for _, time in pairs}
        stamped = [pair for pair in pairs if pair[0]]
        first = f"of the first {len(pairs)} header stamps of {topic}"
        if zeros := len(pairs) - len(stamped):
            lines.append(f"{zeros} {first} are 0, which means none: {_REMEDY}")
        elif len(times) >= _STANDSTILL and len(headers) <= max(_DIFFERENT * len(times), 1):
            lines.append(f"only {len(headers)} {first} differ: {_REMEDY}")
        if len(headers) > 1:
            delays[topic] = 1e-9 * min(time - header for header, time in stamped)
    for topic, delay in delays.items():
        other, least = min(delays.items(), key=lambda item: abs(item[1]))
        if abs(delay - least) > _SAME_CLOCK:
            lines.append(
                f"header stamps of {topic} are {delay:.6g} s before its times of recording, those "
                f"of {other} {least:.6g} s: from two clocks? Then {_REMEDY}"
            )
    return lines
