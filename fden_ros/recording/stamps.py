# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whose time a message of a bag has: its header's, or that of its recording."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from fden_ros.ros.inputs import TRANSFORMS, TYPE_NAMES

#: Messages at the beginning of a topic whose stamps are looked at.
LOOKED_AT = 200
#: Two topics of one clock are recorded with least delays that differ by less than this [s]: a
#: message waits for no longer. Of 0.4 s between force and displacement a third of N/m is left.
_SAME_CLOCK = 0.1
#: Fewer equal stamps may be chance.
_STANDSTILL = 10
#: Where fewer stamps are different, by this part, the clock is too coarse; a half is a driver that
#: sends each value twice.
_DIFFERENT = 0.4
_REMEDY = (
    "take the times of recording with --stamps recording, live with synchronize.stamp_source: "
    "receive"
)

_NS = 1_000_000_000
#: Types that begin with a header, whose stamp follows the encapsulation's 4 bytes.
_STAMPED = {name for kinds in TYPE_NAMES.values() for name in kinds.values()} - {TRANSFORMS}
_BODY = 4
_DOUBLE = 8


def restamped_data(data: bytes, type_name: str, time_ns: int) -> bytes:
    """Return the bytes of an input message with another header stamp; of others as they are."""
    if type_name == TRANSFORMS:
        try:
            return _restamped_transforms(data, time_ns)
        except (struct.error, IndexError):  # damaged bytes are counted where they are read
            return data
    if type_name not in _STAMPED or len(data) < _BODY + 8:
        return data
    stamp = struct.pack(_format(data), *divmod(time_ns, _NS))
    return data[:_BODY] + stamp + data[_BODY + 8 :]


def _restamped_transforms(data: bytes, time_ns: int) -> bytes:
    """Return the bytes of a message of ``/tf`` whose transforms all have another stamp."""
    stamp, changed = struct.pack(_format(data), *divmod(time_ns, _NS)), bytearray(data)
    length = struct.Struct(_format(data)[0] + "I")
    (count,), at = length.unpack_from(data, _BODY), _BODY + length.size
    for _ in range(count):
        changed[at : at + len(stamp)] = stamp
        at += len(stamp)
        for _ in range(2):  # frame and child
            at += (_BODY - at) % length.size
            at += length.size + length.unpack_from(data, at)[0]
        at += (_BODY - at) % _DOUBLE + 7 * _DOUBLE
        if at > len(data):
            raise IndexError
    return bytes(changed)


def carried_stamp(sample: Any) -> Any:
    """Return the stamp of a decoded message: that of its header or its own; None without."""
    header = getattr(sample, "header", None)
    stamp = getattr(header, "stamp", None) or getattr(sample, "stamp", None)
    return stamp if hasattr(stamp, "nanosec") else None


def problems(stamps: Mapping[str, Sequence[tuple[int, int]]]) -> list[str]:
    """Return why header stamps cannot be used as they are, a line each.

    Parameters
    ----------
    stamps : mapping
        By topic pairs of header stamp and time of recording (ns), of its first messages.
    """
    lines = []
    delays: dict[str, float] = {}
    for topic, pairs in stamps.items():
        headers, times = {header for header, _ in pairs}, {time for _, time in pairs}
        stamped = [pair for pair in pairs if pair[0]]
        if headers == {0}:
            lines.append(f"all header stamps of {topic} are 0, which is none: {_REMEDY}")
        elif len(headers) == 1 and len(times) >= _STANDSTILL:
            lines.append(f"all header stamps of {topic} are the same: {_REMEDY}")
        elif len(times) >= _STANDSTILL and len(headers) <= _DIFFERENT * len(times):
            lines.append(
                f"only {len(headers)} of the first {len(times)} header stamps of {topic} differ: "
                f"{_REMEDY}"
            )
        elif len(stamped) < len(pairs):
            lines.append(
                f"{len(pairs) - len(stamped)} of the first {len(pairs)} header stamps of {topic} "
                f"are 0, which is none: {_REMEDY}"
            )
        if stamped and len(headers) > 1:
            delays[topic] = 1e-9 * min(time - header for header, time in stamped)
    for topic, delay in delays.items():
        first, least = min(delays.items(), key=lambda item: abs(item[1]))
        if abs(delay - least) > _SAME_CLOCK:
            lines.append(
                f"header stamps of {topic} are {delay:.6g} s before its times of recording, those "
                f"of {first} {least:.6g} s: of two clocks? Then {_REMEDY}"
            )
    return lines


def _format(data: bytes) -> str:
    return "<iI" if data[1] & 1 else ">iI"
