# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Questions about recordings of others: what is seen, what is asked, and what is known of it.

docs/accuracy.md has the tables that they are read from, and those in which they are put to the
programs of others.
"""

from __future__ import annotations

import csv
import gzip
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmark.harness import DATA_VARIABLE
from benchmark.measured import COLUMNS as HOLD_COLUMNS
from benchmark.measured import read_table
from benchmark.peers import Samples
from fden_ros.core.arrays import Array
from fden_ros.errors import InputError

#: What is asked: N/m of a motion of :data:`TIME_SCALE`, the force [N] at some times and depths,
#: or the order of the relaxation [1].
STIFFNESS, FORCE, ALPHA = "stiffness", "force", "alpha"
PRESS_COLUMNS = ("time_s", "force_N", "displacement_mm")
RELAXATION_COLUMNS = ("time_s", "modulus_Pa")
#: How long the small motion lasts [s].
TIME_SCALE = 0.1
#: Half the window of a curve's own slope [m].
_HALF_WINDOW = 2.5e-4
_QUESTION = ("question", "asked", "time_s", "displacement_mm", "area_m2", "thickness_m")


class Answer(NamedTuple):
    """What an estimator says, arrays of shape (m,); NaN: it gives no value, or no deviation."""

    values: Array
    sds: Array


@dataclass(frozen=True)
class Question:
    """What an estimator is given, and what is known of the answer."""

    name: str
    asked: str
    group: str  #: whose figures are one row
    seen: Samples
    times: Array  #: of what is asked [s], shape (m,)
    depths: Array  #: there [m], shape (m,)
    truth: Array  #: shape (m,)
    truth_sd: float = 0.0
    area: float = math.nan  #: of the face [m^2]
    thickness: float = math.nan  #: [m]
    phantom: str = ""
    modulus: float = math.nan  #: [Pa]; NaN: not known
    is_over: bool = False  #: the probe has left: it is asked of the deepest point

    def answer(self, values: Any = math.nan, sds: Any = math.nan) -> Answer:
        """Return an answer of the right shape."""
        shape = self.times.shape
        return Answer(np.broadcast_to(values, shape), np.broadcast_to(sds, shape))


def read_questions(
    folder: Path | None, strains: Sequence[float], most: int | None = None
) -> list[Question]:
    """Return the questions of every table in a folder.

    Parameters
    ----------
    folder : Path or None
    strains : sequence of float
        At which a compression without a stated stiffness is cut [1].
    most : int, optional
        Tests of each table at most, evenly taken.

    Raises
    ------
    InputError
        If there is no such folder or table, or a number that cannot be read.
    """
    if folder is None:
        raise InputError(f"no data: name the folder with the tables, or set {DATA_VARIABLE}")
    questions: list[Question] = []
    for path in sorted((*folder.glob("*.csv"), *folder.glob("*.csv.gz"))):
        beside = path.with_name(path.name.partition(".")[0] + "_truth.csv")
        if beside.exists():
            questions += _questions_of(path, beside, strains, most)
        elif set(HOLD_COLUMNS) <= set(_headings(path)):
            questions += [_hold(test) for test in _some(read_table(path), most)]
    if not questions:
        words = f"and none of the columns {', '.join(HOLD_COLUMNS)}"
        raise InputError(f"{folder}: no table with a table of its truths beside, {words}")
    return questions


def _headings(path: Path) -> list[str]:
    with _opened(path) as file:
        return next(csv.reader(file), [])


def _opened(path: Path) -> Any:
    return (gzip.open if path.suffix == ".gz" else open)(path, "rt", encoding="utf-8", newline="")


def _some(tests: Sequence[Any], most: int | None) -> Sequence[Any]:
    return tests[:: max(len(tests) // most, 1)][:most] if most else tests


def _questions_of(
    path: Path, beside: Path, strains: Sequence[float], most: int | None
) -> Iterator[Question]:
    with _opened(beside) as file:
        truths = {row["test"]: row for row in csv.DictReader(file)}
    is_relaxation = set(RELAXATION_COLUMNS) <= set(_headings(path))
    columns = RELAXATION_COLUMNS if is_relaxation else PRESS_COLUMNS
    rows: dict[str, list[list[float]]] = defaultdict(list)
    try:
        with _opened(path) as file:
            for row in csv.DictReader(file):
                rows[row["test"]].append([float(row[name]) for name in columns])
        for name in _some(sorted(rows.keys() & truths.keys()), most):
            table = np.array(rows[name])
            if is_relaxation:
                yield _relaxation(name, truths[name], table)
            else:
                yield from _press(name, truths[name], table, strains)
    except (KeyError, ValueError) as error:
        words = f"{path}: not the columns test, {', '.join(columns)} with numbers"
        known = "alpha and alpha_sd" if is_relaxation else "area_m2 and thickness_m"
        raise InputError(f"{words}, or no {known} in {beside}: {error}") from None


def _press(
    name: str, truth: Mapping[str, str], table: Array, strains: Sequence[float]
) -> Iterator[Question]:
    times, forces, depths = table[:, 0], table[:, 1], 1e-3 * table[:, 2]
    known: dict[str, Any] = {
        "area": float(truth["area_m2"]),
        "thickness": float(truth["thickness_m"]),
        "modulus": float(truth.get("modulus_Pa") or math.nan),
        "phantom": truth.get("phantom") or name,
    }
    stated = truth.get("stiffness_N_per_m")

    def asked(at: str, stop: int, end: int, slope: float) -> Question:
        when, depth = times[end - 1 : end] + TIME_SCALE, depths[end - 1 : end]
        seen = Samples(times[:stop], depths[:stop], forces[:stop])
        own = (f"{name} {at}", STIFFNESS, f"N/m {at}", seen, when, depth, np.array([slope]))
        return Question(*own, **known, is_over=bool(stated))

    if stated:
        end = int(np.argmax(depths)) + 1
        yield asked("where it was deepest", times.size, end, float(stated))
        return
    for strain in strains:
        depth = strain * known["thickness"]
        if depths.max() >= depth + _HALF_WINDOW:
            about = np.abs(depths - depth) <= _HALF_WINDOW
            slope = float(np.polyfit(depths[about], forces[about], 1)[0])
            stop = int(np.argmax(depths >= depth)) + 1
            yield asked(f"at a strain of {strain:g}", stop, stop, slope)


def _hold(test: Any) -> Question:
    seen, rest = slice(test.seen), slice(test.seen, None)
    samples = Samples(test.times[seen], test.displacements[seen], test.forces[seen])
    asked = (test.times[rest], test.displacements[rest], test.forces[rest])
    group = f"force in a hold, {test.kind}"
    return Question(test.name, FORCE, group, samples, *asked, thickness=test.thickness)


def _relaxation(name: str, truth: Mapping[str, str], table: Array) -> Question:
    """Return what is asked of a step of the strain by 1 at time 0, of a face and length of 1."""
    begun = np.vstack([np.zeros(2), table])
    seen = Samples(begun[:, 0], np.sign(begun[:, 0]), begun[:, 1])
    asked = (seen.times[-1:], seen.depths[-1:], np.array([float(truth["alpha"])]))
    sd = float(truth["alpha_sd"])
    return Question(name, ALPHA, "alpha of a relaxation", seen, *asked, sd, 1.0, 1.0)


# To and from the programs of others


def write_questions(folder: Path, questions: Sequence[Question]) -> None:
    """Write what is seen as ``samples.csv``, and what is asked as ``questions.csv``."""
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "samples.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("question", *PRESS_COLUMNS))
        for q in questions:
            columns = (q.seen.times, q.seen.forces, 1e3 * q.seen.depths)
            writer.writerows((q.name, *map(float, row)) for row in zip(*columns, strict=True))
    with open(folder / "questions.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(_QUESTION)
        for q in questions:
            for time, depth in zip(q.times.tolist(), (1e3 * q.depths).tolist(), strict=True):
                writer.writerow((q.name, q.asked, time, depth, q.area, q.thickness))


def read_answers(path: Path, questions: Sequence[Question]) -> list[Answer]:
    """Return the answers of another program to these questions; NaN where it gives none.

    Raises
    ------
    InputError
        If it is no table of ``question``, ``time_s``, ``value`` and ``sd``, or no row fits.
    """
    found: dict[tuple[str, float], tuple[float, float]] = {}
    try:
        with _opened(path) as file:
            for row in csv.DictReader(file):
                numbers = (float(row["value"] or math.nan), float(row.get("sd") or math.nan))
                found[row["question"], float(row["time_s"])] = numbers
    except (OSError, KeyError, ValueError) as error:
        words = "expected the rows of questions.csv, with the columns value and sd"
        raise InputError(f"{path}: {words}: {error}") from None
    nothing = (math.nan, math.nan)
    answers = [
        Answer(*np.array([found.get((q.name, t), nothing) for t in q.times.tolist()]).T)
        for q in questions
    ]
    if not any(np.isfinite(answer.values).any() for answer in answers):
        raise InputError(f"{path}: no value in it answers a question of this folder")
    return answers
