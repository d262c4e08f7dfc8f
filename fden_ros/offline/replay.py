# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A bag through the pipeline, straight from the file."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fden_ros.advice import INPUTS
from fden_ros.core.contact import LEAST_SAMPLES
from fden_ros.core.estimation import KEYS
from fden_ros.core.outputs import ContactSummary, Failure, Flag, Output, placed
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.stiffness import NOT_MEASURED, Slopes
from fden_ros.core.streams import Pair
from fden_ros.offline import thickness
from fden_ros.offline.known import known_alone, known_stiffness
from fden_ros.one_thread import one_thread
from fden_ros.parameters import Parameters, pipeline_config
from fden_ros.progress import progress as bar
from fden_ros.recording.bag_files import RawMessage
from fden_ros.recording.source import Selection, Source, open_source

_LOGGER = logging.getLogger(__name__)

#: A progress bar moves by this many messages at once.
_PROGRESS_STEP = 500

#: Keys of the measured slopes, of loading and of unloading.
MEASURED_KEYS = ("measured_slope", "measured_slope_unloading")
#: Keys of a contact, and the fields of its summary.
_FIELDS = {
    "contact_id": "contact_id", "site": "site_id", "start_ns": "start_ns", "end_ns": "end_ns",
    "position": "position", "frame": "position_frame", "converged": "converged",
    "complete": "complete", "max_strain": "max_strain", "max_stress": "max_stress",
    "max_force": "max_force", "samples": "sample_count",
}  # fmt: skip


@dataclass(frozen=True)
class Replay:
    """The result of a recording."""

    samples: int  #: pairs of force and displacement that went through the pipeline
    rejected: dict[str, int]
    warnings: tuple[str, ...]
    summaries: tuple[ContactSummary, ...]  #: in the recording's own times
    inputs: dict[str, str]  #: topic or column of ``force`` and ``displacement``
    parameters: Parameters  #: as given, with the recording's own values
    set_by_recording: tuple[str, ...] = ()  #: those values, a line each
    failures: tuple[Failure, ...] = ()  #: the newest, each of which ended a contact and its site
    #: Slopes of force over displacement outside of contacts, at the deepest point.
    measured_unseen: Slopes = NOT_MEASURED
    never_lifts: bool = False  #: the probe palpates, so that its contacts are strokes
    is_air_doubted: bool = False  #: the force fell below its value in the air, by a wrong sign?

    @property
    def has_identified(self) -> bool:
        """Whether a contact converged, or N/m or a slope is known, of one or on a path."""
        if self.has_strokes or any(s.converged or s.is_of_path for s in self.summaries):
            return not self.has_strokes
        is_unseen = self.measured_unseen.loading is not None and not self.is_air_doubted
        return is_unseen or any(map(known_stiffness, self._believed))

    @property
    def with_stiffness_alone(self) -> frozenset[int]:
        """Numbers of the contacts with known N/m or slope, but not G."""
        return frozenset(s.contact_id for s in self._believed if known_alone(s))

    @property
    def _believed(self) -> list[ContactSummary]:
        """The contacts without those that may be the air, where a sign may be wrong."""
        hidden = Flag.TOUCH_NOT_OBSERVED if self.is_air_doubted else Flag.NONE
        return [s for s in self.summaries if not s.flags & hidden]

    @property
    def has_strokes(self) -> bool:
        """Whether the contacts are strokes of a probe that never lifts, and none is converged."""
        return self.never_lifts and not any(s.converged for s in self.summaries)


class _Watched(Pipeline):
    """A pipeline that passes each pair of samples to a function first."""

    show: Callable[[Pair], None]

    def _on_pair(self, pair: Pair) -> None:
        self.show(pair)
        super()._on_pair(pair)


def replay(
    bag: str | Path, parameters: Parameters, selection: Selection | None = None, **options: Any
) -> Replay:
    """Run a recording, a bag or a table, through the pipeline.

    `selection` names topics, fields or columns; without it the only sensible ones are taken.
    `options` are those of :func:`replay_source`.

    Raises
    ------
    InputError
        If the recording or its topics cannot be used.
    """
    return replay_source(open_source(bag, parameters, selection), **options)


def replay_source(
    source: Source,
    *,
    progress: bool = False,
    on_output: Callable[[Output, str], None] = lambda output, frame: None,
    on_input: Callable[[int, RawMessage | None, Pipeline], None] = lambda *_: None,
    on_pair: Callable[[Pair], None] = lambda pair: None,
) -> Replay:
    """Run a source through the pipeline, and show its `progress` on standard error.

    `on_output` is called with every output and the frame of the force, `on_input` before each
    message or row with its time of recording (ns), the message or None, and the pipeline, and
    `on_pair` with every pair of force and displacement.
    """
    summaries: list[ContactSummary] = []

    def keep(output: Output) -> None:
        output = placed(output, source.displacement_frame)
        if isinstance(output, ContactSummary):
            if summaries and summaries[-1].contact_id == output.contact_id:
                # The air after the contact has contradicted it.
                summaries.pop()
            summaries.append(output)
        on_output(output, source.frame)

    with one_thread():
        pipeline = _Watched(pipeline_config(source.parameters), keep)
        pipeline.show = on_pair
        with bar("replaying", source.total, visible=progress) as show:
            for done in source.feed(pipeline, lambda at, one: on_input(at, one, pipeline)):
                if done % _PROGRESS_STEP == 0:
                    show(done)
        pipeline.finish()
    for failure in pipeline.failures:
        _LOGGER.error("%s\n%s", failure, failure.traceback)
    return Replay(
        samples=pipeline.pair_count,
        rejected=dict(sorted(pipeline.rejected.items())),
        warnings=(*source.warnings, *_warnings(pipeline, summaries)),
        summaries=tuple(_moved(summary, -source.shift_ns) for summary in summaries),
        inputs=source.inputs,
        parameters=source.parameters,
        set_by_recording=source.set_by_recording,
        failures=tuple(pipeline.failures),
        measured_unseen=NOT_MEASURED if summaries else pipeline.measured_unseen,
        never_lifts=pipeline.never_lifts,
        is_air_doubted=pipeline.is_air_doubted,
    )


