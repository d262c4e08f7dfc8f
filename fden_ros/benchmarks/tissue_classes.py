# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Contacts of tissues that a library knows, of those it does not, and what others answer."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fden_ros.benchmarks.lesions import (
    roc,
)
from fden_ros.benchmarks.populations import (
    Drawn,
    Pressed,
    calibration_error,
    classwise_error,
    closed_set,
    draw,
    draw_likelihood,
    informations,
    published,
    stacked,
    training_contacts,
)
from fden_ros.core.arrays import Array, Indices
from fden_ros.core.classification.classifier import (
    Likelihood,
    Tissue,
    TissueLibrary,
    log_evidence,
    posterior,
)
from fden_ros.core.classification.decision import DecisionConfig
from fden_ros.tissues.training import Contacts, learn, library_of

if TYPE_CHECKING:
    pass


OWN, QDA, MIXTURE = "fden_ros", "discriminant analysis", "Gaussian mixtures"
#: Specimens of each class that the library is learned from, contacts with each.
SPECIMENS, PER_SPECIMEN = 60, 3
_SIGNIFICANCE = DecisionConfig().significance
FAR = 5.0
_FOREIGN_CONTACTS = 300


@dataclass(frozen=True, eq=False)
class Scores:
    """What one method made of contacts with known tissues."""

    error: float
    calibration: float
    log_loss: float


@dataclass(frozen=True, eq=False)
class Trial:
    """One library and the contacts that it was tried on."""

    library: TissueLibrary
    open_truth: Indices
    open_probabilities: Array  #: classes and unknown
    calibration: float
    classwise: float
    false_unknown: float
    confusion: Array  #: shares, known tissues; columns with unknown
    scores: dict[str, Scores]


def try_library(
    truth: TissueLibrary,
    precision: Array,
    specimens: int,
    count: int,
    generator: np.random.Generator,
    advance: Callable[[], None],
) -> Trial:
    """Return how a library learned from some specimens a class does on drawn contacts."""
    contacts = training_contacts(truth, precision, specimens, PER_SPECIMEN, generator)
    library = library_of(learn(contacts))
    everything = draw(truth, precision, count, generator)
    evidence, _ = log_evidence(library, everything.likelihood)
    probabilities = posterior(library, evidence)
    known = draw(truth, precision, count, generator, with_unknown=False)
    answers = _answers(library, known.likelihood)
    confusion = np.zeros((len(truth.tissues), len(truth.classes)))
    np.add.at(confusion, (known.truth, answers), 1.0)
    scores = {OWN: _score(closed_set(library, known.likelihood), known.truth)}
    for name, peer in _peers(contacts, library).items():
        scores[name] = _score(peer(published(known.likelihood)), known.truth)
    advance()
    return Trial(
        library,
        everything.truth,
        probabilities,
        calibration_error(probabilities, everything.truth)[0],
        classwise_error(probabilities, everything.truth),
        float(np.mean(answers == len(truth.tissues))),
        confusion / confusion.sum(axis=1, keepdims=True),
        scores,
    )


def _answers(library: TissueLibrary, likelihood: Likelihood) -> Indices:
    """Return the class that is named, by probability and by the open-set test."""
    evidence, fits = log_evidence(library, likelihood)
    answers = posterior(library, evidence).argmax(axis=-1)
    unknown = len(library.tissues)
    return np.where(fits.max(axis=-1) < _SIGNIFICANCE, unknown, answers)


def _score(probabilities: Array, truth: Indices) -> Scores:
    own = probabilities[np.arange(len(truth)), truth]
    return Scores(
        float(np.mean(probabilities.argmax(axis=1) != truth)),
        calibration_error(probabilities, truth)[0],
        float(-np.mean(np.log(np.maximum(own, 1e-12)))),
    )


