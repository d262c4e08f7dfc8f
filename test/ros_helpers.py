# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A real identifier over real DDS, and the node that tests it."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from fden_msgs.msg import ComplexModulus, PalpationSummary, TissueClassification, TissueEstimate
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from live_helpers import LIMIT, Ears, command_of, process_of
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from fden_ros.core.outputs import (
    Classification,
    ContactSummary,
    DynamicModulus,
    Output,
    TissueState,
)
from fden_ros.nodes import player
from fden_ros.offline.replay import Replay, replay
from fden_ros.parameters import read_parameter_file
from fden_ros.recording.message_types import serialize
from fden_ros.recording.reader import BagReader
from fden_ros.ros.messages import to_stamp
from fden_ros.ros.topics import OutputMessages
from simulation.bag import PARAMETER_FILE
from simulation.simulate import START_NS

NAME = "/identifier"
RELIABLE = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(
    depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
#: No sample comes too late for its partner, whichever stream a busy machine holds up.
PATIENT = {"synchronize.max_wait": 60.0}
#: Nothing may be lost where every number is compared.
LOSSLESS: dict[str, Any] = {
    f"qos_overrides./{topic}.subscription.reliability": "reliable"
    for topic in ("force", "displacement", "tf")
}


class Bench(Ears):
    """The test's own node: hears the identifier, publishes its inputs, calls its services."""

    node_name = "bench"

    def __init__(self, name: str = NAME) -> None:
        self.name = name
        self._clients: dict[str, Any] = {}

    def call(self, kind: Any, service: str, request: Any = None) -> Any:
        """Call a service of the identifier and return its response."""
        client = self._clients.get(service)
        if client is None:
            client = self._clients[service] = self._client(kind, service)
            # The node loses an answer to a client that it has not found yet, and finds them in
            # order: once it answers the newest, it knows them all.
            self.state()
        self.wait_for(client.service_is_ready, f"service {service}")
        future = client.call_async(request or kind.Request())
        self.wait_for(future.done, f"an answer of {service}")
        return future.result()

    def _client(self, kind: Any, service: str) -> Any:
        return self.node.create_client(kind, f"{self.name}/{service}")

    def change_state(self, transition: int) -> bool:
        """Run a lifecycle transition; return whether it succeeded."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.call(ChangeState, "change_state", request).success)

    def set_parameters(self, values: Mapping[str, Any]) -> list[SetParametersResult]:
        """Set parameters of the identifier, and return what it says of each."""
        messages = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        request = SetParameters.Request(parameters=messages)
        return list(self.call(SetParameters, "set_parameters", request).results)

    def state(self) -> str:
        """Return the lifecycle state's label."""
        client = self._client(GetState, "get_state")
        asked: list[Any] = []
        again = 0.0

        def answers() -> list[Any]:
            nonlocal again
            # A node that has ended is still known for a while, and does not answer.
            if time.monotonic() > again and client.service_is_ready():
                asked.append(client.call_async(GetState.Request()))
                again = time.monotonic() + 2.0
            return [future.result() for future in asked if future.done()]

        try:
            answer = self.wait_for(answers, f"an answer of {self.name}")[0]
            return str(answer.current_state.label)
        finally:
            self.node.destroy_client(client)

    def __enter__(self) -> Bench:
        super().__enter__()
        name = self.name
        self.estimates: list[TissueEstimate] = []
        self.classifications: list[TissueClassification] = []
        self.summaries: list[PalpationSummary] = []
        self.moduli: list[ComplexModulus] = []
        self.diagnostics: list[DiagnosticArray] = []
        for kind, topic, heard, qos in (
            (TissueClassification, f"{name}/classification", self.classifications, LATCHED),
            (PalpationSummary, f"{name}/palpation", self.summaries, LATCHED),
            (ComplexModulus, f"{name}/complex_modulus", self.moduli, RELIABLE),
            (DiagnosticArray, "/diagnostics", self.diagnostics, RELIABLE),
            # The last: who sends estimates here has found the others too.
            (TissueEstimate, f"{name}/estimate", self.estimates, RELIABLE),
        ):
            self.node.create_subscription(kind, topic, heard.append, qos)
        self.force = self.node.create_publisher(WrenchStamped, "/force", RELIABLE)
        self.displacement = self.node.create_publisher(JointState, "/displacement", RELIABLE)
        return self

    def wait_until_connected(self) -> None:
        """Wait until an active identifier's publishers know this node's subscriptions."""
        self.wait_for(lambda: self.estimates, "an estimate before the first sample")

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


#: Between two samples that a test publishes.
STEP_NS = 4_000_000


class Live:
    """One node for many rows: time goes on, and so do the samples."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.now = START_NS
        self.rng = np.random.default_rng(1)

    def stream(self, seconds: float, depth: Callable[[float], float] = lambda t: 0.0) -> None:
        """Publish good samples, of the air or of a press to `depth` [m]."""
        count = round(seconds * 1e9 / STEP_NS)
        for k in range(count):
            self.now += STEP_NS
            d = depth(k * STEP_NS * 1e-9)
            force = 60.0 * max(d, 0.0) + 1e-4 * self.rng.standard_normal()
            self.bench.publish(self.now, force, d + 1e-6 * self.rng.standard_normal())
        self.bench.spin_for(0.0)

    def recovers(self) -> None:
        """Within a second of good data, by their stamps, the status is true."""
        begin = self.now
        self.stream(1.2)
        self.bench.wait_for(
            lambda: any(
                stamp(m) > begin + 1_000_000_000 and m.status == TissueEstimate.STATUS_NO_CONTACT
                for m in self.bench.estimates[-20:]
            ),
            "a true status a second after good data",
        )

    def count(self, name: str) -> int:
        return int(self.bench.diagnostic().get(f"rejected.{name}", "0"))

    def wait_for_count(self, name: str, least: int) -> None:
        self.bench.wait_for(lambda: self.count(name) >= least, f"{least} times {name}")

    def wait_for_words(self, words: str) -> None:
        def said() -> bool:
            self.stream(0.02)
            return words in self.bench.diagnostic().get("message", "")

        self.bench.wait_for(said, f"the words {words}")


def stamp(message: Any) -> int:
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def play(bag: Path, rate: float = 8.0, **options: Any) -> None:
    """Play a bag to who listens, until everything is received."""
    player.play(BagReader(bag), rate, wait=LIMIT, **options)


def replayed(
    bag: Path, kinds: Sequence[type], **options: Any
) -> tuple[Replay, dict[type, list[bytes]]]:
    """Replay a bag; return the result, and by kind the messages of its outputs in their order."""
    messages: dict[type, list[bytes]] = {kind: [] for kind in kinds}

    def keep(output: Output, frame: str) -> None:
        # The last place of a path ends with the node, when nobody listens any more.
        if type(output) in messages and getattr(output, "complete", True):
            _, message = next(OutputMessages().of(output, frame))
            messages[type(output)].append(serialize(message))

    parameters = read_parameter_file(bag / PARAMETER_FILE)
    return replay(bag, parameters, on_output=keep, **options), messages


def assert_live_equals_replay(bag: Path, kinds: Sequence[type], **options: Any) -> Replay:
    """Play a bag, with `options` of the player, to the node; it says what a replay gives."""
    result, expected = replayed(bag, kinds)
    with Bench() as bench, active(PATIENT, file=bag / PARAMETER_FILE):
        bench.wait_until_connected()
        play(bag, **options)
        heard = {
            TissueState: bench.estimates,
            Classification: bench.classifications,
            ContactSummary: bench.summaries,
            DynamicModulus: bench.moduli,
        }
        for kind, messages in expected.items():
            assert messages
            live = bench.wait_for(
                functools.partial(_as_many, heard[kind], len(messages)), f"every {kind.__name__}"
            )
            if kind is TissueState:
                for message in live:
                    assert message.lag >= 0.0
                    message.lag = 0.0  # as in a replay, which has no clock
            assert [serialize(message) for message in live] == messages, kind
        with Bench() as late:
            # Summaries and the label are latched.
            contacts = len(bench.summaries)
            late.wait_for(lambda: len(late.summaries) == contacts, "the latched summaries")
            if Classification in kinds:
                late.wait_for(lambda: late.classifications, "the latched label")
                assert serialize(late.classifications[-1]) == expected[Classification][-1]
    return result


def _as_many(messages: list[Any], count: int) -> list[Any] | None:
    """Those that hold a number, once there are as many."""
    stale = TissueEstimate.STATUS_STALE
    found = [m for m in messages if getattr(m, "status", None) != stale]
    return found if len(found) >= count else None


#: Of a probe, where no file states one.
PUNCH = {"geometry.area": 1e-4, "geometry.thickness": 0.02}


@contextlib.contextmanager
def active(
    parameters: Mapping[str, Any] | None = None, *, file: Path | None = None
) -> Iterator[Any]:
    """Run an identifier that is active at once and loses no sample, over the values of a file.

    Its first word comes early: who waits until it is heard does not wait long. What a busy machine
    delays is not what is tested, but where that is said.
    """
    own = {"autostart": True, "source_timeout": 0.1, "lag_deadline": 60.0, **LOSSLESS}
    with identifier({**own, **(parameters or {})}, file=file) as process:
        yield process


@contextlib.contextmanager
def identifier(
    parameters: Mapping[str, Any] | None = None,
    *,
    file: Path | None = None,
    remap: Mapping[str, str] | None = None,
    first: str = "",
) -> Iterator[Any]:
    """Run an identifier in a process of its own, `first` before it; stop it at the end."""
    given = {**(PUNCH if file is None else {}), **(parameters or {})}
    command = command_of("identifier", given, file=file, remap=remap)
    if first:
        program = f"{first}\nfrom fden_ros.nodes.identifier import main\nraise SystemExit(main())"
        command[1:4] = ["-c", program]
    with process_of(command) as process:
        yield process
