"""Which tissue it is, with probabilities that mean what they say."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fden_ros.core.classifier import UNKNOWN, Tissue, TissueLibrary, classify
from fden_ros.core.estimator import Estimate
from fden_ros.library import load_library

#: No test depends on the time it takes, nor on chance.
steady = settings(deadline=None, derandomize=True)

LIBRARY = load_library()
LIVER = LIBRARY.tissues[0]


def estimate_of(mean, sd=(0.01, 0.01, 0.01)):
    return Estimate(*(float(v) for v in mean), np.diag(np.square(sd)), 0.0, 0.0, 1.0, True, 1000)


def liver_moved(*by):
    return LIVER.mean + np.array(by)


def probability(result, name):
    return result.probabilities[LIBRARY.class_names.index(name)]


def test_liver_is_liver():
    result = classify(LIBRARY, estimate_of(LIVER.mean), False)
    assert result.label == "liver"
    assert probability(result, "liver") > 0.95


def test_ten_times_stiffer_is_unknown():
    result = classify(LIBRARY, estimate_of(liver_moved(math.log(10.0), 0.0, 0.0)), False)
    assert result.label == UNKNOWN
    assert probability(result, UNKNOWN) > 0.99


def test_estimate_that_is_not_sure_softens_the_answer():
    stiff = liver_moved(1.2, 0.0, 0.0)
    sharp = classify(LIBRARY, estimate_of(stiff, (0.01, 0.01, 0.01)), False)
    soft = classify(LIBRARY, estimate_of(stiff, (1.5, 0.7, 0.01)), False)
    assert probability(sharp, UNKNOWN) > 0.95
    assert 0.05 < probability(soft, UNKNOWN) < 0.5


def test_order_counts_only_if_it_was_learned():
    far = liver_moved(0.0, 0.0, 0.3)
    given_order = classify(LIBRARY, estimate_of(far), False)
    learned = classify(LIBRARY, estimate_of(far), True)
    assert given_order == classify(LIBRARY, estimate_of(LIVER.mean), False)
    assert given_order.label == "liver"
    assert learned.label == UNKNOWN


@steady
@given(
    mean=st.tuples(st.floats(-5.0, 15.0), st.floats(-3.0, 6.0), st.floats(0.0, 1.0)),
    sd=st.tuples(*[st.floats(1e-6, 5.0)] * 3),
    learned=st.booleans(),
)
def test_probabilities_are_probabilities(mean, sd, learned):
    result = classify(LIBRARY, estimate_of(mean, sd), learned)
    assert len(result.probabilities) == len(LIBRARY.class_names)
    assert math.fsum(result.probabilities) == pytest.approx(1.0)
    assert all(0.0 <= p <= 1.0 for p in result.probabilities)
    assert result.label == LIBRARY.class_names[int(np.argmax(result.probabilities))]


def test_prior_odds_multiply_the_odds():
    estimate = estimate_of(liver_moved(0.9, 0.0, 0.0))
    tenfold = replace(LIBRARY, unknown=replace(LIBRARY.unknown, prior=10 * LIBRARY.unknown.prior))

    def odds(library):
        liver, unknown = classify(library, estimate, False).probabilities
        return unknown / liver

    assert odds(tenfold) == pytest.approx(10.0 * odds(LIBRARY))


def test_tissues_of_the_same_parameters_share_their_prior():
    twins = TissueLibrary(
        "twins",
        (replace(LIVER, name="a", prior=3.0), replace(LIVER, name="b", prior=1.0)),
        replace(LIBRARY.unknown, prior=1e-9),
    )
    probabilities = classify(twins, estimate_of(LIVER.mean), False).probabilities
    assert probabilities[:2] == pytest.approx((0.75, 0.25), abs=1e-6)
    assert twins.class_names == ("a", "b", UNKNOWN)


def test_probabilities_are_calibrated():
    # Draw the class from its prior, the tissue from the class, the estimate from its covariance:
    # of the answers given a probability p, the share p must be right.
    rng = np.random.default_rng(0)
    near = Tissue("near", liver_moved(0.5, 0.2, 0.0), LIVER.covariance, 0.6)
    library = TissueLibrary("two", (LIVER, near), LIBRARY.unknown)
    classes = (*library.tissues, library.unknown)
    priors = np.array([c.prior for c in classes])
    said, right = [], []
    for _ in range(4000):
        truth = int(rng.choice(len(classes), p=priors / priors.sum()))
        tissue = rng.multivariate_normal(classes[truth].mean, classes[truth].covariance)
        covariance = np.diag(np.square(rng.uniform(0.02, 0.5, 3)))
        seen = rng.multivariate_normal(tissue, covariance)
        result = classify(library, estimate_of(seen, np.sqrt(np.diag(covariance))), True)
        said.append(max(result.probabilities))
        right.append(result.label == library.class_names[truth])
    said, right = np.array(said), np.array(right, dtype=float)
    edges = [0.0, 0.6, 0.7, 0.8, 0.9, 1.0]
    for low, high in itertools.pairwise(edges):
        inside = (said > low) & (said <= high)
        scatter = math.sqrt(np.mean(said[inside] * (1 - said[inside])) / inside.sum())
        # Four standard deviations of the share of right answers in the bin.
        assert abs(np.mean(right[inside]) - np.mean(said[inside])) < 4.0 * scatter