def _peers(contacts: Contacts, library: TissueLibrary) -> dict[str, Callable[[Array], Array]]:
    """Return scikit-learn's classifiers, learned from the published estimates."""
    from sklearn.discriminant_analysis import (  # type: ignore[import-untyped]
        QuadraticDiscriminantAnalysis,
    )
    from sklearn.mixture import GaussianMixture  # type: ignore[import-untyped]

    values = published(contacts.likelihood)
    # Of one scale: the mixtures' regularisation knows none.
    middle, scale = values.mean(axis=0), values.std(axis=0)
    scaled = (values - middle) / scale
    names = [tissue.name for tissue in library.tissues]
    labels = np.array([names.index(tissue) for tissue in contacts.tissues])
    analysis = QuadraticDiscriminantAnalysis(priors=np.full(len(names), 1.0 / len(names)))
    analysis.fit(scaled, labels)
    mixtures = []
    for label in range(len(names)):
        own = scaled[labels == label]
        candidates = [
            GaussianMixture(k, random_state=0, reg_covar=1e-4).fit(own)
            for k in (1, 2, 3)
            if len(own) > 4 * k
        ]
        mixtures.append(min(candidates, key=lambda one: float(one.bic(own))))

    def mixture(estimates: Array) -> Array:
        logs = np.stack(
            [one.score_samples((estimates - middle) / scale) for one in mixtures], axis=-1
        )
        result: Array = np.exp(logs - logs.max(axis=1, keepdims=True))
        return result / result.sum(axis=1, keepdims=True)

    def discriminant(estimates: Array) -> Array:
        result: Array = analysis.predict_proba((estimates - middle) / scale)
        return result

    return {QDA: discriminant, MIXTURE: mixture}


@dataclass(frozen=True, eq=False)
class Through:
    """The contacts that went through the pipeline."""

    converged: int
    error: float
    expected_error: float  #: as their own probabilities say
    error_sd: float
    nees: float  #: of the likelihoods about the truth, over 3
    decided: float  #: share with a label at the end
    wrong: float  #: share of labels that are not the truth
    changes: float  #: labels replaced, a contact
    times: Array  #: from the touch to the label [s]
    strains: Array


def through_pipeline(truth: TissueLibrary, pressed: Sequence[Pressed]) -> Through:
    """Return what the pipeline itself said of contacts."""
    classes, values, likelihood = stacked(pressed)
    probabilities = closed_set(truth, likelihood)
    best = probabilities.max(axis=1)
    off = likelihood.score + np.einsum(
        "nij,nj->ni", likelihood.information, likelihood.centre - values
    )
    squares = np.einsum(
        "ni,ni->n", off, np.linalg.solve(likelihood.information, off[..., None])[..., 0]
    )
    summaries = [(one.truth, one.summary) for one in pressed if one.summary is not None]
    labelled = [
        (truth.tissues[index].name, summary)
        for index, summary in summaries
        if summary.classes is not None and summary.classes.label
    ]
    changes = [
        sum(a != b for a, b in itertools.pairwise(label for _, label, _ in one.track if label))
        for one in pressed
        if one.track
    ]
    decided = [summary.decided for _, summary in labelled if summary.decided is not None]
    return Through(
        len(classes),
        float(np.mean(probabilities.argmax(axis=1) != classes)),
        float(np.mean(1.0 - best)),
        float(np.sqrt(np.sum(best * (1.0 - best))) / len(best)),
        float(np.mean(squares)) / 3.0,
        len(labelled) / max(len(classes), 1),
        float(np.mean([name != s.classes.label for name, s in labelled if s.classes])),
        float(np.mean(changes)) if changes else math.nan,
        np.array([one.time for one in decided]),
        np.array([one.strain for one in decided]),
    )


@dataclass(frozen=True, eq=False)
class Foreign:
    """Classes that no library knows, five standard deviations away from the nearest."""

    called: float  #: share of their contacts called unknown
    worst: float  #: of the class that was told worst
    with_all: float  #: share over all contacts, those included that do not show alpha
    roc: tuple[Array, Array, float]  #: of the typicality, foreign against known


