# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The parameters of the tissue and how well they are known."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.law import elastic_response, exponential_scale

if TYPE_CHECKING:
    from fden_ros.core.estimation.small_motion import SmallMotion


class StateIndex(enum.IntEnum):
    """Places of the parameters in an estimate's mean and covariance."""

    LOG_LINEAR_STIFFNESS = 0  #: ln G, G in Pa s^alpha
    LOG_NONLINEAR_STIFFNESS = 1  #: ln Gn
    FRACTIONAL_ORDER = 2  #: alpha [1]


class ParameterSet(enum.IntFlag):
    """Some of the tissue's parameters."""

    NONE = 0
    LINEAR_STIFFNESS = 1
    NONLINEAR_STIFFNESS = 2
    FRACTIONAL_ORDER = 4
    STIFFNESS = LINEAR_STIFFNESS | NONLINEAR_STIFFNESS
    ALL = STIFFNESS | FRACTIONAL_ORDER

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in the set, in the order of a state."""
        return tuple(one.name.lower() for one in EACH if one in self and one.name)


EACH = (
    ParameterSet.LINEAR_STIFFNESS,
    ParameterSet.NONLINEAR_STIFFNESS,
    ParameterSet.FRACTIONAL_ORDER,
)


class Component(NamedTuple):
    """One Gaussian of a mixture."""

    weight: float
    mean: Array
    covariance: Array


def moments(components: Sequence[Component]) -> tuple[Array, Array]:
    """Return mean and covariance of a mixture whose weights add up to 1."""
    if len(components) == 1:
        return components[0].mean, components[0].covariance
    middle = np.sum([c.weight * c.mean for c in components], axis=0)
    spread = np.zeros_like(components[0].covariance)
    for component in components:
        off = component.mean - middle
        spread += component.weight * (component.covariance + np.outer(off, off))
    return middle, spread


def inflated(components: Sequence[Component], factor: float) -> tuple[Component, ...]:
    """Return a mixture with the same mean, and a covariance that is `factor` times as large."""
    middle, root = moments(components)[0], math.sqrt(factor)
    return tuple(
        Component(c.weight, middle + root * (c.mean - middle), factor * c.covariance)
        for c in components
    )


class LawError(NamedTuple):
    """How far the data bend the law, as root mean squares of relative deviations [1].

    Of the relaxation kernel over the times seen, of the stress-strain curve over the strains seen,
    and of the curve where it is loaded. And the order of the power law that is nearest to the
    relaxation [1].
    """

    kernel: float
    kernel_sd: float
    characteristic: float
    characteristic_sd: float
    loaded: float
    loaded_sd: float
    order: float
    order_sd: float

    @staticmethod
    def names() -> tuple[str, ...]:
        """Return the names under which outputs state them: relaxation_error and so on."""
        errors = (
            "relaxation_error",
            "stress_strain_error",
            "stress_strain_error_loaded",
            "relaxation_order",
        )
        return tuple(name + part for name in errors for part in ("", "_sd"))


@dataclass(frozen=True)
class Budget:
    """What makes an estimate uncertain."""

    variances: tuple[float, float]  #: of ln G and ln Gn, in all [1]
    parts: Mapping[str, tuple[float, float]]  #: source to its parts of the two [1]
    stress_noise: float  #: standard deviation of the stress per sample [Pa]
    surface_sd: float  #: of the compression at which the tissue begins [1]

    def largest(self, index: int) -> tuple[str, ...]:
        """Return the sources of more than a tenth of ln G (`index` 0) or ln Gn (1), by size."""
        names = sorted(self.parts, key=lambda name: -self.parts[name][index])
        return tuple(name for name in names if self.share(name, index) > 0.1)

    def share(self, source: str, index: int) -> float:
        """Return a source's share of the variance [1]."""
        return self.parts[source][index] / self.variances[index] if self.variances[index] else 0.0


