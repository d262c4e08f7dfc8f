"""The lifecycle node ``identifier``: the pipeline on live topics.

Subscribes to ``force`` and ``displacement``; publishes ``~/estimate``, ``~/classification``,
``~/palpation`` and ``/diagnostics``; offers ``~/reset`` and ``~/tare``. Everything that computes
is in :mod:`fden_ros.core`.
"""

from __future__ import annotations

import copy
import difflib
import gc
import signal
import struct
import sys
import threading
import traceback
from collections.abc import Callable
from typing import Any

import rclpy
from fden_msgs.msg import ComplexModulus, PalpationSummary, TissueClassification, TissueEstimate
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.lifecycle.publisher import LifecyclePublisher
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from fden_ros.core.outputs import (
    Classification,
    ContactSummary,
    DynamicModulus,
    Output,
    TissueState,
    stale,
)
from fden_ros.core.pipeline import Pipeline
from fden_ros.errors import InputError
from fden_ros.nodes.backlog import Backlog, Input, taker
from fden_ros.parameters import NODE_PARAMETERS, PARAMETERS, Parameter, check, pipeline_config
from fden_ros.ros.decoding import UnusualError, fast_handler
from fden_ros.ros.markers import StiffnessMap
from fden_ros.ros.messages import (
    DISPLACEMENT_MESSAGES,
    FORCE_MESSAGES,
    Inputs,
    classification_message,
    estimate_message,
    modulus_message,
    summary_message,
)
from fden_ros.ros.status import Diagnostics, type_name

_DAMAGED = "damaged"

