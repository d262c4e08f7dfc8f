# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the data determine is told for G, Gn and alpha each, and what noise hides is not."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pipeline_helpers import (
    identified,
    items_of,
    of_columns,
    off,
    parameters_of,
    states_of,
    summaries_of,
)
from property_helpers import first

from benchmark.changes import CASES, CHANGES, NOTHING, Change, Pressed, press, run_trial
from benchmark.real import Test as Measured
from benchmark.real import hold_order
from benchmark.real import identify as identify_measured
from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation import (
    KEYS,
    PUBLISHED,
    Estimate,
    EstimatorConfig,
    LawError,
    ParameterSet,
    Prior,
    StateIndex,
)
from fden_ros.core.outputs import ContactSummary, Flag, Output, TissueState
from fden_ros.offline.advice import findings
from fden_ros.offline.replay import contact_object
from fden_ros.offline.rows import contact_row
from fden_ros.report.table import status_words
from fden_ros.ros.messages import estimate_message, state_of, summary_message, summary_of
from fden_ros.simulation import FdenModel
from simulation.closed_form import stress_of_piecewise_linear_strain
from simulation.scenario import Tissue, ramp_scenario
from simulation.simulate import KNOWN_RIG, simulate

G = ParameterSet.LINEAR_STIFFNESS
ALPHA = ParameterSet.FRACTIONAL_ORDER
#: Of what the remarks are on.
CONFIG = PipelineConfig(None, estimator=EstimatorConfig(prior=Prior(fractional_order=0.31)))
LINEAR, BEYOND = (20000.0, 1.5, 0.2), (2000.0, 8.0, 0.2)


@cache
def pressed(
    tissue: tuple[float, float, float],
    noise: float = 3.0,
    stated: tuple[tuple[str, float], ...] = (),
) -> Sequence[Output]:
    """Return what the default prior makes of a press and hold of a tissue (G, Gn, alpha)."""
    sampled = {"rate_hz": 200.0, "noise_stress_pa": noise, "seed": 1}
    press = {"strain_rate": 0.4, "max_strain": 0.25, "hold_s": 1.5}
    recording = simulate(ramp_scenario(tissue=Tissue(*tissue), **press, **sampled))
    own = parameters_of(recording).items()
    parameters = {k: v for k, v in own if not k.startswith(("prior.", "alpha."))}
    return identified(items_of(recording), parameters | dict(stated))[1]


def summary_and_estimate(outputs: Sequence[Output]) -> tuple[ContactSummary, Estimate]:
    (summary,) = summaries_of(outputs)
    assert summary.estimate is not None
    return summary, summary.estimate


def in_contact(outputs: Sequence[Output]) -> list[TissueState]:
    return [state for state in states_of(outputs) if state.contact_id and state.signals]


@pytest.mark.parametrize(
    ("tissue", "noise"),
    [((30.0, 12.0, 0.1), 0.3), ((200000.0, 6.0, 0.32), 300.0), ((2000.0, 8.0, 1e-6), 3.0)],
    ids=["soft", "stiff", "elastic"],
)
def test_tissue_of_any_kind_is_identified_without_a_setting(tissue, noise):
    summary, estimate = summary_and_estimate(pressed(tissue, noise))
    assert summary.converged and not summary.flags
    assert estimate.observable == estimate.known == ParameterSet.ALL
    assert estimate.fractional_order >= 0.0
    assert np.all(np.abs(off(estimate, tissue)) < 4.0)


def test_of_near_linear_material_g_is_known_and_gn_is_said_not_to_be_observable():
    summary, estimate = summary_and_estimate(pressed(LINEAR, 20.0))
    assert not summary.converged and not summary.flags
    assert estimate.observable == estimate.known == G | ALPHA
    assert np.all(np.abs(off(estimate, LINEAR)[[0, 2]]) < 4.0)
    assert status_words(summary) == "G known"
    (said,) = map(str, findings(summary, CONFIG))
    assert said.startswith("G is known, Gn is not observable: the strain reached 0.2")
    assert "press deeper" not in said
    found = contact_object(summary)
    assert found["observable_parameters"] == ["linear_stiffness", "fractional_order"]
    assert found["converged_parameters"] == found["observable_parameters"]
    assert found["prior_limit_parameters"] == []


