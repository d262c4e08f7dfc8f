# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Input and output of an estimator: prior, block, innovation, estimate; indices of a state."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.law.characteristic import elastic_response, exponential_scale

if TYPE_CHECKING:
    from fden_ros.core.estimation.rig_knowledge import RigKnowledge


class StateIndex(enum.IntEnum):
    """Places of the parameters in a state; the first three also in an estimate's covariance."""

    LOG_LINEAR_STIFFNESS = 0  #: ln G, G in Pa s^alpha
    LOG_NONLINEAR_STIFFNESS = 1  #: ln Gn
    FRACTIONAL_ORDER = 2  #: alpha [1]
    STRAIN_ORIGIN = 3  #: o, as compression [1]
    BIAS = 4  #: of the stress in this contact [Pa]
    DRIFT = 5  #: of the stress in this contact [Pa/s]
    PULSE = 6  #: of phi, at a change of the tissue [Pa s^alpha]
    COMPLIANCE = 7  #: of the rig, in its standard deviations [1]
    DELAY = 8  #: between the streams, in its standard deviations [1]
    FRICTION = 9  #: against the motion, in its standard deviations [1]
    JITTER = 10  #: share by which noise of a resting displacement counts too much or little [1]
    SHIFT = 11  #: of the surface since the last contact, in its standard deviations [1]
    WALK = 12  #: stress left out by law and rig at the last knot, in the walk's unit [1]
    WALK_NEXT = 13  #: at the next knot [1]


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
        return tuple(one.name.lower() for one in _EACH if one in self and one.name)


_EACH = (
    ParameterSet.LINEAR_STIFFNESS,
    ParameterSet.NONLINEAR_STIFFNESS,
    ParameterSet.FRACTIONAL_ORDER,
)
#: The data have determined ln G or alpha when its standard deviation is below this share of its
#: prior's [1]: then they say three times as much as the prior.
_LEARNED_SHARE = 0.5


@dataclass(frozen=True)
class Prior:
    """What is known of the tissue before it is touched; by default what soft tissue can be.

    Two standard deviations either way hold G from 10 Pa s^alpha to 1 MPa s^alpha, Gn from 1 to 40
    and alpha from 0.02 to 0.6.

    Parameters
    ----------
    linear_stiffness, nonlinear_stiffness : float
        Medians of G [Pa s^alpha] and Gn [1], both log-normal.
    linear_stiffness_log_sd, nonlinear_stiffness_log_sd : float
        Standard deviations of ln G and ln Gn [1].
    fractional_order, fractional_order_sd : float
        alpha [1] and its standard deviation [1].
    """

    linear_stiffness: float = 3200.0
    linear_stiffness_log_sd: float = 2.9
    nonlinear_stiffness: float = 6.3
    nonlinear_stiffness_log_sd: float = 0.92
    fractional_order: float = 0.31
    fractional_order_sd: float = 0.145

    @property
    def mean(self) -> Array:
        """(ln G, ln Gn, alpha), shape (3,)."""
        return np.array(
            [
                math.log(self.linear_stiffness),
                math.log(self.nonlinear_stiffness),
                self.fractional_order,
            ]
        )

    @property
    def deviations(self) -> Array:
        """Standard deviations of (ln G, ln Gn, alpha), shape (3,)."""
        return np.array(
            [
                self.linear_stiffness_log_sd,
                self.nonlinear_stiffness_log_sd,
                self.fractional_order_sd,
            ]
        )


class Observation(enum.Enum):
    """The quantity whose innovation an estimator takes."""

    STRESS = "stress"
    FRACTIONAL_STRESS = "fractional_stress"


@dataclass(frozen=True)
class Uncertainty:
    """What is not known of model and rig, as standard deviations; 0: nothing.

    Parameters
    ----------
    kernel_sd, characteristic_sd : float
        Relative deviations of relaxation kernel and characteristic from the law [1].
    surface_motion_sd : float
        Way of the tissue's surface in one second [m].
    force_drift_sd : float
        Change of the force's zero in one second of contact [N].
    friction_sd : float
        Friction against the motion of the probe [N].
    compliance_sd : float
        Compliance of tool and robot that `displacement` does not allow for [m/N].
    delay_sd : float
        Delay between force and displacement [s].
    thickness_sd : float
        Relative deviation of the geometry's length [1].
    """

    kernel_sd: float = 0.0
    characteristic_sd: float = 0.0
    surface_motion_sd: float = 0.0
    force_drift_sd: float = 0.0
    friction_sd: float = 0.0
    compliance_sd: float = 0.0
    delay_sd: float = 0.0
    thickness_sd: float = 0.0

    @property
    def rig_sd(self) -> tuple[float, float]:
        """Deviations of what is learned of the rig: delay [s] and friction [N]."""
        return self.delay_sd, self.friction_sd

    @property
    def walks(self) -> bool:
        """Whether there is anything that changes with time."""
        return any(
            (self.kernel_sd, self.characteristic_sd, self.surface_motion_sd, self.force_drift_sd)
        )


