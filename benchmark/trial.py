# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings through the pipeline, and its results compared with the truth."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from benchmark.score import Judged, Outcome, judged, share, warns
from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.outputs import ContactSummary, Flag, Output, Status, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams import NANOSECONDS, Position, Synchronizer
from simulation.simulate import START_NS, Recording

#: Presses are apart by at least this [s]; contact lost for a shorter time is the same press.
_SHORTEST_AIR = 0.15
#: A summary belongs to a press that it overlaps, give or take this [s].
_SLACK = 0.05


def elapsed(stamp_ns: int) -> float:
    """Return the time since the beginning of a simulated recording [s]."""
    return (stamp_ns - START_NS) / NANOSECONDS


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
    """Feed all samples of a simulated recording by stamp."""
    for is_force, stamp_ns, value, place in samples_of(recording):
        if is_force:
            sink.add_force(stamp_ns, value)
        else:
            sink.add_displacement(stamp_ns, value, place)


def through(recording: Recording, config: PipelineConfig) -> tuple[Pipeline, list[Output]]:
    """Return the pipeline after a recording, and all of its outputs."""
    outputs: list[Output] = []
    pipeline = Pipeline(config, outputs.append)
    feed(pipeline, recording)
    pipeline.finish()
    return pipeline, outputs


def last_summaries(outputs: Sequence[Output]) -> dict[int, ContactSummary]:
    """Return the last summary of each contact: it may withdraw an earlier one."""
    return {o.contact_id: o for o in outputs if isinstance(o, ContactSummary)}


def truth_of(recording: Recording, number: int = 0) -> Array:
    """Return the true (ln G, ln Gn, alpha) of a site, shape (3,)."""
    site = recording.truth["sites"][number]
    g, g_n = site["linear_stiffness"], site["nonlinear_stiffness"]
    return np.array([math.log(g), math.log(g_n), site["fractional_order"]])


def presses_of(recording: Recording) -> list[tuple[float, float]]:
    """Return touch and release of each press [s]; contact lost for a moment is one press."""
    presses: list[tuple[float, float]] = []
    for contact in recording.truth["contacts"]:
        start, end = elapsed(contact["start_ns"]), elapsed(contact["end_ns"])
        if presses and start - presses[-1][1] < _SHORTEST_AIR:
            presses[-1] = (presses[-1][0], end)
        else:
            presses.append((start, end))
    return presses


def outcome_of(recording: Recording, outputs: Sequence[Output]) -> Outcome:
    """Judge a pipeline's results for a recording."""
    truth, presses = truth_of(recording), presses_of(recording)
    states = [output for output in outputs if isinstance(output, TissueState)]
    live = Flag.NONE
    claims = []
    for state in states:
        live |= state.flags
        is_claim = state.status is Status.CONVERGED and not warns(state.flags)
        if state.estimate is not None and is_claim:
            claims.append(judged(state.estimate, truth, True, state.flags).is_off)
    return Outcome(
        presses=len(presses),
        contacts=tuple(_judged(s, truth, presses) for s in last_summaries(outputs).values()),
        claims=share(claims),
        live=live,
    )


def _judged(
    summary: ContactSummary, truth: Array, presses: Sequence[tuple[float, float]]
) -> Judged:
    start, end = elapsed(summary.start_ns), elapsed(summary.end_ns)
    overlaps = [min(end, release) - max(start, touch) for touch, release in presses]
    best = int(np.argmax(overlaps)) if overlaps else -1
    number = best if overlaps and overlaps[best] > -_SLACK else -1
    return judged(summary.estimate, truth, summary.converged, summary.flags, number)
