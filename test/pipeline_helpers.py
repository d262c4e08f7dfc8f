# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings straight into the pipeline; a truth by convolution, and errors over deviations."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from benchmark.trial import begun, fed, samples_of
from fden_ros.core.arrays import Array
from fden_ros.core.estimation import Estimate, ParameterSet
from fden_ros.core.outputs import ContactSummary, Flag, OrderSource, Output, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.errors import InputError
from fden_ros.parameters import read_parameter_file
from simulation.simulate import Recording

FORCE, DISPLACEMENT = 0, 1
#: The paper's liver, for what was measured with it as the prior.
_LIVER = Path(__file__).resolve().parents[1] / "config" / "priors" / "liver.yaml"
LIVER_PARAMETERS = {
    k: v for k, v in read_parameter_file(_LIVER).as_dict().items() if k.startswith("prior.")
}


def refusal(read: Callable[[Any], object], what: Any) -> str:
    """Return the one line with which something is refused."""
    with pytest.raises(InputError) as caught:
        read(what)
    assert "\n" not in str(caught.value)
    return str(caught.value)


class Item(NamedTuple):
    """One sample of either stream, as it arrives."""

    stream: int  #: FORCE or DISPLACEMENT
    stamp_ns: int
    value: float
    position: tuple[float, float, float] | None = None


def items_of(recording: Recording) -> list[Item]:
    """Return both streams of a recording in the order of their stamps, displacement first."""
    return [
        Item(FORCE if is_force else DISPLACEMENT, *sample)
        for is_force, *sample in samples_of(recording)
    ]


def feed(pipeline: Pipeline, items: Iterable[Item]) -> None:
    for stream, stamp_ns, value, position in items:
        if stream == FORCE:
            pipeline.add_force(stamp_ns, value)
        else:
            pipeline.add_displacement(stamp_ns, value, position)


def identified(
    items: Iterable[Item], parameters: Mapping[str, object]
) -> tuple[Pipeline, list[Output]]:
    """Return the pipeline after all samples, and everything it put out."""
    pipeline, outputs = begun(parameters)
    feed(pipeline, items)
    pipeline.finish()
    return pipeline, outputs


def of_columns(
    parameters: Mapping[str, object], times: Array, forces: Array, depths: Array
) -> tuple[Pipeline, list[Output]]:
    """Return the same of samples of one clock: [s], [N] and [m]."""
    pipeline, outputs = begun(parameters)
    for _ in fed(pipeline, times, forces, depths):
        pass
    pipeline.finish()
    return pipeline, outputs


def parameters_of(recording: Recording) -> dict[str, object]:
    """Return the identifier's parameters that fit a recording."""
    return dict(recording.truth["identifier_parameters"])


def summaries_of(outputs: Iterable[Output]) -> list[ContactSummary]:
    return [output for output in outputs if isinstance(output, ContactSummary)]


def stress_over_g(strain: np.ndarray, step: float, gn: float, alpha: float) -> np.ndarray:
    """Return the stress of the paper's law for G = 1, by its own convolution, each `step` [s]."""
    phi = np.where(strain < 1 / gn, strain, np.exp(gn * strain - 1.0) / gn)
    lags = np.diff((np.arange(strain.size + 1) * step) ** (1 - alpha))
    lags /= step * math.gamma(2 - alpha)
    return np.maximum(np.convolve(np.diff(phi, prepend=0.0), lags)[: strain.size], 0.0)


def off(estimate: Estimate, tissue: Sequence[float]) -> np.ndarray:
    """Return the errors of ln G, ln Gn and alpha in their deviations; 0 of what is given.

    `tissue` is (G, Gn, alpha).
    """
    truth, sd = [math.log(tissue[0]), math.log(tissue[1]), tissue[2]], estimate.deviations
    return np.divide(estimate.mean - truth, sd, out=np.zeros(3), where=sd > 0.0)


def states_of(outputs: Iterable[Output]) -> list[TissueState]:
    return [output for output in outputs if isinstance(output, TissueState)]


ESTIMATE = Estimate(
    math.log(500.0),
    math.log(8.0),
    0.13,
    np.diag([0.01, 0.0004, 0.0001]),
    contact_point=0.0,
    contact_point_sd=0.0,
    probability_beyond_boundary=1.0,
    observable=ParameterSet.ALL,
    known=ParameterSet.ALL,
    sample_count=1000,
)


def summary(**changes: Any) -> ContactSummary:
    """A converged contact with liver."""
    values: dict[str, Any] = {
        "stamp_ns": 2,
        "start_ns": 0,
        "end_ns": 2,
        "site_id": 1,
        "contact_id": 1,
        "flags": Flag.NONE,
        "converged": True,
        "complete": True,
        "position": None,
        "order_source": OrderSource.LEARNED,
        "estimate": ESTIMATE,
        "max_strain": 0.3,
        "max_stress": 900.0,
        "max_force": 0.3,
        "sample_count": 100,
        "rejected_count": 0,
        "classes": None,
    }
    return ContactSummary(**values | changes)
