# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings through the pipeline, and its results compared with the truth."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeVar

import numpy as np

from benchmark.score import Judged, Outcome, judged, share
from fden_ros.core.arrays import Array
from fden_ros.core.outputs import ContactSummary, Flag, Output, Status, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams import NANOSECONDS, Position, Synchronizer
from fden_ros.parameters import check, pipeline_config
from fden_ros.simulation import FdenModel
from simulation.simulate import START_NS, Recording

Kind = TypeVar("Kind", bound=Output)

#: Presses are apart by at least this [s]; contact lost for a shorter time is the same press.
_SHORTEST_AIR = 0.15
#: A summary belongs to a press that it overlaps, give or take this [s].
_SLACK = 0.05


def elapsed(stamp_ns: int) -> float:
    """Return the time since the beginning of a simulated recording [s]."""
    return (stamp_ns - START_NS) / NANOSECONDS


def log_uniform(generator: np.random.Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is uniform between those of two."""
    return math.exp(generator.uniform(math.log(low), math.log(high)))


def soft_tissue(generator: np.random.Generator, softest: float = 500.0) -> FdenModel:
    """Return a tissue with G up to 8,000, Gn 6 to 10 and alpha 0.08 to 0.32."""
    return FdenModel(
        log_uniform(generator, softest, 8000.0),
        float(generator.uniform(6.0, 10.0)),
        float(generator.uniform(0.08, 0.32)),
    )


def begun(parameters: Mapping[str, object]) -> tuple[Pipeline, list[Output]]:
    """Return a new pipeline, and the list that its outputs go into."""
    outputs: list[Output] = []
    return Pipeline(pipeline_config(check(parameters)), outputs.append), outputs


def fed(
    pipeline: Pipeline, times: Array, forces: Array, displacements: Array, *, placed: bool = False
) -> Iterator[float]:
    """Feed samples of one clock, shape (n,), `placed` at one place, and give each time [s]."""
    for time, force, depth in zip(
        *(a.tolist() for a in (times, forces, displacements)), strict=True
    ):
        stamp_ns = START_NS + round(time * NANOSECONDS)
        pipeline.add_displacement(stamp_ns, depth, (0.0, 0.0, depth) if placed else None)
        pipeline.add_force(stamp_ns, force)
        yield time


def samples_of(recording: Recording) -> Iterator[tuple[bool, int, float, Position | None]]:
    """Give (is a force, stamp, value, place) of all samples by stamp, the displacement first."""
    force, moved = recording.force, recording.displacement
    places: list[Position | None] = [None] * moved.value.size
    if moved.position is not None:
        places = [(x, y, z) for x, y, z in moved.position.tolist()]
    waiting = deque(zip(moved.stamp_ns.tolist(), moved.value.tolist(), places, strict=True))
    for stamp_ns, value in zip(force.stamp_ns.tolist(), force.value.tolist(), strict=True):
        while waiting and waiting[0][0] <= stamp_ns:
            yield False, *waiting.popleft()
        yield True, stamp_ns, value, None
    for sample in waiting:
        yield False, *sample


def feed(sink: Pipeline | Synchronizer, recording: Recording) -> None:
    """Feed all samples of a recording by stamp."""
    for is_force, stamp_ns, value, place in samples_of(recording):
        if is_force:
            sink.add_force(stamp_ns, value)
        else:
            sink.add_displacement(stamp_ns, value, place)


def through(
    recording: Recording, parameters: Mapping[str, object]
) -> tuple[Pipeline, list[Output]]:
    """Return the pipeline after a recording, and all of its outputs."""
    pipeline, outputs = begun(parameters)
    feed(pipeline, recording)
    pipeline.finish()
    return pipeline, outputs


def last_of(kind: type[Kind], outputs: Sequence[Output]) -> Kind | None:
    """Return the last output of a kind."""
    return next((output for output in reversed(outputs) if isinstance(output, kind)), None)


def last_summaries(outputs: Sequence[Output]) -> dict[int, ContactSummary]:
    """Return the last summary of each contact: it may withdraw an earlier one."""
    return {o.contact_id: o for o in outputs if isinstance(o, ContactSummary)}


def presses_of(recording: Recording) -> list[tuple[float, float]]:
    """Return touch and release of each press [s]; contact lost for a moment is one press."""
    presses: list[tuple[float, float]] = []
    for contact in recording.truth["contacts"]:
        start, end = elapsed(contact["start_ns"]), elapsed(contact["end_ns"])
        if presses and start - presses[-1][1] < _SHORTEST_AIR:
            start, _ = presses.pop()
        presses.append((start, end))
    return presses


def outcome_of(recording: Recording, outputs: Sequence[Output]) -> Outcome:
    """Judge a pipeline's results for a recording, by the tissue of its first site."""
    site, presses = recording.truth["sites"][0], presses_of(recording)
    names = ("linear_stiffness", "nonlinear_stiffness")
    truth = np.array([*(math.log(site[name]) for name in names), site["fractional_order"]])
    live, claims = Flag.NONE, []
    for state in outputs:
        if isinstance(state, TissueState):
            live |= state.flags
            found = judged(state.estimate, truth, state.status is Status.CONVERGED, state.flags)
            if found.estimate is not None and found.claims:
                claims.append(found.is_off)
    summaries = last_summaries(outputs).values()
    contacts = tuple(_judged(summary, truth, presses) for summary in summaries)
    return Outcome(len(presses), contacts, share(claims), live)


def _judged(
    summary: ContactSummary, truth: Array, presses: Sequence[tuple[float, float]]
) -> Judged:
    start, end = elapsed(summary.start_ns), elapsed(summary.end_ns)
    overlaps = [min(end, release) - max(start, touch) for touch, release in presses]
    best = int(np.argmax(overlaps)) if overlaps else -1
    number = best if overlaps and overlaps[best] > -_SLACK else -1
    return judged(summary.estimate, truth, summary.converged, summary.flags, number)
