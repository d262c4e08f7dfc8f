# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the posterior of a press says: the estimate, and what may be claimed of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fden_ros.core.estimation.claims import Claims, Evidence, claims_of, converged
from fden_ros.core.estimation.claims import probability_beyond as beyond_boundary
from fden_ros.core.estimation.estimate import Estimate, LawError, ParameterSet
from fden_ros.core.estimation.hypothesis import (
    LEAST_WEIGHT,
    Hypothesis,
)
from fden_ros.core.estimation.mixture import Component, moments, positive
from fden_ros.core.estimation.press_posterior import PressPosterior
from fden_ros.core.estimation.press_setting import PressSetting
from fden_ros.core.estimation.small_motion import SmallMotion
from fden_ros.core.estimation.unknowns import LAW, LOG_G, LOG_GN, ORDER
from fden_ros.core.law import MAX_EXPONENT

#: Place of the strain origin behind the law's parameters.
_ORIGIN = len(LAW)
#: The relaxation contradicts a stated alpha beyond this many standard deviations of both [1]; that
#: of the relaxation's order counts as this at least [1].
_CONTRADICTION, _LEAST_ORDER_SD = 4.0, 0.01
#: Standard deviation of ln N/m for a relaxation that has not been seen, over the stated
#: discrepancy of the law [1]: on a ramp only the curve is. Of tissue of eleven other laws 90 % of
#: the intervals hold on a ramp with it, and 82 % without.
_UNSEEN = 0.5


def estimate_of(press: PressPosterior, mismatch_probability: float) -> Estimate | None:
    """Return the estimate of a press: the moments of its mixture; None: it has told nothing yet.

    Parameters
    ----------
    press : PressPosterior
    mismatch_probability : float
        Of a plateau [1]; NaN: not known.
    """
    weighed = press.weighed
    if not weighed:
        return None
    tissues = [one.tissue_now for _, one in weighed]
    parts = [
        (weight, one, [_of_law(component, one) for component in tissue])
        for (weight, one), tissue in zip(weighed, tissues, strict=True)
    ]
    whole = [c._replace(weight=weight * c.weight) for weight, _, own in parts for c in own]
    mean, covariance = moments(whole)
    if not np.all(np.abs(mean) < MAX_EXPONENT):
        # The filter is where no number is; the next solution is due.
        return None
    best, config = press.best, press.setting.config
    solved, likeliest = best.solved, best.filter
    assert solved is not None and likeliest is not None
    # The filter may have been far from where it is linear.
    covariance = positive(covariance)
    is_contradicted = solved.is_contradicted and not press.setting.is_bent
    if is_contradicted:
        # Parameters of a law that the data contradict are known no better than before.
        widest = config.prior.deviations**2
        least = np.maximum(covariance.diagonal()[:_ORIGIN], widest)
        covariance[:_ORIGIN] = covariance[:, :_ORIGIN] = 0.0
        covariance[:_ORIGIN, :_ORIGIN] = np.diag(least)
    beyond = sum(c.weight * _beyond(press, one, c) for _, one, own in parts for c in own)
    likely = [(one, own) for weight, one, own in parts if weight >= LEAST_WEIGHT]
    claims = [_claims(press, one, own) for one, own in likely]
    valid, known, at_edge = (_common(part) for part in zip(*claims, strict=True))
    deviations = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    seen = press.shows_relaxation or press.setting.carried is not None
    unseen = 0.0 if seen else (_UNSEEN * config.uncertainty.characteristic_sd) ** 2
    motions = tuple(
        replace(_small_motion(press, one, tissue), weight=weight, unseen=unseen)
        for (weight, one), tissue in zip(weighed, tissues, strict=True)
    )
    return Estimate(
        log_linear_stiffness=float(mean[LOG_G]),
        log_nonlinear_stiffness=float(mean[LOG_GN]),
        # The filter knows no bound.
        fractional_order=max(float(mean[ORDER]), 0.0),
        covariance=covariance[:_ORIGIN, :_ORIGIN],
        contact_point=float(mean[_ORIGIN]),
        contact_point_sd=float(deviations[_ORIGIN]),
        probability_beyond_boundary=beyond,
        observable=valid,
        known=known & converged(config, deviations[:_ORIGIN], valid),
        model_discrepancy=sum(s.characteristic * p for s, p in solved.best.scales.items()),
        mean_dwell_time=likeliest.mean_dwell_time,
        law_error=solved.law_error,
        plateau_probability=mismatch_probability,
        at_edge=at_edge,
        is_order_contradicted=any(_contradicts_order(one) for one, _ in likely),
        with_origin=tuple(covariance[_ORIGIN, :_ORIGIN].tolist()),
        components=tuple(
            # Copies: a view would keep the whole matrix with every state that is kept.
            Component(c.weight, c.mean[:_ORIGIN].copy(), c.covariance[:_ORIGIN, :_ORIGIN].copy())
            for c in (whole if not is_contradicted else ())
        ),
        small_motions=motions,
    )