#: A model and a rig that are exact.
NOTHING_UNKNOWN = Uncertainty()


@dataclass(frozen=True)
class EstimatorConfig:
    """Prior, observation, and thresholds of convergence.

    Parameters
    ----------
    prior : Prior
    observation : Observation
        STRESS learns alpha as well; FRACTIONAL_STRESS is the paper's way.
    fractional_order_given : bool
        alpha is not learned; its deviation counts all the same. Always so with FRACTIONAL_STRESS.
    converged_log_sd, converged_linear_log_sd, converged_order_sd : float
        Gn, G and alpha have converged only while the standard deviations of ln Gn, ln G and alpha
        are at most these [1].
    converged_probability : float
        Gn is observable only while P(largest strain > 1/Gn) is at least this [1].
    uncertainty : Uncertainty
        What is not known of model and rig. Whether the model's error is there at all, the evidence
        of the data decides.
    friction : float
        Friction that is expected [N]; counts where its deviation is not 0.
    """

    prior: Prior = Prior()
    observation: Observation = Observation.STRESS
    fractional_order_given: bool = False
    converged_log_sd: float = 0.05
    converged_linear_log_sd: float = 0.5
    converged_order_sd: float = 0.05
    converged_probability: float = 0.99
    uncertainty: Uncertainty = Uncertainty()
    friction: float = 0.0

    @property
    def is_order_given(self) -> bool:
        """Whether alpha is a setting and not learned."""
        return (
            self.fractional_order_given
            or self.observation is Observation.FRACTIONAL_STRESS
            or self.prior.fractional_order_sd == 0.0
        )


class Block(NamedTuple):
    """Means over a block of samples."""

    compression: float  #: u, from the nominal strain origin [1]
    stress: float  #: f [Pa]
    memory_time: float  #: t since the memory began [s]
    size: int  #: samples in the block
    duration: float  #: from the first sample to the last and one step more [s]
    fractional_integrals: Array  #: D^-beta f [Pa s^beta], shape (orders,)


class Innovation(NamedTuple):
    """How one block compared with its prediction."""

    predicted_fractional_stress: float  #: [Pa s^alpha]
    predicted_stress: float | None  #: [Pa]; None where the fractional stress is observed
    innovation: float  #: observed less predicted [Pa, or Pa s^alpha]
    variance: float  #: of the innovation, in its unit squared

    @property
    def normalized_squared(self) -> float:
        """Normalised innovation squared (NIS) [1]."""
        return self.innovation**2 / self.variance


class LawError(NamedTuple):
    """How far the data bend the law, as root mean squares of relative deviations [1].

    Of the relaxation kernel over the times seen, of the stress-strain curve over the strains seen,
    and of the curve where it is loaded (see :mod:`fden_ros.core.estimation.law_deviation`).
    """

    kernel: float
    kernel_sd: float
    characteristic: float
    characteristic_sd: float
    loaded: float
    loaded_sd: float

    @staticmethod
    def names() -> tuple[str, ...]:
        """Return the names under which outputs state them, kernel_error and kernel_error_sd."""
        return tuple(
            f"{field.removesuffix('_sd')}_error{'_sd' if field.endswith('_sd') else ''}"
            for field in LawError._fields
        )


class Estimate(NamedTuple):
    """The parameters and how well they are known."""

    log_linear_stiffness: float  #: ln G, G in Pa s^alpha
    log_nonlinear_stiffness: float  #: ln Gn
    fractional_order: float  #: alpha [1]
    covariance: Array  #: of (ln G, ln Gn, alpha) [1], shape (3, 3)
    strain_origin: float  #: o [1]
    strain_origin_sd: float  #: [1]
    probability_beyond_boundary: float  #: P(largest strain > 1/Gn) [1]
    valid: ParameterSet  #: what the data determine, or a setting: the others are prior knowledge
    known: ParameterSet  #: those of them that have converged, each by itself
    sample_count: int
    #: Relative standard deviation of the stress-strain curve from the law over a factor e of
    #: stress, averaged by the evidence [1]; 0: the data are those of the law.
    model_error: float = 0.0
    #: Mean time since the present elastic response was built up [s]; 0: not known.
    loading_age: float = 0.0
    #: None: not known, before 2 s of the first contact of a site.
    law_error: LawError | None = None
    #: Parameters that lie at an end of what the estimator can represent: then none is known.
    at_edge: ParameterSet = ParameterSet.NONE

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
    def deviations(self) -> Array:
        """Standard deviations of (ln G, ln Gn, alpha) [1], shape (3,)."""
        return np.sqrt(np.maximum(self.covariance.diagonal(), 0.0))

    def determines(self, index: int) -> bool:
        """Whether the data, or a setting, say what the parameter at `index` is."""
        return bool(self.valid & _EACH[index])

    def knows(self, index: int) -> bool:
        """Whether the parameter at `index` has converged."""
        return bool(self.known & _EACH[index])

    def is_at_edge(self, index: int) -> bool:
        """Whether the parameter at `index` is at an end of what can be represented."""
        return bool(self.at_edge & _EACH[index])

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
        return self.linear_stiffness * self._deviation(StateIndex.LOG_LINEAR_STIFFNESS)

    @property
    def nonlinear_stiffness_sd(self) -> float:
        """Standard deviation of Gn to first order [1]."""
        return self.nonlinear_stiffness * self._deviation(StateIndex.LOG_NONLINEAR_STIFFNESS)

    @property
    def fractional_order_sd(self) -> float:
        """Standard deviation of alpha [1]."""
        return self._deviation(StateIndex.FRACTIONAL_ORDER)

    @property
    def exponential_scale(self) -> float:
        """Gi at the medians [Pa s^alpha]."""
        return exponential_scale(self.linear_stiffness, self.nonlinear_stiffness)

    @property
    def boundary_strain(self) -> float:
        """1/Gn at its median [1]."""
        return 1.0 / self.nonlinear_stiffness

    @property
    def numbers(self) -> dict[str, float]:
        """What outputs state, by the names of :data:`PUBLISHED`; without those not known."""
        found = {name: getattr(self, name) for name in _ITS_OWN}
        if self.law_error is not None:
            found |= zip(LawError.names(), self.law_error, strict=True)
        return found

    def _deviation(self, index: StateIndex) -> float:
        return math.sqrt(max(float(self.covariance[index, index]), 0.0))


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
    "strain_origin": "",
    "strain_origin_sd": "",
    "model_error": "",
    "loading_age": "",
    **{name: name for name in LawError.names()},
}
#: Those that have a key, by their keys.
KEYS = {key: name for name, key in PUBLISHED.items() if key}
_ITS_OWN = tuple(name for name in PUBLISHED if name not in LawError.names())


