# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The node ``bridge``: gains of a controller that runs already, from the live stiffness.

Sets parameters of ros2_controllers' ``admittance_controller`` or of FZI's Cartesian controllers
through the services that every node has; publishes ``~/stiffness`` and ``~/gains``. Off unless
``controller`` names one. The rule is in :mod:`fden_ros.control.gain_rules`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64, String

from fden_ros.control.gain_rules import (
    AdmittanceRule,
    CartesianRule,
    StiffnessInUse,
    StiffnessLimits,
)
from fden_ros.control.live_tissue import Refusal
from fden_ros.errors import InputError
from fden_ros.nodes.descriptors import descriptor_of
from fden_ros.nodes.running import run_node
from fden_ros.parameters import Parameter
from fden_ros.ros.topics import latched
from fden_ros.tissue_feed import OFFERED_DEADLINE, TissueFeed

PARAMETERS = (
    Parameter(
        "controller",
        "none",
        "1",
        "Whose gains are set: admittance (ros2_controllers), cartesian (FZI's force and "
        "compliance controllers), or none.",
        choices=("none", "admittance", "cartesian"),
    ),
    Parameter("target", "", "1", "Name of the controller's node, such as admittance_controller."),
    Parameter(
        "axis",
        "z",
        "1",
        "Axis into the tissue: of the control frame (admittance), of the base (cartesian).",
        choices=("x", "y", "z"),
    ),
    Parameter(
        "p",
        0.0,
        "1",
        "cartesian: pd_gains.trans_*.p of the axis, as it is right for tissue of safe_stiffness.",
        0.0,
        1e6,
    ),
    Parameter(
        "d",
        0.0,
        "1",
        "cartesian: pd_gains.trans_*.d of the axis, as it is right for that.",
        0.0,
        1e6,
    ),
    Parameter("identifier", "identifier", "1", "Name of the identifier node."),
    Parameter(
        "safe_stiffness",
        130.0,
        "N/m",
        "Stiffness of the stiffest tissue that is expected; the gains without an estimate.",
        0.1,
        1e6,
    ),
    Parameter(
        "least_stiffness",
        10.0,
        "N/m",
        "No gain is larger than for tissue as soft as this.",
        0.1,
        1e6,
    ),
    Parameter(
        "softening_rate",
        2.0,
        "1/s",
        "The stiffness in use falls by no more than the factor e in 1 / softening_rate; it rises "
        "at once.",
        0.01,
        100.0,
    ),
    Parameter(
        "deviations",
        1.0,
        "1",
        "The stiffness in use is the estimate plus this number of its standard deviations.",
        0.0,
        10.0,
    ),
    Parameter("bandwidth", 12.0, "rad/s", "Of the force on the tissue.", 0.1, 1000.0),
    Parameter("rate", 20.0, "Hz", "How often the gains are looked at.", 1.0, 200.0),
    Parameter(
        "change",
        0.02,
        "1",
        "Smaller relative changes of a gain wait for the next second.",
        0.0,
        0.5,
    ),
    Parameter("deadline", 0.1, "s", "Older estimates are refused.", OFFERED_DEADLINE, 10.0),
    Parameter(
        "timeout",
        0.5,
        "s",
        "A controller that does not answer within it is told as unreachable.",
        0.05,
        10.0,
    ),
)
_AXES = {"x": 0, "y": 1, "z": 2}
#: All gains are set anew after this time [s]: the controller may have started again.
_REFRESH = 1.0
#: A controller that is up is found within this time [s].
_DISCOVERY = 3.0
#: How long the safe gains are waited for at the end [s].
_LAST_WORDS = 1.0
_STIFFNESS_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)

Gains = dict[str, float | list[float]]


