# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""N/m from published recordings, compared with other estimators.

docs/accuracy.md says where they come from; :mod:`benchmark.sources` makes the tables. A press
without a stated stiffness is cut at strains, and its curve's own slope there is the truth.

*Given*: a value was given. *Ratio*: to the truth, median and 5th to 95th percentile. *Rank*: with
the modulus, over all tests and in each family, the first word of a phantom's name up to _.
*Half width*: two stated deviations in percent of the truth. *In 2 sd*: part of the truths within.

The others learn by least squares that forget with a time constant of 1 s, which makes them better:
Kelvin-Voigt, :math:`F = K x + B \dot x`, and Hunt-Crossley, linear in the logarithm,
:math:`\ln F = \ln k + (\lambda/k) \dot x + n \ln x` (A. Haddadi, K. Hashtrudi-Zaad, IEEE Trans.
Robot. 28 (2012) 813).
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import spearmanr

from benchmark.harness import Benchmark, Goal, Report, Table, at_least, measured
from benchmark.real import rows_of_tests
from benchmark.score import share
from benchmark.trial import begun, fed
from fden_ros.core.arrays import Array
from fden_ros.core.outputs import ContactSummary, TissueState
from fden_ros.errors import InputError
from simulation.simulate import KNOWN_RIG

EPILOG = "examples:\n  fden benchmark public recordings/ --quick\n"

COLUMNS = ("time_s", "force_N", "displacement_mm")
_KNOWN = {"test", "area_m2", "thickness_m"}
#: Where compressions are cut [1].
STRAINS = (0.15, 0.3)
_QUICK_TESTS = 6
_HALF_WINDOW = 2.5e-4  #: of a curve's own slope [m]
#: Shallower samples [m] are left out by Hunt-Crossley; bound of its exponential.
_LEAST_DEPTH, _LARGEST_LOG = 1e-5, 50.0
_FORGETTING_TIME = 1.0
#: Samples that are used at most [1], and the size of a step in parts of the depth [1].
_MOST_SAMPLES, _STEP = 500, 1e-4
#: A stiffness and its standard deviation [N/m]; NaN: not given.
Answer = tuple[float, float]


class Samples(NamedTuple):
    """What was measured; arrays of shape (n,)."""

    times: Array  #: [s]
    depths: Array  #: into the tissue [m]
    forces: Array  #: [N]


class Press(NamedTuple):
    """What an estimator is given, and what is known of the answer."""

    group: str  #: whose figures are one row
    seen: Samples
    truth: float  #: [N/m]
    area: float  #: of the face [m^2]
    thickness: float  #: [m]
    phantom: str
    modulus: float  #: [Pa]; NaN: not known
    is_over: bool  #: the probe has left: the answer is that of the deepest point


