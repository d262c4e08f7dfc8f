"""What there is to say of a pipeline's work: the status of ``/diagnostics``, live and offline."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from fden_ros.core.pipeline import Pipeline


def diagnostic_status(
    node_name: str,
    problems: Sequence[str],
    pipeline: Pipeline,
    pairs_before: int,
    more: Mapping[str, int] | None = None,
) -> DiagnosticStatus:
    """Return the status of a node called `node_name`, `pairs_before` as of a second ago."""
    status = DiagnosticStatus()
    status.name = f"{node_name.lstrip('/')}: tissue identification"
    status.hardware_id = ""
    problems = [*pipeline.problems, *problems]
    status.level = DiagnosticStatus.WARN if problems else DiagnosticStatus.OK
    if pipeline.is_failed:
        status.level = DiagnosticStatus.ERROR
    status.message = "; ".join(problems) or "identifying"
    for key, value in {**_values(pipeline, pairs_before), **(more or {})}.items():
        status.values.append(KeyValue(key=key, value=str(value)))
    return status


def _values(pipeline: Pipeline, pairs_before: int) -> dict[str, Any]:
    values: dict[str, Any] = {
        "pairs": pipeline.pair_count,
        "pairs per second": pipeline.pair_count - pairs_before,
        "contacts": pipeline.contact_count,
        "sites": pipeline.site_count,
        "rejected": pipeline.rejected.total(),
        "failures": pipeline.failure_count,
    }
    values.update({f"rejected.{k}": n for k, n in sorted(pipeline.rejected.items())})
    values.update(sorted(pipeline.warnings.items()))
    return values


def type_name(kind: Callable[..., Any]) -> str:
    """Return the name of a message class, such as ``geometry_msgs/msg/WrenchStamped``."""
    package, _, _ = kind.__module__.partition(".")
    return f"{package}/msg/{kind.__name__}"
