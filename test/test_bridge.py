# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The bridge to controllers that exist: the rule, and stand-ins with their parameters over DDS."""

from __future__ import annotations

import contextlib
import itertools
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fden_msgs.msg import TissueEstimate
from live_helpers import LIMIT, Ears, node_process
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Float64, String
from test_tissue_feed import LIVER, Press

from fden_ros.control.gain_rules import (
    AdmittanceRule,
    CartesianRule,
    StiffnessInUse,
    StiffnessLimits,
)
from fden_ros.core.outputs import Status, TissueState
from fden_ros.errors import InputError
from fden_ros.nodes.bridge import PARAMETERS
from fden_ros.ros.topics import OUTPUT_TOPICS, OutputMessages

ROOT = Path(__file__).parent.parent
SAFE, BANDWIDTH = 400.0, 8.0
LIMITS = StiffnessLimits(SAFE, least_stiffness=20.0, softening_rate=2.0, time_scale=0.1)


# The rule


def known(value: float, sd: float = 0.0) -> Any:
    """A reading whose stiffness is known."""
    return SimpleNamespace(stiffness=lambda time_scale: (value, sd))


def test_the_stiffness_in_use_falls_slowly_rises_at_once_and_is_safe_on_a_loss() -> None:
    in_use = StiffnessInUse(LIMITS)
    values = [in_use.step(t, known(50.0, 5.0)) for t in np.arange(0.0, 3.0, 0.05)]
    assert values[0] == SAFE and values[-1] == 55.0
    assert np.all(np.diff(np.log(values)) >= -2.0 * 0.05 - 1e-12)
    assert in_use.step(3.0, None) == SAFE and not in_use.is_live
    assert in_use.step(3.1, known(900.0)) == 900.0 and in_use.is_live
    # No faster than before the loss.
    assert in_use.step(3.2, None) == 900.0
    in_use.leave()
    assert in_use.value == SAFE
    assert [in_use.step(4.0 + t, known(1.0)) for t in (0.0, 10.0)][1] == LIMITS.least_stiffness


@pytest.mark.parametrize("mass", [0.1, 2.0, 20.0])
@pytest.mark.parametrize("spring", [5.0, 300.0])
def test_an_admittance_controller_neither_rings_nor_outruns_the_bandwidth(
    mass: float, spring: float
) -> None:
    rule = AdmittanceRule(mass, spring, BANDWIDTH)
    for tissue in np.geomspace(10.0, 5000.0, 30):
        damping = 2.0 * rule.damping_ratio(tissue) * np.sqrt(mass * spring)
        poles = np.roots([mass, damping, spring + tissue])
        assert np.abs(poles.imag).max() < 1e-5 * np.abs(poles).max()
        if damping > 1.001 * 2.0 * np.sqrt(mass * (spring + tissue)):
            # As the force loop of the rule, faster by the spring and the mass, by their share.
            slow = np.abs(poles).min()
            assert BANDWIDTH <= slow * (1.0 + 1e-9) <= 2.1 * BANDWIDTH * (1.0 + spring / tissue)


def slowest(rule: AdmittanceRule, made_for: float, tissue: float) -> float:
    """Slowest pole [rad/s] of a controller whose damping is made for one tissue, on another."""
    damping = 2.0 * rule.damping_ratio(made_for) * np.sqrt(rule.mass * rule.stiffness)
    return float(np.abs(np.roots([rule.mass, damping, rule.stiffness + tissue])).min())


def test_soft_tissue_is_answered_as_quickly_as_the_page_says() -> None:
    rule = AdmittanceRule(2.0, 80.0, BANDWIDTH)
    words = f"{slowest(rule, 30.0, 30.0):.1f} rad/s instead of {slowest(rule, SAFE, 30.0):.1f}"
    assert words in (ROOT / "docs" / "controller.md").read_text(encoding="utf-8")


def test_a_cartesian_controller_keeps_its_loop_gain() -> None:
    rule = CartesianRule((0.05, 0.005), 500.0, SAFE)
    assert rule.for_tissue(SAFE) == (0.05, 0.005)
    for tissue in (20.0, 100.0, 2000.0):
        p, d = rule.for_tissue(tissue)
        assert p * (500.0 + tissue) == pytest.approx(0.05 * (500.0 + SAFE))
        assert d / p == pytest.approx(0.1)


