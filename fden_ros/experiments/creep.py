# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

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

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import digamma, gammaln

from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.experiments.columns import read_table
from fden_ros.experiments.kinds import Options
from fden_ros.experiments.regression import line_through_logarithms, require_positive
from fden_ros.experiments.result import Fit, r_squared

#: The paper leaves the first second of a creep test out: the rheometer still vibrates.
START = 1.0


class CreepTest(NamedTuple):
    """One creep test."""

    time: Array  #: since the stress was applied [s], positive, shape (n,)
    strain: Array  #: [1], positive, shape (n,)
    stress: float  #: [Pa], constant, positive


def from_file(path: Path, options: Options) -> Fit:
    """Return the fit of one creep test in a file."""
    return fit_creep(*read_creep_test(path, options))


def read_creep_test(path: Path, options: Options) -> CreepTest:
    """Read time_s, strain and the stress of a creep test."""
    table = read_table(path)
    time, strain = table.times(), table.checked_strain(table.column("strain"))
    if options.stress is not None:
        stress = options.stress
    elif "stress_pa" in table:
        stress = table.held("stress_pa", table.column("stress_pa"))
    else:
        raise InputError(f"{path} does not say the stress; give --stress PA or a column stress_pa")
    if not stress > 0.0:
        raise InputError(f"{path}: the stress is {stress:g} Pa; it must be positive")
    kept, table = table.since(time, START if options.start is None else options.start)
    table.require_rows(2, "a creep fit")
    table.require_positive("time_s", time[kept])
    table.require_positive("strain", strain[kept])
    return CreepTest(time[kept], strain[kept], stress)


def fit_creep(time: Array, strain: Array, stress: float) -> Fit:
    r"""Return alpha, xc and G from one creep test by least squares in the log-log plane.

    :math:`\log x = \alpha \log t + \log x_c`, then
    :math:`G = f_c/(x_c \Gamma(1+\alpha))`, with the covariance of (alpha, log xc) carried through
    :math:`d\ln G = -d\ln x_c - \psi(1+\alpha)\,d\alpha`. G is the secant stiffness phi(x)/x where
    the strain is beyond 1/Gn. Parameters as in :class:`CreepTest`.
    """
    require_positive(time=time, strain=strain, stress=np.array([stress]))
    solution = line_through_logarithms(time, strain)
    alpha, log_xc = solution.values
    log_g = float(np.log(stress) - log_xc - gammaln(1.0 + alpha))
    warnings = list(solution.warnings())
    if not 0.0 < alpha < 1.0:
        warnings.append(f"alpha is {alpha:.3f}, outside (0, 1): this is no springpot's creep")
    logs = np.log(strain)
    return Fit(
        "creep",
        {
            "alpha": solution.plain(1.0, 0.0),
            "x_c": solution.positive(0.0, 1.0),
            "g": solution.positive(digamma(1.0 + alpha), 1.0, log_value=log_g),
        },
        r_squared(logs, logs - solution.residuals),
        time.size,
        tuple(warnings),
    )
