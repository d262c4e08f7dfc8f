# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The status of a pipeline's work for ``/diagnostics``, live and offline."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from fden_ros.core.pipeline import Pipeline

#: Name of the status on `/diagnostics`.
_HARDWARE_ID = "force_sensor"
#: An input warning is repeated for this number of looks, one a second.
_WARNED_FOR = 10


def diagnostic_status(
    node_name: str,
    problems: Sequence[str],
    pipeline: Pipeline,
    pairs: int,
    more: Mapping[str, object] | None = None,
    *,
    errors: Sequence[str] = (),
) -> DiagnosticStatus:
    """Return the status of a node called `node_name`, with `pairs` in the last second."""
    if pipeline.is_failed:
        errors = [*errors, str(pipeline.failures[-1])]
    problems = [*errors, *pipeline.problems, *problems]
    level = DiagnosticStatus.WARN if problems else DiagnosticStatus.OK
    if errors:
        level = DiagnosticStatus.ERROR
    status = status_of(node_name, level, "; ".join(problems) or "identifying")
    for key, value in {**_values(pipeline, pairs), **(more or {})}.items():
        status.values.append(KeyValue(key=key, value=str(value)))
    return status


def status_of(node_name: str, level: bytes, words: str) -> DiagnosticStatus:
    """Return the status of a node, without values."""
    return DiagnosticStatus(
        name=f"{node_name.lstrip('/')}: tissue identification",
        hardware_id=_HARDWARE_ID,
        level=level,
        message=words,
    )


class PipelineProblems:
    """What went wrong in a pipeline since the last look at it, in words.

    Not its `problems`, which are constant and in every status.

    Parameters
    ----------
    pipeline : Pipeline
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._pairs_before = 0
        self._rejected_before = 0
        self._warned_before: Counter[str] = Counter()
        self._warned: dict[str, int] = {}

    def look(self) -> PipelineNews:
        """Return what is new; to be called once a second."""
        pipeline = self._pipeline
        pairs, rejected = pipeline.pair_count, pipeline.unusual_rejections
        counts = Counter(pipeline.warnings)
        for words in pipeline.problems:
            del counts[words]
        for words in counts - self._warned_before:
            self._warned[words] = _WARNED_FOR
        # In the order of the pipeline, the likeliest cause first.
        self._warned = {words: self._warned[words] for words in counts if words in self._warned}
        news = PipelineNews(
            pairs=pairs - self._pairs_before,
            rejected=rejected - self._rejected_before,
            warnings=tuple(self._warned),
        )
        self._pairs_before, self._rejected_before = pairs, rejected
        self._warned_before = counts
        self._warned = {words: left - 1 for words, left in self._warned.items() if left > 1}
        return news


@dataclass(frozen=True)
class PipelineNews:
    """What a pipeline did in the last second."""

    pairs: int
    rejected: int
    warnings: tuple[str, ...]  #: about the input in the last ten seconds

    @property
    def problems(self) -> list[str]:
        """Return the problems, a sentence each."""
        problems = list(self.warnings)
        if not self.pairs:
            problems.append("no pair of force and displacement in the last second")
        if self.rejected:
            problems.append(f"{self.rejected} samples rejected in the last second")
        return problems


def _values(pipeline: Pipeline, pairs: int) -> dict[str, Any]:
    values: dict[str, Any] = {
        "pairs": pipeline.pair_count,
        "pairs per second": pairs,
        "contacts": pipeline.contact_count,
        "sites": pipeline.site_count,
        "rejected": pipeline.rejected.total(),
        "failures": pipeline.failure_count,
    }
    values.update({f"rejected.{k}": n for k, n in sorted(pipeline.rejected.items())})
    values.update(sorted(pipeline.warnings.items()))
    return values
