# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The shapes that the docstrings of the estimator's arrays state are those of what is passed."""

from __future__ import annotations

import inspect
import re

import numpy as np
import pytest

from fden_ros.core.estimation.estimate import StateIndex
from fden_ros.core.estimation.estimator import Block
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.gauss_newton import GaussNewton
from fden_ros.core.estimation.normal_equations import NormalEquations
from fden_ros.core.estimation.state_prior import StatePrior
from fden_ros.core.estimation.stress_estimator import StressEstimator
from fden_ros.core.law.geometry import PassThrough
from fden_ros.core.law.kernel import order_nodes
from fden_ros.core.law.stress_response import StressBasis

CHECKED = {
    NormalEquations: ("respond", "node_residuals", "at_state", "at_nodes"),
    GaussNewton: ("solve", "solve_at_nodes", "_moments", "_step", "_covariances", "_weights"),
    StatePrior: ("precision", "distance"),
    StressBasis: ("freeze", "take_block"),
}
PARAMETER = re.compile(r"^(\w+) : ndarray, shape \(([^)]*)\)", re.MULTILINE)
RETURNS = re.compile(r"(?:: |^)ndarray, shape \(([^)]*)\)", re.MULTILINE)


def sizes_of(stated, shape, known):
    """Hold a stated shape against a real one; names that are not known yet get their size."""
    stated = [part.strip() for part in stated.split(",") if part.strip()]
    if "..." in stated:
        stated = stated[stated.index("...") + 1 :]
        shape = shape[len(shape) - len(stated) :]
    assert len(stated) == len(shape), (stated, shape)
    for part, size in zip(stated, shape, strict=True):
        names = re.findall(r"[a-z]\w*", part)
        if len(names) == 1 and part == names[0]:
            assert known.setdefault(part, size) == size, (part, size, known)
        else:
            assert eval(part, {}, dict(known)) == size, (part, size, known)


def watched(function, seen, known):
    document = inspect.getdoc(function) or ""
    parameters, _, returns = document.partition("Returns\n-------")
    signature = inspect.signature(function)

    def call(*args, **kwargs):
        own = dict(known)
        bound = signature.bind(*args, **kwargs).arguments
        stated = PARAMETER.findall(parameters)
        for name, shape in stated:
            sizes_of(shape, bound[name].shape, own)
        result = function(*args, **kwargs)
        values = result if isinstance(result, tuple) else (result,)
        arrays = [value for value in values if isinstance(value, np.ndarray | np.generic)]
        shapes = RETURNS.findall(returns)
        for shape, array in zip(shapes, arrays, strict=bool(shapes)):
            sizes_of(shape, array.shape, own)
        if stated or shapes:
            seen.add(function.__qualname__)
        return result

    return call


def test_stated_shapes_are_those_of_the_arrays(monkeypatch: pytest.MonkeyPatch):
    seen: set[str] = set()
    known = {"orders": len(order_nodes()), "origins": 3, "n": len(StateIndex)}
    for owner, names in CHECKED.items():
        sizes = known if owner is not StressBasis else {"orders": known["orders"], "m": 3}
        for name in names:
            monkeypatch.setattr(owner, name, watched(getattr(owner, name), seen, sizes))
    estimator = StressEstimator(EstimatorConfig(), PassThrough(), 3.0, origin_sd=0.002)
    estimator.begin_contact(0.3, 0.0)
    step, size = 2e-3, 5
    for index in range(100):
        for sample in range(index * size, (index + 1) * size):
            estimator.press(step if sample else 0.0, 0.3 * step * sample)
        # A jump of the stress, so that the change of the tissue is followed too.
        stress = (500.0 if index < 60 else 1500.0) * 0.3 * step * size * (index + 0.5)
        time = step * size * (index + 0.5)
        estimator.update(
            Block(0.3 * time, stress, time, size, step * size, np.zeros(len(order_nodes())))
        )
        estimator.relinearise()
    estimator.estimate()
    assert "NormalEquations.respond" in seen
    assert "StressBasis.take_block" in seen
    assert "NormalEquations.at_nodes" in seen
    assert "GaussNewton._step" in seen
    assert "StatePrior.distance" in seen