def test_without_a_spring_or_mass_there_is_no_damping_and_that_is_said() -> None:
    with pytest.raises(InputError, match=r"admittance\.stiffness of the axis is 0"):
        AdmittanceRule(2.0, 0.0, BANDWIDTH)
    with pytest.raises(InputError, match="must be the larger"):
        StiffnessLimits(5.0, least_stiffness=10.0)


# Stand-ins


class StandIn(Node):
    """A node with a controller's parameters as that declares them, and what it was given."""

    def __init__(self, name: str, parameters: dict[str, Any], context: Any) -> None:
        super().__init__(name, context=context)
        self.heard: list[tuple[float, dict[str, Any]]] = []
        for key, value in parameters.items():
            # generate_parameter_library and auto_declare: of a fixed type, and settable.
            self.declare_parameter(key, value, ParameterDescriptor(description=key))
        self.largest = 1e9
        self.add_on_set_parameters_callback(self._on_set)

    def _on_set(self, changes: list[Parameter]) -> SetParametersResult:
        for change in changes:
            # As generate_parameter_library answers where `element_bounds` do not hold.
            if np.max(change.value) > self.largest:
                reason = f"Value {np.max(change.value)} in parameter '{change.name}' is too large"
                return SetParametersResult(successful=False, reason=reason)
        self.heard.append((time.monotonic(), {c.name: _plain(c.value) for c in changes}))
        return SetParametersResult(successful=True)

    def value(self, name: str) -> Any:
        return _plain(self.get_parameter(name).value)


def _plain(value: Any) -> Any:
    return value if isinstance(value, float) else list(value)


ADMITTANCE = {
    "admittance.selected_axes": [True] * 6,
    "admittance.mass": [2.0, 2.0, 2.0, 0.1, 0.1, 0.1],
    "admittance.damping_ratio": [1.1, 1.2, 1.3, 1.4, 1.5, 1.6],
    "admittance.stiffness": [50.0, 50.0, 80.0, 1.0, 1.0, 1.0],
    "admittance.joint_damping": 5.0,
}
CARTESIAN = {
    "solver.error_scale": 0.5,
    "stiffness.trans_z": 500.0,
    "pd_gains.trans_x.p": 0.07,
    "pd_gains.trans_z.p": 0.05,
    "pd_gains.trans_z.d": 0.005,
}
#: Nothing is lost or unreachable because the machine does something else.
SETTINGS = {
    "safe_stiffness": SAFE,
    "bandwidth": BANDWIDTH,
    "softening_rate": 20.0,
    "deadline": 2.0,
    "timeout": 10.0,
}


class World:
    """Stand-in, identifier's estimates and the bridge's outputs, in one process."""

    def __init__(self, ears: Ears, parameters: dict[str, Any]) -> None:
        self.ears = ears
        self.executor: SingleThreadedExecutor = ears.executor
        self.controller = StandIn("controller", parameters, ears.context)
        self.executor.add_node(self.controller)
        (topic,) = (t for t in OUTPUT_TOPICS if t.message_type is TissueEstimate)
        self.estimates = ears.node.create_publisher(
            TissueEstimate, "/identifier/estimate", topic.profile(0.01)
        )
        latched = next(t for t in OUTPUT_TOPICS if t.name == "classification").profile(0.01)
        self.gains = ears.hear(String, "/bridge/gains", latched)
        self.stiffness = ears.hear(Float64, "/bridge/stiffness")

    def spin(self, until: float) -> None:
        while (left := until - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=left)

    def play(self, states: list[TissueState]) -> None:
        """Publish the states of a press at their own pace."""
        began, messages = time.monotonic(), OutputMessages()
        first = states[0].stamp_ns
        for state in states:
            self.spin(began + 1e-9 * (state.stamp_ns - first))
            for topic, message in messages.of(state, "probe"):
                if topic.message_type is TissueEstimate:
                    self.estimates.publish(message)

    def hold(self, state: TissueState, is_done: Callable[[], object], what: str) -> None:
        """Publish a state again and again, as of later and later, until something is so."""
        end = time.monotonic() + LIMIT
        while not is_done():
            assert time.monotonic() < end, what
            state = replace(state, stamp_ns=state.stamp_ns + 10_000_000)
            self.play([state])
            self.spin(time.monotonic() + 0.01)

    def said(self) -> list[str]:
        return [message.data for message in self.gains]

    def destroy(self) -> None:
        self.executor.remove_node(self.controller)
        self.controller.destroy_node()


