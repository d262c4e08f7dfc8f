# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Arrays through fden_ros.fit."""

from __future__ import annotations

import functools
import importlib.util
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import fden_ros
from fden_ros.core.outputs import Flag
from fden_ros.errors import InputError
from fden_ros.offline.replay import replay, result_object
from fden_ros.parameters import check, read_parameter_file
from fden_ros.report.numbers import plus_minus
from fden_ros.simulation import FdenModel
from simulation.closed_form import moves_of_knots, stress_of_moves

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PROBE = {"kind": "flat_punch", "area": 3.14e-4, "thickness": 0.02}


@functools.cache
def example():
    time, force, depth = np.loadtxt(EXAMPLES / "press.csv", delimiter=",", skiprows=1).T
    return time, force, 1e-3 * depth


@functools.cache
def fitted():
    return fden_ros.fit(*example(), geometry=PROBE)


def test_arrays_give_what_a_replay_gives_to_the_last_bit():
    replayed = replay(EXAMPLES / "press.csv", read_parameter_file(EXAMPLES / "probe.yaml"))
    assert len(replayed.summaries) == 2
    for contact, summary in zip(fitted().contacts, replayed.summaries, strict=True):
        estimate, stiffness = summary.estimate, summary.apparent_stiffness
        assert estimate is not None and stiffness is not None
        assert (estimate.linear_stiffness, estimate.linear_stiffness_sd) == contact.G
        assert contact.Gn == (estimate.nonlinear_stiffness, estimate.nonlinear_stiffness_sd)
        assert contact.alpha == (estimate.fractional_order, estimate.fractional_order_sd)
        assert contact.stiffness == (stiffness.value, stiffness.sd)
        assert np.array_equal(contact.covariance, estimate.covariance)


def test_arrays_and_a_table_from_0_s_on_keep_their_times():
    replayed = replay(EXAMPLES / "press.csv", read_parameter_file(EXAMPLES / "probe.yaml"))
    for contact, written in zip(
        fitted().contacts, result_object(replayed)["contacts"], strict=True
    ):
        ends = contact.samples[0][0], contact.samples[0][-1]
        assert (contact.start, contact.end) == ends
        assert (1e-9 * written["start_ns"], 1e-9 * written["end_ns"]) == pytest.approx(ends)


def test_threads_of_the_linear_algebra_change_no_bit():
    program = (
        "import sys, numpy as np, fden_ros\n"
        "time, force, depth = np.loadtxt(sys.argv[1], delimiter=',', skiprows=1).T\n"
        f"found = fden_ros.fit(time, force, 1e-3 * depth, geometry={PROBE})\n"
        "print([(one.G, one.Gn, one.alpha, one.stiffness) for one in found.contacts])\n"
    )
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "2")
    done = subprocess.run(
        [sys.executable, "-c", program, EXAMPLES / "press.csv"],
        capture_output=True, text=True, check=True, env={**os.environ, **threads},
    )  # fmt: skip
    one = [(one.G, one.Gn, one.alpha, one.stiffness) for one in fitted().contacts]
    assert done.stdout == f"{one}\n"


def test_a_prediction_is_the_law_of_the_contact():
    contact = fitted().contacts[0]
    time = np.linspace(0.0, 3.0, 1501)
    strains = 0.2 * np.minimum(time, 1.0)
    model = FdenModel(contact.G.value, contact.Gn.value, contact.alpha.value)
    moves = moves_of_knots(np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.2, 0.2]))
    expected = 3.14e-4 * stress_of_moves(moves, time, model)
    found = contact.predict((5.0 + time).tolist(), 0.02 * strains)
    assert found == pytest.approx(expected, rel=2e-3, abs=1e-4)


def test_what_is_not_known_is_nan():
    time, force, depth = (column[:1200] for column in example())
    contact = fden_ros.fit(time, force, depth).contacts[0]
    assert not contact.converged and math.isnan(contact.G.value)
    assert "GEOMETRY_UNSTATED" in contact.flags
    assert np.isnan(contact.predict([0.0, 1.0], [0.0, 0.001])).all()


def test_a_fit_is_printed_in_one_line_a_contact_with_stiffness_and_flags():
    first = fitted().contacts[0]
    shown = f"contact 1 at {first.start:g} s: {plus_minus(*first.stiffness)} N/m"
    assert repr(fitted()).splitlines()[:2] == ["contacts: 2, warnings: 0", shown]
    assert len(repr(fitted()).splitlines()) == 3
    summary = replace(first.summary, apparent_stiffness=None, flags=Flag.GAP, converged=False)
    unknown = repr(replace(first, summary=summary))
    assert unknown.endswith(" s: N/m not known, not converged, GAP")


def test_without_pandas_one_line_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=f"pandas: {sys.executable} -m pip install pandas"):
        fitted().to_dataframe()


@pytest.mark.skipif(importlib.util.find_spec("pandas") is None, reason="pandas is not installed")
def test_a_table_has_a_row_a_contact():
    table = fitted().to_dataframe()
    assert table["G"].tolist() == [contact.G.value for contact in fitted().contacts]
    assert table["converged"].all()


@pytest.mark.parametrize(
    "geometry", ["sphere", {"kind": "cube"}, {"kind": "sphere"}, {"radios": 0.005}]
)
def test_a_geometry_that_cannot_be_used_gets_one_sentence_everywhere(geometry, tmp_path):
    path, said = tmp_path / "probe.yaml", set()
    path.write_text(yaml.safe_dump({"/**": {"ros__parameters": {"geometry": geometry}}}))
    for use in (
        lambda: fden_ros.fit(*example(), geometry=geometry),
        lambda: check({"geometry": geometry}),
        lambda: read_parameter_file(path),
    ):
        with pytest.raises(InputError) as error:
            use()
        said.add(str(error.value).removeprefix(f"{path}: "))
    assert len(said) == 1 and "\n" not in said.pop()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"force": [1.0]}, "force has 1 samples"),
        ({"force": ["a"] * 2226}, "force is not an array of numbers"),
        ({"time": np.zeros(2226)}, "time does not increase at sample 1"),
        ({"displacement": np.full(2226, math.nan)}, "displacement has NaN"),
        ({"force": np.zeros((2226, 3))}, "force has the shape"),
        ({"prior": {"beta": 1.0}}, "prior.beta"),
    ],
)
def test_what_cannot_be_used_gets_one_line(change, words):
    given = dict(zip(("time", "force", "displacement"), example(), strict=True))
    with pytest.raises(InputError, match=words) as error:
        fden_ros.fit(**given | {"geometry": PROBE} | change)
    assert "\n" not in str(error.value)
