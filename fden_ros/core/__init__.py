# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The pure core: from samples to classified tissue, in stages that follow the data.

``streams`` → ``law`` → ``contact`` → ``estimation`` → ``classification`` → ``outputs``, composed
by ``pipeline``. Nothing here knows ROS, a clock or a file.

The names below are for use from outside, documented in ``docs/python.md``; each is imported
at its first use.
"""

from __future__ import annotations

#: As that of typing, without importing it: importing this package costs nothing.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from fden_ros.core.config import PipelineConfig
    from fden_ros.core.outputs import (
        Classification,
        ContactSummary,
        Decision,
        DynamicModulus,
        Flag,
        OrderSource,
        Phase,
        Status,
        TissueState,
    )
    from fden_ros.core.pipeline import Pipeline

__all__ = [
    "Classification",
    "ContactSummary",
    "Decision",
    "DynamicModulus",
    "Flag",
    "OrderSource",
    "Phase",
    "Pipeline",
    "PipelineConfig",
    "Status",
    "TissueState",
]

_MODULES = {"Pipeline": "pipeline", "PipelineConfig": "config"}


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(f"{__name__}.{_MODULES.get(name, 'outputs')}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
