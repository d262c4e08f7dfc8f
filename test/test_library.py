# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Libraries of tissues: from YAML, and learned from tables of contacts."""

from __future__ import annotations

import math

import numpy as np
import pytest
import yaml
from command_helpers import answer, with_values
from pipeline_helpers import refusal

from fden_ros.cli import main
from fden_ros.core.classification import UNKNOWN
from fden_ros.core.classification.classifier import likelihood_of, log_evidence, posterior
from fden_ros.core.estimation import Prior
from fden_ros.errors import InputError
from fden_ros.parameters import check, pipeline_config
from fden_ros.tissues.library import load_library, parse_library
from fden_ros.tissues.training import Contacts, learn, library_of, library_text, read_contacts
from simulation.bag import write_recording
from simulation.scenario import Tissue, ramp_scenario
from simulation.simulate import simulate

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
        (content(tissues=[{"name": "a", **MOMENTS}] * 2), "must differ"),
        (content(tissues=[{"name": "unknown", **MOMENTS}]), "unknown"),
        (liver_with(linear_stiffness={"mean": 500.0}), "`linear_stiffness: sd` is None"),
        (liver_with(nonlinear_stiffness={"mean": 0, "sd": 1}), "must be a positive number"),
        (learned_with(mean=[1.0, 2.0]), "must be (ln G, ln Gn, alpha)"),
        (learned_with(covariance=[[1, 2, 0], [2, 1, 0], [0, 0, 1]]), "positive definite"),
        (content(format=2, units="psi"), "must be Pa or N"),
    ],
)
def test_mistake_is_told_in_one_line_with_the_file(tmp_path, data, said):
    path = written(tmp_path, data)
    message = refusal(load_library, path)
    assert said in message and str(path) in message


@pytest.mark.parametrize(("units", "area"), [("N", 1e-4), ("Pa", 1.0)])
def test_library_of_other_units_is_refused(tmp_path, units, area):
    path = written(tmp_path, content(format=2, units=units))
    with pytest.raises(InputError, match=f"G is in {units} s\\^alpha, but the estimates"):
        pipeline_config(check({"classifier.library": str(path), "geometry.area": area}))


MEAN = np.array([6.3, 2.1, 0.13])
SPREAD = np.diag(np.square([0.28, 0.18, 0.017]))
SHIFT = np.array([1.2, 0.1, 0.08])
FLAT = Prior(1.0, 1e5, 1.0, 1e5, 0.0, 1e5)


def drawn(rng, index=0, count=20, error=(0.05, 0.05, 0.005)):
    """Contacts of one of several classes SHIFT apart, with errors of very different size."""
    covariances = [np.diag(np.square(error * rng.uniform(0.2, 2.0, 3))) for _ in range(count)]
    means = [rng.multivariate_normal(MEAN + index * SHIFT, SPREAD + one) for one in covariances]
    return Contacts(np.array(means), np.array(covariances))


def test_estimation_error_is_subtracted():
    rng = np.random.default_rng(0)
    # Errors as large as the spread itself: without it the variance would be 2.5 times too large.
    found = [learn("a", drawn(rng, count=40, error=(0.3, 0.2, 0.02))) for _ in range(20)]
    mean = np.mean([np.diag(one.covariance) for one in found], axis=0)
    np.testing.assert_allclose(mean, np.diag(SPREAD), rtol=0.3)
    assert found[0].degrees_of_freedom == 43.0


@pytest.mark.statistics
def test_library_from_few_contacts_is_calibrated():
    rng = np.random.default_rng(5)
    said, right = [], []
    for _ in range(200):
        library = library_of({name: drawn(rng, i, 5) for i, name in enumerate("ab")})
        for truth in range(2):
            for contact in zip(*drawn(rng, truth, 10)[:2], strict=True):
                evidence = log_evidence(library, likelihood_of(*contact, FLAT))[0]
                known = posterior(library, evidence)[:-1]
                said.append(known.max() / known.sum())
                right.append(known.argmax() == truth)
    assert abs(np.mean(said) - np.mean(right)) < 0.02


