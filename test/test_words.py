# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is said of a contact, and where: stiffness in N/m, what is determined, flags, warnings."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from output_helpers import ESTIMATE, summary
from pipeline_helpers import identified, items_of, parameters_of, summaries_of
from rich.console import Console

from fden_ros.cli import main
from fden_ros.core.classification.classifier import ClassProbabilities
from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation.estimate import ParameterSet
from fden_ros.core.estimation.estimator_config import EstimatorConfig, Prior
from fden_ros.core.outputs import ApparentStiffness, ContactSummary, Flag, OrderSource
from fden_ros.core.pipeline import Pipeline
from fden_ros.offline.remarks import remarks
from fden_ros.offline.replay import replay
from fden_ros.offline.results import replay_to_bag
from fden_ros.parameters import check, pipeline_config, read_parameter_file
from fden_ros.recording.reader import BagReader, decode
from fden_ros.recording.source import Selection
from fden_ros.recording.table import Columns
from fden_ros.report.numbers import plus_minus, result
from fden_ros.report.table import contact_table
from fden_ros.simulation.scenario import Tissue, ramp_scenario
from fden_ros.simulation.simulate import simulate

ROOT = Path(__file__).parent.parent
PRESS = ROOT / "bags" / "golden" / "golden_press"
TABLE = ROOT / "examples" / "press.csv"
PROBE = ROOT / "examples" / "probe.yaml"
COLUMNS = "time_s,force_N,depth_mm*1e-3"
#: Of what the remarks are on.
CONFIG = PipelineConfig(None, estimator=EstimatorConfig(prior=Prior(fractional_order=0.131)))
#: Of the simulated probe.
AREA, THICKNESS = math.pi * 0.01**2, 0.02


def pressed(
    nonlinear_stiffness: float,
    max_strain: float,
    seed: int,
    changes: dict[str, object] | None = None,
) -> ContactSummary:
    scenario = ramp_scenario(
        strain_rate=0.2,
        max_strain=max_strain,
        hold_s=0.5,
        tissue=Tissue(577.0, nonlinear_stiffness, 0.131),
        rate_hz=250.0,
        seed=seed,
    )
    recording = simulate(scenario)
    _, outputs = identified(items_of(recording), parameters_of(recording) | (changes or {}))
    (contact,) = summaries_of(outputs)
    return contact


# The apparent stiffness


def test_the_apparent_stiffness_of_a_contact_is_that_of_the_truth_at_its_deepest_point() -> None:
    contact = pressed(8.5, 0.25, 3, {"estimate.time_scale": 0.5})
    found = contact.apparent_stiffness
    assert found is not None and found.time_scale == 0.5
    tangent = 577.0 * math.exp(8.5 * 0.25 - 1.0) * 0.5**-0.131 / math.gamma(1.0 - 0.131)
    true = tangent * AREA / THICKNESS
    assert abs(found.value - true) < 4.0 * found.sd
    assert found.sd < 0.02 * true


def test_the_apparent_stiffness_is_in_the_json_the_bag_of_results_and_the_table_of_the_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = str(PRESS / "identifier.yaml")
    out, table, page = (str(tmp_path / name) for name in ("out", "contacts.csv", "page.html"))
    assert main(["replay", str(PRESS), "--config", config, "--json", "-o", out]) == 0
    contacts = json.loads(capsys.readouterr().out)["contacts"]
    palpation = "/identifier/palpation"
    messages = [decode(message) for message in BagReader(out).messages([palpation])]
    assert main(["report", str(PRESS), "--config", config, "--csv", table, "-o", page]) == 0
    rows = Path(table).read_text().splitlines()
    columns = rows[0].split(",")
    for contact, message, row in zip(contacts, messages, rows[1:], strict=True):
        cells = dict(zip(columns, row.split(","), strict=True))
        assert contact["apparent_stiffness"] > 0.0 < contact["apparent_stiffness_sd"]
        assert contact["apparent_stiffness_time_scale"] == 0.1
        for key in (
            *("apparent_stiffness", "apparent_stiffness_sd"),
            "apparent_stiffness_time_scale",
        ):
            assert getattr(message, key) == contact[key] == float(cells[key])
        shown = plus_minus(contact["apparent_stiffness"], contact["apparent_stiffness_sd"])
        assert shown in Path(page).read_text()
        known = ["linear_stiffness", "nonlinear_stiffness"]
        assert contact["converged_parameters"][:2] == known
        assert cells["converged_parameters"].split()[:2] == known
        assert message.converged_parameters & ParameterSet.NONLINEAR_STIFFNESS


