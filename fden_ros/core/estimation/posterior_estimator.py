# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The estimator of one site: record, solutions of its posterior, and the filter between them.

The order of events, for each block: the filter takes it; where the record has grown enough, the
posterior is solved anew and the filter goes on from there. After a press its posterior is the next
one's prior, and the stress of the press goes on to act as the free surface of the tissue.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.change import LOOK_PERIOD, SUSPICIOUS, change_of, placed
from fden_ros.core.estimation.claims import Evidence, claims_of, probability_beyond
from fden_ros.core.estimation.error_model import ErrorModel, Noise
from fden_ros.core.estimation.estimate import Estimate, LawError
from fden_ros.core.estimation.estimator import Block, Innovation
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.estimation.filter import PressFilter
from fden_ros.core.estimation.law_error import LawCurves, law_curves, law_error
from fden_ros.core.estimation.modes import Modes, find_modes, follow_modes
from fden_ros.core.estimation.motion_scale import SCALES
from fden_ros.core.estimation.press_model import FreeSurface, PressModel
from fden_ros.core.estimation.record import Points, Record, Sample, block_points
from fden_ros.core.estimation.rig_knowledge import RigKnowledge
from fden_ros.core.estimation.rival import mismatch_log_odds
from fden_ros.core.estimation.scales import Scales, carried_scales, scales_of
from fden_ros.core.estimation.solution import Belief, Posterior, Solution
from fden_ros.core.estimation.unknowns import (
    LOG_G,
    LOG_GN,
    ORDER,
    ORIGIN,
    Lifetime,
    Unknown,
    strain_range,
    unknowns_of,
)
from fden_ros.core.estimation.whiteness import contradicts
from fden_ros.core.law.characteristic import elastic_response
from fden_ros.core.law.geometry import Geometry
from fden_ros.core.law.relaxation import StressMoments
from fden_ros.core.streams.samples import PathNoise

#: The posterior is solved anew when the time since the touch, or the largest compression, has
#: grown by these factors [1], some 25 times a contact; between two the filter is off by half
#: a standard deviation.
_TIME_RATIO, _DEPTH_RATIO = 1.25, 1.12
#: Blocks before the first solution, and until which it is sought from all starts, each time that
#: their number has doubled [1].
_FIRST_SOLUTION, _LAST_STARTS = 4, 32
#: Starts of ln Gn, about the prior's mean in its standard deviations [1].
_STARTS = (-0.8, 0.8)
#: Standard deviation of the zero where it is not measured [N]: with 0 a preload puts ln Gn eight
#: standard deviations off.
_UNKNOWN_ZERO = 0.01
#: Probability of a relaxation that ends beyond which it is said [1].
_MISMATCH = 0.95
#: The relaxation contradicts a stated alpha beyond this many standard deviations of both [1]; that
#: of the relaxation's order counts as this at least [1].
_CONTRADICTION, _LEAST_ORDER_SD = 4.0, 0.01
#: Part of the variance of what is stated of a rig that a press tells at least [1].
_LEAST_TOLD = 0.01
#: What is known of a rig, by the names of its unknowns.
RIG = ("delay", "friction")
#: A change is placed anew once it was seen for this time [s], within this time [s].
_PLACED_AFTER, _PLACED_WITHIN = 0.1, 0.04
#: An innovation beyond this many standard deviations is not explained [1].
_SURPRISE = 5.0
#: Least factor by which the stiffness changes [1].
_LEAST_FACTOR = 0.05
_NOISELESS = PathNoise()


