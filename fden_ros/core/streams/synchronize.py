# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Streams of stamped samples into pairs: all others interpolated to the stamps of the force.

A force waits for one stream after the other: for the displacements around its stamp, the
transforms, where they are needed: :class:`~fden_ros.core.streams.join.Join`.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

from fden_ros.core.parameter import TINY, parameter
from fden_ros.core.streams.frames import Frames, FramesConfig, StaticLinks, between
from fden_ros.core.streams.guard import StreamGuard
from fden_ros.core.streams.join import NOISE_SAMPLES, Join, JoinLimits, Matched, Passed
from fden_ros.core.streams.rotation import Quaternion, Transform, Vector, dot
from fden_ros.core.streams.samples import NANOSECONDS, Pair, Position, Reason, Sample
from fden_ros.core.streams.tool import ToolPath, ToolPathConfig

#: Variance of what is rounded off, in squares of a step: four times that of a single value,
#: since it stays over several samples while the probe moves (six in a press at 4 mm/s by an
#: encoder of 50 um at 500 Hz).
_ROUNDING_VARIANCE = 4.0 / 12.0


@dataclass(frozen=True)
class SynchronizeConfig:
    """How streams are checked and paired."""

    displacement_delay: float = parameter(
        "displacement.delay",
        0.0,
        "How much later than the force the displacement is stamped for the same instant.",
        "s",
        -10.0,
        10.0,
    )
    max_gap: float = parameter(
        "synchronize.max_gap",
        0.25,
        "Displacement samples further apart, and than 2 usual steps of the force, are not "
        "interpolated between; a longer gap ends a contact.",
        "s",
        1e-4,
        10.0,
    )
    max_wait: float = parameter(
        "synchronize.max_wait",
        5.0,
        "How long a sample waits, in stamps, for the other stream; or 4 usual steps of its own.",
        "s",
        0.01,
        60.0,
    )
    force_limit: float = parameter(
        "force.limit", 1e5, "Forces of larger magnitude are rejected.", "N", TINY, 1e9
    )
    #: Displacements of larger magnitude are rejected [m].
    displacement_limit: float = 10.0
    #: A force waits for the transforms around it too, whose stamps lag like the displacement's.
    frames: FramesConfig | None = None
    #: The displacement is the probe's along its own axis.
    tool_path: ToolPathConfig | None = None


