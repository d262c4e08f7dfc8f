"""Run a plain node until SIGINT or SIGTERM; what is wrong comes in one line."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from fden_ros.errors import InputError
from fden_ros.nodes.identifier import make_executor, spin


def run_node(name: str, make: Callable[[], Node], arguments: list[str] | None = None) -> int:
    """Make a node, spin it until a signal, and clean up; return the exit code."""
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    stopped: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda caught, _: stopped.append(caught))
    try:
        node = make()
    except (InputError, InvalidParameterTypeException, ParameterException) as error:
        print(f"{name}: {' '.join(str(error).split())}", file=sys.stderr)
        rclpy.try_shutdown()
        return 1
    executor = make_executor()
    executor.add_node(node)
    try:
        spin(executor, lambda: bool(stopped))
        return 0
    finally:
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
