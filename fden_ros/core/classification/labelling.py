# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The label of one contact over time: what can be said of its tissue, and when it changed."""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from fden_ros.core.classification.classifier import (
    UNKNOWN,
    ClassProbabilities,
    Likelihood,
    TissueLibrary,
    classify,
    likelihood_of_estimate,
)
from fden_ros.core.classification.relative import (
    Comparison,
    RelativeConfig,
    compare,
    stack,
    without_prior,
)
from fden_ros.core.estimation.estimate import Estimate
from fden_ros.core.estimation.estimator_config import EstimatorConfig
from fden_ros.core.law.apparent_stiffness import LogStiffness, log_stiffness
from fden_ros.core.parameter import parameter
from fden_ros.core.streams.samples import NANOSECONDS, Position

#: An unknown place becomes known when its typicality exceeds the significance by this factor.
_TEST_HYSTERESIS = 2.0


@dataclass(frozen=True)
class DecisionConfig:
    """When a label is given, and when it is taken back."""

    probability: float = parameter(
        "classification.probability",
        0.7,
        "A class is named when its probability is at least this.",
        "1",
        0.34,
        1.0,
    )
    release: float = parameter(
        "classification.release",
        0.5,
        "It stays named while its probability is at least this.",
        "1",
        0.0,
        1.0,
    )
    dwell: float = parameter(
        "classification.dwell",
        0.2,
        "How long another answer must stand before it replaces the one that is named.",
        "s",
        0.0,
        60.0,
    )
    significance: float = parameter(
        "classification.significance",
        0.06,
        "library: unknown where less than this part of the contacts with the best fitting tissue "
        "lies as far from it.",
        "1",
        0.0,
        0.5,
    )


class Decider:
    """The label of one contact.

    Parameters
    ----------
    config : DecisionConfig

    Examples
    --------
    >>> decider = Decider(DecisionConfig())
    >>> names = ("liver", "muscle", "unknown")
    >>> decider.update(0, ClassProbabilities("liver", names, (0.6, 0.3, 0.1)))
    ''
    >>> decider.update(10**8, ClassProbabilities("liver", names, (0.8, 0.1, 0.1)))
    'liver'
    >>> decider.update(2 * 10**8, ClassProbabilities("muscle", names, (0.2, 0.75, 0.05)))
    'liver'
    >>> decider.update(4 * 10**8, ClassProbabilities("muscle", names, (0.2, 0.75, 0.05)))
    'muscle'
    """

    def __init__(self, config: DecisionConfig) -> None:
        self.label = ""
        self._config = config
        self._candidate = ""
        self._since_ns = 0

    def update(self, stamp_ns: int, classes: ClassProbabilities, *, last: bool = False) -> str:
        """Take the newest probabilities; return the label, empty while there is none.

        Parameters
        ----------
        stamp_ns : int
        classes : ClassProbabilities
        last : bool
            No more probabilities come: another answer replaces the label at once.
        """
        candidate = self._answer(classes)
        if candidate == self.label:
            self._candidate = candidate
        elif candidate != self._candidate or not self.label:
            self._candidate, self._since_ns = candidate, stamp_ns
        if not self.label or last or self._has_stood(stamp_ns):
            self.label = candidate
        return self.label

    def _has_stood(self, stamp_ns: int) -> bool:
        return stamp_ns - self._since_ns >= self._config.dwell * NANOSECONDS

    def _answer(self, classes: ClassProbabilities) -> str:
        config = self._config
        if not classes.is_observable:
            return ""
        own = dict(zip(classes.names, classes.probabilities, strict=True))
        is_unknown = self.label == UNKNOWN
        limit = config.significance * (_TEST_HYSTERESIS if is_unknown else 1.0)
        if classes.typicality < limit:
            return UNKNOWN
        best = max(own, key=lambda name: own[name])
        if own[best] >= config.probability:
            return best
        if self.label and own.get(self.label, 0.0) >= config.release:
            return self.label
        return ""


#: While converged, every tenth block is classified.
_CLASSIFY_EVERY = 10
#: A probability that moved by more than this since the last answer makes a new one.
_PROBABILITY_CHANGE = 0.01


class Decision(enum.IntEnum):
    """What has been decided of the tissue."""

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
    """What is said of the tissue under the probe."""

    decision: Decision = Decision.NONE
    classes: ClassProbabilities | None = None
    decided: Decided | None = None
    comparison: Comparison | None = None


@dataclass(frozen=True)
class Evidence:
    """What is known of a contact when a block ends."""

    stamp_ns: int
    block: int  #: number of the block
    estimate: Estimate | None
    max_strain: float  #: [1]
    change_count: int  #: how often the tissue changed under the probe
    is_mismatch: bool  #: the model does not describe the contact


class Surroundings:
    """The stiffness of each site touched so far, to compare others with.

    Parameters
    ----------
    config : RelativeConfig
    time_scale : float
        tau of the stiffness [s].
    distance : callable
        Of two positions [m].
    """

    def __init__(
        self,
        config: RelativeConfig,
        time_scale: float,
        distance: Callable[[Position, Position], float],
    ) -> None:
        self._config, self._time_scale = config, time_scale
        self._distance = distance
        self._sites: dict[int, tuple[Position | None, LogStiffness]] = {}

    def compare(
        self, site_id: int, position: Position | None, estimate: Estimate, likelihood: Likelihood
    ) -> Comparison | None:
        """Compare a site with those around it, and keep it for those to come."""
        config = self._config
        own = without_prior(likelihood) or (estimate.mean, estimate.covariance)
        place = log_stiffness(*own, config.strain, self._time_scale)
        around = [
            other
            for other_id, (other_position, other) in self._sites.items()
            if other_id != site_id and self._is_near(other_position, position)
        ]
        self._sites[site_id] = (position, place)
        return compare(place, stack(around))

    def forget(self, site_id: int | None = None) -> None:
        """Forget a site; None: all."""
        if site_id is None:
            self._sites.clear()
        else:
            self._sites.pop(site_id, None)

    def _is_near(self, a: Position | None, b: Position | None) -> bool:
        reach = self._config.distance
        return reach == 0.0 or a is None or b is None or self._distance(a, b) <= reach


