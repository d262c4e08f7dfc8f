# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which tissue it is: whether probabilities mean what they say.

Contacts of four simulated tissues (the paper's liver and three invented ones, which overlap on
purpose, each with the spread of its Table II) go through simulator and pipeline, which classifies
with their true distributions: then the errors that its probabilities expect are the least that
any classifier can have.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from benchmark.harness import Benchmark, Report, Table, at_most, measured
from benchmark.score import share
from benchmark.trial import last_summaries, through
from fden_ros.core.arrays import Array, Indices
from fden_ros.core.classification import (
    UNKNOWN,
    Tissue,
    TissueLibrary,
)
from fden_ros.parameters import check as checked
from fden_ros.parameters import pipeline_config
from simulation.scenario import DisplacementSensor, ForceSensor, Geometry, Scenario, Site
from simulation.scenario import Tissue as SimulatedTissue
from simulation.simulate import simulate
from simulation.trajectory import Approach, Ramp, RampHold

EPILOG = "example:\n  fden benchmark classification --quick\n"

#: Contacts through the pipeline, and those of a quick run.
_CONTACTS, _QUICK_CONTACTS = 360, 48
#: The estimator's prior, as wide as these tissues are.
_PARAMETERS = {
    "alpha.learn": True,
    "prior.linear_stiffness": 750.0,
    "prior.linear_stiffness_log_sd": 0.9,
    "prior.nonlinear_stiffness": 8.5,
    "prior.nonlinear_stiffness_log_sd": 0.45,
    "prior.alpha": 0.17,
    "prior.alpha_sd": 0.06,
    # Poor contacts are also classified, by their information.
    "converged.log_gn_sd": 0.15,
}
#: Median of G [Pa s^alpha], of Gn, and alpha with its spread, by name; liver is the paper's.
_CLASSES = {
    "fat": (340.0, 6.6, 0.155, 0.015),
    "liver": (523.9, 8.4, 0.131, 0.011),
    "muscle": (900.0, 10.5, 0.185, 0.018),
    "stiffer liver": (1000.0, 8.8, 0.138, 0.011),
}
#: Spread of ln G and ln Gn over specimens, that of Table II, and their correlation (invented).
_LOG_SPREAD, _CORRELATION = (0.28, 0.186), -0.3
#: Share of tissues that are none of them, and their spread about the mean: ln G, ln Gn, alpha.
_UNKNOWN_SHARE, _UNKNOWN_SD = 0.1, (1.4, 0.6, 0.12)
_GEOMETRY = Geometry("flat_punch", radius_m=0.01, thickness_m=0.02)
_RATE_HZ = 200.0
#: Noise of the stress [Pa].
_NOISES = (5.0, 20.0, 60.0)
PRESSES: tuple[Ramp | RampHold, ...] = (
    Ramp(strain_rate=0.25, max_strain=0.25),
    RampHold(strain_rate=0.25, max_strain=0.25, hold_s=0.4),
    RampHold(strain_rate=0.25, max_strain=0.22, hold_s=1.5),
)


def population() -> TissueLibrary:
    """Return the true distributions, the unknown with its true share."""
    tissues = []
    for name, (g, g_n, order, order_sd) in _CLASSES.items():
        sd = np.array([*_LOG_SPREAD, order_sd])
        correlation = np.eye(3)
        correlation[0, 1] = correlation[1, 0] = _CORRELATION
        mean = np.array([math.log(g), math.log(g_n), order])
        share = (1.0 - _UNKNOWN_SHARE) / len(_CLASSES)
        tissues.append(Tissue(name, mean, correlation * np.outer(sd, sd), share))
    means = np.array([tissue.mean for tissue in tissues])
    about = means - means.mean(axis=0)
    spread = np.diag(np.square(_UNKNOWN_SD)) + about.T @ about / len(means)
    unknown = Tissue(UNKNOWN, means.mean(axis=0), spread, _UNKNOWN_SHARE)
    return TissueLibrary("population", tuple(tissues), unknown, "Pa", "flat_punch")


class Pressed(NamedTuple):
    """One contact that went through the pipeline."""

    truth: int  #: class
    probabilities: Array | None  #: of the classes, unknown last; None: it has not converged
    label: str  #: at its end; empty: none
    decided: float | None  #: time of the label since the touch [s]


