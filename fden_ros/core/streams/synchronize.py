# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Streams of stamped samples into pairs: all others interpolated to the stamps of the force.

A force waits for the displacements around its stamp and then, where the tissue's surface is
measured too, for the surface around it: :class:`~fden_ros.core.streams.join.Join`.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fden_ros.core.streams.frames import Frames, FramesConfig, StaticLinks, between
from fden_ros.core.streams.guard import StreamGuard
from fden_ros.core.streams.join import NOISE_SAMPLES, Around, Join, JoinLimits, Passed
from fden_ros.core.streams.rotation import Quaternion, Transform, Vector
from fden_ros.core.streams.samples import (
    NANOSECONDS,
    Pair,
    Position,
    Reason,
    Sample,
)
from fden_ros.core.streams.tool import ToolPath, ToolPathConfig

#: The median of the magnitude of a normal variable, by which noise is measured, in standard
#: deviations.
_MEDIAN_OF_NORMAL = 0.6745
#: Variance of what is rounded off, in squares of a step: four times that of a single value,
#: since it stays over several samples while the probe moves (six in a press at 4 mm/s by an
#: encoder of 50 um at 500 Hz).
_ROUNDING_VARIANCE = 4.0 / 12.0


@dataclass(frozen=True)
class SynchronizeConfig:
    """How streams are checked and paired; times in seconds.

    Parameters
    ----------
    displacement_delay : float
        The displacement's stamps lag the force's by this much [s]; may be negative.
    max_gap : float
        Displacement samples further apart than this, and than 2 usual steps of the force, are not
        interpolated between [s].
    pairing_window : float
        A sample waits at most this long, in stamps, for its partner [s]; or 4 usual steps of its
        stream, where they are longer.
    force_limit, displacement_limit : float
        Larger magnitudes are rejected as out of range [N, m].
    takes_surface : bool
        A force waits for the surface around it too, which is taken off the displacement.
    surface_delay : float
        The surface's stamps lag the force's by this much [s]; may be negative.
    frames : FramesConfig, optional
        A force waits for the transforms around it too, whose stamps lag like the displacement's.
    tool_path : ToolPathConfig, optional
        The displacement is the probe's along its own axis.
    """

    displacement_delay: float = 0.0
    max_gap: float = 0.25
    pairing_window: float = 5.0
    force_limit: float = 1e5
    displacement_limit: float = 10.0
    takes_surface: bool = False
    surface_delay: float = 0.0
    frames: FramesConfig | None = None
    tool_path: ToolPathConfig | None = None


