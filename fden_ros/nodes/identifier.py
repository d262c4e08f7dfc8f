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

"""The lifecycle node ``identifier``: the pipeline on live topics.

Subscribes to ``force``, ``displacement`` and, where it is measured, ``surface``; publishes
``~/estimate``, ``~/classification``, ``~/palpation`` and ``/diagnostics``; offers ``~/reset``,
``~/forget_rig``, ``~/tare`` and ``~/identify_tool``.
Everything that computes is in :mod:`fden_ros.core`.
"""

from __future__ import annotations

import copy
import gc
import struct
import threading
import traceback
from collections.abc import Callable
from typing import Any

from fden_msgs.srv import IdentifyTool
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.lifecycle.publisher import LifecyclePublisher
from rclpy.parameter import Parameter as RosParameter
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from fden_ros.configure.tool import ToolCollection
from fden_ros.core.outputs import Output, TissueState, placed, stale
from fden_ros.core.pipeline import Pipeline
from fden_ros.errors import InputError
from fden_ros.nodes.backlog import Backlog, Input, taker
from fden_ros.nodes.decisions import Decisions
from fden_ros.nodes.descriptors import descriptor_of
from fden_ros.nodes.diagnostics import Diagnostics
from fden_ros.nodes.input_problems import ListenedTo
from fden_ros.nodes.qos_overrides import OVERRIDABLE, check_qos_overrides
from fden_ros.nodes.running import run_node
from fden_ros.nodes.tool_identification import ToolIdentification
from fden_ros.parameters import (
    NODE_PARAMETERS,
    PARAMETERS,
    Parameter,
    Parameters,
    check,
    pipeline_config,
)
from fden_ros.parameters.files import identifier_values
from fden_ros.recording.reader import Topic
from fden_ros.ros.decoding import UnusualError, fast_handler
from fden_ros.ros.inputs import DAMAGED, INPUT_MESSAGES, Inputs, stream_of
from fden_ros.ros.status import type_name
from fden_ros.ros.topics import INPUT_QOS, OUTPUT_TOPICS, STATIC_QOS, OutputMessages

_STALE_CHECK_PERIOD = 0.05
#: A stale estimate is published again and again at this period [s].
_STALE_PERIOD = 1.0
_ACKNOWLEDGE_TIMEOUT = 1.0
_INACTIVE = "the node is not active: activate it first"
#: What ``~/identify_tool`` reads.
_TURNS_OF_THE_TOOL = ("force", "displacement")


