# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is said of a contact, and where: stiffness, what is determined, flags, messages."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from command_helpers import text_of
from pipeline_helpers import ESTIMATE, Item, identified, items_of, off, summaries_of, summary
from property_helpers import first

from fden_ros.advice import FLAGS
from fden_ros.core.classification import ClassProbabilities
from fden_ros.core.config import PipelineConfig
from fden_ros.core.law import ApparentStiffness, FlatPunch
from fden_ros.core.outputs import ContactSummary, Decided, Flag, Phase, Status, TissueState
from fden_ros.core.report import apparent_stiffness_of
from fden_ros.core.stiffness import MeasuredSlope, Slopes
from fden_ros.offline.advice import findings
from fden_ros.parameters import check, pipeline_config
from fden_ros.recording.message_types import decoder, serialize
from fden_ros.report.numbers import result
from fden_ros.report.table import contact_table, status_words
from fden_ros.ros.messages import (
    estimate_message,
    state_of,
    summary_message,
    summary_of,
    type_name,
)
from simulation.scenario import DisplacementSensor, ForceSensor, Geometry, Scenario, Site, Tissue
from simulation.simulate import simulate
from simulation.trajectory import RampHold


@pytest.mark.parametrize(
    ("value", "deviation", "is_of_data", "words"),
    [
        (47.4, 4.1, True, "47.4 ± 4.1"),
        (609.0, 322.0, False, "(610 ± 320)"),
        (239.0, 250.0, True, "below 1,400"),  # 239 exp(1.645 250/239) = 1336
        (0.31, 0.31, True, "below 1.7"),
        (239.0, 708.0, True, "–"),
        (0.131, 3e-17, True, "0.131"),  # alpha as given, from moments of the nodes
    ],
)
def test_a_number_as_large_as_its_deviation_is_a_bound_or_nothing(
    value, deviation, is_of_data, words
):
    assert result(value, deviation, is_of_data=is_of_data) == words


CLASSES = ClassProbabilities("liver", ("liver", "unknown"), (0.9, 0.1), 0.4)
COVARIANCE = np.array([[4e-4, -1e-4, 0.0], [-1e-4, 4e-4, 1e-6], [0.0, 1e-6, 1e-6]])
SUMMARY = summary(
    flags=Flag.MODEL_MISMATCH, classes=CLASSES, estimate=ESTIMATE._replace(covariance=COVARIANCE)
)


def test_summary_comes_back_from_its_message():
    sent = replace(SUMMARY, decided=Decided(0.8, 0.21))
    back = summary_of(summary_message(sent, "probe"))
    assert back.classes == CLASSES
    assert back.decided == sent.decided


def test_what_is_not_known_is_nan_in_the_decoded_messages():
    """As PlotJuggler and Foxglove decode them: by the definition, and NaN is a gap."""
    state = TissueState(1, Status.NO_CONTACT, Flag.NONE, 0, 0, Phase.APPROACH)
    assert state_of(estimate_message(state, "probe")) == state
    bare = replace(SUMMARY, estimate=None, classes=None, position=None, apparent_stiffness=None)
    known = {"lag", "max_strain", "max_stress", "max_force"}
    for message in (estimate_message(state, "probe"), summary_message(bare, "probe")):
        decoded = decoder(type_name(type(message)))(serialize(message))
        kinds = message.get_fields_and_field_types()
        numbers = {n for n, kind in kinds.items() if kind.startswith("double")}
        numbers -= {n for n in numbers if kinds[n].startswith("sequence")} | known
        assert len(numbers) > 20
        assert {n for n in numbers if not np.isnan(getattr(decoded, n)).all()} == set()
    assert np.isnan(decoded.position.x)


@pytest.mark.parametrize("flags", [Flag.IMPLAUSIBLE | Flag.TOUCH_NOT_OBSERVED, Flag(4095)])
def test_the_table_wraps_no_word_at_80_columns(flags):
    slopes = Slopes(MeasuredSlope(1620.3, 115.2, 0.00372, 0), None)
    stiff = ApparentStiffness(1047.8, 105.1, 0.1)
    one = replace(SUMMARY, flags=flags, classes=None, measured=slopes, apparent_stiffness=stiff)
    contacts = [one, replace(one, contact_id=112, flags=Flag.NONE)]
    text = text_of(contact_table(contacts), 80)
    assert set(status_words(one).split()) <= set(text.split())
    assert "1,050 ± 110" in text and "1,600 at 3.7" in text


RADIUS = 0.01


PROBE = {"geometry.area": math.pi * RADIUS**2, "geometry.thickness": 0.02}


