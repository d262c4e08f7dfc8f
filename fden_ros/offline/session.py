# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a report shows of a recording: gathered while it is replayed, in bounded memory."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation import Innovation
from fden_ros.core.law import Geometry
from fden_ros.core.outputs import (
    ContactSummary,
    Output,
    Status,
    TissueState,
)
from fden_ros.core.streams import NANOSECONDS
from fden_ros.offline.replay import Replay, replay
from fden_ros.offline.signals import Envelope, signals_of
from fden_ros.parameters import Parameters, pipeline_config
from fden_ros.recording.places import place
from fden_ros.recording.reader import BagReader, read_truth
from fden_ros.recording.source import Selection, is_table, open_source

#: The first 60 contacts are shown in detail, of the others the summary.
DETAILED_CONTACTS = 60
#: More points than a curve needs: a series has this many, or half of it at least.
_STATES_A_CONTACT = 700
#: So many of white innovations are taken for white by a test [1].
_CONFIDENCE = 0.99


@dataclass
class Thinned:
    """A series that halves itself when it grows too long: every 2^k-th of what was added."""

    limit: int
    items: list[Any] = field(default_factory=list)
    _stride: int = 1
    _count: int = 0

    def add(self, item: Any) -> None:
        """Take the next item."""
        if self._count % self._stride == 0:
            self.items.append(item)
            if len(self.items) >= self.limit:
                del self.items[1::2]
                self._stride *= 2
        self._count += 1


@dataclass(frozen=True)
class InnovationTest:
    """Whether innovations are as large, and as white, as the filter says.

    If they are, the sum of the normalised squares is chi-squared with as many degrees of freedom
    as there are, and their correlation with the one before is normal with variance 1/count
    (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    ch. 5.4).
    """

    count: int
    mean_square: float  #: mean of the normalised innovation squared [1]; 1 expected
    low: float  #: interval that holds `mean_square` with 99 % if the filter is right
    high: float
    correlation: float  #: of neighbours [1]; 0 expected
    correlation_limit: float  #: its magnitude stays below this with 99 % if they are white

    @property
    def verdict(self) -> str:
        """The outcome in words."""
        if self.count < 10:
            return "too few innovations for a test"
        size = "as large as the noise explains"
        if self.mean_square > self.high:
            size = "larger than the noise explains: the model or the stated noise is off"
        elif self.mean_square < self.low:
            size = "smaller than the stated noise: the intervals are wider than they need be"
        if abs(self.correlation) <= self.correlation_limit:
            return f"{size}; white"
        likeness = "resemble" if self.correlation > 0.0 else "are opposed to"
        return f"{size}; not white: neighbours {likeness} each other"


@dataclass
class Innovations:
    """Sums over the innovations of a contact, each divided by its standard deviation."""

    count: int = 0
    _sum: float = 0.0
    _square: float = 0.0
    _product: float = 0.0
    _previous: float | None = None

    def add(self, innovation: Innovation) -> None:
        """Take the next innovation."""
        normalized = normalized_innovation(innovation)
        self.count += 1
        self._sum += normalized
        self._square += normalized**2
        if self._previous is not None:
            self._product += normalized * self._previous
        self._previous = normalized

    @property
    def mean_square(self) -> float | None:
        """Mean of the normalised innovation squared [1]; None without any."""
        return self._square / self.count if self.count else None

    @property
    def test(self) -> InnovationTest | None:
        """Their test; None with fewer than two."""
        n = self.count
        if n < 2:
            return None
        tail = 0.5 * (1.0 - _CONFIDENCE)
        mean = self._sum / n
        variance = max(self._square / n - mean**2, 1e-300)
        return InnovationTest(
            count=n,
            mean_square=self._square / n,
            low=float(chi2.ppf(tail, n)) / n,
            high=float(chi2.ppf(1.0 - tail, n)) / n,
            correlation=(self._product / (n - 1) - mean**2) / variance,
            correlation_limit=2.576 / math.sqrt(n),
        )


