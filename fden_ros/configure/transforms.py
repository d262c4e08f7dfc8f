# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A probe whose motion stands in transforms alone: which frames count, its path in the base."""

from __future__ import annotations

from collections import defaultdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fden_ros.core.arrays import Array
from fden_ros.core.streams import chain_up
from fden_ros.errors import InputError
from fden_ros.inputs import stamp_ns


class Path(NamedTuple):
    """Where a frame is in the base."""

    stamps: NDArray[np.int64]  #: [ns], (n,)
    places: Array  #: (n, 3) [m]
    turns: Rotation  #: of the frame into the base (n,)


class FrameTree:
    """Transforms as they were recorded.

    Parameters
    ----------
    where : str
        Whose they are, for the line that says what is wrong.
    """

    def __init__(self, where: str) -> None:
        self._where = where
        self._parents: dict[str, str] = {}
        self._links: dict[str, dict[int, tuple[float, ...]]] = defaultdict(dict)

    def add(self, message: Any) -> None:
        """Take a message of ``/tf`` or ``/tf_static``."""
        for one in message.transforms:
            child = one.child_frame_id.removeprefix("/")
            self._parents[child] = one.header.frame_id.removeprefix("/")
            place, turn = one.transform.translation, one.transform.rotation
            numbers = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
            self._links[child][stamp_ns(one.header.stamp)] = numbers

    def frames_for(self, named: str | None, force_frame: str) -> tuple[str, str]:
        """Return base and tip of the probe: as named ``BASE,PROBE``, or as far as they are clear.

        The base is the root of the frames; the tip the last frame, below that of the force.

        Raises
        ------
        InputError
            With the list of frames, where they are not clear.
        """
        known = sorted({*self._parents, *self._parents.values()})
        given = named.split(",") if named else []
        if given and (len(given) != 2 or not set(given) <= set(known)):
            raise self._unclear(f"{named} is not BASE,PROBE", known)
        if given:
            return given[0], given[1]
        tips = [frame for frame in known if frame not in self._parents.values()]
        if force_frame in self._parents:
            tips = [tip for tip in tips if force_frame in self._chain(tip)]
        if len(tips) != 1:
            raise self._unclear("the probe's tip may be one of several frames", known)
        return self._chain(tips[0])[-1], tips[0]

    def _unclear(self, why: str, known: list[str]) -> InputError:
        listed = ", ".join(known) or "none"
        return InputError(
            f"{self._where}: {why}: say which is the base and which the probe's tip, "
            f"--frames BASE,PROBE, of {listed}"
        )

    def _chain(self, frame: str) -> list[str]:
        """Return a frame, its parent and so on up to the root."""
        return chain_up(frame, self._parents.get)

    def path(self, base: str, frame: str, stamps: NDArray[np.int64] | None = None) -> Path:
        """Return a frame's path in the base; by default at the stamps of what moves most often.

        Raises
        ------
        InputError
            If no transforms lead from one to the other.
        """
        chains = self._chain(frame), self._chain(base)
        if chains[0][-1] != chains[1][-1]:
            known = sorted({*self._parents, *self._parents.values()})
            raise self._unclear(f"no transforms lead from {base} to {frame}", known)
        if stamps is None:
            links = [self._links[one] for one in {*chains[0]} ^ {*chains[1]} if one in self._links]
            most = max(map(len, links), default=0)
            chosen = next((link for link in links if len(link) == most), {})
            stamps = np.array(sorted(chosen), dtype=np.int64)
        places, turns = self._in_root(frame, stamps)
        origin, facing = self._in_root(base, stamps)
        return Path(stamps, facing.inv().apply(places - origin), facing.inv() * turns)

    def _in_root(self, frame: str, stamps: NDArray[np.int64]) -> tuple[Array, Rotation]:
        places, turns = np.zeros((stamps.size, 3)), Rotation.identity(stamps.size)
        for child in self._chain(frame)[:-1]:
            link = sorted(self._links[child].items())
            times = np.array([stamp for stamp, _ in link])
            numbers = np.array([values for _, values in link])
            same = np.sum(numbers[1:, 3:] * numbers[:-1, 3:], axis=1)
            flips = np.cumsum([False, *(same < 0.0)])
            numbers[:, 3:] *= np.where(flips % 2 == 1, -1.0, 1.0)[:, None]
            at = np.stack([np.interp(stamps, times, column) for column in numbers.T], axis=1)
            own = Rotation.from_quat(at[:, 3:])
            places, turns = own.apply(places) + at[:, :3], own * turns
        return places, turns
