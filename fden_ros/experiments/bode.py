# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Bode diagram: the gain and phase of strain after stress (paper, eqs. Gain to Phase).

The gain is :math:`|1/G^*| = \omega^{-\alpha}/G` and the phase :math:`-\pi\alpha/2` at every
frequency (the paper's eq. Phase prints arg(G'/G'')).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.errors import InputError
from fden_ros.experiments.columns import read_table
from fden_ros.experiments.dynamic import alpha_by_phase, contradiction, frequencies
from fden_ros.experiments.kinds import Options
from fden_ros.experiments.regression import line_through_logarithms, require_positive
from fden_ros.experiments.result import Fit, Panel, compared, r_squared


def from_file(path: Path, options: Options) -> Fit:
    """Return the fit of a file of gains and phases."""
    table = read_table(path)
    omega, gain = table.positive("omega_rad_s"), table.positive("gain_per_pa")
    phase = table.column("phase_rad")
    table.require_rows(2, "a Bode fit")
    return fit_bode(omega, gain, phase)


def fit_bode(omega: Array, gain: Array, phase: Array) -> Fit:
    r"""Return alpha and G from the gain, and check the phase.

    Linear regression of :math:`\log \text{gain} = -\log G - \alpha \log\omega`. The phase is not
    used but checked: its mean should be :math:`-\pi\alpha/2`. ``phase`` has the alpha that it
    says; a contradiction is reported.

    Parameters
    ----------
    omega : ndarray, shape (n,)
        Angular frequency [rad/s].
    gain : ndarray, shape (n,)
        Strain per stress [1/Pa].
    phase : ndarray, shape (n,)
        Phase of strain after stress [rad], from -pi/2 to 0.

    Raises
    ------
    InputError
        If the phase cannot be in radians, or has the other sign.
    """
    require_positive(omega=omega, gain=gain)
    if np.max(np.abs(phase)) > math.pi:
        raise InputError(
            f"phase_rad goes to {phase[np.argmax(np.abs(phase))]:g}; give radians, not degrees"
        )
    if np.mean(phase) > 0.0:
        raise InputError(
            "phase_rad is positive; strain lags stress, so the phase must be negative: turn its "
            "sign"
        )
    order = np.argsort(omega, kind="stable")
    omega, gain, phase = omega[order], gain[order], phase[order]
    solution = line_through_logarithms(omega, gain)
    alpha, log_g = -solution.values
    logs, fine = np.log(gain), frequencies(omega)
    gains = compared(omega, gain, fine, fine**-alpha * math.exp(-log_g))
    level = np.full_like(fine, -math.pi / 2 * alpha)
    phases = compared(omega, phase, fine, level, "-πα/2 of the gain")
    problems = contradiction(alpha, solution.covariance[0, 0], -phase, "the phase")
    return Fit(
        "bode",
        {"alpha": solution.plain(-1.0, 0.0), "g": solution.positive(0.0, -1.0)},
        r_squared(logs, logs - solution.residuals),
        omega.size,
        (*problems, *solution.warnings()),
        {"phase": {"alpha": alpha_by_phase(-phase)}},
        (
            Panel("Gain", "ω [rad/s]", "gain [1/Pa]", gains, x_log=True, y_log=True),
            Panel("Phase", "ω [rad/s]", "phase [rad]", phases, x_log=True),
        ),
    )
