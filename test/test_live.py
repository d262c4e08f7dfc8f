# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The live system over DDS: controller, example, monitor, markers, and a clean end."""

from __future__ import annotations

import math
import os
import signal
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fden_msgs.msg import TissueEstimate
from geometry_msgs.msg import WrenchStamped
from live_helpers import LIMIT, PARAMETERS, ROOT, Ears, command_of, node_process, process_of
from output_helpers import ESTIMATE, summary
from rclpy.qos import DurabilityPolicy, QoSProfile
from rich.console import Console
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Float64, String
from visualization_msgs.msg import Marker, MarkerArray

from fden_ros.control.live_tissue import Refusal
from fden_ros.core.outputs import (
    ContactSummary,
    Flag,
    OrderSource,
    Phase,
    Signals,
    Status,
    TissueState,
)
from fden_ros.report.monitor import MonitorView, monitor_view
from fden_ros.ros.markers import StiffnessMap

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: What a machine that runs every other test beside it can keep pace with.
SIMULATOR = {"force.rate": 100.0, "displacement.rate": 100.0}
IDENTIFIER = {"autostart": True, "estimate.period": 0.02}


def on_map(site: int, stiffness: float = 500.0) -> ContactSummary:
    """A contact with a place, ln G known to 0.02."""
    estimate = ESTIMATE._replace(
        log_linear_stiffness=math.log(stiffness), covariance=np.diag([4e-4, 4e-4, 1e-4])
    )
    return summary(
        site_id=site,
        contact_id=site,
        estimate=estimate,
        position=(0.01 * site, 0.02, 0.03),
        position_frame="base",
    )


