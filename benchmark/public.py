# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings of others: N/m of what is pressed, by FDEN and by the estimators of others.

A folder has tables (CSV, also .gz) of the columns test, time_s, force_N and displacement_mm,
from the touch on, each with a table of its name and ``_truth`` beside it: test, area_m2 and
thickness_m of the specimen, and what is known of it, phantom and modulus_Pa, or stiffness_N_per_m
where it was deepest. Without a stiffness a test is cut at each of the strains, and the truth is
the slope of its own curve there, over half a millimetre.

*Known*: a number was given. *Ratio*: to the truth, median and 5th to 95th percentile. *In 2
sd*: truths within two stated deviations. *Rank*: with the modulus, over all tests, and in each
family, which is the first word of a phantom's name up to _. *Repeats*: scatter of the logarithm
within a phantom, over the stated deviation.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import spearmanr

from benchmark.harness import DATA_VARIABLE, Benchmark, Goal, Report, Table, at_least, measured
from benchmark.peers import PEERS, Peer, Samples
from benchmark.score import rms, share
from benchmark.trial import fed
from fden_ros.core.outputs import ContactSummary, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.errors import InputError
from fden_ros.parameters import check, pipeline_config
from simulation.simulate import KNOWN_RIG

EPILOG = """\
examples:
  fden benchmark public recordings/                    all tests, cut at strains of 0.15 and 0.3
  fden benchmark public recordings/ --strains 0.1      at another
  fden benchmark public recordings/ --quick            a few tests of each table

docs/accuracy.md names public recordings, and how they are made such tables.
"""

COLUMNS = ("test", "time_s", "force_N", "displacement_mm")
_QUICK_TESTS = 6
#: Half the window of a curve's own slope [m].
_HALF_WINDOW = 2.5e-4
#: How long the small motion lasts [s], and its size in parts of the depth [1].
TIME_SCALE, _STEP = 0.1, 1e-4
#: Samples that the estimators of others are given at most [1].
_MOST_SAMPLES = 500
_AT_STEP = np.array([0.1, 0.5, 1.0])


class Known(NamedTuple):
    """A stiffness that an estimator gives, with its deviation [N/m]; NaN: none."""

    value: float
    sd: float = math.nan


_NOTHING = Known(math.nan)


@dataclass(frozen=True)
class Press:
    """One recording, up to where its stiffness is asked for."""

    test: str
    phantom: str
    at: str  #: where that is
    samples: Samples
    area: float  #: [m^2]
    thickness: float  #: [m]
    modulus: float  #: [Pa]; NaN: not known
    truth: float  #: [N/m]
    is_over: bool  #: the probe has left: it is that of the whole contact


Estimator = Callable[[Press], Known]


def fden(press: Press) -> Known:
    """Return what the pipeline says, of a rig that is known."""
    parameters = KNOWN_RIG | {
        "geometry.kind": "flat_punch",
        "geometry.area": press.area,
        "geometry.thickness": press.thickness,
        "force.measure_bias": False,
        "origin.source": "given",
        "plausible.force": 1e6,
        "estimate.time_scale": TIME_SCALE,
    }
    outputs: list[Output] = []
    pipeline = Pipeline(pipeline_config(check(parameters)), outputs.append)
    samples = press.samples
    for _ in fed(pipeline, samples.times, samples.forces, samples.depths - samples.depths[0]):
        pass
    pipeline.finish()
    # Of a press that is over what its summary says, else what is known last.
    kinds = ContactSummary if press.is_over else (TissueState, ContactSummary)
    known = [o.apparent_stiffness for o in outputs if isinstance(o, kinds) and o.contact_id]
    found = known[0 if press.is_over else -1] if known else None
    return Known(found.value, found.sd) if found is not None else _NOTHING