#: Deep: one lost sample is lost to the fractional integral for good.
INPUT_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=2000,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
#: Deadline and lease are offered, so that those who ask for them are told when the node freezes.
ESTIMATE_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    deadline=Duration(seconds=0.05),
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=Duration(seconds=0.2),
)
#: What comes late still learns of the last classification and of every palpation of the session's
#: last hundred.
LATCHED_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
CLASSIFICATION_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
_OVERRIDABLE = QoSOverridingOptions(
    (
        QoSPolicyKind.HISTORY,
        QoSPolicyKind.DEPTH,
        QoSPolicyKind.RELIABILITY,
        QoSPolicyKind.DURABILITY,
    )
)
_STALE_CHECK_PERIOD = 0.05
_ACKNOWLEDGE_TIMEOUT = 1.0
#: How soon a signal is seen when nothing else happens [s].
_SPIN_TIMEOUT = 0.1


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
        self._is_stale = False
        self._made: list[Callable[[], object]] = []
        self._subscriptions_made: list[Subscription] = []
        self._publishers_made: dict[type, LifecyclePublisher] = {}
        self.add_on_set_parameters_callback(self._on_set_parameters)

    # Parameters

    def _declare_parameters(self) -> None:
        for parameter in PARAMETERS:
            self.declare_parameter(parameter.name, parameter.default, _descriptor(parameter))
        self.declare_parameter(
            "autostart",
            False,
            ParameterDescriptor(
                description="Configure and activate at start-up, without a lifecycle manager [1]",
                read_only=True,
            ),
        )
        self.declare_parameter(
            "stale_timeout",
            0.5,
            ParameterDescriptor(
                description="Time without a usable pair of samples after which the estimate is "
                "stale [s]",
                floating_point_range=[FloatingPointRange(from_value=0.01, to_value=60.0)],
            ),
        )
        self._warn_of_unknown_parameters()

    def _warn_of_unknown_parameters(self) -> None:
        known = {parameter.name for parameter in PARAMETERS} | NODE_PARAMETERS
        for name in self._parameter_overrides:
            if name in known or name.split(".")[0] in NODE_PARAMETERS:
                continue
            near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
            hint = f"; did you mean {near[0]}?" if near else ""
            self.get_logger().warning(f"there is no parameter {name}: it is ignored{hint}")

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

    def _parameter_values(self) -> dict[str, Any]:
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
        values = self._parameter_values()
        self._pipeline = Pipeline(pipeline_config(values), self._publish)
        self._inputs = Inputs(values, self._pipeline)
        for kind, topic, qos in (
            (TissueEstimate, "~/estimate", ESTIMATE_QOS),
            (TissueClassification, "~/classification", CLASSIFICATION_QOS),
            (PalpationSummary, "~/palpation", LATCHED_QOS),
            (ComplexModulus, "~/complex_modulus", ESTIMATE_QOS),
            (MarkerArray, "~/markers", CLASSIFICATION_QOS),
            (PointCloud2, "~/stiffness_map", CLASSIFICATION_QOS),
        ):
            publisher = self.create_lifecycle_publisher(
                # rclpy writes the overrides into the profile that it is given.
                kind,
                topic,
                copy.copy(qos),
                qos_overriding_options=_OVERRIDABLE,
            )
            self._publishers_made[kind] = publisher
            self._made.append(lambda p=publisher: self.destroy_publisher(p))  # type: ignore[misc]
        self._diagnostics = Diagnostics(self)
        self._made.append(self._diagnostics.destroy)
        for name, callback in (("~/reset", self._on_reset), ("~/tare", self._on_tare)):
            service = self.create_service(Trigger, name, callback)
            self._made.append(lambda s=service: self.destroy_service(s))  # type: ignore[misc]

    def _activate(self) -> None:
        values = self._parameter_values()
        # Afresh: what was learned before an interruption is not trusted after it.
        self._pipeline = Pipeline(pipeline_config(values), self._publish)
        self._inputs = Inputs(values, self._pipeline)
        self._map = StiffnessMap()
        self._last_state = None
        self._is_stale = False
        self._seen_pairs = 0
        self._seen_failures = 0
        self._last_input = self._steady.now()
        self._active = True
        self._backlog = Backlog()
        self._diagnostics.start(self._pipeline, self._subscriptions_made, self._backlog)
        self._subscribe(FORCE_MESSAGES[values["force.message"]], "force", self._inputs)
        self._subscribe(
            DISPLACEMENT_MESSAGES[values["displacement.message"]], "displacement", self._inputs
        )
        self._stale_timer = self.create_timer(
            _STALE_CHECK_PERIOD, self._check_stale, clock=self._steady
        )
        self._listening_timers = [self._stale_timer]
        # rclpy's first line takes a tenth of a second: here, not in the middle of a contact.
        topics = " and ".join(one.topic_name for one in self._subscriptions_made)
        self.get_logger().info(f"listening to {topics}")

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
            copy.copy(INPUT_QOS),
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=lambda event: self._diagnostics.incompatible_qos(topic, event),
                message_lost=lambda event: self._diagnostics.message_lost(topic, event),
            ),
            qos_overriding_options=_OVERRIDABLE,
            # Decoding the few bytes that count is faster than making a message of them all.
            raw=True,
        )
        self._subscriptions_made.append(subscription)
        source = Input(topic, taker(subscription), read)
        self._backlog.inputs.append(source)

    def _reader(self, kind: type, topic: str, inputs: Inputs) -> Callable[[bytes], None]:
        add = inputs.add_force if topic == "force" else inputs.add_displacement
        fast = fast_handler(topic, type_name(kind), inputs)
        assert fast is not None

        def read(data: bytes) -> None:
            try:
                fast(data)
                return
            except (UnusualError, struct.error):
                pass
            try:
                message = deserialize_message(data, kind)
            except Exception:
                # rclpy raises RuntimeError, MemoryError and others for bytes that do not fit.
                inputs.reject(topic, _DAMAGED)
                return
            add(message)

        return read

    def _stop_listening(self) -> None:
        self._active = False
        self._backlog.clear()
        for subscription in self._subscriptions_made:
            self.destroy_subscription(subscription)
        self._subscriptions_made.clear()
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
        assert self._inputs is not None
        frame = self._inputs.force_frame
        if isinstance(output, TissueState):
            self._last_state = output
            self._publishers_made[TissueEstimate].publish(estimate_message(output, frame))
        elif isinstance(output, Classification):
            self._publishers_made[TissueClassification].publish(
                classification_message(output, frame)
            )
        elif isinstance(output, DynamicModulus):
            self._publishers_made[ComplexModulus].publish(modulus_message(output, frame))
        else:
            self._publishers_made[PalpationSummary].publish(summary_message(output, frame))
            self._publish_map(output)

    def _publish_map(self, summary: ContactSummary) -> None:
        assert self._inputs is not None
        frame = self._inputs.displacement_frame
        if self._map.add(summary):
            self._publishers_made[MarkerArray].publish(self._map.markers(frame))
            self._publishers_made[PointCloud2].publish(self._map.cloud(frame))

    def _check_stale(self) -> None:
        with self._lock:
            if self._active and self._backlog.waiting:
                self._backlog.work()
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
            self._is_stale = False
            return
        timeout = self.get_parameter("stale_timeout").value
        waited = (now - self._last_input).nanoseconds * 1e-9
        if waited < timeout or self._is_stale or self._last_state is None:
            return
        self._is_stale = True
        self.get_logger().warning(
            f"no usable pair of force and displacement for {waited:.2f} s: the estimate is stale"
        )
        assert self._inputs is not None
        self._publishers_made[TissueEstimate].publish(
            estimate_message(stale(self._last_state), self._inputs.force_frame)
        )

    # Services

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            return self._reset(response)

    def _reset(self, response: Trigger.Response) -> Trigger.Response:
        if not self._active or self._pipeline is None or self._inputs is None:
            return _answer(response, "the node is not active: activate it first")
        self._pipeline.reset()
        self._inputs.reset()
        self.get_logger().info("reset: everything learned was forgotten")
        return _answer(response, None)

    def _on_tare(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            return self._tare(response)

    def _tare(self, response: Trigger.Response) -> Trigger.Response:
        if not self._active or self._pipeline is None:
            return _answer(response, "the node is not active: activate it first")
        problem = self._pipeline.tare()
        self.get_logger().info(f"tare: {problem or 'the present force is zero now'}")
        return _answer(response, problem)

    # The end

    def finish(self) -> None:
        """Report the open contact and let subscribers have it, before the process ends."""
        with self._lock:
            if not self._active:
                return
            self._deactivate()
        # Lifecycle publishers hand on what rclpy's publishers can do.
        for publisher in self._publishers_made.values():
            publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=_ACKNOWLEDGE_TIMEOUT))


