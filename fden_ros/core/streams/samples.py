# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Samples of one stream, and pairs of force and displacement at one instant."""

from __future__ import annotations

from typing import NamedTuple

from fden_ros.core.streams.rotation import Quaternion, Vector

#: In a second.
NANOSECONDS = 1_000_000_000
#: 20 ms [ns]: the force in the air is averaged over chunks of at least this time. Samples that are
#: missing for less are no gap.
CHUNK_NS = 20_000_000
#: Half a second [ns] is brief. A stamp that goes back by less is late, by more a jump of the
#: clock. A probe that was off the tissue for less has not left it: it chatters, or slides in a
#: palpation of 1 Hz, which leaves the tissue for at most half of its period.
BRIEF_NS = NANOSECONDS // 2

Position = Vector


class Reason:
    """Why a sample was rejected: the keys of the counts, one per reason and stream."""

    NON_FINITE = "non_finite"
    OUT_OF_RANGE = "out_of_range"
    ZERO_STAMP = "zero_stamp"
    DUPLICATE_STAMP = "duplicate_stamp"
    LATE_STAMP = "late_stamp"
    FUTURE_STAMP = "future_stamp"
    UNPAIRED = "unpaired"
    DISPLACEMENT_GAP = "displacement_gap"
    NO_TRANSFORM = "no_transform"
    TRANSFORM_GAP = "transform_gap"
    OTHER_PARENT = "other_parent"
    WRONG_FRAME = "wrong_frame"
    MISSING_FIELD = "missing_field"
    SPIKE = "spike"
    STUCK = "stuck"


class Sample(NamedTuple):
    """One accepted sample. `epoch` counts the backward jumps of the stream's clock."""

    epoch: int
    stamp_ns: int
    value: float
    position: Position | None = None
    load: float = 0.0  #: force on the sensor that is not the tissue's: the tool's weight [N]
    usual_ns: float = 0.0  #: usual step of its stream before it [ns]; 0: not known
    turn: Quaternion | None = None  #: of a transform, or of the probe
    resolution: float = 0.0  #: step in which the values of its stream came so far; 0: continuous


class Pair(NamedTuple):
    """Force and displacement at one instant."""

    epoch: int
    stamp_ns: int
    force: float  #: [N]
    displacement: float  #: [m]
    position: Position | None  #: of the probe [m]
    tilt: float = 0.0  #: of its axis against the surface's normal, where both are known [rad]
    usual_ns: float = 0.0  #: usual step of the force before it [ns]; 0: not known
