# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the data determine is told for G, Gn and alpha each, with the default prior."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pipeline_helpers import identified, items_of, parameters_of, summaries_of
from rich.console import Console

from benchmark.measured import Test as Measured
from benchmark.measured import identify as identify_measured
from fden_ros.control.live_tissue import LiveTissue, Refusal
from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation.estimate import KEYS, PUBLISHED, Estimate, LawError, ParameterSet
from fden_ros.core.estimation.estimator_config import EstimatorConfig, Prior
from fden_ros.core.outputs import ContactSummary, Flag, Output, TissueState
from fden_ros.offline.remarks import remarks
from fden_ros.offline.replay import contact_object
from fden_ros.offline.rows import contact_row
from fden_ros.report.numbers import plus_minus
from fden_ros.report.table import contact_table, status_words
from fden_ros.ros.messages import estimate_message, state_of, summary_message, summary_of
from simulation.scenario import Tissue, ramp_scenario
from simulation.simulate import simulate

G = ParameterSet.LINEAR_STIFFNESS
ALPHA = ParameterSet.FRACTIONAL_ORDER
#: Of what the remarks are on.
CONFIG = PipelineConfig(None, estimator=EstimatorConfig(prior=Prior(fractional_order=0.31)))
LINEAR, ELASTIC = (20000.0, 1.5, 0.2), (2000.0, 8.0, 1e-6)


@cache
def pressed(tissue: tuple[float, float, float], noise: float = 3.0) -> Sequence[Output]:
    """Return what the default prior makes of a press and hold of a tissue (G, Gn, alpha)."""
    scenario = ramp_scenario(
        strain_rate=0.4,
        max_strain=0.25,
        hold_s=1.5,
        tissue=Tissue(*tissue),
        rate_hz=200.0,
        noise_stress_pa=noise,
        seed=1,
    )
    recording = simulate(scenario)
    stated = parameters_of(recording).items()
    parameters = {k: v for k, v in stated if not k.startswith(("prior.", "alpha."))}
    return identified(items_of(recording), parameters)[1]


def summary_and_estimate(outputs: Sequence[Output]) -> tuple[ContactSummary, Estimate]:
    (summary,) = summaries_of(outputs)
    assert summary.estimate is not None
    return summary, summary.estimate


def states_of(outputs: Sequence[Output]) -> list[TissueState]:
    return [x for x in outputs if isinstance(x, TissueState) and x.contact_id and x.signals]


def off(estimate: Estimate, tissue: tuple[float, float, float]) -> np.ndarray:
    """Return the errors of ln G, ln Gn and alpha in their deviations."""
    truth = np.array([math.log(tissue[0]), math.log(tissue[1]), tissue[2]])
    return (estimate.mean - truth) / estimate.deviations


@pytest.mark.parametrize(
    ("tissue", "noise"),
    [
        ((30.0, 12.0, 0.1), 0.3),
        ((545.0, 8.5, 0.131), 3.0),
        ((15000.0, 20.0, 0.45), 100.0),
        ((200000.0, 6.0, 0.32), 300.0),
    ],
)
def test_tissue_of_any_kind_is_identified_without_a_setting(
    tissue: tuple[float, float, float], noise: float
) -> None:
    summary, estimate = summary_and_estimate(pressed(tissue, noise))
    assert summary.converged and not summary.flags
    assert estimate.valid == estimate.known == ParameterSet.ALL
    assert np.all(np.abs(off(estimate, tissue)) < 4.0)


def test_of_near_linear_material_g_is_known_and_gn_is_said_not_to_be_observable() -> None:
    summary, estimate = summary_and_estimate(pressed(LINEAR, 20.0))
    assert not summary.converged and not summary.flags
    assert estimate.valid == estimate.known == G | ALPHA
    assert np.all(np.abs(off(estimate, LINEAR)[[0, 2]]) < 4.0)
    assert status_words(summary) == "G known"
    (said,) = remarks(summary, CONFIG)
    assert said.startswith("G is known, Gn is not observable: the strain reached 0.2")
    assert "press deeper" not in said
    found = contact_object(summary)
    assert found["valid_parameters"] == ["linear_stiffness", "fractional_order"]
    assert found["converged_parameters"] == found["valid_parameters"]
    assert found["edge_parameters"] == []
    console = Console(width=120, record=True)
    console.print(contact_table([summary]))
    shown = console.export_text()
    g, gn = (
        plus_minus(value, deviation, 4)
        for value, deviation in (
            (estimate.linear_stiffness, estimate.linear_stiffness_sd),
            (estimate.nonlinear_stiffness, estimate.nonlinear_stiffness_sd),
        )
    )
    assert f"({gn})" in shown and f" {g}" in shown and "in brackets" in shown


