# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the unknowns of a press are before its record, and the model that the record is held to."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation import loops
from fden_ros.core.estimation.block import Points
from fden_ros.core.estimation.error_model import ErrorModel, Errors
from fden_ros.core.estimation.loops import Evaluation, WalkState
from fden_ros.core.estimation.parts import Limit
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.scales import Scales
from fden_ros.core.estimation.smooth_errors import (
    CHARACTERISTIC_KNOTS,
    KERNEL_KNOTS,
    FieldPrior,
    characteristic_prior,
    kernel_prior,
)
from fden_ros.core.estimation.unknowns import LOG_GN, Lifetime

#: What an evaluation costs beside its points, in points [1]: of 100 points it takes twice as long.
EVALUATION_COST = 150
#: Degrees of freedom of what is stated of a rig [1].
_TAIL_DEGREES = 2.0


@dataclass(frozen=True)
class Belief:
    """A Gaussian prior of the unknowns."""

    mean: Array  #: shape (n,)
    precision: Array  #: without the law's errors where the scales decide on these, (n, n)

    def variances(self) -> Array:
        """Return the variances, (n,); infinite where the scales decide.

        What an earlier press of the site has told is told of several unknowns together.
        """
        open_ = np.flatnonzero(self.precision.diagonal())
        result = np.full(self.mean.size, math.inf)
        result[open_] = np.linalg.inv(self.precision[np.ix_(open_, open_)]).diagonal()
        return result


class Priors(NamedTuple):
    """The prior of all unknowns, at any scales."""

    model: PressModel
    base: Array
    #: Of the errors of kernel and characteristic; None: in `base`.
    fields: tuple[FieldPrior, FieldPrior] | None

    def precision(self, scales: Scales) -> Array:
        """Return its precision, (n, n).

        Raises
        ------
        FloatingPointError
            If the scales give errors no size: those of an earlier press that had told them.
        """
        if self.fields is None:
            return self.base
        if not min(scales[:2]):
            raise FloatingPointError("errors without a size have no prior")
        result = self.base.copy()
        places = self.model.kernel, self.model.characteristic
        for place, own, scale in zip(places, self.fields, scales[:2], strict=True):
            result[place, place] = own.precision / scale**2
        return result

    def equations(self, about: Linear, off: Array, held: Collection[int]) -> loops.Scaled:
        """Return the normal equations about a state, whose prior depends on the scales.

        `off`: the prior's mean from there; `held`: places of unknowns that stay.
        """
        kernel, characteristic = None, None
        if self.fields is not None:
            kernel, characteristic = (own.precision for own in self.fields)
        places = self.model.kernel.start, self.model.characteristic.start
        stays = sum(1 << place for place in held)
        normal = about.towards, about.normal, self.base, off
        return loops.Scaled(*normal, *places, stays, kernel, characteristic)

    def inverse_squares(self, places: Sequence[Scales]) -> Array:
        """Return those of the scales of kernel and characteristic, (places, 2).

        Raises
        ------
        FloatingPointError
            If the scales give errors no size: those of an earlier press that had told them.
        """
        scales = np.array([place[:2] for place in places])
        if self.fields is None:
            return np.zeros_like(scales)
        if not scales.all():
            raise FloatingPointError("errors without a size have no prior")
        return scales**-2.0

    def log_determinant(self, scales: Scales) -> float:
        """Return the logarithm of the precision's determinant, but for what is the same to all."""
        if self.fields is None:
            return 0.0
        kernel, characteristic = self.fields
        found = kernel.log_determinant + characteristic.log_determinant
        found -= 2.0 * KERNEL_KNOTS.size * math.log(scales.kernel)
        return found - 2.0 * CHARACTERISTIC_KNOTS * math.log(scales.characteristic)


class Linear(NamedTuple):
    """A record about one state, whitened: independent and of variance 1."""

    residuals: Array  #: (m,)
    normal: Array  #: J^T S^-1 J, (n, n)
    towards: Array  #: J^T S^-1 r, (n,)
    square: float  #: r^T S^-1 r
    log_determinant: float  #: of the residuals' covariance
    walk: WalkState  #: the walks at the end of the record


