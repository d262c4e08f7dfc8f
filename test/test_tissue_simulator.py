# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The stepped tissue, the rig, and the simulator node in its own process."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from live_helpers import Ears, node_process
from sensor_msgs.msg import JointState

from fden_ros.ros.messages import stamp_ns
from fden_ros.simulation.model import FdenModel
from fden_ros.simulation.rig import Command, Rig, RigConfig
from fden_ros.simulation.tissue import Column, Inclusion, Tissue
from simulation.closed_form import moves_of_knots
from simulation.contact import contacts_of_moves

LIVER = FdenModel(544.8, 8.547, 0.131)
STEP = 1e-3
#: Of the peak; the promise.
TOLERANCE = 1e-4


@pytest.mark.parametrize(
    "model",
    [
        FdenModel(341.8, 5.26, 0.118),
        LIVER,
        FdenModel(1294.0, 13.18, 0.146),
        FdenModel(500.0, 8.0, 0.32),
    ],
)
@pytest.mark.parametrize(
    ("times", "strains"),
    [
        ([0.0, 3.0, 8.0], [0.0, 0.3, 0.3]),
        ([0.0, 0.3, 1.3], [0.0, 0.3, 0.3]),
        ([0.0, 0.2, 1.0, 2.0, 4.0, 4.5, 6.0], [-0.01, -0.01, 0.24, 0.24, -0.06, 0.19, 0.24]),
    ],
    ids=["slow ramp and hold", "fast ramp and hold", "release and second touch"],
)
def test_stepping_follows_the_closed_form(
    model: FdenModel, times: list[float], strains: list[float]
) -> None:
    instants = np.arange(1, int(times[-1] / STEP)) * STEP
    exact = contacts_of_moves(moves_of_knots(times, strains), model).stress(instants)
    tissue = Tissue([Column(model)], STEP)
    stepped = [tissue.press(x) for x in np.interp(instants, times, strains)]
    assert np.abs(stepped - exact).max() <= TOLERANCE * exact.max()


def test_an_inclusion_adds_its_own_law_from_where_it_is_met() -> None:
    plain = Tissue([Column(LIVER)], STEP)
    hard = Tissue([Column(LIVER, (Inclusion(0.1, 5000.0),))], STEP)
    body = Tissue([Column(FdenModel(5000.0, 1e-3, LIVER.fractional_order))], STEP)
    for strain in np.linspace(0.0, 0.25, 400):
        expected = plain.press(strain) + body.press(max(strain - 0.1, 0.0))
        assert hard.press(strain) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def settled(kind: Command, value: float, seconds: float = 3.0) -> Rig:
    rig = Rig(RigConfig((Column(LIVER),)))
    for n in range(int(seconds / STEP)):
        if n % 20 == 0:
            rig.command(kind, value)
        rig.step()
    return rig


def test_position_velocity_and_force_commands_are_followed() -> None:
    assert settled(Command.POSITION, 0.004).depth == pytest.approx(0.004, abs=1e-5)
    assert settled(Command.VELOCITY, 0.002).velocity == pytest.approx(0.002, rel=1e-6)
    assert settled(Command.FORCE, 0.1, 20.0).force == pytest.approx(0.1, rel=0.03)


def test_the_node_publishes_as_a_driver_does_and_takes_commands() -> None:
    with Ears() as ears:
        forces = ears.hear(WrenchStamped, "/force")
        poses = ears.hear(PoseStamped, "/displacement")
        command = ears.node.create_publisher(JointState, "/command", 10)
        with node_process("tissue_simulator", {"force.bias": 0.02}) as simulator:
            ears.wait_for(lambda: len(forces) > 200 and len(poses) > 100, "samples")
            stamps = [stamp_ns(message.header.stamp) for message in forces]
            assert {b - a for a, b in pairwise(stamps[:50])} == {2_000_000}
            air = [message.wrench.force.z for message in forces[:200]]
            assert np.mean(air) == pytest.approx(0.02, abs=5e-4)
            ears.wait_for(command.get_subscription_count, "the simulator's subscription")
            command.publish(JointState(name=["z"], position=[0.004]))
            ears.wait_for(lambda: poses[-1].pose.position.z > 0.0039, "the commanded depth")
            ears.wait_for(lambda: forces[-1].wrench.force.z > 0.05, "the force there")
            command.publish(JointState(name=["x"], position=[0.01]))
            ears.wait_for(lambda: poses[-1].pose.position.x > 0.0099, "the commanded place")
            command.publish(JointState(name=["z"], position=[0.0], velocity=[0.0]))
            command.publish(JointState(name=["z"], effort=[0.02]))
            ears.wait_for(
                lambda: abs(np.mean([m.wrench.force.z for m in forces[-50:]]) - 0.04) < 5e-3,
                "the commanded force",
            )
        assert simulator.returncode == 0
        assert "fill exactly one" in simulator.output
