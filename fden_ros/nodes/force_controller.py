# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The node ``force_controller``: the reference force controller on live topics.

Subscribes to ``force``, ``displacement`` and ``target_force``; publishes ``command`` (velocity),
``~/gains`` and ``~/stiffness``. The law is in :mod:`fden_ros.control.force_control`. With a
program it presses one site after the other by itself.
"""

from __future__ import annotations

import time
from typing import Any

from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from fden_ros.control import Cause, ForceControlConfig, ForceController
from fden_ros.errors import InputError
from fden_ros.nodes.running import declared, run_node
from fden_ros.ros.topics import latched
from fden_ros.tissue_feed import TissueFeed

#: Name, default and meaning, with its unit, of every parameter.
PARAMETERS: tuple[tuple[str, Any, str], ...] = (
    ("identifier", "identifier", "name of the identifier node"),
    ("scheduled", True, "gains from the live stiffness; false: the safe ones"),
    ("safe_stiffness", 130.0, "stiffness for which the safe gains are made [N/m]"),
    ("force_limit", 0.32, "upper limit of the force [N]"),
    ("bandwidth", 12.0, "of the force [rad/s]"),
    ("reaction_time", 0.06, "from a change of the force to the response of the axis [s]"),
    ("surface", 0.0, "displacement at the surface of the tissue [m]"),
    ("tare_time", 2.0, "time in the air at the start to measure the force's bias [s]"),
    ("program.forces", [0.0], "forces of a program, one after the other [N]; all 0: none"),
    ("program.duration", 3.0, "duration of each force [s]"),
    ("program.x", [0.0], "places to press, one after the other [m]"),
    ("program.y", [0.0], "second coordinate of the places [m]"),
)
#: Of the control loop [Hz].
_RATE = 200.0
#: How far the probe leaves the surface between two sites [m].
_LIFT = 0.004
#: Longest wait of the first touch for the identifier, which must see it [s].
_PATIENCE = 20.0
_QOS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
#: After 0.1 s without a force the probe is stopped [s].
_INPUT_TIMEOUT = 0.1


class ForceControllerNode(Node):
    """Force control that uses the estimate while it is reliable."""

    def __init__(self, **options: Any) -> None:
        super().__init__("force_controller", **options)
        values = declared(self, PARAMETERS)
        self._values = values
        names = "safe_stiffness", "force_limit", "bandwidth", "reaction_time"
        config = ForceControlConfig(**{name: values[name] for name in names})
        self._controller = ForceController(config)
        self._places = _places(values["program.x"], values["program.y"])
        self._feed = TissueFeed(
            self,
            self.resolve_topic_name(str(values["identifier"])),
            on_loss=lambda why: self.get_logger().info(f"safe gains: {why}"),
        )
        self._forces: list[float] = []
        self._air: list[float] = []
        self._bias: float | None = None
        self._depth = 0.0
        self._place = (0.0, 0.0)
        self._heard = 0.0
        self._target = 0.0
        self._started = 0.0
        self._began = 0.0
        self._gains = ""
        self._command = self.create_publisher(JointState, "command", _QOS)
        self._gains_topic = self.create_publisher(String, "~/gains", latched(1))
        self._stiffness_topic = self.create_publisher(Float64, "~/stiffness", _QOS)
        self.create_subscription(WrenchStamped, "force", self._on_force, _QOS)
        self.create_subscription(PoseStamped, "displacement", self._on_displacement, _QOS)
        self.create_subscription(Float64, "target_force", self._on_target, _QOS)
        self._timer = self.create_timer(
            1.0 / _RATE, self._control, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def _on_force(self, message: WrenchStamped) -> None:
        self._forces.append(message.wrench.force.z)
        self._heard = time.monotonic()

    def _on_displacement(self, message: PoseStamped) -> None:
        position = message.pose.position
        self._depth, self._place = position.z - self._values["surface"], (position.x, position.y)

    def _on_target(self, message: Float64) -> None:
        self._target = message.data

    def _control(self) -> None:
        now = time.monotonic()
        if not self._forces:
            if now - self._heard > _INPUT_TIMEOUT and self._bias is not None:
                self._send(velocity=0.0)
            return
        force = sum(self._forces) / len(self._forces)
        self._forces.clear()
        if self._bias is None:
            self._tare(force, now)
            return
        force -= self._bias
        self._follow_program(now)
        found = self._feed.stiffness(1.0 / self._values["bandwidth"])
        known = found[:2] if found is not None and self._values["scheduled"] else None
        velocity = self._controller.step(now, force, self._depth, self._target, known)
        if self._target <= 0.0 and self._depth < -_LIFT:
            velocity = 0.0
        self._send(velocity=velocity)
        self._stiffness_topic.publish(Float64(data=float(self._controller.stiffness)))
        gains = self._controller.gains.value
        if gains != self._gains:
            self._gains = gains
            self._gains_topic.publish(String(data=gains))

    def _tare(self, force: float, now: float) -> None:
        """Use the first moments, in the air, for the force's bias."""
        self._started = self._started or now
        refusal = self._feed.refusal()
        unheard = refusal is not None and refusal.cause in (Cause.NEVER_HEARD, Cause.STALE)
        if self._values["scheduled"] and unheard and now - self._started < _PATIENCE:
            return
        self._air.append(force)
        self._began = self._began or now
        if now - self._began >= self._values["tare_time"]:
            self._bias = sum(self._air) / len(self._air)
            self._began = now

    def _follow_program(self, now: float) -> None:
        forces = self._values["program.forces"]
        if not any(forces):
            return
        index = int((now - self._began) / self._values["program.duration"])
        site, step = divmod(index, len(forces))
        self._target = float(forces[step])
        if self._target <= 0.0 and self._depth < 0.0:
            self._move_to(*self._places[(site + 1) % len(self._places)])

    def _move_to(self, x: float, y: float) -> None:
        self._command.publish(JointState(name=["x", "y"], position=[x, y]))

    def _send(self, velocity: float) -> None:
        self._command.publish(JointState(name=["z"], velocity=[float(velocity)]))


def _places(x: Any, y: Any) -> list[tuple[float, float]]:
    if len(x) != len(y):
        raise InputError(f"program.x has {len(x)} places, program.y {len(y)}; give as many")
    return [(float(a), float(b)) for a, b in zip(x, y, strict=True)]


def main(arguments: list[str] | None = None) -> int:
    """Run the controller until SIGINT or SIGTERM."""
    return run_node("force_controller", ForceControllerNode, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
