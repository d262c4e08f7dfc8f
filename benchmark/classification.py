# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which tissue it is: calibration, error over Bayes', the unknown, and measured tissue.

Some hundred contacts of four simulated tissues (the paper's liver and three invented ones) go
through simulator and pipeline; what their data say is the precision of 100,000 contacts and more
that are drawn. Libraries are learned from drawn contacts by the code of ``fden train``. With
measured tests (CSV, as for ``fden benchmark real``) beef and silicone are told apart.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmark.harness import (
    Benchmark,
    Goal,
    Report,
    Table,
    at_least,
    at_most,
    measured,
    undecided,
)
from benchmark.measured import PRIOR_STIFFNESS, Test, identify, read_tests
from benchmark.populations import (
    Pressed,
    calibration_error,
    closed_set,
    draw,
    draw_likelihood,
    informations,
    population,
    press,
    training_contacts,
    values_of,
)
from benchmark.score import Share, share
from fden_ros.core.arrays import Array, Indices
from fden_ros.core.classification.classifier import (
    Likelihood,
    Tissue,
    TissueLibrary,
    log_evidence,
    posterior,
)
from fden_ros.core.classification.decision import DecisionConfig
from fden_ros.core.estimation.estimator_config import Prior
from fden_ros.tissues.training import check, contacts_of, learn, library_of

EPILOG = """\
examples:
  fden benchmark classification --quick           simulated tissues only
  fden benchmark classification measured/         the whole of it, measured tissue included

Measured tests: as for fden benchmark real; without them that part is left out.
"""

#: Specimens of each class that the library is learned from, contacts with each.
SPECIMENS, PER_SPECIMEN = 60, 3
#: Deviations from the nearest known class of those that no library knows, and contacts with each.
FAR, _FOREIGN_CONTACTS = 5.0, 300
#: Contacts by which Bayes' error is known, in those of a library.
_BAYES = 5
#: Contacts with one place whose evidence is added.
_PLACES = (1, 2, 3, 5, 8)


@dataclass(frozen=True)
class Size:
    """How much is done."""

    pressed: int  #: contacts through the pipeline
    drawn: int  #: contacts drawn, for each library
    libraries: int  #: learned from different specimens
    foreign: int  #: classes that were left out


FULL = Size(360, 40_000, 5, 200)
QUICK = Size(48, 20_000, 1, 8)


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    size = QUICK if args.quick else FULL
    truth, generator = population(), np.random.default_rng(2026)
    pressed = measured(press, values_of(size.pressed))
    precision = informations(pressed)
    known = draw(truth, precision, _BAYES * size.drawn, generator, with_unknown=False)
    doubts = 1.0 - closed_set(truth, known.likelihood).max(axis=1)
    bound = float(doubts.mean())
    trials = [try_library(precision, size.drawn, generator) for _ in range(size.libraries)]
    libraries = [library for library, _ in trials]
    learned = {key: float(np.mean([row[key] for _, row in trials])) for key in trials[0][1]}
    figures = {
        **learned,
        "error over Bayes'": learned["error of the label"] / bound,
        f"classes {FAR:g} sd away called unknown": left_out(
            libraries, pressed, size.foreign, generator
        ),
        "contacts of one place, added: calibration error, worst": one_place(
            libraries[0], precision, size.drawn // 2, generator
        ),
        "Bayes' error": bound,
        "its own error": float(doubts.std() / math.sqrt(doubts.size)),
    } | through_pipeline(pressed)
    tables = {
        "figures": Table("Simulated tissues", {name: {"": v} for name, v in figures.items()}),
    }
    goals = _goals(figures)
    if args.data is not None and not args.quick:
        tables["measured"] = Table(
            "One piece left out", {"FDEN, online": told(read_tests(args.data))}
        )
        errors = tables["measured"].rows["FDEN, online"]["beef | silicone: errors"].part
        goals.append(at_most("beef and silicone: errors in cross-validation", float(errors), 0.0))
    # One library and few contacts decide nothing.
    return Report(undecided(goals) if args.quick else goals, tables)


def _goals(figures: Mapping[str, Any]) -> list[Goal]:
    off = abs(figures["pipeline: error"] - figures["pipeline: expected"]) / figures["pipeline: sd"]
    one_place = "contacts of one place, added: calibration error, worst"
    return [
        at_most("calibration error", figures["calibration error, unknown included"], 0.02),
        at_most("error over Bayes' error", figures["error over Bayes'"], 1.1),
        at_least(
            f"left out, {FAR:g} sd away: called unknown",
            figures[f"classes {FAR:g} sd away called unknown"],
            0.95,
        ),
        at_most("known tissues called unknown", figures["known tissues called unknown"], 0.05),
        at_most("through the pipeline: error less expected, in sd", off, 2.5),
        at_most(one_place, figures[one_place], 0.02),
    ]


# Libraries


def try_library(
    precision: Array, count: int, generator: np.random.Generator
) -> tuple[TissueLibrary, dict[str, float]]:
    """Learn a library from drawn contacts; return it, and how it does on others."""
    truth = population()
    contacts = training_contacts(precision, SPECIMENS, PER_SPECIMEN, generator)
    library = library_of(learn(contacts))
    everything = draw(truth, precision, count, generator)
    probabilities = posterior(library, log_evidence(library, everything.likelihood)[0])
    known = draw(truth, precision, count, generator, with_unknown=False)
    unknown = answers_of(library, known.likelihood) == len(truth.tissues)
    labels = closed_set(library, known.likelihood).argmax(axis=1)
    return library, {
        "error of the label": float(np.mean(labels != known.truth)),
        "known tissues called unknown": float(np.mean(unknown)),
        "calibration error, unknown included": calibration_error(probabilities, everything.truth),
    }


def answers_of(library: TissueLibrary, likelihood: Likelihood) -> Indices:
    """Return the class that is named, by probability and by the open-set test, shape (n,)."""
    evidence, fits = log_evidence(library, likelihood)
    answers = posterior(library, evidence).argmax(axis=-1)
    is_far = fits.max(axis=-1) < DecisionConfig().significance
    return np.where(is_far, len(library.tissues), answers)


def left_out(
    libraries: Sequence[TissueLibrary],
    pressed: Sequence[Pressed],
    classes: int,
    generator: np.random.Generator,
) -> float:
    """Return how often tissues of no library are called unknown, where a hold shows alpha."""
    held = informations(pressed, (1, 2))
    shares = []
    for number in range(classes):
        tissue, library = far_class(generator, number), libraries[number % len(libraries)]
        value = generator.multivariate_normal(tissue.mean, tissue.covariance, _FOREIGN_CONTACTS)
        answers = answers_of(library, draw_likelihood(value, held, generator))
        shares.append(float(np.mean(answers == len(library.tissues))))
    return float(np.mean(shares))


def far_class(generator: np.random.Generator, number: int) -> Tissue:
    """Return a class whose centre is five standard deviations from the nearest known one."""
    tissues = population().tissues
    base = tissues[number % len(tissues)]
    factor = np.linalg.cholesky(base.covariance)
    while True:
        direction = generator.standard_normal(3)
        mean = base.mean + FAR * factor @ (direction / np.linalg.norm(direction))
        distances = [
            math.sqrt((mean - t.mean) @ np.linalg.solve(t.covariance, mean - t.mean))
            for t in tissues
        ]
        # A tissue has a positive order.
        if min(distances) > FAR - 1e-9 and mean[2] > 0.03:
            return Tissue("foreign", mean, base.covariance)


def one_place(
    library: TissueLibrary, precision: Array, contacts: int, generator: np.random.Generator
) -> float:
    """Return the worst calibration error of evidence that is added over contacts of one place."""
    drawn = draw(population(), precision, contacts, generator)
    total, errors = drawn.likelihood, []
    for number in range(1, max(_PLACES) + 1):
        if number > 1:
            total = total + draw_likelihood(drawn.value, precision, generator)
        if number in _PLACES:
            together = posterior(library, log_evidence(library, total)[0])
            errors.append(calibration_error(together, drawn.truth))
    return max(errors)


def through_pipeline(pressed: Sequence[Pressed]) -> dict[str, Any]:
    """Return what the pipeline itself said of contacts."""
    truth = population()
    used = [(one, one.likelihood) for one in pressed if one.converged]
    parts = [part for _, part in used if part is not None]
    likelihood = Likelihood(
        np.array([part.centre for part in parts]),
        np.array([part.score for part in parts]),
        np.array([part.information for part in parts]),
    )
    probabilities = closed_set(truth, likelihood)
    best = probabilities.max(axis=1)
    classes = np.array([one.truth for one, part in used if part is not None])
    decided = [one.decided[0] for one in pressed if one.decided is not None]
    wrong = [one.label != truth.tissues[one.truth].name for one in pressed if one.label]
    return {
        "pipeline: converged": Share(len(used), len(pressed)),
        "pipeline: error": float(np.mean(probabilities.argmax(axis=1) != classes)),
        "pipeline: expected": float(np.mean(1.0 - best)),
        "pipeline: sd": float(np.sqrt(np.sum(best * (1.0 - best))) / len(best)),
        "pipeline: labels wrong": share(wrong),
        "pipeline: label after [s], median": float(np.median(decided)) if decided else math.nan,
    }


# Measured tissue


def _identified(test: Test) -> tuple[Array, Array]:
    estimate, _, _ = identify(test)
    return estimate.mean, estimate.covariance


def told(tests: Sequence[Test]) -> dict[str, Any]:
    """Return what FDEN's parameters tell of measured tests, one piece of material left out."""
    found = measured(_identified, [(test,) for test in tests], what="measured tests")
    pieces = [test.specimen for test in tests]
    for index, test in enumerate(tests):
        own = {other.specimen for other in tests if other.kind == test.kind}
        # Silicone is one piece, or a numbered series of tests of it: one test is left out.
        head, _, number = test.specimen.rpartition("-")
        if len(own) == 1 or (head and number.isdigit()):
            pieces[index] = f"{test.specimen}, test {index}"
    prior = Prior(linear_stiffness=PRIOR_STIFFNESS)
    means, covariances = (np.array(values) for values in zip(*found, strict=True))
    contacts = contacts_of([test.kind for test in tests], pieces, means, covariances, prior)
    result = check(contacts, learn(contacts))
    return {
        "beef | silicone: errors": share(result.errors),
        "95 %": result.interval(),
        "unknown": share(result.unknown),
    }


BENCHMARK = Benchmark(run, EPILOG, data=True)
