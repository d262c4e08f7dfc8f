# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is said of a contact, and where: stiffness in N/m, what is determined, flags, warnings."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from output_helpers import ESTIMATE, summary
from pipeline_helpers import identified, items_of, parameters_of, summaries_of
from rich.console import Console

from fden_ros.core.classification.classifier import ClassProbabilities
from fden_ros.core.estimation.estimate import ParameterSet
from fden_ros.core.outputs import ApparentStiffness, ContactSummary, Flag
from fden_ros.report.numbers import result
from fden_ros.report.table import contact_table
from simulation.scenario import Tissue, ramp_scenario
from simulation.simulate import simulate

ROOT = Path(__file__).parent.parent
TABLE = ROOT / "examples" / "press.csv"
PROBE = ROOT / "examples" / "probe.yaml"
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


# What the data determine


# The table


def printed(*contacts: ContactSummary) -> str:
    console = Console(width=80, record=True, file=Path("/dev/null").open("w"))  # noqa: SIM115
    console.print(contact_table(contacts))
    return console.export_text()


def test_the_table_with_flags_is_whole_in_80_columns() -> None:
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
    text = printed(flagged)
    assert "…" not in text
    for words in (
        *("12346 ± 1235", "8.000 ± 0.014", "0.130", "12.35 ± 0.06"),
        *("G known", "tissue", "changed", "origin", "uncertain", "unknown 94%"),
    ):
        assert words in text, text


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
