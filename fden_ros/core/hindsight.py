# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The judging of a contact after its release: the air after it may contradict that before it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact.aftermath import Aftermath
from fden_ros.core.contact.detector import Onset
from fden_ros.core.estimation.drift_scale import drift_evidence
from fden_ros.core.estimation.motion_scale import Evidence
from fden_ros.core.outputs import ContactSummary, Flag, order_source
from fden_ros.core.site import Site
from fden_ros.core.streams.samples import NANOSECONDS, Pair

#: The air after a contact is judged 1 s after its release [ns], and 0.15 s after it was averaged
#: [ns]: a slow contact that begins before is known by then.
_JUDGED_AFTER_NS, _AVERAGED_BEFORE_NS = NANOSECONDS, 150_000_000
#: The air after a contact contradicts that before it beyond this many stated deviations [1].
_CONTRADICTION = 5.0
#: Of the summary of a contact that is withdrawn.
_NO_LABEL: dict[str, Any] = {"classes": None, "decided": None, "comparison": None}


class _Ended(NamedTuple):
    """A contact that the air after it may still contradict."""

    summary: ContactSummary
    site: Site
    aftermath: Aftermath


class Verdict(NamedTuple):
    """What the air after a contact says of it."""

    summary: ContactSummary | None = None  #: the second, where it is contradicted
    drift: Evidence | None = None  #: for scales of the stated drift, where that is learned


_NOTHING = Verdict()


class Hindsight:
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

    def acquit(self) -> None:
        """Let the last contact stand: what comes now cannot be compared with the air before."""
        self._ended = None

    def teach_nothing(self) -> None:
        """Let no other site use what the last contact teaches."""
        if self._ended is not None:
            self._ended.site.teach_nothing()

    def begin(self, summary: ContactSummary, site: Site, onset: Onset) -> None:
        """Begin with a contact that has ended with its release."""
        if self._config.contact.measure_bias:
            drift_sd = self._config.estimator.uncertainty.force_drift_sd
            self._ended = _Ended(summary, site, Aftermath(onset, drift_sd))

    def add(self, pair: Pair) -> Verdict:
        """Take a pair in the air; return what is found, once it can be."""
        if self._ended is None:
            return _NOTHING
        summary, _, aftermath = self._ended
        aftermath.add(pair)
        earliest_ns = summary.end_ns + _JUDGED_AFTER_NS
        if pair.stamp_ns <= max(earliest_ns, aftermath.end_ns + _AVERAGED_BEFORE_NS):
            return _NOTHING
        return self.judge(pair.stamp_ns)

    def judge(self, stamp_ns: int, *, before_ns: int | None = None) -> Verdict:
        """Judge the last contact now.

        `before_ns`: when the next contact began.
        """
        ended, self._ended = self._ended, None
        if ended is None or not ended.aftermath.is_complete:
            return _NOTHING
        if before_ns is not None and ended.aftermath.end_ns > before_ns:
            return _NOTHING
        was_proved, self._is_air_proved = self._is_air_proved, True
        found, site = ended.aftermath.change(), ended.site
        if found is None:
            return _NOTHING
        deviations = found.deviations
        if deviations < -_CONTRADICTION and not was_proved:
            # What was taken for the first air was a contact: there is no origin, nor a history.
            was_usable = site.is_usable
            site.withdraw()
            return Verdict(self._summary_of(ended, stamp_ns)) if was_usable else _NOTHING
        drift = drift_evidence(*found) if site.teaches_drift and found.drift_variance else None
        factor = site.known_rig.drift_factor(drift) if drift is not None else 1.0
        flag = Flag.NONE
        if abs(deviations) > _CONTRADICTION:
            flag, factor = Flag.FORCE_DRIFTED, max(1.0 + deviations**2, factor)
        if factor == 1.0 or not site.is_usable:
            return Verdict(drift=drift)
        site.doubt(flag, factor)
        return Verdict(self._summary_of(ended, stamp_ns), drift)

    def _summary_of(self, ended: _Ended, stamp_ns: int) -> ContactSummary:
        """Return the summary of a contact with what its site says now."""
        estimate = ended.site.usable_estimate
        return replace(
            ended.summary,
            stamp_ns=stamp_ns,
            flags=ended.summary.flags | ended.site.flags,
            estimate=estimate,
            converged=estimate is not None and estimate.converged,
            order_source=order_source(estimate, self._config.estimator),
            **({} if estimate is not None else _NO_LABEL),
        )
