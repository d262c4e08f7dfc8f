"""The pure core: from samples to classified tissue, in stages that follow the data.

``streams`` → ``contact`` → ``law`` → ``estimation`` → ``classification``, composed by
``pipeline``. Nothing here knows ROS, a clock or a file. What stands in ``__all__`` is documented
in ``docs/python.md``.
"""

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
from fden_ros.core.pipeline import Pipeline, PipelineConfig

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
