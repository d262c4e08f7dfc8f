# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which tissue it is: probabilities, the label in a whole contact, a place against others."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t

from fden_ros.core.classification import (
    UNKNOWN,
    ClassProbabilities,
    DecisionConfig,
    Tissue,
    TissueLibrary,
)
from fden_ros.core.classification.classifier import classify, likelihood_of, log_evidence
from fden_ros.core.classification.labelling import Decider
from fden_ros.core.classification.relative import LEAST_SURROUNDINGS, compare
from fden_ros.core.estimation import Prior
from fden_ros.core.law import LogStiffness
from fden_ros.tissues.library import load_library

LIBRARY = load_library()
LIVER = LIBRARY.tissues[0]
#: With it a posterior is what the data say.
FLAT = Prior(1.0, 1e5, 1.0, 1e5, 0.0, 1e5)
PRIOR = Prior(600.0, 0.8, 9.0, 0.5, 0.2, 0.05)
PRIOR_MEAN = np.array([math.log(600.0), math.log(9.0), 0.2])
PRIOR_COVARIANCE = np.diag(np.square([0.8, 0.5, 0.05]))


def seen(mean, sd=(0.01, 0.01, 0.01)):
    return likelihood_of(mean, np.diag(np.square(sd)), FLAT)


def liver_moved(*by):
    return LIVER.mean + np.array(by)


def random_covariance(rng, sd):
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    scale = np.diag(sd)
    return scale @ axes @ np.diag(rng.uniform(0.3, 2.0, 3)) @ axes.T @ scale


def test_liver_is_liver_and_ten_times_stiffer_is_unknown():
    liver = classify(LIBRARY, seen(LIVER.mean))
    assert liver.label == "liver" and liver.p_value > 0.99
    assert liver.probabilities[liver.names.index("liver")] > 0.95
    stiff = classify(LIBRARY, seen(liver_moved(math.log(10.0), 0.0, 0.0)))
    assert stiff.label == UNKNOWN and stiff.probabilities[stiff.names.index(UNKNOWN)] > 0.99


def test_evidence_is_the_density_under_spread_and_error_without_the_estimators_prior():
    rng, inverse = np.random.default_rng(0), np.linalg.inv
    for _ in range(20):
        tissues = [
            Tissue("t", rng.normal(LIVER.mean, 0.3), random_covariance(rng, (0.3, 0.2, 0.02)))
            for _ in range(3)
        ]
        library = TissueLibrary("l", tuple(tissues[:2]), tissues[2])
        seen_at, error = rng.normal(LIVER.mean, 0.3), random_covariance(rng, (0.1, 0.05, 0.01))
        covariance = inverse(inverse(error) + inverse(PRIOR_COVARIANCE))
        mean = covariance @ (inverse(error) @ seen_at + inverse(PRIOR_COVARIANCE) @ PRIOR_MEAN)
        found, _ = log_evidence(library, likelihood_of(mean, covariance, PRIOR))
        expected = [
            multivariate_normal.logpdf(seen_at, t.mean, t.covariance + error) for t in tissues
        ]
        np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-6, atol=1e-6)


def test_learned_class_is_students_t():
    heavy = replace(LIVER, degrees_of_freedom=4.0)
    library = TissueLibrary("l", (heavy,), LIBRARY.unknown)
    for distance in (0.0, 0.5, 1.0):
        mean = liver_moved(distance, -distance / 2, 0.01)
        found, fits = log_evidence(library, seen(mean, (1e-6, 1e-6, 1e-7)))
        expected = multivariate_t.logpdf(mean, heavy.mean, heavy.covariance, df=4.0)
        wide = multivariate_normal.logpdf(mean, library.unknown.mean, library.unknown.covariance)
        assert found[0] - found[1] == pytest.approx(expected - wide, abs=0.02)
        # Mahalanobis' distance over 3 is F distributed with 3 and 4 degrees of freedom.
        square = np.sum((mean - heavy.mean) ** 2 / np.diag(heavy.covariance))
        draws = multivariate_t.rvs(np.zeros(3), np.eye(3), df=4.0, size=200_000, random_state=1)
        tail = np.mean(np.sum(draws**2, axis=1) > square)
        assert fits[0] == pytest.approx(tail, abs=0.01)


def test_contact_that_showed_nothing_leaves_the_priors():
    twins = TissueLibrary(
        "two",
        (replace(LIVER, name="a", prior=3.0), Tissue("b", liver_moved(1, 0, 0), LIVER.covariance)),
        replace(LIBRARY.unknown, prior=1e-9),
    )
    # Widened for a mismatch, a covariance may exceed the prior's.
    for factor in (1.0, 3.0):
        result = classify(twins, likelihood_of(PRIOR_MEAN, factor * PRIOR_COVARIANCE, PRIOR))
        assert result.probabilities[:2] == pytest.approx((0.75, 0.25), abs=1e-6)
        assert result.p_value == 1.0
        assert not result.is_observable