def test_library_that_was_written_is_read_again():
    rng = np.random.default_rng(9)
    library = library_of({"a": drawn(rng), "b": drawn(rng, 1)}, "mine", "N", "flat_punch")
    again = parse_library(library_text(library, {"kind": "flat_punch"}), "text")
    assert (again.name, again.units, again.geometry) == ("mine", "N", "flat_punch")
    assert again.class_names == ("a", "b", UNKNOWN)
    for one, other in zip(library.classes, again.classes, strict=True):
        np.testing.assert_allclose(one.mean, other.mean)
        np.testing.assert_allclose(one.covariance, other.covariance)
        assert (one.degrees_of_freedom, one.prior) == (other.degrees_of_freedom, other.prior)


def test_tables_of_batch_become_a_library_that_a_replay_uses(tmp_path, capsys):
    labelled = []
    for name, g in (("soft", 450.0), ("stiff", 1500.0)):
        scenario = ramp_scenario(
            strain_rate=0.4, max_strain=0.22, hold_s=0.3, rate_hz=100.0, seed=1,
            tissue=Tissue(g, 8.0, 0.13),
        )  # fmt: skip
        write_recording(simulate(scenario), tmp_path / name)
        own = tmp_path / name / "identifier.yaml"
        config = with_values(own, {"prior.linear_stiffness_log_sd": 1.0})
        table = tmp_path / f"{name}.csv"
        options = ("--config", str(config), "-o", str(table), "--workers", "1")
        assert main(["batch", str(tmp_path / name), *options]) == 0
        labelled.append(f"{name}={table}")
    library = tmp_path / "library.yaml"
    assert main(["train", *labelled, "--config", str(config), "-o", str(library)]) == 0
    assert load_library(library).class_names == ("soft", "stiff", UNKNOWN)
    recorded = yaml.safe_load(library.read_text(encoding="utf-8"))["geometry"]
    assert recorded["thickness"] == 0.02 and recorded["area"] == pytest.approx(math.pi * 1e-4)

    chosen = with_values(config, {"classifier.library": str(library)}, "chosen.yaml")
    (contact,) = answer(capsys, "replay", tmp_path / "stiff", "--config", chosen)["contacts"]
    assert contact["label"] == "stiff" and contact["probabilities"]["stiff"] > 0.7
    assert 0.05 < contact["p_value"] <= 1.0
    assert 0.12 < contact["decision_strain"] <= 0.23
    assert 0.2 < contact["decision_time"] < 1.5


HEAD = "configuration,converged,g,g_n,alpha,g_sd,g_n_sd,alpha_sd,alpha_source," + ",".join(
    f"{pair}_correlation" for pair in ("g_g_n", "g_alpha", "g_n_alpha")
)
ROW = "one,True,500,8,0.13,50,0.4,0.01,learned,0.5,0,0"


def test_contacts_are_the_converged_rows(tmp_path):
    path = written(tmp_path, "\n".join((HEAD, ROW, ROW.replace("True", "False"))))
    (mean,), (covariance,), is_learned = read_contacts(path)
    np.testing.assert_allclose(mean, [math.log(500.0), math.log(8.0), 0.13])
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [0.1, 0.05, 0.01])
    assert covariance[0, 1] == pytest.approx(0.5 * 0.1 * 0.05) and is_learned
    path = written(tmp_path, "\n".join((HEAD, ROW, ROW.replace("learned", "given"))))
    assert learn("a", read_contacts(path)).covariance[2, 2] == pytest.approx(0.12**2)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ((ROW.replace("True", "False"),), "none of its 1 contacts has converged"),
        ((ROW, ROW.replace("one", "two")), "several configurations"),
        ((ROW.replace("500", ""),), "not a table of fden batch"),
    ],
)
def test_table_that_teaches_nothing_is_refused(tmp_path, rows, said):
    path = written(tmp_path, "\n".join((HEAD, *rows)))
    assert said in refusal(read_contacts, path)