def test_every_published_number_of_an_estimate_is_in_the_messages_the_json_and_the_table() -> None:
    states = states_of(pressed(LINEAR, 20.0))
    summary, estimate = summary_and_estimate(pressed(LINEAR, 20.0))
    estimate = estimate._replace(
        law_error=LawError(0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8),
        mismatch_probability=0.9,
        known=G,
        at_edge=ALPHA,
    )
    assert set(estimate.numbers) == set(PUBLISHED)
    summary = replace(summary, estimate=estimate)
    sent = (
        estimate_message(replace(states[-1], estimate=estimate), "probe"),
        summary_message(summary, "probe"),
    )
    for name, value in estimate.numbers.items():
        assert [getattr(message, name) for message in sent] == [value, value]
    for key, name in KEYS.items():
        assert contact_object(summary)[key] == contact_row(summary, None)[key]
        assert contact_object(summary)[key] == estimate.numbers[name]
    for heard in (state_of(sent[0]).estimate, summary_of(sent[1]).estimate):
        assert (heard.valid, heard.known, heard.at_edge) == (G | ALPHA, G, ALPHA)
    assert summary_of(sent[1]).estimate.numbers == pytest.approx(estimate.numbers, rel=1e-12)


def test_a_consumer_that_needs_g_alone_has_it_of_near_linear_material() -> None:
    default, linear = LiveTissue(), LiveTissue(required=G)
    for state in states_of(pressed(LINEAR, 20.0)):
        now = state.stamp_ns * 1e-9
        default.add(state, now)
        linear.add(state, now)
    assert default.reading(now) is None
    assert default.refusal(now) is Refusal.NOT_OBSERVABLE
    reading = linear.reading(now)
    assert reading is not None and reading.linear_stiffness == pytest.approx(20000.0, rel=0.1)
    value, deviation = reading.stiffness(0.1)
    assert 0.0 < deviation < 0.2 * value
    # What stiffens how is not known: nothing is predicted.
    assert linear.predictor(now) is None


def test_an_elastic_material_is_at_the_edge_of_alpha_and_never_converged() -> None:
    summary, estimate = summary_and_estimate(pressed(ELASTIC))
    assert summary.flags & Flag.ESTIMATE_AT_EDGE and not summary.converged
    assert estimate.at_edge == ALPHA and estimate.known == ParameterSet.NONE
    assert "estimate at edge" in status_words(summary)
    said = " ".join(remarks(summary, CONFIG))
    assert "an end of the range of alpha" in said and "prior knowledge" not in said
    for state in states_of(pressed(ELASTIC)):
        assert state.estimate is not None
        assert bool(state.estimate.at_edge) == bool(state.flags & Flag.ESTIMATE_AT_EDGE)
        assert not (state.estimate.at_edge and state.estimate.known)


@pytest.mark.parametrize("toe", [0.0, 0.5])
def test_alpha_is_that_of_the_relaxation_whatever_the_curve(toe: float) -> None:
    """A curve stiffer at small strain, as beef's, would make of an alpha of 0.3 one of 0.39."""
    times, fine = np.arange(0.0, 16.0, 0.1), np.arange(0.0, 16.005, 0.01)
    strains = 0.08 * np.minimum(fine, 4.0)
    law = np.where(strains < 0.125, strains, 0.125 * np.exp(8.0 * strains - 1.0))
    response = law * (1.0 + toe * np.exp(-((strains / 0.1) ** 2)))
    since = np.maximum(times[:, None] - fine, 0.0) ** 0.7
    forces = (since[:, :-1] - since[:, 1:]) @ np.diff(response)
    forces = forces / forces.max() + np.random.default_rng(0).normal(0.0, 1e-3, times.size)
    depths = 0.02 * 0.08 * np.minimum(times, 4.0)
    test = Measured("simulated", "beef", times, forces, depths, 0.02)
    estimate, _, summary = identify_measured(test)
    assert summary is not None and estimate.converged and not summary.flags
    assert estimate.knows(2)
    assert abs(estimate.fractional_order - 0.3) < 2.5 * estimate.fractional_order_sd