class Synchronizer:
    """Pair force with displacement by stamp.

    Parameters
    ----------
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
        self._displacements = self._join(
            self.displacement_guard, Reason.UNPAIRED, Reason.DISPLACEMENT_GAP
        )
        self.frames: Frames | None = None
        self._moves_probe = False  # the transforms give the displacement
        self._moved, self._moved_ns = Passed(), 0
        self._held: deque[Sample] = deque()  # forces whose frame is not known
        if config.frames is not None:
            self._moves_probe = config.frames.moves_probe
            known = statics if statics is not None else StaticLinks()
            self.frames = Frames(config.frames, self._link, known)
        self._joins: list[Join] = []  # in the order in which a force waits for them
        if self.frames is None:
            self._order_joins()

    def _order_joins(self) -> None:
        first = [] if self._moves_probe else [self._displacements]
        links = self.frames.joins if self.frames is not None else []
        self._joins = [*first, *links]

    def _link(self) -> Join:
        """Return what lets forces wait for a link between frames."""
        limit = self._config.displacement_limit
        guard = StreamGuard(limit, self._rejected, "transform", is_vector=True)
        return self._join(guard, Reason.NO_TRANSFORM, Reason.TRANSFORM_GAP)

    def _join(self, guard: StreamGuard, unpaired: str, gap: str) -> Join:
        """Return what lets forces wait for a stream whose stamps lag."""
        limits = JoinLimits(
            max_gap_ns=round(self._config.max_gap * NANOSECONDS),
            window_ns=round(self._config.max_wait * NANOSECONDS),
            delay_ns=round(self._config.displacement_delay * NANOSECONDS),
            unpaired=unpaired,
            gap=gap,
        )
        return Join(limits, self.force_guard, guard, self._advance)

    @property
    def waiting(self) -> int:
        """How many samples of all streams are kept for others to come."""
        kept = self.frames.kept if self.frames is not None else 0
        return kept + len(self._held) + sum(join.waiting for join in self._joins)

    def path_noise(self) -> float:
        """Return the noise of the motion: variance per sample times the time between [m^2 s].

        From the distances of the last 256 samples of displacement and transforms from the lines
        between their neighbours, or from the steps in which they come; 0 while there are
        fewer than 32.
        """
        streams = (self._displacements.passed, self._moved)
        return sum(_noise_of(passed.samples) for passed in streams)

    def add_force(self, stamp_ns: int, force: float) -> None:
        """Add a force sample [N]."""
        self._lead(self.force_guard.accept(stamp_ns, force))

    def add_force_vector(self, stamp_ns: int, frame: str, force: Vector) -> None:
        """Add a force [N] or torque [N m] in a frame that moves."""
        x, y, z = force
        self._lead(self.force_guard.accept(stamp_ns, x + y + z, force), frame)

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
        self._release()

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
        self._displacements.follow(stamp_ns, displacement, position, load, turn)

    def _lead(self, forces: tuple[Sample, ...], frame: str = "") -> None:
        for force in forces:
            if self.frames is None or self._joins:
                self._advance(force, ())
                continue
            self.frames.name_force(frame)
            self._held.append(force)
            self._release()
            while self._held and self._has_waited(self._held[0], force):
                self._held.popleft()
                self.force_guard.reject(Reason.NO_TRANSFORM)

    def _has_waited(self, oldest: Sample, newest: Sample) -> bool:
        waited_ns = newest.stamp_ns - oldest.stamp_ns
        window_ns = round(self._config.max_wait * NANOSECONDS)
        return oldest.epoch != newest.epoch or waited_ns > window_ns

    def _release(self) -> None:
        """Let the forces go on that were held, once all frames are known."""
        if self.frames is None or not self.frames.is_known or self._joins:
            return
        self._order_joins()
        while self._held:
            self._advance(self._held.popleft(), ())

    def _advance(self, force: Sample, matched: Matched) -> None:
        """Let a force wait for the next stream, or make the pair once it has met all."""
        if len(matched) < len(self._joins):
            self._joins[len(matched)].lead(force, matched)
        else:
            self._make(force, matched)

    def _make(self, force: Sample, matched: Matched) -> None:
        count = len(self.frames.joins) if self.frames is not None else 0
        first = 0 if self._moves_probe else 1
        links = matched[first : first + count]
        displacement, position, tilt = self._motion(force, matched, links)
        key = force.epoch, force.stamp_ns
        for passed in (self._moved, *(join.passed for join in self._joins)):
            passed.until(key)
        value = self._force(force, matched, links)
        self._on_pair(Pair(*key, value, displacement, position, tilt))

    def _force(self, force: Sample, matched: Matched, links: Matched) -> float:
        """Return the force along its axis, the tool's weight taken off [N]."""
        value = force.value if self._moves_probe else force.value - matched[0].load
        if self.frames is None:
            return value
        if force.position is not None:
            value = self.frames.force_along(force.position, links)
        tool = self._config.frames.tool if self._config.frames is not None else None
        if self._moves_probe and self._path is not None and tool is not None:
            value -= tool.load(self.frames.probe(links).rotation)
        return value

    def _motion(
        self, force: Sample, matched: Matched, links: Matched
    ) -> tuple[float, Position | None, float]:
        """Return displacement [m], position [m] and tilt [rad] of the probe."""
        frames, path = self._config.frames, self._path
        if self.frames is None or frames is None or not frames.moves_probe:
            around = matched[0]
            way = (around.value, 0.0) if path is None else path.add(between(around))
            return way[0], around.position, way[1]
        probe = self.frames.probe(links)
        along = dot(frames.displacement_axis, probe.translation)
        displacement, tilt = (along, 0.0) if path is None else path.add(probe)
        if links and links[-1].before.stamp_ns != self._moved_ns:
            # One per transform, for its noise.
            self._moved_ns = links[-1].before.stamp_ns
            key = force.epoch, force.stamp_ns
            self._moved.add(key, Sample(*key, displacement))
        return displacement, probe.translation, tilt


def _noise_of(samples: deque[Sample]) -> float:
    if len(samples) < NOISE_SAMPLES // 8:
        return 0.0
    import numpy as np  # here alone: what reads recordings uses this room without it

    time = np.array([sample.stamp_ns - samples[0].stamp_ns for sample in samples])
    value = np.array([sample.value for sample in samples])
    step = np.diff(time) / NANOSECONDS
    fraction = step[:-1] / (step[:-1] + step[1:])
    apart = value[1:-1] - (1.0 - fraction) * value[:-2] - fraction * value[2:]
    scale = np.sqrt(1.0 + fraction**2 + (1.0 - fraction) ** 2)
    # The median of a normal variable's magnitude is 0.6745 deviations.
    sd = float(np.median(np.abs(apart / scale))) / 0.6745
    rounding = _ROUNDING_VARIANCE * samples[-1].resolution ** 2
    return max(sd**2, rounding) * float(np.median(step))