def read_presses(folder: Path, most: int | None = None) -> list[Press]:
    """Return the presses of every table in a folder, `most` tests of each."""
    found: list[Press] = []
    for path in sorted(folder.glob("*.csv")):
        truths = path.with_name(f"{path.stem}_truth.csv")
        if truths.exists():
            tests = rows_of_tests(path, ("test",), COLUMNS)
            with truths.open(encoding="utf-8", newline="") as file:
                known = [row for row in csv.DictReader(file) if row.keys() >= _KNOWN]
            truth = {row["test"]: row for row in known if (row["test"],) in tests}
            names = sorted(truth)
            every = max(len(names) // most, 1) if most else 1
            for name in names[::every][:most]:
                try:
                    found += _press(name, truth[name], tests[name,])
                except ValueError as error:
                    raise InputError(f"{truths}: {name}: {error}") from None
    if not found:
        columns = ", ".join(("test", *COLUMNS))
        words = f"no table of {columns} with {', '.join(sorted(_KNOWN))} in NAME_truth.csv"
        raise InputError(f"{folder}: {words}")
    return found


def _press(name: str, truth: Mapping[str, str], table: Array) -> Iterator[Press]:
    times, forces, depths = table[:, 0], table[:, 1], 1e-3 * table[:, 2]
    area, thickness = float(truth["area_m2"]), float(truth["thickness_m"])
    phantom, modulus = truth.get("phantom") or name, float(truth.get("modulus_Pa") or math.nan)
    known = (area, thickness, phantom, modulus)
    if stated := truth.get("stiffness_N_per_m"):
        group, seen = "N/m where it was deepest", Samples(times, depths, forces)
        yield Press(group, seen, float(stated), *known, is_over=True)
        return
    for strain in STRAINS:
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
    pipeline, outputs = begun(parameters)
    times, depths, forces = press.seen
    for _ in fed(pipeline, times, forces, depths - depths[0]):
        pass
    pipeline.finish()
    kinds = ContactSummary if press.is_over else (TissueState, ContactSummary)
    known = [o.apparent_stiffness for o in outputs if isinstance(o, kinds) and o.contact_id]
    found = known[0 if press.is_over else -1] if known else None
    return (found.value, found.sd) if found is not None else (math.nan, math.nan)


#: From what is seen, its depths and their velocities, to the force of a depth at rest [N].
Peer = Callable[[Samples, Array], Callable[[float], float]]


def kelvin_voigt(seen: Samples, velocities: Array) -> Callable[[float], float]:
    """Learn F = K x + B dx/dt."""
    design = np.column_stack([seen.depths, velocities])
    stiffness, _ = _weighted(design, seen.forces, seen.times)
    return lambda depth: stiffness * depth


def hunt_crossley(seen: Samples, velocities: Array) -> Callable[[float], float]:
    """Learn Hunt-Crossley, linear in the logarithm."""
    used = (seen.depths >= _LEAST_DEPTH) & (seen.forces > 0.0)
    depths = seen.depths[used]
    design = np.column_stack([np.ones_like(depths), velocities[used], np.log(depths)])
    log_stiffness, _, exponent = _weighted(design, np.log(seen.forces[used]), seen.times[used])

    def force(depth: float) -> float:
        log_force = log_stiffness + exponent * np.log(max(depth, _LEAST_DEPTH))
        return float(np.exp(np.clip(log_force, -_LARGEST_LOG, _LARGEST_LOG)))

    return force


def _weighted(design: Array, values: Array, times: Array) -> list[float]:
    """Return the coefficients of least squares that forget."""
    root = np.exp(0.5 * (times - times[-1]) / _FORGETTING_TIME)
    found = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
    coefficients: list[float] = found.tolist()
    return coefficients


def small_step(peer: Peer, seen: Samples) -> float:
    """Return the N/m that a small step from the last sample would meet."""
    # Some take the square of the samples.
    every = slice(None, None, -(-seen.times.size // _MOST_SAMPLES))
    seen = Samples(*(values[::-1][every][::-1] for values in seen))
    # Backward difference quotients, the first one as the second.
    rates = np.diff(seen.depths) / np.diff(seen.times)
    force = peer(seen, np.append(rates[:1], rates))
    depth = float(seen.depths[-1])
    step = _STEP * depth
    return (force(depth + step) - force(depth)) / step


PEERS: dict[str, Peer] = {"Kelvin-Voigt": kelvin_voigt, "Hunt-Crossley": hunt_crossley}


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    presses = read_presses(args.data, _QUICK_TESTS if args.quick else None)
    groups: dict[str, dict[str, list[tuple[Press, Answer]]]] = {}
    found = measured(answers_of, [(press,) for press in presses], "recordings")
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
    families = np.array([press.phantom.partition("_")[0] for press, _ in given])
    own = (families == family for family in sorted(set(families)))
    row |= {
        "ratio, median": float(np.median(values / truths)),
        "ratio, 5 to 95 %": np.percentile(values / truths, [5.0, 95.0]),
        "rank": _rank(values, moduli),
        "in each family": [_rank(values[of], moduli[of]) for of in own],
    }
    if np.isfinite(sds).all():
        row["half width"] = float(np.median(200.0 * sds / truths))
        row["in 2 sd"] = float(np.mean(np.abs(values - truths) <= 2.0 * sds))
    return row


def _rank(values: Array, moduli: Array) -> float:
    """Return the rank correlation of stiffnesses with moduli; NaN: these are not known."""
    is_known = moduli.size > 2 and np.isfinite(moduli).all()
    return float(spearmanr(values, moduli).statistic) if is_known else math.nan


def _goals(group: str, row: Mapping[str, Any]) -> Iterator[Goal]:
    yield at_least(f"{group}: given", row["given"].value, 0.95)
    if math.isfinite(row.get("rank", math.nan)):
        yield at_least(f"{group}: rank with the modulus", row["rank"], 0.97)
        yield at_least(f"{group}: the same in the worst family", min(row["in each family"]), 0.97)


BENCHMARK = Benchmark(run, EPILOG, data=True)
