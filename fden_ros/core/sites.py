# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The sites that were touched, and the choice of the site of a touch."""

from __future__ import annotations

from fden_ros.core.config import PipelineConfig
from fden_ros.core.contact import Onset
from fden_ros.core.outputs import Flag
from fden_ros.core.site import Site, dips
from fden_ros.core.streams import Position

#: Number of sites whose tissue is remembered, so that a second press of a place is recognised [1].
_MOST_VISITED = 16


class Sites:
    """The present site and those that were visited before.

    `flags` apply to every estimate.
    """

    def __init__(self, config: PipelineConfig, flags: Flag) -> None:
        self._config, self._flags = config, flags
        self.count = 0  #: so far
        self.forget()

    def forget(self) -> None:
        """Drop all but their number."""
        self.present: Site | None = None
        self.visited: list[Site] = []

    def of(self, onset: Onset, left_unseen_ns: int | None) -> Site:
        """Return the site of a touch, which becomes the present one.

        The probe may have left a tissue unseen at `left_unseen_ns`.
        """
        before, first = self.present, onset.samples[0]
        is_elsewhere = before.is_elsewhere(onset) if before is not None else True
        if before is not None and is_elsewhere is False:
            if not before.begins_anew(first.stamp_ns):
                return before
        elif before is not None and is_elsewhere:
            before.put_away()
        past = self._at(first.position) if is_elsewhere else before
        if past is not None and is_elsewhere and not past.begins_anew(first.stamp_ns):
            site = past
        else:
            site = self._new(onset, past)
        is_doubted = left_unseen_ns is not None and dips(first.stamp_ns - left_unseen_ns)
        if is_doubted or (before is not None and before.leaves_doubt(first.stamp_ns)):
            site.withdraw()
        self.present = site
        return site

    def _at(self, position: Position | None) -> Site | None:
        """Return the newest site at a position whose tissue may remember what was seen there."""
        known = (s for s in reversed(self.visited) if s.is_observed or s.misses_samples)
        return next((s for s in known if s.whereabouts.is_at(position)), None)

    def _new(self, onset: Onset, past: Site | None) -> Site:
        """Return a new site; `past` was perhaps the same place."""
        self.count += 1
        site = Site(self.count, onset, self._config, self._flags)
        self.visited = [*self.visited[1 - _MOST_VISITED :], site]
        if past is not None and past.misses_past(onset.samples[0].stamp_ns):
            site.flags |= Flag.GAP
        return site

    def drop(self) -> None:
        """Drop the present site: the next one must not inherit its origin."""
        self.visited = [site for site in self.visited if site is not self.present]
        self.present = None
