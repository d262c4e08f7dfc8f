# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the benchmarks share, and a small run of each."""

from __future__ import annotations

import csv
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from command_helpers import answer

from benchmark import changes, exact, harness, invariance, laws, public, real, robots
from benchmark.exact import contact_bounds
from benchmark.score import Judged
from fden_ros.core.estimation import Estimate, ParameterSet
from fden_ros.core.outputs import Flag
from fden_ros.nodes.backlog import Backlog
from fden_ros.simulation import FdenModel
from simulation.closed_form import LinearMove, stress_of_piecewise_linear_strain

DEVIATION = np.array([0.01, 0.01, 0.002])


def judged(error=(0.0, 0.0, 0.0), *, flags=Flag.NONE, converged=True, number=0, sd=DEVIATION):
    everything = ParameterSet.ALL
    spread = np.diag(np.square(sd))
    estimate = Estimate(0.0, 2.0, 0.2, spread, 0, 0, 1, everything, everything, 100)
    return Judged(converged, flags, np.array(error), np.array(sd), number, estimate)


@pytest.fixture(autouse=True)
def one_process(monkeypatch):
    """Few trials take less time than processes take to begin."""
    monkeypatch.setattr(harness, "PROCESSES", 1)


def test_error_is_undetected_unless_a_flag_reports_it():
    off = (0.1, 0.0, 0.0)
    assert judged(off).is_undetected
    assert judged(off, flags=Flag.INPUT_REJECTED).is_undetected
    assert not judged(off, converged=False).is_undetected
    for flag in (Flag.MODEL_MISMATCH, Flag.TISSUE_CHANGED, Flag.TOUCH_NOT_OBSERVED, Flag.GAP):
        assert not judged(off, flags=flag).is_undetected


def test_bound_of_a_ramp_below_the_boundary_strain_is_the_analytic_one():
    # f = G v t^(1-alpha) / Gamma(2-alpha), df/dorigin = -G t^-alpha / Gamma(1-alpha).
    g, alpha, rate, noise, start = 500.0, 0.3, 0.05, 0.2, 1.0
    moves = [LinearMove(0.0, 2.5, -start * rate, 1.5 * rate)]
    stamps = np.arange(0.0025, 2.5, 5e-3)
    prior = np.array([0.3, 0.0, 0.0, math.inf, 0.01])
    found = contact_bounds(moves, FdenModel(g, 5.0, alpha), stamps, noise, prior)

    elapsed = stamps[stamps > start] - start
    rows = np.array(
        [
            g * rate * elapsed ** (1.0 - alpha) / math.gamma(2.0 - alpha),
            -g * elapsed**-alpha / math.gamma(1.0 - alpha),
            np.ones_like(elapsed),
        ]
    )
    total = rows @ rows.T / noise**2 + np.diag([0.3**-2, 0.0, 0.01**-2])
    expected = np.sqrt(np.linalg.inv(total).diagonal())
    # The derivative by the origin is singular at the touch: differences see it blunted.
    np.testing.assert_allclose(found[[0, 3, 4]], expected, rtol=0.01)
    assert found[1] == found[2] == 0.0


def benchmark(capsys, tmp_path, name, *arguments):
    """Run a benchmark and return its figures."""
    shown = answer(capsys, "benchmark", name, *arguments, "-o", tmp_path)
    assert shown == json.loads((tmp_path / f"{name}.json").read_text())
    names = [goal["name"] for goal in shown["goals"]]
    assert len(set(names)) == len(names)
    return shown["figures"]


@pytest.fixture
def small(monkeypatch, tables):
    for module, name, value in (
        (robots, "RATE_HZ", 100.0),
        (exact, "_QUICK_SAMPLES", 300),
        (laws, "GEOMETRIES", {"sphere": laws.GEOMETRIES["sphere"]}),
        (laws, "_OTHERS", {"kelvin_voigt": laws._OTHERS["kelvin_voigt"]}),
        (invariance, "CHANGES", {"stamps": invariance.CHANGES["stamps shifted"]}),
        (real, "_QUICK_TESTS", 3),
    ):
        monkeypatch.setattr(module, name, value)
    return tables


#: Of a small run of each: what follows from its words.
SMALL = {
    "exact --quick --contacts 1": lambda f: (
        f["bound"]["ln G"]["contacts"] == 1
        and f["rows"]["all"]["no estimate"][1] == f["rows"]["ramp"]["no estimate"][1] == 1
        and f["rows"]["rig known"]["undetected"] == [0, 1]
        and "palpation" not in f["rows"]
    ),
    # The plateau is contradicted; from the hold on no N/m is invented of it, or of a dashpot.
    "laws --quick --cases linear_solid_1": lambda f: (
        f["laws"]["standard linear solid, 1 s, testing machine"]["mismatch"] == [1, 1]
        and f["N/m"]["spring and dashpot, testing machine"]["known"][0] <= 2
        and f["N/m"]["standard linear solid, 1 s, testing machine"]["known"][0] <= 2
    ),
    "changes --cases flat_10 --contacts 1": lambda f: (
        [set(row) for row in f["rows"].values()] == [{change.name for change in changes.CHANGES}]
    ),
    "real {tables} --quick": lambda f: (
        f["materials"]["beef"]["error, median"] < 1.0 and f["materials"]["beef"]["in 95 %"] > 0.8
    ),
    "invariance --contacts 1": lambda f: (
        f["rigs"]["stamps"]["records"] == 1 and max(f["rigs"]["stamps"]["largest"]) < 1e-3
    ),
}