class _Press:
    """One press: its record, model and filter."""

    def __init__(self, start: float, zero_sd: float, drift_sd: float, noise_sd: float) -> None:
        self.start, self.zero_sd, self.drift_sd = start, zero_sd, drift_sd
        self.record = Record(noise_sd)
        self.free: FreeSurface | None = None
        self.samples: list[Sample] = []
        self.last = start
        self.is_pressed = False
        self.blocks = self.blocks_at_starts = 0
        self.modes: Modes | None = None
        self.posterior: Posterior | None = None
        self.filter: PressFilter | None = None
        self.solved_at = (0.0, 0.0)
        self.law_error: LawError | None = None
        self.changes: list[Unknown] = []
        self.is_placed = True
        self.is_lost = False  # the newest solution was not found
        self.is_contradicted = False  # by the residuals of the newest solution
        self.looked_at = -math.inf

    @property
    def solutions(self) -> tuple[Solution, ...]:
        """About the maxima of the posterior, best first."""
        return self.modes.solutions if self.modes is not None else ()

    @property
    def solution(self) -> Solution | None:
        """About the best maximum; None: not solved yet."""
        return self.modes.best if self.modes is not None else None


class PosteriorEstimator:
    """The estimator of one site.

    Parameters
    ----------
    config : EstimatorConfig
    geometry : Geometry
    noise_sd : float
        Standard deviation of the stress per sample [Pa].
    origin_sd : float
        Standard deviation of the strain origin [1]; 0: known.
    path_noise : PathNoise
        Of the compression [1].
    rig : RigKnowledge, optional
        What earlier contacts have told; without it what the configuration states.
    """

    def __init__(
        self,
        config: EstimatorConfig,
        geometry: Geometry,
        noise_sd: float,
        origin_sd: float = 0.0,
        path_noise: PathNoise = _NOISELESS,
        rig: RigKnowledge | None = None,
    ) -> None:
        self._known_rig = rig or RigKnowledge.stated(config)
        self._stated_config = config
        learned = self._known_rig.learned(config.uncertainty)
        self._config = replace(config, uncertainty=learned)
        self._geometry, self._origin_sd = geometry, origin_sd
        self._noise_sd, self._path_noise = noise_sd, path_noise
        self._time = 0.0
        self._step = 0.0
        self._press: _Press | None = None
        self._moments, self._moments_at = StressMoments(), 0.0
        self._stress_before = 0.0
        self._carried: tuple[tuple[Unknown, ...], float, Array, Array, bool] | None = None
        self._max_compression = 0.0
        self._sample_count = 0
        self._change_count = 0
        self._is_surprised = False
        self._mismatch_probability = 0.0

    # What others ask

    @property
    def is_mismatch(self) -> bool:
        """Whether the data contradict the law.

        A law that is said to be exact: the innovations; else a relaxation that ends is likelier.
        """
        if self._config.uncertainty.characteristic_sd == 0.0:
            press = self._press
            return press is not None and press.is_contradicted
        return self._mismatch_probability > _MISMATCH

    @property
    def is_doubtful(self) -> bool:
        """Whether the newest solution was not found, or the newest block is not explained."""
        press = self._press
        if press is None or press.solution is None:
            return False
        return self._is_surprised or press.is_lost or not press.solution.is_solved

    @property
    def change_count(self) -> int:
        """Changes of the tissue under the probe that were found."""
        return self._change_count

    @property
    def rig_misfit(self) -> float:
        """How far a contact says the rig is from what is stated, in standard deviations [1]."""
        press = self._press
        if press is None or press.solution is None or press.posterior is None:
            return 0.0
        belief, off = press.posterior.belief, 0.0
        for k, unknown in enumerate(press.posterior.model.unknowns):
            if unknown.lifetime is Lifetime.RIG:
                before = 1.0 / belief.precision[k, k]
                told = max(before - press.solution.covariance[k, k], _LEAST_TOLD * before)
                off = max(off, abs(press.solution.mean[k] - belief.mean[k]) / math.sqrt(told))
        return off

    def motion_evidence(self) -> list[float] | None:
        """Return the log evidence of the press for scales of the surface's stated motion.

        The law counts as exact, so that all it leaves out counts as motion.
        """
        press, stated = self._press, self._stated_config.uncertainty.surface_motion_sd
        if press is None or press.solution is None or press.posterior is None or not stated:
            return None
        if press.is_lost:
            return None
        now = self._config.uncertainty.surface_motion_sd
        grid = [Scales(0.0, 0.0, 0.0, scale * stated / now) for scale in SCALES]
        return press.posterior.evidence(press.record.points(), press.solution.maximum, grid)

    def rig(self) -> RigKnowledge | None:
        """Return what is known of the rig after the press; None where it tells nothing."""
        press = self._press
        if press is None or press.solution is None or press.posterior is None:
            return None
        names = [u.name for u in press.posterior.model.unknowns]
        mean, covariance = self._known_rig.scaled(self._stated_config.uncertainty)
        places = [(i, names.index(name)) for i, name in enumerate(RIG) if name in names]
        if not places:
            return None
        own, found = (list(each) for each in zip(*places, strict=True))
        mean[own] = press.solution.mean[found]
        covariance[np.ix_(own, own)] = press.solution.covariance[np.ix_(found, found)]
        return self._known_rig.taught(mean, covariance, self._stated_config)

    # Samples

    def begin_contact(self, bias_sd: float, drift_sd: float) -> None:
        """Start a press whose stress has a zero [Pa] and a drift [Pa/s] of its own."""
        self._carry()
        zero_sd = bias_sd or _UNKNOWN_ZERO * self._geometry.stress_per_force
        spread = self._path_noise.total
        noise_sd = math.sqrt(spread / self._step) if self._step else 0.0
        self._press = _Press(self._time, zero_sd, drift_sd, noise_sd)
        if self._carried is not None:
            self._moments.wait(self._time - self._moments_at)
            self._moments_at = self._time
            frozen = StressMoments()
            frozen.values = self._moments.values.copy()
            self._press.free = FreeSurface(frozen, self._time)

    def take(self, step: float, compression: float, stress: float, *, is_free: bool) -> None:
        """Take a sample of a contact, `step` seconds after the last.

        `is_free`: the tissue is not on the probe, as far as is known.
        """
        press = self._press
        assert press is not None
        self._time += step
        if step > 0.0 and not press.record.noise_sd:
            press.record.noise_sd = math.sqrt(self._path_noise.total / step)
        if step > 0.0:
            self._step = step
        press.is_pressed |= not is_free
        observed = not (is_free and press.is_pressed)
        sample = Sample(self._time, compression, stress)
        press.record.add(*sample, is_observed=observed)
        if observed:
            press.samples.append(sample)
            self._max_compression = max(self._max_compression, compression)

    def rest(self, duration: float) -> None:
        """Let time [s] pass between two contacts."""
        self._time += duration

    def _remember(self, stress: float) -> None:
        """Take the mean stress of a block into the tissue's memory."""
        step = self._time - self._moments_at
        if step > 0.0:
            self._moments.add(step, self._stress_before, stress)
            self._moments_at, self._stress_before = self._time, stress

    def skip(self) -> None:
        """Let the samples since the last block go by."""
        self._remember(0.0)
        if self._press is not None:
            self._press.samples.clear()

    def update(self, block: Block) -> Innovation:
        """Take one block; return how it compared with the prediction.

        Raises
        ------
        FloatingPointError
            If the block's response is beyond floating-point numbers.
        """
        press = self._press
        assert press is not None
        self._remember(block.stress)
        self._sample_count += block.size
        innovation = Innovation(0.0, block.stress, 0.0, max(self._noise_sd**2, 1e-300))
        if press.filter is not None and press.samples:
            innovation = self._filtered(press, press.filter, block.compression)
        press.samples.clear()
        press.blocks += 1
        off = innovation.normalized_squared > SUSPICIOUS**2
        self._is_surprised = innovation.normalized_squared > _SURPRISE**2
        is_time = self._time - press.looked_at > LOOK_PERIOD
        if press.filter is not None and off and is_time:
            self._solve(press, fully=self._finds_change(press))
        elif self._is_due(press):
            self._solve(press)
        return innovation

    def _filtered(self, press: _Press, own_filter: PressFilter, compression: float) -> Innovation:
        """Let the filter take the samples of a block."""
        points = block_points(press.samples, press.last)
        press.last = press.samples[-1].time
        try:
            found = own_filter.step(points)
            elastic = self._elastic(compression)
        except (FloatingPointError, OverflowError):
            # Too far from the last solution: the next one is due now.
            press.solved_at = 0.0, 1e-9
            stress = float(points.stresses[0])
            return Innovation(0.0, stress, 0.0, max(self._noise_sd**2, 1e-300))
        return Innovation(elastic, found.prediction, found.innovation, found.variance)

    def _finds_change(self, press: _Press) -> bool:
        """Whether the tissue has changed under the probe; then the change is an unknown more."""
        press.looked_at = self._time
        if press.solution is None or not press.is_placed:
            return False
        change = change_of(
            press.record.points(),
            press.solution,
            self._posterior(press),
            lambda unknown: self._posterior(press, (unknown,)),
        )
        if change is None:
            return False
        press.changes.append(change)
        press.is_placed = False
        self._change_count += 1
        return True

    def _elastic(self, compression: float) -> float:
        """Return phi at a compression by the newest estimate [Pa s^alpha]."""
        assert self._press is not None and self._press.filter is not None
        mean = self._press.filter.mean
        origin = mean[ORIGIN] * self._origin_sd
        strain = self._geometry.strain(compression - origin)
        return elastic_response(strain, math.exp(mean[LOG_G]), math.exp(mean[LOG_GN])).value

    # Solutions

    def _is_due(self, press: _Press) -> bool:
        if press.blocks < _FIRST_SOLUTION or press.record.is_full:
            return False
        elapsed, depth = press.solved_at
        return (
            self._time - press.start > _TIME_RATIO * elapsed
            or press.record.max_compression > _DEPTH_RATIO * depth > 0.0
        )

    def _place_again(self, press: _Press) -> None:
        """Place the newest change anew, once it has been seen for long enough."""
        since, solution = press.changes[-1].since, press.solution
        if press.is_placed or since is None or self._time - since < _PLACED_AFTER:
            return
        press.is_placed = True
        assert solution is not None
        points = press.record.points()
        state = self._grown(press, solution, self._posterior(press))
        *before, newest = press.changes

        def evidence_of(change: Unknown) -> float:
            press.changes = [*before, change]
            return self._posterior(press).tracked(points, state, solution).log_evidence

        press.changes = [*before, placed(newest, _PLACED_WITHIN, evidence_of)]

    def _solve(self, press: _Press, *, fully: bool = False) -> None:
        if press.changes and press.solution is not None:
            self._place_again(press)
        points = press.record.points()
        if points.stresses.size < _FIRST_SOLUTION:
            return
        posterior = self._posterior(press)
        tracked = [(self._grown(press, s, posterior), s) for s in press.solutions]
        is_early = 2 * press.blocks_at_starts <= press.blocks <= _LAST_STARTS
        try:
            press.modes = self._modes(
                press, points, posterior, tracked, fully=fully or is_early or not tracked
            )
        except (FloatingPointError, np.linalg.LinAlgError):
            if press.modes is None:
                raise
            press.is_lost = True
            return
        press.is_lost = False
        press.posterior = posterior
        best = press.modes.best
        press.filter = PressFilter(best, posterior.model, posterior.error_model)
        press.last = float(points.times[-1])
        press.is_contradicted = contradicts(best.residuals)
        press.solved_at = self._time - press.start, press.record.max_compression
        press.law_error = self._law_error(press)

    def _modes(
        self,
        press: _Press,
        points: Points,
        posterior: Posterior,
        tracked: list[tuple[Array, Solution]],
        *,
        fully: bool,
    ) -> Modes:
        """Return the modes; `fully`: from all starts, not only from the last ones."""
        strain = self._largest_strain(press)
        if not fully:
            try:
                return follow_modes(posterior, points, tracked, strain)
            except (FloatingPointError, OverflowError, np.linalg.LinAlgError):
                pass  # the record has grown beyond where the last solution has numbers
        press.blocks_at_starts = press.blocks
        starts = [state for state, _ in tracked] + self._starts(posterior, points)
        return find_modes(posterior, points, starts, _middle(posterior), strain)

    @staticmethod
    def _grown(press: _Press, solution: Solution, posterior: Posterior) -> Array:
        """Return the state of a solution for a posterior that may have more unknowns."""
        assert press.posterior is not None
        before, now = press.posterior.model, posterior.model
        known = len(before.unknowns)
        more = len(now.unknowns) - known
        state = np.insert(solution.maximum.state, [known] * more, 0.0)
        if before.last_knot != now.last_knot:
            state[now.characteristic] = 0.0
        return state

    def _largest_strain(self, press: _Press) -> float:
        """Return the largest strain of a site, from the newest origin [1]."""
        origin = 0.0
        if press.solution is not None:
            origin = self._origin_sd * float(press.solution.mean[ORIGIN])
        return self._geometry.strain(max(self._max_compression - origin, 0.0))

    def _posterior(
        self, press: _Press, more: tuple[Unknown, ...] = (), kind: type[PressModel] = PressModel
    ) -> Posterior:
        config, geometry = self._config, self._geometry
        unknowns = unknowns_of(config, geometry, self._origin_sd, press.drift_sd)
        unknowns += (*press.changes, *more)
        is_bent = config.uncertainty.characteristic_sd > 0.0
        largest = self._geometry.strain(max(self._max_compression + self._origin_sd, 0.0))
        model = kind(
            unknowns,
            geometry,
            is_bent=is_bent,
            last_knot=strain_range(largest),
            free=press.free,
        )
        noise = Noise(
            self._noise_sd,
            math.sqrt(self._path_noise.total / self._step) if self._step else 0.0,
            press.zero_sd,
        )
        error_model = ErrorModel(model, config.uncertainty, noise)
        mean, precision = np.zeros(model.size), np.zeros((model.size, model.size))
        mean[: len(unknowns)] = [u.mean for u in unknowns]
        for k, unknown in enumerate(unknowns):
            precision[k, k] = 1.0 / unknown.unit**2 if unknown.unit else 1.0
        names = [u.name for u in unknowns]
        places = [(i, names.index(name)) for i, name in enumerate(RIG) if name in names]
        if places:
            own, found = (list(each) for each in zip(*places, strict=True))
            rig_mean, rig_covariance = self._known_rig.scaled(self._stated_config.uncertainty)
            mean[found] = rig_mean[own]
            precision[np.ix_(found, found)] = np.linalg.inv(rig_covariance[np.ix_(own, own)])
        grid, belief, has_fields = scales_of(config.uncertainty), Belief(mean, precision), is_bent
        if self._carried is not None:
            belief, has_fields = _taken_over(self._carried, model, mean, precision)
            if not has_fields:
                grid = carried_scales(config.uncertainty)
        order_sd = config.prior.fractional_order_sd if config.fractional_order_given else 0.0
        return Posterior(
            model, error_model, belief, grid, has_field_prior=has_fields, order_sd=order_sd
        )

    def _starts(self, posterior: Posterior, points: Points) -> list[Array]:
        found = []
        sd = posterior.model.unknowns[LOG_GN].sd
        places = _STARTS if self._carried is None and sd > 0.0 else (0.0,)
        for place in places:
            start = posterior.belief.mean.copy()
            start[LOG_GN] += place * sd
            if self._carried is None:
                highest = float(posterior.model.stress(points, start).max())
                if highest > 0.0:
                    start[LOG_G] += math.log(max(points.stresses.max(), 1e-9) / highest)
            found.append(start)
        return found

    def finish(self) -> None:
        """Solve anew at the end of a contact, from all starts."""
        press = self._press
        if press is not None and press.blocks >= _FIRST_SOLUTION:
            self._solve(press, fully=True)
            self._compare(press)

    def _compare(self, press: _Press) -> None:
        """Weigh the law against a relaxation that ends."""
        solution, posterior = press.solution, press.posterior
        if solution is None or posterior is None or not posterior.model.is_bent:
            return
        if self._carried is not None or self._config.is_order_given:
            return
        odds = mismatch_log_odds(
            press.record.points(),
            solution,
            posterior,
            lambda kind: self._posterior(press, kind=kind),
        )
        self._mismatch_probability = 1.0 / (1.0 + math.exp(min(-odds, 700.0)))

    def _carry(self) -> None:
        """Make the posterior of the press the prior of the next."""
        press, self._press = self._press, None
        if press is None or press.solution is None or press.posterior is None:
            return
        assert press.modes is not None
        model = press.posterior.model
        self._carried = (
            model.unknowns,
            model.last_knot,
            *press.modes.mixed(press.solution.mean, press.solution.covariance),
            model.is_bent,
        )

    # Result

    def estimate(self) -> Estimate:
        """Return the present estimate."""
        press = self._press
        if press is None or press.filter is None or press.posterior is None:
            return self._prior_estimate()
        solution = press.solution
        assert press.modes is not None and solution is not None
        mean, full = press.modes.mixed(press.filter.mean, press.filter.covariance)
        mean, full = _after_changes(press.posterior.model, mean, full)
        covariance = full[:3, :3].copy()
        covariance[:2, :2] += self._config.uncertainty.thickness_sd**2
        covariance = 0.5 * (covariance + covariance.T)
        if press.is_contradicted and not press.posterior.model.is_bent:
            # Parameters of a law that the data contradict are known no better than before.
            covariance = np.diag(
                np.maximum(covariance.diagonal(), self._config.prior.deviations**2)
            )
        origin_sd = self._origin_sd * math.sqrt(max(float(full[ORIGIN, ORIGIN]), 0.0))
        origin = self._origin_sd * float(mean[ORIGIN])
        compression = max(self._max_compression - origin, 0.0)
        strain = self._geometry.strain(compression)
        strain_sd = self._geometry.strain_slope(compression) * origin_sd
        deviations = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
        beyond = probability_beyond(strain, strain_sd, float(mean[LOG_GN]), float(deviations[1]))
        error = press.law_error
        is_contradicted = _is_contradicted(self._config, error)
        evidence = Evidence(
            mean[:3],
            deviations,
            beyond,
            solution.is_solved and not press.is_lost,
            origin_sd * math.exp(mean[LOG_GN]),
            is_contradicted,
        )
        claims = claims_of(self._config, evidence)
        return Estimate(
            log_linear_stiffness=float(mean[LOG_G]),
            log_nonlinear_stiffness=float(mean[LOG_GN]),
            fractional_order=float(mean[ORDER]),
            covariance=covariance,
            strain_origin=origin,
            strain_origin_sd=origin_sd,
            probability_beyond_boundary=beyond,
            valid=claims.valid,
            known=claims.known,
            sample_count=self._sample_count,
            model_error=sum(s.characteristic * p for s, p in solution.scales.items()),
            loading_age=press.filter.loading_age,
            law_error=error,
            at_edge=claims.at_edge,
            is_order_contradicted=is_contradicted,
        )

    def law_curves(self) -> LawCurves | None:
        """Return how the press bends the law, at its end; None: the law is said to be exact."""
        press = self._press
        seen = self._seen(press) if press is not None else None
        if press is None or press.solution is None or press.posterior is None or seen is None:
            return None
        return law_curves(press.solution, press.posterior.model, seen)

    def _law_error(self, press: _Press) -> LawError | None:
        seen = self._seen(press)
        if press.solution is None or press.posterior is None or seen is None:
            return None
        return law_error(press.solution, press.posterior.model, seen)

    def _seen(self, press: _Press) -> tuple[float, float] | None:
        """Return the time since the touch [s] and the largest strain [1]; None: nothing."""
        if press.posterior is None or not press.posterior.model.is_bent:
            return None
        strain, elapsed = self._largest_strain(press), self._time - press.start
        return (elapsed, strain) if strain > 0.0 and elapsed > 0.0 else None

    def _prior_estimate(self) -> Estimate:
        prior = self._config.prior
        mean, variances = prior.mean, prior.deviations**2
        origin = 0.0
        if self._carried is not None:
            mean, covariance = self._carried[2][:3], self._carried[3][:3, :3].copy()
            origin = self._origin_sd * float(self._carried[2][ORIGIN])
        else:
            covariance = np.diag(variances)
        covariance[:2, :2] += self._config.uncertainty.thickness_sd**2
        deviations = np.sqrt(covariance.diagonal())
        claims = claims_of(self._config, Evidence(mean, deviations, 0.0, False, 0.0))
        return Estimate(
            log_linear_stiffness=float(mean[0]),
            log_nonlinear_stiffness=float(mean[1]),
            fractional_order=float(mean[2]),
            covariance=covariance,
            strain_origin=origin,
            strain_origin_sd=self._origin_sd,
            probability_beyond_boundary=0.0,
            valid=claims.valid,
            known=claims.known,
            sample_count=self._sample_count,
        )