class Target:
    """The parameters of a controller that the rule reads and sets.

    Parameters
    ----------
    values : mapping
        Of the node's parameters.

    Raises
    ------
    InputError
        If one is missing that this controller needs.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self._kind, self._axis = values["controller"], values["axis"]
        self._bandwidth, self._safe_stiffness = values["bandwidth"], values["safe_stiffness"]
        self._tuned = (values["p"], values["d"])
        self._rule: AdmittanceRule | CartesianRule | None = None
        self._ratios: list[float] = []
        if not values["target"]:
            raise InputError(f"name the {self._kind} controller's node by `target`")
        if self._kind == "admittance":
            self.names = [f"admittance.{name}" for name in ("mass", "stiffness", "damping_ratio")]
            return
        # Read from the controller it might be what a bridge before this one has set.
        if not values["p"] > 0.0:
            raise InputError(
                f"p is 0: give that of the {self._kind} controller, tuned for tissue of "
                "safe_stiffness"
            )
        self.names = [f"stiffness.trans_{self._axis}"]

    @property
    def is_known(self) -> bool:
        """Whether the controller's own parameters have been read."""
        return self._rule is not None

    def read(self, values: Sequence[ParameterValue]) -> None:
        """Take the values of `names`.

        Raises
        ------
        InputError
            If one is missing or of another type, or the rule cannot work with it.
        """
        if self._kind == "cartesian":
            (value,) = values
            # A force controller has no spring.
            is_set = value.type != ParameterType.PARAMETER_NOT_SET
            if is_set and value.type != ParameterType.PARAMETER_DOUBLE:
                raise InputError(
                    f"{self.names[0]} is no number: is it one of FZI's Cartesian controllers?"
                )
            spring = value.double_value if is_set else 0.0
            self._rule = CartesianRule(self._tuned, spring, self._safe_stiffness)
            return
        for name, value in zip(self.names, values, strict=True):
            if len(value.double_array_value) != 6:
                raise InputError(
                    f"{name} is no list of six numbers: is it an admittance_controller?"
                )
        mass, spring, self._ratios = (list(value.double_array_value) for value in values)
        index = _AXES[self._axis]
        self._rule = AdmittanceRule(mass[index], spring[index], self._bandwidth)

    def gains(self, stiffness: float) -> Gains:
        """Return the parameters for tissue of a stiffness [N/m]."""
        if isinstance(self._rule, AdmittanceRule):
            ratios = list(self._ratios)
            ratios[_AXES[self._axis]] = self._rule.damping_ratio(stiffness)
            return {self.names[2]: ratios}
        assert self._rule is not None
        p, d = self._rule.for_tissue(stiffness)
        return {f"pd_gains.trans_{self._axis}.p": p, f"pd_gains.trans_{self._axis}.d": d}


