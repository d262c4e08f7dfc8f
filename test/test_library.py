"""Tissue libraries from YAML."""

from __future__ import annotations

import math

import numpy as np
import pytest
import yaml

from fden_ros.errors import InputError
from fden_ros.library import load_library

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


def test_unknown_of_the_built_in_library_is_wider_than_any_tissue():
    library = load_library()
    for tissue in library.tissues:
        assert np.all(np.diag(library.unknown.covariance) > np.diag(tissue.covariance))


def test_file_is_read_with_its_names_and_priors(tmp_path):
    tissues = [{"name": "a", "prior": 2, **MOMENTS}, {"name": "b", **MOMENTS}]
    library = load_library(written(tmp_path, content(tissues=tissues)))
    assert library.name == "mine"
    assert library.class_names == ("a", "b", "unknown")
    assert [t.prior for t in library.tissues] == [2.0, 1.0]
    assert library.unknown.prior == 0.1


def test_missing_file_is_named(tmp_path):
    assert "No such file" in refused(tmp_path / "none.yaml")


def test_binary_file_is_no_text(tmp_path):
    path = tmp_path / "tissues.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    assert "not a text file" in refused(path)


def liver_with(**changes):
    return content(tissues=[{"name": "liver", **MOMENTS} | changes])


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ("tissues: [", "not valid YAML"),
        ("just text", "format: 2"),
        ("", "format: 2"),
        (content(format=3), "newer"),
        (content(tissues=[]), "at least one"),
        (content(tissues={"liver": 1}), "must be a list"),
        (content(tissues=["liver"]), "tissue 1: needs a `name`"),
        (content(tissues=[{**MOMENTS}]), "needs a `name`"),
        (content(tissues=[{"name": "a", **MOMENTS}] * 2), "must differ"),
        (content(tissues=[{"name": "unknown", **MOMENTS}]), "unknown"),
        (content(unknown=None), "needs `unknown`"),
        (content(unknown={"prior": 1}), "unknown: needs `linear_stiffness`"),
        (liver_with(linear_stiffness=3.0), "needs `linear_stiffness`"),
        (liver_with(linear_stiffness={"mean": 500.0}), "`linear_stiffness: sd` is None"),
        (liver_with(nonlinear_stiffness={"mean": 0, "sd": 1}), "must be a positive number"),
        (liver_with(nonlinear_stiffness={"mean": "8", "sd": 1}), "must be a positive number"),
        (liver_with(fractional_order={"mean": True, "sd": 1}), "must be a positive number"),
        (liver_with(fractional_order={"mean": math.nan, "sd": 1}), "must be a positive number"),
        (liver_with(prior=-1), "`prior` is -1"),
    ],
)
def test_mistake_is_told_in_one_line_with_the_file(tmp_path, data, said):
    assert said in refused(written(tmp_path, data))