class Identifier(LifecycleNode):
    """The pipeline on live topics."""

    def __init__(self, **node_options: Any) -> None:
        super().__init__("identifier", **node_options)
        self._declare_parameters()
        # Transitions may be triggered from any thread, in the middle of a callback.
        self._lock = threading.RLock()
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._pipeline: Pipeline | None = None
        self._inputs: Inputs | None = None
        self._active = False
        self._backlog = Backlog()
        self._last_state: TissueState | None = None
        self._last_input = self._steady.now()
        self._seen_pairs = 0
        self._seen_failures = 0
        self._told_stale: Time | None = None
        self._made: list[Callable[[], object]] = []
        self._listened_to: list[ListenedTo] = []
        self._publishers_made: dict[str, LifecyclePublisher] = {}
        self._tool = ToolIdentification(
            self._begin_collection, lambda line: self.get_logger().info(f"identify_tool: {line}")
        )
        self.add_on_set_parameters_callback(self._on_set_parameters)

    # Parameters

    def _declare_parameters(self) -> None:
        self._check_overrides()
        for parameter in PARAMETERS:
            self.declare_parameter(parameter.name, parameter.default, _descriptor(parameter))
        for parameter in NODE_PARAMETERS:
            # rclpy declares those of every node itself.
            if not self.has_parameter(parameter.name):
                self.declare_parameter(
                    parameter.name, parameter.default, _node_descriptor(parameter)
                )

    def _check_overrides(self) -> None:
        """Refuse a parameter that is unknown or not allowed; [0, 0, -1] is a list of numbers."""
        given = {
            name: _plain(override.value) for name, override in self._parameter_overrides.items()
        }
        values = check(identifier_values(given)).as_dict()
        values |= {p.name: p.check(given[p.name]) for p in NODE_PARAMETERS if p.name in given}
        for name in given:
            if name in values:
                self._parameter_overrides[name] = RosParameter(name, value=values[name])
        inputs = [self.resolve_topic_name(name) for name in INPUT_MESSAGES]
        outputs = [self.resolve_topic_name(f"~/{topic.name}") for topic in OUTPUT_TOPICS]
        check_qos_overrides(given, inputs, outputs)

    def _on_set_parameters(self, changes: list[RosParameter]) -> SetParametersResult:
        own = {parameter.name: parameter for parameter in PARAMETERS}
        changed = [change for change in changes if change.name in own]
        if changed and self._pipeline is not None:
            return SetParametersResult(
                successful=False,
                reason=f"parameter {changed[0].name} cannot change while the node is configured: "
                "deactivate and clean up first",
            )
        try:
            for change in changed:
                own[change.name].check(_plain(change.value))
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _parameters_now(self) -> Parameters:
        return check({p.name: _plain(self.get_parameter(p.name).value) for p in PARAMETERS})

    # Lifecycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Check the parameters and make publishers, services and the pipeline."""
        return self._transition("configure", self._configure, undo=self._release)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start afresh and listen."""
        activated: TransitionCallbackReturn = super().on_activate(state)
        if activated != TransitionCallbackReturn.SUCCESS:
            return activated
        return self._transition("activate", self._activate, undo=self._stop_listening)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Report the open contact and fall silent."""
        result = self._transition("deactivate", self._deactivate)
        super().on_deactivate(state)
        self.get_logger().info(f"deactivated: silent until it is activated{self._by('activate')}")
        return result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything that configuring made."""
        return self._transition("clean up", self._release)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Report the open contact and release everything."""
        return self._transition("shut down", self._deactivate_and_release)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything, so that the node can be configured again."""
        return self._transition("recover", self._deactivate_and_release)

    def _transition(
        self, name: str, action: Callable[[], None], undo: Callable[[], None] | None = None
    ) -> TransitionCallbackReturn:
        """Run a transition; log what goes wrong, because rclpy would swallow it."""
        try:
            with self._lock:
                action()
        except InputError as error:
            self.get_logger().error(f"cannot {name}: {error}")
        except Exception:
            self.get_logger().error(f"cannot {name}:\n{traceback.format_exc()}")
        else:
            return TransitionCallbackReturn.SUCCESS
        if undo is not None:
            with self._lock:
                undo()
        return TransitionCallbackReturn.FAILURE

    def _configure(self) -> None:
        parameters = self._parameters_now()
        self._pipeline = Pipeline(pipeline_config(parameters), self._publish)
        self._inputs = Inputs(parameters, self._pipeline)
        for topic in OUTPUT_TOPICS:
            publisher = self.create_lifecycle_publisher(
                topic.message_type,
                f"~/{topic.name}",
                topic.profile(parameters.estimate.period),
                qos_overriding_options=OVERRIDABLE,
            )
            self._publishers_made[topic.name] = publisher
            self._made.append(lambda p=publisher: self.destroy_publisher(p))  # type: ignore[misc]
        self._diagnostics = Diagnostics(self)
        self._made.append(self._diagnostics.destroy)
        for kind, name, callback in (
            (Trigger, "~/reset", self._on_reset),
            (Trigger, "~/forget_rig", self._on_forget_rig),
            (Trigger, "~/tare", self._on_tare),
            (IdentifyTool, "~/identify_tool", self._on_identify_tool),
        ):
            service = self.create_service(kind, name, callback)
            self._made.append(lambda s=service: self.destroy_service(s))  # type: ignore[misc]
        self.get_logger().info(f"configured: silent until it is activated{self._by('activate')}")

    def _activate(self) -> None:
        parameters = self._parameters_now()
        # Afresh: what was learned before an interruption is not trusted after it.
        self._pipeline = Pipeline(pipeline_config(parameters), self._publish)
        self._inputs = Inputs(parameters, self._pipeline)
        self._messages = OutputMessages()
        self._decisions = Decisions(self._pipeline.rejected)
        self._last_state = None
        self._told_stale = None
        self._seen_pairs = 0
        self._seen_failures = 0
        self._last_input = self._steady.now()
        self._active = True
        self._backlog = Backlog()
        self._diagnostics.start(
            self._pipeline,
            self._inputs,
            self._listened_to,
            self._backlog,
            lambda: self._tool.is_collecting,
        )
        for name in self._inputs.names:
            kind = getattr(parameters, name).message
            self._subscribe(INPUT_MESSAGES[name][kind], name, self._inputs)
        for name in self._inputs.transform_topics:
            self._subscribe(TFMessage, name, self._inputs)
        self._stale_timer = self.create_timer(
            _STALE_CHECK_PERIOD, self._check_stale, clock=self._steady
        )
        self._listening_timers = [self._stale_timer]
        # rclpy's first line takes a tenth of a second: here, not in the middle of a contact.
        *first, last = (one.subscription.topic_name for one in self._listened_to)
        self.get_logger().info(f"listening to {', '.join(first)} and {last}")
        for problem in self._pipeline.problems:
            self.get_logger().warning(problem)

    def _subscribe(self, kind: type, topic: str, inputs: Inputs) -> None:
        read = self._reader(kind, topic, inputs)
        source: Input | None = None

        def on_message(data: bytes) -> None:
            with self._lock:
                if self._active and source is not None:
                    self._backlog.add(source, data)

        subscription = self.create_subscription(
            kind,
            topic,
            on_message,
            copy.copy(STATIC_QOS if topic == "/tf_static" else INPUT_QOS),
            event_callbacks=SubscriptionEventCallbacks(
                # The diagnostics say it, with the override that mends it.
                incompatible_qos=lambda event: None,
                message_lost=lambda event: self._diagnostics.message_lost(topic, event),
            ),
            qos_overriding_options=OVERRIDABLE,
            # Decoding the few bytes that count is faster than making a message of them all.
            raw=True,
        )
        self._listened_to.append(ListenedTo(topic, subscription))
        source = Input(topic, taker(subscription), read)
        self._backlog.inputs.append(source)

    def _reader(self, kind: type, topic: str, inputs: Inputs) -> Callable[[bytes], None]:
        fast = fast_handler(topic, type_name(kind), inputs)

        def read(data: bytes) -> None:
            if self._tool.is_collecting and topic in _TURNS_OF_THE_TOOL:
                self._tool.add(topic, data)
                return
            try:
                if fast is not None:
                    fast(data)
                    return
            except (UnusualError, struct.error):
                pass
            try:
                message = deserialize_message(data, kind)
            except Exception:
                # rclpy raises RuntimeError, MemoryError and others for bytes that do not fit.
                inputs.reject(stream_of(topic), DAMAGED)
                return
            inputs.add(topic, message)

        return read

    def _stop_listening(self) -> None:
        self._active = False
        self._tool.end()
        self._backlog.clear()
        for one in self._listened_to:
            self.destroy_subscription(one.subscription)
        self._listened_to.clear()
        for timer in getattr(self, "_listening_timers", []):
            self.destroy_timer(timer)
        self._listening_timers = []
        self._diagnostics.stop()

    def _deactivate(self) -> None:
        if not self._active:
            return
        assert self._pipeline is not None
        self._pipeline.finish()
        self._log_failures()
        self._stop_listening()

    def _by(self, transition: str) -> str:
        return f" (ros2 lifecycle set {self.get_fully_qualified_name()} {transition})"

    def tell_unconfigured(self) -> None:
        """Log that nothing happens before somebody asks for it."""
        self.get_logger().info(
            "unconfigured: it neither listens nor publishes until it is configured"
            f"{self._by('configure')} and activated; -p autostart:=true does both at the start"
        )

    def _release(self) -> None:
        while self._made:
            self._made.pop()()
        self._publishers_made.clear()
        self._pipeline = None
        self._inputs = None

    def _deactivate_and_release(self) -> None:
        self._deactivate()
        self._release()

    # Outputs

    def _publish(self, output: Output) -> None:
        if isinstance(output, TissueState):
            self._last_state = output
        self._publish_messages(output)
        for decision in self._decisions.of(output):
            self.get_logger().debug(decision)

    def _publish_messages(self, output: Output) -> None:
        assert self._inputs is not None
        output = placed(output, self._inputs.displacement_frame)
        for topic, message in self._messages.of(output, self._inputs.force_frame):
            self._publishers_made[topic.name].publish(message)

    def _check_stale(self) -> None:
        with self._lock:
            if self._active and self._backlog.waiting:
                self._backlog.work()
            self._tool.check_time()
            self._log_failures()
            self._tell_stale()

    def _log_failures(self) -> None:
        pipeline = self._pipeline
        if pipeline is None or pipeline.failure_count == self._seen_failures:
            return
        new = pipeline.failure_count - self._seen_failures
        self._seen_failures = pipeline.failure_count
        for failure in list(pipeline.failures)[-new:]:
            self.get_logger().error(f"{failure}\n{failure.traceback}")

    def _tell_stale(self) -> None:
        pipeline = self._pipeline
        if not self._active or pipeline is None:
            return
        now = self._steady.now()
        if pipeline.pair_count != self._seen_pairs:
            self._seen_pairs = pipeline.pair_count
            self._last_input = now
            self._told_stale = None
            return
        waited = _seconds(self._last_input, now)
        if waited < self.get_parameter("stale_timeout").value:
            return
        if self._tool.is_collecting and self._told_stale is None:
            self.get_logger().debug("stale: the samples go to identify_tool")
        elif self._told_stale is None and self._last_state is not None:
            self.get_logger().warning(
                f"no usable pair of force and displacement for {waited:.2f} s: the estimate is "
                "stale"
            )
        elif self._told_stale is not None and _seconds(self._told_stale, now) < _STALE_PERIOD:
            return
        # Again and again, so that who comes late is told too.
        self._told_stale = now
        self._last_state = stale(self._last_state, pipeline.standing_flags)
        self._publish_messages(self._last_state)

    # Services

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            return self._reset(response)

    def _reset(self, response: Trigger.Response) -> Trigger.Response:
        if not self._active or self._pipeline is None or self._inputs is None:
            return _answer(response, _INACTIVE)
        problem = self._pipeline.reset()
        if problem is None:
            self._inputs.reset()
        done = "everything learned but of the rig was forgotten"
        self.get_logger().info(f"reset: {problem or done}")
        return _answer(response, problem)

    def _on_forget_rig(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        with self._lock:
            if not self._active or self._pipeline is None:
                return _answer(response, _INACTIVE)
            self._pipeline.forget_rig()
            self.get_logger().info("forget_rig: the next site begins with the parameters' rig")
            return _answer(response, None)

    def _on_tare(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            return self._tare(response)

    def _tare(self, response: Trigger.Response) -> Trigger.Response:
        if not self._active or self._pipeline is None:
            return _answer(response, _INACTIVE)
        problem = self._pipeline.tare()
        self.get_logger().info(f"tare: {problem or 'the present force is zero now'}")
        return _answer(response, problem)

    def _on_identify_tool(
        self, request: IdentifyTool.Request, response: IdentifyTool.Response
    ) -> IdentifyTool.Response:
        with self._lock:
            if not self._active:
                response.message = _INACTIVE
                return response
            return self._tool.answer(request.command, response)

    def _begin_collection(self) -> ToolCollection:
        """Return an empty collection; the pipeline waits, and begins afresh behind it."""
        assert self._pipeline is not None and self._inputs is not None
        parameters = self._parameters_now()
        if parameters.displacement.message not in INPUT_MESSAGES["displacement"]:
            raise InputError("identify_tool needs the turns of a pose: displacement.message: pose")
        kinds = {
            name: INPUT_MESSAGES[name][getattr(parameters, name).message]
            for name in _TURNS_OF_THE_TOOL
        }
        force, displacement = (
            Topic(self.resolve_topic_name(name), type_name(kind), 1)
            for name, kind in kinds.items()
        )
        needs_centre = self._inputs.takes_torque
        collection = ToolCollection(force, displacement, needs_centre=needs_centre)
        if self._pipeline.reset() is not None:
            raise InputError(
                "the probe is in contact: lift it, then ask again; where it is in the air all "
                "the same, deactivate and activate the node first"
            )
        self._inputs.reset()
        return collection

    # The end

    def finish(self) -> None:
        """Report the open contact and let subscribers have it, before the process ends."""
        with self._lock:
            if not self._active:
                return
            self._deactivate()
        # Lifecycle publishers hand on what rclpy's publishers can do.
        for publisher in self._publishers_made.values():
            publisher.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGE_TIMEOUT))


def _seconds(start: Time, end: Time) -> float:
    return float((end - start).nanoseconds * 1e-9)


def _answer(response: Trigger.Response, problem: str | None) -> Trigger.Response:
    response.success = problem is None
    response.message = problem or "done"
    return response


def _plain(value: Any) -> Any:
    """Return a parameter's value as plain Python: arrays come as array.array, none as None."""
    if value is None:
        return []
    return value if isinstance(value, (bool, int, float, str)) else list(value)


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    descriptor = _node_descriptor(parameter)
    descriptor.additional_constraints = "; ".join(
        filter(None, (parameter.constraint, "changes only while unconfigured"))
    )
    return descriptor


def _node_descriptor(parameter: Parameter) -> ParameterDescriptor:
    return descriptor_of(parameter, read_only=parameter.name == "autostart")


def main(arguments: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; report the open contact before leaving."""
    return run_node(
        "identifier",
        Identifier,
        arguments,
        start=_start,
        finish=Identifier.finish,
        needs_section=True,
    )


def _start(node: Identifier) -> bool:
    if not node.get_parameter("autostart").value:
        node.tell_unconfigured()
    elif not _autostart(node):
        return False
    # What is there by now stays: the collector need not look through it again and again.
    gc.collect()
    gc.freeze()
    return True


def _autostart(node: Identifier) -> bool:
    success = TransitionCallbackReturn.SUCCESS
    return node.trigger_configure() == success and node.trigger_activate() == success
