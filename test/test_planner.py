# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The node planner: its answers over DDS are those of Python, from what the identifier says."""

from __future__ import annotations

import contextlib
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fden_msgs.msg import PalpationSummary
from fden_msgs.srv import NextPresses
from geometry_msgs.msg import Point
from live_helpers import node_process
from ros_helpers import Remote
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker

from fden_ros.cli import main
from fden_ros.offline.replay import replay
from fden_ros.parameters import pipeline_config, read_parameter_file
from fden_ros.planning.motion import Sensors
from fden_ros.planning.plan import Target, plan
from fden_ros.planning.region import Presses, Region
from fden_ros.planning.tissue import TissueBelief
from fden_ros.ros.messages import summary_message, to_stamp
from fden_ros.ros.topics import latched

BAG = Path(__file__).parent.parent / "bags" / "golden" / "golden_press"
FILE = BAG / "identifier.yaml"
SENSORS = Sensors(rate=500.0, force_sd=0.002)


@contextlib.contextmanager
def planner(folder: Path) -> Iterator[Remote]:
    # Under another name: a command with "identifier" in it ends the one that tests share.
    file = folder / "probe.yaml"
    file.write_text(FILE.read_text(encoding="utf-8"), encoding="utf-8")
    stated = {"parameters": f"[{file}]", "noise": SENSORS.force_sd, "rate": SENSORS.rate}
    with node_process("planner", stated), Remote("/planner") as remote:
        yield remote


def ask(remote: Remote, **fields: Any) -> Any:
    client = remote._clients.setdefault("next", remote._client(NextPresses, "next_presses"))
    remote.wait_for(client.service_is_ready, "the planner")
    future = client.call_async(NextPresses.Request(**fields))
    return remote.wait_for(future.done, "a plan") and future.result()


def test_the_motion_is_that_of_python_after_what_was_found(tmp_path: Path) -> None:
    contact = replay(BAG, parameters := read_parameter_file(FILE)).summaries[-1]
    assert contact.estimate is not None
    target = Target((0.02, 0.02, 0.01))
    known = TissueBelief.found(contact.estimate)
    expected = plan(pipeline_config(parameters), SENSORS, target, tissue=known)
    with planner(tmp_path) as remote:
        before = ask(remote)
        pressed = remote.node.create_publisher(
            PalpationSummary, "/identifier/palpation", latched(100)
        )
        pressed.publish(summary_message(contact, "sensor"))
        found = remote.wait_for(
            lambda: (a := ask(remote, target=[0.02, 0.02, 0.01])).header.stamp.sec and a, "it"
        )
        began = time.monotonic()
        shallow = ask(remote, max_depth=1e-3)
        print(f"answered in {1e3 * (time.monotonic() - began):.0f} ms")
    assert before.message.startswith(("press to", "not possible"))
    np.testing.assert_allclose(found.deviations, expected.deviations, rtol=1e-6)
    assert found.message == expected.line()
    assert found.depth == expected.motion.depth and found.presses == expected.presses
    assert shallow.depth <= 1e-3


def summary(number: int, place: np.ndarray, log: float, sd: float) -> PalpationSummary:
    message = PalpationSummary(site_id=number, contact_id=number, position_valid=True)
    message.header.stamp = to_stamp(10**9 * number)
    message.position = Point(x=float(place[0]), y=float(place[1]), z=0.01)
    message.position_frame_id = "base"
    message.apparent_stiffness = float(np.exp(log))
    message.apparent_stiffness_sd = sd * message.apparent_stiffness
    message.apparent_stiffness_time_scale = 0.1
    return message


def field(places: np.ndarray) -> np.ndarray:
    """Return ln k of a disc of 8 mm that is twice as stiff."""
    away = np.linalg.norm(places - [0.04, 0.02], axis=1)
    return np.log(40.0) + np.log(2.0) / (1.0 + np.exp((away - 8e-3) / 1e-3))


def test_places_are_those_of_python_and_the_map_is_published(tmp_path: Path) -> None:
    corners = {"low": Point(), "high": Point(x=0.06, y=0.06)}
    region, presses = Region((0.0, 0.0), (0.06, 0.06)), Presses.of([])
    places = region.propose(presses, 16).places
    expected = None
    with planner(tmp_path) as remote:
        first = ask(remote, number=16, **corners)
        np.testing.assert_allclose([(p.x, p.y) for p in first.places], places)
        pressed = remote.node.create_publisher(
            PalpationSummary, "/identifier/palpation", latched(100)
        )
        clouds = remote.hear(PointCloud2, "/planner/region_map", latched(1))
        lines = remote.hear(Marker, "/planner/boundary", latched(1))
        logs = field(places)
        for k, (place, log) in enumerate(zip(places, logs, strict=True)):
            pressed.publish(summary(k + 1, place, log, 0.05))
        remote.wait_for(pressed.get_subscription_count, "the planner's subscription")
        expected = region.propose(Presses(places, logs, np.full(16, 0.05)), 2)
        found = remote.wait_for(
            lambda: (a := ask(remote, number=2, **corners)).header.stamp.sec == 16 and a, "it"
        )
        remote.wait_for(lambda: clouds and lines, "the map")
        bad = ask(remote, number=1)
    assert found.success and found.header.frame_id == "base"
    # Deviations over stiffnesses differ by their last bits: the draws may not.
    np.testing.assert_allclose([(p.x, p.y) for p in found.places], expected.places, atol=1e-6)
    assert found.expected_overlap == pytest.approx(expected.known.overlap, abs=0.05)
    assert clouds[-1].width == len(region.cells)
    assert len(lines[-1].points) >= 8 and lines[-1].header.frame_id == "base"
    inside = np.array([(p.x, p.y) for p in lines[-1].points]).mean(axis=0)
    assert np.linalg.norm(inside - [0.04, 0.02]) < 6e-3
    assert not bad.success and "no area" in bad.message


def test_the_command_names_the_place_that_python_names(tmp_path: Path, capsys: Any) -> None:
    region = Region((0.0, 0.0), (0.06, 0.06))
    places = region.propose(Presses.of([]), 16).places
    contacts = [
        {
            "position": [*place, 0.0],
            "apparent_stiffness": math.exp(log),
            "apparent_stiffness_sd": 0.05 * math.exp(log),
        }
        for place, log in zip(places.tolist(), field(places), strict=True)
    ]
    results, picture = tmp_path / "palpation.json", tmp_path / "map.png"
    results.write_text(json.dumps({"contacts": contacts}), encoding="utf-8")
    arguments = ["plan", "--map", str(results), "--region", "0,0,0.06,0.06", "--json"]
    assert main([*arguments, "--plot", str(picture)]) == 0
    found = json.loads(capsys.readouterr().out)
    expected = region.propose(Presses(places, field(places), np.full(16, 0.05)))
    np.testing.assert_allclose(found["places"], expected.places, atol=1e-6)
    assert not found["done"] and picture.stat().st_size > 10_000
