# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings of others, and what is known of them, beside the estimators of others and your own.

docs/accuracy.md says where they come from, which tables they are, and how a program of your own
answers: the input is a table, and the output.

*Known*: a value was given. *Ratio*: to the truth, median and 5th to 95th percentile. *Rank*: with
the modulus, over all tests, and in each family, which is the first word of a phantom's name up to
_. *Repeats*: scatter of the logarithm within a phantom, over the stated deviation. *Error*: of
N/m in percent of the truth; of a force, root mean square, in percent of the peak; of alpha, as it
is. *Half width*: two stated deviations, in the same unit. *In 2 sd*: part of the truths within
two.
"""

from __future__ import annotations

import argparse
import math
from collections import defaultdict
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import spearmanr

from benchmark.estimators import answers_of
from benchmark.harness import Benchmark, Goal, Report, Table, at_least, at_most, measured
from benchmark.questions import (
    ALPHA,
    FORCE,
    STIFFNESS,
    Answer,
    Question,
    read_answers,
    read_questions,
    write_questions,
)
from benchmark.score import mean_of, rms, share
from fden_ros.commands.command import write_picture
from fden_ros.core.arrays import Array
from fden_ros.report import style

EPILOG = """\
examples:
  fden benchmark public recordings/                        all tests
  fden benchmark public recordings/ --questions mine/      what a program of your own is asked
  fden benchmark public recordings/ --answers mine/own.csv beside the others, as "own"
  fden benchmark public recordings/ --picture errors.png   the errors of all
