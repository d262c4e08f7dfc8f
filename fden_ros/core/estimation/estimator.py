# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The estimator of one site: samples in, estimates out.

Where nothing says whether a touch is of the same place as the one before, there are three records:
one continues at the same spot, one at another spot of the same tissue, and one begins. All take
the samples, and the evidence of these weighs them. What is published is their mixture, until one
has odds of 20 to 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.claims import Claims, claims_of, converged
from fden_ros.core.estimation.estimate import (
    Budget,
    Component,
    Estimate,
    LawError,
    ParameterSet,
    moments,
)
from fden_ros.core.estimation.estimator_config import Prior
from fden_ros.core.estimation.face import Estimator, Innovation, Setting, Touch
from fden_ros.core.estimation.grid import Grid
from fden_ros.core.estimation.place import PlacePosterior
from fden_ros.core.estimation.posterior import Posterior
from fden_ros.core.estimation.small_motion import SmallMotion

#: Odds at which a place is dropped at the end of a press, and within it [1].
_ODDS, _FAR = 20.0, 200.0
#: Between two grids the likelihood is that of the leading scales. So a hypothesis is weighed anew
#: where the logarithm of its odds has changed by the first, and, with the likeliest one, before it
#: is dropped, where there are more cells since its newest grid than the second.
_STALE, _FRESH = 2.0, 16
#: Least time after a round [s], and for each cell of its record: one takes 0.25 ms.
_ROUND_TIME, _CELL_TIME = 0.04, 6e-4
#: The log evidence of a grid that is not settled is low by less than this [1].
_LOW = 10.0
#: Deviations by which the order of the relaxation is another than is stated; its own are not less
#: than this [1].
_CONTRADICTION, _LEAST_ORDER_SD = 4.0, 0.01
#: Probability of a plateau from which on the law is contradicted [1].
_MISMATCH = 0.95


@dataclass(eq=False)
class _Hypothesis:
    """A place that may be the one that is touched."""

    place: PlacePosterior
    log_prior: float = 0.0  #: before the press that is open, or the last
    shift: float = 0.0  #: by which its indentations are larger than those that are given [1]
    base: float = 0.0  #: log evidence of its record before this counts
    anew: float = 0.0  #: by which that has changed as blocks were gathered anew
    held: float | None = None  #: its weight while not all are gathered to the same cells
    grid: Grid | None = None  #: the newest
    laid_odds: float = 0.0  #: logarithm of the odds to the best when that was laid

    @property
    def log_weight(self) -> float:
        """Of it by now, as a logarithm."""
        if self.held is not None:
            return self.held
        return self.log_prior + self.place.log_evidence - self.base - self.anew


@dataclass(frozen=True)
class _Part:
    """One hypothesis by now."""

    weight: float
    hypothesis: _Hypothesis
    posterior: Posterior
    mean: Array  #: of (ln G, ln Gn, alpha, contact point), (4,)
    covariance: Array
    claims: Claims
    beyond: float
    is_order_contradicted: bool


