# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The input of a replay: a bag or a table, message by message or row by row, into the pipeline."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

from fden_ros.core.arrays import Array
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams import NANOSECONDS
from fden_ros.errors import InputError
from fden_ros.inputs import (
    DAMAGED,
    TRANSFORM_TOPICS,
    TRANSFORMS,
    TYPE_NAMES,
    Inputs,
    inputs_of,
    stamp_ns,
    stream_of,
)
from fden_ros.parameters import Parameters, frames_config
from fden_ros.recording.bag_files import RawMessage, Topic
from fden_ros.recording.fields import FieldPath, decoder_of, hint_of
from fden_ros.recording.machine import machine_values
from fden_ros.recording.places import called, copied, is_remote, place, reached
from fden_ros.recording.reader import BagReader
from fden_ros.recording.stamps import LOOKED_AT, carried_stamp, problems
from fden_ros.recording.table import Columns, TableReader
from fden_ros.recording.text import looks_like_a_table
from fden_ros.recording.topics import (
    NoTopicError,
    find_topic,
    is_commanded,
    topic_with_messages,
)

_ALWAYS = ("force", "displacement")
_JOINTS = TYPE_NAMES["force"]["joint_state"]

#: Line of a parameter file with the options for force and displacement of a recording.
SELECTION_LINE = "# Recording: "


@dataclass(frozen=True)
class Selection:
    """The sources of force, displacement and the like in a recording; unnamed ones are found.

    A field is one of that topic's messages, of whatever type they are: a number, or a vector that
    is projected on the configured axis.
    """

    topics: Mapping[str, str] = field(default_factory=dict)  #: by the name of the input
    fields: Mapping[str, str] = field(default_factory=dict)
    columns: Columns | None = None  #: of a table
    where: tuple[str, str] | None = None  #: column and text of a table's rows that are used
    stamps: str = "header"  #: of a bag's messages; or ``recording``, the time of their recording
    from_touch: bool | None = None  #: whether a table begins at the touch; None: by its preamble

    def options(self) -> list[str]:
        """Return the options of commands that select the same."""
        named = {f"--{stream}-topic": name for stream, name in self.topics.items()}
        named |= {f"--{stream}-field": path for stream, path in self.fields.items()}
        named |= {"--stamps": self.stamps} if self.stamps != "header" else {}
        named |= {"--rows": "=".join(self.where)} if self.where is not None else {}
        named |= {"--columns": str(self.columns)} if self.columns is not None else {}
        return [word for option in named.items() for word in option]


def is_table(path: str | Path, selection: Selection | None) -> bool:
    """Return whether a recording is read as a table."""
    return (selection is not None and selection.columns is not None) or looks_like_a_table(path)


def open_source(
    path: str | Path, parameters: Parameters, selection: Selection | None = None
) -> Source:
    """Return the recording at `path`."""
    chosen = selection or Selection()
    if is_table(path, chosen):
        return _open_table(place(path), parameters, chosen)
    if chosen.from_touch or chosen.where is not None:
        option = "--from-touch" if chosen.from_touch else "--rows"
        raise InputError(f"{path} is not a table: {option} is for tables")
    return BagSource(path, parameters, chosen)


def _open_table(path: Path, parameters: Parameters, selection: Selection) -> RowSource:
    for name, is_set, what in (
        ("tool.mass", bool(parameters.tool.mass), "the tool's orientation"),
        ("displacement.along_tool", parameters.displacement.along_tool, "the same"),
        ("frames.base", bool(parameters.frames.base), "transforms"),
    ):
        if is_set:
            raise InputError(
                f"{name} needs {what}, which a table does not hold: unset it, or replay a bag"
            )
    with TemporaryDirectory(prefix="fden_") as folder:
        with reached(path):
            here = copied(path, folder) if is_remote(path) else path
        with called(here, path):
            table = TableReader(here, selection.columns, selection.where)
            found = machine_values(table, parameters, selection.from_touch)
    columns = table.columns
    values, set_by_recording, questions = found
    return RowSource(
        (table.stamps, table.force, table.displacement),
        parameters.changed(values) if values else parameters,
        {
            "force": table.named(columns.force),
            "displacement": table.named(columns.displacement),
            "time": table.named(columns.time),
        },
        (*table.warnings, *questions),
        set_by_recording,
    )


