"""The whole chain from samples to classified tissue, the same for live, replay and batch.

Samples of force and displacement go in, each stream in its own order; :class:`TissueState`,
:class:`Classification`, :class:`ContactSummary` and, where the probe oscillates,
:class:`DynamicModulus` come out through a callback. Time is taken from the stamps alone.
"""

from __future__ import annotations

import math
import traceback
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import digamma

from fden_ros.core.classification.classifier import (
    UNKNOWN,
    ClassProbabilities,
    Likelihood,
    TissueLibrary,
    classify,
    likelihood_of_estimate,
    mean_of,
)
from fden_ros.core.classification.decision import Decider, DecisionConfig
from fden_ros.core.classification.relative import (
    Comparison,
    LogStiffness,
    RelativeConfig,
    compare,
    log_stiffness,
    stack,
    without_prior,
)
from fden_ros.core.contact.detector import ContactConfig, ContactDetector, Onset, Release
from fden_ros.core.estimation.complex_modulus import ComplexModulusMeter
from fden_ros.core.estimation.estimate import (
    Block,
    Estimate,
    Estimator,
    EstimatorConfig,
    Innovation,
    Observation,
)
from fden_ros.core.estimation.fractional_stress_estimator import FractionalStressEstimator
from fden_ros.core.estimation.stress_estimator import StressEstimator
from fden_ros.core.law.characteristic import apparent_stiffness_factor, elastic_response
from fden_ros.core.law.fractional_integral import SHORTEST_STEP, FractionalIntegral
from fden_ros.core.law.geometry import FlatPunch, Geometry
from fden_ros.core.law.stress_response import order_interpolation, order_nodes
from fden_ros.core.outputs import (
    ApparentStiffness,
    Classification,
    ContactSummary,
    Decided,
    Decision,
    DynamicModulus,
    Failure,
    Flag,
    OrderSource,
    Output,
    Phase,
    Signals,
    Status,
    TissueState,
)
from fden_ros.core.streams.samples import NANOSECONDS, Pair, Position, Reason
from fden_ros.core.streams.synchronize import SynchronizeConfig, Synchronizer

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PipelineConfig:
    """Everything the pipeline can be told; times in seconds, SI units throughout.

    Parameters
    ----------
    library : TissueLibrary or None
        Tissues to classify into; None: nothing is classified.
    geometry : Geometry
        From force and displacement to stress and strain.
    synchronize, contact, estimator
        Configuration of those steps.
    strain_origin : float or None
        Displacement at which the tissue is free of load [m]; None: found from the force.
    block_duration : float
        One estimate per this time [s].
    block_compression : float
        A block is cut short when the compression changes by more than this [1].
    apparent_stiffness_time_scale : float
        tau of the apparent stiffness [s].
    decision : DecisionConfig
        When a tissue is named.
    relative : RelativeConfig or None
        Compare each site with those around it that were touched before, not with the library.
    dither_frequencies : tuple of float
        Frequencies of the probe's oscillation [Hz], different; empty: there is none.
    dither_periods : int
        One complex modulus per so many periods of the lowest frequency.
    """

    library: TissueLibrary | None
    geometry: Geometry = field(default_factory=lambda: FlatPunch(area=1e-4, thickness=0.02))
    synchronize: SynchronizeConfig = field(default_factory=SynchronizeConfig)
    contact: ContactConfig = field(default_factory=ContactConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    strain_origin: float | None = None
    block_duration: float = 0.01
    block_compression: float = 0.005
    apparent_stiffness_time_scale: float = 0.1
    decision: DecisionConfig = field(default_factory=DecisionConfig)
    relative: RelativeConfig | None = None
    dither_frequencies: tuple[float, ...] = ()
    dither_periods: int = 4


#: A hold is a compression that changes by less than this per second [1/s].
_HOLDING_RATE = 0.005
_RATE_BLOCKS = 10
#: A block is complete within this share of its duration, so that jitter does not add a sample.
_BLOCK_SHARE = 0.95
#: A step this many times the usual one, and this long [s], is reported as a gap.
_GAP_STEPS = 10.0
_GAP_TIME = 0.02
_CLASSIFY_EVERY = 10
#: A first contact whose force stays below this many release thresholds makes no site.
_FAINT = 4.0
_PROBABILITY_CHANGE = 0.01
#: alpha is learned when its standard deviation is below this share of its prior's.
_LEARNED_SHARE = 0.5
#: Half the distance between the orders whose difference is df'/dalpha.
_ORDER_STEP = 0.005
#: The orders of the integral before the nodes: alpha itself and the two for the derivative.
_EXACT_ORDERS = 3
#: Samples from before the touch was detected are made up for within about so long [s].
_CATCH_UP_TIME = 0.03
#: The tissue's relaxation between two contacts is followed in steps, the first so long [s], each
#: longer by this factor. (Eight a decade would bias Gn by a third of its error's bound.)
_FIRST_REST, _REST_RATIO = 1e-3, 1.04
#: The surface found at the touch starts the filter; its deviation is widened, since the filter
#: sees those samples again.
_ORIGIN_WIDENING = 3.0
#: Failures are kept up to this number, the newest.
_FAILURES_KEPT = 20


@dataclass
class _Site:
    """One place on the tissue: its memory and what has been learned of it."""

    site_id: int
    origin: float  #: nominal displacement at zero strain [m]
    origin_sd: float  #: [1], as compression
    integral: FractionalIntegral
    start_ns: int
    last_ns: int
    usable: bool  #: its history has been seen from the first touch, without a gap
    flags: Flag
    position: Position | None
    estimator: Estimator | None = None
    estimate: Estimate | None = None


@dataclass
class _Contact:
    """One press, from onset to release."""

    contact_id: int
    start_ns: int
    bias: float
    drift: float
    release_force: float
    rejected_before: int
    at_limit_before: int
    position: Position | None
    flags: Flag = Flag.NONE
    max_strain: float = 0.0
    max_stress: float = 0.0
    max_force: float = 0.0
    sample_count: int = 0
    is_pressed: bool = False
    is_free: bool = True  #: the tissue is not on the probe
    changes_before: int = 0
    changes_labelled: int = 0
    flags_decided: Flag = Flag.NONE
    ended: bool = False  #: reported already, after a gap; the probe has not left yet
    classes: ClassProbabilities | None = None
    decision: Decision = Decision.NONE
    decider: Decider | None = None
    comparison: Comparison | None = None
    decided: Decided | None = None


@dataclass
class _Sums:
    """Running sums of a block."""

    count: int = 0
    start_ns: int = 0
    start_compression: float = 0.0
    first_step: float = 0.0  #: from the sample before the first [s]
    compression: float = 0.0
    stress: float = 0.0
    force: float = 0.0
    has_free: bool = False  #: the tissue was free of the probe for part of it

    def clear(self) -> None:
        self.count = 0
        self.has_free = False
        self.compression = self.stress = self.force = 0.0


class Pipeline:
    """From samples to :class:`TissueState`, :class:`Classification` and :class:`ContactSummary`.

    Parameters
    ----------
    config : PipelineConfig
    emit : callable
        Called with every output, in order of stamps. What it raises is not caught.

    Attributes
    ----------
    failures : deque of Failure
        The newest exceptions of the computation. Each ended one contact and its site, both
        flagged :attr:`Flag.ESTIMATION_FAILED`; the next site begins afresh.
    failure_count : int
        How many there were.
    """

    def __init__(self, config: PipelineConfig, emit: Callable[[Output], None]) -> None:
        self.config = config
        self.rejected: Counter[str] = Counter()
        self._clock_jumps = 0
        self.pair_count = 0
        self.contact_count = 0
        self.site_count = 0
        self.newest_ns = 0
        self._emit_output = emit
        self._muted = False
        self._listener_error: Exception | None = None
        self.failures: deque[Failure] = deque(maxlen=_FAILURES_KEPT)
        self.failure_count = 0
        self._tare_offset = 0.0
        self._block_ns = round(_BLOCK_SHARE * config.block_duration * NANOSECONDS)
        self._max_gap_ns = round(config.synchronize.max_gap * NANOSECONDS)
        self._timeout_ns = round(config.contact.site_timeout * NANOSECONDS)
        order = config.estimator.prior.fractional_order
        self._orders = (order, order + _ORDER_STEP, max(order - _ORDER_STEP, 1e-6), *order_nodes())
        self._order_interpolation = order_interpolation()
        self._detector = ContactDetector(config.contact, order)
        self._meter = (
            ComplexModulusMeter(config.dither_frequencies, config.dither_periods)
            if config.dither_frequencies
            else None
        )
        self._sums = _Sums()
        self._epoch = 0
        self._clear()
        # The kernels' weights take a moment to compute: now, not at the first touch.
        FractionalIntegral(self._orders)
        self._new_estimator(1.0, 1.0)

    def _clear(self) -> None:
        """Forget all streams, memory, contact and site; counts and ids go on."""
        self._synchronizer = Synchronizer(self.config.synchronize, self._on_pair, self.rejected)
        self._forget_site()
        self._epoch = 0

    def _forget_site(self) -> None:
        self._site: _Site | None = None
        self._contact: _Contact | None = None
        self._stiffnesses: dict[int, tuple[Position | None, LogStiffness]] = {}
        self._previous_ns: int | None = None
        self._usual_step_ns = 0.0
        self._behind: deque[Pair] = deque()  # samples of the contact that are not taken yet
        self._pace = 1
        self._sums.clear()
        self._block_end_ns = 0
        self._recent: deque[tuple[int, float]] = deque(maxlen=_RATE_BLOCKS)
        self._rejected_reported = self.rejected.total()
        self._blocks = 0

    # Inputs

    def add_force(self, stamp_ns: int, force: float) -> None:
        """Take a force sample [N], positive when pressing; with torsion a torque [N m]."""
        try:
            self._synchronizer.add_force(stamp_ns, force - self._tare_offset)
        except Exception as error:
            self._synchronizer_failed(stamp_ns, error)

    def add_displacement(
        self,
        stamp_ns: int,
        displacement: float,
        position: Position | None = None,
        load: float = 0.0,
    ) -> None:
        """Take a displacement [m], positive into the tissue, and the position where known [m].

        `load` is the part of the tool's weight in the force at this orientation [N].
        """
        try:
            self._synchronizer.add_displacement(stamp_ns, displacement, position, load)
        except Exception as error:
            self._synchronizer_failed(stamp_ns, error)

    def reject(self, stream: str, reason: str) -> None:
        """Count a sample that could not even be read."""
        self.rejected[f"{stream}.{reason}"] += 1

    def tare(self) -> str | None:
        """Take the present force as zero; return None, or why that cannot be done now."""
        mean = self._detector.mean_air_force()
        if mean is None:
            if self._detector.in_contact:
                return "the probe is in contact: lift it, then tare"
            return "no force has been measured in the air yet: wait for samples, then tare"
        self._tare_offset += mean
        self._detector.reset()
        return None

    def reset(self) -> None:
        """End the contact, if any, as incomplete, and forget everything that was learned."""
        self.finish()
        self._detector.reset()
        self._clear()

    def finish(self) -> None:
        """No more samples come: report the contact that is still open."""
        try:
            self._end_contact(self._previous_ns, complete=False)
        except Exception as error:
            self._failed(self.newest_ns, error)

    @property
    def is_failed(self) -> bool:
        """Whether the newest failure is that of the present site, or came without one."""
        if not self.failures:
            return False
        site_id = self._site.site_id if self._site is not None else 0
        return self.failures[-1].site_id == site_id

    @property
    def warnings(self) -> dict[str, int]:
        """What was odd about the input, in words, and how often."""
        detector = self._detector
        counts = {
            "the clock jumped back: everything learned was reset": self._clock_jumps,
            "the force fell below its value in the air: does it have the wrong sign, "
            "or did the data begin in contact?": detector.below_baseline,
            "the force drifts in the air: tare, or let the sensor warm up": detector.drifts,
            "the force repeated one value: is the sensor dead, or at its end?": self.rejected[
                f"force.{Reason.STUCK}"
            ],
        }
        return {words: count for words, count in counts.items() if count}

    # Pairs

    def _on_pair(self, pair: Pair) -> None:
        try:
            self._take(pair)
        except Exception as error:
            self._failed(pair.stamp_ns, error)

    def _synchronizer_failed(self, stamp_ns: int, error: Exception) -> None:
        self._failed(stamp_ns, error)
        self._synchronizer = Synchronizer(self.config.synchronize, self._on_pair, self.rejected)
        self._epoch = 0

    def _failed(self, stamp_ns: int, error: Exception) -> None:
        """Take note of an exception, and end the contact and the site it came from.

        What the listener to the outputs raised is raised again.
        """
        if error is self._listener_error:
            raise error
        contact, site = self._contact, self._site
        lines = "".join(traceback.format_exception(error)).strip()
        self.failure_count += 1
        self.failures.append(
            Failure(
                stamp_ns=stamp_ns,
                site_id=site.site_id if site is not None else 0,
                contact_id=contact.contact_id if contact is not None else 0,
                reason=" ".join("".join(traceback.format_exception_only(error)).split()),
                traceback=lines,
            )
        )
        self._muted = False
        self._behind.clear()
        self._sums.clear()
        if self._meter is not None:
            self._meter.reset()
        if site is None:
            return
        site.usable = False
        site.flags |= Flag.ESTIMATION_FAILED
        site.estimator = site.estimate = None
        self._stiffnesses.pop(site.site_id, None)
        if contact is None:
            return
        contact.flags |= Flag.ESTIMATION_FAILED
        if not contact.ended:
            contact.ended = True
            self._emit(self._summary(contact, site, stamp_ns, complete=False))

    def _take(self, pair: Pair) -> None:
        if pair.epoch != self._epoch:
            self._clock_jumped(pair.epoch)
        self._check_gap(pair.stamp_ns)
        self.pair_count += 1
        self.newest_ns = pair.stamp_ns
        event = self._detect(pair)
        if isinstance(event, Onset):
            self._touch(event)
        elif self._contact is not None and self._contact.flags & Flag.ESTIMATION_FAILED:
            self._pass(pair, self._contact)
        elif self._contact is not None:
            self._behind.append(pair)
            self._catch_up(self._pace)
        else:
            self._hover(pair)
        if isinstance(event, Release):
            self._end_contact(event.stamp_ns, complete=True)

    def _detect(self, pair: Pair) -> Onset | Release | None:
        try:
            return self._detector.add(pair)
        except Exception:
            self._detector.reset()
            raise

    def _pass(self, pair: Pair, contact: _Contact) -> None:
        """Let a sample of a contact go by in which the estimation failed."""
        contact.sample_count += 1
        force = pair.force - contact.bias
        if force > contact.max_force:
            contact.max_force = force
            contact.max_stress = force * self.config.geometry.stress_per_force
        if pair.stamp_ns - self._block_end_ns < self._block_ns:
            return
        self._block_end_ns = pair.stamp_ns
        assert self._site is not None
        self._emit(
            TissueState(
                stamp_ns=pair.stamp_ns,
                status=Status.UNKNOWN,
                flags=contact.flags | self._input_flags(),
                site_id=self._site.site_id,
                contact_id=contact.contact_id,
                phase=Phase.NONE,
            )
        )

    def _clock_jumped(self, epoch: int) -> None:
        self._clock_jumps += 1
        self._end_contact(self._previous_ns, complete=False)
        in_contact = self._detector.in_contact
        if not in_contact:
            # In contact the detector still knows the air's force, and waits for it.
            self._detector.reset()
        self._forget_site()
        self._epoch = epoch

    def _check_gap(self, stamp_ns: int) -> None:
        previous_ns, self._previous_ns = self._previous_ns, stamp_ns
        if previous_ns is None:
            return
        step_ns = stamp_ns - previous_ns
        usual_ns = self._usual_step_ns
        self._usual_step_ns = usual_ns + 0.05 * (step_ns - usual_ns) if usual_ns else 1.0 * step_ns
        if step_ns <= _GAP_STEPS * usual_ns or step_ns <= _GAP_TIME * NANOSECONDS or not usual_ns:
            return
        self._usual_step_ns = usual_ns
        contact, site = self._contact, self._site
        if contact is None or site is None:
            return
        contact.flags |= Flag.GAP | self._saturation(contact)
        site.flags |= Flag.GAP
        if self._meter is not None:
            self._meter.reset()
        if step_ns > self._max_gap_ns:
            # The memory of this site is lost; the present contact says nothing more.
            self._end_contact(previous_ns, complete=False)
            site.usable = False

    def _saturation(self, contact: _Contact) -> Flag:
        """Whether the force's sensor was at its end, or stuck, during a gap of the contact."""
        grown = self._at_limit() > contact.at_limit_before
        return Flag.SATURATED if grown else Flag.NONE

    def _at_limit(self) -> int:
        return (
            self.rejected[f"force.{Reason.STUCK}"] + self.rejected[f"force.{Reason.OUT_OF_RANGE}"]
        )

    def _touch(self, onset: Onset) -> None:
        first = onset.samples[0]
        site = self._site
        is_known = site is not None and not self._is_new_site(site, first)
        if site is None or not is_known:
            site = self._site = self._new_site(onset)
        self.contact_count += 1
        contact = self._contact = _Contact(
            contact_id=self.contact_count,
            start_ns=first.stamp_ns,
            bias=onset.bias,
            drift=onset.drift,
            release_force=self._detector.release_threshold,
            rejected_before=self.rejected.total(),
            at_limit_before=self._at_limit(),
            position=first.position,
            flags=site.flags,
        )
        # A site that was pressed before needs no surface, only to be left alone in between.
        is_followed = onset.air_seen if is_known else onset.seen
        if not is_followed and not self._begins_at_origin(first):
            site.usable = False
            site.flags |= Flag.ORIGIN_UNCERTAIN
            contact.flags |= Flag.ORIGIN_UNCERTAIN
        if site.flags & Flag.ESTIMATION_FAILED:
            self._block_end_ns = first.stamp_ns
            return
        scale = self.config.geometry.stress_per_force
        if site.usable and site.estimator is None:
            site.estimator = self._new_estimator(onset.noise_sd * scale, site.origin_sd)
        self._rest_until(site, first.stamp_ns)
        site.integral.take_sum()
        if site.estimator is not None:
            site.estimator.begin_contact(onset.bias_sd * scale, onset.drift_sd * scale)
            contact.changes_before = contact.changes_labelled = site.estimator.change_count
        self._sums.clear()
        self._block_end_ns = first.stamp_ns
        self._recent.clear()
        if self._meter is not None:
            self._meter.reset()
        self._behind.extend(onset.samples)
        self._pace = self._pace_of(onset)
        self._catch_up(self._pace)

    def _pace_of(self, onset: Onset) -> int:
        """Return how many samples to take at a time, so that a touch delays no later sample."""
        samples = onset.samples
        lasted = (samples[-1].stamp_ns - samples[0].stamp_ns) / NANOSECONDS
        return 1 + math.ceil(lasted / _CATCH_UP_TIME)

    def _catch_up(self, count: int) -> None:
        """Take samples that wait since the touch.

        They were in the air as far as anyone was told: only the newest state is news.
        """
        behind = self._behind
        for _ in range(min(count, len(behind))):
            pair = behind.popleft()
            self._muted = bool(behind)
            self._press(pair)
        self._muted = False

    def _begins_at_origin(self, pair: Pair) -> bool:
        """Whether the origin is given and a sample is there, so that no press came before it."""
        origin = self.config.strain_origin
        if origin is None:
            return False
        compression = (pair.displacement - origin) / self.config.geometry.length
        return compression <= self.config.block_compression

    def _new_estimator(self, noise_sd: float, origin_sd: float) -> Estimator:
        config = self.config
        if config.estimator.observation is Observation.STRESS:
            return StressEstimator(
                config.estimator,
                config.geometry,
                noise_sd,
                origin_sd,
                self._synchronizer.motion_noise() / config.geometry.length**2,
            )
        return FractionalStressEstimator(config.estimator, config.geometry, noise_sd, origin_sd)

    def _new_site(self, onset: Onset) -> _Site:
        self.site_count += 1
        first = onset.samples[0]
        origin, origin_sd = self.config.strain_origin, 0.0
        if origin is None:
            origin = onset.displacement
            origin_sd = _ORIGIN_WIDENING * onset.displacement_sd / self.config.geometry.length
        site = _Site(
            site_id=self.site_count,
            origin=origin,
            origin_sd=origin_sd,
            integral=FractionalIntegral(self._orders),
            start_ns=first.stamp_ns,
            last_ns=first.stamp_ns,
            usable=True,
            flags=Flag.NONE,
            position=first.position,
        )
        site.integral.start(0.0)
        return site

    def _is_new_site(self, site: _Site, pair: Pair) -> bool:
        if site.position is None or pair.position is None:
            return pair.stamp_ns - site.last_ns > self._timeout_ns
        return (
            self._lateral_distance(site.position, pair.position)
            > self.config.contact.site_distance
        )

    def _lateral_distance(self, a: Position, b: Position) -> float:
        axis = self.config.contact.approach_axis
        offset = [q - p for p, q in zip(a, b, strict=True)]
        along = sum(o * n for o, n in zip(offset, axis, strict=True))
        return math.dist(offset, [along * n for n in axis])

    def _rest_until(self, site: _Site, stamp_ns: int) -> None:
        """Let the tissue relax free of stress since the last sample in contact."""
        step = (stamp_ns - site.last_ns) / NANOSECONDS
        if step < 4.0 * SHORTEST_STEP:
            return
        end = step - SHORTEST_STEP
        first = min(_FIRST_REST, 0.5 * end)
        count = 2 + math.ceil(math.log(end / first) / math.log(_REST_RATIO))
        elapsed = np.geomspace(first, end, count if first == _FIRST_REST else 2)
        steps = tuple(np.diff(elapsed, prepend=0.0).tolist())
        free = site.integral.relax(steps)
        if site.estimator is not None:
            site.estimator.rest(steps, free[:, _EXACT_ORDERS:])
        site.last_ns = stamp_ns - round(SHORTEST_STEP * NANOSECONDS)

    def _press(self, pair: Pair) -> None:
        contact, site = self._contact, self._site
        assert contact is not None and site is not None
        geometry = self.config.geometry
        elapsed = (pair.stamp_ns - contact.start_ns) / NANOSECONDS
        force = pair.force - contact.bias - contact.drift * elapsed
        stress = force * geometry.stress_per_force
        displacement = self._detector.compliance_free(pair, force)
        compression = (displacement - site.origin) / geometry.length
        sums = self._sums
        step = (pair.stamp_ns - site.last_ns) / NANOSECONDS
        is_free = self._is_free(step, force, compression, contact, site)
        sums.has_free |= is_free
        estimator = site.estimator if not contact.ended else None
        if estimator is not None and sums.count == 0 and not self._muted:
            # Only now: whoever waits for the last block's estimate has it already.
            estimator.settle()
        if not is_free:
            if step > 0.0:
                site.integral.add(step, stress)
            if estimator is not None:
                estimator.press(step, compression)
        elif step > 0.0:
            free = site.integral.advance(step, 0.0)
            if estimator is not None:
                estimator.rest((step,), free[None, _EXACT_ORDERS:])
        site.last_ns = pair.stamp_ns
        if self._meter is not None:
            self._oscillate(pair.stamp_ns, compression, stress, is_free)
        if sums.count == 0:
            sums.start_ns, sums.start_compression = pair.stamp_ns, compression
            sums.first_step = step
        sums.count += 1
        sums.compression += compression
        sums.stress += stress
        sums.force += force
        contact.sample_count += 1
        if force > contact.max_force:
            contact.max_force, contact.max_stress = force, stress
        if (
            pair.stamp_ns - self._block_end_ns >= self._block_ns
            or abs(compression - sums.start_compression) > self.config.block_compression
        ):
            self._close_block(pair.stamp_ns, contact, site)

    def _oscillate(self, stamp_ns: int, compression: float, stress: float, is_free: bool) -> None:
        """Measure the complex modulus from a sample in contact."""
        meter, contact, site = self._meter, self._contact, self._site
        assert meter is not None and contact is not None and site is not None
        if is_free or contact.ended:
            meter.reset()
            return
        origin = site.estimate.strain_origin if site.estimate is not None else 0.0
        strain = self.config.geometry.strain(compression - origin)
        elapsed = (stamp_ns - contact.start_ns) / NANOSECONDS
        for modulus in meter.add(elapsed, strain, stress):
            self._emit(
                DynamicModulus(
                    stamp_ns=stamp_ns,
                    start_ns=contact.start_ns + round(modulus.start * NANOSECONDS),
                    site_id=site.site_id,
                    contact_id=contact.contact_id,
                    modulus=modulus,
                )
            )

    def _is_free(
        self, step: float, force: float, compression: float, contact: _Contact, site: _Site
    ) -> bool:
        """Whether the tissue has left the probe, or has not met it yet.

        The first touch says where the origin is, so there the law holds from the origin on; later
        ones meet a surface that still recovers.
        """
        clear = 2.0 * contact.release_force
        is_first_touch = contact.start_ns == site.start_ns and not contact.is_pressed
        if is_first_touch:
            is_free = False
        elif abs(force) <= clear and step > 0.0 and self._is_known(site):
            # Where noise hides the force, the law says where the surface is.
            is_free = self._is_above_surface(step, compression, site)
        else:
            # Twice as much to meet it as to leave it, so that noise does neither.
            is_free = force <= (clear if contact.is_free else contact.release_force)
        contact.is_free = is_free
        return is_free

    @staticmethod
    def _is_known(site: _Site) -> bool:
        return (
            site.usable
            and site.estimate is not None
            and site.estimate.converged
            and site.estimator is not None
            and not site.estimator.is_mismatch
        )

    def _is_above_surface(self, step: float, compression: float, site: _Site) -> bool:
        """Whether the tissue would have to pull at the probe, by what is known of it."""
        estimate = site.estimate
        assert estimate is not None
        weights, _ = self._order_interpolation(estimate.fractional_order)
        free = float(weights @ site.integral.ahead(step)[_EXACT_ORDERS:])
        response = elastic_response(
            self.config.geometry.strain(compression - estimate.strain_origin),
            math.exp(estimate.log_linear_stiffness),
            math.exp(estimate.log_nonlinear_stiffness),
        )
        return response.value <= free

    def _hover(self, pair: Pair) -> None:
        if pair.stamp_ns - self._block_end_ns < self._block_ns:
            return
        self._block_end_ns = pair.stamp_ns
        site = self._site
        estimate = site.estimate if site is not None and site.usable else None
        self._emit(
            TissueState(
                stamp_ns=pair.stamp_ns,
                # After a jump of the clock the probe may press on a tissue that nothing is known
                # of.
                status=Status.UNKNOWN if self._detector.in_contact else Status.NO_CONTACT,
                flags=self._input_flags(),
                site_id=site.site_id if site is not None else 0,
                contact_id=self.contact_count if site is not None else 0,
                phase=Phase.APPROACH,
                estimate=estimate,
                order_source=self._order_source(estimate),
            )
        )

    # Blocks

    def _close_block(self, stamp_ns: int, contact: _Contact, site: _Site) -> None:
        sums = self._sums
        count = sums.count
        compression = sums.compression / count
        stress, force = sums.stress / count, sums.force / count
        fractional = site.integral.take_sum() / count
        block = Block(
            compression=compression,
            stress=stress,
            fractional_stress=self._fractional_stress(site, fractional),
            fractional_stress_by_order=float(fractional[1] - fractional[2])
            / (self._orders[1] - self._orders[2]),
            memory_time=0.5 * (sums.start_ns + stamp_ns - 2 * site.start_ns) / NANOSECONDS,
            size=count,
            duration=(stamp_ns - sums.start_ns) / NANOSECONDS + sums.first_step,
        )
        has_free = sums.has_free
        sums.clear()
        self._block_end_ns = stamp_ns
        self._blocks += 1
        innovation = None
        if site.estimator is not None and site.usable and not contact.ended:
            # Without contact the law does not hold; near the surface the origin's error is not
            # small.
            if self._is_informative(block, force, has_free, contact, site):
                innovation = site.estimator.update(block)
                _check_finite(innovation.innovation, innovation.variance)
                self._watch(site.estimator, contact)
            else:
                site.estimator.skip()
            if not self._muted:
                site.estimate = _checked(site.estimator.estimate())
        self._report(stamp_ns, contact, site, block, innovation)

    @staticmethod
    def _watch(estimator: Estimator, contact: _Contact) -> None:
        if estimator.change_count > contact.changes_before:
            contact.flags |= Flag.TISSUE_CHANGED
        if estimator.is_mismatch:
            contact.flags |= Flag.MODEL_MISMATCH

    def _fractional_stress(self, site: _Site, fractional: Array) -> float:
        """Return D^-alpha f at the order that is known by now."""
        estimate = site.estimate
        order = self._orders[0] if estimate is None else estimate.fractional_order
        if order == self._orders[0]:
            return float(fractional[0])
        return float(self._order_interpolation(order)[0] @ fractional[_EXACT_ORDERS:])

    def _is_informative(
        self, block: Block, force: float, has_free: bool, contact: _Contact, site: _Site
    ) -> bool:
        """Whether the law holds for a block: not behind the surface, nor while letting go."""
        if self.config.estimator.observation is Observation.STRESS:
            contact.is_pressed |= force > 2.0 * contact.release_force
            return not has_free
        return force > contact.release_force and block.compression > site.origin_sd

    def _report(
        self,
        stamp_ns: int,
        contact: _Contact,
        site: _Site,
        block: Block,
        innovation: Innovation | None,
    ) -> None:
        estimate = site.estimate if site.usable and not contact.ended else None
        origin = estimate.strain_origin if estimate is not None else 0.0
        compression = block.compression - origin
        strain = self.config.geometry.strain(compression)
        contact.max_strain = max(contact.max_strain, strain)
        phase = self._phase(stamp_ns, block.compression)
        if self._muted:
            return
        status = Status.CONVERGING
        if estimate is not None and estimate.converged:
            doubtful = site.estimator is not None and site.estimator.is_doubtful
            status = Status.CONVERGING if doubtful else Status.CONVERGED
        flags = contact.flags | self._input_flags()
        self._emit(
            TissueState(
                stamp_ns=stamp_ns,
                status=status,
                flags=flags,
                site_id=site.site_id,
                contact_id=contact.contact_id,
                phase=phase,
                order_source=self._order_source(estimate),
                estimate=estimate,
                signals=Signals(strain, block.stress, block.fractional_stress),
                innovation=innovation,
                apparent_stiffness=(
                    self._apparent_stiffness(estimate, compression)
                    if estimate is not None
                    else None
                ),
            )
        )
        self._classify(stamp_ns, contact, site, estimate)

    def _phase(self, stamp_ns: int, compression: float) -> Phase:
        recent = self._recent
        recent.append((stamp_ns, compression))
        elapsed_ns = stamp_ns - recent[0][0]
        if elapsed_ns == 0:
            return Phase.LOADING
        rate = (compression - recent[0][1]) * NANOSECONDS / elapsed_ns
        if abs(rate) < _HOLDING_RATE:
            return Phase.HOLDING
        return Phase.LOADING if rate > 0.0 else Phase.UNLOADING

    def _apparent_stiffness(self, estimate: Estimate, compression: float) -> ApparentStiffness:
        geometry = self.config.geometry
        order = estimate.fractional_order
        tau = self.config.apparent_stiffness_time_scale
        nonlinear_stiffness = math.exp(estimate.log_nonlinear_stiffness)
        strain = geometry.strain(compression)
        response = elastic_response(
            strain, math.exp(estimate.log_linear_stiffness), nonlinear_stiffness
        )
        value = (
            response.by_strain
            * geometry.strain_slope(compression)
            * apparent_stiffness_factor(order, tau)
            / (geometry.stress_per_force * geometry.length)
        )
        beyond = max(nonlinear_stiffness * abs(strain), 1.0)
        gradient = np.array(
            [1.0, beyond if beyond > 1.0 else 0.0, -math.log(tau) + float(digamma(1.0 - order))]
        )
        sd = value * math.sqrt(max(float(gradient @ estimate.covariance @ gradient), 0.0))
        return ApparentStiffness(value, sd, tau)

    def _order_source(self, estimate: Estimate | None) -> OrderSource:
        if estimate is None:
            return OrderSource.NONE
        if self.config.estimator.order_given:
            return OrderSource.GIVEN
        return OrderSource.LEARNED if self._is_order_learned(estimate) else OrderSource.PRIOR

    def _is_order_learned(self, estimate: Estimate) -> bool:
        config = self.config.estimator
        variance = float(estimate.covariance[2, 2])
        known = (_LEARNED_SHARE * config.prior.fractional_order_sd) ** 2
        return not config.order_given and variance < known

    # Classification and summary

    def _classify(
        self, stamp_ns: int, contact: _Contact, site: _Site, estimate: Estimate | None
    ) -> None:
        changes = site.estimator.change_count if site.estimator is not None else 0
        if changes != contact.changes_labelled:
            # What was named is no longer under the probe.
            contact.changes_labelled = changes
            contact.decider = contact.decided = None
            if contact.classes is not None:
                self._decide(stamp_ns, contact, site, None)
        elif (contact.flags ^ contact.flags_decided) & Flag.MODEL_MISMATCH:
            # What was said stands, but no longer without a reservation.
            self._decide(stamp_ns, contact, site, contact.classes)
        if estimate is None or not estimate.converged:
            if contact.decision is Decision.NONE:
                self._decide(stamp_ns, contact, site, None)
            return
        if self._blocks % _CLASSIFY_EVERY and contact.classes is not None:
            return
        classes = self._classes(stamp_ns, contact, site, estimate)
        if classes is None:
            if contact.decision is Decision.NONE:
                self._decide(stamp_ns, contact, site, None)
            return
        previous = contact.classes
        if (
            previous is None
            or previous.label != classes.label
            or any(
                abs(new - old) > _PROBABILITY_CHANGE
                for new, old in zip(classes.probabilities, previous.probabilities, strict=True)
            )
        ):
            self._decide(stamp_ns, contact, site, classes)

    def _classes(
        self,
        stamp_ns: int,
        contact: _Contact,
        site: _Site,
        estimate: Estimate,
        *,
        last: bool = False,
    ) -> ClassProbabilities | None:
        """Return the probabilities by now, with the label that stands; None: nothing to tell."""
        config = self.config
        likelihood = likelihood_of_estimate(
            estimate, config.estimator.prior, config.estimator.order_given
        )
        if config.relative is not None:
            contact.comparison = self._compare(site, estimate, likelihood)
            if contact.comparison is None:
                return None
            classes = contact.comparison.classes(config.relative.ratio)
        elif config.library is not None:
            classes = classify(config.library, likelihood, config.decision.significance)
        else:
            return None
        if contact.decider is None:
            contact.decider = Decider(config.decision)
        before = contact.decider.label
        label = contact.decider.update(stamp_ns, classes, last=last)
        if label != before:
            elapsed = (stamp_ns - contact.start_ns) / NANOSECONDS
            contact.decided = Decided(elapsed, contact.max_strain) if label else None
        return classes._replace(label=label)

    def _compare(
        self, site: _Site, estimate: Estimate, likelihood: Likelihood
    ) -> Comparison | None:
        """Compare a site with those around it, and keep it for those to come."""
        relative = self.config.relative
        assert relative is not None
        own = without_prior(likelihood) or (mean_of(estimate), estimate.covariance)
        place = log_stiffness(*own, relative.strain, relative.time_scale)
        around = [
            other
            for site_id, (position, other) in self._stiffnesses.items()
            if site_id != site.site_id
            and (
                relative.distance == 0.0
                or position is None
                or site.position is None
                or self._lateral_distance(position, site.position) <= relative.distance
            )
        ]
        self._stiffnesses[site.site_id] = (site.position, place)
        return compare(place, stack(around))

    def _decide(
        self, stamp_ns: int, contact: _Contact, site: _Site, classes: ClassProbabilities | None
    ) -> None:
        decision = Decision.UNDETERMINED
        if classes is not None and classes.label:
            decision = Decision.UNKNOWN if classes.label == UNKNOWN else Decision.CLASS
        contact.decision, contact.classes = decision, classes
        contact.flags_decided = contact.flags
        self._emit(
            Classification(
                stamp_ns=stamp_ns,
                decision=decision,
                site_id=site.site_id,
                contact_id=contact.contact_id,
                flags=contact.flags,
                classes=classes,
                library_name=self._library_name,
                decided=contact.decided,
                comparison=contact.comparison,
            )
        )

    @property
    def _library_name(self) -> str:
        if self.config.relative is not None or self.config.library is None:
            return ""
        return self.config.library.name

    def _end_contact(self, end_ns: int | None, *, complete: bool) -> None:
        self._catch_up(len(self._behind))
        contact, site = self._contact, self._site
        if contact is None or site is None or end_ns is None:
            return
        if not contact.ended:
            contact.ended = True
            if site.estimator is not None and site.usable and site.estimate is not None:
                site.estimator.settle(fully=True)
                site.estimate = _checked(site.estimator.estimate())
            if not complete:
                contact.flags |= self._saturation(contact)
            self._emit(self._summary(contact, site, end_ns, complete))
        # An incomplete contact may go on: the probe has not left.
        if complete:
            self._contact = None
            self._sums.clear()
            is_first = contact.start_ns == site.start_ns
            is_faint = contact.max_force < _FAINT * contact.release_force
            if is_first and is_faint and not site.flags & Flag.ESTIMATION_FAILED:
                # Perhaps noise: what comes next must not inherit its origin.
                self._site = None

    def _summary(
        self, contact: _Contact, site: _Site, end_ns: int, complete: bool
    ) -> ContactSummary:
        estimate = site.estimate if site.usable else None
        converged = estimate is not None and estimate.converged
        rejected = self.rejected.total() - contact.rejected_before
        classes = None
        if estimate is not None and converged:
            classes = self._classes(end_ns, contact, site, estimate, last=True)
        return ContactSummary(
            stamp_ns=end_ns,
            start_ns=contact.start_ns,
            end_ns=end_ns,
            site_id=site.site_id,
            contact_id=contact.contact_id,
            flags=contact.flags | (Flag.INPUT_REJECTED if rejected else Flag.NONE),
            converged=converged,
            complete=complete,
            position=contact.position,
            order_source=self._order_source(estimate),
            estimate=estimate,
            max_strain=contact.max_strain,
            max_stress=contact.max_stress,
            max_force=contact.max_force,
            sample_count=contact.sample_count,
            rejected_count=rejected,
            classes=classes,
            decided=contact.decided if classes is not None else None,
            comparison=contact.comparison if classes is not None else None,
        )

    def _input_flags(self) -> Flag:
        total = self.rejected.total()
        if total == self._rejected_reported:
            return Flag.NONE
        self._rejected_reported = total
        return Flag.INPUT_REJECTED

    def _emit(self, output: Output) -> None:
        if self._muted:
            return
        try:
            self._emit_output(output)
        except Exception as error:
            self._listener_error = error
            raise


def _checked(estimate: Estimate) -> Estimate:
    """Return an estimate that is finite throughout.

    Raises
    ------
    FloatingPointError
        If it is not.
    """
    _check_finite(
        estimate.log_linear_stiffness,
        estimate.log_nonlinear_stiffness,
        estimate.fractional_order,
        estimate.strain_origin,
        estimate.strain_origin_sd,
        float(estimate.covariance.sum()),
    )
    return estimate


def _check_finite(*numbers: float) -> None:
    if not math.isfinite(sum(numbers)):
        raise FloatingPointError(f"the estimate is not finite: {numbers}")
