# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Streams of stamped samples into pairs: all others interpolated to the stamps of the force.

A force waits for one stream after the other: for the displacements around its stamp, and for the
transforms where they are needed: :class:`~fden_ros.core.streams.join.Join`.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fden_ros.core.parameter import TINY, parameter
from fden_ros.core.streams.frames import Frames, FramesConfig, StaticLinks
from fden_ros.core.streams.guard import USUAL_SAMPLES, StreamGuard
from fden_ros.core.streams.join import Join, Matched
from fden_ros.core.streams.rotation import Transform, Vector
from fden_ros.core.streams.samples import NANOSECONDS, Pair, Position, Reason, Sample
from fden_ros.core.streams.tool import ToolPath


@dataclass(frozen=True)
class SynchronizeConfig:
    """How streams are checked and paired."""

    displacement_delay: float = parameter(
        "displacement.delay",
        0.0,
        "Time by which the displacement is stamped later than the force of the same instant.",
        "s",
        -10.0,
        10.0,
    )
    max_gap: float = parameter(
        "synchronize.max_gap",
        0.25,
        "Longest gap between displacement samples that is interpolated, or 2 usual steps of the "
        "force if longer; a longer gap ends a contact.",
        "s",
        1e-4,
        10.0,
    )
    max_wait: float = parameter(
        "synchronize.max_wait",
        5.0,
        "Time, by the stamps, that a sample waits for the other stream; or 4 of its own usual "
        "steps.",
        "s",
        0.01,
        60.0,
    )
    force_limit: float = parameter(
        "force.limit", 1e5, "Forces of larger magnitude are rejected.", "N", TINY, 1e9
    )
    #: Displacements of larger magnitude are rejected [m].
    displacement_limit: float = 10.0
    #: A force also waits for the transforms around it, whose stamps lag like the displacement's.
    frames: FramesConfig | None = None
    #: The displacement is the probe's along this axis of its own frame, a unit vector out of its
    #: tip. The normal is a unit vector into the tissue, perpendicular to its surface; if it is not
    #: known, the probe is assumed to stand upright.
    tool_axis: Vector | None = None
    tool_normal: Vector | None = None


