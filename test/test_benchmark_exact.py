# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The benchmark of tissue that obeys the law: what is drawn, counted and written."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from fden_ros.benchmarks import exact_contacts as contacts
from fden_ros.benchmarks.exact import figures_of, goals_of, one_sided, read_findings, report_of
from fden_ros.benchmarks.exact_contacts import Finding, drawn, find, parameters_of, scenario_of
from fden_ros.cli import main
from fden_ros.errors import InputError
from fden_ros.simulation.simulate import EXACT, simulate

DRAWN = [drawn(number) for number in range(48)]
DEVIATION = [0.01, 0.01, 0.002]


def finding(number=0, *, error=(0.01, 0.0, 0.0), **changes):
    described = {
        "rig": contacts.RIGID,
        "motion": "ramp",
        "linear_stiffness": 500.0,
        "nonlinear_stiffness": 8.0,
        "fractional_order": 0.13,
        "hold_s": 0.0,
        "rate_hz": 100.0,
        "noise_pa": 3.0,
        "signal_to_noise": 50.0,
    }
    given = Finding(
        number=number,
        largest_samples=1000,
        drawn=described,
        presses=1,
        contacts=1,
        with_estimate=1,
        converged=1,
        silent=0,
        mismatch=False,
        changed=False,
        live_mismatch=False,
        live_changed=False,
        claims=10,
        wrong_claims=0,
        flags=[],
        error=list(error),
        deviation=DEVIATION,
    )
    return replace(given, **changes)


@pytest.mark.parametrize("contact", DRAWN, ids=lambda contact: str(contact.number))
def test_what_is_drawn_is_within_what_is_stated(contact):
    model = contact.model
    for value, (low, high) in (
        (model.linear_stiffness, contacts.LINEAR_STIFFNESS),
        (model.nonlinear_stiffness, contacts.NONLINEAR_STIFFNESS),
        (model.fractional_order, contacts.ORDER),
        (contact.noise_pa, contacts.NOISE_PA),
        (contact.rate_hz, contacts.RATE_HZ),
    ):
        assert low * (1.0 - 1e-9) <= value <= high * (1.0 + 1e-9)
    assert contact.signal_to_noise >= contacts.SIGNAL_TO_NOISE
    assert contact.signal_to_noise * contact.noise_pa <= contacts.LARGEST_STRESS
    assert contact.held_s <= contacts.HOLD_S[1]
    if contact.prior:
        off = math.log(contact.prior["prior.linear_stiffness"] / model.linear_stiffness)
        assert abs(off) <= contacts.PRIOR_OFF * contact.prior["prior.linear_stiffness_log_sd"]
    assert contact == drawn(contact.number)


def test_every_motion_meets_every_rig_and_both_kinds_of_prior():
    pairs = {(contact.press.kind, contact.rig) for contact in DRAWN}
    assert pairs == {(m, rig) for m in contacts.MOTIONS for rig in (contacts.RIGID, contacts.ARM)}
    assert {bool(contact.prior) for contact in DRAWN} == {True, False}
    assert max(contact.held_s for contact in DRAWN) > 100.0


def test_long_holds_are_sampled_slowly_but_never_below_the_slowest_rate():
    rates = [drawn(number, 100).rate_hz for number in range(4, 12)]
    assert rates == pytest.approx([contacts.RATE_HZ[0]] * 8)
    for contact in DRAWN:
        assert contact.held_s * contact.rate_hz <= max(
            contacts.LARGEST_SAMPLES, contacts.RATE_HZ[0] * contacts.HOLD_S[1]
        )


def test_identifier_is_told_the_rig_and_not_the_noise():
    rigid, arm = (next(c for c in DRAWN if c.rig == rig) for rig in (contacts.RIGID, contacts.ARM))
    own = parameters_of(rigid, simulate(scenario_of(rigid)))
    assert own["displacement.compliance_sd"] == 0.0 and "model_error.sd" not in own
    others = parameters_of(arm, simulate(scenario_of(arm)))
    assert not set(EXACT) & set(others)
    assert not {"force.noise", "alpha.learn"} & (set(own) | set(others))


