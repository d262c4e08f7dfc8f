# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The files of bags: MCAP by the package ``mcap``, sqlite3 and ROS 1 by ``rosbags``."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from mcap.reader import SeekingReader
from mcap.records import Channel, Footer, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.interfaces import ConnectionExtRosbag1, MessageDefinitionFormat
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


class DamageError(Exception):
    """The rest of a file cannot be read."""


@dataclass
class BagFile:
    """What one file of a bag holds; the messages themselves are read on demand.

    Parameters
    ----------
    path : Path
    topics : list of Topic
    read : callable
        Yields topic, time of recording (ns) and bytes of the messages of some topics, by time.
    start_ns, end_ns : int, optional
        Times of recording of the first and the last message; None without messages.
    warnings : list of str
    """

    path: Path
    topics: list[Topic]
    read: Callable[[Collection[str]], Iterator[tuple[str, int, bytes]]]
    start_ns: int | None = None
    end_ns: int | None = None
    warnings: list[str] = field(default_factory=list)

    def messages(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of some topics by time of recording, those of ROS 1 as CDR.

        Raises
        ------
        DamageError
            Where the file breaks.
        """
        types = {topic.name: topic.type_name for topic in self.topics if topic.name in wanted}
        convert = {t.name: _from_ros1(t) for t in self.topics if t.encoding == _ROS1}
        if not types:
            return
        try:
            for name, time_ns, data in self.read(types):
                if name in convert:
                    data = convert[name](data)
                yield RawMessage(name, types[name], time_ns, bytes(data))
        except Exception as error:  # for damaged bytes the packages let through every kind
            raise DamageError(_reason(error)) from None


def _from_ros1(topic: Topic) -> Callable[[bytes], Any]:
    types = carried_types(topic.type_name, topic.definition, _ROS1)
    return lambda data: types.ros1_to_cdr(data, topic.type_name)


def read_mcap(path: Path) -> BagFile | None:
    """Return what an MCAP file at `path` holds by its index; None without a usable one."""
    try:
        with opened(path) as stream:
            summary = SeekingReader(stream).get_summary()
        statistics = summary.statistics if summary is not None else None
        if summary is None or statistics is None:
            return None
        counts = statistics.channel_message_counts
        size = path.stat().st_size
        is_whole = sum(counts.values()) == statistics.message_count and all(
            one.chunk_start_offset + one.chunk_length <= size for one in summary.chunk_indexes
        )
        if not is_whole or bool(summary.chunk_indexes) != bool(statistics.message_count):
            return None
        channels = [summary.channels[number] for number in counts]
        schemas = summary.schemas
    except Exception:  # for bytes that are no MCAP the package lets through every kind
        return None

    def read(wanted: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        with opened(path) as stream:
            reader = SeekingReader(stream, validate_crcs=True)
            for _, channel, message in reader.iter_messages(wanted):
                yield channel.topic, message.log_time, message.data

    others = [one for number, one in summary.channels.items() if number not in counts]
    file = _mcap_file(path, [*channels, *others], schemas, Counter(counts), read)
    if statistics.message_count:
        file.start_ns, file.end_ns = statistics.message_start_time, statistics.message_end_time
    return file


def scan_mcap(path: Path) -> BagFile:
    """Return what an MCAP file without an index holds: what stands before its end, or a cut."""
    found = _Scan(path)
    for _ in found.messages():
        pass

    def read(wanted: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        kept = [one for one in _Scan(path).messages() if one[0] in wanted]
        yield from sorted(kept, key=lambda message: message[1])

    file = _mcap_file(path, list(found.channels.values()), found.schemas, found.counts, read)
    file.start_ns, file.end_ns = found.start_ns, found.end_ns
    if not found.is_complete:
        file.warnings.append(
            f"{path.name} is cut off or damaged: the {found.counts.total()} messages before that "
            "are used"
        )
    return file


class _Scan:
    """Reads the records of a file from its start to its end, or to where it breaks."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        self.start_ns: int | None = None
        self.end_ns: int | None = None
        self.is_complete = False

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        """Yield topic, time of recording (ns) and bytes of each message, in the file's order."""
        with self._path.open("rb") as stream:
            records = iter(StreamReader(stream, validate_crcs=True).records)
            while True:
                try:
                    record = next(records)
                except Exception:  # for damaged bytes the package lets through every kind
                    return
                if isinstance(record, Schema):
                    self.schemas[record.id] = record
                elif isinstance(record, Channel):
                    self.channels[record.id] = record
                elif isinstance(record, Message) and record.channel_id in self.channels:
                    self._count(record)
                    yield self.channels[record.channel_id].topic, record.log_time, record.data
                elif isinstance(record, Footer):
                    self.is_complete = True
                    return

    def _count(self, record: Message) -> None:
        self.counts[record.channel_id] += 1
        times = [record.log_time, self.start_ns, self.end_ns]
        known = [time for time in times if time is not None]
        self.start_ns, self.end_ns = min(known), max(known)


def _mcap_file(
    path: Path,
    channels: Collection[Channel],
    schemas: dict[int, Schema],
    counts: Counter[int],
    read: Callable[[Collection[str]], Iterator[tuple[str, int, bytes]]],
) -> BagFile:
    file = BagFile(path, [], read)
    for channel in channels:
        schema = schemas.get(channel.schema_id)
        if schema is None or channel.message_encoding not in ("cdr", "ros1"):
            file.warnings.append(
                f"topic {channel.topic} is not in the encoding of ROS 2 or ROS 1 "
                f"({channel.message_encoding or 'none'}): not used"
            )
            continue
        topic = Topic(
            channel.topic,
            schema.name,
            counts[channel.id],
            Qos.from_bag(channel.metadata.get("offered_qos_profiles")),
            schema.data.decode("utf-8", "replace").strip(),
            schema.encoding,
        )
        _add(file, topic)
    return file


def _add(file: BagFile, topic: Topic) -> None:
    """Add a topic, or the messages of another channel of it."""
    try:
        topic = replace(topic, type_name=full_type_name(topic.type_name))
    except InputError as error:
        file.warnings.append(f"topic {topic.name} is not used: {error}")
        return
    for index, other in enumerate(file.topics):
        if other.name == topic.name:
            if other.type_name != topic.type_name:
                raise InputError(
                    f"{file.path}: topic {topic.name} has two types, {other.type_name} and "
                    f"{topic.type_name}: record it anew"
                )
            count = other.message_count + topic.message_count
            file.topics[index] = replace(other, message_count=count)
            return
    file.topics.append(topic)


def read_rosbag(path: Path, *, is_ros1: bool = False) -> BagFile:
    """Return what a sqlite3 file, a folder of rosbag2 or a bag of ROS 1 at `path` holds.

    Raises
    ------
    InputError
        If it is damaged, was not closed, or is none of rosbag2.
    """

    def opened_bag() -> AbstractContextManager[Any]:
        return Ros1Reader(path) if is_ros1 else Ros2Reader(path)

    def read(wanted: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        with opened_bag() as reader:
            chosen = [one for one in reader.connections if one.topic in wanted]
            for connection, time_ns, data in reader.messages(chosen):
                yield connection.topic, time_ns, data

    file = BagFile(path, [], read)
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
        raise InputError(f"{path} is damaged ({reason}): copy it anew") from None
    for one in connections:
        offered: tuple[Qos, ...]
        if isinstance(one.ext, ConnectionExtRosbag1):
            offered, encoding = ((LATCHED,) if one.ext.latching else ()), _ROS1
        else:
            offered = Qos.from_bag(one.ext.offered_qos_profiles)
            encoding = _ENCODINGS.get(one.msgdef.format, "")
        _add(file, Topic(one.topic, one.msgtype, one.msgcount, offered, one.msgdef.data, encoding))
    return file


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
