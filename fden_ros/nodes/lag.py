# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How long after their samples estimates come, and what that asks for."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Lag:
    """The ages of estimates when they were published [s].

    The age of one is counted from when the middleware received the sample that completed it: the
    stamp of a sample may be of a foreign or simulated clock.
    """

    newest: float = 0.0
    late_count: int = 0  #: so far
    _late_before: int = 0
    _lags: list[float] = field(default_factory=list)

    def add(self, lag: float, *, is_late: bool) -> None:
        """Take the age of one."""
        self.newest = lag
        self.late_count += is_late
        self._lags.append(lag)

    def look(self) -> Lags:
        """Return those since the last look."""
        found = Lags(tuple(self._lags), self.late_count - self._late_before)
        self._lags.clear()
        self._late_before = self.late_count
        return found


@dataclass(frozen=True)
class Lags:
    """The ages of estimates over some time."""

    lags: tuple[float, ...] = ()  #: [s]
    late: int = 0  #: of them

    @property
    def most(self) -> float:
        """The largest [s]."""
        return max(self.lags, default=0.0)

    @property
    def problem(self) -> str:
        """That estimates are late, and what mends it; empty: none is."""
        if not self.late:
            return ""
        return (
            f"the machine is too slow: {self.late} of {len(self.lags)} estimates were late, up to "
            f"{self.most:.2f} s behind their samples; give the node a core or priority (nice), or "
            "set estimate.period to twice what it is"
        )
