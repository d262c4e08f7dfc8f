# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Force and displacement over a whole recording, in bounded memory."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any, cast

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.streams import (
    NANOSECONDS,
    Pair,
    Position,
    Quaternion,
    Sink,
    SynchronizeConfig,
    Synchronizer,
    Transform,
)
from fden_ros.parameters import Parameters, pipeline_config
from fden_ros.recording.source import Source

_BUCKETS = 1500


class Envelope:
    """Least and largest value of a signal in each of a bounded number of stretches of time."""

    def __init__(self) -> None:
        self._width_ns = 1_000_000
        self._start_ns: int | None = None
        self._buckets: dict[int, tuple[float, float]] = {}

    def add(self, stamp_ns: int, value: float) -> None:
        """Take a sample; what is not finite or before the first is left out."""
        if not math.isfinite(value):
            return
        if self._start_ns is None:
            self._start_ns = stamp_ns
        index = (stamp_ns - self._start_ns) // self._width_ns
        if index < 0:
            return
        low, high = self._buckets.get(index, (value, value))
        self._buckets[index] = (min(low, value), max(high, value))
        if len(self._buckets) > _BUCKETS:
            self._widen()

    def _widen(self) -> None:
        wider: dict[int, tuple[float, float]] = {}
        for index, (low, high) in self._buckets.items():
            other = wider.get(index // 2, (low, high))
            wider[index // 2] = (min(low, other[0]), max(high, other[1]))
        self._buckets, self._width_ns = wider, 2 * self._width_ns

    def arrays(self, origin_ns: int) -> tuple[Array, Array, Array]:
        """Return time since `origin_ns` [s], least and largest values, shape (n,) each."""
        if self._start_ns is None:
            return (np.zeros(0),) * 3
        indices = sorted(self._buckets)
        middle = self._start_ns - origin_ns + self._width_ns // 2
        time = (np.array(indices, dtype=np.int64) * self._width_ns + middle) / NANOSECONDS
        low, high = np.array([self._buckets[index] for index in indices]).T
        return time, low, high


class Signals(Sink):
    """Force and displacement over the whole recording, sample by sample."""

    def __init__(self) -> None:
        self.force, self.displacement = Envelope(), Envelope()
        self.start_ns: int | None = None
        self.end_ns = 0

    def add_force(self, stamp_ns: int, force: float) -> None:
        """Take a sample of the force."""
        self._see(stamp_ns)
        self.force.add(stamp_ns, force)

    def add_displacement(
        self,
        stamp_ns: int,
        displacement: float,
        position: Position | None = None,
        load: float = 0.0,
        turn: Quaternion | None = None,
    ) -> None:
        """Take a sample of the displacement."""
        self._see(stamp_ns)
        self.displacement.add(stamp_ns, displacement)

    def _see(self, stamp_ns: int) -> None:
        if self.start_ns is None:
            self.start_ns = stamp_ns
        self.end_ns = max(self.end_ns, stamp_ns)


class _Paired:
    """Stands before signals where frames move: only pairs are along the axes."""

    def __init__(self, config: SynchronizeConfig, signals: Signals) -> None:
        self._signals = signals
        self._streams = Synchronizer(config, self._take, Counter())

    def __getattr__(self, name: str) -> Any:
        return getattr(self._streams, name)

    def add_transform(
        self,
        stamp_ns: int,
        parent: str,
        child: str,
        translation: Position,
        rotation: Quaternion,
        *,
        is_static: bool,
    ) -> None:
        place = Transform(translation, rotation)
        self._streams.add_transform(stamp_ns, parent, child, place, is_static=is_static)

    def reject(self, stream: str, reason: str) -> None:
        return

    def _take(self, pair: Pair) -> None:
        self._signals.add_force(pair.stamp_ns, pair.force)
        self._signals.add_displacement(pair.stamp_ns, pair.displacement)


def signals_of(source: Source, parameters: Parameters) -> Signals:
    """Return force and displacement of a recording."""
    signals, config = Signals(), pipeline_config(parameters).synchronize
    is_turned = config.frames is not None or config.tool_path is not None
    sink = cast(Sink, _Paired(config, signals)) if is_turned else signals
    for _ in source.feed(sink, lambda log_time_ns, message: None):
        pass
    return signals