#: The others by make statistics.
OFTEN = "exact", "laws", "real"


@pytest.mark.parametrize(
    "words",
    [pytest.param(w, marks=[] if w.startswith(OFTEN) else pytest.mark.statistics) for w in SMALL],
)
def test_a_small_run_of_each_writes_its_figures(words, small, tmp_path, capsys):
    figures = benchmark(capsys, tmp_path, *words.format(tables=small).split())
    assert SMALL[words](figures)


def test_tissue_that_obeys_the_law_has_no_plateau_where_the_rig_is_better_than_stated():
    """Of an order of 0.56 and an arm's defaults, the noise of whose motion is overstated."""
    (contact,) = exact.run_trial(15, exact.LARGEST_SAMPLES).outcome.contacts[-1:]
    assert not contact.flags


def test_recordings_of_others_are_held_against_their_own_curves(capsys, tmp_path, monkeypatch):
    """Three springs between plates: what they are is their modulus, and their slope."""
    folder, generator = tmp_path / "others", np.random.default_rng(3)
    folder.mkdir()
    times = np.arange(0.0, 21.0, 0.1)
    rows, truths = ["test,time_s,force_N,displacement_mm"], []
    for name, spring in (("f_a", 1000.0), ("f_b", 2000.0), ("f_c", 3000.0)):
        depths = 0.2 * times
        forces = 1e-3 * spring * depths + generator.normal(0.0, 0.005, times.size)
        rows += [f"{name},{t},{f},{d}" for t, f, d in zip(times, forces, depths, strict=True)]
        truths.append(f"{name},{name},1e-3,0.02,{spring * 0.02 / 1e-3}")
    (folder / "springs.csv").write_text("\n".join(rows))
    heading = "test,phantom,area_m2,thickness_m,modulus_Pa"
    (folder / "springs_truth.csv").write_text("\n".join([heading, *truths]))
    monkeypatch.setattr(public, "STRAINS", (0.15,))
    (table,) = benchmark(capsys, tmp_path, "public", str(folder)).values()
    row = table["FDEN"]
    # A spring is a plateau too: where that is likelier, the law's N/m is withheld.
    assert row["given"][1] == 3
    assert row["given"][0] == 0 or abs(row["ratio, median"] - 1.0) < 0.1
    assert table["Kelvin-Voigt"]["given"] == [3, 3]
    assert abs(table["Kelvin-Voigt"]["ratio, median"] - 1.0) < 0.1
    assert {"Hunt-Crossley", "force over depth"} < set(table)


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """A folder with a table of two materials: soft and slow, stiff and quick."""
    rng, lines = np.random.default_rng(7), []
    for index in range(6):
        name, g, order = (("beef_x", 2.0, 0.32), ("silicone", 6.0, 0.1))[index % 2]
        model = FdenModel(g * math.exp(rng.normal(0, 0.1)), 8.0, order + rng.normal(0, 0.01))
        times = 0.1 * np.arange(80)
        strains = np.minimum(0.01 * np.arange(80), 0.3)
        forces = stress_of_piecewise_linear_strain(times, strains, times, model)
        forces += rng.normal(0.0, 1e-3, 80)
        lines += [
            (f"d/P{index} 1", name, t, f, 10.0 * x, 10.0)
            for t, f, x in zip(times, forces, strains, strict=True)
        ]
    folder = tmp_path_factory.mktemp("measured")
    with (folder / "tests.csv").open("w", newline="") as file:
        header = ("test", "material", "time_s", "force_N", "displacement_mm", "gap_mm")
        csv.writer(file).writerows([header, *lines])
    return folder


def test_a_backlog_is_worked_off_in_order_and_its_oldest_dropped_and_counted():
    read, coming = [], [[(b"%d" % number, number) for number in range(30_000)]]
    inputs = SimpleNamespace(add=lambda stream, value, received: read.append(value))
    backlog = Backlog(inputs, is_restamped=False)
    backlog.add("force", lambda: coming.pop() if coming else [], float)
    backlog.work()
    while backlog.waiting:
        backlog.work()
    assert backlog.dropped["force"] == 10_000
    assert read == list(range(10_000, 30_000))
    assert backlog.received["force"] == 20_000
    assert backlog.received_ns == 29_999