def press(value: Array, truth: int, seed: int) -> Pressed:
    """Press a tissue once; the pipeline classifies with the true library."""
    noise = _NOISES[seed // len(PRESSES) % len(_NOISES)]
    tissue = SimulatedTissue(math.exp(value[0]), math.exp(value[1]), max(float(value[2]), 0.03))
    scenario = Scenario(
        name="population",
        geometry=_GEOMETRY,
        approach=Approach(
            distance_m=0.002,
            speed_m_per_s=0.02,
            slow_distance_m=0.001,
            retract_speed_m_per_s=0.04,
            start_pause_s=1.0,
        ),
        sites=(Site(tissue, (PRESSES[seed % len(PRESSES)],)),),
        force=ForceSensor(rate_hz=_RATE_HZ, noise_stress_pa=noise),
        displacement=DisplacementSensor(rate_hz=_RATE_HZ),
    )
    recording = simulate(scenario, seed)
    own = dict(recording.truth["identifier_parameters"]) | _PARAMETERS
    _, outputs = through(recording, replace(pipeline_config(checked(own)), library=population()))
    summaries = list(last_summaries(outputs).values())
    if not summaries:
        return Pressed(truth, None, "", None)
    one = summaries[-1]
    decided = one.decided.time if one.decided is not None else None
    if one.classes is None:
        return Pressed(truth, None, "", decided)
    probabilities = np.array(one.classes.probabilities) if one.converged else None
    return Pressed(truth, probabilities, one.classes.label, decided)


def values_of(count: int) -> list[tuple[Array, int, int]]:
    """Return true values, class and seed of `count` contacts, the known classes in turn."""
    library, generator = population(), np.random.default_rng(8)
    known = len(library.tissues)
    drawn = []
    for number in range(count):
        tissue = library.tissues[number % known]
        value = generator.multivariate_normal(tissue.mean, tissue.covariance)
        # Every class occurs with every press and every noise.
        drawn.append((value, number % known, number // known))
    return drawn


def run(args: argparse.Namespace) -> Report:
    """Measure; return the report."""
    pressed = measured(press, values_of(_QUICK_CONTACTS if args.quick else _CONTACTS))
    figures = figures_of(pressed)
    rows = {name: {"": value} for name, value in figures.items()}
    tables = {"figures": Table("Simulated tissues", rows)}
    off = (figures["error"] - figures["expected"]) / figures["its deviation"]
    goals = [
        at_most("error less expected, in deviations", abs(off), 2.5),
        at_most("known tissues called unknown", figures["called unknown"].value, 0.05),
    ]
    # Few contacts decide nothing.
    return Report([replace(g, met=None) for g in goals] if args.quick else goals, tables)


def figures_of(pressed: Sequence[Pressed]) -> dict[str, Any]:
    """Return the pipeline's results for contacts, with their true class."""
    tissues = population().tissues
    used = [one for one in pressed if one.probabilities is not None]
    every = np.array([one.probabilities for one in used])
    known = every[:, :-1] / every[:, :-1].sum(axis=1, keepdims=True)
    classes = np.array([one.truth for one in used])
    best = known.max(axis=1)
    decided = [one.decided for one in pressed if one.decided is not None]
    return {
        "converged": share(one.probabilities is not None for one in pressed),
        "error": float(np.mean(known.argmax(axis=1) != classes)),
        "expected": float(np.mean(1.0 - best)),
        "its deviation": float(np.sqrt(np.sum(best * (1.0 - best))) / len(best)),
        "calibration error": calibration_error(known, classes),
        "called unknown": share(row.argmax() == len(tissues) for row in every),
        "labels wrong": share(o.label != tissues[o.truth].name for o in pressed if o.label),
        "label after [s], median": float(np.median(decided)) if decided else math.nan,
    }


def calibration_error(probabilities: Array, truth: Indices, bins: int = 15) -> float:
    """Return the expected calibration error of the most probable class (C. Guo et al. 2017)."""
    best = probabilities.max(axis=1)
    right = probabilities.argmax(axis=1) == truth
    index = np.minimum((best * bins).astype(int), bins - 1)
    gaps = np.bincount(index, weights=best - right, minlength=bins)
    return float(np.abs(gaps).sum()) / len(truth)


BENCHMARK = Benchmark(run, EPILOG)
