# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Dynamic viscoelastic tests: an oscillation in the linear range, at several frequencies.

With :math:`x` small the model is :math:`D^\alpha (G x) = f`, whose transfer function is the
complex modulus (paper, eqs. Laplace to GpandGpp)

.. math:: G^*(j\omega) = G (j\omega)^\alpha, \qquad
          G' = G \cos(\tfrac{\pi}{2}\alpha)\,\omega^\alpha, \qquad
          G'' = G \sin(\tfrac{\pi}{2}\alpha)\,\omega^\alpha .

These are two straight lines of the slope alpha in the log-log plane.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from fden_ros.core.arrays import Array
from fden_ros.experiments.columns import read_table
from fden_ros.experiments.regression import line_through, require_positive
from fden_ros.experiments.result import Fit, Parameter, plain, positive, r_squared

#: Deviations of alpha and ln G about the first sample's values, before any sample counts.
_PRIOR_SD, _LEAST_NOISE = (0.3, 3.0), 1e-7
#: A contradiction is reported beyond this many deviations, and this difference of alpha.
_CONTRADICTION, _NEGLIGIBLE_ORDER = 3.0, 1e-3


def from_file(path: Path) -> Fit:
    """Return the fit of a file of storage and loss moduli."""
    table = read_table(path)
    columns = [table.positive(n) for n in ("omega_rad_s", "storage_modulus_pa", "loss_modulus_pa")]
    table.require_rows(2, "a dynamic fit")
    return fit_complex_modulus(*columns)


def fit_complex_modulus(omega: Array, storage: Array, loss: Array) -> Fit:
    r"""Return alpha and G from omega [rad/s], G' and G'' [Pa], (n,) each (paper, Appendix C).

    An extended Kalman filter with the constant state (alpha, ln G) observes
    :math:`(\log G', \log G'')`, frequency after frequency. The paper starts it at zero, where the
    logarithm is infinite. Here it starts at the first pair, with wide deviations. The
    residuals of one run give the noise of each modulus for the next.

    The slope of \|G*\| and the mean phase each give an alpha. Where they contradict each other, as
    for some tissue (Kobayashi et al., arXiv:1804.00979), a warning has both.
    """
    require_positive(omega=omega, storage_modulus=storage, loss_modulus=loss)
    order = np.argsort(omega, kind="stable")
    omega = omega[order]
    moduli = np.column_stack([storage, loss])[order]
    logs = np.log(moduli)
    noise = np.full(2, 0.05)
    # Twice, because the noise comes from the second run's residuals.
    for _ in range(3):
        state, covariance = _filter(np.log(omega), logs, noise)
        residuals = logs - _predicted(state, np.log(omega))
        noise = np.sqrt(np.sum(residuals**2, axis=0) / max(omega.size - 1, 1)) + _LEAST_NOISE
    # One of the two moduli, G'', determines nearly all of alpha.
    dof = float(omega.size - 1)
    deviations = np.sqrt(np.diag(covariance)) if dof > 0 else np.full(2, math.nan)
    parameters = {
        "alpha": plain(state[0], deviations[0], dof),
        "g": positive(state[1], deviations[1], dof),
    }
    orders = 2.0 / math.pi * np.arctan2(moduli[:, 1], moduli[:, 0])
    sd = orders.std(ddof=1) / math.sqrt(orders.size) if dof > 0 else math.nan
    phase = plain(float(orders.mean()), sd, dof)
    slope = line_through(np.log(omega), np.log(np.hypot(*moduli.T))).plain(1.0)
    fitted = r_squared(logs, _predicted(state, np.log(omega)))
    return Fit("dynamic", parameters, fitted, omega.size, _contradiction(slope, phase))


def _predicted(state: Array, log_omega: Array) -> Array:
    """Return log G' and log G'' (eqs. logGp, logGpp), shape (n, 2)."""
    alpha, log_g = state
    angle = 0.5 * math.pi * alpha
    distances = np.array([math.log(math.cos(angle)), math.log(math.sin(angle))])
    result: Array = alpha * log_omega[:, None] + log_g + distances
    return result


def _filter(log_omega: Array, logs: Array, noise: Array) -> tuple[Array, Array]:
    """Run the filter of Appendix C; return state (2,) and covariance (2, 2)."""
    alpha = 2.0 / math.pi * math.atan(math.exp(logs[0, 1] - logs[0, 0]))
    log_modulus = 0.5 * np.logaddexp(2.0 * logs[0, 0], 2.0 * logs[0, 1])
    ekf = ExtendedKalmanFilter(dim_x=2, dim_z=2)
    ekf.x = np.array([alpha, log_modulus - alpha * log_omega[0]])
    ekf.P = np.diag(np.square(_PRIOR_SD))
    ekf.R = np.diag(noise**2)
    for position, observed in zip(log_omega, logs, strict=True):

        def jacobian(state: Array, position: float = position) -> Array:
            angle = 0.5 * math.pi * state[0]
            slopes = position + 0.5 * math.pi * np.array([-math.tan(angle), 1 / math.tan(angle)])
            return np.column_stack([slopes, np.ones(2)])

        def expected(state: Array, position: float = position) -> Array:
            return np.asarray(_predicted(state, np.array([position]))[0])

        ekf.update(observed, jacobian, expected)
        # One pair of moduli can throw alpha out of its range, where the model has no logarithm.
        ekf.x[0] = min(max(ekf.x[0], 1e-4), 1.0 - 1e-4)
    return np.array(ekf.x), np.array(ekf.P)


def _contradiction(slope: Parameter, phase: Parameter) -> tuple[str, ...]:
    """Return a warning if the alphas of slope and phase exclude each other."""
    sd = math.hypot(slope.sd, phase.sd)
    if not abs(slope.value - phase.value) > max(_CONTRADICTION * sd, _NEGLIGIBLE_ORDER):
        return ()
    return (
        f"slope and phase contradict each other: alpha is {slope.value:.3f} by the slope, "
        f"{phase.value:.3f} by G''/G'; one springpot does not describe both",
    )
