# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The node ``tissue_simulator``: a probe on simulated tissue, with the topics of a robot's driver.

Takes ``command`` (sensor_msgs/JointState; the one array that is filled is the command:
position, velocity or effort of joint ``z``, or positions of ``x`` and ``y``), publishes ``force``
and ``displacement``. The tissue itself is in :mod:`fden_ros.simulation`.
"""

from __future__ import annotations

import time
from typing import Any

from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from fden_ros.errors import InputError
from fden_ros.nodes.running import declared, run_node
from fden_ros.ros.messages import to_stamp
from fden_ros.simulation import Column, Command, FdenModel, Inclusion, Rig, RigConfig

#: Name, default and meaning, with its unit, of every parameter.
PARAMETERS: tuple[tuple[str, Any, str], ...] = (
    ("sites.x", [0.0], "place of each site, across the approach axis [m]"),
    ("sites.y", [0.0], "the same, second coordinate [m]"),
    ("sites.linear_stiffness", [544.8], "G of each site [Pa s^alpha]"),
    ("sites.nonlinear_stiffness", [8.547], "Gn of each site [1]"),
    ("sites.fractional_order", [0.131], "alpha of each site [1]"),
    ("sites.inclusion_strain", [0.0], "strain at which each site's inclusion is met [1]"),
    ("sites.inclusion_stiffness", [0.0], "G of each site's inclusion [Pa s^alpha]; 0: none"),
    ("area", 3.1416e-4, "of the probe's flat face [m^2]"),
    ("thickness", 0.02, "of the tissue [m]"),
    ("height", 0.002, "of the probe above the surface at the start [m]"),
    ("surface", 0.0, "displacement that the axis shows at the surface [m]"),
    ("force.rate", 500.0, "of the force [Hz]"),
    ("force.noise", 1e-3, "standard deviation per sample [N]"),
    ("force.bias", 0.05, "of the force sensor [N]"),
    ("displacement.rate", 250.0, "of the position [Hz]"),
    ("displacement.noise", 1e-6, "standard deviation per sample [m]"),
    ("displacement.delay", 0.0, "delay of the stamps of the position [s]"),
    ("command.delay", 0.01, "from a command to the response of the axis [s]"),
    ("command.timeout", 0.2, "a velocity becomes 0 after this time without a new command [s]"),
    ("axis.lag", 0.015, "time constant of the axis's velocity [s]"),
    ("axis.max_speed", 0.05, "[m/s]"),
    ("axis.force_gain", 0.02, "velocity per error of a commanded force [m/(N s)]"),
    ("seed", 0, "of the noise"),
)
_QOS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
_STEP = 1e-3
_TICK = 0.002
#: After a longer pause than this [s] simulated time does not catch up with the clock.
_LONGEST_LAG = 30.0


class TissueSimulator(Node):
    """A simulated rig in step with the clock."""

    def __init__(self, **options: Any) -> None:
        super().__init__("tissue_simulator", **options)
        values = declared(self, PARAMETERS)
        self._rig = Rig(_rig_config(values))
        self._surface = float(values["surface"])
        self._delay_ns = round(values["displacement.delay"] * 1e9)
        self._every = {
            stream: _steps_per_sample(stream, float(values[f"{stream}.rate"]))
            for stream in ("force", "displacement")
        }
        self._force = self.create_publisher(WrenchStamped, "force", _QOS)
        self._displacement = self.create_publisher(PoseStamped, "displacement", _QOS)
        self.create_subscription(JointState, "command", self._on_command, _QOS)
        self._start_ns = self.get_clock().now().nanoseconds
        self._began = time.monotonic()
        self._steps = 0
        self._timer = self.create_timer(
            _TICK, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def _tick(self) -> None:
        due = int((time.monotonic() - self._began) / _STEP)
        late = (due - self._steps) * _STEP
        if late > _LONGEST_LAG:
            # Time goes on while a driver is stopped: its stamps jump ahead.
            skipped = due - self._steps
            self._start_ns += round(skipped * _STEP * 1e9)
            self._began += skipped * _STEP
            self.get_logger().warning(f"{late:.2f} s late: the simulation paused for that long")
            return
        while self._steps < due:
            self._rig.step()
            self._steps += 1
            self._publish(self._start_ns + round(self._steps * _STEP * 1e9))

    def _publish(self, stamp_ns: int) -> None:
        if self._steps % self._every["displacement"] == 0:
            pose = PoseStamped()
            pose.header.stamp = to_stamp(stamp_ns + self._delay_ns)
            pose.header.frame_id = "base"
            x, y, z = self._rig.measured_position()
            position = pose.pose.position
            position.x, position.y, position.z = float(x), float(y), float(z) + self._surface
            self._displacement.publish(pose)
        if self._steps % self._every["force"] == 0:
            wrench = WrenchStamped()
            wrench.header.stamp = to_stamp(stamp_ns)
            wrench.header.frame_id = "probe"
            wrench.wrench.force.z = float(self._rig.measured_force())
            self._force.publish(wrench)

    def _on_command(self, message: JointState) -> None:
        try:
            self._take(message)
        except InputError as error:
            self.get_logger().warning(f"command refused: {error}", throttle_duration_sec=1.0)

    def _take(self, message: JointState) -> None:
        filled = [
            (kind, values)
            for kind, values in (
                (Command.POSITION, message.position),
                (Command.VELOCITY, message.velocity),
                (Command.FORCE, message.effort),
            )
            if len(values)
        ]
        if len(filled) != 1:
            raise InputError(
                f"{len(filled)} of position, velocity and effort are filled; fill exactly one"
            )
        kind, values = filled[0]
        names = list(message.name) or ["z"]
        if len(names) != len(values):
            raise InputError(f"{len(names)} names and {len(values)} values; give as many of each")
        by_name = dict(zip(names, (float(v) for v in values), strict=True))
        lateral = {"x", "y"}.intersection(by_name)
        if not set(by_name) <= {"x", "y", "z"} or (lateral and kind is not Command.POSITION):
            raise InputError("joints are x, y and z; x and y take positions only")
        if lateral:
            x, y = self._rig.lateral_target
            self._rig.move_to(by_name.get("x", x), by_name.get("y", y))
        if "z" in by_name:
            offset = self._surface if kind is Command.POSITION else 0.0
            self._rig.command(kind, by_name["z"] - offset)


def _steps_per_sample(stream: str, rate: float) -> int:
    if not 0.0 < rate <= 1.0 / _STEP:
        raise InputError(f"{stream}.rate is {rate} Hz; it must be above 0 and at most 1000")
    return max(round(1.0 / (rate * _STEP)), 1)


def _rig_config(values: dict[str, Any]) -> RigConfig:
    sites = {name: list(value) for name, value in values.items() if name.startswith("sites.")}
    count = len(sites["sites.linear_stiffness"])
    for name, given in sites.items():
        if len(given) == 1:
            sites[name] = given * count
        elif len(given) != count:
            raise InputError(
                f"{name} has {len(given)} values; give one, or {count} as sites.linear_stiffness"
            )
    columns = [
        Column(
            FdenModel(g, gn, order),
            (Inclusion(strain, stiffness),) if stiffness > 0.0 else (),
            (x, y),
        )
        for x, y, g, gn, order, strain, stiffness in zip(
            *(sites[name] for name, _, _ in PARAMETERS if name.startswith("sites.")), strict=True
        )
    ]
    return RigConfig(
        columns=tuple(columns),
        area=values["area"],
        thickness=values["thickness"],
        step=_STEP,
        delay=values["command.delay"],
        servo_lag=values["axis.lag"],
        max_speed=values["axis.max_speed"],
        force_gain=values["axis.force_gain"],
        command_timeout=values["command.timeout"],
        height=values["height"],
        force_noise=values["force.noise"],
        force_bias=values["force.bias"],
        displacement_noise=values["displacement.noise"],
        seed=values["seed"],
    )


def main(arguments: list[str] | None = None) -> int:
    """Run the simulator until SIGINT or SIGTERM."""
    return run_node("tissue_simulator", TissueSimulator, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