def determined(
    config: EstimatorConfig, deviations: Array, probability_beyond_boundary: float
) -> ParameterSet:
    """Return the parameters that the data determine, or a setting.

    Gn is where the strain has passed 1/Gn: below, the law is linear. G and alpha are where their
    deviations are below half of their priors'. An alpha that is given is as it was stated.

    Parameters
    ----------
    config : EstimatorConfig
    deviations : ndarray, shape (3,)
        Standard deviations of (ln G, ln Gn, alpha) [1].
    probability_beyond_boundary : float
        P(largest strain > 1/Gn) [1].
    """
    log_g, _, order = (deviations < _LEARNED_SHARE * config.prior.deviations).tolist()
    found = ParameterSet.NONE
    if probability_beyond_boundary >= config.converged_probability:
        # A stress-strain curve that is seen to bend has a scale, too.
        found |= ParameterSet.STIFFNESS
    if log_g:
        found |= ParameterSet.LINEAR_STIFFNESS
    if order or config.is_order_given:
        found |= ParameterSet.FRACTIONAL_ORDER
    return found


def converged(config: EstimatorConfig, deviations: Array, valid: ParameterSet) -> ParameterSet:
    """Return those of the parameters `valid` whose deviations, shape (3,), are small enough."""
    limits = np.array(
        [config.converged_linear_log_sd, config.converged_log_sd, config.converged_order_sd]
    )
    found = ParameterSet.NONE
    for parameter, is_close in zip(_EACH, deviations <= limits, strict=True):
        if is_close:
            found |= parameter
    return found & valid


class Estimator(Protocol):
    """An observation model with its filter; the pipeline asks for nothing else."""

    @property
    def is_mismatch(self) -> bool:
        """Whether the innovations are larger or slower than model and noise explain."""

    @property
    def is_doubtful(self) -> bool:
        """Whether a surprise or a mismatch of late is not explained yet."""

    @property
    def change_count(self) -> int:
        """Changes of the tissue under the probe that were found."""

    @property
    def rig_deviations(self) -> float:
        """How far a contact that went in and out says the rig is from what is stated [1]."""

    def begin_contact(self, bias_sd: float, drift_sd: float) -> None:
        """Start a contact whose stress has a bias [Pa] and a drift [Pa/s] of its own."""

    def press(self, step: float, compression: float, surface: float = 0.0) -> None:
        """Take the motion of a sample in contact, `step` seconds after the last.

        `surface` is what its measured place has taken off the compression [1].
        """

    def rest(self, steps: tuple[float, ...], free_responses: Array) -> None:
        """Take steps in the air, with D^-alpha of the stress after each at the order nodes."""

    def skip(self) -> None:
        """Let the samples since the last block go by."""

    def update(self, block: Block) -> Innovation:
        """Take one block; return how it compared with the prediction."""

    def estimate(self) -> Estimate:
        """Return the present estimate."""

    def motion_evidence(self) -> list[float] | None:
        """Return the evidence of a contact for shares of the surface's stated motion, or None."""

    def rig(self) -> RigKnowledge | None:
        """Return what is known of the rig after a contact; None where it tells nothing."""

    def work_ahead(self, steps: int, *, begins: bool) -> None:
        """Do some steps of solving anew, where that is due; `begins`: a new block does."""

    def relinearise(self, *, fully: bool = False) -> None:
        """Solve anew about the present state, when that is due; `fully`: now, at the end."""