"""

_QUICK_TESTS = 6

Pair = tuple[Question, Answer]


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    strains = [float(text) for text in args.strains.split(",")]
    questions = read_questions(args.data, strains, _QUICK_TESTS if args.quick else None)
    if args.questions is not None:
        write_questions(args.questions, questions)
    own = {path.stem: read_answers(path, questions) for path in args.answers}
    found = measured(answers_of, [(q,) for q in questions], what="recordings")
    groups: dict[str, dict[str, list[Pair]]] = defaultdict(lambda: defaultdict(list))
    for number, (question, answers) in enumerate(zip(questions, found, strict=True)):
        answers |= {name: those[number] for name, those in own.items()}
        for name, answer in answers.items():
            groups[question.group][name].append((question, answer))
    tables, goals = {}, []
    for group, pairs in groups.items():
        rows = {name: row_of(those) for name, those in pairs.items()}
        rows = {name: row for name, row in rows.items() if row["known"].part}
        tables[group] = Table(group, rows)
        goals += _goals(group, rows.get("FDEN"))
    if args.picture is not None:
        write_picture(args.picture, partial(_draw, tables=list(tables.values())))
    return Report(goals, tables)


def _draw(figure: Figure, tables: Sequence[Table]) -> None:
    """Draw the median error of each estimator, with a line to its 90th percentile."""
    figure.set_size_inches(1.6 + 2.3 * len(tables), 2.5)
    names = list(dict.fromkeys(name for table in tables for name in table.rows))[::-1]
    (panels,) = figure.subplots(1, len(tables), sharey=True, squeeze=False)
    for axes, table in zip(panels, tables, strict=True):
        for name, row in table.rows.items():
            color = style.ESTIMATE if name == "FDEN" else style.MUTED
            at, ends = names.index(name), (row["error, median"], row["error, 90 %"])
            axes.plot(ends, [at, at], color=color, linewidth=3.0)
            axes.plot(ends[0], at, "o", color=color)
        axes.set_title(table.title)
        is_order = "alpha" in table.title
        axes.set_xlabel("error" if is_order else "error [%]")
        axes.set_yticks(range(len(names)), names)
        axes.set_xscale("log")
        ticks = (0.01, 0.1, 1.0) if is_order else (0.1, 1.0, 10.0, 100.0, 1000.0)
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)


def row_of(pairs: Sequence[Pair]) -> dict[str, Any]:
    """Return the figures of one estimator."""
    are_known = [bool(np.isfinite(answer.values).all()) for _, answer in pairs]
    answered = [pair for pair, is_known in zip(pairs, are_known, strict=True) if is_known]
    row: dict[str, Any] = {"known": share(are_known)}
    if answered:
        asked = pairs[0][0].asked
        row |= _stiffness(answered) if asked == STIFFNESS else {}
        row |= _errors(answered)
    return row


def _errors(pairs: Sequence[Pair]) -> dict[str, Any]:
    """Return the figures of errors."""
    scales = [_scale(question) for question, _ in pairs]
    off = [s * rms(a.values - q.truth) for s, (q, a) in zip(scales, pairs, strict=True)]
    widths = [2.0 * s * np.median(a.sds) for s, (_, a) in zip(scales, pairs, strict=True)]
    return {
        "error, median": float(np.median(off)),
        "error, 90 %": float(np.percentile(off, 90.0)),
        "half width": float(np.median(widths)),
        "in 2 sd": mean_of(_inside(*pair) for pair in pairs),
    }


def _scale(question: Question) -> float:
    """Return what makes an error percent of the truth or of the peak; 1 of an order."""
    if question.asked == ALPHA:
        return 1.0
    whole = question.seen.forces if question.asked == FORCE else question.truth
    return 100.0 / float(whole.max())


def _inside(question: Question, answer: Answer) -> float:
    """Return the part of the truths that lie within two deviations; NaN: none is stated."""
    if not np.isfinite(answer.sds).all():
        return math.nan
    reach = 2.0 * np.hypot(answer.sds, question.truth_sd)
    return float(np.mean(np.abs(answer.values - question.truth) <= reach))


def _stiffness(pairs: Sequence[Pair]) -> dict[str, Any]:
    """Return the figures of N/m."""
    values = np.array([answer.values[0] for _, answer in pairs])
    sds = np.array([answer.sds[0] for _, answer in pairs])
    truths = np.array([question.truth[0] for question, _ in pairs])
    moduli = np.array([question.modulus for question, _ in pairs])
    phantoms = [question.phantom for question, _ in pairs]
    families = np.array([phantom.partition("_")[0] for phantom in phantoms])
    own = (families == family for family in sorted(set(families)))
    ratios = values / truths
    return {
        "ratio, median": float(np.median(ratios)),
        "ratio, 5 to 95 %": np.percentile(ratios, [5.0, 95.0]),
        "rank": _rank(values, moduli),
        "in each family": [_rank(values[of], moduli[of]) for of in own],
        "repeats": _repeats(phantoms, values, sds),
    }


def _rank(values: Array, moduli: Array) -> float:
    """Return the rank correlation of stiffnesses with moduli; NaN: these are not known."""
    if moduli.size < 3 or not np.isfinite(moduli).all():
        return math.nan
    return float(spearmanr(values, moduli).statistic)


def _repeats(phantoms: Sequence[str], values: Array, sds: Array) -> float:
    """Return the scatter of ln N/m within a phantom over its deviations, as a root mean square."""
    places = defaultdict(list)
    for k, phantom in enumerate(phantoms):
        places[phantom].append(k)
    off = []
    for own in (np.array(p) for p in places.values() if len(p) > 1):
        logs = np.log(np.maximum(values[own], 1e-300))
        scatter = (logs - logs.mean()) * math.sqrt(own.size / (own.size - 1.0))
        off += (scatter / (sds[own] / values[own])).tolist()
    return float(rms(np.array(off))) if off else math.nan


def _goals(group: str, row: dict[str, Any] | None) -> list[Goal]:
    if row is None:
        return [at_least(f"{group}: known", 0.0, 0.95)]
    goals = [at_least(f"{group}: known", row["known"].value, 0.95)]
    if math.isfinite(row.get("rank", math.nan)):
        goals.append(at_least(f"{group}: rank with the modulus", row["rank"], 0.97))
        families = row["in each family"]
        goals.append(at_least(f"{group}: the same in the worst family", min(families), 0.97))
    if math.isfinite(row.get("repeats", math.nan)):
        goals.append(at_most(f"{group}: repeats", row["repeats"], 2.0))
    return goals


def _more(parser: argparse.ArgumentParser) -> None:
    words = "where compressions are cut (0.15,0.3)"
    parser.add_argument("--strains", default="0.15,0.3", metavar="A,B", help=words)
    words = "write what is asked there, for another program"
    parser.add_argument("--questions", type=Path, metavar="FOLDER", help=words)
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the errors")
    words = "its answers; may be given again"
    parser.add_argument(
        "--answers", type=Path, action="append", default=[], metavar="FILE", help=words
    )


BENCHMARK = Benchmark(run, EPILOG, data=True, more=_more)