# What the data determine


def test_of_material_that_is_linear_so_far_g_is_known_and_gn_is_not() -> None:
    contact = pressed(1.0, 0.08, 0)
    assert not contact.converged
    estimate = contact.estimate
    assert estimate is not None
    known = estimate.known & ParameterSet.STIFFNESS
    assert known is ParameterSet.LINEAR_STIFFNESS
    assert abs(estimate[0] - math.log(577.0)) < 4.0 * estimate.deviations[0]
    (text,) = (text for text in remarks(contact, CONFIG) if "Gn" in text)
    assert "Gn is not observable" in text and "G is known" in text
    assert "press deeper" not in text


def test_an_alpha_that_is_not_the_prior_s_is_not_called_prior_knowledge() -> None:
    unlearned = ParameterSet.STIFFNESS
    estimate = ESTIMATE._replace(fractional_order=0.01, valid=unlearned, known=unlearned)
    contact = summary(estimate=estimate, order_source=OrderSource.PRIOR)
    (text,) = remarks(contact, CONFIG)
    assert "0.010 ± 0.010" in text and "prior 0.131" in text
    assert "is prior knowledge" not in text


# The table


def printed(*contacts: ContactSummary, truth: dict[int, dict[str, float]] | None = None) -> str:
    console = Console(width=80, record=True, file=Path("/dev/null").open("w"))  # noqa: SIM115
    console.print(contact_table(contacts, truth))
    return console.export_text()


def test_the_table_with_the_truth_and_flags_is_whole_in_80_columns() -> None:
    flagged = summary(
        contact_id=12,
        site_id=12,
        converged=False,
        flags=Flag.TISSUE_CHANGED | Flag.ORIGIN_UNCERTAIN,
        estimate=ESTIMATE._replace(
            log_linear_stiffness=math.log(12345.6),
            covariance=np.diag([0.01, 0.00175**2, 0.0001]),
            known=ParameterSet.LINEAR_STIFFNESS,
        ),
        apparent_stiffness=ApparentStiffness(12.354, 0.062, 0.1),
        classes=ClassProbabilities("unknown", ("liver", "unknown"), (0.06, 0.94)),
    )
    truth = {12: {"linear_stiffness": 12000.0, "nonlinear_stiffness": 8.0}}
    text = printed(flagged, truth=truth)
    assert "…" not in text
    for words in (
        *("12346 ± 1235", "true 12000", "8.000 ± 0.014", "true 8.00", "0.130", "12.35 ± 0.06"),
        *("G known", "tissue", "changed", "origin", "uncertain", "unknown 94%"),
    ):
        assert words in text, text


def test_numbers_of_any_size_stay_short() -> None:
    for value, deviation in ((1e181, 1e180), (8e20, 1.8e23), (4.4e-4, 2e-4), (10.0064, 0.0076)):
        text = plus_minus(value, deviation, 4)
        assert len(text) <= 20, text
    assert plus_minus(460.05, 52.66, 4) == "460 ± 53"
    assert plus_minus(10.0064, 0.0004, 4) == "10.01 ± 0.0004"


# Rejections that are usual


def test_the_first_samples_without_a_partner_are_no_reason_to_warn() -> None:
    pipeline = Pipeline(pipeline_config(check({})), lambda output: None)
    pipeline.reject("force", "unpaired")
    pipeline.reject("force", "unpaired")
    assert pipeline.unusual_rejections == 0
    pipeline.reject("force", "unpaired")
    pipeline.reject("force", "spike")
    assert pipeline.unusual_rejections == 2
    assert pipeline.rejected.total() == 4


