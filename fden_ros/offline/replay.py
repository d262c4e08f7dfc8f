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

"""A bag through the pipeline, straight from the file."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fden_ros.core.estimation.estimate import KEYS
from fden_ros.core.outputs import ContactSummary, Failure, Flag, Output, placed
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.rotation import Quaternion
from fden_ros.core.streams.samples import Position, Sink
from fden_ros.parameters import Parameters, pipeline_config
from fden_ros.recording.reader import RawMessage
from fden_ros.recording.source import Selection, open_source

_LOGGER = logging.getLogger(__name__)

#: A progress bar is told of this many messages at once.
_PROGRESS_STEP = 500


@dataclass(frozen=True)
class Replay:
    """What came out of a recording."""

    samples: int  #: pairs of force and displacement that went through the pipeline
    rejected: dict[str, int]
    warnings: tuple[str, ...]
    summaries: tuple[ContactSummary, ...]
    inputs: dict[str, str]  #: topic or column of ``force`` and ``displacement``
    failures: tuple[Failure, ...] = ()  #: what ended a contact and its site, the newest

    @property
    def has_identified(self) -> bool:
        """Whether a contact converged, or the stiffness of a place on a path is known."""
        return any(summary.converged or summary.is_of_path for summary in self.summaries)


def replay(
    bag: str | Path,
    parameters: Parameters,
    selection: Selection | None = None,
    *,
    progress: bool = False,
    on_output: Callable[[Output, str], None] | None = None,
    on_input: Callable[[int, RawMessage | None, Pipeline], None] | None = None,
    listener: Sink | None = None,
) -> Replay:
    """Run a recording through the pipeline.

    Parameters
    ----------
    bag : path
        A rosbag2 folder, an ``.mcap`` file, or a table with `selection.columns`.
    parameters : Parameters
        Of :func:`fden_ros.parameters.check`.
    selection : Selection, optional
        Topics, fields or columns; without it the only sensible topics of the bag.
    progress : bool
        Show a progress bar on standard error.
    on_output : callable, optional
        Called with every output and the frame of the force.
    on_input : callable, optional
        Called before each message or row with its time of recording (ns), the message or None,
        and the pipeline.
    listener : Sink, optional
        Given every sample too, before the pipeline.

    Raises
    ------
    InputError
        If the recording or its topics cannot be used.
    """
    source = open_source(bag, parameters, selection)
    summaries: list[ContactSummary] = []

    def keep(output: Output) -> None:
        output = placed(output, source.displacement_frame)
        if isinstance(output, ContactSummary):
            if summaries and summaries[-1].contact_id == output.contact_id:
                # The air after it has contradicted it.
                summaries.pop()
            summaries.append(output)
        if on_output is not None:
            on_output(output, source.frame)

    def before(log_time_ns: int, message: RawMessage | None) -> None:
        if on_input is not None:
            on_input(log_time_ns, message, pipeline)

    pipeline = Pipeline(pipeline_config(parameters), keep)
    sink: Sink = pipeline if listener is None else _Both(listener, pipeline)
    with _progress_bar(progress, source.total) as show:
        for done in source.feed(sink, before):
            if done % _PROGRESS_STEP == 0:
                show(done)
    pipeline.finish()
    for failure in pipeline.failures:
        _LOGGER.error("%s\n%s", failure, failure.traceback)
    return Replay(
        samples=pipeline.pair_count,
        rejected=dict(sorted(pipeline.rejected.items())),
        warnings=(*source.warnings, *_warnings(pipeline, summaries)),
        summaries=tuple(summaries),
        inputs=source.inputs,
        failures=tuple(pipeline.failures),
    )


class _Both:
    """Gives samples to two, one after the other."""

    def __init__(self, first: Sink, second: Sink) -> None:
        self._sinks = first, second

    def add_force(self, stamp_ns: int, force: float) -> None:
        for sink in self._sinks:
            sink.add_force(stamp_ns, force)

    def add_displacement(
        self,
        stamp_ns: int,
        displacement: float,
        position: Position | None = None,
        load: float = 0.0,
        turn: Quaternion | None = None,
    ) -> None:
        for sink in self._sinks:
            sink.add_displacement(stamp_ns, displacement, position, load, turn)

    def add_force_vector(self, stamp_ns: int, frame: str, force: Position) -> None:
        for sink in self._sinks:
            sink.add_force_vector(stamp_ns, frame, force)

    def add_transform(
        self,
        stamp_ns: int,
        parent: str,
        child: str,
        translation: Position,
        rotation: Quaternion,
        *,
        is_static: bool,
    ) -> None:
        for sink in self._sinks:
            sink.add_transform(stamp_ns, parent, child, translation, rotation, is_static=is_static)

    def add_surface(self, stamp_ns: int, surface: float) -> None:
        for sink in self._sinks:
            sink.add_surface(stamp_ns, surface)

    def reject(self, stream: str, reason: str) -> None:
        for sink in self._sinks:
            sink.reject(stream, reason)


class _progress_bar:  # noqa: N801 - used as a function
    """Progress on standard error, or none; gives the function to call with the steps done."""

    def __init__(self, visible: bool, total: int) -> None:
        self._visible, self._total = visible, total

    def __enter__(self) -> Callable[[int], object]:
        if not self._visible:
            return lambda done: None
        from rich.console import Console
        from rich.progress import Progress

        self._bar = Progress(console=Console(stderr=True), transient=True)
        self._bar.start()
        task = self._bar.add_task("replaying", total=self._total or None)
        return lambda done: self._bar.update(task, completed=done)

    def __exit__(self, *_: object) -> None:
        if self._visible:
            self._bar.stop()


def _warnings(pipeline: Pipeline, summaries: list[ContactSummary]) -> list[str]:
    odd = pipeline.warnings
    warnings = [f"{text} ({n} times)" if n > 1 else text for text, n in odd.items()]
    is_explained = len(odd) > len(pipeline.problems)
    warnings += map(str, pipeline.failures)
    if pipeline.unusual_rejections:
        rejected = pipeline.rejected.total()
        warnings.append(f"{rejected} samples were rejected; `rejected` says why")
    if is_explained:
        return warnings
    if not pipeline.pair_count:
        warnings.append(
            "no pair of force and displacement: do the stamps of the two topics overlap?"
        )
    elif not summaries:
        warnings.append(
            "no contact was found: check force.axis (the force must grow when the probe presses) "
            "and force.threshold"
        )
    return warnings


def result_object(result: Replay) -> dict[str, Any]:
    """Return a replay as what ``fden replay --json`` prints."""
    return {
        "inputs": result.inputs,
        "samples": result.samples,
        "rejected": result.rejected,
        "warnings": list(result.warnings),
        "contacts": [contact_object(summary) for summary in result.summaries],
    }


def contact_object(summary: ContactSummary) -> dict[str, Any]:
    """Return one contact as a JSON-ready object; what was not estimated is null."""
    contact: dict[str, Any] = {
        "contact_id": summary.contact_id,
        "site": summary.site_id,
        "start_ns": summary.start_ns,
        "end_ns": summary.end_ns,
        "position": summary.position,
        "frame": summary.position_frame,
        **dict.fromkeys(KEYS),
        "apparent_stiffness": None,
        "apparent_stiffness_sd": None,
        "apparent_stiffness_time_scale": None,
        "alpha_source": summary.order_source.name.lower(),
        "converged": summary.converged,
        "valid_parameters": [],
        "converged_parameters": [],
        "edge_parameters": [],
        "complete": summary.complete,
        "flags": [f.name.lower() for f in Flag if f and f.name and summary.flags & f],
        "max_strain": summary.max_strain,
        "max_stress": summary.max_stress,
        "max_force": summary.max_force,
        "samples": summary.sample_count,
        "label": "",
        "probabilities": {},
        "typicality": None,
        "decision_time": None,
        "decision_strain": None,
        "ratio": None,
        "ratio_low": None,
        "ratio_high": None,
        "rig": None,
    }
    estimate = summary.estimate
    if estimate is not None:
        numbers = estimate.numbers
        contact |= {
            **{key: numbers.get(name) for key, name in KEYS.items()},
            "valid_parameters": list(estimate.valid.names),
            "converged_parameters": list(estimate.known.names),
            "edge_parameters": list(estimate.at_edge.names),
        }
    stiffness = summary.apparent_stiffness
    if stiffness is not None:
        contact |= {
            "apparent_stiffness": stiffness.value,
            "apparent_stiffness_sd": stiffness.sd,
            "apparent_stiffness_time_scale": stiffness.time_scale,
        }
    if summary.classes is not None:
        contact["label"] = summary.classes.label
        contact["probabilities"] = dict(
            zip(summary.classes.names, summary.classes.probabilities, strict=True)
        )
        contact["typicality"] = summary.classes.typicality
    if summary.decided is not None:
        contact["decision_time"] = summary.decided.time
        contact["decision_strain"] = summary.decided.strain
    if summary.comparison is not None:
        contact["ratio"] = summary.comparison.ratio
        contact["ratio_low"], contact["ratio_high"] = summary.comparison.interval()
    if summary.rig is not None:
        contact["rig"] = {
            name: {"value": value.mean, "sd": value.sd}
            for name, value in summary.rig.values.items()
        }
    return contact