class Bridge(Node):
    """Keeps the gains of one controller right for the tissue, or safe."""

    def __init__(self, **options: Any) -> None:
        super().__init__("bridge", **options)
        values: Mapping[str, Any] = {
            parameter.name: parameter.check(
                self.declare_parameter(
                    parameter.name, parameter.default, descriptor_of(parameter, read_only=True)
                ).value
            )
            for parameter in PARAMETERS
        }
        self._values = values
        self._in_use = StiffnessInUse(
            StiffnessLimits(
                safe_stiffness=values["safe_stiffness"],
                least_stiffness=values["least_stiffness"],
                softening_rate=values["softening_rate"],
                deviations=values["deviations"],
                time_scale=1.0 / values["bandwidth"],
            )
        )
        self._target: Target | None = None
        if values["controller"] != "none":
            self._target = Target(values)
            target = self._absolute(values["target"])
            self._get = self.create_client(GetParameters, f"{target}/get_parameters")
            self._set = self.create_client(SetParameters, f"{target}/set_parameters")
        self._pending: tuple[Any, Any, float] | None = None  #: client, future, since
        self._sent: Gains = {}
        self._asked = -_REFRESH
        self._reached = time.monotonic()
        self._told = ""
        self._problem, self._has_set = "", False
        self._feed = TissueFeed(
            self,
            self._absolute(values["identifier"]),
            deadline=values["deadline"],
            on_loss=self._on_loss,
        )
        self._gains_topic = self.create_publisher(String, "~/gains", latched(1))
        self._stiffness_topic = self.create_publisher(Float64, "~/stiffness", _STIFFNESS_QOS)
        self._timer = self.create_timer(
            1.0 / values["rate"], self._look, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def finish(self) -> None:
        """Leave the controller with the safe gains."""
        target = self._target
        if target is None or not target.is_known or not self._set.service_is_ready():
            return
        self._timer.cancel()
        future = self._set.call_async(_request(target.gains(self._values["safe_stiffness"])))
        end = time.monotonic() + _LAST_WORDS
        while not future.done() and time.monotonic() < end and self.executor is not None:
            self.executor.spin_once(timeout_sec=0.05)

    # Inside

    def _absolute(self, name: str) -> str:
        return name if name.startswith("/") else f"{self.get_namespace().rstrip('/')}/{name}"

    def _on_loss(self, why: Refusal) -> None:
        self.get_logger().info(f"safe gains: {why.value}")
        self._look()

    def _look(self) -> None:
        now = time.monotonic()
        if self._feed.refusal() is Refusal.NO_CONTACT:
            self._in_use.leave()
        else:
            self._in_use.step(now, self._feed.reading())
        self._stiffness_topic.publish(Float64(data=self._in_use.value))
        if self._target is not None:
            self._talk(self._target, now)
        self._tell()

    def _talk(self, target: Target, now: float) -> None:
        """Read what is needed, then set what has changed; one request at a time."""
        if self._pending is not None:
            client, future, since = self._pending
            if not future.done():
                if now - since < self._values["timeout"]:
                    return
                client.remove_pending_request(future)
                self._sent = {}
                self._has("unreachable", f"{client.srv_name} does not answer")
            self._pending = None
        client = self._set if target.is_known else self._get
        if not client.service_is_ready():
            self._sent = {}
            if now - self._reached > _DISCOVERY:
                words = f"nothing offers {client.srv_name}: is the controller up?"
                self._has("unreachable", words)
            return
        self._reached = now
        is_due = now - self._asked > _REFRESH
        if not target.is_known:
            if is_due:
                self._ask(client, GetParameters.Request(names=target.names), self._on_values, now)
            return
        gains = target.gains(self._in_use.value)
        if is_due or self._differs(gains):
            self._sent = gains
            self._ask(client, _request(gains), self._on_set, now)

    def _ask(self, client: Any, request: Any, then: Any, now: float) -> None:
        future = client.call_async(request)
        self._pending, self._asked = (client, future, now), now
        future.add_done_callback(lambda done: None if done.cancelled() else then(done.result()))

    def _on_values(self, response: GetParameters.Response) -> None:
        assert self._target is not None
        try:
            if len(response.values) != len(self._target.names):
                raise InputError(f"{self._get.srv_name} does not know {self._target.names}")
            self._target.read(response.values)
        except InputError as error:
            self._has("refused", str(error))
            return
        self._asked = -_REFRESH  # The gains follow at once.

    def _on_set(self, response: SetParameters.Response) -> None:
        reasons = [result.reason for result in response.results if not result.successful]
        if reasons:
            self._has("refused", f"{self._set.srv_name} refuses the gains: {reasons[0]}")
            return
        self._problem, self._has_set = "", True

    def _differs(self, gains: Gains) -> bool:
        """Whether a gain has moved by more than `change`, or is that of a loss."""
        if self._sent.keys() != gains.keys():
            return True
        before, after = (np.hstack(list(values.values())) for values in (self._sent, gains))
        change = self._values["change"] if self._in_use.is_live else 0.0
        return bool(np.any(np.abs(after - before) > change * np.abs(before)))

    def _has(self, problem: str, words: str) -> None:
        if problem != self._problem:
            self.get_logger().error(f"{words}; its gains are as they are")
        self._problem = problem

    def _tell(self) -> None:
        """Say where the gains come from, when that changes."""
        told = self._problem
        if self._target is None:
            told = "off"
        elif self._has_set and not told:
            told = "live" if self._in_use.is_live else "safe"
        if told != self._told:
            self._told = told
            self._gains_topic.publish(String(data=told))


def _request(gains: Gains) -> SetParameters.Request:
    return SetParameters.Request(
        parameters=[RosParameter(n, value=value).to_parameter_msg() for n, value in gains.items()]
    )


def main(arguments: list[str] | None = None) -> int:
    """Run the bridge until SIGINT or SIGTERM; leave the controller with the safe gains."""
    return run_node("bridge", Bridge, arguments, finish=Bridge.finish)


if __name__ == "__main__":
    raise SystemExit(main())
