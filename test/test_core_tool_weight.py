# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The weight of a tool that turns, taken off the force by its orientation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fault_helpers import first_press, turn_of
from geometry_msgs.msg import PoseStamped, WrenchStamped
from scipy.spatial.transform import Rotation

from fden_ros.core.outputs import ContactSummary
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.tool import ToolWeight
from fden_ros.parameters import check, pipeline_config
from fden_ros.recording.cdr import serialize
from fden_ros.ros.decoding import fast_handler
from fden_ros.ros.inputs import Inputs
from fden_ros.ros.messages import to_stamp

MASS, CENTRE, GRAVITY = 0.3, (0.01, -0.02, 0.05), (0.0, 0.0, -9.80665)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("is_torque", [False, True])
def test_load_is_the_weight_seen_from_the_sensor(seed: int, is_torque: bool) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    turn = Rotation.random(rng=rng)
    tool = ToolWeight(MASS, CENTRE, GRAVITY, tuple(axis), is_torque)
    weight = turn.inv().apply(MASS * np.array(GRAVITY))
    expected = axis @ (np.cross(CENTRE, weight) if is_torque else weight)
    assert tool.load(tuple(turn.as_quat())) == pytest.approx(expected, abs=1e-12)


def turning(mass: float, told: float, fast: bool) -> tuple[Pipeline, list[ContactSummary]]:
    """A press with a tool that turns all the time, its true mass and the one told."""
    base = first_press()
    outputs: list[object] = []
    values = check({**base.parameters, "tool.mass": told})
    pipeline = Pipeline(pipeline_config(values), outputs.append)
    inputs = Inputs(values, pipeline)
    handlers = {
        "force": fast_handler("force", "geometry_msgs/msg/WrenchStamped", inputs),
        "displacement": fast_handler("displacement", "geometry_msgs/msg/PoseStamped", inputs),
    }
    for item in base.items:
        turn = turn_of(base.second(item.stamp_ns))
        if item.stream == 0:
            weight = turn.inv().apply(mass * np.array(GRAVITY))
            message = WrenchStamped()
            message.wrench.force.x, message.wrench.force.y = map(float, weight[:2])
            message.wrench.force.z = item.value + float(weight[2])
            name = "force"
        else:
            message = PoseStamped()
            assert item.position is not None
            message.pose.position.x, message.pose.position.y, message.pose.position.z = (
                item.position
            )
            orientation = message.pose.orientation
            orientation.x, orientation.y, orientation.z, orientation.w = turn.as_quat().tolist()
            name = "displacement"
        message.header.stamp = to_stamp(item.stamp_ns)
        message.header.frame_id = "s"
        if fast:
            handlers[name](serialize(message))  # type: ignore[misc]
        else:
            inputs.add(name, message)
    pipeline.finish()
    return pipeline, [output for output in outputs if isinstance(output, ContactSummary)]


@pytest.mark.parametrize("fast", [False, True])
def test_a_tool_that_turns_while_it_presses_gives_what_one_that_does_not_turn_gives(
    fast: bool,
) -> None:
    _, still = turning(0.0, 0.0, fast)
    _, turned = turning(MASS, MASS, fast)
    assert len(turned) == len(still) == 1
    for a, b in zip(turned, still, strict=True):
        assert a.estimate is not None and b.estimate is not None
        assert a.converged and not a.flags
        sd = math.sqrt(b.estimate.covariance[0, 0])
        assert abs(a.estimate.log_linear_stiffness - b.estimate.log_linear_stiffness) < 0.3 * sd
