# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Press with 0.15 N, quickly where the tissue is known and carefully where it is not."""

import rclpy
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

from fden_ros.tissue_feed import TissueFeed

TARGET, BANDWIDTH, SAFE_STIFFNESS = 0.15, 8.0, 130.0  # N, rad/s, N/m


class Controller(rclpy.node.Node):
    def __init__(self):
        super().__init__("controller")
        self.feed = TissueFeed(self, "/identifier", on_loss=self.tell, on_change=self.tell)
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
        stiffness = sum(known) if known else SAFE_STIFFNESS  # value + deviation, N/m
        velocity = BANDWIDTH * (TARGET - self.force) / stiffness if len(self.air) == 500 else 0.0
        self.command.publish(JointState(name=["z"], velocity=[max(-0.02, min(velocity, 0.02))]))

    def tell(self, news):
        self.get_logger().info(f"{self.feed.stiffness() or news}")


rclpy.init()
rclpy.spin(Controller())
