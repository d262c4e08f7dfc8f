# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The files of bags: MCAP by the package ``mcap``, sqlite3 and ROS 1 by ``rosbags``."""

from __future__ import annotations

import functools
import shlex
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from mcap.reader import SeekingReader
from mcap.records import Channel, Footer, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader

from fden_ros.errors import InputError
from fden_ros.recording.message_types import carried_types, full_type_name, type_hash
from fden_ros.recording.places import opened
from fden_ros.recording.qos import LATCHED, Qos

MAGIC = b"\x89MCAP0\r\n"
_ROS1 = "ros1msg"
_ENCODINGS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}


class RawMessage(NamedTuple):
    """One message as recorded: CDR bytes and the time of recording (ns since the epoch)."""

    topic: str
    type_name: str
    log_time_ns: int
    data: bytes


@dataclass(frozen=True)
class Topic:
    """One topic of a bag."""

    name: str  #: such as ``/force``
    type_name: str  #: such as ``geometry_msgs/msg/WrenchStamped``
    message_count: int
    offered_qos: tuple[Qos, ...] = ()  #: by its publishers; empty when the bag does not say
    definition: str = ""  #: of the type as the bag carries it
    encoding: str = ""  #: of the definition: ``ros2msg``, ``ros2idl``, ``ros1msg``

    @property
    def type_hash(self) -> str:
        """Hash of the type as it was recorded; empty when the bag carries no definition."""
        if not self.definition:
            return ""
        types = carried_types(self.type_name, self.definition, self.encoding)
        return type_hash(self.type_name, types)