class Estimate(NamedTuple):
    """The parameters and how well they are known."""

    log_linear_stiffness: float  #: ln G, G in Pa s^alpha
    log_nonlinear_stiffness: float  #: ln Gn
    fractional_order: float  #: alpha [1]
    covariance: Array  #: of (ln G, ln Gn, alpha) [1], shape (3, 3)
    contact_point: float = 0.0  #: o [1]
    contact_point_sd: float = 0.0  #: [1]
    probability_beyond_boundary: float = 0.0  #: P(largest strain > 1/Gn) [1]
    #: What the data determine, or a setting: the others are prior knowledge.
    observable: ParameterSet = ParameterSet.NONE
    #: Those of them that have converged, each by itself.
    known: ParameterSet = ParameterSet.NONE
    sample_count: int = 0
    #: Relative standard deviation of the stress-strain curve from the law over a factor e of
    #: stress, averaged by the evidence [1]; 0: the data are those of the law.
    model_discrepancy: float = 0.0
    #: Mean time since the present elastic response was built up [s]; 0: not known.
    mean_dwell_time: float = 0.0
    #: None: not known, before the first grid, and where the law is said to be exact.
    law_error: LawError | None = None
    #: Probability that the relaxation reaches a plateau, and so is not the law's [1]; NaN: not
    #: known, as before the motion has slowed.
    plateau_probability: float = math.nan
    #: Parameters that lie at an end of what the prior allows: then none is known.
    at_edge: ParameterSet = ParameterSet.NONE
    #: Whether the relaxation contradicts the alpha that was stated.
    is_order_contradicted: bool = False
    #: Covariances of (ln G, ln Gn, alpha) with the origin [1]: a hidden one leaves open where the
    #: tissue begins, and not the slope of the force.
    with_origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    #: Components of (ln G, ln Gn, alpha), whose moments the mean and `covariance` are; one: the
    #: posterior is a Gaussian. Empty: not known.
    components: tuple[Component, ...] = ()
    #: Whether the estimator resolves its posterior; otherwise nothing is claimed, nor predicted.
    is_settled: bool = True
    #: For the stiffness of a small motion: of each place that it may be; empty: not known.
    small_motions: tuple[SmallMotion, ...] = ()

    @property
    def stated(self) -> Estimate:
        """Itself, without what only the core asks for."""
        return self._replace(small_motions=())

    @property
    def converged(self) -> bool:
        """Whether G and Gn have converged."""
        return ParameterSet.STIFFNESS in self.known

    @property
    def mean(self) -> Array:
        """(ln G, ln Gn, alpha), shape (3,)."""
        return np.array(
            [self.log_linear_stiffness, self.log_nonlinear_stiffness, self.fractional_order]
        )

    @property
    def mixture(self) -> tuple[Component, ...]:
        """Components, whose moments mean and covariance are; one where it is a Gaussian."""
        return self.components or (Component(1.0, self.mean, self.covariance),)

    @property
    def deviations(self) -> Array:
        """Standard deviations of (ln G, ln Gn, alpha) [1], shape (3,)."""
        return np.sqrt(np.maximum(self.covariance.diagonal(), 0.0))

    def determines(self, index: int) -> bool:
        """Whether the data, or a setting, say what the parameter at `index` is."""
        return bool(self.observable & EACH[index])

    def knows(self, index: int) -> bool:
        """Whether the parameter at `index` has converged."""
        return bool(self.known & EACH[index])

    def is_at_edge(self, index: int) -> bool:
        """Whether the parameter at `index` is at an end of what the prior allows."""
        return bool(self.at_edge & EACH[index])

    def is_above_surface(self, strain: float, free_response: float) -> bool:
        """Whether the tissue would have to pull at a probe to follow it to a strain [1].

        `free_response` is phi of the tissue left alone, D^-alpha of its stress [Pa s^alpha].
        """
        response = elastic_response(strain, self.linear_stiffness, self.nonlinear_stiffness)
        return response.value <= free_response

    @property
    def linear_stiffness(self) -> float:
        """Median of G [Pa s^alpha]."""
        return math.exp(self.log_linear_stiffness)

    @property
    def nonlinear_stiffness(self) -> float:
        """Median of Gn [1]."""
        return math.exp(self.log_nonlinear_stiffness)

    @property
    def linear_stiffness_sd(self) -> float:
        """Standard deviation of G to first order [Pa s^alpha]."""
        return self.linear_stiffness * float(self.deviations[0])

    @property
    def nonlinear_stiffness_sd(self) -> float:
        """Standard deviation of Gn to first order [1]."""
        return self.nonlinear_stiffness * float(self.deviations[1])

    @property
    def fractional_order_sd(self) -> float:
        """Standard deviation of alpha [1]."""
        return float(self.deviations[2])

    @property
    def exponential_scale(self) -> float:
        """Gi at the medians [Pa s^alpha]."""
        return exponential_scale(self.linear_stiffness, self.nonlinear_stiffness)

    @property
    def boundary_strain(self) -> float:
        """1/Gn at its median [1]."""
        return 1.0 / self.nonlinear_stiffness

    @property
    def boundary_stress(self) -> float:
        """G/Gn, about the stress after a second at the boundary strain [Pa]."""
        return self.linear_stiffness * self.boundary_strain

    @property
    def numbers(self) -> dict[str, float]:
        """What outputs state, by the names of :data:`PUBLISHED`; without those not known."""
        of_law = LawError.names()
        found = {name: getattr(self, name) for name in PUBLISHED if name not in of_law}
        if math.isnan(self.plateau_probability):
            del found["plateau_probability"]
        if self.law_error is not None:
            found |= zip(of_law, self.law_error, strict=True)
        return found


#: Numbers of an estimate that leave the core, by their names, which are those of the fields of the
#: messages; and their keys in the JSON of a contact and columns of a table; empty: in neither. To
#: put out another, add it here, to both messages, and to what docs/interface.md says of `valid`.
PUBLISHED = {
    "linear_stiffness": "g",
    "nonlinear_stiffness": "g_n",
    "fractional_order": "alpha",
    "linear_stiffness_sd": "g_sd",
    "nonlinear_stiffness_sd": "g_n_sd",
    "fractional_order_sd": "alpha_sd",
    "exponential_scale": "",
    "boundary_strain": "",
    "contact_point": "",
    "contact_point_sd": "",
    "model_discrepancy": "",
    "mean_dwell_time": "",
    "plateau_probability": "plateau_probability",
    **{name: name for name in LawError.names()},
}
#: Those that have a key, by their keys.
KEYS = {key: name for name, key in PUBLISHED.items() if key}