class Synchronizer:
    """Pair force with displacement by stamp.

    Parameters
    ----------
    config : SynchronizeConfig
    on_pair : callable
        Called with each :class:`Pair`, in order.
    rejected : collections.Counter
        Counts of rejected samples, keyed ``"<stream>.<reason>"``; added to.
    statics : StaticLinks, optional
        Static transforms that are known by now; added to.
    """

    def __init__(
        self,
        config: SynchronizeConfig,
        on_pair: Callable[[Pair], None],
        rejected: Counter[str],
        statics: StaticLinks | None = None,
    ) -> None:
        self._config = config
        self._on_pair = on_pair
        self._rejected = rejected
        self.force_guard = StreamGuard(
            config.force_limit, rejected, "force", is_vector=config.frames is not None
        )
        self._path = ToolPath(config.tool_path) if config.tool_path is not None else None
        self.displacement_guard = StreamGuard(
            config.displacement_limit,
            rejected,
            "displacement",
            is_vector=config.tool_path is not None,
        )
        self.surface_guard = StreamGuard(config.displacement_limit, rejected, "surface")
        self._passed, self._surfaces_passed = Passed(), Passed()
        self._displacements = Join[None](
            self._limits(config.displacement_delay, Reason.UNPAIRED, Reason.DISPLACEMENT_GAP),
            self.force_guard,
            self.displacement_guard,
            self._on_displacement,
            self._passed,
        )
        self._surfaces = Join[Pair](
            self._limits(config.surface_delay, Reason.NO_SURFACE, Reason.SURFACE_GAP),
            self.force_guard,
            self.surface_guard,
            self._on_surface,
            self._surfaces_passed,
        )

        self._force_frame = ""
        self.frames: Frames | None = None
        if config.frames is not None:
            self.frames = Frames(
                config.frames,
                self._limits(config.displacement_delay, Reason.NO_TRANSFORM, Reason.TRANSFORM_GAP),
                self.force_guard,
                self._transform_guard,
                statics if statics is not None else StaticLinks(),
                self._in_base,
                self._path,
            )

    def _transform_guard(self) -> StreamGuard:
        limit = self._config.displacement_limit
        return StreamGuard(limit, self._rejected, "transform", is_vector=True)

    def _limits(self, delay: float, unpaired: str, gap: str) -> JoinLimits:
        return JoinLimits(
            max_gap_ns=round(self._config.max_gap * NANOSECONDS),
            window_ns=round(self._config.pairing_window * NANOSECONDS),
            delay_ns=round(delay * NANOSECONDS),
            unpaired=unpaired,
            gap=gap,
        )

    @property
    def waiting(self) -> int:
        """How many samples of all streams are kept for others to come."""
        in_frames = self.frames.waiting if self.frames is not None else 0
        return self._displacements.waiting + self._surfaces.waiting + in_frames

    def path_noise(self) -> float:
        """Return the noise of the motion: variance per sample times the time between [m^2 s].

        From the distances of the last 256 samples of displacement, surface and transforms from the
        lines between their neighbours, or from the steps in which they come; 0 while there are
        fewer than 32.
        """
        streams = [self._passed, self._surfaces_passed]
        if self.frames is not None:
            streams.append(self.frames.passed)
        return sum(_noise_of(passed.samples) for passed in streams)

    def add_force(self, stamp_ns: int, force: float) -> None:
        """Add a force sample [N]."""
        self._lead(self.force_guard.accept(stamp_ns, force))

    def add_force_vector(self, stamp_ns: int, frame: str, force: Vector) -> None:
        """Add a force [N] or torque [N m] in a frame that moves."""
        self._force_frame = frame
        x, y, z = force
        self._lead(self.force_guard.accept(stamp_ns, x + y + z, force))

    def add_transform(
        self, stamp_ns: int, parent: str, child: str, transform: Transform, *, is_static: bool
    ) -> None:
        """Add where a frame is in its parent; a static one holds at all times."""
        if self.frames is None:
            return
        problem = self.frames.add_transform(
            stamp_ns, parent, child, transform, is_static=is_static
        )
        if problem is not None:
            self._rejected[f"transform.{problem}"] += 1

    def add_displacement(
        self,
        stamp_ns: int,
        displacement: float,
        position: Position | None = None,
        load: float = 0.0,
        turn: Quaternion | None = None,
    ) -> None:
        """Add a displacement sample [m], and the probe's position [m] and turn where known.

        `load` [N] is what the sensor measures there without any contact.
        """
        self._displacements.follow(
            self.displacement_guard.accept(stamp_ns, displacement, position, load, turn)
        )

    def add_surface(self, stamp_ns: int, surface: float) -> None:
        """Add a place of the tissue's surface, along the displacement [m]."""
        if self._config.takes_surface:
            self._surfaces.follow(self.surface_guard.accept(stamp_ns, surface))

    def _lead(self, forces: tuple[Sample, ...]) -> None:
        frames = self._config.frames
        for force in forces:
            if frames is None or not frames.moves_probe:
                self._displacements.lead(force, None)
            else:
                # The transforms give the displacement.
                self._on_force(force, Pair(force.epoch, force.stamp_ns, force.value, 0.0, None))

    def _on_displacement(self, force: Sample, _: None, around: Around) -> None:
        pair = Pair(
            force.epoch,
            force.stamp_ns,
            force.value - around.load,
            around.value,
            around.position,
        )
        if self._path is not None:
            displacement, tilt = self._path.add(between(around))
            pair = pair._replace(displacement=displacement, tilt=tilt)
        self._on_force(force, pair)

    def _on_force(self, force: Sample, pair: Pair) -> None:
        if self.frames is not None:
            self.frames.lead(force, pair, self._force_frame)
        else:
            self._in_base(force, pair)

    def _in_base(self, force: Sample, pair: Pair) -> None:
        if self._config.takes_surface:
            self._surfaces.lead(force, pair)
        else:
            self._make(pair)

    def _on_surface(self, _: Sample, pair: Pair, around: Around) -> None:
        place = around.value
        self._make(pair._replace(displacement=pair.displacement - place, surface=place))

    def _make(self, pair: Pair) -> None:
        key = (pair.epoch, pair.stamp_ns)
        self._passed.until(key)
        self._surfaces_passed.until(key)
        if self.frames is not None:
            self.frames.passed.until(key)
        self._on_pair(pair)


def _noise_of(samples: deque[Sample]) -> float:
    if len(samples) < NOISE_SAMPLES // 8:
        return 0.0
    time = np.array([sample.stamp_ns - samples[0].stamp_ns for sample in samples])
    value = np.array([sample.value for sample in samples])
    step = np.diff(time) / NANOSECONDS
    fraction = step[:-1] / (step[:-1] + step[1:])
    apart = value[1:-1] - (1.0 - fraction) * value[:-2] - fraction * value[2:]
    scale = np.sqrt(1.0 + fraction**2 + (1.0 - fraction) ** 2)
    sd = float(np.median(np.abs(apart / scale))) / _MEDIAN_OF_NORMAL
    rounding = _ROUNDING_VARIANCE * samples[-1].resolution ** 2
    return max(sd**2, rounding) * float(np.median(step))
