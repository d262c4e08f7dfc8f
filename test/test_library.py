# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Libraries of tissues: from YAML, learned from contacts, and by `fden train`."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from pipeline_helpers import refusal

import fden_ros.offline.labelled as labelled
from fden_ros.cli import main
from fden_ros.core.classification import UNKNOWN, log_evidence, posterior
from fden_ros.errors import InputError
from fden_ros.offline.labelled import Source, read_source
from fden_ros.offline.replay import replay
from fden_ros.parameters import check, pipeline_config, read_parameter_file
from fden_ros.tissues.library import load_library, parse_library
from fden_ros.tissues.training import check as checked
from fden_ros.tissues.training import contacts_of, learn, library_of, library_text
from simulation.bag import write_recording
from simulation.scenario import Tissue, ramp_scenario
from simulation.simulate import simulate

# Tissue libraries from YAML


MOMENTS = {
    "linear_stiffness": {"mean": 544.8, "sd": 155.3},
    "nonlinear_stiffness": {"mean": 8.547, "sd": 1.604},
    "fractional_order": {"mean": 0.131, "sd": 0.011},
}


def content(**changes):
    return {
        "format": 1,
        "name": "mine",
        "tissues": [{"name": "liver", **MOMENTS}],
        "unknown": {"prior": 0.1, **MOMENTS},
    } | changes


def written(tmp_path, data):
    path = tmp_path / "tissues.yaml"
    path.write_text(data if isinstance(data, str) else yaml.safe_dump(data), encoding="utf-8")
    return path


def test_built_in_library_has_the_moments_of_table_ii():
    (liver,) = load_library().tissues
    assert liver.name == "liver"
    for mean, variance, expected in zip(
        liver.mean[:2],
        np.diag(liver.covariance)[:2],
        ((544.8, 155.3), (8.547, 1.604)),
        strict=True,
    ):
        # Moments of the log-normal distribution.
        average = math.exp(mean + variance / 2)
        assert average == pytest.approx(expected[0], rel=1e-12)
        assert average * math.sqrt(math.expm1(variance)) == pytest.approx(expected[1], rel=1e-12)
    assert liver.mean[2] == pytest.approx(0.131)
    assert liver.covariance[2, 2] == pytest.approx(0.011**2)


LEARNED = {
    "mean": [6.3, 2.1, 0.13],
    "covariance": [[0.08, 0.01, 0.0], [0.01, 0.04, 0.0], [0.0, 0.0, 1e-4]],
    "degrees_of_freedom": 7,
}


def learned_with(**changes):
    return content(format=2, tissues=[{"name": "liver", "distribution": LEARNED | changes}])


def liver_with(**changes):
    return content(tissues=[{"name": "liver", **MOMENTS} | changes])


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ("tissues: [", "not valid YAML"),
        (content(format=3), "newer"),
        (content(tissues=[]), "at least one"),
        (content(tissues=[{"name": "a", **MOMENTS}] * 2), "must differ"),
        (content(tissues=[{"name": "unknown", **MOMENTS}]), "unknown"),
        (content(unknown=None), "needs `unknown`"),
        (liver_with(linear_stiffness={"mean": 500.0}), "`linear_stiffness: sd` is None"),
        (liver_with(nonlinear_stiffness={"mean": 0, "sd": 1}), "must be a positive number"),
        (liver_with(fractional_order={"mean": math.nan, "sd": 1}), "must be a positive number"),
        (liver_with(prior=-1), "`prior` is -1"),
        (learned_with(mean=[1.0, 2.0]), "must be (ln G, ln Gn, alpha)"),
        (learned_with(covariance=[[1, 2, 0], [2, 1, 0], [0, 0, 1]]), "positive definite"),
        (learned_with(covariance=[[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]), "symmetric"),
        (content(format=2, units="psi"), "must be Pa or N"),
    ],
)
def test_mistake_is_told_in_one_line_with_the_file(tmp_path, data, said):
    path = written(tmp_path, data)
    message = refusal(load_library, path)
    assert said in message and str(path) in message


# Units and geometry


def parameters(path="", **geometry):
    values = {f"geometry.{name}": value for name, value in geometry.items()}
    return check({"classifier.library": str(path), **values})


