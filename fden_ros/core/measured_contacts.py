# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is measured of each contact: see :mod:`fden_ros.core.measured_stiffness`.

A press has the slopes where it was deepest, each of its widest window there; a place on a path
has the newest.
"""

from __future__ import annotations

from fden_ros.core.config import PipelineConfig
from fden_ros.core.measured_stiffness import (
    NOT_MEASURED,
    BothWays,
    MeasuredStiffness,
    StiffnessMeter,
)
from fden_ros.core.streams import Pair

#: Contacts that are remembered: the summary of one may come in the next.
_CONTACTS_KEPT = 3
#: Two windows reach as deep where they differ by less than this part of the width [1]: a window
#: ends where a piece does, of which it has eight or more.
_SLACK = 0.125


class MeasuredContacts:
    """Measures the stiffness, and keeps that of the newest contacts."""

    def __init__(self, config: PipelineConfig) -> None:
        contact = config.contact
        self._compliance_free = contact.compliance_free
        self._is_continuous = config.is_continuous
        self._meter = StiffnessMeter(
            max(contact.force_noise, contact.noise_floor), config.geometry.length
        )
        #: That of motion outside of any contact, where it was deepest: in the air, or where no
        #: touch was seen.
        self.unseen = NOT_MEASURED
        self._found: dict[int, BothWays] = {}
        self._was_in_contact = False
        self._kept = 0, NOT_MEASURED  # what was kept last, behind the contact that it is of

    @property
    def newest(self) -> BothWays:
        """The newest slopes."""
        return self._meter.newest

    def of(self, contact_id: int) -> BothWays:
        """Return what was measured of a contact."""
        return self._found.get(contact_id, NOT_MEASURED)

    def forget(self) -> None:
        """Forget the motion so far: the clock, or the place, is another."""
        self._meter.forget()

    def skip(self) -> None:
        """Take note that samples are missing, or that the force's zero is another."""
        self._meter.skip()

    def add(self, pair: Pair) -> None:
        """Take a sample, before the contact that it is of is known."""
        displacement = self._compliance_free(pair, pair.force)
        self._meter.add(pair.stamp_ns, displacement, pair.force)

    def assign(self, contact_id: int, *, in_contact: bool) -> None:
        """Assign what is known after a sample to the contact that the sample is of."""
        if in_contact or self._is_continuous:
            self._keep(contact_id)
        elif self._was_in_contact:
            # In the air there is none.
            self._meter.forget()
        elif self.newest is not NOT_MEASURED:
            self.unseen = _deepest(self.unseen, self.newest)
        self._was_in_contact = in_contact

    def _keep(self, contact_id: int) -> None:
        found, newest = self._found, self.newest
        last_id, last = self._kept
        if contact_id == last_id and newest is last:
            return
        self._kept = contact_id, newest
        if contact_id not in found:
            found[contact_id] = NOT_MEASURED
            if len(found) > _CONTACTS_KEPT:
                del found[min(found)]
        kept = found[contact_id]
        found[contact_id] = newest if self._is_continuous else _deepest(kept, newest)


def _deepest(kept: BothWays, new: BothWays) -> BothWays:
    return BothWays(*(_deeper(*each) for each in zip(kept, new, strict=True)))


def _deeper(
    kept: MeasuredStiffness | None, new: MeasuredStiffness | None
) -> MeasuredStiffness | None:
    """Return the one whose window reaches deeper, the new one where both are alike."""
    if kept is None or new is None:
        return new or kept
    reaches = new.depth + 0.5 * new.width + _SLACK * min(new.width, kept.width)
    return new if reaches >= kept.depth + 0.5 * kept.width else kept
