# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""N/m of recordings of others, next to the estimators of others.

docs/accuracy.md says where they come from; :mod:`benchmark.sources` makes the tables. A press
without a stated stiffness is cut at strains, and its curve's own slope there is the truth.

*Given*: a value was given. *Ratio*: to the truth, median and 5th to 95th percentile. *Rank*: with
the modulus, over all tests and in each family, the first word of a phantom's name up to _.
*Repeats*: scatter of the logarithm within a phantom, over the stated deviation. *Error* and *half
width*, two stated deviations: in percent of the truth. *In 2 sd*: part of the truths within two.

The others learn by least squares that forget with a time constant of 1 s, which makes them better:
Kelvin-Voigt, :math:`F = K x + B \dot x`, and Hunt-Crossley, linear in the logarithm,
:math:`\ln F = \ln k + (\lambda/k) \dot x + n \ln x` (A. Haddadi, K. Hashtrudi-Zaad, IEEE Trans.
Robot. 28 (2012) 813).
"""

from __future__ import annotations

import argparse
import csv
import math
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import spearmanr

from benchmark import harness
from benchmark.harness import Benchmark, Goal, Report, Table, at_least, at_most
from benchmark.score import mean_of, rms, share
from benchmark.trial import fed
from fden_ros.core.arrays import Array
from fden_ros.core.outputs import ContactSummary, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.errors import InputError
from fden_ros.parameters import check, pipeline_config
from simulation.simulate import KNOWN_RIG

EPILOG = "examples:\n  fden benchmark public recordings/ --strains 0.15\n"

COLUMNS = ("time_s", "force_N", "displacement_mm")
_QUICK_TESTS = 6
_HALF_WINDOW = 2.5e-4  #: of a curve's own slope [m]
#: Shallower samples [m] are left out by Hunt-Crossley; bound of its exponential.
_LEAST_DEPTH, _LARGEST_LOG = 1e-5, 50.0
_FORGETTING_TIME = 1.0
#: Samples that are used at most [1], the size of a step in parts of the depth [1], and times in
#: the step of 0.1 s [s].
_MOST_SAMPLES, _STEP, _AT_STEP = 500, 1e-4, np.array([0.01, 0.05, 0.1])
#: A stiffness and its standard deviation [N/m]; NaN: not given.
Answer = tuple[float, float]


class Samples(NamedTuple):
    """What was measured; arrays of shape (n,)."""

    times: Array  #: [s]
    depths: Array  #: into the tissue [m]
    forces: Array  #: [N]

    @property
    def velocities(self) -> Array:
        """Backward difference quotients [m/s], the first one as the second."""
        rates: Array = np.diff(self.depths) / np.diff(self.times)
        return np.append(rates[:1], rates)


@dataclass(frozen=True)
class Press:
    """What an estimator is given, and what is known of the answer."""

    group: str  #: whose figures are one row
    seen: Samples
    truth: float  #: [N/m]
    area: float  #: of the face [m^2]
    thickness: float  #: [m]
    phantom: str
    modulus: float  #: [Pa]; NaN: not known
    is_over: bool  #: the probe has left: the answer is that of the deepest point


def read_presses(
    folder: Path | None, strains: Sequence[float], most: int | None = None
) -> list[Press]:
    """Return the presses of every table in a folder, `most` tests of each."""
    if folder is None:
        raise InputError(
            f"no data: name the folder with the tables, or set {harness.DATA_VARIABLE}"
        )
    found: list[Press] = []
    for path in sorted(folder.glob("*.csv")):
        truths = path.with_name(f"{path.stem}_truth.csv")
        if truths.exists():
            found += _presses_of(path, truths, strains, most)
    if not found:
        raise InputError(f"{folder}: no table with a table of its truths, NAME_truth.csv")
    return found


def _presses_of(
    path: Path, truths: Path, strains: Sequence[float], most: int | None
) -> Iterator[Press]:
    rows: dict[str, list[list[float]]] = defaultdict(list)
    try:
        with open(truths, encoding="utf-8", newline="") as file:
            known = {row["test"]: row for row in csv.DictReader(file)}
        with open(path, encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                rows[row["test"]].append([float(row[name]) for name in COLUMNS])
        names = sorted(rows.keys() & known.keys())
        every = max(len(names) // most, 1) if most else 1
        for name in names[::every][:most]:
            yield from _press(name, known[name], np.array(rows[name]), strains)
    except (KeyError, ValueError) as error:
        words = f"not the columns test, {', '.join(COLUMNS)}, or area_m2, thickness_m in {truths}"
        raise InputError(f"{path}: {words}: {error}") from None


def _press(
    name: str, truth: Mapping[str, str], table: Array, strains: Sequence[float]
) -> Iterator[Press]:
    times, forces, depths = table[:, 0], table[:, 1], 1e-3 * table[:, 2]
    area, thickness = float(truth["area_m2"]), float(truth["thickness_m"])
    phantom, modulus = truth.get("phantom") or name, float(truth.get("modulus_Pa") or math.nan)
    known = (area, thickness, phantom, modulus)
    if stated := truth.get("stiffness_N_per_m"):
        group, seen = "N/m where it was deepest", Samples(times, depths, forces)
        yield Press(group, seen, float(stated), *known, is_over=True)
        return
    for strain in strains:
        depth = strain * thickness
        if depths.max() >= depth + _HALF_WINDOW:
            about = np.abs(depths - depth) <= _HALF_WINDOW
            slope = float(np.polyfit(depths[about], forces[about], 1)[0])
            stop = int(np.argmax(depths >= depth)) + 1
            seen = Samples(times[:stop], depths[:stop], forces[:stop])
            yield Press(f"N/m at a strain of {strain:g}", seen, slope, *known, is_over=False)


def answers_of(press: Press) -> dict[str, Answer]:
    """Return the answer of every estimator."""
    stop = int(np.argmax(press.seen.depths)) + 1 if press.is_over else None
    seen = Samples(*(values[:stop] for values in press.seen))
    return {
        "FDEN": _fden(press),
        "force over depth": (float(seen.forces.max() / seen.depths.max()), math.nan),
        **{name: (small_step(peer, seen), math.nan) for name, peer in PEERS.items()},
    }


def _fden(press: Press) -> Answer:
    """Return what the pipeline knows last, or in the summary of a press that is over."""
    parameters = KNOWN_RIG | {
        "geometry.kind": "flat_punch",
        "geometry.area": press.area,
        "geometry.thickness": press.thickness,
        "force.measure_bias": False,
        "origin.source": "given",
        "plausibility.max_force": 1e6,
    }
    outputs: list[Output] = []
    pipeline = Pipeline(pipeline_config(check(parameters)), outputs.append)
    times, depths, forces = press.seen
    deque(fed(pipeline, times, forces, depths - depths[0]), maxlen=0)
    pipeline.finish()
    kinds = ContactSummary if press.is_over else (TissueState, ContactSummary)
    known = [o.apparent_stiffness for o in outputs if isinstance(o, kinds) and o.contact_id]
    found = known[0 if press.is_over else -1] if known else None
    return (found.value, found.sd) if found is not None else (math.nan, math.nan)


#: From what is seen, and times and depths of what is to come, to its force [N].
Peer = Callable[[Samples, Samples], Array]


def kelvin_voigt(seen: Samples, ahead: Samples) -> Array:
    """Predict F = K x + B dx/dt."""
    design = np.column_stack([seen.depths, seen.velocities])
    stiffness, damping = _weighted(design, seen.forces, seen.times)
    result: Array = stiffness * ahead.depths + damping * ahead.velocities
    return result


def hunt_crossley(seen: Samples, ahead: Samples) -> Array:
    """Predict Hunt-Crossley, linear in the logarithm."""
    used = (seen.depths >= _LEAST_DEPTH) & (seen.forces > 0.0)
    depths, velocities = seen.depths[used], seen.velocities[used]
    design = np.column_stack([np.ones_like(depths), velocities, np.log(depths)])
    coefficients = _weighted(design, np.log(seen.forces[used]), seen.times[used])
    log_stiffness, damping, exponent = coefficients
    depth = np.log(np.maximum(ahead.depths, _LEAST_DEPTH))
    static = np.exp(np.clip(log_stiffness + exponent * depth, -_LARGEST_LOG, _LARGEST_LOG))
    result: Array = static * (1.0 + damping * ahead.velocities)
    return result


def _weighted(design: Array, values: Array, times: Array) -> Array:
    """Return the coefficients of least squares that forget."""
    root = np.exp(0.5 * (times - times[-1]) / _FORGETTING_TIME)
    return np.asarray(np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0])


def small_step(peer: Peer, seen: Samples) -> float:
    """Return the N/m that a small step from the last sample would meet."""
    # Some take the square of the samples.
    every = slice(None, None, -(-seen.times.size // _MOST_SAMPLES))
    seen = Samples(*(values[::-1][every][::-1] for values in seen))
    times, depth = seen.times[-1] + _AT_STEP, float(seen.depths[-1])
    step = _STEP * depth
    low, high = (
        peer(seen, Samples(times, np.full(times.size, at), np.zeros(times.size)))[-1]
        for at in (depth, depth + step)
    )
    return float(high - low) / step


PEERS: dict[str, Peer] = {"Kelvin-Voigt": kelvin_voigt, "Hunt-Crossley": hunt_crossley}


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    strains = [float(text) for text in args.strains.split(",")]
    presses = read_presses(args.data, strains, _QUICK_TESTS if args.quick else None)
    groups: dict[str, dict[str, list[tuple[Press, Answer]]]] = {}
    found = harness.measured(answers_of, [(press,) for press in presses], what="recordings")
    for press, answers in zip(presses, found, strict=True):
        for name, answer in answers.items():
            groups.setdefault(press.group, {}).setdefault(name, []).append((press, answer))
    tables = {
        group: Table(group, {name: row_of(pairs) for name, pairs in by_name.items()})
        for group, by_name in groups.items()
    }
    goals = [goal for group, table in tables.items() for goal in _goals(group, table.rows["FDEN"])]
    return Report(goals, tables)


def row_of(pairs: Sequence[tuple[Press, Answer]]) -> dict[str, Any]:
    """Return the figures of one estimator."""
    given = [pair for pair in pairs if math.isfinite(pair[1][0])]
    row: dict[str, Any] = {"given": share(math.isfinite(answer[0]) for _, answer in pairs)}
    if not given:
        return row
    values, sds = np.array([answer for _, answer in given]).T
    truths, moduli = np.array([(press.truth, press.modulus) for press, _ in given]).T
    phantoms = [press.phantom for press, _ in given]
    families = np.array([phantom.partition("_")[0] for phantom in phantoms])
    own = (families == family for family in sorted(set(families)))
    ratios, off = values / truths, 100.0 * np.abs(values / truths - 1.0)
    has_sd = bool(np.isfinite(sds).all())
    return row | {
        "ratio, median": float(np.median(ratios)),
        "ratio, 5 to 95 %": np.percentile(ratios, [5.0, 95.0]),
        "rank": _rank(values, moduli),
        "in each family": [_rank(values[of], moduli[of]) for of in own],
        "repeats": _repeats(phantoms, values, sds),
        "error, median": float(np.median(off)),
        "error, 90 %": float(np.percentile(off, 90.0)),
        "half width": float(np.median(200.0 * sds / truths)),
        "in 2 sd": mean_of(np.abs(values - truths) <= 2.0 * sds) if has_sd else math.nan,
    }


def _rank(values: Array, moduli: Array) -> float:
    """Return the rank correlation of stiffnesses with moduli; NaN: these are not known."""
    is_known = moduli.size > 2 and np.isfinite(moduli).all()
    return float(spearmanr(values, moduli).statistic) if is_known else math.nan


def _repeats(phantoms: Sequence[str], values: Array, sds: Array) -> float:
    """Return the scatter of ln N/m within a phantom over its deviations, as a root mean square."""
    places = np.array(phantoms)
    off: list[float] = []
    for own in (places == phantom for phantom in sorted(set(phantoms))):
        if own.sum() > 1:
            logs = np.log(np.maximum(values[own], 1e-300))
            scatter = (logs - logs.mean()) * math.sqrt(own.sum() / (own.sum() - 1.0))
            off += (scatter / (sds[own] / values[own])).tolist()
    return float(rms(np.array(off))) if off else math.nan


def _goals(group: str, row: Mapping[str, Any]) -> Iterator[Goal]:
    yield at_least(f"{group}: given", row["given"].value, 0.95)
    if math.isfinite(row.get("rank", math.nan)):
        yield at_least(f"{group}: rank with the modulus", row["rank"], 0.97)
        yield at_least(f"{group}: the same in the worst family", min(row["in each family"]), 0.97)
    yield at_most(f"{group}: repeats", row.get("repeats", math.nan), 2.0)


def _more(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--strains", default="0.15,0.3", help="where compressions are cut")


BENCHMARK = Benchmark(run, EPILOG, data=True, more=_more)
