# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A probe that presses and leaves: contacts of sites, and the air between."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from fden_ros.core.arrays import Array
from fden_ros.core.block import BlockSums
from fden_ros.core.config import PipelineConfig, labeller_of
from fden_ros.core.contact import ContactDetector, Onset, Release
from fden_ros.core.noise_filter import LONGEST_FILTER
from fden_ros.core.outputs import (
    Flag,
    Output,
    Phase,
    Status,
    TissueState,
    estimate_flags,
    order_source,
)
from fden_ros.core.plausibility import Plausibility, Tilt
from fden_ros.core.report import Common
from fden_ros.core.site import prepare
from fden_ros.core.site_contact import Contact
from fden_ros.core.sites import Sites
from fden_ros.core.streams import Pair
from fden_ros.core.strokes import Strokes
from fden_ros.written import written


class ContactSession:
    """One press after the other.

    `path_noise` returns the noise of the motion so far [m^2 s]; `flags` apply to every
    estimate.
    """

    def __init__(
        self,
        config: PipelineConfig,
        rejected: Counter[str],
        path_noise: Callable[[], float],
        flags: Flag,
    ) -> None:
        self.contact_count = 0  #: so far
        self._config, self._path_noise, self._flags = config, path_noise, flags
        self._sites = Sites(config, flags)
        #: Contacts with a mass beyond the sensor, the newest such mass [kg]; contacts before which
        #: the noise was smooth, and the longest time of such a filter [s].
        self._inertial, self._mass, self._filters, self._filter_time = 0, 0.0, 0, 0.0
        self._detector = ContactDetector(config.contact, config.estimator.prior.fractional_order)
        self._tilt = Tilt(config.geometry)
        self._strokes = Strokes()
        self._common = Common(
            config,
            rejected,
            labeller_of(config),
            Plausibility(config.plausibility, config.geometry, config.estimator.prior),
            BlockSums(config.block_duration, config.block_compression),
        )
        self.forget()
        prepare(config)

    def forget(self, *, keeps_contact: bool = False) -> None:
        """Reset the sites, and the air's force; ids are kept.

        `keeps_contact`: a detector in contact waits for the release.
        """
        self._sites.forget()
        self._contact: Contact | None = None  # the newest
        #: Surface of the tissue at the newest contact [m], not a number where none was seen.
        self.surface = math.nan
        #: Of the force at its touch: bias and noise [N], the time of a filter [s], and the mass
        #: beyond the sensor [kg].
        self.air = 0.0, 0.0, 0.0, 0.0
        self._strokes.forget()
        self._common.labeller.forget()
        self._common.sums.forget()
        self._detector.reset(keeps_contact=keeps_contact)

    @property
    def site_count(self) -> int:
        """Sites so far."""
        return self._sites.count

    @property
    def in_contact(self) -> bool:
        """Whether the probe presses."""
        return self._detector.in_contact

    @property
    def place(self) -> tuple[int, int]:
        """Numbers of the present site and contact; 0: there is none."""
        contact = self._contact
        if contact is not None and contact.state.is_open:
            return contact.site.site_id, contact.contact_id
        site = self._sites.present
        return (site.site_id if site is not None else 0), 0

    @property
    def air_events(self) -> tuple[int, int, bool]:
        """As :func:`~fden_ros.core.input_warnings.input_warnings` expects them."""
        detector = self._detector
        if self._inertial:  # whose inertia makes the force rise and fall in the air
            return 0, 0, detector.has_seen_air
        return detector.below_baseline, detector.drifts, detector.has_seen_air

    @property
    def warnings(self) -> dict[str, int]:
        """Problems of the contacts, in words, with counts."""
        strokes = self._strokes
        inertia = (
            f"the force follows the acceleration in the air: some {1e3 * self._mass:.2g} g "
            "beyond the sensor (press more slowly)"
        )
        smooth = (
            "the force's noise in the air is smooth over some "
            f"{written(1e3 * self._filter_time, 2)} ms, as after a filter, which "
            + (
                "is too slow for G, Gn and N/m and makes slopes too low (switch it off, or read "
                "the force before it)"
                if self._filter_time > LONGEST_FILTER
                else "delays the force (measure the delay with fden configure and state "
                "displacement.delay, or weaken the filter)"
            )
        )
        return {
            inertia: self._inertial,
            smooth: self._filters,
            **self._common.plausibility.found,
            self._tilt.words: self._tilt.count,
            strokes.warning: 1,
        }

    @property
    def never_lifts(self) -> bool:
        """Whether the probe palpates without lifting, so that its contacts do not count."""
        return self._strokes.prevails

    def force_ahead(self, times: Array, displacements: Array) -> tuple[Array, Array] | None:
        """Return the force of a motion to come, as :meth:`~.site.Site.force_ahead` does."""
        site = self._sites.present if self.in_contact else None
        return site.force_ahead(times, displacements) if site is not None else None

    def withdraw(self, flag: Flag) -> None:
        """Give no more estimates of the tissue under the probe, for the reason of a flag."""
        if self._contact is not None and self._contact.state.is_open:
            self._contact.site.withdraw(flag)

    def zero(self) -> float | str:
        """Measure the force in the air anew; return its old value [N], or the refusal."""
        mean = self._detector.mean_air_force()
        if mean is None:
            if self._detector.in_contact:
                return "the probe is in contact: lift it, then tare"
            return "no force has been measured in the air yet: wait for samples, then tare"
        self._detector.reset()
        # From now on the air has another bias than before the last contact.
        if self._contact is not None:
            self._contact.drop_air()
        return mean

    # Pairs

    def take(self, pair: Pair) -> Iterator[Output]:
        """Add a pair; yield its outputs."""
        event, contact = self._detect(pair), self._contact
        self._strokes.add(pair, in_contact=self._detector.in_contact)
        if isinstance(event, Onset):
            self._strokes.touch(event)
            yield from self._touch(event)
        elif contact is None or contact.state.has_left:
            yield from self._hover(pair)
        else:
            yield from contact.take(pair)
        if isinstance(event, Release):
            self._strokes.release()
            yield from self._release(event.stamp_ns)

    def _detect(self, pair: Pair) -> Onset | Release | None:
        try:
            return self._detector.add(pair)
        except Exception:
            self._detector.reset()
            raise

    def _touch(self, onset: Onset) -> Iterator[Output]:
        first, newest = onset.samples[0], onset.samples[-1]
        before, stamp_ns = self._sites.present, newest.stamp_ns
        yield from self._lead(lambda contact: contact.summarize(stamp_ns))
        yield from self._lead(lambda contact: contact.judge(stamp_ns, before_ns=first.stamp_ns))
        self._inertial, self._mass = self._inertial + (onset.mass > 0.0), onset.mass or self._mass
        self._filters += onset.filter_time > 0.0
        self._filter_time = max(self._filter_time, onset.filter_time)
        if onset.filter_time <= LONGEST_FILTER:
            late = onset.filter_time + min(self._config.synchronize.displacement_delay, 0.0)
            onset = onset._replace(filter_time=max(late, 0.0))
        self._tilt.see(newest.tilt)
        self.air = onset.bias, onset.noise_sd, onset.filter_time, onset.mass
        site = self._sites.of(onset, self._detector.left_unseen_ns)
        site.check_history(onset)
        found = onset.displacement if onset.seen else math.nan
        # A dent that has not recovered is no surface.
        self.surface = site.origin if site.is_observed else found
        self.contact_count += 1
        is_air_proved = self._contact is not None and self._contact.is_air_proved
        self._contact = Contact(self.contact_count, onset, site, self._common, is_air_proved)
        yield from self._contact.begin(self._path_noise(), before)

    def _hover(self, pair: Pair) -> Iterator[Output]:
        """Add a pair in the air; yield a state per block duration, and summaries that are due."""
        contact, stamp_ns = self._contact, pair.stamp_ns
        if contact is not None:
            yield from contact.hover(pair)
        if self._common.sums.passes(stamp_ns):
            yield self._state(stamp_ns)
        if contact is not None:
            if contact.is_due(stamp_ns):
                yield from contact.summarize(stamp_ns)
            contact.settle(stamp_ns)

    def _state(self, stamp_ns: int) -> TissueState:
        """Return the state in the air."""
        site = self._sites.present
        estimate = site.usable_estimate if site is not None else None
        return TissueState(
            stamp_ns=stamp_ns,
            # After a jump of the clock the probe may press on a tissue without a site.
            status=Status.UNKNOWN if self._detector.in_contact else Status.NO_CONTACT,
            flags=self._flags | estimate_flags(estimate),
            site_id=site.site_id if site is not None else 0,
            contact_id=self.contact_count if site is not None else 0,
            phase=Phase.APPROACH,
            estimate=estimate,
            order_source=order_source(estimate, self._config.estimator),
        )

    def _lead(self, step: Callable[[Contact], Iterable[Output]]) -> Iterator[Output]:
        """Continue the contact; yield its outputs."""
        if self._contact is not None:
            yield from step(self._contact)

    # Interruption and end

    def _release(self, stamp_ns: int) -> Iterator[Output]:
        contact = self._contact
        if contact is None or contact.state.has_left:
            return
        yield from contact.release(stamp_ns)
        self._common.sums.clear()
        if contact.is_faint:
            self._sites.drop()

    def see_gap(self, before_ns: int, *, is_long: bool) -> Iterator[Output]:
        """Handle samples missing since a stamp.

        `is_long`: the memory of the site is lost; the present contact gives no more estimates.
        """
        if is_long:
            self._strokes.forget()
        yield from self._lead(lambda contact: contact.see_gap(before_ns, is_long=is_long))

    def break_off(self, stamp_ns: int) -> Iterator[Output]:
        """Yield the summary of a contact whose samples end at a stamp."""
        yield from self._lead(lambda contact: contact.summarize(stamp_ns))
        yield from self._lead(lambda contact: contact.interrupt(stamp_ns))

    def finish(self, stamp_ns: int) -> Iterator[Output]:
        """Yield the remaining outputs when no more samples come."""
        yield from self.break_off(stamp_ns)
        yield from self._lead(lambda contact: contact.judge(stamp_ns))

    def fail(self, stamp_ns: int) -> Iterator[Output]:
        """End contact and site after an exception."""
        self._common.sums.clear()
        contact = self._contact
        site = (
            contact.site if contact is not None and contact.state.is_open else self._sites.present
        )
        if site is None:
            return
        site.fail()
        self._common.labeller.forget(site.site_id)
        yield from self._lead(lambda contact: contact.fail(stamp_ns))