@contextlib.contextmanager
def world(parameters: dict[str, Any], **bridge: Any) -> Iterator[tuple[World, Any]]:
    with Ears() as ears:
        scene = World(ears, parameters)
        with node_process("bridge", {**SETTINGS, **bridge}) as process:
            ears.wait_for(
                lambda: (
                    ears.node.count_publishers("/bridge/gains")
                    and scene.estimates.get_subscription_count()
                ),
                "the bridge",
            )
            yield scene, process
        scene.destroy()


@pytest.fixture(scope="module")
def press() -> Press:
    return Press(LIVER, seed=1, after=0.0)


def converged(press: Press) -> list[TissueState]:
    return [state for state in press.states if state.status is Status.CONVERGED]


def stiffness_of(state: TissueState) -> float:
    """Stiffness for a motion of 1 / bandwidth and its deviation together [N/m]."""
    assert state.apparent_stiffness is not None and state.estimate is not None
    apparent = state.apparent_stiffness
    shift = (1.0 / BANDWIDTH / apparent.time_scale) ** -state.estimate.fractional_order
    return shift * (apparent.value + apparent.sd)


def admittance_ratio(tissue: float) -> float:
    damping = max(tissue / BANDWIDTH, 2.0 * np.sqrt(2.0 * (80.0 + tissue)))
    return float(damping / (2.0 * np.sqrt(2.0 * 80.0)))


def test_an_admittance_controller_follows_the_tissue_and_is_safe_on_loss(press: Press) -> None:
    name = "admittance.damping_ratio"
    with world(ADMITTANCE, controller="admittance", target="controller") as (scene, process):
        controller, safe = scene.controller, admittance_ratio(SAFE)
        scene.ears.wait_for(lambda: controller.heard, "the first gains")
        assert controller.value(name) == pytest.approx([1.1, 1.2, safe, 1.4, 1.5, 1.6])
        scene.ears.wait_for(scene.said, "where they come from")
        scene.play(press.states)
        scene.ears.wait_for(lambda: scene.said()[-1] == "safe", "the loss")
        # The bridge may have begun before the controller could be reached.
        said = [word for word, _ in itertools.groupby(scene.said()) if word != "unreachable"]
        assert said[:2] == ["safe", "live"]
        live = [values[name] for _, values in controller.heard if values[name][2] != safe]
        softest = min(one[2] for one in live)
        expected = [admittance_ratio(stiffness_of(state)) for state in converged(press)]
        assert min(expected) == pytest.approx(softest, rel=0.05)
        assert softest >= min(expected)
        assert softest < 0.8 * safe
        assert all(one[:2] + one[3:] == [1.1, 1.2, 1.4, 1.5, 1.6] for one in live)
        scene.ears.wait_for(lambda: controller.value(name)[2] == pytest.approx(safe), "safety")
        assert controller.value("admittance.stiffness")[2] == 80.0
        # What the controller forgets is set anew.
        controller.set_parameters([Parameter(name, value=[1.0] * 6)])
        scene.ears.wait_for(lambda: controller.value(name)[2] == pytest.approx(safe), "it again")
    assert "Traceback" not in process.output


