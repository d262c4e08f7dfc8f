# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a replay reads: a bag or a table, message by message or row by row, into the pipeline."""

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
from fden_ros.core.streams import Sink
from fden_ros.errors import Hint, InputError
from fden_ros.inputs import (
    DAMAGED,
    TRANSFORM_TOPICS,
    TRANSFORMS,
    TYPE_NAMES,
    Inputs,
    NumberOrVector,
    stamp_ns,
    stream_of,
)
from fden_ros.parameters import Parameters, frames_config, moves_probe
from fden_ros.recording.bag_files import RawMessage, Topic
from fden_ros.recording.candidates import hint_of
from fden_ros.recording.fields import FieldPath, as_number_or_vector, decoder_of
from fden_ros.recording.machine import machine_values
from fden_ros.recording.places import called, copied, is_remote, place, reached
from fden_ros.recording.reader import BagReader, decode
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

#: Line of a parameter file that says what in a recording is force and displacement, as options.
SELECTION_LINE = "# Recording: "


@dataclass(frozen=True)
class Selection:
    """Where in a recording force, displacement and the like are; what is not named is found.

    A field is one of that topic's messages, of whatever type they are: a number, or a vector that
    is projected on the configured axis.
    """

    topics: Mapping[str, str] = field(default_factory=dict)  #: by the name of the input
    fields: Mapping[str, str] = field(default_factory=dict)
    columns: Columns | None = None  #: of a table
    where: tuple[str, str] | None = None  #: column and text of a table's rows that are used
    stamps: str = "header"  #: of a bag's messages; or ``recording``, the time of their recording
    from_touch: bool | None = None  #: whether a table begins at the touch; None: by its preamble


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
        raise InputError(f"{path} is no table: {option} is for tables")
    return BagSource(path, parameters, chosen)