def _moved(summary: ContactSummary, by_ns: int) -> ContactSummary:
    times = {name: getattr(summary, name) + by_ns for name in ("stamp_ns", "start_ns", "end_ns")}
    return replace(summary, **times)


def _warnings(pipeline: Pipeline, summaries: list[ContactSummary]) -> list[str]:
    odd = pipeline.warnings
    warnings = [f"{text} ({n} times)" if n > 1 else text for text, n in odd.items()]
    warnings += map(str, pipeline.failures)
    if pipeline.unusual_rejections:
        rejected, used = pipeline.rejected.total(), pipeline.pair_count
        why = ", ".join(f"{reason} {n}" for reason, n in sorted(pipeline.rejected.items()))
        warnings.append(f"{rejected:,} samples were rejected ({why}), {used:,} were used")
    if len(odd) == len(pipeline.problems) and not summaries:
        count = pipeline.pair_count
        code = "few samples" if 0 < count < LEAST_SAMPLES else "no contact" if count else "no pair"
        warnings.append(str(INPUTS[code].of(count=count)))
    # The assumption about the thickness, where G depends on it.
    strains = [summary.max_strain for summary in summaries if summary.estimate is not None]
    if strains:
        geometry = pipeline.config.geometry
        depth = geometry.length * geometry.compression(max(strains))
        warnings += filter(None, [thickness.assumed(geometry, depth)])
    return warnings


def result_object(result: Replay) -> dict[str, Any]:
    """Return a replay as the output of ``fden replay --json``."""
    return {
        "inputs": result.inputs,
        "set_by_recording": list(result.set_by_recording),
        "samples": result.samples,
        "rejected": result.rejected,
        "warnings": list(result.warnings),
        "contacts": [contact_object(summary) for summary in result.summaries],
        "unseen": measured_object(result.measured_unseen),
    }


def contact_object(summary: ContactSummary) -> dict[str, Any]:
    """Return one contact as a JSON-ready object; null: not estimated."""
    estimate, budget, classes = summary.estimate, summary.budget, summary.classes
    low, high = summary.comparison.interval() if summary.comparison else (None, None)
    sets = ("observable", "converged", "prior_limit")
    known = (estimate.observable, estimate.known, estimate.at_edge) if estimate else ()
    numbers = estimate.numbers if estimate else {}
    return {
        **{name: getattr(summary, field) for name, field in _FIELDS.items()},
        **{key: numbers.get(name) for key, name in KEYS.items()},
        "apparent_stiffness": getattr(summary.apparent_stiffness, "value", None),
        "apparent_stiffness_sd": getattr(summary.apparent_stiffness, "sd", None),
        "apparent_stiffness_time_scale": getattr(summary.apparent_stiffness, "time_scale", None),
        **measured_object(summary.measured),
        "alpha_source": summary.order_source.name.lower(),
        **{f"{name}_parameters": [] for name in sets},
        **{f"{name}_parameters": list(one.names) for name, one in zip(sets, known, strict=False)},
        "covariance": estimate.covariance.tolist() if estimate else None,
        # The modes of (ln G, ln Gn, alpha), whose moments are mean and covariance.
        "components": [
            {"weight": m.weight, "mean": m.mean.tolist(), "covariance": m.covariance.tolist()}
            for m in (estimate.mixture if estimate else ())
        ],
        "flags": [f.name.lower() for f in Flag if f and f.name and summary.flags & f],
        "label": classes.label if classes else "",
        "probabilities": (
            dict(zip(classes.names, classes.probabilities, strict=True)) if classes else {}
        ),
        "p_value": getattr(classes, "p_value", None),
        "decision_time": getattr(summary.decided, "time", None),
        "decision_strain": getattr(summary.decided, "strain", None),
        "ratio": getattr(summary.comparison, "ratio", None),
        "ratio_low": low,
        "ratio_high": high,
        # Which part of the variances of ln G and ln Gn comes from each source.
        "uncertainty_budget": budget
        and {
            name: {"g": budget.share(name, 0), "g_n": budget.share(name, 1)}
            for name in budget.parts
        },
    }


def measured_object(measured: Slopes) -> dict[str, float | None]:
    """Return the measured slopes [N/m], their deviations and depths [m]; null: not known."""
    found: dict[str, float | None] = {}
    for name, slope in zip(MEASURED_KEYS, measured, strict=True):
        parts = slope or (None, None, math.nan)
        depth = None if math.isnan(parts[2]) else parts[2]
        for part, value in zip(("", "_sd", "_depth"), (*parts[:2], depth), strict=True):
            found[f"{name}{part}"] = value
    return found
