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

r"""Creep: a constant stress from time 0, the strain over time.

In the linear range :math:`D^\alpha(G x) = f_c` is solved by the fractional integral of a constant
(paper, eqs. FC, Creep, CreepLog and xc, where r means alpha),

.. math:: x = \frac{1}{G} D^{-\alpha} f_c = \frac{f_c}{G\,\Gamma(1+\alpha)}\, t^\alpha
            = x_c\, t^\alpha ,

a straight line in the log-log plane. Beyond :math:`1/G_n` the exact creep is
:math:`x = \varphi^{-1}(f_c t^\alpha/\Gamma(1+\alpha))`, whose log-log slope is
:math:`\alpha/(G_n x)`: no power law, and a smaller slope, see
:mod:`fden_ros.experiments.nonlinearity`.
"""

from __future__ import annotations

import numpy as np
from scipy.special import digamma, gammaln

from fden_ros.core.arrays import Array
from fden_ros.experiments.regression import line_through_logarithms, require_positive
from fden_ros.experiments.result import Curve, Fit, Panel, plain, positive, r_squared


def fit_creep(time: Array, strain: Array, stress: float) -> Fit:
    r"""Return alpha, xc and G from one creep test by least squares in the log-log plane.

    :math:`\log x = \alpha \log t + \log x_c`, then
    :math:`G = f_c/(x_c \Gamma(1+\alpha))`, with the covariance of (alpha, log xc) carried through
    :math:`d\ln G = -d\ln x_c - \psi(1+\alpha)\,d\alpha`. G is the secant stiffness phi(x)/x where
    the strain is beyond 1/Gn.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Time since the stress was applied [s], positive. The paper leaves the first second out.
    strain : ndarray, shape (n,)
        Strain [1], positive.
    stress : float
        The constant stress fc [Pa].
    """
    require_positive(time=time, strain=strain, stress=np.array([stress]))
    solution = line_through_logarithms(time, strain)
    alpha, log_xc = solution.values
    spread, dof = solution.deviation_of, solution.dof
    parameters = {
        "alpha": plain(alpha, spread(np.array([1.0, 0.0])), dof),
        "x_c": positive(log_xc, spread(np.array([0.0, 1.0])), dof),
        "g": positive(
            float(np.log(stress) - log_xc - gammaln(1.0 + alpha)),
            spread(np.array([digamma(1.0 + alpha), 1.0])),
            dof,
        ),
    }
    logs = np.log(strain)
    warnings = list(solution.warnings())
    if not 0.0 < alpha < 1.0:
        warnings.append(f"alpha is {alpha:.3f}, outside (0, 1): this is no springpot's creep")
    model = np.exp(log_xc) * time**alpha
    curves = (Curve(time, strain, "measured", line=False), Curve(time, model, "model", color=1))
    return Fit(
        "creep",
        parameters,
        r_squared(logs, logs - solution.residuals),
        time.size,
        tuple(warnings),
        panels=(
            Panel("Creep", "time [s]", "strain", curves),
            Panel("Log-log", "time [s]", "strain", curves, x_log=True, y_log=True),
        ),
    )