def test_every_published_number_of_an_estimate_is_in_the_messages_the_json_and_the_table():
    summary, estimate = summary_and_estimate(pressed(LINEAR, 20.0))
    law_error = LawError(0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
    estimate = estimate._replace(
        law_error=law_error, plateau_probability=0.9, known=G, at_edge=ALPHA
    )
    assert set(estimate.numbers) == set(PUBLISHED)
    summary = replace(summary, estimate=estimate)
    state = replace(in_contact(pressed(LINEAR, 20.0))[-1], estimate=estimate)
    sent = estimate_message(state, "probe"), summary_message(summary, "probe")
    for name, value in estimate.numbers.items():
        assert [getattr(message, name) for message in sent] == [value, value]
    for key, name in KEYS.items():
        assert contact_object(summary)[key] == contact_row(summary, None)[key]
        assert contact_object(summary)[key] == estimate.numbers[name]
    for heard in (state_of(sent[0]).estimate, summary_of(sent[1]).estimate):
        assert (heard.observable, heard.known, heard.at_edge) == (G | ALPHA, G, ALPHA)
    assert summary_of(sent[1]).estimate.numbers == pytest.approx(estimate.numbers, rel=1e-12)


def test_what_lies_at_an_end_of_its_prior_is_said_and_nothing_is_known():
    stated = (("prior.linear_stiffness", 100.0), ("prior.linear_stiffness_log_sd", 0.3))
    summary, estimate = summary_and_estimate(pressed(BEYOND, stated=stated))
    assert summary.flags & Flag.AT_PRIOR_LIMIT and not summary.converged
    assert estimate.at_edge == G and estimate.known == ParameterSet.NONE
    assert "at prior limit" in status_words(summary)
    said = " ".join(map(str, findings(summary, CONFIG)))
    assert "a limit of its prior" in said and "prior knowledge" not in said
    for state in in_contact(pressed(BEYOND, stated=stated)):
        assert bool(state.estimate.at_edge) == bool(state.flags & Flag.AT_PRIOR_LIMIT)
        assert not (state.estimate.at_edge and state.estimate.known)


# Presses whose force hardly leaves the noise: what noise hides is unknown, and no truth


@pytest.mark.parametrize("seed", first(0, 1, 2, 3, 4))
def test_a_touch_whose_linear_part_noise_hides_leaves_g_open_and_shows_gn(seed):
    """It ends at 2 Pa, under a noise of 6: G was up to 24 of its deviations off, and converged."""
    tissue, area, thickness = (60.0, 29.0, 0.15), 1e-4, 0.02
    times = np.arange(0.0, 5.9, 1.0 / 30.0) - 2.0
    strains = np.clip(0.1 * times, -0.3, 0.19)
    stresses = np.random.default_rng(seed).normal(0.0, 6.0, times.size)
    stresses += stress_of_piecewise_linear_strain(
        [0.0, 1.9], [0.0, 0.19], times, FdenModel(*tissue)
    )
    parameters = KNOWN_RIG | {"geometry.area": area, "geometry.thickness": thickness}
    columns = times + 2.0, area * stresses, thickness * strains
    summary, estimate = summary_and_estimate(of_columns(parameters, *columns)[1])
    assert ParameterSet.LINEAR_STIFFNESS not in estimate.known
    assert not summary.converged
    assert ParameterSet.NONLINEAR_STIFFNESS in estimate.observable
    assert estimate.deviations[1] < 0.1
    assert np.all(np.abs(off(estimate, tissue)) < 3.0)


def test_a_stated_alpha_is_reported_as_wrong_where_it_is():
    for wrong_by in (0.0, 0.15):
        stated = {"alpha.learn": False, "prior.alpha": BEYOND[2] + wrong_by}
        stated |= {"prior.alpha_sd": 0.01, "model_discrepancy.sd": 0.2}  # the default
        outputs = pressed(BEYOND, stated=tuple(stated.items()))
        summary, estimate = summary_and_estimate(outputs)
        assert (Flag.ALPHA_PRIOR_CONFLICT in summary.flags) == (wrong_by > 0.0)
    assert estimate.law_error is not None
    assert not estimate.knows(StateIndex.FRACTIONAL_ORDER)
    off = estimate.law_error.order - BEYOND[2]
    assert abs(off) < 3.0 * estimate.law_error.order_sd < 0.03


@pytest.mark.parametrize("seed", first(0, 1, 2))
def test_a_press_on_a_given_origin_that_is_found_late_begins_at_the_origin(seed):
    """A testing machine of 5 Hz: the motion begins a third of the time between two samples."""
    begin, ramp, depth, thickness = 2.35 / 5.0, 2.2, 0.25, 0.013
    times = np.arange(0.0, 12.0, 0.2)
    strains = np.clip((times - begin) / ramp, 0.0, 1.0) * depth
    forces = np.random.default_rng(seed).normal(0.0, 1e-3, times.size)
    forces += stress_of_piecewise_linear_strain(
        [0.0, begin, begin + ramp], [0.0, 0.0, depth], times, FdenModel(1.5, 11.5, 0.3)
    )
    test = Measured("made", "made", times, forces, thickness * strains, thickness)
    # Of the hold alone, by any curve.
    assert hold_order(test) == pytest.approx(0.3, abs=0.02)
    estimate = identify_measured(test)[1].estimate
    assert np.abs(off(estimate, (1.5, 11.5, 0.3))).max() < 3.0
    assert estimate.deviations[2] < 0.02


# A change of the tissue under the probe


SLIDE = next(change for change in CHANGES if change.kind == "slide")
DOUBLED = next(change for change in CHANGES if change.name == "inclusion 2")


@pytest.mark.parametrize(
    ("case", "change", "number"),
    [
        ("flat_30", SLIDE, 4),
        ("flat_500", SLIDE, 2),
        ("flat_30", DOUBLED, 4),
        ("sphere_500", DOUBLED, 5),
    ],
)
def test_a_change_is_reported_after_it_began(case, change, number):
    assert 0.0 <= run_trial((case, change.name), number) < 2.0


def changed_press(
    case: str,
    number: int,
    change: Change = NOTHING,
    forces: Callable[[Pressed], Array] = lambda own: own.forces,
) -> tuple[Pressed, list[Output]]:
    """Return a press, and the outputs of the pipeline."""
    row = CASES[case]
    own = press(row.geometry, row.rate_hz, change, number)
    parameters = {**row.parameters, **row.geometry.parameters}
    return own, of_columns(parameters, own.times, forces(own), own.displacements)[1]


def ramp_and_hold(seed: int, start: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times [s], forces [N] and displacements [m]; the latter from a strain of `start`.

    A tissue of another curve, x + 8 x^2, that relaxes by t^-0.3; from 3 s on the probe goes.
    """
    times = 0.01 * np.arange(1400)
    way = np.clip(start + 0.06 * (times - 3.0), start or -0.05, 0.36)
    strains = np.convolve(np.pad(way, 10, mode="edge"), np.ones(21) / 21, "valid")
    curve = np.maximum(strains, 0.0) + 8.0 * np.maximum(strains, 0.0) ** 2
    lags = np.diff((0.01 * np.arange(times.size + 1)) ** 0.7) / 0.01 / math.gamma(1.7)
    forces = 0.4 * np.convolve(np.diff(curve, prepend=0.0), lags)[: times.size]
    noise = 0.002 * np.random.default_rng(seed).standard_normal(times.size)
    return times, forces + noise, 0.02 * strains


SPECIMEN = KNOWN_RIG | {
    "geometry.kind": "flat_punch",
    "geometry.area": 1e-4,
    "geometry.thickness": 0.02,
}


@pytest.mark.parametrize("seed", [3, 4, 6])
def test_relaxation_of_a_tissue_of_another_curve_is_no_change(seed):
    outputs = of_columns(SPECIMEN, *ramp_and_hold(seed))[1]
    (summary,) = summaries_of(outputs)
    assert not summary.flags and summary.estimate.knows(StateIndex.FRACTIONAL_ORDER)
    assert abs(summary.estimate.fractional_order - 0.3) < 0.05


@pytest.mark.parametrize("start", [0.01, 0.02])
def test_preload_of_a_record_is_no_sign_that_the_tissue_does_not_relax(start):
    """It has pressed for 2 s before the record begins: its force is nearly constant."""
    times, forces, places = (column[200:] for column in ramp_and_hold(3, start))
    parameters = SPECIMEN | {"force.measure_bias": False, "origin.source": "given"}
    states = states_of(of_columns(parameters, times, forces, places - places[0])[1])
    assert not any(state.flags & Flag.TISSUE_CHANGED for state in states)
    assert abs(states[-1].estimate.fractional_order - 0.3) < 0.05


@pytest.mark.parametrize(("seconds", "is_changed"), [(0.06, False), (0.2, True)])
def test_a_brief_jerk_of_the_force_is_no_change(seconds, is_changed):
    def jerked(own: Pressed) -> Array:
        middle = own.times[own.forces.argmax()] + 0.3
        is_during = (own.times > middle) & (own.times < middle + seconds)
        return own.forces + 0.2 * own.forces.max() * is_during

    states = states_of(changed_press("flat_500", 2, forces=jerked)[1])
    assert any(state.flags & Flag.TISSUE_CHANGED for state in states) == is_changed


def test_nothing_is_known_once_the_tissue_has_changed():
    outputs = changed_press("flat_500", 1, SLIDE)[1]
    states = states_of(outputs)
    changed = [bool(state.flags & Flag.TISSUE_CHANGED) for state in states]
    first = changed.index(True)
    assert any(state.estimate and state.estimate.known for state in states[:first])
    assert not any(state.estimate and state.estimate.known for state in states[first:])


@pytest.mark.parametrize(
    ("case", "number"),
    [
        ("flat_30", 4),
        ("flat_500", 2),
        # All weight was at one value of alpha: it was known to 3e-17.
        ("sphere_500", 43),
    ],
)
def test_the_same_tissue_is_known_and_right(case, number):
    own, outputs = changed_press(case, number)
    states = states_of(outputs)
    assert not any(state.flags & Flag.TISSUE_CHANGED for state in states)
    (summary,) = summaries_of(outputs)
    estimate, tissue = summary.estimate, own.tissue
    assert estimate is not None and estimate.known == ParameterSet.ALL
    true = tissue.linear_stiffness, tissue.nonlinear_stiffness, tissue.fractional_order
    assert np.abs(off(estimate, true)).max() < 4.5
