# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tissue libraries from YAML."""

from __future__ import annotations

import math

import numpy as np
import pytest
import yaml

from fden_ros.errors import InputError
from fden_ros.parameters import check, pipeline_config
from fden_ros.tissues.library import load_library

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


def refused(path):
    with pytest.raises(InputError) as caught:
        load_library(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


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
    assert said in refused(written(tmp_path, data))


def test_typed_and_learned_tissues_stand_in_one_file(tmp_path):
    tissues = [{"name": "a", "distribution": LEARNED}, {"name": "b", **MOMENTS}]
    data = content(format=2, units="N", geometry={"kind": "sphere"}, tissues=tissues)
    library = load_library(written(tmp_path, data))
    assert library.class_names == ("a", "b", "unknown")
    assert [t.degrees_of_freedom for t in library.tissues] == [7.0, math.inf]
    np.testing.assert_allclose(library.tissues[0].mean, LEARNED["mean"])
    np.testing.assert_allclose(library.tissues[0].covariance, LEARNED["covariance"])
    assert (library.units, library.geometry) == ("N", "sphere")


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
