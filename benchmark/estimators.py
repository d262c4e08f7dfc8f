# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Estimators that answer questions about recordings of others: FDEN, and those of others."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmark.measured import Test
from benchmark.peers import PEERS, Peer, Samples, last_value, linear_fractional, relaxation_order
from benchmark.questions import ALPHA, FORCE, STIFFNESS, TIME_SCALE, Answer, Question
from benchmark.real import foretell
from benchmark.trial import fed
from fden_ros.core.outputs import ContactSummary, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.experiments.relaxation import fit_relaxation
from fden_ros.parameters import check, pipeline_config
from simulation.simulate import KNOWN_RIG

#: The size of a small motion in parts of the depth [1].
_STEP = 1e-4
#: Samples that the estimators of others are given at most [1].
_MOST_SAMPLES = 500
_AT_STEP = np.array([0.1, 0.5, 1.0])

Estimator = Callable[[Question], Answer]


def fden(question: Question) -> Answer:
    """Answer by the pipeline, on a rig that is known; of a relaxation by ``fden fit``."""
    if question.asked != ALPHA:
        return _by_pipeline(question, "stress")
    seen = question.seen
    alpha = fit_relaxation(seen.times[1:], seen.forces[1:], 1.0).parameters["alpha"]
    return question.answer(alpha.value, alpha.sd)


def papers_filter(question: Question) -> Answer:
    """Answer by the paper's filter, whose alpha is that of the prior."""
    if question.asked == ALPHA:
        return question.answer()
    return _by_pipeline(question, "fractional_stress")


def _by_pipeline(question: Question, observation: str) -> Answer:
    observed = {"estimator.observation": observation}
    if question.asked == FORCE:
        _, prediction = foretell(_hold_of(question), observed)
        return question.answer(prediction.value, prediction.sd)
    parameters = (
        KNOWN_RIG
        | observed
        | {
            "geometry.kind": "flat_punch",
            "geometry.area": question.area,
            "geometry.thickness": question.thickness,
            "force.measure_bias": False,
            "origin.source": "given",
            "plausibility.max_force": 1e6,
        }
    )
    outputs: list[Output] = []
    pipeline = Pipeline(pipeline_config(check(parameters)), outputs.append)
    seen = question.seen
    for _ in fed(pipeline, seen.times, seen.forces, seen.depths - seen.depths[0]):
        pass
    pipeline.finish()
    # Of a press that is over what its summary says, else what is known last.
    kinds = ContactSummary if question.is_over else (TissueState, ContactSummary)
    known = [o.apparent_stiffness for o in outputs if isinstance(o, kinds) and o.contact_id]
    found = known[0 if question.is_over else -1] if known else None
    return question.answer() if found is None else question.answer(found.value, found.sd)


def _hold_of(question: Question) -> Test:
    """Return the hold whose rest is asked for, and not known."""
    seen = question.seen
    return Test(
        question.name,
        "",
        np.append(seen.times, question.times),
        np.append(seen.forces, np.full(question.times.size, math.nan)),
        np.append(seen.depths, question.depths),
        question.thickness,
    )


def of_peer(peer: Peer, question: Question) -> Answer:
    """Answer by what another estimator predicts."""
    if question.asked == STIFFNESS and peer is not last_value:
        return question.answer(_small_step(peer, question))
    if question.asked == FORCE:
        return question.answer(
            peer(question.seen, Samples(question.times, question.depths, question.depths))
        )
    if question.asked == ALPHA and peer is linear_fractional:
        return question.answer(relaxation_order(question.seen.times[1:], question.seen.forces[1:]))
    return question.answer()


def _small_step(peer: Peer, question: Question) -> float:
    """Return the N/m that a small step would meet."""
    seen = question.seen
    if question.is_over:
        # Of the whole contact up to its deepest point.
        stop = int(np.argmax(seen.depths)) + 1
        seen = Samples(*(values[:stop] for values in seen))
    seen = _thinned(seen)
    times, depth = seen.times[-1] + TIME_SCALE * _AT_STEP, float(seen.depths[-1])
    step = _STEP * depth
    forces = [
        peer(seen, Samples(times, np.full(times.size, at), np.zeros(times.size)))[-1]
        for at in (depth, depth + step)
    ]
    return float(forces[1] - forces[0]) / step


def _thinned(seen: Samples) -> Samples:
    """Return some of the samples, the last among them: some estimators take their square."""
    every = slice(None, None, -(-seen.times.size // _MOST_SAMPLES))
    return Samples(*(values[::-1][every][::-1] for values in seen))


def force_over_depth(question: Question) -> Answer:
    """Answer by the largest force over the largest depth."""
    if question.asked != STIFFNESS:
        return question.answer()
    return question.answer(float(question.seen.forces.max() / question.seen.depths.max()))


ESTIMATORS: dict[str, Estimator] = {
    "FDEN": fden,
    "the paper's filter": papers_filter,
    "force over depth": force_over_depth,
    **{name: partial(of_peer, peer) for name, peer in PEERS.items()},
}


def answers_of(question: Question) -> dict[str, Answer]:
    """Return the answer of every estimator."""
    return {name: answer(question) for name, answer in ESTIMATORS.items()}
