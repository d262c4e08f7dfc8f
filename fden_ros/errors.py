# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The one exception that users meet: its text is the single line they read."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Hint:
    """What a command shows below the line of an error."""

    lines: tuple[str, ...]  #: the choices
    options: tuple[str, ...] = ()  #: with these the same command would work


class InputError(Exception):
    """Something given from outside (a file, a parameter, an argument) cannot be used.

    The message is one line that says what is wrong and what would be right. Commands print it and
    exit with 1; the node logs it and refuses the transition.

    Parameters
    ----------
    message : str
    hint : callable, optional
        Makes the :class:`Hint`, which may take a while, where somebody reads it.
    """

    def __init__(self, message: str, hint: Callable[[], Hint] | None = None) -> None:
        super().__init__(message)
        self.hint = hint


def without_ros(error: ModuleNotFoundError) -> InputError:
    """Return the line for a computer without ROS 2 or without the messages.

    Raises
    ------
    ModuleNotFoundError
        The error itself, where what is missing is no part of ROS 2.
    """
    if not re.match(r"(rclpy|rosidl_parser|std_srvs|\w+_interfaces|\w+_msgs)\b", error.name or ""):
        raise error
    return InputError(
        f"this needs ROS 2 ({error}): source ROS 2 Jazzy and the workspace, or install "
        "fden_ros[wheels] and the wheel of fden_msgs"
    )
