# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What an estimator knows before the data: prior, what model and rig leave open, thresholds."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np

from fden_ros.core.arrays import Array


@dataclass(frozen=True)
class Prior:
    """What is known of the tissue before it is touched; by default what soft tissue can be.

    Two standard deviations either way hold G from 10 Pa s^alpha to 1 MPa s^alpha, Gn from 1 to 40
    and alpha from 0.02 to 0.6.
    """

    #: Medians of G [Pa s^alpha] and Gn [1], both log-normal.
    linear_stiffness: float = 3200.0
    #: Standard deviations of ln G and ln Gn [1].
    linear_stiffness_log_sd: float = 2.9
    nonlinear_stiffness: float = 6.3
    nonlinear_stiffness_log_sd: float = 0.92
    #: alpha [1] and its standard deviation [1].
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


#: The kernel's relative error over that of the characteristic [1], as on beef: 0.05 against 0.2
#: predict the hold of measured presses within their intervals.
KERNEL_SHARE = 0.25


class Observation(enum.Enum):
    """What an estimator takes."""

    STRESS = "stress"
    FRACTIONAL_STRESS = "fractional_stress"


@dataclass(frozen=True)
class Uncertainty:
    """What is not known of model and rig, as standard deviations; 0: nothing."""

    #: Relative deviations of relaxation kernel and characteristic from the law [1].
    kernel_sd: float = 0.0
    characteristic_sd: float = 0.0
    surface_motion_sd: float = 0.0  #: way of the tissue's surface in one second [m]
    force_drift_sd: float = 0.0  #: change of the force's zero in one second of contact [N]
    friction_sd: float = 0.0  #: friction against the motion of the probe [N]
    #: Compliance of tool and robot that `displacement` does not allow for [m/N].
    compliance_sd: float = 0.0
    delay_sd: float = 0.0  #: delay between force and displacement [s]
    thickness_sd: float = 0.0  #: relative deviation of the geometry's length [1]

    @property
    def rig_sd(self) -> tuple[float, float]:
        """Deviations of what is learned of the rig: delay [s] and friction [N]."""
        return self.delay_sd, self.friction_sd


#: A model and a rig that are exact.
NOTHING_UNKNOWN = Uncertainty()


@dataclass(frozen=True)
class EstimatorConfig:
    """Prior, observation, and thresholds of convergence."""

    prior: Prior = Prior()
    #: STRESS learns alpha as well; FRACTIONAL_STRESS is the paper's way.
    observation: Observation = Observation.STRESS
    #: alpha is not learned; its deviation counts all the same. Always so with FRACTIONAL_STRESS.
    fractional_order_given: bool = False
    #: Gn, G and alpha have converged only while the standard deviations of ln Gn, ln G and alpha
    #: are at most these [1].
    converged_log_sd: float = 0.05
    converged_linear_log_sd: float = 0.5
    converged_order_sd: float = 0.05
    #: Gn is observable only while P(largest strain > 1/Gn) is at least this [1].
    converged_probability: float = 0.99
    #: What is not known of model and rig. Whether the model's error is there at all, the evidence
    #: of the data decides.
    uncertainty: Uncertainty = Uncertainty()
    friction: float = 0.0  #: friction that is expected [N]; counts where its deviation is not 0

    @property
    def is_order_given(self) -> bool:
        """Whether alpha is a setting and not learned."""
        return (
            self.fractional_order_given
            or self.observation is Observation.FRACTIONAL_STRESS
            or self.prior.fractional_order_sd == 0.0
        )