class GridEstimator(Estimator):
    """The estimator of one site: the posterior as one weighted sum over a grid."""

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        self._hypotheses = [_Hypothesis(PlacePosterior(self._setting))]
        self._touched_at, self._now, self._count = 0.0, 0.0, 0
        self._round_at = self._step = 0.0  #: of the last round, and from sample to sample [s]
        self._pause = _ROUND_TIME  #: least time to the next round [s]
        self._is_due = False  #: a block has come since nothing was to be laid
        self._were_resolved = False  #: the places, when their blocks began to wait
        self._newest = self._prior()  #: estimate
        self._ending: Iterator[None] | None = None  #: the last rounds of a press

    def may_continue(self, other: GridEstimator, shift: float, log_wider: float) -> None:
        """Let the next touch, the first, be perhaps of the place that another one was on.

        Parameters
        ----------
        shift : float
            By which the indentations of the other are larger [1].
        log_wider : float
            Logarithm of how much wider the contact point's prior is than where the touch showed
            the surface: that noise may hide it makes a new place no less likely.
        """
        self._now = other._now
        known = [one for one in other._hypotheses if one.place.filter is not None]
        if not known:
            return
        best = max(known, key=lambda one: one.log_weight)
        own_sd, base = self._setting.contact_point_sd, best.place.log_evidence
        same, elsewhere = best.place.continued(), best.place.continued(own_sd)
        self._hypotheses = [
            _Hypothesis(PlacePosterior(self._setting, best.place.noise_sd), log_wider),
            _Hypothesis(same, math.log(2.0), best.shift + shift, base),
            _Hypothesis(elsewhere, log_wider, base=base),
        ]

    def touch(self, onset: Touch, pause: float) -> None:
        """Begin a press, a time without stress [s] after the last sample."""
        self._now = self._touched_at = self._now + pause
        # Evidences compare where the records are of the same data.
        reach = max(one.place.reach + one.shift for one in self._hypotheses)
        for one in self._hypotheses:
            one.log_prior, one.base, one.anew = one.log_weight, one.place.log_evidence, 0.0
            approach = onset.approach + np.array([[0.0], [one.shift], [0.0]])
            own = onset._replace(approach=approach)
            one.place.touch(own, self._now, reach - one.shift if one.place.reach else 0.0)

    def add(
        self,
        times: Sequence[float],
        indentation: Sequence[float],
        stress: Sequence[float],
        on_tissue: Sequence[bool],
        *,
        is_behind: bool = False,
    ) -> Estimate:
        """Take samples of the press; see :meth:`~.estimation.Estimator.add`."""
        has_block = False
        for time, u, f, on in zip(times, indentation, stress, on_tissue, strict=True):
            if self._touched_at + time < self._now:
                continue  # the press before had it
            if not is_behind:
                self.work()
            self._step, self._now = self._touched_at + time - self._now, self._touched_at + time
            done = [
                one.place.add(self._now, u + one.shift, f, on_tissue=on)
                for one in self._hypotheses
            ]
            has_block |= any(done)
            self._is_due |= any(done)
        self._count += len(times)
        return self.estimate() if has_block else self._as_before()

    def work(self) -> None:
        """Lay what the blocks have made due, a round at a time; see :meth:`~.Estimator.work`.

        A sample of a slow sensor has the time of several.
        """
        if not self._is_due or self._now - self._round_at < self._pause:
            return
        for _ in range(max(math.ceil(self._step / self._pause), 1)):
            place = self._gather() or self._take_turn()
            self._is_due = place is not None
            if place is None:
                break
            self._round_at = self._now
            self._pause = max(_ROUND_TIME, _CELL_TIME * place.count)

    def _gather(self) -> PlacePosterior | None:
        """Gather and return one of the places whose blocks wait for that; None: there is none.

        Evidences are of the same cells: until all are gathered, the weights are as before.
        """
        waiting = [one for one in self._hypotheses if one.place.is_waiting]
        if not waiting:
            return None
        self._hold()
        waiting[0].place.gather()
        if len(waiting) == 1:
            self._compare(keeps_odds=self._were_resolved)
        return waiting[0].place

    def _hold(self) -> None:
        if self._best.held is None:
            places = [one.place for one in self._hypotheses]
            self._were_resolved = all(place.is_laid and place.is_resolved for place in places)
        for one in self._hypotheses:
            one.held = one.log_weight

    def _compare(self, *, keeps_odds: bool = False) -> None:
        """Weigh the places by their cells by now; `keeps_odds`: these are of the same data."""
        for one in self._hypotheses:
            held, one.held = one.log_weight, None
            one.anew = one.anew + one.log_weight - held if keeps_odds else 0.0
        self._note_odds()

    def _take_turn(self) -> PlacePosterior | None:
        """Lay a round of the place that has waited for longest; None: none is due."""
        self._note_odds()
        stale = self._drop()
        places = [one.place for one in self._hypotheses if one.place.is_due or one in stale]
        due = [place for place in places if not place.gate.is_beyond]
        if due:
            place = min(due, key=lambda place: place.laid_at)
            place.lay()
        else:
            place = self.best
            if not self._ask():
                return None
        self._note_odds()
        return place

    def _ask(self) -> bool:
        """Lay a round of another grid of the likeliest place; False: none is due.

        Another mode of the posterior is one hypothesis more, until its odds are too low.
        """
        best = self._best
        if not best.place.ask():
            return False
        known = [one.place.filter.grid for one in self._hypotheses if one.place.filter is not None]
        if (place := best.place.branched(known)) is not None:
            self._hypotheses.append(replace(best, place=place, grid=None))
        return True

    def _drop(self) -> list[_Hypothesis]:
        """Drop places that are far less likely; return those to be weighed anew before."""
        best, possible = self._best, self._possible(_FAR)
        unlikely = [one for one in self._hypotheses if one not in possible]
        stale = [
            one
            for one in self._hypotheses
            if abs(one.log_weight - best.log_weight - one.laid_odds) > _STALE
            or (unlikely and (one is best or one in unlikely) and one.place.behind > _FRESH)
        ]
        if best not in stale:
            # Of one that is not settled yet, rounds are to come.
            dropped = [
                one
                for one in unlikely
                if one not in stale and (one.place.is_resolved or not one.place.is_due)
            ]
            self._hypotheses = [one for one in self._hypotheses if one not in dropped]
        return stale

    def _note_odds(self) -> None:
        """Take note of the odds of places whose grid is new."""
        best = max(one.log_weight for one in self._hypotheses)
        for one in self._hypotheses:
            if (own := one.place.filter) is not None and own.grid is not one.grid:
                one.grid, one.laid_odds = own.grid, one.log_weight - best

    def settle(self) -> None:
        """End the press by one round more; see :meth:`~.estimation.Estimator.settle`."""
        self._ending = self._ending or self._last_rounds()
        next(self._ending, None)

    def _last_rounds(self) -> Iterator[None]:
        self.work()
        self._hold()
        for one in self._hypotheses:
            yield from one.place.release()
        self._compare()
        self._hypotheses = self._possible(_ODDS)
        yield from self.best.ask_rival()

    def release(self) -> Estimate:
        """End the press; return the estimate."""
        for _ in self._ending or self._last_rounds():
            pass
        self._ending = None
        parts = self._parts()
        return self._estimate(parts)._replace(components=_components(parts))

    def _possible(self, odds: float) -> list[_Hypothesis]:
        """Return the places that are not less likely than a settled one by these odds.

        One that is not settled may be likelier than it seems.
        """
        settled = [one.log_weight for one in self._hypotheses if one.place.is_resolved]
        least = max(settled, default=-math.inf) - math.log(odds)
        return [
            one
            for one in self._hypotheses
            if one.log_weight >= least - (0.0 if one.place.is_resolved else _LOW)
        ]

    # What else the pipeline needs

    @property
    def best(self) -> PlacePosterior:
        """The likeliest place."""
        return self._best.place

    @property
    def _best(self) -> _Hypothesis:
        return max(self._hypotheses, key=lambda one: one.log_weight)

    @property
    def innovation(self) -> Innovation | None:  # type: ignore[override]
        """Of the newest block; None: it was not predicted."""
        return self.best.innovation

    @property
    def is_doubtful(self) -> bool:
        """Whether the newest block is beyond the gate."""
        return self.best.gate.is_doubtful

    @property
    def rig_misfit(self) -> float:
        """How far a contact says the rig is from what is stated, in standard deviations [1]."""
        posterior = self.best.posterior()
        return posterior.rig_conflict if posterior is not None else 0.0

    def budget(self) -> Budget | None:
        """Return what makes the estimate uncertain; None: not known."""
        posterior = self.best.posterior()
        if posterior is None:
            return None
        variances = posterior.tissue[1].diagonal()
        whole = float(variances[0]), float(variances[1])
        noise_sd = self._setting.noise_sd
        return Budget(whole, posterior.shares(), noise_sd, math.sqrt(float(variances[3])))

    @property
    def is_changed(self) -> bool:
        """Whether the tissue under the probe has changed since the touch."""
        return all(one.place.gate.is_changed for one in self._hypotheses)

    @property
    def plateau_probability(self) -> float:
        """Probability that the relaxation has a plateau [1]; NaN: it was not asked for."""
        return self.best.plateau_probability

    @property
    def is_mismatch(self) -> bool:
        """Whether the data contradict the law: another describes them, or this one does not."""
        best = self.best.filter
        is_misfit = best is not None and best.grid.is_misfit
        return is_misfit or self.plateau_probability > _MISMATCH

    # The estimate

    def estimate(self) -> Estimate:
        """Return the present estimate."""
        return self._estimate(self._parts())

    def _estimate(self, parts: Sequence[_Part]) -> Estimate:
        found = self._mixed(parts) if parts else self._prior()
        self._newest = found._replace(sample_count=self._count)
        return self._newest

    def _as_before(self) -> Estimate:
        """Return the newest estimate, by now."""
        motions = tuple(replace(one, now=self._now) for one in self._newest.small_motions)
        return self._newest._replace(sample_count=self._count, small_motions=motions)

    def _parts(self) -> list[_Part]:
        known = [one for one in self._hypotheses if one.place.filter is not None]
        if not known:
            return []
        logs = np.array([one.log_weight for one in known])
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        likely = [k for k, weight in enumerate(weights) if weight > 1.0 / (1.0 + _ODDS)]
        total = float(weights[likely].sum())
        return [self._part(known[k], float(weights[k]) / total) for k in likely]

    def _part(self, one: _Hypothesis, weight: float) -> _Part:
        place, config = one.place, self._setting.config
        posterior = place.posterior()
        assert posterior is not None
        mean, covariance = posterior.tissue
        beyond = posterior.probability_beyond(place.deepest)
        mean = mean - np.array([0.0, 0.0, 0.0, one.shift])
        sds = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
        is_contradicted = _contradicts_order(config.prior, place.law_error(posterior))
        claims = claims_of(
            config, mean[:3], sds[:3], beyond,
            is_solved=place.is_settled and place.has_searched,
            is_order_contradicted=is_contradicted,
        )  # fmt: skip
        return _Part(weight, one, posterior, mean, covariance, claims, beyond, is_contradicted)

    def _prior(self) -> Estimate:
        config = self._setting.config
        covariance = np.diag(config.prior.deviations**2)
        covariance[:2, :2] += config.uncertainty.thickness_sd**2
        sds = np.sqrt(covariance.diagonal())
        claims = claims_of(config, config.prior.mean, sds, 0.0, is_solved=False)
        log_g, log_gn, order = config.prior.mean.tolist()
        return Estimate(
            log_g,
            log_gn,
            order,
            covariance=covariance,
            contact_point_sd=self._setting.contact_point_sd,
            observable=claims.observable,
            known=claims.known,
        )

    def _mixed(self, parts: Sequence[_Part]) -> Estimate:
        config = self._setting.config
        mean, covariance = moments([Component(p.weight, p.mean, p.covariance) for p in parts])
        sds = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
        observable = known = ParameterSet.ALL
        at_edge = ParameterSet.NONE
        for part in parts:
            observable &= part.claims.observable
            known &= part.claims.known
            at_edge |= part.claims.at_edge
        known &= converged(config, sds[:3], observable)
        is_settled = all(one.place.is_settled for one in self._possible(_ODDS))
        is_settled = is_settled and all(part.hypothesis.place.has_searched for part in parts)
        if not is_settled or self.is_changed:
            known = ParameterSet.NONE
        best = max(parts, key=lambda part: part.weight)
        grid = best.posterior.grid
        log_g, log_gn, order, contact_point = mean.tolist()
        with_point = covariance[3, :3].tolist()
        return Estimate(
            log_g,
            log_gn,
            order,
            covariance=covariance[:3, :3],
            contact_point=contact_point,
            contact_point_sd=float(sds[3]),
            probability_beyond_boundary=sum(p.weight * p.beyond for p in parts),
            observable=observable,
            known=known,
            at_edge=at_edge,
            model_discrepancy=sum(one.curve * part for one, part in grid.scales),
            mean_dwell_time=best.posterior.state.mean_dwell_time,
            law_error=best.hypothesis.place.law_error(best.posterior),
            is_order_contradicted=any(part.is_order_contradicted for part in parts),
            plateau_probability=self.plateau_probability,
            with_origin=(with_point[0], with_point[1], with_point[2]),
            small_motions=self._small_motions(parts),
            is_settled=is_settled,
        )

    def _small_motions(self, parts: Sequence[_Part]) -> tuple[SmallMotion, ...]:
        return tuple(
            SmallMotion(
                part.posterior,
                self._now,
                part.weight,
                part.hypothesis.shift,
                unseen=part.hypothesis.place.unseen**2,
            )
            for part in parts
        )


def _contradicts_order(prior: Prior, error: LawError | None) -> bool:
    """Whether the relaxation is that of another alpha than is stated."""
    if error is None:
        return False
    both = math.hypot(prior.fractional_order_sd, max(error.order_sd, _LEAST_ORDER_SD))
    return abs(error.order - prior.fractional_order) > _CONTRADICTION * both


def _components(parts: Sequence[_Part]) -> tuple[Component, ...]:
    """Return at most 6 Gaussians of (ln G, ln Gn, alpha)."""
    most = 4 if len(parts) == 1 else 2
    return tuple(
        component._replace(weight=part.weight * component.weight)
        for part in parts
        for component in part.posterior.components(most)
    )
