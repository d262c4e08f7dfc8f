# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Forces and positions in frames that move: each sample waits for the transforms around its stamp.

Every link of a chain of frames is a stream of its own, joined by the rules of force and
displacement: :class:`~fden_ros.core.streams.join.Join`. A link that is static holds at all times.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from fden_ros.core.streams.join import Around, Join, Matched
from fden_ros.core.streams.rotation import (
    Transform,
    Vector,
    conjugate,
    dot,
    normalised,
    rotate,
    slerp,
)
from fden_ros.core.streams.samples import Reason
from fden_ros.core.streams.tool import ToolWeight

#: Samples of a link are kept up to this number, the newest, while it is not known which links
#: count.
_MOST_KEPT = 2000


@dataclass(frozen=True)
class FramesConfig:
    """Which frames count, and what is asked of them.

    Parameters
    ----------
    force_axis, displacement_axis : Vector
        Unit vectors in `base`.
    """

    base: str  #: frame in which the axes are given
    probe: str  #: frame of the probe's tip; also of forces that name no frame
    force_axis: Vector
    displacement_axis: Vector
    moves_probe: bool = False  #: the displacement is that of `probe` in `base`
    tool: ToolWeight | None = None  #: its weight is taken off the force


#: By the name of a frame, its parent and where it is in it, at all times.
StaticLinks = dict[str, tuple[str, Transform]]


class _Link:
    """The moving place of a frame in its parent."""

    def __init__(self, parent: str) -> None:
        self.parent = parent
        self.kept: deque[tuple[int, Transform]] = deque(maxlen=_MOST_KEPT)
        self.join: Join | None = None