@pytest.mark.parametrize(("units", "area"), [("N", 1e-4), ("Pa", 1.0)])
def test_library_of_other_units_is_refused(tmp_path, units, area):
    path = written(tmp_path, content(format=2, units=units))
    with pytest.raises(InputError, match=f"G is in {units} s\\^alpha, but the estimates"):
        pipeline_config(parameters(path, area=area))


def test_built_in_library_is_left_out_where_it_does_not_fit():
    assert pipeline_config(parameters(area=1.0)).library is None
    assert pipeline_config(parameters()).library.name == "paper"


# Libraries learned from labelled contacts


MEAN = np.array([6.3, 2.1, 0.13])
BETWEEN = np.diag(np.square([0.25, 0.15, 0.015]))
WITHIN = np.diag(np.square([0.12, 0.10, 0.008]))
SHIFT = np.array([1.2, 0.1, 0.08])


def drawn(rng, *, classes=2, specimens=20, each=3, error=(0.05, 0.05, 0.005), named=True):
    """Contacts of classes SHIFT apart, with estimation errors of very different size."""
    tissues, names, means, covariances = [], [], [], []
    for index in range(classes):
        for specimen in range(specimens):
            middle = rng.multivariate_normal(MEAN + index * SHIFT, BETWEEN)
            for _ in range(each):
                covariance = np.diag(np.square(np.array(error) * rng.uniform(0.2, 2.0, 3)))
                value = rng.multivariate_normal(middle, WITHIN)
                means.append(rng.multivariate_normal(value, covariance))
                covariances.append(covariance)
                tissues.append("abc"[index])
                names.append(str(specimen) if named else "")
    return contacts_of(tissues, names, np.array(means), np.array(covariances))


def test_estimation_error_is_taken_out():
    rng = np.random.default_rng(0)
    found = []
    for _ in range(4):
        # Errors as large as the spread itself.
        spreads = learn(drawn(rng, specimens=40, error=(0.3, 0.2, 0.02)))
        found += [(np.diag(one.between), np.diag(one.within)) for one in spreads.values()]
    between, within = np.mean(found, axis=0)
    # Uncorrected the whole would be 2.3 times too large.
    np.testing.assert_allclose(between + within, np.diag(BETWEEN + WITHIN), rtol=0.3)
    np.testing.assert_allclose(between, np.diag(BETWEEN), rtol=0.4)


def test_prediction_from_few_specimens_is_the_golden_one():
    learned = learn(drawn(np.random.default_rng(5), specimens=4, each=2))
    prediction = learned["a"].tissue("a")
    spread = np.sqrt(np.diag(prediction.covariance))
    np.testing.assert_allclose(spread, [0.35448, 0.22486, 0.014351], rtol=1e-3)
    assert prediction.degrees_of_freedom == 7.0


@pytest.mark.statistics
def test_library_from_few_specimens_is_calibrated():
    rng = np.random.default_rng(5)
    said, right = [], []
    for _ in range(40):
        library = library_of(learn(drawn(rng, specimens=4, each=2)), unknown_prior=0.001)
        fresh = drawn(rng, specimens=25, each=1)
        probabilities = posterior(library, log_evidence(library, fresh.likelihood)[0])
        said.append(probabilities.max(axis=1))
        truth = np.array(fresh.tissues) == "b"
        right.append(probabilities.argmax(axis=1) == truth)
    said, right = np.concatenate(said), np.concatenate(right)
    assert abs(np.mean(said) - np.mean(right)) < 0.025


# The check


def test_check_leaves_out_specimens_not_contacts():
    rng = np.random.default_rng(6)
    # Every specimen has a place of its own, and classes do not differ: only the specimen tells.
    tissues, names, means = [], [], []
    for index in range(16):
        middle = rng.normal(MEAN, [0.8, 0.3, 0.03])
        for _ in range(6):
            tissues.append("ab"[index % 2])
            names.append(str(index))
            means.append(rng.normal(middle, [0.01, 0.01, 0.001]))
    covariance = np.broadcast_to(np.diag(np.square([0.01, 0.01, 0.001])), (96, 3, 3))
    contacts = contacts_of(tissues, names, np.array(means), covariance)
    result = checked(contacts, learn(contacts))
    assert 0.25 < np.mean(result.errors) < 0.9
    low, high = result.interval()
    assert low < 0.5 < high


# The file