def _small_motion(
    press: PressPosterior, one: Hypothesis, tissue: tuple[Component, ...]
) -> SmallMotion:
    """Return what a hypothesis makes of a small motion; `tissue`: its components now."""
    assert one.solved is not None
    by_origin, shift = one.setting.by_origin(one.solved.model.size), one.past.shift
    solved = one.tissue_when_solved if press.is_deeper else ()
    return SmallMotion(one.solved.model, tissue, by_origin, shift=shift, solved=solved)


def _of_law(component: Component, one: Hypothesis) -> Component:
    """Return a component of (ln G, ln Gn, alpha, origin), with what the thickness adds.

    The origin is in the compressions that are given [1].
    """
    weight, state, whole = component
    by_origin = one.setting.by_origin(state.size)
    with_origin = whole @ by_origin
    mean, covariance = np.empty(_ORIGIN + 1), np.empty((_ORIGIN + 1, _ORIGIN + 1))
    mean[:_ORIGIN], mean[_ORIGIN] = state[:_ORIGIN], by_origin @ state - one.past.shift
    covariance[:_ORIGIN, :_ORIGIN] = whole[:_ORIGIN, :_ORIGIN]
    covariance[_ORIGIN, :_ORIGIN] = covariance[:_ORIGIN, _ORIGIN] = with_origin[:_ORIGIN]
    covariance[_ORIGIN, _ORIGIN] = by_origin @ with_origin
    covariance[:2, :2] += one.setting.config.uncertainty.thickness_sd**2
    return Component(weight, mean, covariance)


def _claims(press: PressPosterior, one: Hypothesis, own: list[Component]) -> Claims:
    """Return what may be said by one hypothesis alone."""
    assert one.solved is not None
    mean, covariance = moments(own)
    evidence = Evidence(
        mean[:_ORIGIN],
        np.sqrt(np.maximum(covariance.diagonal()[:_ORIGIN], 0.0)),
        sum(c.weight * _beyond(press, one, c) for c in own),
        one.is_solved,
        _contradicts_order(one),
        one.solved.best.beyond_bound,
    )
    return claims_of(one.setting.config, evidence)


def _common(sets: tuple[ParameterSet, ...]) -> ParameterSet:
    found = ParameterSet.ALL
    for one in sets:
        found &= one
    return found


def prior_estimate(setting: PressSetting, shift: float = 0.0) -> Estimate:
    """Return what is known before a press; `shift`: of its compressions, from those given [1]."""
    config, carried = setting.config, setting.carried
    mean, covariance, origin = config.prior.mean, np.diag(config.prior.deviations**2), 0.0
    motions: tuple[SmallMotion, ...] = ()
    if carried is not None and carried.is_sound:
        state, whole = carried.moments
        mean, covariance = state[:_ORIGIN], whole[:_ORIGIN, :_ORIGIN].copy()
        by_origin = setting.by_origin(state.size)
        motions = (SmallMotion(carried.model, carried.components, by_origin, shift=shift),)
        origin = setting.origin(state) - shift
    covariance[:2, :2] += setting.config.uncertainty.thickness_sd**2
    covariance = positive(covariance)
    deviations = np.sqrt(covariance.diagonal())
    claims = claims_of(config, Evidence(mean, deviations, 0.0, False))
    return Estimate(
        log_linear_stiffness=float(mean[LOG_G]),
        log_nonlinear_stiffness=float(mean[LOG_GN]),
        fractional_order=float(mean[ORDER]),
        covariance=covariance,
        contact_point=origin,
        contact_point_sd=setting.origin_sd,
        observable=claims.observable,
        known=claims.known,
        small_motions=motions,
    )


def _beyond(press: PressPosterior, one: Hypothesis, component: Component) -> float:
    """Return P(largest strain > 1/Gn) of a component of (ln G, ln Gn, alpha, origin) [1]."""
    geometry = one.setting.geometry
    mean, deviations = component.mean, np.sqrt(np.maximum(component.covariance.diagonal(), 0.0))
    deepest = one.deepest(press.intake.deepest) - one.past.shift
    compression = max(deepest - float(mean[_ORIGIN]), 0.0)
    strain = geometry.strain(compression)
    strain_sd = geometry.strain_slope(compression) * float(deviations[_ORIGIN])
    return beyond_boundary(strain, strain_sd, float(mean[LOG_GN]), float(deviations[LOG_GN]))


def _contradicts_order(one: Hypothesis) -> bool:
    """Whether the relaxation is that of another alpha than is stated."""
    error: LawError | None = one.solved.law_error if one.solved is not None else None
    if error is None:
        return False
    prior = one.setting.config.prior
    both = math.hypot(prior.fractional_order_sd, max(error.order_sd, _LEAST_ORDER_SD))
    return abs(error.order - prior.fractional_order) > _CONTRADICTION * both