class BagSource:
    """A bag whose topics of force and displacement are known.

    It can be fed into a pipeline, once.
    """

    set_by_recording: tuple[str, ...] = ()
    shift_ns = 0

    def __init__(self, path: str | Path, parameters: Parameters, selection: Selection) -> None:
        self.reader = BagReader(path)
        self.parameters = parameters
        self._is_stamped = selection.stamps == "header" and parameters.stamp_source == "header"
        wanted = ("force",) if parameters.displacement.message == "tf" else _ALWAYS
        self._paths = {s: FieldPath(selection.fields[s]) for s in wanted if s in selection.fields}
        self.topics: dict[str, Topic] = {}
        for stream in wanted:
            name = selection.topics.get(stream)
            try:
                if name is not None and stream in self._paths:
                    self.topics[stream] = topic_with_messages(self.reader, name)
                else:
                    others = self.topics.values()
                    self.topics[stream] = find_topic(self.reader, name, stream, others)
            except NoTopicError as error:
                named = {**selection.topics, **self.topics}
                hint = hint_of(self.reader, [one for one in wanted if one not in named])
                raise InputError(str(error), hint) from None
        self._frames = frames_config(parameters)
        if self._frames is not None:
            self._find_transforms()
        self._notes = [
            f"{topic.name} is commanded, not measured, as its name says"
            for topic in self._measured.values()
            if is_commanded(topic)
        ]
        self.stamp_problems: list[str] = []
        self._inputs: Inputs | None = None

    def _find_transforms(self) -> None:
        for topic in self.reader.topics:
            stream = "/" + topic.name.rpartition("/")[2]
            if stream in TRANSFORM_TOPICS and topic.type_name == TRANSFORMS:
                self.topics[stream] = topic
        if not set(self.topics) & set(TRANSFORM_TOPICS):
            raise InputError(
                f"{self.reader.path}: frames.base is set, but the bag has no transforms: record "
                "/tf and /tf_static too, or unset frames.base"
            )

    @property
    def _measured(self) -> dict[str, Topic]:
        return {stream: topic for stream, topic in self.topics.items() if stream in _ALWAYS}

    @property
    def force(self) -> Topic:
        """Topic of the force."""
        return self.topics["force"]

    @property
    def total(self) -> int:
        """Messages on the topics used."""
        return sum(topic.message_count for topic in set(self.topics.values()))

    @property
    def inputs(self) -> dict[str, str]:
        """Topic of each quantity, with the field where one is configured."""
        names = {stream: topic.name for stream, topic in self.topics.items()}
        names |= {stream: f"{names[stream]} {path.text}" for stream, path in self._paths.items()}
        if self._frames is not None and self._frames.moves_probe:
            names["displacement"] = f"{self._frames.probe} in {self._frames.base}"
        order = (*_ALWAYS, *TRANSFORM_TOPICS)
        return {stream.lstrip("/"): names[stream] for stream in order if stream in names}

    @property
    def warnings(self) -> tuple[str, ...]:
        """The problems of the bag."""
        return (*self.stamp_problems, *self.reader.warnings, *self._notes)

    @property
    def frame(self) -> str:
        """frame_id of the force so far."""
        return self._inputs.force_frame if self._inputs is not None else ""

    @property
    def displacement_frame(self) -> str:
        """frame_id of the positions so far."""
        return self._inputs.displacement_frame if self._inputs is not None else ""

    def feed(
        self, sink: Pipeline | Inputs, before: Callable[[int, RawMessage | None], None]
    ) -> Iterator[int]:
        """Feed `sink` the messages in the order of their recording, and yield the steps done.

        `before` is called with the time of recording (ns) and the message before its sample is
        added. Inputs add the measurements unchanged.
        """
        self._inputs = inputs = inputs_of(self.parameters, sink)
        if inputs is not sink:
            self._note_joints()
        handlers: dict[str, list[Callable[[RawMessage], None]]] = {}
        for stream, topic in self.topics.items():
            handlers.setdefault(topic.name, []).append(self._handler(stream, topic, inputs))
        for done, message in enumerate(self.messages(handlers), start=1):
            before(message.log_time_ns, message)
            for handle in handlers[message.topic]:
                handle(message)
            yield done

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of topics.

        Problems of the stamps of force, displacement and the like are added to the warnings.
        """
        if self._is_stamped:
            stamps: dict[str, list[tuple[int, int]]] = {}
            for topic in self._measured.values():
                pairs = stamps[topic.name] = []
                for sample, time_ns in self._first(topic, LOOKED_AT):
                    stamp = carried_stamp(sample)
                    pairs.append((time_ns if stamp is None else stamp_ns(stamp), time_ns))
            self.stamp_problems = problems(stamps)
        return self.reader.messages(topics)

    def _first(self, topic: Topic, most: int) -> Iterator[tuple[Any, int]]:
        """Yield the first messages of a topic, decoded, with their times of recording [ns]."""
        decode = decoder_of(topic)
        for message in itertools.islice(self.reader.messages([topic.name]), most):
            with contextlib.suppress(Exception):  # counted as damaged where it is used
                yield decode(message.data), message.log_time_ns

    def _note_joints(self) -> None:
        """Warn which of several joints is used where none is named."""
        for stream, topic in self._measured.items():
            is_named = stream in self._paths or getattr(self.parameters, stream).name
            if is_named or topic.type_name != _JOINTS:
                continue
            for sample, _ in self._first(topic, 1):
                if len(sample.name) > 1:
                    self.note(
                        f"{topic.name} has the joints {', '.join(sample.name)}: the first is the "
                        f"{stream}; name another by {stream}.name, as `fden configure` does"
                    )

    def _handler(self, stream: str, topic: Topic, inputs: Inputs) -> Callable[[RawMessage], None]:
        """Return the function that feeds the messages of a topic."""
        decode, path = decoder_of(topic), self._paths.get(stream)

        def handle(message: RawMessage) -> None:
            try:
                sample = decode(message.data)
            except Exception:  # damaged bytes raise errors of every kind
                inputs.reject(stream_of(stream), DAMAGED)
                return
            if path is None:
                inputs.add(stream, sample, None if self._is_stamped else message.log_time_ns)
                return
            try:
                value = path.number_or_vector(sample)
            except InputError as error:
                why = f"{topic.name}: {error}: choose another field with --{stream}-field"
                raise InputError(why) from None
            carried = carried_stamp(sample) if self._is_stamped else None
            if carried is None and self._is_stamped:
                self.note(
                    f"{topic.name} carries no stamps: the times of recording are used, which "
                    "jitter"
                )
            stamp = message.log_time_ns if carried is None else stamp_ns(carried)
            frame = str(getattr(getattr(sample, "header", None), "frame_id", ""))
            if stream == "force":
                inputs.add_force(frame, stamp, value)
            else:
                turn = path.orientation(sample)
                inputs.add_displacement(frame, stamp, value, turn)

        return handle

    def note(self, text: str) -> None:
        """Add a warning, once."""
        if text not in self._notes:
            self._notes.append(text)


@dataclass(frozen=True, eq=False)
class RowSource:
    """A table, or arrays, fed row by row."""

    #: Stamps [ns], force [N] and displacement [m], shape (n,) each; NaN where a row has none.
    columns: tuple[Any, Array, Array]
    parameters: Parameters  #: with the table's own values
    inputs: dict[str, str]  #: column of each quantity
    warnings: tuple[str, ...] = ()  #: its problems and open questions
    set_by_recording: tuple[str, ...] = ()  #: the parameters from the table, a line each
    frame: str = ""
    displacement_frame: str = ""

    @property
    def shift_ns(self) -> int:
        """What :meth:`feed` adds to the stamps: 0 stands for "no stamp" everywhere in ROS [ns]."""
        stamps = self.columns[0]
        return NANOSECONDS - int(stamps[0]) if stamps.size and stamps[0] <= 0 else 0

    @property
    def total(self) -> int:
        """Rows."""
        return int(self.columns[0].size)

    def feed(
        self, sink: Pipeline | Inputs, before: Callable[[int, RawMessage | None], None]
    ) -> Iterator[int]:
        """Feed the rows in their order."""
        inputs = inputs_of(self.parameters, sink)
        stamps, *values = self.columns
        rows = zip(*(column.tolist() for column in (stamps + self.shift_ns, *values)), strict=True)
        for done, (stamp, force, displacement) in enumerate(rows, start=1):
            before(stamp, None)
            if not math.isnan(displacement):
                inputs.add_displacement("", stamp, displacement)
            if not math.isnan(force):
                inputs.add_force("", stamp, force)
            yield done


Source: TypeAlias = BagSource | RowSource
