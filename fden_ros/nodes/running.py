# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Run a node until SIGINT or SIGTERM, with its parameters; an error is one line."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import rclpy
import yaml
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.context import Context
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from fden_ros.errors import InputError
from fden_ros.nodes.programs import ignore_signals, note_signals
from fden_ros.one_thread import one_thread
from fden_ros.parameters import (
    Section,
    check_types,
    live_topics,
    parse_yaml,
    read_sections,
    values_for,
)

_Node = TypeVar("_Node", bound=Node)

#: Longest delay of a signal when nothing else happens [s].
_SPIN_TIMEOUT = 0.1
#: A computing thread yields to messages after this time [s]: Python's default is 5 ms.
_SWITCH_INTERVAL = 0.0005
_ROS_OPTIONS = ("--params-file", "-p", "--param", "-r", "--remap")
_LOG_LEVELS = ("debug", "info", "warn", "error", "fatal", "unset")


def declared(node: Node, parameters: Iterable[tuple[str, Any, str]]) -> dict[str, Any]:
    """Declare a node's read-only parameters: name, default, meaning; return their values."""
    return {
        name: node.declare_parameter(
            name, default, ParameterDescriptor(description=meaning, read_only=True)
        ).value
        for name, default, meaning in parameters
    }


def run_node(
    name: str,
    make: Callable[[], _Node],
    arguments: Sequence[str] | None = None,
    *,
    start: Callable[[_Node], bool] = lambda node: True,
    finish: Callable[[_Node], object] = lambda node: None,
    needs_section: bool = False,
) -> int:
    """Make a node, spin it until a signal, and clean up; return the exit code.

    Parameters
    ----------
    name : str
        Prefix of an error line.
    make : callable
        Returns the node.
    arguments : sequence of str, optional
        Of the command line, the program's name first; without it the process's own.
    start, finish : callable
        Called with the node before and after it is spun; where `start` returns false the node
        ends.
    needs_section : bool
        Refuse a parameter file that has no section for this node, and take its topics.
    """
    noted = note_signals()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    try:
        node = _made(make, list(sys.argv if arguments is None else arguments), needs_section)
        with one_thread():
            return _run(node, start, finish, lambda: bool(noted))
    except _RefusedError as refused:
        # rcl writes several lines, and adds the places in its sources.
        text = " ".join(str(refused).split()).removeprefix("failed to initialize rcl: ")
        print(f"{name}: {re.sub(r', at [^ ,]+:[0-9]+', '', text)}", file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()
        ignore_signals()


class _RefusedError(Exception):
    """The arguments cannot be used."""


def _made(make: Callable[[], _Node], arguments: Sequence[str], needs_section: bool) -> _Node:
    try:
        files = check_arguments(arguments)
        remaps = written_remaps(arguments) if needs_section else []
        rclpy.init(args=[*arguments, *remaps], signal_handler_options=SignalHandlerOptions.NO)
    except (InputError, RuntimeError, ValueError) as error:
        # rclpy raises RCLError, a RuntimeError, for arguments that rcl cannot read.
        raise _RefusedError(str(error)) from error
    try:
        node = make()
        for sections in files if needs_section else ():
            values_for(sections, node.get_fully_qualified_name())
    except (InputError, InvalidParameterTypeException, ParameterException) as error:
        raise _RefusedError(str(error)) from error
    return node


def _run(
    node: _Node,
    start: Callable[[_Node], bool],
    finish: Callable[[_Node], object],
    is_over: Callable[[], bool],
) -> int:
    executor = make_executor()
    executor.add_node(node)
    try:
        if is_over():
            return 0
        if not start(node):
            return 1
        spin(executor, is_over)
        return 0
    finally:
        finish(node)
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_node()


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


def check_arguments(arguments: Sequence[str]) -> list[list[Section]]:
    """Check the ROS arguments of a command line, before rcl reads them.

    Returns
    -------
    list of list of Section
        Of each parameter file.

    Raises
    ------
    InputError
        In one line, where rcl would write several, or name no reason.
    """
    files: list[list[Section]] = []
    ros_options = list(_ros_options(arguments))
    for option in _ROS_OPTIONS:
        if arguments.count(option) > [one for one, _ in ros_options].count(option):
            raise InputError(f"{option} counts only after --ros-args: put --ros-args before it")
    for option, value in ros_options:
        if option == "--params-file":
            files.append(read_sections(value))
        elif option in ("-p", "--param"):
            _check_override(value)
        elif option == "--log-level" and value.split(":=")[-1].lower() not in _LOG_LEVELS:
            raise InputError(
                f"there is no log level {value}: it must be one of {', '.join(_LOG_LEVELS)}"
            )
    return files


def written_remaps(arguments: Sequence[str]) -> list[str]:
    """Return arguments for the topics that parameter files name and the command line does not."""
    options = list(_ros_options(arguments))
    said = [value for option, value in options if option in ("-r", "--remap")]
    given = {value.split(":=")[0].rpartition(":")[2] for value in said}
    topics: dict[str, str] = {}
    for option, value in options:
        if option == "--params-file":
            topics |= live_topics(value)
    words = [f"{name}:={topic}" for name, topic in topics.items() if name not in given]
    return ["--ros-args", *(part for word in words for part in ("-r", word))] if words else []


def _ros_options(arguments: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield every argument between --ros-args and -- with the one that follows it."""
    is_ros = False
    for option, value in zip(arguments, [*arguments[1:], ""], strict=True):
        is_ros = (is_ros or option == "--ros-args") and option != "--"
        if is_ros:
            yield option, value


def _check_override(text: str) -> None:
    name, separator, value = text.partition(":=")
    if not name or not separator:
        raise InputError(f"-p {text} is not a parameter: expected -p NAME:=VALUE")
    try:
        check_types(name, parse_yaml(value))
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"-p {text}: not valid YAML: {' '.join(str(error).split())}") from None
