# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The lifecycle node ``identifier``: the pipeline on live topics.

Subscribes to ``force`` and ``displacement``; publishes
``~/estimate``, ``~/classification``, ``~/palpation`` and ``/diagnostics``; offers ``~/reset``
and ``~/tare``.
All computation is in :mod:`fden_ros.core`; the state of an active node is in
:mod:`fden_ros.nodes.session`.
"""

from __future__ import annotations

import functools
import gc
import os
import threading
import traceback
from collections.abc import Callable, Iterator
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.lifecycle.publisher import LifecyclePublisher
from rclpy.parameter import Parameter as RosParameter
from rclpy.service import Service
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from fden_ros.core.pipeline import Pipeline
from fden_ros.errors import InputError
from fden_ros.nodes.backlog import Taken
from fden_ros.nodes.diagnostics import Diagnostics
from fden_ros.nodes.running import run_node
from fden_ros.nodes.session import Session
from fden_ros.parameters import (
    NODE_PARAMETERS,
    PARAMETERS,
    Parameter,
    Parameters,
    check,
    identifier_values,
    pipeline_config,
)
from fden_ros.ros.topics import OUTPUT_TOPICS

#: Next to busy processes a node of their priority gets half a core: a contact at 1 kHz needs that.
_NICE = -10
_ACKNOWLEDGE_TIMEOUT = 1.0
_INACTIVE = "the node is not active: activate it first"


class Identifier(LifecycleNode):
    """The pipeline on live topics."""

    def __init__(self, **node_options: Any) -> None:
        super().__init__("identifier", **node_options)
        self._declare_parameters()
        # Transitions may be triggered from any thread, in the middle of a callback.
        self._lock = threading.RLock()
        self._session: Session | None = None
        self._is_configured = False
        self._publishers_made: dict[str, LifecyclePublisher] = {}
        self._services_made: list[Service] = []
        self._diagnostics = Diagnostics(self, self._lock)
        self.add_on_set_parameters_callback(self._on_set_parameters)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Those that executors wait for: not the inputs, which a timer takes."""
        return (s for s in super().subscriptions if not isinstance(s.callback_group, Taken))

    # Parameters

    def _declare_parameters(self) -> None:
        """Declare; refuse an unknown override or one that is not allowed, [0, 0, -1] is a list."""
        given = {
            name: _plain(override.value) for name, override in self._parameter_overrides.items()
        }
        values = check(identifier_values(given)).as_dict()
        values |= {p.name: p.check(given[p.name]) for p in NODE_PARAMETERS if p.name in given}
        for name in given:
            if name in values:
                self._parameter_overrides[name] = RosParameter(name, value=values[name])
        for parameter in PARAMETERS:
            constraints = parameter.constraint, "changes only while unconfigured"
            descriptor = _descriptor(parameter, *constraints)
            self.declare_parameter(parameter.name, parameter.default, descriptor)
        for parameter in NODE_PARAMETERS:
            self.declare_parameter(parameter.name, parameter.default, _descriptor(parameter))

    def _on_set_parameters(self, changes: list[RosParameter]) -> SetParametersResult:
        own = {parameter.name: parameter for parameter in PARAMETERS}
        changed = [change for change in changes if change.name in own]
        try:
            if changed and self._is_configured:
                raise InputError(
                    f"parameter {changed[0].name} cannot change while the node is configured: "
                    "deactivate and clean up first"
                )
            for change in changed:
                own[change.name].check(_plain(change.value))
        except InputError as error:
            self._diagnostics.refusal = f"set parameter: {error}"
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _parameters_now(self) -> Parameters:
        return check({p.name: _plain(self.get_parameter(p.name).value) for p in PARAMETERS})

    # Lifecycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Check the parameters and make publishers and services."""
        return self._transition("configure", self._configure, undo=self._release)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start afresh and listen."""
        activated: TransitionCallbackReturn = super().on_activate(state)
        if activated != TransitionCallbackReturn.SUCCESS:
            return activated
        return self._transition("activate", self._activate, undo=self._deactivate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Report the open contact and stop publishing."""
        result = self._transition("deactivate", self._deactivate)
        super().on_deactivate(state)
        self.get_logger().info(f"deactivated: silent until it is activated{self._by('activate')}")
        return result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything that was configured."""
        return self._transition("clean up", self._release)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Report the open contact and release everything."""
        return self._transition("shut down", self._release)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything, so that the node can be configured again."""
        return self._transition("recover", self._release)

    def _transition(
        self, name: str, action: Callable[[], None], undo: Callable[[], None] = lambda: None
    ) -> TransitionCallbackReturn:
        """Run a transition; report what goes wrong, because rclpy would swallow it."""
        with self._lock:
            try:
                action()
            except Exception as error:
                known = isinstance(error, InputError)
                words = f"cannot {name}: {error}" if known else f"cannot {name}: {error!r}"
                self._diagnostics.refusal, self._diagnostics.is_stuck = words, True
                self.get_logger().error(
                    words if known else f"cannot {name}:\n{traceback.format_exc()}"
                )
                undo()
            else:
                self._diagnostics.is_stuck = False
                return TransitionCallbackReturn.SUCCESS
        self._diagnostics.publish()
        return TransitionCallbackReturn.FAILURE

    def _configure(self) -> None:
        parameters = self._parameters_now()
        # Other needs than parameters, such as a library, are refused now and not at activation.
        Pipeline(pipeline_config(parameters), lambda output: None)
        for topic in OUTPUT_TOPICS:
            self._publishers_made[topic.name] = self.create_lifecycle_publisher(
                topic.message_type,
                f"~/{topic.name}",
                topic.profile(parameters.core.block_duration),
            )
        self._services_made = [
            self.create_service(Trigger, name, answer)
            for name, answer in (
                ("~/reset", self._on_reset),
                ("~/tare", self._on_tare),
            )
        ]
        self._is_configured = True
        self.get_logger().info(f"configured: silent until it is activated{self._by('activate')}")

    def _activate(self) -> None:
        self._session = Session(self, self._parameters_now(), self._publishers_made, self._lock)
        self._session.listen()
        self._diagnostics.begin(self._session)

    def _deactivate(self) -> None:
        session, self._session = self._session, None
        self._diagnostics.end()
        if session is not None:
            session.finish()

    def _release(self) -> None:
        self._deactivate()
        for publisher in self._publishers_made.values():
            self.destroy_publisher(publisher)
        for service in self._services_made:
            self.destroy_service(service)
        self._publishers_made.clear()
        self._services_made.clear()
        self._is_configured = False

    def _by(self, transition: str) -> str:
        return f" (ros2 lifecycle set {self.get_fully_qualified_name()} {transition})"

    def start(self) -> bool:
        """Configure and activate if ``autostart`` is set; return whether that was done."""
        if not self.get_parameter("autostart").value:
            self.get_logger().info(
                "unconfigured: it neither listens nor publishes until it is configured"
                f"{self._by('configure')} and activated; -p autostart:=true does both at the start"
            )
            return True
        success = TransitionCallbackReturn.SUCCESS
        return self.trigger_configure() == success and self.trigger_activate() == success

    def finish(self) -> None:
        """Report the open contact and let subscribers receive it, before the process ends."""
        with self._lock:
            if self._session is None:
                return
            self._deactivate()
        # Lifecycle publishers delegate to rclpy's publishers.
        for publisher in self._publishers_made.values():
            publisher.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGE_TIMEOUT))

    def destroy_node(self) -> None:
        """Stop and release everything first, so that nothing is left in the middleware."""
        with self._lock:
            self._release()
        super().destroy_node()

    # Services

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        done = "everything learned was forgotten"
        return self._answer("reset", response, lambda session: session.reset(), done)

    def _on_tare(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        done = "the present force is zero now"
        return self._answer("tare", response, lambda session: session.pipeline.tare(), done)

    def _answer(
        self,
        name: str,
        response: Trigger.Response,
        act: Callable[[Session], str | None],
        done: str,
    ) -> Trigger.Response:
        """Run a service's action; it returns None, or why it is not possible now."""
        with self._lock:
            problem = _INACTIVE if self._session is None else act(self._session)
            if problem is not None:
                self._diagnostics.refusal = f"{name}: {problem}"
        self.get_logger().info(f"{name}: {problem or done}")
        response.success, response.message = problem is None, problem or "done"
        return response


