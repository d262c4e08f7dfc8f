# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A bar on standard error for what takes long."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


@contextmanager
def progress(
    description: str, total: float | None, *, visible: bool = True
) -> Iterator[Callable[[float], None]]:
    """Show a bar on standard error, if that is a terminal.

    The function it gives takes how much is done; where `total` is not known the bar only moves.
    """
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not (visible and sys.stderr.isatty()),
    )
    with bar:
        task = bar.add_task(description, total=total or None)
        yield lambda done: bar.update(task, completed=done)
