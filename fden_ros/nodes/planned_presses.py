# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Presses that the planner proposes, made one after the other by depth.

One motion is asked for at the beginning, so that all places are pressed alike; then a place after
each press, from all that the identifier has said until then.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from typing import Any

from fden_msgs.srv import NextPresses
from geometry_msgs.msg import Point
from rclpy.node import Node

from fden_ros.errors import InputError

#: The probe is at a place within 0.1 mm [m]; its depth within 0.05 mm.
_AT_PLACE, _AT_DEPTH = 1e-4, 5e-5
#: Velocity per error of the depth [1/s]: a third of what an axis of 25 ms follows.
_DEPTH_GAIN = 12.0
#: An answer that does not know the last press is asked for again after 0.2 s, for at most 5 s.
_ASK_AGAIN, _PATIENCE = 0.2, 5.0

Course = Generator[float, None, None]


class PlannedPresses:
    """What a planner proposes, as velocities of the probe.

    Parameters
    ----------
    node : Node
    planner : str
        Name of the planner.
    region : sequence of float
        x and y of its lower and of its upper corner [m].
    force_limit : float
        A press is planned to stay below it, and left where it does not [N].
    lift : float
        How far the probe leaves the surface between two places [m].
    move_to : callable
        Sends the probe to x, y [m].

    Raises
    ------
    InputError
        If the region has no area.
    """

    def __init__(
        self,
        node: Node,
        planner: str,
        region: Sequence[float],
        *,
        force_limit: float,
        lift: float,
        move_to: Callable[[float, float], object],
    ) -> None:
        if len(region) != 4 or not (region[0] < region[2] and region[1] < region[3]):
            raise InputError(
                f"region is {list(region)}; it must be x0, y0, x1, y1 [m] with x0 < x1, y0 < y1"
            )
        self._low, self._high = (Point(x=x, y=y) for x, y in (region[:2], region[2:]))
        self._log = node.get_logger()
        self._client = node.create_client(NextPresses, f"{planner}/next_presses")
        self._force_limit, self._lift, self._move_to = force_limit, lift, move_to
        self._known: Any = None  # stamp of the newest press that an answer knew of
        self._course = self._presses()

    def velocity(
        self, now: float, force: float, depth: float, place: tuple[float, float]
    ) -> float:
        """Return the velocity into the tissue [m/s].

        Parameters
        ----------
        now : float
            Of the measurement [s].
        force, depth : float
            Measured, on the tissue [N], into it [m].
        place : tuple of float
            x and y [m].
        """
        self._now, self._force, self._depth, self._place = now, force, depth, place
        return next(self._course)

    def _presses(self) -> Course:
        motion = yield from self._answer(NextPresses.Request(max_force=self._force_limit))
        self._log.info(motion.message)
        while motion.depth > 0.0:
            found = yield from self._next_place()
            self._log.info(found.message)
            if not (found.success and found.places):
                break
            yield from self._press_at(found.places[0].x, found.places[0].y, motion)
        while True:
            yield self._towards(-self._lift, motion.release)

    def _next_place(self) -> Generator[float, None, Any]:
        """Ask where to press next, until the answer knows of the last press."""
        request = NextPresses.Request(number=1, low=self._low, high=self._high)
        end = self._now + _PATIENCE
        while True:
            found = yield from self._answer(request)
            if found.header.stamp != self._known or self._now > end:
                self._known = found.header.stamp
                return found
            again = self._now + _ASK_AGAIN
            while self._now < again:
                yield 0.0

    def _answer(self, request: Any) -> Generator[float, None, Any]:
        while not self._client.service_is_ready():
            yield 0.0
        future = self._client.call_async(request)
        while not future.done():
            yield 0.0
        return future.result()

    def _press_at(self, x: float, y: float, motion: Any) -> Course:
        while math.hypot(self._place[0] - x, self._place[1] - y) > _AT_PLACE:
            self._move_to(x, y)
            yield 0.0
        while self._depth < motion.depth - _AT_DEPTH and self._force < self._force_limit:
            yield self._towards(motion.depth, motion.speed)
        end = self._now + motion.hold
        while self._now < end and self._force < self._force_limit:
            yield self._towards(motion.depth, motion.speed)
        while self._depth > -self._lift + _AT_DEPTH:
            yield self._towards(-self._lift, motion.release)

    def _towards(self, depth: float, speed: float) -> float:
        return min(max(_DEPTH_GAIN * (depth - self._depth), -speed), speed)