def _is_contradicted(config: EstimatorConfig, error: LawError | None) -> bool:
    """Whether the relaxation is that of another alpha than is stated."""
    if error is None:
        return False
    prior = config.prior
    both = math.hypot(prior.fractional_order_sd, max(error.order_sd, _LEAST_ORDER_SD))
    return abs(error.order - prior.fractional_order) > _CONTRADICTION * both


def _after_changes(model: PressModel, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the moments with ln G of the tissue that is under the probe now."""
    places = [k for k, unknown in enumerate(model.unknowns) if unknown.since is not None]
    if not places:
        return mean, covariance
    factor = max(1.0 + float(mean[places].sum()), _LEAST_FACTOR)
    jacobian = np.eye(mean.size)
    jacobian[LOG_G, places] = 1.0 / factor
    after = mean.copy()
    after[LOG_G] += math.log(factor)
    return after, jacobian @ covariance @ jacobian.T


def _middle(posterior: Posterior) -> Scales:
    """Return the scales to begin with: rough, and of a moderate error."""
    ranked = sorted(posterior.grid, key=lambda g: (g.scales.roughness, g.log_prior))
    return ranked[-1].scales if len(ranked) < 3 else _nearest(posterior)


def _nearest(posterior: Posterior) -> Scales:
    def off(scales: Scales) -> float:
        wanted = (0.1, 0.1, 0.06, 1.0)
        found = zip(scales, wanted, strict=True)
        return sum(abs(math.log((a + 1e-4) / (b + 1e-4))) for a, b in found)

    return min((g.scales for g in posterior.grid), key=off)


def _taken_over(
    carried: tuple[tuple[Unknown, ...], float, Array, Array, bool],
    model: PressModel,
    mean: Array,
    precision: Array,
) -> tuple[Belief, bool]:
    """Return the belief after an earlier press; and whether the law's errors are open anew."""
    unknowns, last_knot, old_mean, old_covariance, _ = carried
    names = [u.name for u in unknowns if u.lifetime is not Lifetime.CONTACT]
    places = [[u.name for u in model.unknowns].index(name) for name in names]
    sources = [[u.name for u in unknowns].index(name) for name in names]
    has_fields = model.is_bent and last_knot == model.last_knot
    if has_fields:
        before = len(unknowns)
        places += list(range(len(model.unknowns), model.size))
        sources += list(range(before, old_mean.size))
    elif model.is_bent:
        places += list(range(model.kernel.start, model.kernel.stop))
        sources += list(
            range(len(unknowns), len(unknowns) + model.kernel.stop - model.kernel.start)
        )
    belief_mean, belief_precision = mean.copy(), precision.copy()
    belief_mean[places] = old_mean[sources]
    covariance = old_covariance[np.ix_(sources, sources)]
    scale = np.sqrt(covariance.diagonal())
    scale[scale == 0.0] = 1.0
    inverse = np.linalg.inv(covariance / np.outer(scale, scale) + 1e-9 * np.eye(scale.size))
    belief_precision[np.ix_(places, places)] = inverse / np.outer(scale, scale)
    return Belief(belief_mean, belief_precision), model.is_bent and not has_fields
