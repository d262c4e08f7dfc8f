# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Dynamic viscoelastic tests: an oscillation in the linear range, at several frequencies.

With :math:`x` small the model is :math:`D^\alpha (G x) = f`, whose transfer function is the
complex modulus (paper, eqs. Laplace to GpandGpp)

.. math:: G^*(j\omega) = G (j\omega)^\alpha, \qquad
          G' = G \cos(\tfrac{\pi}{2}\alpha)\,\omega^\alpha, \qquad
          G'' = G \sin(\tfrac{\pi}{2}\alpha)\,\omega^\alpha .

So in the log-log plane storage and loss modulus are two straight lines of the same slope alpha,
and their distance is :math:`\log\tan(\pi\alpha/2)`.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from fden_ros.core.arrays import Array
from fden_ros.experiments.columns import read_table
from fden_ros.experiments.kinds import Options
from fden_ros.experiments.regression import line_through, require_positive
from fden_ros.experiments.result import Fit, Parameter, plain, positive, r_squared

#: Deviations of alpha and ln G about the first sample's values, before any sample counts.
_PRIOR_SD = (0.3, 3.0)
_LEAST_NOISE = 1e-7
#: A contradiction is reported beyond this many deviations.
_CONTRADICTION = 3.0
_NEGLIGIBLE_ORDER = 1e-3


def from_file(path: Path, options: Options) -> Fit:
    """Return the fit of a file of storage and loss moduli."""
    table = read_table(path)
    columns = [table.positive(n) for n in ("omega_rad_s", "storage_modulus_pa", "loss_modulus_pa")]
    table.require_rows(2, "a dynamic fit")
    return fit_complex_modulus(*columns)


def fit_complex_modulus(omega: Array, storage: Array, loss: Array) -> Fit:
    r"""Return alpha and G from storage and loss modulus (paper, Appendix C).

    An extended Kalman filter with the constant state (alpha, ln G) observes
    :math:`(\log G', \log G'')`, frequency after frequency. The paper starts it at zero, where the
    logarithm is infinite; it starts at what the first pair says by itself,
    :math:`\alpha = \tfrac{2}{\pi}\arctan(G''/G')` and :math:`G = |G^*|/\omega^\alpha`, with wide
    deviations. The noise is not known beforehand: a first run, equally sure of both moduli, gives
    the residuals, and a second takes the variance of each modulus from them.

    Beside it ``slope`` has the alpha of the slope of \|G*\|, ``phase`` that of the mean phase;
    some tissue has a larger phase than its slope says (Kobayashi et al., arXiv:1804.00979). Where
    they contradict each other, no single springpot describes the data: a warning says so.

    Parameters
    ----------
    omega : ndarray, shape (n,)
        Angular frequency [rad/s].
    storage, loss : ndarray, shape (n,)
        G' and G'' [Pa].
    """
    require_positive(omega=omega, storage_modulus=storage, loss_modulus=loss)
    order = np.argsort(omega, kind="stable")
    omega = omega[order]
    moduli = np.column_stack([storage, loss])[order]
    logs = np.log(moduli)
    noise = np.full(2, 0.05)
    # Twice, because the second run's residuals are what the noise is taken from.
    for _ in range(3):
        state, covariance = _filter(np.log(omega), logs, noise)
        residuals = logs - _predicted(state, np.log(omega))
        noise = np.sqrt(np.sum(residuals**2, axis=0) / max(omega.size - 1, 1)) + _LEAST_NOISE
    # Nearly all that is known of alpha comes from one of the two moduli, G''.
    dof = float(omega.size - 1)
    deviations = np.sqrt(np.diag(covariance)) if dof > 0 else np.full(2, math.nan)
    parameters = {
        "alpha": plain(state[0], deviations[0], dof),
        "g": positive(state[1], deviations[1], dof),
    }
    phase = alpha_by_phase(np.arctan2(moduli[:, 1], moduli[:, 0]))
    slope = line_through(np.log(omega), np.log(np.hypot(*moduli.T))).plain(1.0)
    return Fit(
        "dynamic",
        parameters,
        r_squared(logs, _predicted(state, np.log(omega))),
        omega.size,
        _contradiction(slope, phase),
        {"slope": {"alpha": slope}, "phase": {"alpha": phase}},
    )


def alpha_by_phase(angles: Array) -> Parameter:
    """Return the alpha that the loss angles [rad] say (n,)."""
    orders = 2.0 / math.pi * angles
    sd = orders.std(ddof=1) / math.sqrt(orders.size) if orders.size > 1 else math.nan
    return plain(float(orders.mean()), sd, orders.size - 1.0)


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
            values: Array = _predicted(state, np.array([position]))[0]
            return values

        ekf.update(observed, jacobian, expected)
        # One pair of moduli can throw alpha out of its range, where the model has no logarithm.
        ekf.x[0] = min(max(ekf.x[0], 1e-4), 1.0 - 1e-4)
    return np.array(ekf.x), np.array(ekf.P)


def _contradiction(slope: Parameter, phase: Parameter) -> tuple[str, ...]:
    """Return a warning if the alphas of slope and phase exclude each other."""
    difference, sd = abs(slope.value - phase.value), math.hypot(slope.sd, phase.sd)
    if not difference > max(_CONTRADICTION * sd, _NEGLIGIBLE_ORDER):
        return ()
    return (
        f"slope and phase contradict each other: alpha is {slope.value:.3f} by the slope, "
        f"{phase.value:.3f} by G''/G' ({difference / max(sd, 1e-12):.0f} deviations apart); one "
        "springpot does not describe both",
    )
