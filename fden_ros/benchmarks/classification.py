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

"""Which tissue it is: calibration, error over Bayes', the unknown, lesions, and measured tissue.

Some hundred contacts of four simulated tissues (the paper's liver and three invented ones) go
through simulator and pipeline; what their data say is the precision of 100,000 contacts and more
that are drawn. Libraries are learned from drawn contacts by the code of ``fden train``. Peers,
scikit-learn's quadratic discriminant analysis and Gaussian mixtures, learn from the same contacts
but know nothing of the estimation error. With measured tests (CSV, as for ``fden benchmark real``)
beef and silicone are told apart, by FDEN's parameters and by those of other contact models.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fden_ros.benchmarks import Goal, Report, progress, real, within
from fden_ros.benchmarks.lesions import (
    CONTRASTS,
    DIAMETERS,
    RATIO,
    SIDE,
    SPACING,
    SURROUNDINGS,
    Grid,
    comparisons,
    drawn_estimates,
    make_grid,
    pressed_estimates,
    roc,
    true_log_stiffness,
)
from fden_ros.benchmarks.populations import (
    Drawn,
    Pressed,
    bayes_error,
    calibration_error,
    classwise_error,
    closed_set,
    draw,
    draw_likelihood,
    informations,
    population,
    press_many,
    published,
    stacked,
    training_contacts,
)
from fden_ros.benchmarks.real_classes import ONLINE, Told, tell
from fden_ros.core.arrays import Array, Indices
from fden_ros.core.classification.classifier import (
    Likelihood,
    Tissue,
    TissueLibrary,
    log_evidence,
    posterior,
)
from fden_ros.core.classification.decision import DecisionConfig
from fden_ros.core.classification.relative import Comparison, neighbours
from fden_ros.errors import InputError
from fden_ros.tissues.training import Contacts, learn, library_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.table import Table


EPILOG = """\
examples:
  fden benchmark classification --quick           simulated tissues only, under a minute
  fden benchmark classification measured/         the whole of it, measured tissue included
  FDEN_DATA=measured fden benchmark classification --json | jq '.figures.peers'

