# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""How fast the stress may leave the law: what model and rig leave out, as variances per block.

Errors of model and rig are independent and add to the increments of one random walk of the stress,
in the form that a prediction needs, which has the estimate but not its posterior
(:mod:`fden_ros.core.estimation.error_model` has that one's):

.. math::
    dv = f^2 \left( 2\sigma_c^2\,|d\ln\varphi| + \frac{2\sigma_k^2}{\ell}\,|d\ln A| \right)
    + \left(\frac{\partial f}{\partial d}\,\sigma_s\right)^2 dt + (c\,\sigma_d)^2\,dt

- The *characteristic* deviates from phi by a relative :math:`\sigma_c` while phi grows by a factor
  e: its clock is the motion.
- The *kernel* deviates from :math:`t^{-\alpha}` by a relative :math:`\sigma_k`, correlated over
  :math:`\ell` of ln t. Its clock is the age A of the loading, the mean time since phi grew: in a
  hold A grows with time, in an exponential loading it stands still,
  :math:`\dot A = 1 - A \max(\dot\varphi, 0)/\varphi`.
- The tissue's *surface* moves by :math:`\sigma_s` in a second, against the stiffness of the
  tissue; the sensor's zero *drifts* by :math:`\sigma_d` in a second of contact.

References
----------
Kennedy and O'Hagan, J. R. Statist. Soc. B 63 (2001) 425; Brynjarsdottir and O'Hagan, Inverse
Problems 30 (2014) 114007: the discrepancy of a model must be constrained by what is known of it,
here that it is relative, and smooth in ln phi and ln t.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from fden_ros.core.estimation.estimator_config import Uncertainty
from fden_ros.core.estimation.unknowns import KERNEL_LENGTH
from fden_ros.core.law.geometry import Geometry

#: Growth in one block that counts at most: of ln phi and of ln A [1]. More is the touch itself.
_MOST_LOADING, _MOST_AGEING = 1.0, 2.0
#: phi at G = 1 [1] below which a block is not loaded.
_LEAST_STRAIN = 1e-9


@dataclass(frozen=True)
class Growth:
    """How the loading has changed over a block: the clocks of characteristic and kernel."""

    loading: float = 0.0  #: |d ln phi| [1]
    ageing: float = 0.0  #: |d ln A| [1]


class LoadingAge:
    """The mean time since the present elastic response was built up, and how it grows.

    Parameters
    ----------
    age : float
        The mean time at the beginning [s]; 0: nothing is loaded.
    response : float
        phi at G = 1 by then [1].
    """

    def __init__(self, age: float = 0.0, response: float = 0.0) -> None:
        self._age, self._response = age, response

    @property
    def age(self) -> float:
        """The mean time [s]; 0 before the first block."""
        return self._age

    def grow(self, duration: float, response: float) -> Growth:
        """Take a block of `duration` [s] at whose end phi is `response`, at G = 1 [1]."""
        before, after = self._response, max(response, 0.0)
        self._response = after
        age = self._age
        kept = min(before / after, 1.0) if after > 0.0 else 1.0
        self._age = max((age + duration) * kept, 0.5 * duration)
        if age <= 0.0 or min(before, after) < _LEAST_STRAIN:
            return Growth()
        return Growth(
            min(abs(math.log(after / before)), _MOST_LOADING),
            min(abs(math.log(self._age / age)), _MOST_AGEING),
        )


def kernel_error_variance(kernel_sd: float, ageing: float) -> float:
    """Return the relative variance of the stress [1] by which the kernel's error grows.

    Parameters
    ----------
    kernel_sd : float
        Relative deviation of the kernel from the law [1].
    ageing : float
        Growth of the logarithm of the loading's age [1].
    """
    return 2.0 * kernel_sd**2 / KERNEL_LENGTH * ageing


def model_error_variance(uncertainty: Uncertainty, stress: float, growth: Growth) -> float:
    """Return by how much the variance of the law's error grows at a stress [Pa] [Pa^2]."""
    relative = 2.0 * uncertainty.characteristic_sd**2 * growth.loading + kernel_error_variance(
        uncertainty.kernel_sd, growth.ageing
    )
    return stress**2 * relative


def rig_error_variance(
    uncertainty: Uncertainty, geometry: Geometry, duration: float, stiffness: float
) -> float:
    """Return by how much the variance of the rig's error grows [Pa^2].

    Parameters
    ----------
    uncertainty : Uncertainty
    geometry : Geometry
    duration : float
        [s].
    stiffness : float
        Of the stress by the displacement, relaxed for the time scale of the surface [Pa/m].
    """
    surface = stiffness * uncertainty.surface_motion_sd
    drift = geometry.stress_per_force * uncertainty.force_drift_sd
    return (surface**2 + drift**2) * duration
