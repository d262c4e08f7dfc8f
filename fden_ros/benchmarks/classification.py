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
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fden_ros.benchmarks import Goal, Report, progress, real, within
from fden_ros.benchmarks.classification_found import Found, draw_picture, quantiles, tables_of
from fden_ros.benchmarks.lesions import (
    SIDE,
    compare_lesions,
)
from fden_ros.benchmarks.measured_tests import read_tests
from fden_ros.benchmarks.populations import (
    bayes_error,
    informations,
    log_loss,
    population,
    press_many,
)
from fden_ros.benchmarks.real_classes import ONLINE, Told, tell
from fden_ros.benchmarks.tissue_classes import (
    FAR,
    MIXTURE,
    OWN,
    PER_SPECIMEN,
    QDA,
    SPECIMENS,
    left_out,
    presses_of_one_place,
    through_pipeline,
    try_library,
)
from fden_ros.errors import InputError

if TYPE_CHECKING:
    pass


EPILOG = """\
examples:
  fden benchmark classification --quick           simulated tissues only, under a minute
  fden benchmark classification measured/         the whole of it, measured tissue included
  FDEN_DATA=measured fden benchmark classification --json | jq '.figures.peers'

Measured tests: as for fden benchmark real; without them that part is left out.
"""


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
    tests = read_tests(Path(args.data)) if args.data is not None and not args.quick else []
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
            try_library(truth, precision, SPECIMENS, size.drawn, generator, advance)
            for _ in range(size.libraries)
        ]
        curve = {
            count: try_library(truth, precision, count, size.drawn // 2, generator, advance)
            for count in size.curve
        }
        library = trials[0].library
        libraries = [trial.library for trial in trials]
        foreign = left_out(truth, libraries, pressed, size.foreign, generator, advance)
        places = presses_of_one_place(truth, library, precision, size.drawn // 2, generator)
        lesions = compare_lesions(
            precision, size.grids, generator, advance, presses_grid=size.presses_grid
        )
        told = tell(tests, advance) if tests else {}
    found = Found(
        pressed,
        through_pipeline(truth, pressed),
        bound,
        trials,
        curve,
        foreign,
        places,
        lesions,
        told,
    )
    return Report(
        goals=_goals(found, args.quick),
        figures=_figures(found),
        draw=lambda figure: draw_picture(figure, found, truth),
        tables=tables_of(found, truth),
    )


def _require_sklearn() -> None:
    try:
        import sklearn  # type: ignore[import-untyped]  # noqa: F401
    except ImportError:
        raise InputError(
            "the peers need scikit-learn: pip install 'fden_ros[benchmark]', or pip install "
            "scikit-learn"
        ) from None


# What came out


def _goals(found: Found, quick: bool) -> list[Goal]:
    calibration = max(trial.calibration for trial in found.trials)
    ratio = found.mean(OWN, "error") / found.bound[0]
    count = sum(len(trial.open_truth) for trial in found.trials)
    through = found.through
    off = abs(through.error - through.expected_error) / through.error_sd
    goals = [
        within("contacts with known truth, drawn", float(count), (20_000.0, math.inf)),
        within("expected calibration error, worst library", calibration, (0.0, 0.02)),
        within("error over Bayes' error", ratio, (0.0, 1.1)),
        within(f"left out, {FAR:g} sd away: called unknown", found.foreign.called, (0.95, 1.0)),
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


def _figures(found: Found) -> dict[str, Any]:
    through, places, lesions = found.through, found.places, found.lesions
    return {
        "bayes_error": {"value": found.bound[0], "standard_error": found.bound[1]},
        "specimens_per_class": SPECIMENS,
        "contacts_per_specimen": PER_SPECIMEN,
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
            "decision_time_s": quantiles(through.times),
            "decision_strain": quantiles(through.strains),
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


def _told_figures(told: Told) -> dict[str, Any]:
    figures: dict[str, Any] = {
        "contacts": len(told.kinds.truth),
        "errors": int(told.kinds.errors.sum()),
        "error_95": told.kinds.interval(),
        "called_unknown": int(told.kinds.unknown.sum()),
        "log_loss": log_loss(told.kinds.probabilities, told.kinds.truth),
        "mismatched": told.mismatched,
    }
    if told.cuts is not None:
        figures["cuts"] = {
            "contacts": len(told.cuts.truth),
            "error": float(np.mean(told.cuts.errors)),
            "error_95": told.cuts.interval(),
        }
    return figures