def test_library_that_was_written_is_read_again():
    rng = np.random.default_rng(9)
    contacts = drawn(rng)
    spreads = learn(contacts)
    library = library_of(spreads, "mine", {"a": 3.0}, 0.2, "N", "flat_punch")
    text = library_text(
        library, spreads, contacts, checked(contacts, spreads), {"kind": "flat_punch"}
    )
    again = parse_library(text, "text")
    assert (again.name, again.units, again.geometry) == ("mine", "N", "flat_punch")
    assert again.class_names == ("a", "b", UNKNOWN)
    for one, other in zip(library.classes, again.classes, strict=True):
        np.testing.assert_allclose(one.mean, other.mean, rtol=1e-8)
        np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-8)
        assert one.degrees_of_freedom == other.degrees_of_freedom
        assert one.prior == pytest.approx(other.prior, rel=1e-5)
    for tissue in library.tissues:
        wider = library.unknown.covariance - tissue.covariance
        assert np.linalg.eigvalsh(wider)[0] > 0.0
    assert library.tissues[0].prior == pytest.approx(3.0 * library.tissues[1].prior)
    content = yaml.safe_load(text)
    assert content["tissues"][0]["trained_on"] == {"contacts": 60, "specimens": 20}
    assert content["check"]["contacts"] == 120


# fden train: from labelled recordings to a library, and back into a replay


def train(capsys, *arguments):
    code = main(["train", *map(str, arguments)])
    shown = capsys.readouterr()
    return code, shown.out, shown.err


def learned_from(monkeypatch, contacts):
    """Let the recordings hold these contacts."""
    monkeypatch.setattr(labelled, "read_source", lambda *arguments: contacts)


def test_contacts_become_a_library_with_a_check_and_priors(tmp_path, capsys, monkeypatch):
    learned_from(monkeypatch, drawn(np.random.default_rng(0), specimens=6, each=2))
    library = tmp_path / "library.yaml"
    priors = ("--prior", "a=3", "--prior", "b=1", "--unknown", "0.2")
    code, out, _ = train(capsys, "a=here", "-o", library, *priors)
    assert code == 0
    assert "error 0.0%" in out and "12 specimens" in out
    found = load_library(library)
    assert found.class_names == ("a", "b", "unknown")
    for index, tissue in enumerate(found.tissues):
        off = np.abs(tissue.mean - MEAN - index * SHIFT)
        assert np.all(off < [0.3, 0.2, 0.02])
    assert [round(one.prior, 4) for one in found.classes] == [0.6, 0.2, 0.2]
    assert found.units == "Pa"


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
    assert 0.05 < contact["p_value"] <= 1.0
    assert 0.12 < contact["decision_strain"] <= 0.23
    assert 0.2 < contact["decision_time"] < 1.5


def test_a_class_that_cannot_be_learned_is_named_with_the_reason(tmp_path, capsys, monkeypatch):
    good = drawn(np.random.default_rng(0), specimens=6, each=2)
    none = replace(good.only([]), sources=("there",), skipped={"not converged": 3})

    def read(source, *arguments):
        return good if source.tissue == "a" else none

    monkeypatch.setattr(labelled, "read_source", read)
    library = tmp_path / "library.yaml"
    line = (
        "skin cannot be learned: none of its contacts has converged (3 not converged); fden "
        "replay says of there what they lack"
    )
    code, out, _ = train(capsys, "a=here", "skin=there", "-o", library, "--json")
    assert code == 0 and json.loads(out)["warnings"][0] == line
    code, out, _ = train(capsys, "a=here", "skin=there", "-o", library)
    assert code == 0 and line in " ".join(out.split())
    assert load_library(library).class_names == ("a", "b", "unknown")
    code, _, error = train(capsys, "a=here", "skin=there", "-o", library, "--prior", "skin=0.5")
    assert code == 1 and f"--prior skin: {line}" in error
    code, _, error = train(capsys, "skin=there", "-o", library)
    assert code == 1 and line in error and error.count("\n") == 1


def test_prior_of_the_estimator_is_taken_out_of_what_recordings_tell(bags):
    folder, config = bags
    parameters = read_parameter_file(config)
    (contact,) = replay(folder / "soft", parameters).summaries
    found = read_source(Source.parse(f"soft={folder / 'soft'}"), parameters)
    prior = np.diag(pipeline_config(parameters).estimator.prior.deviations[:2] ** -2.0)
    left = np.linalg.inv(contact.estimate.covariance[:2, :2]) - prior
    np.testing.assert_allclose(found.likelihood.information[0, :2, :2], left, rtol=0.05)
