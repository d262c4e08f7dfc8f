# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The one exception that users meet: its text is the single line they read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Hint:
    """What a command shows below the line of an error."""

    lines: tuple[str, ...]  #: what there is to choose from
    options: tuple[str, ...] = ()  #: with which the same command would go on


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
