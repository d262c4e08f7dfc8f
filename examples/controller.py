# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Press with 0.15 N, quickly where the tissue is known and carefully where it is not."""

from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from fden_ros.nodes.running import run_node
from fden_ros.tissue_feed import TissueFeed

TARGET, BANDWIDTH, SAFE_STIFFNESS = 0.15, 8.0, 130.0  # N, rad/s, N/m


class Controller(Node):
    def __init__(self):
        super().__init__("controller")
        self.feed = TissueFeed(self, "/identifier", on_loss=self.say)
        self.air, self.force = [], 0.0
        self.create_subscription(WrenchStamped, "/force", self.on_force, 100)
        self.command = self.create_publisher(JointState, "/command", 10)
        self.create_timer(0.005, self.control)

    def on_force(self, message):
        if len(self.air) < 500:  # tare in the air first
            self.air.append(message.wrench.force.z)
        bias = sum(self.air) / len(self.air)
        self.force += 0.2 * (message.wrench.force.z - bias - self.force)

    def control(self):
        known = self.feed.stiffness(time_scale=1.0 / BANDWIDTH)  # None: do not rely on it
        is_present = known is not None and known.depth is None  # not a slope of another depth
        stiffness = known.value + known.sd if is_present else SAFE_STIFFNESS  # N/m
        velocity = BANDWIDTH * (TARGET - self.force) / stiffness if len(self.air) == 500 else 0.0
        self.command.publish(JointState(name=["z"], velocity=[max(-0.02, min(velocity, 0.02))]))

    def say(self, refusal):
        self.get_logger().info(str(refusal))


run_node("controller", Controller)  # until Ctrl-C
