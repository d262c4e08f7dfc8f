# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A computation beside the samples, so that they need not wait for it.

When its result is used is for the data to decide and not for a clock: so what comes of a recording
is what came of it live, bit for bit.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")


class Pending(Generic[Result]):
    """A result that is computed elsewhere, or here when it is asked for.

    Parameters
    ----------
    compute : callable
        What it computes from does not change.
    executor : Executor, optional
        Where it is computed.
    """

    def __init__(self, compute: Callable[[], Result], executor: Executor | None = None) -> None:
        self._compute = compute
        self._future: Future[Result] | None = None
        if executor is not None:
            # It may have been shut down, or its process have died.
            with contextlib.suppress(RuntimeError):
                self._future = executor.submit(compute)

    @property
    def is_there(self) -> bool:
        """Whether it need not be waited for: it has come, or is computed here."""
        return self._future is None or self._future.done()

    def result(self) -> Result:
        """Return the result once it is there; raise what the computation has raised."""
        if self._future is not None:
            try:
                return self._future.result()
            except BrokenExecutor:
                self._future = None
        return self._compute()

    def __getstate__(self) -> dict[str, Any]:
        """Return what computes it anew: a future is not pickled."""
        return {"_compute": self._compute, "_future": None}
