# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the posterior of a press says: the estimate, and what may be claimed of it."""

from __future__ import annotations

import math

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.claims import Evidence, claims_of, probability_beyond
from fden_ros.core.estimation.estimate import Estimate, LawError, Member, mixture, positive
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.press_model import PressModel
from fden_ros.core.estimation.press_posterior import PressPosterior
from fden_ros.core.estimation.press_setting import PressSetting
from fden_ros.core.estimation.small_motion import SmallMotion
from fden_ros.core.estimation.unknowns import LOG_G, LOG_GN, ORDER
from fden_ros.core.law.characteristic import MAX_EXPONENT

#: The relaxation contradicts a stated alpha beyond this many standard deviations of both [1]; that
#: of the relaxation's order counts as this at least [1].
_CONTRADICTION, _LEAST_ORDER_SD = 4.0, 0.01
#: Least factor by which the stiffness changes [1].
_LEAST_FACTOR = 0.05


def estimate_of(press: PressPosterior, mismatch_probability: float) -> Estimate | None:
    """Return the estimate of a press; None: it has told nothing yet.

    Parameters
    ----------
    press : PressPosterior
    mismatch_probability : float
        Of a relaxation that ends [1]; NaN: not known.
    """
    if press.solved is None or press.filter is None:
        return None
    solved, setting = press.solved, press.setting
    config = setting.config
    modes = _after_changes(
        solved.model, solved.modes.members(press.filter.mean, press.filter.covariance)
    )
    mean, full = mixture(modes)
    if not np.all(np.abs(mean) < MAX_EXPONENT):
        # The filter is where no number is; the next solution is due.
        return None
    covariance = _published(setting, full)
    if solved.is_contradicted and not setting.is_bent:
        # Parameters of a law that the data contradict are known no better than before.
        widest = config.prior.deviations**2
        covariance = np.diag(np.maximum(covariance.diagonal(), widest))
    deviations = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    origin_sd = setting.origin_deviation(full)
    beyond = _probability_beyond(press, mean, origin_sd, float(deviations[LOG_GN]))
    is_contradicted = _is_order_contradicted(config, solved.law_error)
    evidence = Evidence(
        mean[:3],
        deviations,
        beyond,
        solved.best.is_solved and not press.is_lost,
        is_contradicted,
        solved.best.beyond_bound,
    )
    claims = claims_of(config, evidence)
    return Estimate(
        log_linear_stiffness=float(mean[LOG_G]),
        log_nonlinear_stiffness=float(mean[LOG_GN]),
        # The filter knows no bound.
        fractional_order=max(float(mean[ORDER]), 0.0),
        covariance=covariance,
        strain_origin=setting.origin(mean),
        strain_origin_sd=origin_sd,
        probability_beyond_boundary=beyond,
        valid=claims.valid,
        known=claims.known,
        model_error=sum(s.characteristic * p for s, p in solved.best.scales.items()),
        loading_age=press.filter.loading_age,
        law_error=solved.law_error,
        mismatch_probability=mismatch_probability,
        at_edge=claims.at_edge,
        is_order_contradicted=is_contradicted,
        with_origin=tuple(setting.origin_covariance(full)[:3].tolist()),
        # Copies: a view would keep the whole matrix with every state that is kept.
        modes=tuple(
            Member(m.weight, m.mean[:3].copy(), m.covariance[:3, :3].copy()) for m in modes
        ),
        small_motions=(SmallMotion(solved.model, tuple(modes), setting.by_origin(mean.size)),),
        delay=setting.delay(mean, full) if setting.is_late else None,
    )


def prior_estimate(setting: PressSetting) -> Estimate:
    """Return what is known before a press."""
    config, carried = setting.config, setting.carried
    mean, full, origin = config.prior.mean, np.diag(config.prior.deviations**2), 0.0
    motions: tuple[SmallMotion, ...] = ()
    if carried is not None and carried.is_sound:
        mean, full = carried.mean[:3], carried.covariance
        whole = Member(1.0, carried.mean, carried.covariance)
        motions = (SmallMotion(carried.model, (whole,), setting.by_origin(whole.mean.size)),)
        origin = setting.origin(carried.mean)
    covariance = _published(setting, full)
    deviations = np.sqrt(covariance.diagonal())
    claims = claims_of(config, Evidence(mean, deviations, 0.0, False))
    return Estimate(
        log_linear_stiffness=float(mean[LOG_G]),
        log_nonlinear_stiffness=float(mean[LOG_GN]),
        fractional_order=float(mean[ORDER]),
        covariance=covariance,
        strain_origin=origin,
        strain_origin_sd=setting.origin_sd,
        valid=claims.valid,
        known=claims.known,
        small_motions=motions,
    )


def _published(setting: PressSetting, full: Array) -> Array:
    """Return the covariance of (ln G, ln Gn, alpha), with that of the thickness."""
    covariance = full[:3, :3].copy()
    covariance[:2, :2] += setting.config.uncertainty.thickness_sd**2
    # The filter may have been far from where it is linear.
    return positive(covariance)


def _probability_beyond(
    press: PressPosterior, mean: Array, origin_sd: float, log_gn_sd: float
) -> float:
    """Return P(largest strain > 1/Gn) [1]."""
    geometry = press.setting.geometry
    compression = max(press.deepest - press.setting.origin(mean), 0.0)
    strain_sd = geometry.strain_slope(compression) * origin_sd
    strain = geometry.strain(compression)
    return probability_beyond(strain, strain_sd, float(mean[LOG_GN]), log_gn_sd)


def _is_order_contradicted(config: EstimatorConfig, error: LawError | None) -> bool:
    """Whether the relaxation is that of another alpha than is stated."""
    if error is None:
        return False
    prior = config.prior
    both = math.hypot(prior.fractional_order_sd, max(error.order_sd, _LEAST_ORDER_SD))
    return abs(error.order - prior.fractional_order) > _CONTRADICTION * both


def _after_changes(model: PressModel, modes: list[Member]) -> list[Member]:
    """Return the modes with ln G of the tissue that is under the probe now."""
    places = [k for k, unknown in enumerate(model.unknowns) if unknown.since is not None]
    if not places:
        return modes
    found = []
    for mode in modes:
        factor = max(1.0 + float(mode.mean[places].sum()), _LEAST_FACTOR)
        jacobian = np.eye(mode.mean.size)
        jacobian[LOG_G, places] = 1.0 / factor
        after = mode.mean.copy()
        after[LOG_G] += math.log(factor)
        found.append(Member(mode.weight, after, jacobian @ mode.covariance @ jacobian.T))
    return found
