# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The label of one contact over time: what can be said of its tissue, and when it changed."""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass, replace

from fden_ros.core.classification.classifier import (
    UNKNOWN,
    ClassProbabilities,
    TissueLibrary,
    classify,
    likelihood_of,
)
from fden_ros.core.classification.relative import Comparison, Surroundings
from fden_ros.core.estimation import Estimate, EstimatorConfig
from fden_ros.core.parameter import parameter
from fden_ros.core.streams import NANOSECONDS

#: An unknown place becomes known when its p_value exceeds the significance by this factor.
_KNOWN_AGAIN = 2.0


@dataclass(frozen=True)
class DecisionConfig:
    """When a label is given, and when it is withdrawn."""

    probability: float = parameter(
        "classification.probability",
        0.7,
        "A class is named when its probability is at least this.",
        "1",
        0.34,
        1.0,
    )
    #: The label stands while its probability is at least this [1].
    exit_probability: float = 0.5
    #: How long another answer must persist before it replaces the label [s].
    min_duration: float = 0.2
    #: library: unknown where less than this part of the contacts with the best fitting tissue lie
    #: as far from its centre [1].
    significance: float = 0.06


class Decider:
    """The label of one contact."""

    def __init__(self, config: DecisionConfig) -> None:
        self.label = ""
        self._config = config
        self._candidate = ""
        self._since_ns = 0

    def update(self, stamp_ns: int, classes: ClassProbabilities, *, last: bool = False) -> str:
        """Add probabilities, or the `last`; return the label, empty while there is none."""
        candidate = self._answer(classes)
        if candidate != self._candidate:
            self._candidate, self._since_ns = candidate, stamp_ns
        has_stood = stamp_ns - self._since_ns >= self._config.min_duration * NANOSECONDS
        if not self.label or last or has_stood:
            self.label = candidate
        return self.label

    def _answer(self, classes: ClassProbabilities) -> str:
        config = self._config
        if not classes.is_observable:
            return ""
        own = dict(zip(classes.names, classes.probabilities, strict=True))
        factor = _KNOWN_AGAIN if self.label == UNKNOWN else 1.0
        if classes.p_value < factor * config.significance:
            return UNKNOWN
        best = max(own, key=own.__getitem__)
        if own[best] >= config.probability:
            return best
        return self.label if own.get(self.label, 0.0) >= config.exit_probability else ""


#: While converged, every tenth block is classified.
_CLASSIFY_EVERY = 10
#: A probability that moved by more than this since the last answer makes a new one.
_PROBABILITY_CHANGE = 0.01


class Decision(enum.IntEnum):
    """The classification of the tissue so far."""

    NONE = 0
    UNDETERMINED = 1
    CLASS = 2
    UNKNOWN = 3


@dataclass(frozen=True)
class Decided:
    """What it took to name the tissue, since the touch."""

    time: float  #: [s]
    strain: float  #: largest until then [1]


@dataclass(frozen=True)
class Answer:
    """The answer for the tissue under the probe."""

    classes: ClassProbabilities | None = None
    decided: Decided | None = None
    comparison: Comparison | None = None

    @property
    def decision(self) -> Decision:
        """What the label says."""
        label = self.classes.label if self.classes is not None else ""
        named = Decision.UNKNOWN if label == UNKNOWN else Decision.CLASS
        return named if label else Decision.UNDETERMINED


@dataclass(frozen=True)
class Labeller:
    """How a contact is labelled, the same for all contacts."""

    library: TissueLibrary | None
    estimator: EstimatorConfig  #: its prior is removed from the estimates
    decision: DecisionConfig
    #: Sites to compare with in place of the library's tissues.
    surroundings: Surroundings | None = None

    @property
    def library_name(self) -> str:
        """Name of the library in use; empty: none."""
        return self.library.name if self.library and self.surroundings is None else ""

    def forget(self, site_id: int | None = None) -> None:
        """Drop a site from the comparison; None: all sites so far."""
        if self.surroundings is not None:
            self.surroundings.forget(site_id)

    def classes(
        self, site_id: int, estimate: Estimate
    ) -> tuple[ClassProbabilities | None, Comparison | None]:
        """Return the probabilities of the classes and the comparison, each None without."""
        prior, is_given = self.estimator.prior, self.estimator.is_order_given
        likelihood = likelihood_of(
            estimate.mean, estimate.covariance, prior, order_counts=not is_given
        )
        if self.surroundings is not None:
            found = self.surroundings.compared(site_id, estimate, likelihood)
            return found.classes if found is not None else None, found
        if self.library is not None:
            return classify(self.library, likelihood), None
        return None, None


class Labelling:
    """The label of one contact with a site."""

    def __init__(self, labeller: Labeller, site_id: int, start_ns: int) -> None:
        self._labeller = labeller
        self._site_id, self._start_ns = site_id, start_ns
        self._is_first, self._is_mismatch = True, False  # of the newest answer
        self._decider = Decider(labeller.decision)
        self._answer = Answer()

    def update(
        self,
        stamp_ns: int,
        estimate: Estimate | None,
        max_strain: float,
        *,
        block: int,
        has_changed: bool,
        is_mismatch: bool,
    ) -> Iterator[Answer]:
        """Add the estimate after a numbered block; yield each answer that differs from the last.

        `has_changed`: the tissue under the probe; `is_mismatch`: the model does not describe it.
        """
        if has_changed and self._answer.classes is not None:
            # The named tissue is no longer under the probe.
            self._decider = Decider(self._labeller.decision)
            self._answer = replace(self._answer, decided=None)
            yield self._give(None, is_mismatch)
        elif is_mismatch != self._is_mismatch:
            # The label stands, but no longer without a reservation.
            yield self._give(self._answer.classes, is_mismatch)
        before, classes = self._answer.classes, None
        is_due = before is None or block % _CLASSIFY_EVERY == 0
        if is_due and estimate is not None and estimate.converged:
            classes = self._classes(stamp_ns, estimate, max_strain)
        if _differ(before, classes) if classes is not None else self._is_first:
            yield self._give(classes, is_mismatch)

    def finish(self, stamp_ns: int, estimate: Estimate | None, max_strain: float) -> Answer:
        """Return the answer at the end of the contact, which needs no minimum duration."""
        if estimate is None or not estimate.converged:
            return Answer()
        classes = self._classes(stamp_ns, estimate, max_strain, last=True)
        return Answer() if classes is None else replace(self._answer, classes=classes)

    def _give(self, classes: ClassProbabilities | None, is_mismatch: bool) -> Answer:
        self._is_first, self._is_mismatch = False, is_mismatch
        self._answer = replace(self._answer, classes=classes)
        return self._answer

    def _classes(
        self, stamp_ns: int, estimate: Estimate, max_strain: float, *, last: bool = False
    ) -> ClassProbabilities | None:
        """Return the probabilities with the label that stands; None: no estimate."""
        classes, comparison = self._labeller.classes(self._site_id, estimate)
        self._answer = replace(self._answer, comparison=comparison)
        if classes is None:
            return None
        before = self._decider.label
        label = self._decider.update(stamp_ns, classes, last=last)
        if label != before:
            elapsed = (stamp_ns - self._start_ns) / NANOSECONDS
            decided = Decided(elapsed, max_strain) if label else None
            self._answer = replace(self._answer, decided=decided)
        return classes._replace(label=label)


def _differ(old: ClassProbabilities | None, new: ClassProbabilities) -> bool:
    if old is None or old.label != new.label:
        return True
    changes = (abs(a - b) for a, b in zip(new.probabilities, old.probabilities, strict=True))
    return max(changes) > _PROBABILITY_CHANGE
