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

"""Tasks of a benchmark in several processes, whose results come as they are ready."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, TypeVar

Task = TypeVar("Task", bound="tuple[Any, ...]")
Result = TypeVar("Result")


def completed(
    function: Callable[..., Result], tasks: Sequence[Task], *shared: object, jobs: int
) -> Iterator[tuple[Task, Result]]:
    """Yield every task with what a function of it returns, the first that is ready first.

    Parameters
    ----------
    function : callable
        Of a module, so that a process can be sent its name.
    tasks : sequence of tuple
        The first arguments of each call.
    *shared
        The last arguments, the same for all.
    jobs : int
        Processes; 1: this one, in the order of the tasks.
    """
    if jobs == 1:
        for task in tasks:
            yield task, function(*task, *shared)
        return
    pool = ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"))
    try:
        futures = {pool.submit(function, *task, *shared): task for task in tasks}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        pool.shutdown(cancel_futures=True)
