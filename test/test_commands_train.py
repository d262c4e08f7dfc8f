# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""fden train: from labelled bags and tables to a library, and back into a replay."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
import yaml
from pipeline_helpers import LIVER_FILE

from fden_ros.cli import main
from fden_ros.tissues.library import load_library
from simulation.bag import write_recording
from simulation.scenario import Tissue, ramp_scenario
from simulation.simulate import simulate

CLASSES = {"liver": (6.3, 2.1, 0.13), "muscle": (7.3, 2.3, 0.2)}
HEADER = ("tissue", "specimen", "g", "g_sd", "g_n", "g_n_sd", "alpha", "alpha_sd")


def rows(specimens=6, each=2, seed=0):
    rng = np.random.default_rng(seed)
    found = []
    for name, mean in CLASSES.items():
        for specimen in range(specimens):
            middle = rng.normal(mean, [0.2, 0.1, 0.01])
            for _ in range(each):
                g, g_n = np.exp(rng.normal(middle[:2], 0.05))
                order = rng.normal(middle[2], 0.005)
                found.append((name, specimen, g, 0.03 * g, g_n, 0.03 * g_n, order, 0.004))
    return found


def written(path, body, header=HEADER):
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([header, *body])
    return path


def train(capsys, *arguments):
    code = main(["train", *map(str, arguments)])
    shown = capsys.readouterr()
    return code, shown.out, shown.err


def test_table_becomes_a_library_with_a_check_and_priors(tmp_path, capsys):
    table, library = written(tmp_path / "table.csv", rows()), tmp_path / "library.yaml"
    priors = ("--prior", "liver=3", "--prior", "muscle=1", "--unknown", "0.2")
    code, out, _ = train(capsys, table, "-o", library, *priors)
    assert code == 0
    assert "liver" in out and "error 0.0%" in out and "12 specimens" in out
    found = load_library(library)
    assert found.class_names == ("liver", "muscle", "unknown")
    for tissue in found.tissues:
        off = np.abs(tissue.mean - CLASSES[tissue.name])
        assert np.all(off < [0.3, 0.15, 0.02])
    assert [round(one.prior, 4) for one in found.classes] == [0.6, 0.2, 0.2]
    assert found.units == "Pa"


def test_answer_in_json_has_check_warnings_and_what_was_left_out(tmp_path, capsys):
    body = [(row[0], "", *row[2:], i % 4 != 0, "") for i, row in enumerate(rows())]
    table = written(tmp_path / "table.csv", body, (*HEADER, "converged", "flags"))
    code, out, _ = train(capsys, table, "-o", tmp_path / "l.yaml", "--json")
    answer = json.loads(out)
    assert code == 0 and answer["contacts"] == 18
    assert answer["left_out"] == {"not converged": 6}
    assert answer["check"]["left_out"] == "one contact at a time: no specimen is named"
    assert any("no specimen is named for liver, muscle" in line for line in answer["warnings"])


def test_prior_of_the_estimator_is_taken_out_of_results(tmp_path, capsys):
    # Contacts that showed as much as the prior knew: the truth lies twice as far from it.
    log_sd, mean = 0.3, math.log(520.0)
    body = []
    for specimen in range(8):
        g = math.exp(mean + 0.4)
        sd = log_sd / math.sqrt(2.0)
        body.append(("a", specimen, g, sd * g, 8.4, 0.05 * 8.4, 0.131, 0.002, "prior"))
    header = (*HEADER, "alpha_source")
    path = written(tmp_path / "results.csv", body, header)
    assert train(capsys, path, "-o", tmp_path / "l.yaml", "--config", LIVER_FILE)[0] == 0
    found = load_library(tmp_path / "l.yaml").tissues[0]
    assert found.mean[0] == pytest.approx(mean + 0.8, abs=0.05)


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Two bags of one site each, and parameters with a wide prior."""
    folder = tmp_path_factory.mktemp("bags")
    for name, g in (("soft", 450.0), ("stiff", 1500.0)):
        scenario = ramp_scenario(
            strain_rate=0.4, max_strain=0.22, hold_s=0.3, rate_hz=200.0, seed=1,
            tissue=Tissue(g, 8.0, 0.13),
        )  # fmt: skip
        write_recording(simulate(scenario), folder / name)
    return folder, changed(folder / "soft" / "identifier.yaml", folder / "probe.yaml", **{
        "prior": {"linear_stiffness_log_sd": 1.0}
    })  # fmt: skip


def changed(path, other, **changes):
    """Write a parameter file with other values to another path, and return that."""
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    (section,) = content.values()
    for name, values in changes.items():
        section["ros__parameters"].setdefault(name, {}).update(values)
    other.write_text(yaml.safe_dump(content), encoding="utf-8")
    return other


def test_labelled_bags_become_a_library_that_a_replay_uses(bags, tmp_path, capsys):
    folder, config = bags
    library = tmp_path / "library.yaml"
    sources = [f"soft/one={folder / 'soft'}", f"stiff/two={folder / 'stiff'}"]
    code, out, _ = train(capsys, *sources, "--config", config, "-o", library, "--json")
    answer = json.loads(out)
    assert code == 0 and answer["contacts"] == 2
    assert any("soft has a single specimen" in line for line in answer["warnings"])
    assert load_library(library).geometry == "flat_punch"
    recorded = yaml.safe_load(library.read_text(encoding="utf-8"))["geometry"]
    assert recorded["thickness"] == 0.02 and recorded["area"] == pytest.approx(math.pi * 1e-4)

    chosen = changed(config, tmp_path / "chosen.yaml", classifier={"library": str(library)})
    assert main(["replay", str(folder / "stiff"), "--config", str(chosen), "--json"]) == 0
    (contact,) = json.loads(capsys.readouterr().out)["contacts"]
    assert contact["label"] == "stiff"
    assert contact["probabilities"]["stiff"] > 0.7
    assert 0.05 < contact["typicality"] <= 1.0
    assert 0.12 < contact["decision_strain"] <= 0.23
    assert 0.2 < contact["decision_time"] < 1.5


@pytest.mark.parametrize(
    ("header", "body", "words"),
    [
        (HEADER[1:], [row[1:] for row in rows()], "which tissue is it? Add a column tissue"),
        (
            ("label", *HEADER[1:]),
            rows(),
            "its column label is what the classifier said, not the truth",
        ),
        (("tissue", "g", "g_n"), [("a", 1, 2)], "column g_sd is missing"),
        (HEADER, [("", *rows()[0][1:])], "row 1: tissue is empty"),
        (HEADER, [("a", 1, 500, 0, 8, 0.2, 0.1, 0.01)], "must be positive"),
    ],
)
def test_mistake_in_a_table_is_told_in_one_line(tmp_path, capsys, header, body, words):
    table = written(tmp_path / "t.csv", body, header)
    code, _, error = train(capsys, table, "-o", tmp_path / "l.yaml")
    assert code == 1
    assert words in error and error.count("\n") == 1
