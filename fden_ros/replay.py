"""A bag through the pipeline, straight from the file."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message

from fden_ros.core.pipeline import ContactSummary, Flag, Output, Pipeline
from fden_ros.errors import InputError
from fden_ros.messages import DISPLACEMENT_MESSAGES, FORCE_MESSAGES, Inputs
from fden_ros.parameters import pipeline_config
from fden_ros.recording.definitions import message_class
from fden_ros.recording.reader import BagReader, Topic


@dataclass(frozen=True)
class Replay:
    """What came out of a bag."""

    samples: int  #: pairs of force and displacement that went through the pipeline
    rejected: dict[str, int]
    warnings: tuple[str, ...]
    summaries: tuple[ContactSummary, ...]


def replay(
    bag: str | Path,
    parameters: Mapping[str, Any],
    *,
    force_topic: str | None = None,
    displacement_topic: str | None = None,
    progress: bool = False,
    on_output: Callable[[Output, str], None] | None = None,
) -> Replay:
    """Run a bag through the pipeline.

    Parameters
    ----------
    bag : path
        A rosbag2 folder or an ``.mcap`` file.
    parameters : mapping
        Checked parameter values (:func:`fden_ros.parameters.check`).
    force_topic, displacement_topic : str, optional
        Topics; without them the only sensible ones of the bag.
    progress : bool
        Show a progress bar on standard error.
    on_output : callable, optional
        Called with every output and the frame of the force.

    Raises
    ------
    InputError
        If the bag or its topics cannot be used.
    """
    reader = BagReader(bag)
    force = find_topic(reader, force_topic, "force", FORCE_MESSAGES.values())
    displacement = find_topic(
        reader, displacement_topic, "displacement", DISPLACEMENT_MESSAGES.values(), other=force
    )
    summaries: list[ContactSummary] = []

    def keep(output: Output) -> None:
        if isinstance(output, ContactSummary):
            summaries.append(output)
        if on_output is not None:
            on_output(output, inputs.force_frame)

    pipeline = Pipeline(pipeline_config(parameters), keep)
    inputs = Inputs(parameters, pipeline)
    classes = {t.name: message_class(t.type_name) for t in (force, displacement)}
    total = force.message_count + displacement.message_count
    with _progress_bar(progress, total) as advance:
        for message in reader.messages({force.name, displacement.name}):
            sample = deserialize_message(message.data, classes[message.topic])
            if message.topic == force.name:
                inputs.add_force(sample)
            if message.topic == displacement.name:
                inputs.add_displacement(sample)
            advance()
    pipeline.finish()
    return Replay(
        samples=pipeline.pair_count,
        rejected=dict(sorted(pipeline.rejected.items())),
        warnings=(*reader.warnings, *_warnings(pipeline, summaries)),
        summaries=tuple(summaries),
    )


def find_topic(
    reader: BagReader, name: str | None, what: str, classes: Any, other: Topic | None = None
) -> Topic:
    """Return the topic called `name`, or the only one that can carry `what`.

    Raises
    ------
    InputError
        If there is none, several, or one of a type that cannot be read.
    """
    usable = {_type_name(kind) for kind in classes}
    if name is not None:
        names = {topic.name: topic for topic in reader.topics}
        topic = names.get(name) or names.get(f"/{name}") or reader.topic(name)
        if topic.type_name not in usable:
            raise InputError(
                f"{name} carries {topic.type_name}, which holds no {what}: "
                f"must be one of {', '.join(sorted(usable))}"
            )
        return topic
    candidates = [
        t for t in reader.topics if t.type_name in usable and t.message_count and t != other
    ]
    named = [t for t in candidates if t.name.strip("/").split("/")[-1] == what]
    if what == "force" and not named:
        # A wrench is a force; joint states usually are not.
        named = [t for t in candidates if t.type_name == _type_name(FORCE_MESSAGES["wrench"])]
    chosen = named if len(named) == 1 else candidates
    if len(chosen) == 1:
        return chosen[0]
    listed = ", ".join(f"{t.name} ({t.type_name})" for t in candidates or reader.topics) or "none"
    problem = "several topics could carry" if candidates else "no topic can carry"
    raise InputError(f"{reader.path}: {problem} the {what}: {listed}; name it with --{what}-topic")


def _type_name(kind: type) -> str:
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


class _progress_bar:  # noqa: N801 - used as a function
    """Progress on standard error, or none; gives the function to call for each message."""

    def __init__(self, visible: bool, total: int) -> None:
        self._visible, self._total = visible, total

    def __enter__(self) -> Callable[[], object]:
        if not self._visible:
            return lambda: None
        from rich.console import Console
        from rich.progress import Progress

        self._bar = Progress(console=Console(stderr=True), transient=True)
        self._bar.start()
        task = self._bar.add_task("replaying", total=self._total)
        return lambda: self._bar.advance(task)

    def __exit__(self, *_: object) -> None:
        if self._visible:
            self._bar.stop()


def _warnings(pipeline: Pipeline, summaries: list[ContactSummary]) -> list[str]:
    warnings = [f"{text} ({n} times)" if n > 1 else text for text, n in pipeline.warnings.items()]
    rejected = pipeline.rejected.total()
    if rejected:
        warnings.append(f"{rejected} samples were rejected; `rejected` says why")
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
        "g": None,
        "g_n": None,
        "alpha": None,
        "g_sd": None,
        "g_n_sd": None,
        "alpha_sd": None,
        "alpha_source": summary.order_source.name.lower(),
        "converged": summary.converged,
        "complete": summary.complete,
        "flags": [f.name.lower() for f in Flag if f and f.name and summary.flags & f],
        "max_strain": summary.max_strain,
        "max_stress": summary.max_stress,
        "max_force": summary.max_force,
        "samples": summary.sample_count,
        "label": "",
        "probabilities": {},
    }
    estimate = summary.estimate
    if estimate is not None:
        g = math.exp(estimate.log_linear_stiffness)
        g_n = math.exp(estimate.log_nonlinear_stiffness)
        deviations = [math.sqrt(estimate.covariance[i, i]) for i in range(3)]
        contact |= {
            "g": g,
            "g_n": g_n,
            "alpha": estimate.fractional_order,
            "g_sd": g * deviations[0],
            "g_n_sd": g_n * deviations[1],
            "alpha_sd": deviations[2],
        }
    if summary.classes is not None:
        contact["label"] = summary.classes.label
        contact["probabilities"] = dict(
            zip(summary.classes.names, summary.classes.probabilities, strict=True)
        )
    return contact
