# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The priority of the node's process, so that work on the same cores does not delay estimates.

At the priority of every other process a node gets half of a core next to one that computes, and a
contact at 1 kHz takes about that.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


def raise_priority(nice: int) -> str:
    """Let all threads of the process have a nice value, where theirs is higher; say why not.

    Parameters
    ----------
    nice : int
        From -20, the highest priority, to 0, that of an ordinary process: then nothing is asked.

    Returns
    -------
    str
        Empty where that was done, or nothing was to do.
    """
    threads = Path("/proc/self/task")
    if nice == 0 or not threads.is_dir():
        return ""
    try:
        for thread in threads.iterdir():
            number = int(thread.name)
            # One may end in the meantime.
            with contextlib.suppress(ProcessLookupError):
                if os.getpriority(os.PRIO_PROCESS, number) > nice:
                    os.setpriority(os.PRIO_PROCESS, number, nice)
    except PermissionError:
        return (
            f"nice {nice} is not permitted: next to busy processes estimates may come late; "
            "docs/robots.md says how to permit it"
        )
    return ""