class Frames:
    """Where the frames that count are in the base, by the transforms between them.

    Parameters
    ----------
    make_join : callable
        Makes what lets forces wait for a link's transforms.
    statics : StaticLinks
        Those known by now; added to.
    """

    def __init__(
        self, config: FramesConfig, make_join: Callable[[], Join], statics: StaticLinks
    ) -> None:
        self._config, self._make_join = config, make_join
        self._statics = statics
        self._links: dict[str, _Link] = {}
        self._force_frame: str | None = None
        #: Of the links that count, in order; empty until all are known, and where all are static.
        self.joins: list[Join] = []
        self.is_known = False  #: whether each frame that counts leads to the base
        #: Which links count, in order.
        self._chain: tuple[str, ...] = ()
        #: By a frame, its ancestors below the one that it has in common with the base, and the
        #: base's.
        self._chains: dict[str, tuple[list[str], list[str]]] = {}

    @property
    def kept(self) -> int:
        """How many transforms are kept until it is known which links count."""
        return sum(len(link.kept) for link in self._links.values())

    @property
    def missing(self) -> str:
        """The frame that no transform leads to the base from; empty: they all do."""
        if self.is_known or self._force_frame is None:
            return ""
        found = self._ancestors(self._config.base)[-1]
        return next((f for f in self._wanted() if self._ancestors(f)[-1] != found), "")

    @property
    def problem(self) -> str:
        """What is wrong where a frame does not lead to the base, in words; or empty."""
        missing = self.missing
        if not missing:
            return ""
        links = {child: link.parent for child, link in self._links.items()}
        links |= {child: parent for child, (parent, _) in self._statics.items()}
        known = ", ".join(sorted({*links, *links.values()})) or "none"
        return (
            f"no chain of transforms leads from {missing} to {self._config.base}: /tf and "
            f"/tf_static name {known}; set frames.base and frames.probe to frames that are "
            "connected"
        )

    def add_transform(
        self, stamp_ns: int, parent: str, child: str, transform: Transform, *, is_static: bool
    ) -> str | None:
        """Take where a frame is in its parent; return why it is rejected, or None."""
        link, static = self._links.get(child), self._statics.get(child)
        known = link.parent if link is not None else static[0] if static is not None else parent
        if known != parent or parent == child or (is_static and link is not None):
            return Reason.OTHER_PARENT
        try:
            transform = Transform(transform.translation, normalised(transform.rotation))
        except ValueError:
            return Reason.NON_FINITE
        if is_static:
            if static is None:
                self._statics[child] = (parent, transform)
                self._resolve()
            return None
        if static is not None:
            return Reason.OTHER_PARENT
        if link is None:
            link = self._links[child] = _Link(parent)
            link.kept.append((stamp_ns, transform))
            self._resolve()
        elif not self.is_known:
            link.kept.append((stamp_ns, transform))
        elif link.join is not None:
            self._follow(link, stamp_ns, transform)
        return None

    def name_force(self, frame: str) -> None:
        """Take the frame of the forces, empty: the probe's; the first one counts."""
        if self._force_frame is None:
            self._force_frame = frame or self._config.probe
            self._resolve()

    # The chain

    def _wanted(self) -> tuple[str, ...]:
        force = self._force_frame or ""
        return (force, self._config.probe) if self._config.moves_probe else (force,)

    def _ancestors(self, frame: str) -> list[str]:
        """Return a frame, its parent and so on, up to the root."""
        return chain_up(frame, self._parent_of)

    def _parent_of(self, frame: str) -> str | None:
        link, static = self._links.get(frame), self._statics.get(frame)
        return link.parent if link is not None else static[0] if static is not None else None

    def _resolve(self) -> None:
        """Find the links between the frames, once each leads to the base."""
        if self.is_known or self._force_frame is None:
            return
        base = self._ancestors(self._config.base)
        chains: dict[str, tuple[list[str], list[str]]] = {}
        for frame in self._wanted():
            own = self._ancestors(frame)
            common = next((ancestor for ancestor in own if ancestor in base), None)
            if common is None:
                return
            chains[frame] = own[: own.index(common)], base[: base.index(common)]
        frames = dict.fromkeys(f for chain in chains.values() for part in chain for f in part)
        self._chains = chains
        self._chain = tuple(frame for frame in frames if frame in self._links)
        self.is_known = True
        for child in self._chain:
            join = self._links[child].join = self._make_join()
            self.joins.append(join)
        for child, link in self._links.items():
            kept, link.kept = link.kept, deque(maxlen=1)
            if child in self._chain:
                for stamp_ns, transform in kept:
                    self._follow(link, stamp_ns, transform)

    def _follow(self, link: _Link, stamp_ns: int, transform: Transform) -> None:
        assert link.join is not None
        place, turn = transform
        x, y, z = place
        link.join.follow(stamp_ns, x + y + z, place, turn=turn)

    # At an instant

    def probe(self, matched: Matched) -> Transform:
        """Return where the probe is in the base, by the transforms of the joins."""
        return self._in_base(self._config.probe, self._moving(matched))

    def force_along(self, force: Vector, matched: Matched) -> float:
        """Return a force along the axis, less the tool's weight [N]."""
        config = self._config
        turn = self._in_base(self._force_frame or "", self._moving(matched)).rotation
        net = dot(config.force_axis, rotate(turn, force))
        if config.tool is None:
            return net
        return net - config.tool.load(turn, rotate(conjugate(turn), config.force_axis))

    def _moving(self, matched: Matched) -> dict[str, Transform]:
        return dict(zip(self._chain, map(between, matched), strict=True))

    def _in_base(self, frame: str, moving: dict[str, Transform]) -> Transform:
        """Return where a frame is in the base."""
        own, base = (self._up(chain, moving) for chain in self._chains[frame])
        return base.inverse().then(own)

    def _up(self, chain: list[str], moving: dict[str, Transform]) -> Transform:
        found = Transform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        for child in chain:
            link = moving[child] if child in moving else self._statics[child][1]
            found = link.then(found)
        return found


def chain_up(frame: str, parent_of: Callable[[str], str | None]) -> list[str]:
    """Return a frame, its parent and so on, up to the root; a ring ends where it closes."""
    chain = [frame]
    while (parent := parent_of(chain[-1])) is not None and parent not in chain:
        chain.append(parent)
    return chain


def between(around: Around) -> Transform:
    """Return place and turn at an instant: the place linear, the turn at a constant rate."""
    position, before, after = around.position, around.before.turn, around.after.turn
    assert position is not None and before is not None and after is not None
    if around.after is around.before:
        return Transform(position, before)
    return Transform(position, slerp(before, after, around.fraction))