def test_contact_is_found_and_its_truth_is_the_drawn_one():
    found = find(1, 1000)
    assert found == find(1, 1000)
    assert (found.presses, found.contacts, found.with_estimate) == (1, 1, 1)
    assert np.all(np.abs(found.error) < 5.0 * np.array(found.deviation))
    assert json.loads(json.dumps(found.json_object())) == found.json_object()


def test_counts_are_of_contacts_and_claims_of_states():
    findings = [
        finding(0),
        finding(1, mismatch=True, live_mismatch=True),
        finding(2, live_changed=True),
        finding(3, silent=1, wrong_claims=5, error=(0.1, 0.0, 0.0)),
        finding(4, error=(), deviation=[], contacts=0, with_estimate=0, converged=0),
    ]
    row = figures_of(findings)
    assert (row["mismatch"], row["changed"]) == (1, 0)
    assert (row["live_mismatch"], row["live_changed"]) == (1, 1)
    assert (row["silent"], row["without_estimate"]) == (1, 1)
    assert row["live_wrong"] == pytest.approx(5 / 50)
    assert row["rms"]["ln G"] == pytest.approx(math.sqrt((3 * 1.0 + 100.0) / 4))
    assert row["coverage"]["ln G"] == 0.75
    report = report_of(findings)
    assert [alarm["number"] for alarm in report.figures["alarms"]] == [1, 2, 3]
    rows = report.figures["rows"]
    assert rows["linear part seen"]["contacts"] == 5 and "linear part hidden" not in rows


def test_limits_of_a_share_are_exact():
    assert one_sided(0, 3000) == (0.0, pytest.approx(1.0 - 0.05 ** (1.0 / 3000.0)))
    assert one_sided(7, 7)[1] == 1.0
    assert one_sided(7, 7)[0] == pytest.approx(0.05 ** (1.0 / 7.0))


def test_goal_is_met_by_three_thousand_without_an_alarm_and_no_fewer():
    name = "false alarms: told as mismatch or change"
    met = [
        next(goal.met for goal in goals_of([finding()] * count) if goal.name == name)
        for count in (1000, 3000)
    ]
    assert met == [None, True]
    alarmed = [finding(mismatch=True)] * 10 + [finding()] * 990
    assert next(goal.met for goal in goals_of(alarmed) if goal.name == name) is False


def benchmark(capsys, *arguments):
    assert main(["benchmark", "exact", *map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_run_goes_on_where_another_one_ended(tmp_path, capsys):
    own = ("--samples", 300, "--jobs", 1, "-o", tmp_path)
    benchmark(capsys, "--first", 0, "--contacts", 2, *own)
    path = tmp_path / "exact.jsonl"
    first, second = path.read_text().splitlines()
    changed = json.loads(first) | {"mismatch": True}
    # The second line is cut short, as by a run that was stopped.
    path.write_text(json.dumps(changed) + "\n" + second[:40])
    shown = json.loads(benchmark(capsys, "--contacts", 3, "--resume", "--json", *own))
    assert shown["figures"]["contacts"] == 3
    assert shown["figures"]["rows"]["all"]["mismatch"] == 1 + sum(
        json.loads(line)["mismatch"] for line in path.read_text().splitlines()[1:]
    )
    assert [found.number for found in read_findings(path)] == [0, 1, 2]
    assert (tmp_path / "exact.png").read_bytes().startswith(b"\x89PNG")


def test_file_of_something_else_is_refused(tmp_path):
    path = tmp_path / "exact.jsonl"
    path.write_text('{"number": 1}\n{}\n')
    with pytest.raises(InputError, match="line 1 is not a contact"):
        read_findings(path)


@pytest.mark.parametrize("arguments", [("--contacts", "0"), ("--first", "-1"), ("--jobs", "0")])
def test_bad_arguments_end_in_one_line(arguments, tmp_path, capsys):
    assert main(["benchmark", "exact", *arguments, "-o", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert "at least 1" in error and error.count("\n") == 1
