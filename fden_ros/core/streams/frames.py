# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Forces and positions in frames that move: each sample waits for the transforms around its stamp.

Every link of a chain of frames is a stream of its own, joined by the rules of force and
displacement: :class:`~fden_ros.core.streams.join.Join`. A link that is static holds at all times.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fden_ros.core.streams.join import Around, Join
from fden_ros.core.streams.rotation import (
    Transform,
    Vector,
    conjugate,
    dot,
    normalised,
    rotate,
)
from fden_ros.core.streams.samples import Reason
from fden_ros.core.streams.tool import ToolWeight


@dataclass(frozen=True)
class FramesConfig:
    """Which frames are needed, and for what."""

    base: str  #: frame in which the axes are given, as unit vectors
    probe: str  #: frame of the probe's tip; also of forces that name no frame
    force_axis: Vector
    displacement_axis: Vector
    moves_probe: bool = False  #: the displacement is that of `probe` in `base`
    tool: ToolWeight | None = None  #: its weight is subtracted from the force


#: By the name of a static frame, its parent and its place there.
StaticLinks = dict[str, tuple[str, Transform]]
#: By the name of a moving frame, its place in its parent at an instant.
Moving = dict[str, Transform]


class Frames:
    """The places of the needed frames in the base, by the transforms between them.

    `make_join` makes what lets forces wait for a link's transforms; static ones are added to
    `statics`, those known so far.
    """

    def __init__(
        self, config: FramesConfig, make_join: Callable[[], Join], statics: StaticLinks
    ) -> None:
        self._config, self._make_join, self._statics = config, make_join, statics
        #: By the name of a moving frame, its parent and the join that waits for its transforms.
        self._links: dict[str, tuple[str, Join]] = {}
        self._force_frame: str | None = None
        self.is_known = False  #: whether each needed frame leads to the base
        self._missing = ""  # one that does not
        #: The needed links, in order; empty until all are known, and where all are static.
        self._chain: dict[str, Join] = {}
        #: By a frame, its ancestors below the one that it has in common with the base, and the
        #: base's.
        self._chains: dict[str, tuple[list[str], list[str]]] = {}

    @property
    def joins(self) -> list[Join]:
        """The joins that forces pass, in order."""
        return list(self._chain.values())

    @property
    def problem(self) -> str:
        """The problem where a frame does not lead to the base, in words; or empty."""
        if not self._missing:
            return ""
        links = {**self._links, **self._statics}
        known = ", ".join(sorted({*links, *(parent for parent, _ in links.values())})) or "none"
        return (
            f"no chain of transforms leads from {self._missing} to {self._config.base}: /tf and "
            f"/tf_static name {known}; set frames.base and frames.probe to frames that are "
            "connected"
        )

    def add_transform(
        self, stamp_ns: int, parent: str, child: str, transform: Transform, *, is_static: bool
    ) -> str | None:
        """Add the place of a frame in its parent; return why it is rejected, or None."""
        known, others = self._parent_of(child), self._links if is_static else self._statics
        if parent == child or known not in (None, parent) or child in others:
            return Reason.OTHER_PARENT
        place, turn = transform
        try:
            turn = normalised(turn)
        except ValueError:
            return Reason.NON_FINITE
        if is_static:
            self._statics.setdefault(child, (parent, Transform(place, turn)))
        elif known is None:
            self._links[child] = parent, self._make_join()
        if known is None:
            self._resolve()
        if not is_static and (child in self._chain or not self.is_known):
            x, y, z = place
            self._links[child][1].follow(stamp_ns, x + y + z, place, 0.0, turn)
        return None

    def name_force(self, frame: str) -> None:
        """Set the frame of the forces, empty: the probe's; the first one counts."""
        if self._force_frame is None:
            self._force_frame = frame or self._config.probe
            self._resolve()

    # The chain

    def _ancestors(self, frame: str) -> list[str]:
        """Return a frame, its parent and so on, up to the root; a ring ends where it closes."""
        chain = [frame]
        while (parent := self._parent_of(chain[-1])) is not None and parent not in chain:
            chain.append(parent)
        return chain

    def _parent_of(self, frame: str) -> str | None:
        link = self._links.get(frame) or self._statics.get(frame)
        return link[0] if link is not None else None

    def _resolve(self) -> None:
        """Find the links between the frames, once each leads to the base."""
        if self.is_known or self._force_frame is None:
            return
        base = self._ancestors(self._config.base)
        wanted = [self._force_frame, self._config.probe]
        for frame in wanted if self._config.moves_probe else wanted[:1]:
            own = self._ancestors(frame)
            common = next((ancestor for ancestor in own if ancestor in base), None)
            if common is None:
                self._missing = frame
                return
            self._chains[frame] = own[: own.index(common)], base[: base.index(common)]
        frames = [f for chains in self._chains.values() for chain in chains for f in chain]
        self._chain = {frame: self._links[frame][1] for frame in frames if frame in self._links}
        self.is_known, self._missing = True, ""

    # At an instant

    def moving(self, matched: Sequence[Around]) -> Moving:
        """Return the places of the joins' frames in their parents."""
        return {frame: one.transform for frame, one in zip(self._chain, matched, strict=True)}

    def probe(self, moving: Moving) -> tuple[Transform, float, float]:
        """Return the place of the probe in the base, and its displacement [m].

        Also return the tool's weight along the force's axis in the probe's own frame [N].
        """
        config, probe = self._config, self._in_base(self._config.probe, moving)
        load = config.tool.load(probe.rotation) if config.tool is not None else 0.0
        return probe, dot(config.displacement_axis, probe.translation), load

    def force_along(self, force: Vector, moving: Moving) -> float:
        """Return a force along the axis, less the tool's weight [N]."""
        config = self._config
        turn = self._in_base(self._force_frame or "", moving).rotation
        net = dot(config.force_axis, rotate(turn, force))
        if config.tool is None:
            return net
        return net - config.tool.load(turn, rotate(conjugate(turn), config.force_axis))

    def _in_base(self, frame: str, moving: Moving) -> Transform:
        """Return the place of a frame in the base."""
        places = []
        for chain in self._chains[frame]:
            place = Transform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
            for child in chain:
                link = moving[child] if child in moving else self._statics[child][1]
                place = link.then(place)
            places.append(place)
        own, base = places
        return base.inverse().then(own)
