# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Processes that identify recordings: of this machine, or of a cluster of Dask.

Each is an executor of :mod:`concurrent.futures`; leaving it ends the tasks that have begun.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager

from fden_ros import __version__
from fden_ros.errors import InputError
from fden_ros.recording.places import needs_extra

SAME_VERSION = f"install fden_ros {__version__} and the same tissue library on each"


@contextmanager
def local(count: int) -> Iterator[Executor]:
    """Give `count` processes of this machine."""
    others = multiprocessing.active_children()
    # A fork would copy the threads of the numerics.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(count, context, initializer=_ignore_interrupts)
    try:
        yield pool
    except KeyboardInterrupt:
        # Unfinished tasks are dropped: nobody waits for them.
        for process in set(multiprocessing.active_children()) - set(others):
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _ignore_interrupts() -> None:
    """Ignore Ctrl-C: the process that started this one handles it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def cluster(scheduler: str, say: Callable[[str], object]) -> Iterator[Executor]:
    """Give the workers of a scheduler of Dask, by its address or the file that it has written.

    `say` is called with a line where there is no worker yet.

    Raises
    ------
    InputError
        If it cannot be reached.
    """
    with needs_extra("--scheduler"):
        from distributed import Client
    is_file = os.path.isfile(scheduler)
    if not is_file and "://" not in scheduler:
        raise InputError(f"{scheduler} is not a scheduler: give tcp://HOST:8786, or its file")
    try:
        client = Client(**{"scheduler_file" if is_file else "address": scheduler})
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"the scheduler {scheduler} cannot be reached ({error}): start it with dask scheduler"
        ) from None
    with client:
        if not client.scheduler_info()["workers"]:
            say(f"{scheduler} has no worker yet: waiting for one")
        pool = client.get_executor()
        try:
            yield pool
        finally:
            pool.shutdown(wait=False)