Measured tests: as for fden benchmark real; without them that part is left out.
"""

OWN, QDA, MIXTURE = "fden_ros", "discriminant analysis", "Gaussian mixtures"
#: Specimens of each class that the library is learned from, contacts with each.
_SPECIMENS, _PER_SPECIMEN = 60, 3
_SIGNIFICANCE = DecisionConfig().significance
_FAR = 5.0
_FOREIGN_CONTACTS = 300


@dataclass(frozen=True)
class _Size:
    """How much is done."""

    pressed: int  #: contacts through the pipeline
    drawn: int  #: contacts drawn, for each library
    libraries: int  #: learned from different specimens
    curve: tuple[int, ...]  #: numbers of specimens of the learning curve
    points: int  #: of the integration, a power of 2
    replicates: int
    foreign: int  #: classes that were left out
    grids: int  #: grids of lesions drawn
    presses_grid: bool  #: one more grid through the pipeline


_FULL = _Size(360, 40_000, 5, (3, 5, 10, 20, 40, 80), 8192, 16, 200, 20, True)
_QUICK = _Size(48, 20_000, 1, (5, 20), 1024, 4, 8, 2, False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmark's own arguments; without a folder measured tissue is left out."""
    real.add_arguments(parser)
    parser.epilog = EPILOG


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    _require_sklearn()
    size = _QUICK if args.quick else _FULL
    tests = real.read_tests(Path(args.data)) if args.data is not None and not args.quick else []
    truth = population()
    steps = size.pressed + size.libraries + len(size.curve) + size.foreign + size.grids
    steps += size.presses_grid * SIDE**2 + (len(tests) + 4) * bool(tests)
    with progress("contacts", steps + 1) as advance:
        pressed = press_many(truth, size.pressed, advance)
        precision = informations(pressed)
        bound = bayes_error(truth, precision, size.points, size.replicates)
        advance()
        generator = np.random.default_rng(2026)
        trials = [
            _trial(truth, precision, _SPECIMENS, size.drawn, generator, advance)
            for _ in range(size.libraries)
        ]
        curve = {
            count: _trial(truth, precision, count, size.drawn // 2, generator, advance)
            for count in size.curve
        }
        library = trials[0].library
        libraries = [trial.library for trial in trials]
        foreign = _foreign(truth, libraries, pressed, size, generator, advance)
        places = _places(truth, library, precision, size, generator)
        lesions = _lesions(precision, size, generator, advance)
        told = tell(tests, advance) if tests else {}
    found = _Found(
        pressed, _through(truth, pressed), bound, trials, curve, foreign, places, lesions, told
    )
    return Report(
        goals=_goals(found, args.quick),
        figures=_figures(found),
        draw=lambda figure: _draw(figure, found, truth),
        tables=_tables(found, truth),
    )


def _require_sklearn() -> None:
    try:
        import sklearn  # type: ignore[import-untyped]  # noqa: F401
    except ImportError:
        raise InputError(
            "the peers need scikit-learn: pip install 'fden_ros[benchmark]', or pip install "
            "scikit-learn"
        ) from None


# Populations


@dataclass(frozen=True, eq=False)
class _Scores:
    """What one method made of contacts with known tissues."""

    error: float
    calibration: float
    log_loss: float


@dataclass(frozen=True, eq=False)
class _Trial:
    """One library and the contacts that it was tried on."""

    library: TissueLibrary
    open_truth: Indices
    open_probabilities: Array  #: classes and unknown
    calibration: float
    classwise: float
    false_unknown: float
    confusion: Array  #: shares, known tissues; columns with unknown
    scores: dict[str, _Scores]


def _trial(
    truth: TissueLibrary,
    precision: Array,
    specimens: int,
    count: int,
    generator: np.random.Generator,
    advance: Callable[[], None],
) -> _Trial:
    contacts = training_contacts(truth, precision, specimens, _PER_SPECIMEN, generator)
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
    return _Trial(
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


def _score(probabilities: Array, truth: Indices) -> _Scores:
    own = probabilities[np.arange(len(truth)), truth]
    return _Scores(
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
class _Through:
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


def _through(truth: TissueLibrary, pressed: Sequence[Pressed]) -> _Through:
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
    return _Through(
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
class _Foreign:
    """Classes that no library knows, five standard deviations away from the nearest."""

    called: float  #: share of their contacts called unknown
    worst: float  #: of the class that was told worst
    with_all: float  #: share over all contacts, those included that do not show alpha
    roc: tuple[Array, Array, float]  #: of the typicality, foreign against known


def _foreign(
    truth: TissueLibrary,
    libraries: Sequence[TissueLibrary],
    pressed: Sequence[Pressed],
    size: _Size,
    generator: np.random.Generator,
    advance: Callable[[], None],
) -> _Foreign:
    held = informations(pressed, (1, 2))
    everything = informations(pressed)
    shares: list[float] = []
    total: list[float] = []
    fits = []
    for number in range(size.foreign):
        tissue = _far_class(truth, generator, number)
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
    return _Foreign(
        float(np.mean(shares)), min(shares), float(np.mean(total)), roc(scores, positive)
    )


def _far_class(truth: TissueLibrary, generator: np.random.Generator, number: int) -> Tissue:
    """Return a class whose centre is five standard deviations from the nearest known one."""
    base = truth.tissues[number % len(truth.tissues)]
    factor = np.linalg.cholesky(base.covariance)
    while True:
        direction = generator.standard_normal(3)
        direction /= np.linalg.norm(direction)
        mean = base.mean + _FAR * factor @ direction
        distances = [
            math.sqrt((mean - t.mean) @ np.linalg.solve(t.covariance, mean - t.mean))
            for t in truth.tissues
        ]
        # A tissue has a positive order.
        if min(distances) > _FAR - 1e-9 and mean[2] > 0.03:
            return Tissue("foreign", mean, base.covariance)


def _of_class(
    tissue: Tissue, precision: Array, count: int, generator: np.random.Generator
) -> Likelihood:
    value = generator.multivariate_normal(tissue.mean, tissue.covariance, count)
    chosen = precision[generator.integers(len(precision), size=count)]
    return draw_likelihood(value, chosen, generator)


@dataclass(frozen=True, eq=False)
class _Places:
    """Several contacts with one place: their evidence added, or their probabilities multiplied."""

    counts: tuple[int, ...]
    added: list[float]  #: calibration error
    multiplied: list[float]
    error: list[float]


def _places(
    truth: TissueLibrary,
    library: TissueLibrary,
    precision: Array,
    size: _Size,
    generator: np.random.Generator,
) -> _Places:
    drawn: Drawn = draw(truth, precision, size.drawn // 2, generator)
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
    return _Places(counts, added, multiplied, error)


# Lesions


@dataclass(frozen=True, eq=False)
class _Lesions:
    """What the comparison with the surroundings tells."""

    curves: dict[float, tuple[Array, Array, float]]  #: by contrast
    by_size: dict[tuple[float, float], float]  #: area by contrast and diameter
    coverage: float  #: of the 95 % interval of the ratio where there is no lesion around
    coverage_among: float  #: of healthy sites among lesions, which the surroundings include
    false_alarms: float  #: healthy sites with P(stiffer by RATIO) above a half
    found: dict[float, float]  #: sites of a contrast with that
    grid: Grid
    compared: list[Comparison | None]
    through_pipeline: bool
    pipeline_areas: dict[float, float]


def _lesions(
    precision: Array,
    size: _Size,
    generator: np.random.Generator,
    advance: Callable[[], None],
) -> _Lesions:
    parts: list[tuple[Array, ...]] = []
    last: tuple[Grid, list[Comparison | None]] | None = None
    for _ in range(size.grids):
        grid = make_grid(generator)
        compared = comparisons(grid, drawn_estimates(grid, precision, generator))
        last = grid, compared
        parts.append(_grid_scores(grid, compared))
        advance()
    assert last is not None
    sound = make_grid(generator, has_lesions=False)
    _, holds, _, _, _ = _grid_scores(
        sound, comparisons(sound, drawn_estimates(sound, precision, generator))
    )
    areas = {}
    if size.presses_grid:
        grid = make_grid(np.random.default_rng(7))
        last = grid, comparisons(grid, pressed_estimates(grid, advance))
        score, _, _, truth, _ = _grid_scores(*last)
        areas = {c: _curve(score, truth, c)[2] for c in CONTRASTS}
    score, inside, alarm, truth, diameter = (
        np.concatenate(part) for part in zip(*parts, strict=True)
    )
    return _Lesions(
        {contrast: _curve(score, truth, contrast) for contrast in CONTRASTS},
        {
            (contrast, wide): _curve(
                score[(truth == 1.0) | (diameter == wide)],
                truth[(truth == 1.0) | (diameter == wide)],
                contrast,
            )[2]
            for contrast in CONTRASTS
            for wide in DIAMETERS
        },
        float(np.mean(holds)),
        float(np.mean(inside[truth == 1.0])),
        float(np.mean(alarm[truth == 1.0])),
        {contrast: float(np.mean(alarm[truth == contrast])) for contrast in CONTRASTS},
        *last,
        size.presses_grid,
        areas,
    )


def _grid_scores(
    grid: Grid, compared: Sequence[Comparison | None]
) -> tuple[Array, Array, Array, Array, Array]:
    """Return score, interval holds the truth, alarm, contrast and diameter of the sites."""
    used = [i for i, one in enumerate(compared) if one is not None and not grid.edge[i]]
    contrasts = np.array([i.contrast for i in grid.inclusions] + [1.0])
    diameters = np.array([i.diameter for i in grid.inclusions] + [0.0])
    ones = [compared[i] for i in used]
    own = true_log_stiffness(grid)
    healthy = _healthy(grid, own)
    holds = []
    for index, one in zip(used, ones, strict=True):
        assert one is not None
        low, high = one.interval()
        holds.append(low <= math.exp(own[index] - healthy[index]) <= high)
    return (
        np.array([one.deviations for one in ones if one is not None]),
        np.array(holds, dtype=float),
        np.array([one.probability_stiffer(RATIO) > 0.5 for one in ones if one is not None]),
        contrasts[grid.inside[used]],
        diameters[grid.inside[used]],
    )


def _healthy(grid: Grid, own: Array) -> Array:
    """Return the mean of l over the healthy surroundings of each site, shape (n,)."""
    sound = (grid.inside < 0) & ~grid.edge
    near = [neighbours(grid.positions, i, SURROUNDINGS) for i in range(len(own))]
    return np.array([float(np.mean(own[index[sound[index]]])) for index in near])


def _curve(score: Array, truth: Array, contrast: float) -> tuple[Array, Array, float]:
    kept = (truth == 1.0) | (truth == contrast)
    return roc(score[kept], truth[kept] == contrast)


# What came out


@dataclass(frozen=True, eq=False)
class _Found:
    pressed: list[Pressed]
    through: _Through
    bound: tuple[float, float]
    trials: list[_Trial]
    curve: dict[int, _Trial]
    foreign: _Foreign
    places: _Places
    lesions: _Lesions
    told: dict[str, Told]

    def mean(self, method: str, what: str) -> float:
        """Return a score, averaged over the libraries."""
        return float(np.mean([getattr(t.scores[method], what) for t in self.trials]))


def _goals(found: _Found, quick: bool) -> list[Goal]:
    calibration = max(trial.calibration for trial in found.trials)
    ratio = found.mean(OWN, "error") / found.bound[0]
    count = sum(len(trial.open_truth) for trial in found.trials)
    through = found.through
    off = abs(through.error - through.expected_error) / through.error_sd
    goals = [
        within("contacts with known truth, drawn", float(count), (20_000.0, math.inf)),
        within("expected calibration error, worst library", calibration, (0.0, 0.02)),
        within("error over Bayes' error", ratio, (0.0, 1.1)),
        within(f"left out, {_FAR:g} sd away: called unknown", found.foreign.called, (0.95, 1.0)),
        within(
            "known tissues called unknown",
            float(np.mean([trial.false_unknown for trial in found.trials])),
            (0.0, 0.05),
        ),
        within("through the pipeline: error less expected, in sd", off, (0.0, 2.5)),
        within(
            "contacts of one place, added: calibration error, worst",
            max(found.places.added),
            (0.0, 0.02),
        ),
        within(
            "error over that of the best peer",
            found.mean(OWN, "error") / min(found.mean(name, "error") for name in (QDA, MIXTURE)),
            (0.0, 1.0),
        ),
    ]
    if found.told:
        errors = int(found.told[ONLINE].kinds.errors.sum())
        goals.append(
            Goal("beef and silicone: errors in cross-validation", errors, "0", errors == 0)
        )
    elif not quick:
        goals.append(Goal("beef and silicone: errors in cross-validation", None, "0", None))
    if quick:
        # One library and few contacts: what is near its goal cannot be decided.
        goals = [_undecided(goal) for goal in goals]
    return goals


def _undecided(goal: Goal) -> Goal:
    is_short = any(word in goal.name for word in ("Bayes", "left out", "pipeline", "best peer"))
    return Goal(goal.name, goal.value, goal.goal, None) if is_short else goal


def _figures(found: _Found) -> dict[str, Any]:
    through, places, lesions = found.through, found.places, found.lesions
    return {
        "bayes_error": {"value": found.bound[0], "standard_error": found.bound[1]},
        "specimens_per_class": _SPECIMENS,
        "contacts_per_specimen": _PER_SPECIMEN,
        "open_set": {
            "calibration_error": [t.calibration for t in found.trials],
            "classwise_calibration_error": [t.classwise for t in found.trials],
            "false_unknown": [t.false_unknown for t in found.trials],
        },
        "peers": {
            name: {what: found.mean(name, what) for what in ("error", "calibration", "log_loss")}
            for name in (OWN, QDA, MIXTURE)
        },
        "learning_curve": {
            str(count): {
                name: {"error": s.error, "calibration": s.calibration, "log_loss": s.log_loss}
                for name, s in trial.scores.items()
            }
            | {"open_set_calibration_error": trial.calibration}
            for count, trial in found.curve.items()
        },
        "foreign": {
            "called_unknown": found.foreign.called,
            "worst_class": found.foreign.worst,
            "all_contacts": found.foreign.with_all,
            "roc_area": found.foreign.roc[2],
        },
        "pipeline": {
            "contacts": len(found.pressed),
            "converged": through.converged,
            "error": through.error,
            "expected_error": through.expected_error,
            "error_sd": through.error_sd,
            "nees": through.nees,
            "labelled": through.decided,
            "labels_wrong": through.wrong,
            "label_changes_per_contact": through.changes,
            "decision_time_s": _quantiles(through.times),
            "decision_strain": _quantiles(through.strains),
        },
        "one_place": {
            "contacts": places.counts,
            "calibration_error_added": places.added,
            "calibration_error_multiplied": places.multiplied,
            "error": places.error,
        },
        "lesions": {
            "roc_area": {str(c): curve[2] for c, curve in lesions.curves.items()},
            "roc_area_by_size": {
                f"{c:g} times, {d:g} mm": area for (c, d), area in lesions.by_size.items()
            },
            "pipeline_roc_area": {str(c): area for c, area in lesions.pipeline_areas.items()},
            "interval_coverage": lesions.coverage,
            "interval_coverage_among_lesions": lesions.coverage_among,
            "false_alarms": lesions.false_alarms,
            "found": {str(c): share for c, share in lesions.found.items()},
        },
        "real": {name: _told_figures(one) for name, one in found.told.items()},
    }


def _quantiles(values: Array) -> dict[str, float]:
    if not values.size:
        return {}
    return {f"{q}": float(np.percentile(values, q)) for q in (5, 50, 95)}


def _told_figures(told: Told) -> dict[str, Any]:
    figures: dict[str, Any] = {
        "contacts": len(told.kinds.truth),
        "errors": int(told.kinds.errors.sum()),
        "error_95": told.kinds.interval(),
        "called_unknown": int(told.kinds.unknown.sum()),
        "log_loss": _log_loss(told.kinds.probabilities, told.kinds.truth),
        "mismatched": told.mismatched,
    }
    if told.cuts is not None:
        figures["cuts"] = {
            "contacts": len(told.cuts.truth),
            "error": float(np.mean(told.cuts.errors)),
            "error_95": told.cuts.interval(),
        }
    return figures


def _log_loss(probabilities: Array, truth: Indices) -> float:
    known = probabilities[:, :-1]
    own = known[np.arange(len(truth)), truth] / known.sum(axis=1)
    return float(-np.mean(np.log(np.maximum(own, 1e-12))))


# Tables


def _tables(found: _Found, truth: TissueLibrary) -> list[Table]:
    tables = [_peer_table(found), _confusion_table(found, truth), _pipeline_table(found)]
    tables.append(_lesion_table(found.lesions))
    if found.told:
        tables.append(_real_table(found.told))
    return tables


def _table(title: str, columns: Sequence[str]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for index, name in enumerate(columns):
        table.add_column(name, justify="right" if index else "left", no_wrap=True)
    return table


def _peer_table(found: _Found) -> Table:
    bound, own = found.bound
    table = _table(
        f"Known tissues, {len(found.trials)} libraries of {_SPECIMENS} specimens a class; Bayes' "
        f"error {100 * bound:.2f} ± {100 * own:.2f} %",
        ("", "error", "over Bayes'", "calibration error", "log loss"),
    )
    for name in (OWN, QDA, MIXTURE):
        error = found.mean(name, "error")
        table.add_row(
            name,
            f"{100 * error:.2f} %",
            f"{error / bound:.3f}",
            f"{found.mean(name, 'calibration'):.4f}",
            f"{found.mean(name, 'log_loss'):.4f}",
        )
    return table


def _confusion_table(found: _Found, truth: TissueLibrary) -> Table:
    table = _table("Truth (row) and label, in %", ("", *truth.class_names))
    shares = np.mean([trial.confusion for trial in found.trials], axis=0)
    for tissue, row in zip(truth.tissues, shares, strict=True):
        table.add_row(tissue.name, *(f"{100 * share:.1f}" for share in row))
    return table


def _pipeline_table(found: _Found) -> Table:
    one = found.through
    table = _table("Through the pipeline", ("", ""))
    time, strain = _quantiles(one.times), _quantiles(one.strains)
    rows = [
        ("contacts, of them converged", f"{len(found.pressed)}, {one.converged}"),
        ("error", f"{100 * one.error:.1f} %"),
        (
            "expected from their probabilities",
            f"{100 * one.expected_error:.1f} ± {100 * one.error_sd:.1f} %",
        ),
        ("squared error over covariance (1)", f"{one.nees:.2f}"),
        ("converged contacts with a label", f"{100 * one.decided:.0f} %"),
        ("labels replaced, a contact", f"{one.changes:.3f}"),
    ]
    if time:
        rows += [
            ("label after, median (95 %)", f"{time['50']:.2f} ({time['95']:.2f}) s"),
            ("at a strain of", f"{strain['50']:.3f} ({strain['95']:.3f})"),
        ]
    for row in rows:
        table.add_row(*row)
    return table


def _lesion_table(lesions: _Lesions) -> Table:
    columns = ("", "area under ROC", *(f"{d:g} mm" for d in DIAMETERS), f"P(> {RATIO:g}) > ½")
    if lesions.pipeline_areas:
        columns = (*columns, "pipeline")
    table = _table(
        f"Lesions: sites against their surroundings; false alarms {100 * lesions.false_alarms:.1f}"
        f" %; 95 % intervals hold the truth of {100 * lesions.coverage:.0f} %, among lesions "
        f"{100 * lesions.coverage_among:.0f} %",
        columns,
    )
    for contrast in CONTRASTS:
        cells = [f"{lesions.curves[contrast][2]:.3f}"]
        cells += [f"{lesions.by_size[contrast, d]:.3f}" for d in DIAMETERS]
        cells.append(f"{100 * lesions.found[contrast]:.0f} %")
        if lesions.pipeline_areas:
            cells.append(f"{lesions.pipeline_areas[contrast]:.3f}")
        table.add_row(f"{contrast:g} times", *cells)
    return table


def _real_table(told: Mapping[str, Told]) -> Table:
    table = _table(
        "Measured: one specimen left out (silicone is one piece: one test left out)",
        ("parameters", "beef | silicone", "95 %", "unknown", "log loss", "cuts of beef", "95 %"),
    )
    for name, one in told.items():
        low, high = one.kinds.interval()
        cells = [
            f"{int(one.kinds.errors.sum())} of {len(one.kinds.truth)}",
            f"{100 * low:.0f} to {100 * high:.0f} %",
            str(int(one.kinds.unknown.sum())),
            f"{_log_loss(one.kinds.probabilities, one.kinds.truth):.3f}",
        ]
        if one.cuts is not None:
            low, high = one.cuts.interval()
            cells += [
                f"{100 * float(np.mean(one.cuts.errors)):.0f} % wrong",
                f"{100 * low:.0f} to {100 * high:.0f} %",
            ]
        table.add_row(name, *cells)
    return table


# The picture

_COLORS = {OWN: "#1f77b4", QDA: "#d95f02", MIXTURE: "#7570b3"}
_CONTRAST_COLORS = ("#74add1", "#f46d43", "#a50026")


def _draw(figure: Figure, found: _Found, truth: TissueLibrary) -> None:
    figure.set_size_inches(16, 9)
    axes = figure.subplots(2, 4)
    _draw_reliability(axes[0, 0], found)
    _draw_confusion(axes[0, 1], found, truth)
    _draw_curve(axes[0, 2], found)
    _draw_unknown(axes[0, 3], found)
    _draw_settling(axes[1, 0], found, truth)
    _draw_places(axes[1, 1], found.places)
    _draw_roc(axes[1, 2], found.lesions)
    _draw_map(figure, axes[1, 3], found.lesions)


def _draw_reliability(axes: Axes, found: _Found) -> None:
    probabilities = np.concatenate([t.open_probabilities for t in found.trials])
    truth = np.concatenate([t.open_truth for t in found.trials])
    error, said, right, count = calibration_error(probabilities, truth)
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1.0)
    spread = 2.0 * np.sqrt(np.maximum(right * (1.0 - right), 1e-9) / np.maximum(count, 1))
    axes.errorbar(said, right, spread, fmt="o-", color=_COLORS[OWN], markersize=4, capsize=2)
    twin = axes.twinx()
    width = 1.0 / len(count)
    twin.bar((np.arange(len(count)) + 0.5) * width, count / count.sum(), width, color="0.85")
    twin.set_ylim(0.0, 1.5)
    twin.set_yticks([])
    axes.set_zorder(twin.get_zorder() + 1)
    axes.patch.set_visible(False)
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.02)
    axes.set_xlabel("probability of the most probable class")
    axes.set_ylabel("share that is right")
    axes.set_title(
        f"Reliability, {len(truth):,} contacts: calibration error {error:.4f}", fontsize=10
    )
    axes.text(
        0.03, 0.9, "unknown is one of them;\nbars: share of the contacts", color="0.5", fontsize=8
    )


def _draw_confusion(axes: Axes, found: _Found, truth: TissueLibrary) -> None:
    shares = 100.0 * np.mean([trial.confusion for trial in found.trials], axis=0)
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=100.0, aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        axes.text(
            column,
            row,
            f"{share:.1f}",
            ha="center",
            va="center",
            color="white" if share > 55.0 else "0.15",
            fontsize=9,
        )
    names = [name.replace(" ", "\n") for name in truth.class_names]
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_yticks(range(len(names) - 1), names[:-1], fontsize=8)
    axes.set_ylabel("truth")
    axes.set_title("Label given, % of the truth", fontsize=10)


def _draw_curve(axes: Axes, found: _Found) -> None:
    counts = list(found.curve)
    for name, color in _COLORS.items():
        ratios = [found.curve[n].scores[name].error / found.bound[0] for n in counts]
        axes.plot(counts, ratios, "o-", color=color, markersize=4, label=name)
    axes.axhline(1.0, color="0.7", linewidth=1.0)
    axes.axhline(1.1, color="0.7", linewidth=1.0, linestyle="--")
    axes.set_xscale("log")
    axes.set_xticks(counts, [str(n) for n in counts])
    axes.minorticks_off()
    top = max(found.curve[counts[0]].scores[n].error for n in _COLORS) / found.bound[0]
    axes.set_ylim(0.95, min(1.05 * top, 2.5))
    axes.set_xlabel(f"specimens per class, {_PER_SPECIMEN} contacts each")
    axes.set_ylabel("error over Bayes' error")
    axes.set_title("Learning from few specimens", fontsize=10)
    axes.legend(fontsize=8)


def _draw_unknown(axes: Axes, found: _Found) -> None:
    false, true, area = found.foreign.roc
    keep = np.unique(np.linspace(0, len(false) - 1, 2000).astype(int))
    axes.plot(100.0 * false[keep], 100.0 * true[keep], color=_COLORS[OWN])
    at = float(np.mean([trial.false_unknown for trial in found.trials]))
    axes.plot(100.0 * at, 100.0 * found.foreign.called, "o", color="#d95f02", label="as labelled")
    axes.axvline(5.0, color="0.7", linewidth=1.0, linestyle="--")
    axes.axhline(95.0, color="0.7", linewidth=1.0, linestyle="--")
    axes.set_xlim(0.0, 10.0)
    axes.set_ylim(80.0, 100.2)
    axes.set_xlabel("known tissues called unknown, %")
    axes.set_ylabel(f"classes {_FAR:g} sd away called unknown, %")
    axes.set_title(f"The unknown: area under ROC {area:.4f}", fontsize=10)
    axes.legend(fontsize=8, loc="lower right")


def _draw_settling(axes: Axes, found: _Found, truth: TissueLibrary) -> None:
    shown = 0
    for one in found.pressed:
        if not one.track or shown >= 60:
            continue
        shown += 1
        times = [time for time, _, _ in one.track]
        own = [p[one.truth] for _, _, p in one.track]
        end = (one.summary.end_ns - one.summary.start_ns) * 1e-9 if one.summary else times[-1]
        axes.step(
            [*times, end],
            [*own, own[-1]],
            where="post",
            color=_COLORS[OWN] if own[-1] > 0.5 else "#d95f02",
            alpha=0.35,
            linewidth=1.0,
        )
    axes.axhline(DecisionConfig().probability, color="0.7", linewidth=1.0, linestyle="--")
    axes.set_ylim(0.0, 1.02)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("time since the touch [s]")
    axes.set_ylabel("probability of the true tissue")
    axes.text(
        0.98,
        0.03,
        "orange: another tissue in the end",
        transform=axes.transAxes,
        ha="right",
        color="#d95f02",
        fontsize=8,
    )
    median = np.median(found.through.times) if found.through.times.size else math.nan
    axes.set_title(f"As the contact goes on; label after {median:.2f} s (median)", fontsize=10)


def _draw_places(axes: Axes, places: _Places) -> None:
    axes.plot(places.counts, places.added, "o-", color=_COLORS[OWN], label="evidence added")
    axes.plot(
        places.counts,
        places.multiplied,
        "s-",
        color="#d95f02",
        label="probabilities multiplied",
    )
    axes.axhline(0.02, color="0.7", linewidth=1.0, linestyle="--")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("contacts with one place")
    axes.set_ylabel("calibration error")
    axes.set_title("Several contacts", fontsize=10)
    axes.legend(fontsize=8)


def _draw_roc(axes: Axes, lesions: _Lesions) -> None:
    for (contrast, (false, true, area)), color in zip(
        lesions.curves.items(), _CONTRAST_COLORS, strict=True
    ):
        axes.plot(false, true, color=color, label=f"{contrast:g} times stiffer: {area:.3f}")
    axes.plot([0, 1], [0, 1], color="0.8", linewidth=1.0)
    axes.set_xlim(-0.01, 1.0)
    axes.set_ylim(0.0, 1.01)
    axes.set_xlabel("false positive rate")
    axes.set_ylabel("true positive rate")
    axes.set_title("Lesions: ROC and its area", fontsize=10)
    axes.legend(fontsize=8, loc="lower right")


def _draw_map(figure: Figure, axes: Axes, lesions: _Lesions) -> None:
    from matplotlib.patches import Circle

    ratio = np.array([math.nan if c is None else c.ratio for c in lesions.compared])
    image = axes.imshow(
        np.log2(ratio).reshape(SIDE, SIDE).T,
        origin="lower",
        cmap="RdBu_r",
        vmin=-2.0,
        vmax=2.0,
        extent=(-0.5 * SPACING, (SIDE - 0.5) * SPACING) * 2,
    )
    for one in lesions.grid.inclusions:
        axes.add_patch(
            Circle((one.x, one.y), 0.5 * one.diameter, fill=False, color="0.1", linewidth=1.2)
        )
        axes.text(
            one.x, one.y + 0.5 * one.diameter + 1.0, f"{one.contrast:g}×", ha="center", fontsize=7
        )
    alarms = [
        i
        for i, c in enumerate(lesions.compared)
        if c is not None and c.probability_stiffer(RATIO) > 0.5
    ]
    axes.plot(*lesions.grid.positions[alarms].T, ".", color="k", markersize=2.5)
    bar = figure.colorbar(image, ax=axes, shrink=0.85, ticks=(-2, -1, 0, 1, 2))
    bar.ax.set_yticklabels(["¼", "½", "1", "2", "4"])
    bar.set_label("times stiffer than around")
    axes.set_xlabel("mm")
    how = "through the pipeline" if lesions.through_pipeline else "drawn"
    axes.set_title(f"400 sites {how};\ndot: P(> {RATIO:g} times) > ½", fontsize=10)
