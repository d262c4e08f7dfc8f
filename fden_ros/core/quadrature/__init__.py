# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The estimator as one weighted sum: nodes of what is nonlinear, Gaussian algebra for the rest."""

from fden_ros.core.quadrature.estimator import QuadratureEstimator
from fden_ros.core.quadrature.place import Touch

__all__ = ["QuadratureEstimator", "Touch"]