def _answer(response: Trigger.Response, problem: str | None) -> Trigger.Response:
    response.success = problem is None
    response.message = problem or "done"
    return response


def _plain(value: Any) -> Any:
    """Return a parameter's value as plain Python: arrays come as array.array."""
    return value if isinstance(value, (bool, int, float, str)) else list(value)


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=f"{parameter.description} [{parameter.unit}]",
        additional_constraints="; ".join(
            filter(None, (parameter.constraint, "changes only while unconfigured"))
        ),
    )
    is_number = isinstance(parameter.default, (int, float)) and not isinstance(
        parameter.default, bool
    )
    if is_number and isinstance(parameter.default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=parameter.minimum, to_value=parameter.maximum)
        ]
    elif is_number:
        descriptor.integer_range = [
            IntegerRange(
                from_value=int(parameter.minimum), to_value=int(parameter.maximum), step=1
            )
        ]
    return descriptor


def make_executor(context: Context | None = None) -> Executor:
    """Return an EventsExecutor, or the default one where rclpy has none (before 7.1.4)."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    executor: Executor = EventsExecutor(context=context)
    return executor


def spin(executor: Executor, stop: Callable[[], bool]) -> None:
    """Run callbacks until `stop`.

    Event by event with a timeout: signals then reach Python, and ``EventsExecutor.spin`` of the
    manylinux wheels, which polls without pause and never returns, is not needed.
    """
    while not stop():
        executor.spin_once(timeout_sec=_SPIN_TIMEOUT)


def main(arguments: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; report the open contact before leaving."""
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda caught, _: stopped.append(caught))
    try:
        node = Identifier()
    except (InvalidParameterTypeException, ParameterException) as error:
        print(f"identifier: {' '.join(str(error).split())}", file=sys.stderr)
        rclpy.try_shutdown()
        return 1
    executor = make_executor()
    executor.add_node(node)
    try:
        if node.get_parameter("autostart").value and not _autostart(node):
            return 1
        # What is there by now stays: the collector need not look through it again and again.
        gc.collect()
        gc.freeze()
        spin(executor, lambda: bool(stopped))
        return 0
    finally:
        node.finish()
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


def _autostart(node: Identifier) -> bool:
    success = TransitionCallbackReturn.SUCCESS
    return node.trigger_configure() == success and node.trigger_activate() == success


if __name__ == "__main__":
    sys.exit(main())
