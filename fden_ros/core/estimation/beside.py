# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A computation in a thread of its own, so that samples need not wait for it.

When its result is used is for the data to decide and not for a clock: so what comes of a recording
is what came of it live, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Thread
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")


class Beside(Generic[Result]):
    """Computes in a thread; what it computes from must not change meanwhile.

    Parameters
    ----------
    compute : callable
    """

    def __init__(self, compute: Callable[[], Result]) -> None:
        self._results: list[Result] = []
        self._error: Exception | None = None
        # A process that ends does not wait for it.
        self._thread: Thread | None = Thread(target=self._run, args=(compute,), daemon=True)
        self._thread.start()

    def _run(self, compute: Callable[[], Result]) -> None:
        try:
            self._results.append(compute())
        except Exception as error:
            self._error = error

    def _wait(self) -> None:
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def result(self) -> Result:
        """Return the result once it is there; raise what the computation has raised."""
        self._wait()
        if self._error is not None:
            raise self._error
        return self._results[0]

    def __getstate__(self) -> dict[str, Any]:
        """Return what is left of it once it is done: a thread is not pickled."""
        self._wait()
        return self.__dict__