def left_out(
    truth: TissueLibrary,
    libraries: Sequence[TissueLibrary],
    pressed: Sequence[Pressed],
    classes: int,
    generator: np.random.Generator,
    advance: Callable[[], None],
) -> Foreign:
    """Return what is said of tissues that no library has."""
    held = informations(pressed, (1, 2))
    everything = informations(pressed)
    shares: list[float] = []
    total: list[float] = []
    fits = []
    for number in range(classes):
        tissue = far_class(truth, generator, number)
        library = libraries[number % len(libraries)]
        for precision, into in ((held, shares), (everything, total)):
            drawn = _of_class(tissue, precision, _FOREIGN_CONTACTS, generator)
            unknown = _answers(library, drawn) == len(library.tissues)
            into.append(float(np.mean(unknown)))
            if precision is held:
                fits.append(log_evidence(library, drawn)[1].max(axis=-1))
        advance()
    own = np.concatenate(
        [
            log_evidence(
                library,
                draw(truth, held, 10_000, generator, with_unknown=False).likelihood,
            )[1].max(axis=-1)
            for library in libraries
        ]
    )
    scores = np.concatenate([-np.log10(own + 1e-30), -np.log10(np.concatenate(fits) + 1e-30)])
    positive = np.arange(len(scores)) >= len(own)
    return Foreign(
        float(np.mean(shares)), min(shares), float(np.mean(total)), roc(scores, positive)
    )


def far_class(truth: TissueLibrary, generator: np.random.Generator, number: int) -> Tissue:
    """Return a class whose centre is five standard deviations from the nearest known one."""
    base = truth.tissues[number % len(truth.tissues)]
    factor = np.linalg.cholesky(base.covariance)
    while True:
        direction = generator.standard_normal(3)
        direction /= np.linalg.norm(direction)
        mean = base.mean + FAR * factor @ direction
        distances = [
            math.sqrt((mean - t.mean) @ np.linalg.solve(t.covariance, mean - t.mean))
            for t in truth.tissues
        ]
        # A tissue has a positive order.
        if min(distances) > FAR - 1e-9 and mean[2] > 0.03:
            return Tissue("foreign", mean, base.covariance)


def _of_class(
    tissue: Tissue, precision: Array, count: int, generator: np.random.Generator
) -> Likelihood:
    value = generator.multivariate_normal(tissue.mean, tissue.covariance, count)
    chosen = precision[generator.integers(len(precision), size=count)]
    return draw_likelihood(value, chosen, generator)


@dataclass(frozen=True, eq=False)
class Places:
    """Several contacts with one place: their evidence added, or their probabilities multiplied."""

    counts: tuple[int, ...]
    added: list[float]  #: calibration error
    multiplied: list[float]
    error: list[float]


def presses_of_one_place(
    truth: TissueLibrary,
    library: TissueLibrary,
    precision: Array,
    contacts: int,
    generator: np.random.Generator,
) -> Places:
    """Return what several contacts of one place say together."""
    drawn: Drawn = draw(truth, precision, contacts, generator)
    total: Likelihood | None = None
    logs = np.zeros((len(drawn.truth), len(truth.classes)))
    counts = (1, 2, 3, 5, 8)
    added, multiplied, error = [], [], []
    for number in range(1, max(counts) + 1):
        chosen = precision[generator.integers(len(precision), size=len(drawn.truth))]
        one = draw_likelihood(drawn.value, chosen, generator)
        total = one if total is None else total + one
        logs += log_evidence(library, one)[0]
        if number in counts:
            together = posterior(library, log_evidence(library, total)[0])
            added.append(calibration_error(together, drawn.truth)[0])
            error.append(float(np.mean(together.argmax(axis=1) != drawn.truth)))
            multiplied.append(calibration_error(posterior(library, logs), drawn.truth)[0])
    return Places(counts, added, multiplied, error)