def test_a_replay_does_not_warn_of_what_is_usual(tmp_path: Path) -> None:
    lines = TABLE.read_text().splitlines()
    parameters = read_parameter_file(PROBE)
    # Displacement that comes 8 ms late leaves the first forces without a partner.
    late = parameters.changed({"displacement.delay": -0.008})
    table = tmp_path / "air.csv"
    table.write_text("\n".join(lines[:200]))
    result = replay(table, late, Selection(columns=Columns.parse(COLUMNS)))
    assert 0 < result.rejected["force.unpaired"] <= 2
    assert not any("rejected" in text for text in result.warnings)


# Results of a table


def test_the_rows_of_a_table_go_into_the_bag_of_results_and_replay_alike(tmp_path: Path) -> None:
    parameters = read_parameter_file(PROBE).changed(
        {"force.inverted": True, "displacement.inverted": True}
    )
    selection = Selection(columns=Columns.parse("time_s,force_N*-1,depth_mm*-1e-3"))
    out = tmp_path / "results"
    of_table = replay_to_bag(TABLE, parameters, selection, out, with_inputs=True)
    assert len(of_table.summaries) == 2
    topics = {topic.name: topic for topic in BagReader(out).topics}
    for name in ("/force", "/displacement"):
        assert topics[name].message_count == 2226
    of_bag = replay(out, parameters)
    assert of_bag.inputs == {"force": "/force", "displacement": "/displacement"}
    for one, other in zip(of_table.summaries, of_bag.summaries, strict=True):
        assert one.estimate is not None and other.estimate is not None
        assert one.estimate.mean.tolist() == other.estimate.mean.tolist()
        assert replace(one, estimate=None, classes=None, stamp_ns=0) == replace(
            other, estimate=None, classes=None, stamp_ns=0
        )


def test_the_words_on_what_cannot_be_are_whole_beside_numbers_of_any_size() -> None:
    impossible = summary(
        converged=False,
        flags=Flag.IMPLAUSIBLE | Flag.ESTIMATE_AT_EDGE,
        estimate=ESTIMATE._replace(
            log_linear_stiffness=math.log(0.022),
            covariance=np.diag([1.2, 0.0005, 0.0001]),
            known=ParameterSet.NONE,
            valid=ParameterSet.STIFFNESS,
        ),
        apparent_stiffness=ApparentStiffness(1.46e7, 1.5e7, 0.1),
    )
    text = printed(impossible)
    assert "…" not in text and "e+07" not in text
    assert "implausible" in text and "undetermined" in text


# What is no result is not printed as one


@pytest.mark.parametrize(
    ("value", "deviation", "is_of_data", "words"),
    [
        (47.4, 4.1, True, "47.4 ± 4.1"),
        (609.0, 322.0, False, "(609 ± 322)"),
        (239.0, 250.0, True, "below 1400"),  # 239 exp(1.645 250/239) = 1336
        (0.31, 0.31, True, "below 1.7"),
        (239.0, 708.0, True, "–"),
    ],
)
def test_a_number_as_large_as_its_deviation_is_a_bound_or_nothing(
    value: float, deviation: float, is_of_data: bool, words: str
) -> None:
    assert result(value, deviation, is_of_data=is_of_data) == words


def test_table_puts_what_the_prior_says_in_brackets() -> None:
    open_ = ESTIMATE._replace(
        covariance=np.diag([1.2, 0.04, 0.0001]), valid=ParameterSet.LINEAR_STIFFNESS
    )
    contact = summary(estimate=open_, apparent_stiffness=ApparentStiffness(40.0, 44.0, 0.1))
    text = printed(contact)
    assert "below 3" in text and "(8.0 ± 1.6)" in text and "± 5" not in text
    assert "below 250" in printed(contact)