@dataclass(frozen=True)
class Labeller:
    """How a contact is labelled, the same for all contacts.

    Parameters
    ----------
    library : TissueLibrary or None
    estimator : EstimatorConfig
        Its prior is taken out of the estimates.
    decision : DecisionConfig
    ratio : float
        Stiffer than the surroundings by more than this is ``stiffer``.
    surroundings : Surroundings or None
        Sites to compare with in place of the library's tissues.
    """

    library: TissueLibrary | None
    estimator: EstimatorConfig
    decision: DecisionConfig
    ratio: float = 1.0
    surroundings: Surroundings | None = None

    @property
    def library_name(self) -> str:
        """Name of the library in use; empty: none is."""
        if self.surroundings is not None or self.library is None:
            return ""
        return self.library.name

    def forget(self, site_id: int | None = None) -> None:
        """Compare with a site no more; None: with none of those so far."""
        if self.surroundings is not None:
            self.surroundings.forget(site_id)

    def classes(
        self, site_id: int, position: Position | None, estimate: Estimate
    ) -> tuple[ClassProbabilities | None, Comparison | None]:
        """Return the probabilities of the classes and the comparison, each None without."""
        config = self.estimator
        likelihood = likelihood_of_estimate(estimate, config.prior, config.fractional_order_given)
        if self.surroundings is not None:
            found = self.surroundings.compare(site_id, position, estimate, likelihood)
            return (found.classes(self.ratio) if found is not None else None), found
        if self.library is not None:
            return classify(self.library, likelihood, self.decision.significance), None
        return None, None


class Labelling:
    """The label of one contact.

    Parameters
    ----------
    labeller : Labeller
    site_id : int
    position : tuple of float or None
        Of the site [m].
    start_ns : int
        Stamp of the touch.
    change_count : int
        How often the site's tissue has changed before.
    """

    def __init__(
        self,
        labeller: Labeller,
        site_id: int,
        position: Position | None,
        start_ns: int,
        change_count: int,
    ) -> None:
        self._labeller = labeller
        self._site_id = site_id
        self._position = position
        self._start_ns = start_ns
        self._change_count = change_count
        self._is_mismatch = False
        self._decider: Decider | None = None
        self._answer = Answer()

    def update(self, evidence: Evidence) -> Iterator[Answer]:
        """Take what is known after a block; give each answer that differs from the last."""
        if evidence.change_count != self._change_count:
            # The tissue that was named is no longer under the probe.
            self._change_count = evidence.change_count
            self._decider = None
            self._answer = replace(self._answer, decided=None)
            if self._answer.classes is not None:
                yield self._say(evidence, None)
        elif evidence.is_mismatch != self._is_mismatch:
            # The label stands, but no longer without a reservation.
            yield self._say(evidence, self._answer.classes)
        estimate = evidence.estimate
        if estimate is None or not estimate.converged:
            yield from self._begin(evidence)
            return
        if evidence.block % _CLASSIFY_EVERY and self._answer.classes is not None:
            return
        classes = self._classes(evidence.stamp_ns, estimate, evidence.max_strain)
        if classes is None:
            yield from self._begin(evidence)
        elif self._is_news(classes):
            yield self._say(evidence, classes)

    def finish(self, stamp_ns: int, estimate: Estimate | None, max_strain: float) -> Answer:
        """Return the answer at the end of the contact; no other comes that it must stand for."""
        if estimate is None or not estimate.converged:
            return Answer()
        classes = self._classes(stamp_ns, estimate, max_strain, last=True)
        return Answer() if classes is None else replace(self._answer, classes=classes)

    def _begin(self, evidence: Evidence) -> Iterator[Answer]:
        """Say that nothing is decided, unless something was said before."""
        if self._answer.decision is Decision.NONE:
            yield self._say(evidence, None)

    def _is_news(self, classes: ClassProbabilities) -> bool:
        previous = self._answer.classes
        return (
            previous is None
            or previous.label != classes.label
            or any(
                abs(new - old) > _PROBABILITY_CHANGE
                for new, old in zip(classes.probabilities, previous.probabilities, strict=True)
            )
        )

    def _say(self, evidence: Evidence, classes: ClassProbabilities | None) -> Answer:
        decision = Decision.UNDETERMINED
        if classes is not None and classes.label:
            decision = Decision.UNKNOWN if classes.label == UNKNOWN else Decision.CLASS
        self._is_mismatch = evidence.is_mismatch
        self._answer = replace(self._answer, decision=decision, classes=classes)
        return self._answer

    def _classes(
        self, stamp_ns: int, estimate: Estimate, max_strain: float, *, last: bool = False
    ) -> ClassProbabilities | None:
        """Return the probabilities with the label that stands; None: nothing can be said."""
        classes, comparison = self._labeller.classes(self._site_id, self._position, estimate)
        self._answer = replace(self._answer, comparison=comparison)
        if classes is None:
            return None
        if self._decider is None:
            self._decider = Decider(self._labeller.decision)
        before = self._decider.label
        label = self._decider.update(stamp_ns, classes, last=last)
        if label != before:
            elapsed = (stamp_ns - self._start_ns) / NANOSECONDS
            decided = Decided(elapsed, max_strain) if label else None
            self._answer = replace(self._answer, decided=decided)
        return classes._replace(label=label)
