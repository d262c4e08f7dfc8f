# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The content of a report on a recording: gathered during its replay, in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.config import PipelineConfig
from fden_ros.core.outputs import ContactSummary, Output, Status, TissueState
from fden_ros.core.streams import NANOSECONDS, Pair
from fden_ros.offline.replay import Replay, replay
from fden_ros.parameters import Parameters, pipeline_config
from fden_ros.recording.places import place
from fden_ros.recording.reader import BagReader, read_truth
from fden_ros.recording.source import Selection, is_table

#: The first 60 contacts are shown in detail, of the others the summary.
DETAILED_CONTACTS = 60
#: Sufficient points of a curve, of a contact and of the recording.
_STATES_A_CONTACT, _STRETCHES = 700, 1500


@dataclass
class Contact:
    """One contact: its summary and every 2^k-th state that led to it, of a bounded number."""

    contact_id: int
    summary: ContactSummary | None = None
    states: list[Any] = field(default_factory=list)
    _stride: int = 1
    _count: int = 0

    def add(self, state: TissueState) -> None:
        """Add the next state; a series that grows too long halves itself."""
        if self._count % self._stride == 0:
            self.states.append(state)
            if len(self.states) >= _STATES_A_CONTACT:
                del self.states[1::2]
                self._stride *= 2
        self._count += 1


class Trace:
    """Least and largest force and displacement in each of a bounded number of stretches."""

    def __init__(self) -> None:
        self._width_ns = 1_000_000
        self._rows: dict[int, tuple[float, ...]] = {}
        self.start_ns = self.end_ns = 0  #: of the first and the newest pair

    def add(self, pair: Pair) -> None:
        """Add a pair of samples."""
        self.start_ns, self.end_ns = self.start_ns or pair.stamp_ns, pair.stamp_ns
        index = pair.stamp_ns // self._width_ns
        self._keep(index, (pair.force, pair.force, pair.displacement, pair.displacement))
        if len(self._rows) > _STRETCHES:
            rows, self._rows = self._rows, {}
            self._width_ns *= 2
            for index, row in rows.items():
                self._keep(index // 2, row)

    def _keep(self, index: int, row: tuple[float, ...]) -> None:
        old = self._rows.get(index, row)
        ends = zip((min, max, min, max), old, row, strict=True)
        self._rows[index] = tuple(end(a, b) for end, a, b in ends)

    def arrays(self) -> tuple[Array, Array]:
        """Return times since the start [s], and ends of force [N] and displacement [m], (n, 4)."""
        indices = sorted(self._rows)
        middle = self._width_ns // 2 - self.start_ns
        time = (np.array(indices, dtype=np.int64) * self._width_ns + middle) / NANOSECONDS
        return time, np.array([self._rows[index] for index in indices]).reshape(-1, 4)


@dataclass(frozen=True)
class Session:
    """A recording as a report shows it."""

    path: Path
    parameters: Parameters
    replay: Replay
    contacts: list[Contact]
    trace: Trace
    config: PipelineConfig
    truth: dict[int, dict[str, Any]]  #: by site, of simulated recordings

    def seconds(self, stamp_ns: int) -> float:
        """Return the time since the first pair of a stamp of `contacts`, not of `replay` [s]."""
        return (stamp_ns - self.trace.start_ns) / NANOSECONDS


def gather(
    bag: str | Path,
    parameters: Parameters,
    selection: Selection | None = None,
    *,
    progress: bool = False,
) -> Session:
    """Replay a recording as :func:`fden_ros.offline.replay.replay` does; keep the report data."""
    contacts: list[Contact] = []
    trace = Trace()

    def contact(contact_id: int) -> Contact:
        if not contacts or contacts[-1].contact_id != contact_id:
            contacts.append(Contact(contact_id))
        return contacts[-1]

    def take(output: Output, frame: str) -> None:
        if isinstance(output, ContactSummary):
            contact(output.contact_id).summary = output
        elif isinstance(output, TissueState) and output.contact_id:
            is_shown = output.status in (Status.CONVERGING, Status.CONVERGED)
            if is_shown and len(contacts) <= DETAILED_CONTACTS:
                contact(output.contact_id).add(output)

    result = replay(
        bag, parameters, selection, progress=progress, on_output=take, on_pair=trace.add
    )
    truth = None if is_table(bag, selection) else read_truth(BagReader(bag))
    return Session(
        path=place(bag),
        parameters=result.parameters,
        replay=result,
        contacts=[one for one in contacts if one.summary is not None],
        trace=trace,
        config=pipeline_config(result.parameters),
        truth={site["site"]: site for site in truth["sites"]} if truth else {},
    )
