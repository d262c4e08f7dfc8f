# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A computation in parts, so that samples need not wait for the whole of it.

It is a generator that gives what each part has cost, in points evaluated: never in time, so that
what comes of a recording is what came of it live, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")

#: A computation: it gives the cost of each part, and returns the result.
Parts = Generator[int, None, Result]


class Limit:
    """What a computation may cost in all; beyond it, it ends with what it has.

    `most`: points evaluated.
    """

    def __init__(self, most: float = math.inf) -> None:
        self._left = most

    @property
    def is_reached(self) -> bool:
        """Whether it has cost as much."""
        return self._left <= 0.0

    def counted(self, parts: Parts[Result]) -> Parts[Result]:
        """Give the parts of a computation, and count them."""
        try:
            while True:
                cost = next(parts)
                self._left -= cost
                yield cost
        except StopIteration as end:
            return end.value


def ended(parts: Parts[Result]) -> Result:
    """Return the result of a computation, all of it now."""
    try:
        while True:
            next(parts)
    except StopIteration as end:
        return end.value


class Advanced(Generic[Result]):
    """A computation that is advanced by budgets.

    `begin`: begins it; what it computes from does not change.
    """

    def __init__(self, begin: Callable[[], Parts[Result]]) -> None:
        self._begin, self._parts = begin, begin()
        self._taken, self._debt = 0, 0.0
        self._found: Result | None = None
        self._failed: Exception | None = None
        self.has_ended = False

    def advance(self, budget: float) -> bool:
        """Go on by parts of a cost; return whether it has ended.

        What a part has cost more is taken off the next budget.
        """
        left = budget - self._debt
        try:
            while left > 0 and not self.has_ended:
                left -= next(self._parts)
                self._taken += 1
        except StopIteration as end:
            self._found, self.has_ended = end.value, True
        except Exception as failure:  # it is raised where the result is asked for
            self._failed, self.has_ended = failure, True
        self._debt = max(-left, 0.0)
        return self.has_ended

    def result(self) -> Result:
        """Return the result, all that is left of it now; raise what it has raised."""
        while not self.has_ended:
            self.advance(math.inf)
        if self._failed is not None:
            raise self._failed
        return self._found  # type: ignore[return-value]

    def __getstate__(self) -> dict[str, Any]:
        """Return it without the generator, which is not pickled: it is brought there anew."""
        return self.__dict__ | {"_parts": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Go on from where it was."""
        self.__dict__.update(state)
        self._parts = self._begin()
        for _ in range(0 if self.has_ended else self._taken):
            next(self._parts)
