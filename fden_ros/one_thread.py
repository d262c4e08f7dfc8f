# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Linear algebra on one thread.

The matrices here are small. Threads would wait for each other, several milliseconds at a time on a
busy machine, and would change the last bits of what a replay must repeat.
"""

from __future__ import annotations

import os
from contextlib import AbstractContextManager

from threadpoolctl import threadpool_limits


def one_thread() -> AbstractContextManager[object]:
    """Return a context in which linear algebra runs on one thread; numpy must be imported."""
    return threadpool_limits(limits=1, user_api="blas")


def start_no_threads() -> None:
    """Let numpy, which is not imported yet, start no threads in this process and its workers.

    They would only spin. A number of threads that the user has set stands.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