class Synchronizer:
    """Pair force with displacement by stamp.

    Parameters
    ----------
    on_pair : callable
        Called with each :class:`Pair`, in order.
    rejected : collections.Counter
        Counts of rejected samples, keyed ``"<stream>.<reason>"``; added to.
    statics : StaticLinks, optional
        Static transforms that are known so far; added to.
    """

    def __init__(
        self,
        config: SynchronizeConfig,
        on_pair: Callable[[Pair], None],
        rejected: Counter[str],
        statics: StaticLinks | None = None,
    ) -> None:
        self._config, self._on_pair, self._rejected = config, on_pair, rejected
        frames = config.frames
        self.force_guard = StreamGuard(
            config.force_limit, rejected, "force", is_vector=frames is not None
        )
        axis = config.tool_axis
        self._path = ToolPath(axis, config.tool_normal) if axis is not None else None
        reasons = Reason.UNPAIRED, Reason.DISPLACEMENT_GAP
        self._displacements = self._join("displacement", *reasons, is_vector=axis is not None)
        self.displacement_guard = self._displacements.follow_guard
        #: Whether the transforms give the displacement.
        self._moves_probe = frames is not None and frames.moves_probe
        #: Samples of the motion's stream that pairs have followed, and the motion then.
        self._moved: deque[tuple[Sample, Sample]] = deque(maxlen=8 * USUAL_SAMPLES + 1)
        self._held: deque[Sample] = deque()  # forces, until all frames are known
        self.frames: Frames | None = None
        if frames is not None:
            links = Reason.NO_TRANSFORM, Reason.TRANSFORM_GAP
            known = {} if statics is None else statics
            self.frames = Frames(frames, lambda: self._join("transform", *links), known)
        self._joins = [self._displacements]  # in the order in which a force waits for them

    def _join(self, name: str, unpaired: str, gap: str, *, is_vector: bool = True) -> Join:
        """Return the join of forces with a stream whose stamps lag, such as a moving link's."""
        limit = self._config.displacement_limit
        guard = StreamGuard(limit, self._rejected, name, is_vector=is_vector)
        times = self._config.max_gap, self._config.max_wait, self._config.displacement_delay
        return Join(times, self.force_guard, guard, self._advance, (unpaired, gap))

    def path_noise(self) -> float:
        """Return the noise of the motion: variance per sample times the time between [m^2 s].

        From the distances of the last 256 samples from the lines between their neighbours, or
        from the steps in which they come; 0 while there are fewer than 32.
        """
        samples = [moved for _, moved in self._moved][:-1]
        if len(samples) < USUAL_SAMPLES:
            return 0.0
        time = np.array([sample.stamp_ns - samples[0].stamp_ns for sample in samples])
        value = np.array([sample.value for sample in samples])
        step = np.diff(time) / NANOSECONDS
        fraction = step[:-1] / (step[:-1] + step[1:])
        apart = value[1:-1] - (1.0 - fraction) * value[:-2] - fraction * value[2:]
        scale = np.sqrt(1.0 + fraction**2 + (1.0 - fraction) ** 2)
        # The median of a normal variable's magnitude is 0.6745 deviations.
        sd = float(np.median(np.abs(apart / scale))) / 0.6745
        # Four times the variance of a single rounding error, a twelfth: the error persists over
        # several samples while the probe moves (six in a press at 4 mm/s by an encoder of 50 um
        # at 500 Hz).
        rounding = 4.0 / 12.0 * samples[-1].resolution ** 2
        return max(sd**2, rounding) * float(np.median(step))

    def add_force(self, stamp_ns: int, force: float) -> None:
        """Add a force sample [N]."""
        self._lead(self.force_guard.accept(stamp_ns, force))

    def add_force_vector(self, stamp_ns: int, frame: str, force: Vector) -> None:
        """Add a force [N] or torque [N m] in a moving frame."""
        x, y, z = force
        self._lead(self.force_guard.accept(stamp_ns, x + y + z, force), frame)

    def add_transform(
        self, stamp_ns: int, parent: str, child: str, transform: Transform, *, is_static: bool
    ) -> None:
        """Add the place of a frame in its parent; a static one holds at all times."""
        if self.frames is None:
            return
        problem = self.frames.add_transform(
            stamp_ns, parent, child, transform, is_static=is_static
        )
        if problem is not None:
            self._rejected[f"transform.{problem}"] += 1
        self._release()

    def add_displacement(self, stamp_ns: int, displacement: float, *more: Any) -> None:
        """Add a displacement sample [m], and `more` as :meth:`StreamGuard.accept` takes it."""
        self._displacements.follow(stamp_ns, displacement, *more)

    def _lead(self, forces: list[Sample], frame: str = "") -> None:
        for force in forces:
            if self.frames is not None:
                self.frames.name_force(frame)
            self._held.append(force)
            self._release()
            oldest_ns = force.stamp_ns - round(self._config.max_wait * NANOSECONDS)
            while self._held and self._held[0][:2] < (force.epoch, oldest_ns):
                self._held.popleft()
                self.force_guard.reject(Reason.NO_TRANSFORM)

    def _release(self) -> None:
        """Release the held forces, once all frames are known."""
        if self.frames is not None:
            if not self.frames.is_known:
                return
            own = [] if self._moves_probe else [self._displacements]
            self._joins = [*own, *self.frames.joins]
        while self._held:
            self._advance(self._held.popleft(), ())

    def _advance(self, force: Sample, matched: Matched) -> None:
        """Let a force wait for the next stream, or make the pair once it has met all."""
        if len(matched) < len(self._joins):
            self._joins[len(matched)].lead(force, matched)
            return
        self._on_pair(self._pair(force, matched))

    def _pair(self, force: Sample, matched: Matched) -> Pair:
        epoch, stamp_ns, value, vector, *_ = force
        frames, path, tilt = self.frames, self._path, 0.0
        links = matched if self._moves_probe else matched[1:]
        moving = frames.moving(links) if frames is not None else {}
        if frames is not None and self._moves_probe:
            probe, way, load = frames.probe(moving)
            position: Position | None = probe.translation
            if path is not None:
                way, tilt = path.add(probe)
            if links:
                self._pass(links[-1].before, Sample(epoch, stamp_ns, way))
        else:
            around = matched[0]
            way, position, load = around.value, around.position, around.load
            if path is not None:
                way, tilt = path.add(around.transform)
            self._pass(around.before, around.before)
        if frames is not None and vector is not None:
            value = frames.force_along(vector, moving)
        else:
            value -= load
        return Pair(epoch, stamp_ns, value, way, position, tilt, force.usual_ns)

    def _pass(self, before: Sample, moved: Sample) -> None:
        """Keep one sample of the motion for each of its stream."""
        if not self._moved or self._moved[-1][0][:2] != before[:2]:
            self._moved.append((before, moved))
