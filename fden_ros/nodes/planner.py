# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The node ``planner``: which press to make next, in a process beside the identifier's.

Subscribes to the identifier's ``palpation``; offers ``~/next_presses``; publishes what is known of
a region that it was asked for, ``~/region_map`` and ``~/boundary``. What plans is in
:mod:`fden_ros.planning`.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from fden_msgs.msg import PalpationSummary
from fden_msgs.srv import NextPresses
from geometry_msgs.msg import Point
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from fden_ros.core.outputs import ContactSummary
from fden_ros.errors import InputError
from fden_ros.nodes.running import declared, run_node
from fden_ros.offline.sensors import sensors_of
from fden_ros.parameters import pipeline_config, read_parameter_files
from fden_ros.planning.motion import FREQUENCY
from fden_ros.planning.plan import LIMITS, Limits, Plan, Target, plan
from fden_ros.planning.region import ENOUGH, Presses, Region
from fden_ros.planning.tissue import TissueBelief
from fden_ros.ros.messages import summary_of, to_stamp
from fden_ros.ros.region_messages import boundary_of, cloud_of
from fden_ros.ros.topics import latched

#: Name, default and meaning, with its unit, of every parameter.
PARAMETERS: tuple[tuple[str, Any, str], ...] = (
    ("identifier", "identifier", "name of the identifier node"),
    ("parameters", [""], "parameter files of the identifier"),
    ("noise", 0.0, "of the force, per sample [N]; 0: as fden configure has written"),
    ("rate", 0.0, "of the force [Hz]; 0: as fden configure has written"),
    ("displacement_noise", 0.0, "per sample [m]; 0: as fden configure has written"),
)
#: Contacts of a region that are kept.
_MOST_CONTACTS = 1000


class Planner(Node):
    """Answers which press to make, from what the identifier has published."""

    def __init__(self, **options: Any) -> None:
        super().__init__("planner", **options)
        values = declared(self, PARAMETERS)
        name = self.resolve_topic_name(str(values["identifier"]))
        files = [Path(path) for path in values["parameters"] if path]
        parameters = read_parameter_files(files, name)
        self._config = pipeline_config(parameters)
        if not self._config.geometry.is_stated:
            raise InputError("parameters: a file with geometry, without which nothing is planned")
        stated = (values[key] for key in ("noise", "rate", "displacement_noise"))
        self._sensors = sensors_of(files, parameters, *stated)
        self._contacts: OrderedDict[int, ContactSummary] = OrderedDict()
        self._region: Region | None = None
        # What is loaded at the first plan is loaded now.
        plan(self._config, self._sensors)
        self._map = self.create_publisher(PointCloud2, "~/region_map", latched(1))
        self._boundary = self.create_publisher(Marker, "~/boundary", latched(1))
        self.create_subscription(
            PalpationSummary, f"{name}/palpation", self._on_summary, latched(100)
        )
        self.create_service(NextPresses, "~/next_presses", self._answer)

    def _on_summary(self, message: PalpationSummary) -> None:
        summary = summary_of(message)
        if self._contacts and summary.stamp_ns < next(reversed(self._contacts.values())).stamp_ns:
            self._contacts.clear()  # of another run
        self._contacts[summary.contact_id] = summary
        while len(self._contacts) > _MOST_CONTACTS:
            self._contacts.popitem(last=False)

    def _answer(
        self, request: NextPresses.Request, response: NextPresses.Response
    ) -> NextPresses.Response:
        try:
            if request.number:
                self._fill_places(request, response)
            else:
                _fill_motion(response, self._planned(request))
        except (InputError, np.linalg.LinAlgError) as error:
            response.message = str(error)
        response.header = self._header
        self.get_logger().info(response.message)
        return response

    def _planned(self, request: NextPresses.Request) -> Plan:
        wanted = [sd if sd > 0.0 else math.inf for sd in request.target]
        target = Target(wanted) if min(wanted) < math.inf else None
        most = {name: getattr(request, f"max_{name}") for name in LIMITS}
        limits = Limits.usual(self._config, self._sensors).stated(**most)
        known = [one.estimate for one in self._contacts.values() if one.estimate is not None]
        tissue = TissueBelief.found(known[-1]) if known else None
        return plan(self._config, self._sensors, target, limits, tissue)

    def _fill_places(self, request: NextPresses.Request, response: NextPresses.Response) -> None:
        region = self._region_of(request)
        header = self._header
        alike = [c for c in self._contacts.values() if c.position_frame == header.frame_id]
        presses = Presses.found(alike)
        found = region.propose(presses, request.number, request.overlap or ENOUGH)
        height = _height(alike, request.low.z)
        response.success, response.message = not found.is_done, found.line()
        response.probability = found.probability
        response.places = [Point(x=float(x), y=float(y), z=height) for x, y in found.places]
        if found.known is not None:
            response.expected_overlap = found.known.overlap
            response.expected_overlap_sd = found.known.overlap_sd
            self._map.publish(cloud_of(region, found.known, height, header))
            sides = region.boundary(found.known)
            self._boundary.publish(boundary_of(sides, height, header))

    @property
    def _header(self) -> Header:
        """Of the newest contact."""
        if not self._contacts:
            return Header()
        newest = next(reversed(self._contacts.values()))
        return Header(stamp=to_stamp(newest.stamp_ns), frame_id=newest.position_frame)

    def _region_of(self, request: NextPresses.Request) -> Region:
        low, high = ((corner.x, corner.y) for corner in (request.low, request.high))
        if not all(a < b for a, b in zip(low, high, strict=True)):
            raise InputError("the region has no area: low.x < high.x and low.y < high.y [m]")
        if self._region is None or (*self._region.low, *self._region.high) != (*low, *high):
            self._region = Region(low, high)
        return self._region


def _height(contacts: Iterable[ContactSummary], otherwise: float) -> float:
    """Return the median height of the touches [m]."""
    found = [one.position[2] for one in contacts if one.position is not None]
    return float(np.median(found)) if found else otherwise


def _fill_motion(response: NextPresses.Response, found: Plan) -> None:
    motion = found.motion
    response.success, response.message = found.is_worth_it, found.line()
    for name in ("depth", "speed", "hold", "amplitude", "cycles", "release", "seconds"):
        setattr(response, name, getattr(motion, name))
    response.frequency = FREQUENCY if motion.cycles else 0.0
    response.force, response.deviations = found.force, found.deviations
    response.presses, response.probability = found.presses, found.probability


def main(arguments: list[str] | None = None) -> int:
    """Run the planner until SIGINT or SIGTERM."""
    return run_node("planner", Planner, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
