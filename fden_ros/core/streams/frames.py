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
from typing import NamedTuple

from fden_ros.core.streams.guard import StreamGuard
from fden_ros.core.streams.join import Around, Join, JoinLimits, Passed
from fden_ros.core.streams.rotation import (
    Quaternion,
    Transform,
    Vector,
    dot,
    normalised,
    rotate,
    slerp,
)
from fden_ros.core.streams.samples import Pair, Reason, Sample
from fden_ros.core.streams.tool import ToolPath, ToolWeight

#: Samples of a link are kept up to this number, the newest, while it is not known which links
#: count.
_MOST_KEPT = 2000


@dataclass(frozen=True)
class FramesConfig:
    """Which frames count, and what is asked of them.

    Parameters
    ----------
    base : str
        Frame in which the axes are given.
    probe : str
        Frame of the probe's tip; also of forces that name no frame.
    force_axis, displacement_axis : Vector
        Unit vectors in `base`.
    moves_probe : bool
        The displacement is that of `probe` in `base`.
    tool : ToolWeight, optional
        Its weight is taken off the force.
    """

    base: str
    probe: str
    force_axis: Vector
    displacement_axis: Vector
    moves_probe: bool = False
    tool: ToolWeight | None = None


class StaticLinks(dict[str, tuple[str, Transform]]):
    """By the name of a frame, its parent and where it is in it, at all times."""


class _Waiting(NamedTuple):
    """A pair that waits, and the dynamic transforms at its stamp that are known by now."""

    pair: Pair
    transforms: tuple[Transform, ...]
    since_ns: int = 0  #: stamp of the transform before it


class _Link:
    """The moving place of a frame in its parent."""

    def __init__(self, parent: str) -> None:
        self.parent = parent
        self.kept: deque[tuple[int, Transform]] = deque(maxlen=_MOST_KEPT)
        self.guard: StreamGuard | None = None
        self.join: Join[_Waiting] | None = None