def samples(g: float, press: RampHold, noise: float, rate: float) -> list[Item]:
    """Return the samples of a press of tissue."""
    scenario = Scenario(
        seed=1,
        geometry=Geometry(radius_m=RADIUS, thickness_m=0.02),
        sites=(Site(tissue=Tissue(g, 8.5, 0.131), presses=(press,)),),
        force=ForceSensor(rate_hz=rate, noise_n=noise),
        displacement=DisplacementSensor(rate_hz=rate, noise_m=5e-6),
    )
    return items_of(simulate(scenario))


def contact_of(items: list[Item], parameters: dict[str, float]) -> ContactSummary:
    (contact,) = summaries_of(identified(items, parameters)[1])
    return contact


def test_every_flag_of_an_estimate_has_its_sentence_and_its_remedy():
    config = PipelineConfig(None, geometry=FlatPunch(math.pi * RADIUS**2, 0.02))
    # Rejected samples are counted, and a limit of the prior is named by its parameter.
    for flag in set(Flag) - {Flag.INPUT_REJECTED, Flag.AT_PRIOR_LIMIT}:
        found = list(findings(summary(flags=flag), config))
        assert found == [FLAGS[flag.name]] and found[0].remedy
    assert not list(findings(summary(), config))


@pytest.mark.parametrize("delay", first(0.06, 0.03))
def test_a_long_delay_converges_once_it_is_stated_and_is_not_wrong_before(delay):
    items = samples(450.0, RampHold(0.2, 0.3, 1.5), 2e-3, 200.0)
    late = [i._replace(stamp_ns=i.stamp_ns + round(delay * 1e9 * i.stream)) for i in items]
    late.sort(key=lambda item: item.stamp_ns)
    truth = 450.0, 8.5, 0.131
    contact = contact_of(late, PROBE)
    assert not contact.converged
    if contact.flags & (Flag.MODEL_MISMATCH | Flag.RIG_PRIOR_CONFLICT):
        assert "delay" in next(findings(contact, pipeline_config(check(PROBE)))).remedy
    assert np.all(np.abs(off(contact.estimate, truth)) < 2.0)
    contact = contact_of(late, PROBE | {"displacement.delay": delay})
    assert not contact.flags and abs(off(contact.estimate, truth)[0]) < 2.0


def test_a_hidden_surface_leaves_the_slope_of_the_force():
    # Along the ridge of a hidden origin ln G - Gn o is known.
    gn, origin = ESTIMATE.nonlinear_stiffness, 0.4
    along = np.array([gn * origin, 0.0, 0.0])
    hidden = ESTIMATE._replace(
        covariance=ESTIMATE.covariance + np.outer(along, along),
        with_origin=tuple((along * origin).tolist()),
        contact_point_sd=origin,
    )
    geometry = FlatPunch(math.pi * RADIUS**2, 0.02)
    seen, open_ = (apparent_stiffness_of(e, geometry, 0.3, 0.0, 0.1) for e in (ESTIMATE, hidden))
    assert seen is not None and open_ is not None
    assert hidden.deviations[0] > 2.0
    assert open_.value == seen.value
    assert open_.sd == pytest.approx(seen.sd)
    moved = ESTIMATE._replace(contact_point=0.1)
    assert apparent_stiffness_of(moved, geometry, 0.4, 0.0, 0.1).value == pytest.approx(seen.value)
    # Below 1/Gn the slope is that of G, and known as well.
    of_g = ESTIMATE._replace(covariance=np.diag([0.01, 0.0, 0.0]))
    below = apparent_stiffness_of(of_g, geometry, 0.1, 0.0, 0.1)
    assert below is not None and below.sd == pytest.approx(0.1 * below.value)
    assert apparent_stiffness_of(hidden, geometry, 0.1, 0.0, 0.1) is None


def test_where_a_source_is_stated_as_none_the_variance_loses_its_part_or_more():
    shallow = samples(2000.0, RampHold(0.1, 0.06, 1.0), 0.002, 100.0)
    budget = contact_of(shallow, PROBE).budget
    without = contact_of(shallow, PROBE | {"force.drift_sd": 0.0}).budget
    assert budget is not None and without is not None
    for index in range(2):
        total = sum(part[index] for part in budget.parts.values())
        assert total == pytest.approx(budget.variances[index])
    # More, because the data are weighed anew.
    part, left = budget.parts["drift"][0], without.variances[0]
    assert 0.2 * budget.variances[0] < part < budget.variances[0] - left
    assert without.parts["drift"][0] < 1e-3 * left
