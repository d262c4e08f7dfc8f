# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What an estimator knows before the data: prior, what model and rig leave open, thresholds."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, fields

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.parameter import parameter


@dataclass(frozen=True)
class Prior:
    """What is known of the tissue before it is touched; by default what soft tissue can be.

    Two standard deviations either way hold G from 10 Pa s^alpha to 1 MPa s^alpha, Gn from 1 to 40
    and alpha from 0.02 to 0.6.
    """

    linear_stiffness: float = parameter(
        "prior.linear_stiffness", 3200.0, "Median of G before the touch.", "Pa s^alpha", 1e-3, 1e9
    )
    linear_stiffness_log_sd: float = parameter(
        "prior.linear_stiffness_log_sd", 2.9, "Standard deviation of ln G.", "1", 1e-3, 5.0
    )
    nonlinear_stiffness: float = parameter(
        "prior.nonlinear_stiffness", 6.3, "Median of Gn before the touch.", "1", 0.1, 100.0
    )
    nonlinear_stiffness_log_sd: float = parameter(
        "prior.nonlinear_stiffness_log_sd", 0.92, "Standard deviation of ln Gn.", "1", 0.01, 2.0
    )
    fractional_order: float = parameter(
        "prior.alpha",
        0.31,
        "Median of alpha before the touch, or alpha itself if alpha.learn is false; 0: a spring.",
        "1",
        0.0,
        0.6,
    )
    fractional_order_sd: float = parameter(
        "prior.alpha_sd", 0.145, "Standard deviation of alpha.", "1", 0.0, 0.3
    )

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


class EstimatorKind(enum.Enum):
    """Which estimator."""

    GRID = "grid"
    EKF = "ekf"


@dataclass(frozen=True)
class Uncertainty:
    """What is not known of model and rig, by default of an arm; 0: nothing."""

    characteristic_sd: float = parameter(
        "model_discrepancy.sd",
        0.2,
        "Relative standard deviation of the stress-strain curve from the law over a factor e of "
        "stress; the relaxation's is a quarter of it. 0: the law is exact.",
        "1",
        0.0,
        1.0,
    )
    surface_motion_sd: float = parameter(
        "surface.motion_sd",
        0.00012,
        "Standard deviation of the surface's unmeasured motion in one second, such as breathing; "
        "0: it rests.",
        "m",
        0.0,
        0.1,
    )
    force_drift_sd: float = parameter(
        "force.drift_sd",
        0.005,
        "Standard deviation of the drift of the force's bias in one second of contact; 0: none.",
        "N",
        0.0,
        1000.0,
    )
    friction_sd: float = parameter(
        "force.friction_sd",
        0.007,
        "Standard deviation of the friction around force.friction; 0: none.",
        "N",
        0.0,
        1000.0,
    )
    compliance_sd: float = parameter(
        "displacement.compliance_sd",
        0.0002,
        "Standard deviation of the compliance around displacement.compliance; 0: none.",
        "m/N",
        0.0,
        1.0,
    )
    delay_sd: float = parameter(
        "displacement.delay_sd",
        0.0025,
        "Standard deviation of the delay around displacement.delay; 0: none.",
        "s",
        0.0,
        0.01,
    )
    backlash_sd: float = parameter(
        "displacement.backlash_sd",
        0.0001,
        "Standard deviation of the play of the drive, by which the tip lags after the motion "
        "turns; 0: none.",
        "m",
        0.0,
        0.1,
    )
    thickness_sd: float = parameter(
        "geometry.thickness_sd",
        0.02,
        "Relative standard deviation of the thickness, or of a sphere's radius; 0: exact.",
        "1",
        0.0,
        1.0,
    )

    @property
    def kernel_sd(self) -> float:
        """Relative standard deviation of the relaxation kernel from the law [1]."""
        # As on beef: 0.05 against 0.2 predict the hold of measured presses within their intervals.
        return 0.25 * self.characteristic_sd


#: A model and a rig that are exact.
NOTHING_UNKNOWN = Uncertainty(**{field.name: 0.0 for field in fields(Uncertainty)})


@dataclass(frozen=True)
class EstimatorConfig:
    """Prior, kind, and thresholds of convergence."""

    prior: Prior = Prior()
    kind: EstimatorKind = parameter(
        "estimator.kind",
        EstimatorKind.GRID,
        "The estimator: grid models the errors of law and rig; ekf is the paper's recursion. ekf "
        "converges only if law and rig are stated to be exact.",
    )
    learns_fractional_order: bool = parameter(
        "alpha.learn",
        True,
        "Learn alpha together with G and Gn; false: alpha is prior.alpha, with prior.alpha_sd. "
        "With estimator.kind ekf alpha is learned unless prior.alpha_sd is 0.",
    )
    converged_log_gn_sd: float = parameter(
        "converged.log_gn_sd",
        0.1,
        "Gn has converged only while the standard deviation of ln Gn is below this.",
        "1",
        1e-4,
        1.0,
    )
    converged_log_g_sd: float = parameter(
        "converged.log_g_sd",
        0.5,
        "G has converged only while the standard deviation of ln G is below this.",
        "1",
        1e-4,
        5.0,
    )
    #: alpha has converged only while its standard deviation is below this [1].
    converged_order_sd: float = 0.05
    #: Gn is observable only while the strain has passed 1/Gn with this probability [1].
    converged_probability: float = 0.99
    #: The evidence of the data decides whether the model's error is there at all.
    uncertainty: Uncertainty = Uncertainty()
    friction: float = parameter(
        "force.friction",
        0.0,
        "Friction against the motion of the probe; used if force.friction_sd is not 0.",
        "N",
        -1000.0,
        1000.0,
    )

    @property
    def is_order_given(self) -> bool:
        """Whether alpha is a setting and not learned."""
        return (
            not self.learns_fractional_order and self.kind is EstimatorKind.GRID
        ) or self.prior.fractional_order_sd == 0.0