def of_peer(peer: Peer, press: Press) -> Known:
    """Return what a small step would meet, by what another estimator predicts."""
    seen = press.samples
    if press.is_over:
        # Of the whole contact up to its deepest point.
        stop = int(np.argmax(seen.depths)) + 1
        seen = Samples(*(values[:stop] for values in seen))
    # Some of them take the square of the number of samples.
    thin = slice(None, None, -(-seen.times.size // _MOST_SAMPLES))
    seen = Samples(*(values[::-1][thin][::-1] for values in seen))
    times, depth = seen.times[-1] + TIME_SCALE * _AT_STEP, float(seen.depths[-1])
    step = _STEP * depth
    forces = [
        peer(seen, Samples(times, np.full(times.size, at), np.zeros(times.size)))[-1]
        for at in (depth, depth + step)
    ]
    found = float(forces[1] - forces[0]) / step
    return Known(found) if math.isfinite(found) else _NOTHING


def force_over_depth(press: Press) -> Known:
    """Return the largest force over the largest depth."""
    return Known(float(press.samples.forces.max() / press.samples.depths.max()))


def _estimated(press: Press) -> dict[str, Known]:
    found = {"FDEN": fden(press), "force over depth": force_over_depth(press)}
    others = {name: peer for name, peer in PEERS.items() if name != "last value"}
    return found | {name: of_peer(peer, press) for name, peer in others.items()}


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    strains = [float(text) for text in args.strains.split(",")]
    presses = read_presses(args.data, strains, _QUICK_TESTS if args.quick else None)
    found = measured(_estimated, [(press,) for press in presses], what="recordings")
    groups: dict[str, list[tuple[Press, dict[str, Known]]]] = defaultdict(list)
    for press, known in zip(presses, found, strict=True):
        groups[press.at].append((press, known))
    tables, goals = {}, []
    for at, pairs in groups.items():
        rows = {name: _row([(p, known[name]) for p, known in pairs]) for name in pairs[0][1]}
        tables[at] = Table(f"N/m after {TIME_SCALE:g} s, {at}", rows)
        goals += _goals(at, rows["FDEN"])
    return Report(goals, tables)


def _row(pairs: Sequence[tuple[Press, Known]]) -> dict[str, Any]:
    """Return the figures of one estimator."""
    known = [(press, one) for press, one in pairs if math.isfinite(one.value)]
    row: dict[str, Any] = {"known": share(math.isfinite(one.value) for _, one in pairs)}
    if not known:
        return row
    values = np.array([one.value for _, one in known])
    sds = np.array([one.sd for _, one in known])
    truths = np.array([press.truth for press, _ in known])
    moduli = np.array([press.modulus for press, _ in known])
    ratios = values / truths
    row["ratio, median"] = float(np.median(ratios))
    row["ratio, 5 to 95 %"] = np.percentile(ratios, [5.0, 95.0])
    row["half width"] = float(np.median(2.0 * sds / values))
    inside = np.abs(values - truths) <= 2.0 * sds
    row["in 2 sd"] = share(inside) if np.isfinite(sds).all() else math.nan
    row["rank"] = _rank(values, moduli)
    families = np.array([press.phantom.partition("_")[0] for press, _ in known])
    own = (families == family for family in sorted(set(families)))
    row["in each family"] = [_rank(values[of], moduli[of]) for of in own]
    row["repeats"] = _repeats([press.phantom for press, _ in known], values, sds)
    return row


def _rank(values: np.ndarray, moduli: np.ndarray) -> float:
    """Return the rank correlation of stiffnesses with moduli; NaN: these are not known."""
    if moduli.size < 3 or not np.isfinite(moduli).all():
        return math.nan
    return float(spearmanr(values, moduli).statistic)


def _repeats(phantoms: Sequence[str], values: np.ndarray, sds: np.ndarray) -> float:
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


def _goals(at: str, row: dict[str, Any]) -> list[Goal]:
    goals = [at_least(f"{at}: known", row["known"].value, 0.95)]
    if math.isfinite(row.get("rank", math.nan)):
        goals.append(at_least(f"{at}: rank with the modulus", row["rank"], 0.97))
        families = row["in each family"]
        goals.append(at_least(f"{at}: the same in the worst family", min(families), 0.97))
    return goals


def read_presses(
    folder: Path | None, strains: Sequence[float], most: int | None = None
) -> list[Press]:
    """Return the presses in every table of a folder.

    Parameters
    ----------
    folder : Path or None
    strains : sequence of float
        At which a test without a stated stiffness is cut [1].
    most : int, optional
        Tests of each table at most, evenly taken.

    Raises
    ------
    InputError
        If there is no such folder or table, or a number that cannot be read.
    """
    if folder is None:
        raise InputError(f"no data: name the folder with the tables, or set {DATA_VARIABLE}")
    presses: list[Press] = []
    for path in sorted((*folder.glob("*.csv"), *folder.glob("*.csv.gz"))):
        beside = path.with_name(path.name.partition(".")[0] + "_truth.csv")
        if beside.exists():
            presses += _presses_of(path, beside, strains, most)
    if not presses:
        raise InputError(f"{folder}: no table with a table of its truths (NAME_truth.csv) beside")
    return presses


def _presses_of(
    path: Path, beside: Path, strains: Sequence[float], most: int | None
) -> list[Press]:
    with open(beside, newline="", encoding="utf-8") as file:
        truths = {row["test"]: row for row in csv.DictReader(file)}
    columns: dict[str, list[list[float]]] = defaultdict(list)
    try:
        with (gzip.open if path.suffix == ".gz" else open)(path, "rt", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                columns[row["test"]].append([float(row[name]) for name in COLUMNS[1:]])
        names = sorted(columns.keys() & truths.keys())
        names = names[:: max(len(names) // most, 1)][:most] if most else names
        return [
            press
            for name in names
            for press in _cut(name, truths[name], np.array(columns[name]), strains)
        ]
    except (KeyError, ValueError) as error:
        words = f"{path}: not the columns {', '.join(COLUMNS)} with numbers"
        raise InputError(f"{words}, or no area_m2 and thickness_m in {beside}: {error}") from None


def _cut(
    name: str, truth: dict[str, str], table: np.ndarray, strains: Sequence[float]
) -> list[Press]:
    """Return the presses of one test."""
    times, forces, depths = table[:, 0], table[:, 1], 1e-3 * table[:, 2]
    thickness, stated = float(truth["thickness_m"]), truth.get("stiffness_N_per_m")
    specimen = (float(truth["area_m2"]), thickness, float(truth.get("modulus_Pa") or math.nan))
    phantom = truth.get("phantom") or name
    if stated:
        whole = Samples(times, depths, forces)
        own = Press(name, phantom, "where it was deepest", whole, *specimen, float(stated), True)
        return [own]
    found = []
    for strain in strains:
        depth = strain * thickness
        if depths.max() < depth + _HALF_WINDOW:
            continue
        about = np.abs(depths - depth) <= _HALF_WINDOW
        slope = float(np.polyfit(depths[about], forces[about], 1)[0])
        stop = int(np.argmax(depths >= depth)) + 1
        samples = Samples(times[:stop], depths[:stop], forces[:stop])
        found.append(
            Press(name, phantom, f"at a strain of {strain:g}", samples, *specimen, slope, False)
        )
    return found


def _more(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--strains", default="0.15,0.3", metavar="A,B", help="where tests are cut (0.15,0.3)"
    )


BENCHMARK = Benchmark(run, EPILOG, data=True, more=_more)