class Frames:
    """Bring pairs into the base frame.

    Parameters
    ----------
    config : FramesConfig
    limits : JoinLimits
    force_guard : StreamGuard
        Counts the forces that find no transform.
    make_guard : callable
        Makes the guard of a link.
    statics : StaticLinks
        Those known by now; added to.
    on_pair : callable
        Called with the force's sample and each pair whose force and displacement are in the base.
    path : ToolPath, optional
        The displacement is along the probe's axis.
    """

    def __init__(
        self,
        config: FramesConfig,
        limits: JoinLimits,
        force_guard: StreamGuard,
        make_guard: Callable[[], StreamGuard],
        statics: StaticLinks,
        on_pair: Callable[[Sample, Pair], None],
        path: ToolPath | None = None,
    ) -> None:
        self._config = config
        self._path = path
        self._limits = limits
        self._force_guard, self._make_guard = force_guard, make_guard
        self._statics = statics
        self._on_pair = on_pair
        self._links: dict[str, _Link] = {}
        self._force_frame: str | None = None
        #: Which links count, in order, once all are known.
        self._chain: tuple[str, ...] | None = None
        #: By a frame, its ancestors below the one that it has in common with the base, and the
        #: base's.
        self._chains: dict[str, tuple[list[str], list[str]]] = {}
        self._unresolved: deque[tuple[Sample, Pair]] = deque()
        self._since_ns = 0
        #: The newest displacements, one between any two transforms.
        self.passed = Passed()

    @property
    def waiting(self) -> int:
        """How many samples are kept."""
        kept = sum(len(link.kept) for link in self._links.values())
        joins = [link.join for link in self._links.values() if link.join is not None]
        return len(self._unresolved) + kept + sum(join.waiting for join in joins)

    @property
    def missing(self) -> str:
        """The frame that no transform leads to the base from; empty: they all do."""
        if self._chain is not None or self._force_frame is None:
            return ""
        found = self._ancestors(self._config.base)[-1]
        return next((f for f in self._wanted() if self._ancestors(f)[-1] != found), "")

    @property
    def known(self) -> tuple[str, ...]:
        """The frames that transforms have named."""
        links = {child: link.parent for child, link in self._links.items()}
        links |= {child: parent for child, (parent, _) in self._statics.items()}
        return tuple(sorted({*links, *links.values()}))

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
        elif self._chain is None:
            link.kept.append((stamp_ns, transform))
        elif link.join is not None:
            self._follow(link, stamp_ns, transform)
        return None

    def lead(self, force: Sample, pair: Pair, frame: str) -> None:
        """Take a pair whose force is given in `frame`."""
        if self._force_frame is None:
            self._force_frame = frame or self._config.probe
            self._resolve()
        if self._chain is not None:
            self._next(force, _Waiting(pair, ()))
            return
        self._unresolved.append((force, pair))
        while self._has_waited(self._unresolved[0][0], force):
            self._unresolved.popleft()
            self._force_guard.reject(Reason.NO_TRANSFORM)

    def _has_waited(self, oldest: Sample, newest: Sample) -> bool:
        waited_ns = newest.stamp_ns - oldest.stamp_ns
        return oldest.epoch != newest.epoch or waited_ns > self._limits.window_ns

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
        if self._chain is not None or self._force_frame is None:
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
        for place, child in enumerate(self._chain):
            self._begin(self._links[child], place)
        for child, link in self._links.items():
            kept, link.kept = link.kept, deque(maxlen=1)
            if child in self._chain:
                for stamp_ns, transform in kept:
                    self._follow(link, stamp_ns, transform)
        while self._unresolved:
            force, pair = self._unresolved.popleft()
            self._next(force, _Waiting(pair, ()))

    def _begin(self, link: _Link, place: int) -> None:
        guard = link.guard = self._make_guard()

        def on_match(force: Sample, waiting: _Waiting, around: Around) -> None:
            transforms = (*waiting.transforms, between(around))
            self._next(force, _Waiting(waiting.pair, transforms, around.before.stamp_ns))

        link.join = Join[_Waiting](self._limits, self._force_guard, guard, on_match)

    def _follow(self, link: _Link, stamp_ns: int, transform: Transform) -> None:
        assert link.guard is not None and link.join is not None
        x, y, z = transform.translation
        link.join.follow(
            link.guard.accept(stamp_ns, x + y + z, transform.translation, turn=transform.rotation)
        )

    def _next(self, force: Sample, waiting: _Waiting) -> None:
        """Let a pair wait for the next link, or compose them all."""
        assert self._chain is not None
        if len(waiting.transforms) == len(self._chain):
            self._compose(force, waiting)
            return
        join = self._links[self._chain[len(waiting.transforms)]].join
        assert join is not None
        join.lead(force, waiting)

    def _compose(self, force: Sample, waiting: _Waiting) -> None:
        assert self._chain is not None
        moving = dict(zip(self._chain, waiting.transforms, strict=True))
        pair, config = waiting.pair, self._config
        if force.position is not None:
            assert self._force_frame is not None
            turn = self._in_base(self._force_frame, moving).rotation
            pair = pair._replace(force=self._along(force.position, turn))
        if config.moves_probe:
            probe = self._in_base(config.probe, moving)
            displacement, tilt = dot(config.displacement_axis, probe.translation), 0.0
            if self._path is not None:
                displacement, tilt = self._path.add(probe)
                if config.tool is not None:
                    pair = pair._replace(force=pair.force - config.tool.load(probe.rotation))
            pair = pair._replace(displacement=displacement, position=probe.translation, tilt=tilt)
            # One per transform, for its noise.
            if waiting.since_ns != self._since_ns:
                self._since_ns = waiting.since_ns
                key = pair.epoch, pair.stamp_ns
                self.passed.add(key, Sample(*key, displacement))
        self._on_pair(force, pair)

    def _along(self, force: Vector, turn: Quaternion) -> float:
        """Return a force along the axis, less the tool's weight [N]."""
        config = self._config
        net = dot(config.force_axis, rotate(turn, force))
        if config.tool is None:
            return net
        x, y, z, w = turn
        return net - config.tool.load(turn, rotate((-x, -y, -z, w), config.force_axis))

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