def points(cloud: PointCloud2) -> dict[str, np.ndarray]:
    formats = {PointField.FLOAT32: "<f4", PointField.FLOAT64: "<f8"}
    kind = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "formats": [formats[field.datatype] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    rows = np.frombuffer(bytes(cloud.data), kind)
    assert rows.size == cloud.width
    return {name: rows[name] for name in rows.dtype.names or ()}


def test_a_site_is_one_marker_and_one_point_of_its_newest_contact():
    stiffness_map = StiffnessMap()
    for site, stiffness in ((1, 300.0), (2, 900.0), (1, 320.0)):
        assert stiffness_map.add(on_map(site, stiffness))
    markers = stiffness_map.markers().markers
    assert sorted(m.id for m in markers if m.ns == "sites") == [1, 2]
    assert all(m.header.frame_id == "base" for m in markers)
    raw = stiffness_map.cloud()
    # RViz draws coordinates of float32 alone.
    assert [field.datatype for field in raw.fields[:3]] == [PointField.FLOAT32] * 3
    assert len(raw.data) == raw.row_step == 2 * raw.point_step
    cloud = points(raw)
    assert cloud["G"] == pytest.approx([320.0, 900.0])
    assert cloud["x"] == pytest.approx([0.01, 0.02])
    assert cloud["G_sd"] == pytest.approx([6.4, 18.0])


def drawn(messages: list[MarkerArray]) -> set[int]:
    """The sites that are left on the screen after messages: what RViz makes of their actions."""
    shown: dict[tuple[str, int], Marker] = {}
    for marker in (m for message in messages for m in message.markers):
        if marker.action == Marker.DELETEALL:
            assert marker.header.frame_id, "RViz refuses a marker without a frame"
            shown.clear()
        elif marker.action == Marker.DELETE:
            shown.pop((marker.ns, marker.id), None)
        else:
            shown[marker.ns, marker.id] = marker
    return {site for _, site in shown}


def test_markers_go_where_their_sites_are_on_the_map_no_longer():
    """Withdrawn, forgotten as the oldest, or of the node's run before."""
    stiffness_map = StiffnessMap()
    messages = []
    for site in range(1, 1004):
        stiffness_map.add(on_map(site))
        if site > 998:
            messages.append(stiffness_map.markers())
    assert drawn(messages) == set(range(4, 1004))
    assert points(stiffness_map.cloud())["x"] == pytest.approx(0.01 * np.arange(4, 1004))
    withdrawn = replace(on_map(1003), estimate=None, converged=False)
    assert stiffness_map.add(withdrawn) and withdrawn in stiffness_map
    messages.append(stiffness_map.markers())
    assert drawn(messages) == set(range(4, 1003))
    assert points(stiffness_map.cloud())["x"] == pytest.approx(0.01 * np.arange(4, 1003))
    another_run = StiffnessMap()
    another_run.add(on_map(1))
    assert drawn([*messages, another_run.markers()]) == {1}


def shown(view: MonitorView) -> str:
    console = Console(width=110, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    console.print(monitor_view(view))
    return console.export_text()


def test_the_monitor_shows_what_is_known_and_what_is_not():
    assert "nothing heard yet" in shown(MonitorView("/identifier"))
    state = TissueState(
        stamp_ns=0,
        status=Status.CONVERGED,
        flags=Flag.GAP,
        site_id=2,
        contact_id=3,
        phase=Phase.HOLDING,
        order_source=OrderSource.LEARNED,
        estimate=ESTIMATE,
        signals=Signals(0.2, 500.0, 400.0),
    )
    text = shown(
        MonitorView(
            "/identifier",
            state=state,
            age=0.01,
            rate=99.0,
            refusal=Refusal.REJECTED,
            label="liver",
            probabilities={"liver": 0.97, "unknown": 0.03},
            summaries=(on_map(1),),
            diagnostics={"message": "3 samples rejected in the last second"},
            gains="safe",
        )
    )
    for words in (
        *("converged", "gap", "99 Hz", "3 at site 2", "holding", "0.130", "learned"),
        *("liver 97%", "3 samples rejected", "safe", "Contacts"),
        f"[{500 * math.exp(-0.2):.4g}, {500 * math.exp(0.2):.4g}]",
    ):
        assert words in text
    lost = MonitorView("/identifier", state=state, age=3.0, refusal=Refusal.LOST)
    assert "no estimate for 3.0 s" in shown(lost)


def test_the_controller_schedules_live_and_falls_back_when_the_node_dies():
    with Ears() as ears:
        gains = ears.hear(String, "/force_controller/gains", LATCHED)
        forces = ears.hear(WrenchStamped, "/force")
        estimates = ears.hear(TissueEstimate, "/identifier/estimate")
        maps = ears.hear(PointCloud2, "/identifier/stiffness_map", LATCHED)
        markers = ears.hear(MarkerArray, "/identifier/markers", LATCHED)
        target = ears.node.create_publisher(Float64, "/target_force", 10)
        with (
            node_process("tissue_simulator", SIMULATOR, file=PARAMETERS),
            node_process("identifier", IDENTIFIER, file=PARAMETERS) as identifier,
        ):
            # The air's noise is measured before the touch.
            ears.wait_for(lambda: len(estimates) > 50, "the identifier")
            controller = {"program.forces": "[0.0]", "tare_time": 2.0, "reaction_time": 0.1}
            with node_process("force_controller", controller, file=PARAMETERS) as node:
                ears.wait_for(target.get_subscription_count, "the controller")
                target.publish(Float64(data=0.1))
                ears.wait_for(lambda: gains and gains[-1].data == "live", "live gains")
                ears.wait_for(lambda: abs(mean_force(forces) - 0.1) < 0.01, "the force wanted")
                target.publish(Float64(data=0.0))
                ears.wait_for(lambda: maps and markers, "the map")
                cloud = points(maps[-1])
                assert cloud["G"] == pytest.approx([341.8], rel=0.1)
                assert cloud["x"] == pytest.approx([0.0], abs=1e-4)
                assert maps[-1].header.frame_id == "base"
                # And measured again, where the release found the force off its zero.
                released = len(estimates)
                ears.wait_for(lambda: len(estimates) > released + 100, "1 s of air")
                target.publish(Float64(data=0.1))
                ears.wait_for(lambda: gains[-1].data == "live", "live gains again")
                gains.clear()
                identifier.kill()
                ears.wait_for(lambda: gains and gains[-1].data == "safe", "safe gains")
            assert node.returncode == 0


def mean_force(forces: list[Any], bias: float = 0.05) -> float:
    if len(forces) < 50:
        return math.nan
    return float(np.mean([message.wrench.force.z for message in forces[-20:]])) - bias


def test_the_documented_program_runs_as_it_stands():
    program = ROOT / "examples" / "controller.py"
    # As the page starts it.
    simulator = command_of("tissue_simulator", SIMULATOR, file=PARAMETERS)
    simulator[1:4] = ["-m", "fden_ros.nodes.tissue_simulator"]
    with Ears() as ears:
        forces = ears.hear(WrenchStamped, "/force")
        estimates = ears.hear(TissueEstimate, "/identifier/estimate")
        with (
            process_of(simulator),
            node_process("identifier", IDENTIFIER, file=PARAMETERS),
        ):
            # The air's noise is measured before the touch.
            ears.wait_for(lambda: len(estimates) > 50, "the identifier")
            with process_of([sys.executable, str(program)]) as controller:
                ears.wait_for(
                    lambda: abs(mean_force(forces) - 0.15) < 0.01, "the force it wants", 90.0
                )
                assert controller.poll() is None
    assert controller.returncode == 0
    assert "Traceback" not in controller.output and "Error" not in controller.output


def test_the_live_system_starts_and_ends_cleanly_on_ctrl_c(tmp_path):
    with Ears() as ears:
        forces = ears.hear(WrenchStamped, "/fden_live/force")
        with process_of([sys.executable, "-m", "fden_ros.cli", "live"]) as live:
            ears.wait_for(lambda: len(forces) > 100, "the simulator")
            ears.wait_for(
                lambda: ears.node.count_publishers("/fden_live/command"), "the controller"
            )
            ears.wait_for(
                lambda: ears.node.count_publishers("/fden_live/identifier/estimate"),
                "the identifier",
            )
            live.send_signal(signal.SIGINT)
            assert live.wait(LIMIT) == 0
        assert "stopped tissue_simulator, identifier, force_controller" in live.output
        assert "Traceback" not in live.output
        ears.wait_for(
            lambda: not ears.node.count_publishers("/fden_live/force"), "everybody's end"
        )