def _plain(value: Any) -> Any:
    """Return a parameter's value as plain Python: arrays come as array.array, none as None."""
    if value is None:
        return []
    return value if isinstance(value, (bool, int, float, str)) else list(value)


def _descriptor(parameter: Parameter, *more: str) -> ParameterDescriptor:
    """Return a parameter's description and range, in ROS's format."""
    descriptor = ParameterDescriptor(
        description=f"{parameter.description} [{parameter.unit}]",
        additional_constraints="; ".join(filter(None, more)),
        read_only=parameter.name == "autostart",
    )
    low, high = parameter.minimum, parameter.maximum
    if isinstance(parameter.default, float):
        least = 0.0 if parameter.may_be_zero else low
        descriptor.floating_point_range = [FloatingPointRange(from_value=least, to_value=high)]
    elif isinstance(parameter.default, int) and not isinstance(parameter.default, bool):
        own = IntegerRange(from_value=int(low), to_value=int(high), step=1)
        descriptor.integer_range = [own]
    return descriptor


def main(arguments: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; report the open contact before leaving."""
    # The threads of the middleware, which begin later, inherit it.
    problem = _raise_priority() if arguments is None else ""
    return run_node(
        "identifier",
        Identifier,
        arguments,
        start=functools.partial(_start, problem=problem),
        finish=Identifier.finish,
        needs_section=True,
    )


def _raise_priority() -> str:
    """Raise the process's priority; return why that is not possible, or nothing."""
    try:
        os.nice(_NICE)
    except PermissionError:
        return (
            f"no right to a nice value of {_NICE}: next to busy processes estimates may come "
            "late; docs/quickstart.md says how to get it"
        )
    return ""


def _start(node: Identifier, problem: str) -> bool:
    if problem:
        node.get_logger().warning(problem)
    is_done = node.start()
    # Present objects stay: the collector need not scan them again and again.
    gc.collect()
    gc.freeze()
    return is_done


if __name__ == "__main__":
    raise SystemExit(main())