def test_a_cartesian_controller_is_left_with_the_safe_gains_when_the_bridge_ends(
    press: Press,
) -> None:
    name = "pd_gains.trans_z.p"
    target = {"controller": "cartesian", "target": "/controller", "p": 0.05, "d": 0.005}
    with world(CARTESIAN, **target) as (scene, process):
        controller = scene.controller
        scene.ears.wait_for(lambda: controller.heard, "the first gains")
        assert controller.value(name) == 0.05
        # Up to the middle of the hold, and not beyond: the bridge ends while the gains are live.
        known = converged(press)
        middle = known[len(known) // 2]
        scene.play([s for s in press.states if s.stamp_ns <= middle.stamp_ns])
        tissue = stiffness_of(middle)
        right = pytest.approx(0.05 * (500.0 + SAFE) / (500.0 + tissue), rel=0.05)
        scene.hold(middle, lambda: controller.value(name) == right, "the gains of the tissue")
        assert scene.said()[-1] == "live"
        live = controller.value(name)
        assert controller.value("pd_gains.trans_z.d") == pytest.approx(0.1 * live)
        assert controller.value("pd_gains.trans_x.p") == 0.07
        process.send_signal(signal.SIGINT)
        scene.ears.wait_for(lambda: process.poll() is not None, "the end of the bridge")
        scene.ears.wait_for(lambda: controller.value(name) == 0.05, "the safe gains")
    assert process.returncode == 0


def test_by_default_it_sets_nothing(press: Press) -> None:
    with world(CARTESIAN) as (scene, _):
        known = converged(press)
        middle = known[len(known) // 2]
        scene.play([s for s in press.states if s.stamp_ns <= middle.stamp_ns])
        softens = lambda: min(m.data for m in scene.stiffness) < 0.8 * SAFE  # noqa: E731
        scene.hold(middle, softens, "the stiffness of the tissue")
        scene.ears.wait_for(lambda: scene.said() == ["off"], "that it sets nothing")
        assert not scene.controller.heard


def test_a_controller_that_refuses_or_is_not_there_is_said_in_one_line() -> None:
    target = {"controller": "admittance", "target": "controller", "timeout": 3.0}
    with world(ADMITTANCE, **target) as (scene, process):
        scene.ears.wait_for(lambda: scene.controller.heard, "the first gains")
        scene.controller.largest = 0.1
        scene.ears.wait_for(lambda: scene.said()[-1:] == ["refused"], "the refusal")
        scene.controller.largest = 1e9
        scene.ears.wait_for(lambda: scene.said()[-1] == "safe", "that it is taken again")
        scene.executor.remove_node(scene.controller)
        scene.ears.wait_for(lambda: scene.said()[-1] == "unreachable", "the missing answer")
        scene.executor.add_node(scene.controller)
        scene.ears.wait_for(lambda: scene.said()[-1] == "safe", "the answer")
        said = scene.said()
    # Once each, but where a busy machine has answered late in between.
    assert 1 <= process.output.count("does not answer") <= said.count("unreachable") + 1
    assert 1 <= process.output.count("refuses the gains: Value") <= said.count("unreachable")
    with world({**ADMITTANCE, "admittance.stiffness": [0.0] * 6}, **target) as (scene, process):
        scene.ears.wait_for(lambda: scene.said()[-1:] == ["refused"], "the refusal")
    assert process.output.count("admittance.stiffness of the axis is 0") == 1


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"controller": "admittance"}, "name the admittance controller's node by `target`"),
        ({"controller": "cartesian", "target": "a"}, "p is 0: give that of the cartesian"),
        ({"controller": "impedance"}, "must be one of none, admittance, cartesian"),
        ({"least_stiffness": 200.0}, "must be the larger"),
        ({"rate": 1e5}, "rate"),
    ],
)
def test_a_wrong_parameter_ends_it_with_one_line(given: dict[str, Any], words: str) -> None:
    with node_process("bridge", given) as process:
        assert process.wait(LIMIT) == 1
    lines = process.output.strip().splitlines()
    assert len(lines) == 1 and words in lines[0]


def test_the_page_has_every_parameter_with_its_default() -> None:
    page = (ROOT / "docs" / "controller.md").read_text(encoding="utf-8")
    for parameter in PARAMETERS:
        text = f"`{parameter.default}`" if parameter.default != "" else ""
        row = f"| `{parameter.name}` | {text} | {parameter.unit} | {parameter.description}"
        limits = f" ({parameter.constraint})" if parameter.constraint else ""
        assert f"{row}{limits} |" in page, parameter.name
