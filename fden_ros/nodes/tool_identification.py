# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The service ``~/identify_tool``: inputs go to a collection of turns, not to the pipeline."""

from __future__ import annotations

import time
from collections.abc import Callable

from fden_msgs.srv import IdentifyTool

from fden_ros.configure.finding import Finding
from fden_ros.configure.weight import MOTION, ToolAnswer, ToolCollection
from fden_ros.errors import InputError

#: A collection holds every sample: it is given up after this time [s].
_LONGEST = 120.0


class ToolIdentification:
    """What the service does from one call to the next.

    Parameters
    ----------
    begin : callable
        Returns an empty collection, and raises InputError where none can begin now.
    say : callable
        Takes a line for the log.
    """

    def __init__(self, begin: Callable[[], ToolCollection], say: Callable[[str], object]) -> None:
        self._begin, self._say = begin, say
        self._collection: ToolCollection | None = None
        self._began = 0.0

    @property
    def is_collecting(self) -> bool:
        """Whether the inputs are wanted here."""
        return self._collection is not None

    def add(self, what: str, data: bytes) -> None:
        """Take a message of ``force`` or ``displacement`` as CDR bytes."""
        assert self._collection is not None
        self._collection.add(what, data)

    def check_time(self) -> None:
        """Give up a collection that nobody ends."""
        if self._collection is not None and time.monotonic() - self._began > _LONGEST:
            self._collection = None
            self._say(f"given up after {_LONGEST:g} s: call again to begin anew")

    def end(self) -> None:
        """Forget what has been collected."""
        self._collection = None

    def answer(self, command: int, response: IdentifyTool.Response) -> IdentifyTool.Response:
        """Fill in the response to a call."""
        request = IdentifyTool.Request
        if command == request.COMMAND_CANCEL:
            self.end()
            response.message = "no longer collecting"
        elif command not in (request.COMMAND_NEXT, request.COMMAND_RESTART):
            response.message = f"there is no command {command}: it must be 0, 1 or 2"
        elif self._collection is None or command == request.COMMAND_RESTART:
            self._start(response)
        else:
            found = self._collection.answer()
            response.collected = self._collection.seconds
            _fill(response, found)
            if found.is_known:
                self.end()
        response.collecting = self.is_collecting
        self._say(response.message)
        return response

    def _start(self, response: IdentifyTool.Response) -> None:
        try:
            self._collection = self._begin()
        except InputError as error:
            response.message = str(error)
            return
        self._began = time.monotonic()
        response.message = f"collecting, nothing is estimated meanwhile: {MOTION}; then ask again"


def _fill(response: IdentifyTool.Response, found: ToolAnswer) -> None:
    response.success, response.message = found.is_known, found.words
    if found.mass is not None:
        response.mass, response.mass_sd = _number(found.mass), found.mass.deviation or 0.0
        response.gravity = found.mass.parameters.get("tool.gravity", [0.0, 0.0, 0.0])
    if found.centre is not None:
        response.centre_known = True
        response.centre_of_mass = found.centre.parameters["tool.centre_of_mass"]
        response.centre_of_mass_sd = found.centre.deviation or 0.0


def _number(finding: Finding) -> float:
    assert isinstance(finding.value, float)
    return finding.value