@dataclass
class BagFile:
    """The content of one file of a bag; the messages themselves are read on demand."""

    path: Path
    #: Yields topic, time of recording (ns) and bytes of the messages of some topics, by time.
    read: Callable[[Collection[str]], Iterator[tuple[str, int, bytes]]]
    start_ns: int | None = None  #: time of recording of the first message
    end_ns: int | None = None  #: of the last
    topics: list[Topic] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def messages(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of some topics by time of recording, those of ROS 1 as CDR.

        If the file breaks, a warning is added.
        """
        types = {topic.name: topic.type_name for topic in self.topics if topic.name in wanted}
        convert = {t.name: _from_ros1(t) for t in self.topics if t.encoding == _ROS1}
        try:
            for name, time_ns, data in self.read(types) if types else ():
                if name in convert:
                    data = convert[name](data)
                yield RawMessage(name, types[name], time_ns, bytes(data))
        except Exception as error:  # for damaged bytes the packages raise every kind
            warning = f"{self.path.name} is damaged: the rest of it is lost ({_reason(error)})"
            if warning not in self.warnings:
                self.warnings.append(warning)

    def add(self, topic: Topic) -> None:
        """Add a topic, or another channel of one."""
        try:
            self.topics.append(replace(topic, type_name=full_type_name(topic.type_name)))
        except InputError as error:
            self.warnings.append(f"topic {topic.name} is not used: {error}")


def _from_ros1(topic: Topic) -> Callable[[bytes], Any]:
    types = carried_types(topic.type_name, topic.definition, _ROS1)
    return lambda data: types.ros1_to_cdr(data, topic.type_name)


def read_mcap(path: Path) -> BagFile | None:
    """Return the content of an MCAP file at `path` by its index; None without a usable one."""
    try:
        with opened(path) as stream:
            summary = SeekingReader(stream).get_summary()
        counts, size = summary.statistics.channel_message_counts, path.stat().st_size
        total = summary.statistics.message_count
        is_whole = sum(counts.values()) == total and all(
            one.chunk_start_offset + one.chunk_length <= size for one in summary.chunk_indexes
        )
        if not is_whole or bool(summary.chunk_indexes) != bool(total):
            return None
        # Those with messages first: they describe the topic.
        channels = sorted(summary.channels.values(), key=lambda channel: channel.id not in counts)
    except Exception:  # for bytes that are no MCAP the package lets through every kind
        return None

    def read(wanted: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        with opened(path) as stream:
            reader = SeekingReader(stream, validate_crcs=True)
            for _, channel, message in reader.iter_messages(wanted):
                yield channel.topic, message.log_time, message.data

    file = BagFile(path, read)
    if total:
        file.start_ns = summary.statistics.message_start_time
        file.end_ns = summary.statistics.message_end_time
    return _with_channels(file, channels, summary.schemas, counts)


def scan_mcap(path: Path) -> BagFile:
    """Return the content of an MCAP file without an index: up to its end, or a cut."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    counts: Counter[int] = Counter()

    def read(wanted: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        kept = [
            (channels[one.channel_id].topic, one.log_time, one.data)
            for one in _records(path)
            if isinstance(one, Message) and channels[one.channel_id].topic in wanted
        ]
        yield from sorted(kept, key=lambda message: message[1])

    file = BagFile(path, read)
    is_complete = False
    for record in _records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            counts[record.channel_id] += 1
            times = (record.log_time, file.start_ns, file.end_ns)
            known = [time for time in times if time is not None]
            file.start_ns, file.end_ns = min(known), max(known)
        is_complete = isinstance(record, Footer)
    if not (is_complete or channels):
        raise cut_short(path)
    if not is_complete:
        used = f"the {counts.total()} messages before that are used"
        file.warnings.append(f"{path.name} is cut off or damaged: {used}")
    return _with_channels(file, channels.values(), schemas, counts)


def cut_short(path: Path) -> InputError:
    """Return the problem of a file that holds too little."""
    size = path.stat().st_size
    return InputError(f"{path} is cut off before its first topic, at {size} bytes: copy it again")


def _records(path: Path) -> Iterator[Any]:
    """Yield the records of an MCAP file from its start to its end, or to where it breaks."""
    known = set()
    with path.open("rb") as stream:
        records = iter(StreamReader(stream, validate_crcs=True).records)
        while True:
            try:
                record = next(records)
            except Exception:  # for damaged bytes the package lets through every kind
                return
            if isinstance(record, Channel):
                known.add(record.id)
            if not isinstance(record, Message) or record.channel_id in known:
                yield record
            if isinstance(record, Footer):
                return


def _with_channels(
    file: BagFile,
    channels: Iterable[Channel],
    schemas: Mapping[int, Schema],
    counts: Mapping[int, int],
) -> BagFile:
    for channel in channels:
        schema = schemas.get(channel.schema_id)
        if schema is None or channel.message_encoding not in ("cdr", "ros1"):
            file.warnings.append(
                f"topic {channel.topic} is not in the encoding of ROS 2 or ROS 1 "
                f"({channel.message_encoding or 'none'}): not used"
            )
            continue
        qos = Qos.from_bag(channel.metadata.get("offered_qos_profiles"))
        text, count = schema.data.decode("utf-8", "replace").strip(), counts.get(channel.id, 0)
        file.add(Topic(channel.topic, schema.name, count, qos, text, schema.encoding))
    return file


def read_rosbag(path: Path, *, is_ros1: bool = False) -> BagFile:
    """Return the content of a sqlite3 file, a folder of rosbag2 or a bag of ROS 1 at `path`."""
    opened_bag: Any = functools.partial(Ros1Reader if is_ros1 else Ros2Reader, path)

    def read(wanted: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        with opened_bag() as reader:
            chosen = [one for one in reader.connections if one.topic in wanted]
            for connection, time_ns, data in reader.messages(chosen):
                yield connection.topic, time_ns, data

    file = BagFile(path, read)
    try:
        with opened_bag() as reader:
            connections = list(reader.connections)
            if reader.message_count:
                file.start_ns, file.end_ns = reader.start_time, reader.end_time - 1
    except Exception as error:  # for bytes that are no bag the package lets through every kind
        reason = _reason(error)
        if "not indexed" in reason:
            raise InputError(
                f"{path} was not closed, so it has no index (interrupted recording?): write the "
                f"index where ROS 1 is installed, with: rosbag reindex {shlex.quote(str(path))}"
            ) from None
        raise InputError(f"{path} is damaged ({reason}): copy it again") from None
    for one in connections:
        offered: tuple[Qos, ...] = (LATCHED,) if is_ros1 and one.ext.latching else ()
        if not is_ros1:
            offered = Qos.from_bag(one.ext.offered_qos_profiles)
        encoding = _ROS1 if is_ros1 else _ENCODINGS.get(one.msgdef.format, "")
        file.add(Topic(one.topic, one.msgtype, one.msgcount, offered, one.msgdef.data, encoding))
    return file


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
