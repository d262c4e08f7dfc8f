# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The service ``~/identify_tool``: inputs go to a collection of turns, not to the pipeline."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fden_msgs.srv import IdentifyTool

from fden_ros.configure.finding import TURN, Finding
from fden_ros.configure.reading import Column, reading_of
from fden_ros.configure.weight import find_weight, weight_findings
from fden_ros.errors import InputError
from fden_ros.recording.reader import Topic
from fden_ros.recording.source import Selection

#: A collection holds every sample: it is given up after this time [s].
_LONGEST = 120.0
#: What says something of a tool's weight.
_NEEDED = {
    "force": ("geometry_msgs/msg/WrenchStamped",),
    "displacement": ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped"),
}


@dataclass(frozen=True)
class ToolAnswer:
    """What the turns tell of the tool by now.

    Parameters
    ----------
    is_known : bool
        ``tool.*`` can be set by it.
    words : str
        The answer in one line; where it is not known, why, and the motion that would tell.
    found : tuple of Finding
        Mass [kg] and centre of mass in the sensor's frame [m], as far as they are known.
    """

    is_known: bool
    words: str
    found: tuple[Finding, ...] = ()


class ToolCollection:
    """Forces and orientations since the collection began.

    Parameters
    ----------
    force, displacement : Topic
        Where they come from: a wrench, and a pose or a transform of the sensor.
    needs_centre : bool
        Whether the centre of mass counts, as for a torque.

    Raises
    ------
    InputError
        If one of the types says nothing of a tool's weight.
    """

    def __init__(self, force: Topic, displacement: Topic, *, needs_centre: bool) -> None:
        topics = {"force": force, "displacement": displacement}
        for what, topic in topics.items():
            if topic.type_name not in _NEEDED[what]:
                raise InputError(
                    f"{topic.name} is a {topic.type_name.replace('/msg/', '/')}: the tool's "
                    "weight wants a wrench and the orientation of a pose or transform "
                    "(force.message, displacement.message)"
                )
        self._needs_centre = needs_centre
        self._columns = {what: Column(topic, None, what) for what, topic in topics.items()}

    def add(self, what: str, data: bytes) -> None:
        """Take a message of ``force`` or ``displacement`` as CDR bytes."""
        self._columns[what].add(data, 0)

    @property
    def seconds(self) -> float:
        """From the first stamp of the force to its last [s]."""
        stamps = self._columns["force"].stamps
        return 1e-9 * (stamps[-1] - stamps[0]) if stamps else 0.0

    def answer(self) -> ToolAnswer:
        """Return what is known by now."""
        try:
            streams = [reading_of(Path("live"), self._columns, Selection()).streams]
        except InputError as error:
            return ToolAnswer(False, f"{error}".removeprefix("live: "))
        mass, centre = weight_findings(find_weight(streams), streams)
        if not mass.claim or not mass.parameters:
            ask = f": {mass.motion}; then ask again" if mass.motion else ""
            return ToolAnswer(False, mass.evidence + ask, (mass,) if mass.claim else ())
        if not mass.value:
            return ToolAnswer(True, f"tool.mass: 0 kg; {mass.evidence}", (mass,))
        if self._needs_centre and not centre.claim:
            words = f"{_words(mass)}, but {centre.evidence}: {centre.motion}; then ask again"
            return ToolAnswer(False, words, (mass,))
        found = tuple(finding for finding in (mass, centre) if finding.claim)
        words = ", ".join(map(_words, found))
        return ToolAnswer(
            True, f"{words}: put them into the parameter file and configure anew", found
        )


def _words(finding: Finding) -> str:
    """Return the parameters that a finding sets, as in ``tool.mass: 0.3 ± 0.001 kg``."""
    said = []
    for name, value in finding.parameters.items():
        measured = f" ± {finding.deviation:.2g} {finding.unit}"
        said.append(f"{name}: {value}{' m/s^2' if name == 'tool.gravity' else measured}")
    return ", ".join(said)


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
        response.message = f"collecting, nothing is estimated meanwhile: {TURN}; then ask again"


def _fill(response: IdentifyTool.Response, answer: ToolAnswer) -> None:
    response.success, response.message = answer.is_known, answer.words
    for finding in answer.found:
        told, sd = finding.parameters, finding.deviation or 0.0
        if finding.subject == "tool mass":
            assert isinstance(finding.value, float)
            response.mass, response.mass_sd = finding.value, sd
            response.gravity = told.get("tool.gravity", [0.0, 0.0, 0.0])
        else:
            response.centre_known, response.centre_of_mass_sd = True, sd
            response.centre_of_mass = told["tool.centre_of_mass"]
