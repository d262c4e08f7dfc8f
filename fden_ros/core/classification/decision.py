# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""From probabilities that move to a label that stands: hysteresis, in amount and in time."""

from __future__ import annotations

from dataclasses import dataclass

from fden_ros.core.classification.classifier import UNKNOWN, ClassProbabilities
from fden_ros.core.streams.samples import NANOSECONDS

#: An unknown place becomes known when its typicality exceeds the significance by this factor.
_TEST_HYSTERESIS = 2.0


@dataclass(frozen=True)
class DecisionConfig:
    """When a label is given, and when it is taken back.

    Parameters
    ----------
    probability : float
        A class becomes the label when its probability is at least this [1].
    release : float
        It stays the label while its probability is at least this [1]; below `probability`.
    dwell : float
        Another answer replaces the label when it has stood for this time [s].
    significance : float
        A place is unknown when its typicality, the share of contacts with the best fitting tissue
        that lie as far from its centre, is below this [1]: the share of false unknowns.
    """

    probability: float = 0.7
    release: float = 0.5
    dwell: float = 0.2
    significance: float = 0.06


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
