# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A contact judged by the air behind it, which may contradict the air before."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact.detector import Onset
from fden_ros.core.estimation.learned_scales import Evidence, drift_evidence
from fden_ros.core.outputs import ContactSummary, Flag, order_source
from fden_ros.core.site import Site
from fden_ros.core.streams.samples import NANOSECONDS, Pair

#: The force is averaged from 0.2 s to 0.5 s after the probe has gone back behind the surface where
#: it touched [ns]: by then what stuck has let go, and a sensor that creeps has hardly recovered.
_SETTLING_NS, _WINDOW_NS = 200_000_000, 500_000_000
#: At least this number of samples is averaged.
_LEAST_SAMPLES = 12
#: It is judged 1 s after the release [ns], and 0.15 s after it was averaged [ns]: a slow contact
#: that begins before is known by then.
_JUDGED_AFTER_NS, _AVERAGED_BEFORE_NS = NANOSECONDS, 150_000_000
#: It contradicts the air before the contact beyond this many stated standard deviations.
_CONTRADICTION = 5.0
#: Of the summary of a contact that is withdrawn.
_NO_LABEL: dict[str, Any] = {"classes": None, "decided": None, "comparison": None}


class AirChange(NamedTuple):
    """The air's force after a contact less that before it, its drift there taken on."""

    change: float  #: [N]
    noise_variance: float  #: of that, by what is not known of the air [N^2]
    drift_variance: float  #: of the drift that is stated for the contact [N^2]

    @property
    def deviations(self) -> float:
        """The change over its stated standard deviation [1]; below 0: the force has fallen."""
        return self.change / math.sqrt(self.noise_variance + self.drift_variance)


class AirAfter:
    """Averages the force in the air behind the surface of a contact.

    Parameters
    ----------
    onset : Onset
    drift_sd : float
        Of the force over one second in contact [N], as stated.
    """

    def __init__(self, onset: Onset, drift_sd: float) -> None:
        self._onset = onset
        self._drift_sd = drift_sd
        self._behind_ns: int | None = None
        self._size, self._sum = 0, 0.0
        self.is_complete = False

    @property
    def end_ns(self) -> int:
        """When the averaging ends [ns]; 0: it has not begun."""
        return 0 if self._behind_ns is None else self._behind_ns + _WINDOW_NS

    def average(self, pair: Pair) -> None:
        """Take a pair after the release."""
        if self.is_complete:
            return
        if pair.displacement >= self._onset.displacement:
            self._behind_ns, self._size, self._sum = None, 0, 0.0
            return
        if self._behind_ns is None:
            self._behind_ns = pair.stamp_ns
        elapsed_ns = pair.stamp_ns - self._behind_ns
        self.is_complete = elapsed_ns > _WINDOW_NS
        if _SETTLING_NS <= elapsed_ns <= _WINDOW_NS:
            self._size += 1
            self._sum += pair.force

    def change(self) -> AirChange | None:
        """Return how the air has changed; None where too few samples say nothing."""
        onset = self._onset
        if not self.is_complete or self._size < _LEAST_SAMPLES:
            return None
        elapsed = (self.end_ns - onset.samples[0].stamp_ns) / NANOSECONDS
        return AirChange(
            self._sum / self._size - onset.bias - onset.drift * elapsed,
            onset.bias_sd**2 + (onset.drift_sd * elapsed) ** 2 + onset.noise_sd**2 / self._size,
            self._drift_sd**2 * elapsed,
        )


class _Ended(NamedTuple):
    """A contact that the air after it may still contradict."""

    end_ns: int  #: stamp of the release
    site: Site
    air: AirAfter
    summary: ContactSummary | None = None  #: None: it is not there yet


class Verdict(NamedTuple):
    """What the air after a contact says of it."""

    summary: ContactSummary | None = None  #: the second, where it is contradicted
    drift: Evidence | None = None  #: for scales of the stated drift, where that is learned


_NOTHING = Verdict()


class AirCheck:
    """Judges each contact by the air after it, once.

    A contact that is contradicted gets a second summary. Its site is doubted: the covariance is
    widened by as much as the air contradicts what is stated, or what was learned; or, where the
    first contact was taken for air, withdrawn.

    Parameters
    ----------
    config : PipelineConfig
    """

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self.forget()

    def forget(self) -> None:
        """Forget the last contact, and that the air was the air."""
        self._ended: _Ended | None = None
        self._is_air_proved = False

    def drop(self) -> None:
        """Let the last contact stand: what comes now cannot be compared with the air before."""
        self._ended = None

    def teach_nothing(self) -> None:
        """Let no other site use what the last contact teaches."""
        if self._ended is not None:
            self._ended.site.teach_nothing()

    def watch(self, end_ns: int, site: Site, onset: Onset) -> None:
        """Begin with a contact that has ended with its release."""
        if self._config.contact.measure_bias:
            drift_sd = self._config.estimator.uncertainty.force_drift_sd
            self._ended = _Ended(end_ns, site, AirAfter(onset, drift_sd))

    def see(self, summary: ContactSummary) -> None:
        """Take note of the contact's summary: only now it can be judged."""
        if self._ended is not None:
            self._ended = self._ended._replace(summary=summary)

    def hear(self, pair: Pair) -> Verdict:
        """Take a pair in the air; return what is found, once it can be."""
        if self._ended is None:
            return _NOTHING
        air = self._ended.air
        air.average(pair)
        earliest_ns = self._ended.end_ns + _JUDGED_AFTER_NS
        if pair.stamp_ns <= max(earliest_ns, air.end_ns + _AVERAGED_BEFORE_NS):
            return _NOTHING
        return self.judge(pair.stamp_ns)

    def judge(self, stamp_ns: int, *, before_ns: int | None = None) -> Verdict:
        """Judge the last contact now.

        `before_ns`: when the next contact began.
        """
        ended, self._ended = self._ended, None
        if ended is None or ended.summary is None or not ended.air.is_complete:
            return _NOTHING
        if before_ns is not None and ended.air.end_ns > before_ns:
            return _NOTHING
        was_proved, self._is_air_proved = self._is_air_proved, True
        found, site = ended.air.change(), ended.site
        if found is None:
            return _NOTHING
        deviations = found.deviations
        if deviations < -_CONTRADICTION and not was_proved:
            # What was taken for the first air was a contact: there is no origin, nor a history.
            was_usable = site.is_usable
            site.withdraw()
            return self._verdict(ended.summary, site, stamp_ns) if was_usable else _NOTHING
        drift = drift_evidence(*found) if site.teaches_drift and found.drift_variance else None
        factor = site.known_rig.drift_factor(drift) if drift is not None else 1.0
        flag = Flag.NONE
        if abs(deviations) > _CONTRADICTION:
            flag, factor = Flag.FORCE_DRIFTED, max(1.0 + deviations**2, factor)
        if factor == 1.0 or not site.is_usable:
            return Verdict(drift=drift)
        site.doubt(flag, factor)
        return self._verdict(ended.summary, site, stamp_ns, drift)

    def _verdict(
        self, summary: ContactSummary, site: Site, stamp_ns: int, drift: Evidence | None = None
    ) -> Verdict:
        """Return the summary of a contact with what its site says now."""
        estimate = site.usable_estimate
        second = replace(
            summary,
            stamp_ns=stamp_ns,
            flags=summary.flags | site.flags,
            estimate=estimate,
            converged=estimate is not None and estimate.converged,
            order_source=order_source(estimate, self._config.estimator),
            **({} if estimate is not None else _NO_LABEL),
        )
        return Verdict(second, drift)