def test_classes_that_differ_in_the_order_wait_for_the_order():
    slow = replace(LIVER, name="slow", mean=liver_moved(0.0, 0.0, 0.08), prior=0.01)
    library = replace(LIBRARY, tissues=(LIVER, slow))
    ramp = np.diag(np.square([0.01, 0.01, 0.05]))
    before = likelihood_of(np.array([*LIVER.mean[:2], 0.2]), ramp, PRIOR)
    # Whatever the priors say, the data have not looked yet.
    assert not classify(library, before).is_observable
    hold = np.diag(np.square([0.01, 0.01, 0.002]))
    after = classify(library, likelihood_of(slow.mean, hold, PRIOR))
    assert after.is_observable and after.label == "slow"


# The label


NAMES = ("a", "b", UNKNOWN)


def said(*probabilities, p_value=1.0, observable=True):
    best = NAMES[int(np.argmax(probabilities))]
    return ClassProbabilities(best, NAMES, probabilities, p_value, observable)


A, B = said(0.8, 0.2, 0.0), said(0.1, 0.9, 0.0)
OUT, EDGE, IN = (said(0.9, 0.1, 0.0, p_value=t) for t in (0.03, 0.08, 0.14))
#: Answers 50 ms apart, and the label after each; None: not looked at.
SEQUENCES = {
    "waits for its probability and for observability": (
        [said(0.6, 0.3, 0.1), said(0.99, 0.01, 0.0, observable=False), said(0.71, 0.2, 0.09)],
        ["", "", "a"],
    ),
    "another answer must stand for a while": ([A, B, B, B, A, *[B] * 5], [*["a"] * 9, "b"]),
    "stays in doubt": ([A, *[said(0.55, 0.35, 0.1)] * 10], ["a"] * 11),
    "is taken back when no longer likely": ([A, *[said(0.4, 0.35, 0.25)] * 6], [*[None] * 6, ""]),
    "unknown stays at the edge": ([OUT, *[EDGE] * 8], [UNKNOWN] * 9),
    "unknown becomes known by a better fit": ([OUT, *[IN] * 8], [*[None] * 8, "a"]),
}


@pytest.mark.parametrize("name", SEQUENCES)
def test_label_of_a_sequence_of_answers(name):
    decider = Decider(DecisionConfig())
    for count, (answer, label) in enumerate(zip(*SEQUENCES[name], strict=True)):
        found = decider.update(50_000_000 * count, answer)
        assert label is None or found == label


# A place against its surroundings


def stiffness(values, sd=0.0):
    values = np.asarray(values, dtype=float)
    return LogStiffness(values, np.full(values.shape, sd**2))


def test_ratio_and_interval_hold_the_truth():
    rng = np.random.default_rng(1)
    inside, ratios = 0, []
    for _ in range(600):
        around = rng.normal(0.0, 0.1, 30) + rng.normal(0.0, 0.05, 30)
        mine = math.log(2.0) + rng.normal(0.0, 0.05)
        compared = compare(stiffness(mine, 0.05), stiffness(around, 0.05))
        low, high = compared.interval()
        inside += low <= 2.0 <= high
        ratios.append(compared.log_ratio)
    assert math.exp(np.mean(ratios)) == pytest.approx(2.0, rel=0.02)
    # Of 95 %: four standard deviations of 600 trials, and a share taken for something else.
    assert 0.91 < inside / 600 < 0.98


def test_lesions_among_the_surroundings_do_not_hide_a_lesion():
    rng = np.random.default_rng(4)
    around = [*rng.normal(0.0, 0.1, 24), *rng.normal(math.log(4.0), 0.1, 8)]
    compared = compare(stiffness(math.log(4.0), 0.02), stiffness(around, 0.02))
    assert compared.ratio == pytest.approx(4.0, rel=0.12)
    assert compared.degrees_of_freedom == pytest.approx(23.0, abs=4.0)
    assert compared.log_ratio > 6.0 * math.hypot(compared.log_ratio_sd, 0.1)


@pytest.mark.parametrize("count", [0, LEAST_SURROUNDINGS - 1, LEAST_SURROUNDINGS])
def test_too_few_surroundings_make_no_comparison(count):
    compared = compare(stiffness(0.0, 0.1), stiffness([0.0] * count))
    assert (compared is None) == (count < LEAST_SURROUNDINGS)
