# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Libraries learned from labelled contacts."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from fden_ros.core.classification.classifier import UNKNOWN, log_evidence, posterior
from fden_ros.tissues.library import parse_library
from fden_ros.tissues.training import (
    check,
    contacts_of,
    learn,
    library_of,
    library_text,
)

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
    result = check(contacts, learn(contacts))
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
        library, spreads, contacts, check(contacts, spreads), {"kind": "flat_punch"}
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
