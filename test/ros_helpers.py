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

"""Real nodes over real DDS: start the identifier in its own process, listen, publish, wait."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from fden_msgs.msg import ComplexModulus, PalpationSummary, TissueClassification, TissueEstimate
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from fden_ros.ros.messages import to_stamp

NAME = "/identifier"
RELIABLE = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(
    depth=1000,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
#: Nothing may be lost where every number is compared.
LOSSLESS = {
    "qos_overrides./force.subscription.reliability": "reliable",
    "qos_overrides./force.subscription.depth": 20000,
    "qos_overrides./displacement.subscription.reliability": "reliable",
    "qos_overrides./displacement.subscription.depth": 20000,
    "qos_overrides./identifier/estimate.publisher.depth": 10000,
    "qos_overrides./identifier/classification.publisher.depth": 1000,
}
TIMEOUT = 40.0


def wait_for(condition: Callable[[], Any], what: str, timeout: float = TIMEOUT) -> Any:
    """Wait until `condition` holds; return its value."""
    end = time.monotonic() + timeout
    while not (value := condition()):
        assert time.monotonic() < end, f"waited {timeout:g} s in vain for {what}"
        time.sleep(0.01)
    return value


class Bench:
    """The test's own node: hears the identifier, publishes its inputs, calls its services."""

    def __init__(self, name: str = NAME) -> None:
        self.name = name
        self.estimates: list[TissueEstimate] = []
        self.classifications: list[TissueClassification] = []
        self.summaries: list[PalpationSummary] = []
        self.moduli: list[ComplexModulus] = []
        self.diagnostics: list[DiagnosticArray] = []

    def __enter__(self) -> Bench:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("bench", context=self.context)
        for kind, topic, heard, qos in (
            (TissueEstimate, f"{self.name}/estimate", self.estimates, RELIABLE),
            (TissueClassification, f"{self.name}/classification", self.classifications, LATCHED),
            (PalpationSummary, f"{self.name}/palpation", self.summaries, LATCHED),
            (ComplexModulus, f"{self.name}/complex_modulus", self.moduli, RELIABLE),
            (DiagnosticArray, "/diagnostics", self.diagnostics, RELIABLE),
        ):
            self.node.create_subscription(kind, topic, heard.append, qos)
        self.force = self.node.create_publisher(WrenchStamped, "/force", RELIABLE)
        self.displacement = self.node.create_publisher(JointState, "/displacement", RELIABLE)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        return self

    def __exit__(self, *_: object) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def wait_for(self, condition: Callable[[], Any], what: str, timeout: float = TIMEOUT) -> Any:
        """Spin until `condition` holds; return its value."""
        end = time.monotonic() + timeout
        while not (value := condition()):
            assert time.monotonic() < end, f"waited {timeout:g} s in vain for {what}"
            self.executor.spin_once(timeout_sec=0.02)
        return value

    def spin_for(self, seconds: float) -> None:
        """Spin for so long, to show that nothing comes."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)

    def call(self, kind: Any, service: str, request: Any = None) -> Any:
        """Call a service of the identifier and return its response."""
        client = self.node.create_client(kind, f"{self.name}/{service}")
        try:
            self.wait_for(client.service_is_ready, f"service {service}")
            future = client.call_async(request or kind.Request())
            self.wait_for(future.done, f"an answer of {service}")
            return future.result()
        finally:
            self.node.destroy_client(client)

    def change_state(self, transition: int) -> bool:
        """Run a lifecycle transition; return whether it succeeded."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.call(ChangeState, "change_state", request).success)

    def state(self) -> str:
        """Return the lifecycle state's label."""
        return str(self.call(GetState, "get_state").current_state.label)

    def wait_until_connected(self) -> None:
        """Wait until the identifier's publishers know this node's subscriptions."""
        topics = ("estimate", "classification", "palpation")
        self.wait_for(
            lambda: all(self.node.count_publishers(f"{self.name}/{topic}") for topic in topics),
            "the identifier's publishers",
        )
        # The other side's match is reported nowhere.
        self.spin_for(0.5)

    def wait_until_heard(self) -> None:
        """Wait until the identifier subscribes to the inputs."""
        self.wait_for(
            lambda: (
                self.force.get_subscription_count() and self.displacement.get_subscription_count()
            ),
            "the identifier's subscriptions",
        )
        self.wait_until_connected()

    def publish(self, stamp_ns: int, force: float, displacement: float, frame: str = "s") -> None:
        """Publish one sample of each stream."""
        wrench = WrenchStamped()
        wrench.header.stamp, wrench.header.frame_id = to_stamp(stamp_ns), frame
        wrench.wrench.force.z = force
        joint = JointState(name=["probe"], position=[displacement])
        joint.header.stamp = wrench.header.stamp
        self.displacement.publish(joint)
        self.force.publish(wrench)

    def diagnostic(self) -> dict[str, str]:
        """Return the newest diagnostics as a dictionary, its words under ``message``."""
        if not self.diagnostics:
            return {}
        status = self.diagnostics[-1].status[0]
        return {"message": status.message, **{v.key: v.value for v in status.values}}

    def diagnostic_level(self) -> bytes:
        """Return the level of the newest diagnostics."""
        level: bytes = self.diagnostics[-1].status[0].level
        return level


#: Of a probe, where no file states one.
PUNCH = {"geometry.area": 1e-4, "geometry.thickness": 0.02}


@contextlib.contextmanager
def identifier(
    parameters: Mapping[str, Any] | None = None,
    *,
    file: Path | None = None,
    remap: Mapping[str, str] | None = None,
    first: str = "",
) -> Iterator[subprocess.Popen[str]]:
    """Run the identifier in a process of its own, `first` before it; stop it at the end."""
    command = [sys.executable, "-m", "fden_ros.nodes.programs", "identifier", "--ros-args"]
    if first:
        program = f"{first}\nfrom fden_ros.nodes.identifier import main\nraise SystemExit(main())"
        command[1:4] = ["-c", program]
    if file is not None:
        command += ["--params-file", str(file)]
    given = {**(PUNCH if file is None else {}), **(parameters or {})}
    for name, value in given.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        command += ["-p", f"{name}:={text}"]
    for old, new in (remap or {}).items():
        command += ["-r", f"{old}:={new}"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            process.wait(15.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise
        finally:
            assert process.stdout is not None
            process.output = process.stdout.read()  # type: ignore[attr-defined]
            # Shown by pytest if the test fails.
            print(process.output)  # type: ignore[attr-defined]