@dataclass(frozen=True)
class Maximum:
    """A maximum of the posterior at given scales."""

    state: Array  #: shape (n,)
    evaluation: Evaluation  #: of the model there
    errors: Errors  #: the error processes there
    scales: Scales
    is_solved: bool  #: it wants no further step
    is_at_bound: bool = False  #: alpha is at an end of what there is, and wants beyond


@dataclass(eq=False)
class Density:
    """Prior, model and errors of a press."""

    model: PressModel
    error_model: ErrorModel
    belief: Belief
    #: The law's errors have the priors of the scales, not that of the belief.
    has_field_prior: bool = field(kw_only=True)
    limit: Limit = field(default_factory=Limit, init=False)  #: of what maxima may cost

    def __post_init__(self) -> None:
        """Find the unknowns that are known, and those of the rig."""
        self.known = np.flatnonzero([u.sd == 0.0 for u in self.model.unknowns])
        self._of_rig = np.array([u.lifetime is Lifetime.RIG for u in self.model.unknowns])

    def priors(self, state: Array) -> Priors:
        """Return the priors at a state.

        What is stated of a rig has Student's tails: it may be wrong by far, and then counts less.
        """
        base = self.belief.precision
        if self._of_rig.any():
            root = np.ones(base.shape[0])
            root[: self._of_rig.size][self._of_rig] = np.sqrt(_weights(self._off(state)))
            base = base * np.outer(root, root)
        if not self.has_field_prior:
            return Priors(self.model, base, None)
        characteristic = characteristic_prior(math.exp(state[LOG_GN]), self.model.last_knot)
        kernel = kernel_prior(self.model.order(state))
        return Priors(self.model, base, (kernel, characteristic))

    def tails(self, state: Array) -> float:
        """Return by how much Student's tails are above the quadratic of `priors` [1].

        Of minus twice the log prior: the quadratic alone never exceeds 3.
        """
        off = self._off(state)
        beyond = 1.0 + (1.0 + _TAIL_DEGREES) * np.log(
            (off**2 + _TAIL_DEGREES) / (1.0 + _TAIL_DEGREES)
        )
        exact = np.where(np.abs(off) > 1.0, beyond, off**2)
        return float(np.sum(exact - _weights(off) * off**2))

    def _off(self, state: Array) -> Array:
        """Return how far what is stated of the rig is off, in standard deviations."""
        return (state - self.belief.mean)[: self._of_rig.size][self._of_rig]

    def precision(self, state: Array, scales: Scales) -> Array:
        """Return the prior's precision at a state."""
        return self.priors(state).precision(scales)

    def evaluate(self, points: Points, state: Array) -> Evaluation:
        """Return the model at a state; what is known has no derivative."""
        found = self.model.evaluate(points, state)
        found.jacobian[:, self.known] = 0.0
        return found

    def linear(
        self, points: Points, found: Evaluation, errors: Errors, roughness: float, motion: float
    ) -> Linear:
        """Return the record about a state, with errors of given roughness and motion."""
        rows = np.empty((found.stress.size, 1 + found.jacobian.shape[1]))
        np.subtract(points.stresses, found.stress, out=rows[:, 0])
        rows[:, 1:] = found.jacobian
        walk = self.error_model.walk(rows.shape[1])
        products, log_determinant = loops.equations(rows, errors.rows, roughness, motion, walk)
        normal, towards = products[1:, 1:].copy(), products[0, 1:].copy()
        square = float(products[0, 0])
        return Linear(rows[:, 0], normal, towards, square, log_determinant, walk)


def _weights(off: Array) -> Array:
    """Return the weights with which a Gaussian prior pulls as Student's does."""
    return np.minimum((1.0 + _TAIL_DEGREES) / (off**2 + _TAIL_DEGREES), 1.0)