@dataclass
class Contact:
    """One contact: its summary and, in detail, what led to it."""

    contact_id: int
    states: Thinned = field(default_factory=lambda: Thinned(_STATES_A_CONTACT))
    summary: ContactSummary | None = None
    innovations: Innovations = field(default_factory=Innovations)

    def add(self, state: TissueState) -> None:
        """Take a state of this contact."""
        self.states.add(state)
        if state.innovation is not None:
            self.innovations.add(state.innovation)


@dataclass(frozen=True)
class Session:
    """A recording as a report shows it."""

    path: Path
    parameters: Parameters
    replay: Replay
    contacts: list[Contact]
    force: Envelope
    displacement: Envelope
    start_ns: int
    end_ns: int
    config: PipelineConfig
    truth: dict[int, dict[str, Any]]  #: by site, of simulated recordings

    @property
    def geometry(self) -> Geometry:
        """Of the probe and the tissue."""
        return self.config.geometry

    @property
    def duration(self) -> float:
        """From the first to the last sample [s]."""
        return (self.end_ns - self.start_ns) / NANOSECONDS


def gather(
    bag: str | Path,
    parameters: Parameters,
    selection: Selection | None = None,
    *,
    progress: bool = False,
) -> Session:
    """Replay a recording and keep what a report shows.

    Parameters
    ----------
    bag, parameters, selection, progress
        As for :func:`fden_ros.offline.replay.replay`.

    Raises
    ------
    InputError
        As :func:`fden_ros.offline.replay.replay`.
    """
    gatherer = _Gatherer()
    result = replay(bag, parameters, selection, progress=progress, on_output=gatherer.take)
    signals = signals_of(open_source(bag, parameters, selection), result.parameters)
    return Session(
        path=place(bag),
        parameters=result.parameters,
        replay=result,
        contacts=[c for c in gatherer.contacts if c.summary is not None],
        force=signals.force,
        displacement=signals.displacement,
        start_ns=signals.start_ns or 0,
        end_ns=signals.end_ns,
        config=pipeline_config(result.parameters),
        truth=_truth(bag, selection),
    )


def _truth(bag: str | Path, selection: Selection | None) -> dict[int, dict[str, Any]]:
    if is_table(bag, selection):
        return {}
    truth = read_truth(BagReader(bag))
    return {site["site"]: site for site in truth["sites"]} if truth else {}


class _Gatherer:
    """Takes the outputs, contact by contact."""

    def __init__(self) -> None:
        self.contacts: list[Contact] = []

    def take(self, output: Output, frame: str) -> None:
        if isinstance(output, TissueState):
            if output.status in (Status.CONVERGING, Status.CONVERGED) and output.contact_id:
                contact = self._contact(output.contact_id)
                if len(self.contacts) <= DETAILED_CONTACTS:
                    contact.add(output)
        elif isinstance(output, ContactSummary):
            self._contact(output.contact_id).summary = output

    def _contact(self, contact_id: int) -> Contact:
        if not self.contacts or self.contacts[-1].contact_id != contact_id:
            self.contacts.append(Contact(contact_id))
        return self.contacts[-1]


def normalized_innovation(innovation: Innovation) -> float:
    """Return the innovation over its standard deviation [1]."""
    return innovation.innovation / math.sqrt(innovation.variance)


def predicted_stress(contact: Contact) -> tuple[Array, Array]:
    """Return time [s] and predicted stress [Pa], shape (n,) each."""
    states = [
        s for s in contact.states.items if s.signals is not None and s.innovation is not None
    ]
    if len(states) < 2:
        return np.zeros(0), np.zeros(0)
    time = np.array([(s.stamp_ns - states[0].stamp_ns) / NANOSECONDS for s in states])
    return time, np.array([s.innovation.predicted_stress for s in states])
