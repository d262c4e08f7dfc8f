# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The delay of estimates behind their samples, and its remedy."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Lag:
    """The ages of estimates when they were published [s].

    An age is counted from when the middleware received the sample that completed the estimate: the
    stamp of a sample may be of a foreign or simulated clock.
    """

    newest: float = 0.0
    late_count: int = 0  #: so far
    _late_before: int = 0
    _lags: list[float] = field(default_factory=list)

    def add(self, lag: float, *, is_late: bool) -> None:
        """Add the age of one estimate."""
        self.newest = lag
        self.late_count += is_late
        self._lags.append(lag)

    def look(self) -> tuple[float, list[str]]:
        """Return the largest age since the last look, and the problem."""
        late, count, most = (
            self.late_count - self._late_before,
            len(self._lags),
            max(self._lags, default=0.0),
        )
        self._late_before = self.late_count
        self._lags.clear()
        if not late:
            return most, []
        return most, [
            f"the machine is too slow: {late} of {count} estimates were late, up to {most:.2f} s "
            "behind their samples; give the node a core or priority, or double estimate.period"
        ]