def _open_table(path: Path, parameters: Parameters, selection: Selection) -> RowSource:
    for name, is_set, what in (
        ("tool.mass", bool(parameters.tool.mass), "the tool's orientation"),
        ("displacement.along_tool", parameters.displacement.along_tool, "the same"),
        ("frames.base", bool(parameters.frames.base), "transforms"),
    ):
        if is_set:
            raise InputError(
                f"{name} asks for {what}, which a table does not hold: unset it, or replay a bag"
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

    def __init__(self, path: str | Path, parameters: Parameters, selection: Selection) -> None:
        self.reader = BagReader(path)
        self.parameters = parameters
        self._selection = selection
        self._is_stamped = selection.stamps == "header" and parameters.stamp_source == "header"
        self._fields: dict[str, str | None] = {}
        self.topics: dict[str, Topic] = {}
        wanted = ("force",) if moves_probe(parameters) else _ALWAYS
        for stream in wanted:
            self._fields[stream] = selection.fields.get(stream)
            try:
                self.topics[stream] = self._find(stream, selection.topics.get(stream))
            except NoTopicError as error:
                raise InputError(str(error), self._hint(wanted)) from None
        self._frames = frames_config(parameters)
        if self._frames is not None:
            self._find_transforms()
        self._notes = [
            f"{topic.name} is commanded by its name, not measured"
            for stream, topic in self.topics.items()
            if stream not in TRANSFORM_TOPICS and is_commanded(topic)
        ]
        self.stamp_problems: list[str] = []
        self._inputs: Inputs | None = None

    def _find_transforms(self) -> None:
        for topic in self.reader.topics:
            stream = "/" + topic.name.rpartition("/")[2]
            if stream in TRANSFORM_TOPICS and topic.type_name == TRANSFORMS:
                self._fields[stream] = None
                self.topics[stream] = topic
        if not set(self.topics) & set(TRANSFORM_TOPICS):
            raise InputError(
                f"{self.reader.path}: frames.base is set, but the bag has no transforms: record "
                "/tf and /tf_static too, or unset frames.base"
            )

    def _find(self, stream: str, topic: str | None) -> Topic:
        if self._fields[stream] is not None and topic is not None:
            return topic_with_messages(str(self.reader.path), self.reader.topics, topic)
        present, where = self.reader.topics, str(self.reader.path)
        return find_topic(where, present, topic, stream, self.topics.values())

    def _hint(self, wanted: Collection[str]) -> Callable[[], Hint]:
        """Return what lists the numbers of the bag, for what of force and displacement is open."""
        named = {**self._selection.topics, **self.topics}
        return hint_of(self.reader, [s for s in wanted if s in _ALWAYS and s not in named])

    def _note_joints(self) -> None:
        """Say which of several joints is taken where none is named."""
        for stream in _ALWAYS:
            topic = self.topics.get(stream)
            is_open = topic is not None and self._fields[stream] is None
            if topic is None or not is_open or getattr(self.parameters, stream).name:
                continue
            if topic.type_name == _JOINTS:
                first = next(self.reader.messages([topic.name]), None)
                names: list[str] = []
                with contextlib.suppress(InputError):  # counted as damaged where it is used
                    names = list(decode(first).name) if first is not None else []
                if len(names) > 1:
                    self.note(
                        f"{topic.name} has the joints {', '.join(names)}: the first is the "
                        f"{stream}; name another by {stream}.name, as `fden configure` does"
                    )

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
        fields = {stream: f" {field}" if field else "" for stream, field in self._fields.items()}
        names = {stream: topic.name + fields[stream] for stream, topic in self.topics.items()}
        if self._frames is not None and self._frames.moves_probe:
            names["displacement"] = f"{self._frames.probe} in {self._frames.base}"
        order = (*_ALWAYS, *TRANSFORM_TOPICS)
        return {stream.lstrip("/"): names[stream] for stream in order if stream in names}

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was wrong with the bag."""
        return (*self.stamp_problems, *self.reader.warnings, *self._notes)

    @property
    def frame(self) -> str:
        """frame_id of the force so far."""
        return self._inputs.force_frame if self._inputs is not None else ""

    @property
    def displacement_frame(self) -> str:
        """frame_id of the positions so far."""
        return self._inputs.displacement_frame if self._inputs is not None else ""

    def feed(self, sink: Sink, before: Callable[[int, RawMessage | None], None]) -> Iterator[int]:
        """Feed `sink` the messages in the order of their recording, and yield the steps done.

        `before` is called with the time of recording (ns) and the message before its sample goes
        in.
        """
        self._inputs = Inputs(self.parameters, sink)
        self._note_joints()
        handlers: dict[str, list[Callable[[RawMessage], None]]] = {}
        for stream, topic in self.topics.items():
            handlers.setdefault(topic.name, []).append(self._handler(stream, topic))
        for done, message in enumerate(self.messages(handlers), start=1):
            before(message.log_time_ns, message)
            for handle in handlers[message.topic]:
                handle(message)
            yield done

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of topics.

        What is wrong with the stamps of force, displacement and the like joins the warnings.
        """
        if self._is_stamped:
            self.stamp_problems = problems(
                {
                    topic.name: self._stamps(topic)
                    for stream, topic in self.topics.items()
                    if stream not in TRANSFORM_TOPICS
                }
            )
        return self.reader.messages(topics)

    def _stamps(self, topic: Topic) -> list[tuple[int, int]]:
        """Return header stamps and times of recording (ns) of a topic's first messages."""
        decode = decoder_of(topic)
        pairs = []
        for message in itertools.islice(self.reader.messages([topic.name]), LOOKED_AT):
            with contextlib.suppress(Exception):  # counted as damaged where it is used
                stamp = carried_stamp(decode(message.data))
                header = message.log_time_ns if stamp is None else stamp_ns(stamp)
                pairs.append((header, message.log_time_ns))
        return pairs

    def _handler(self, stream: str, topic: Topic) -> Callable[[RawMessage], None]:
        field, inputs = self._fields[stream], self._inputs
        assert inputs is not None
        decode = decoder_of(topic)
        take = self._field_taker(stream, topic, FieldPath(field), inputs) if field else None

        def handle(message: RawMessage) -> None:
            try:
                sample = decode(message.data)
            except Exception:  # damaged bytes raise errors of every kind
                inputs.reject(stream_of(stream), DAMAGED)
                return
            if take is not None:
                take(sample, message.log_time_ns)
            else:
                inputs.add(stream, sample, None if self._is_stamped else message.log_time_ns)

        return handle

    def _field_taker(
        self, stream: str, topic: Topic, path: FieldPath, inputs: Inputs
    ) -> Callable[[Any, int], None]:
        """Return what takes one field out of every decoded message of a topic."""
        has_value = False

        def value_of(sample: Any) -> NumberOrVector | None:
            nonlocal has_value
            try:
                found = path.of(sample)
            except IndexError:
                return None
            except InputError as error:
                raise InputError(f"{topic.name}: {error}") from None
            value = as_number_or_vector(found)
            if value is None and not has_value:
                raise InputError(
                    f"{topic.name}: {path.text} is neither a number nor a vector: choose another "
                    f"field with --{stream}-field"
                )
            has_value = True
            return value

        def take(sample: Any, log_time_ns: int) -> None:
            value = value_of(sample)
            carried = carried_stamp(sample) if self._is_stamped else None
            if carried is None and self._is_stamped:
                self.note(
                    f"{topic.name} carries no stamps: the times of recording are used, which "
                    "jitter"
                )
            stamp = log_time_ns if carried is None else stamp_ns(carried)
            frame = str(getattr(getattr(sample, "header", None), "frame_id", ""))
            if stream == "force":
                inputs.add_force(frame, stamp, value)
            else:
                turn = path.orientation_beside(sample)
                inputs.add_displacement(frame, stamp, value, turn)

        return take

    def note(self, text: str) -> None:
        """Add a warning, once."""
        if text not in self._notes:
            self._notes.append(text)


@dataclass(frozen=True, eq=False)
class RowSource:
    """A table, or arrays, fed row by row.

    Parameters
    ----------
    columns : tuple of ndarray
        Stamps [ns], force [N] and displacement [m], shape (n,) each; NaN where a row has none.
    parameters : Parameters
        With what the table says or needs.
    inputs : dict
        Column of each quantity.
    warnings : tuple of str
        What is wrong with it, or is to be stated.
    set_by_recording : tuple of str
        What of the parameters the table says, a line each.
    """

    columns: tuple[Any, Array, Array]
    parameters: Parameters
    inputs: dict[str, str]
    warnings: tuple[str, ...] = ()
    set_by_recording: tuple[str, ...] = ()
    frame: str = ""
    displacement_frame: str = ""

    @property
    def total(self) -> int:
        """Rows."""
        return int(self.columns[0].size)

    def feed(self, sink: Sink, before: Callable[[int, RawMessage | None], None]) -> Iterator[int]:
        """Feed the rows in their order."""
        inputs = Inputs(self.parameters, sink)
        rows = zip(*(column.tolist() for column in self.columns), strict=True)
        for done, (stamp, force, displacement) in enumerate(rows, start=1):
            before(stamp, None)
            if not math.isnan(displacement):
                inputs.add_displacement("", stamp, displacement)
            if not math.isnan(force):
                inputs.add_force("", stamp, force)
            yield done


Source: TypeAlias = BagSource | RowSource
