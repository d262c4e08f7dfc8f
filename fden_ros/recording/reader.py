# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Reading bags of every kind: folders and bare files, split, compressed or cut off."""

from __future__ import annotations

import bisect
import contextlib
import fnmatch
import heapq
import itertools
import re
import shutil
import sqlite3
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import lz4.frame
import yaml
import zstandard
from mcap.well_known import MessageEncoding

from fden_ros.errors import InputError
from fden_ros.recording.definitions import decoder, full_type_name
from fden_ros.recording.foreign import reason_of
from fden_ros.recording.mcap_file import (
    MAGIC,
    ChunkError,
    McapFile,
    Row,
    Span,
    log_time,
    read_index,
    read_mcap,
)
from fden_ros.recording.places import called, copied, exists, is_folder, is_remote, place, reached
from fden_ros.recording.qos import Qos, parse_profiles
from fden_ros.recording.rosbags_file import DamageError, RosbagsFile, read_ros1, read_sqlite3

METADATA_FILE = "metadata.yaml"
_SQLITE3 = b"SQLite format 3\0"
_ROS1 = b"#ROSBAG V"
_ZSTD = b"\x28\xb5\x2f\xfd"
_LZ4 = b"\x04\x22\x4d\x18"
#: Names of the files of a bag without metadata; the first pattern that some match counts.
_RECORDINGS = ("*.mcap", "*.mcap.*", "*.db3", "*.db3.zstd", "*.bag", "*.bag.*")
#: Suffixes of what sqlite3 leaves beside a file whose writer was interrupted.
_LEFTOVERS = ("-wal", "-journal")
_EXPECTED = "give a bag folder, or an .mcap, .db3 or .bag file"


@dataclass(frozen=True)
class Topic:
    """One topic of a bag."""

    name: str  #: such as ``/force``
    type_name: str  #: such as ``geometry_msgs/msg/WrenchStamped``
    message_count: int
    offered_qos: tuple[Qos, ...] = ()  #: by its publishers; empty when the bag does not say
    schema: str = ""  #: definition of the type as the bag carries it
    schema_encoding: str = ""  #: its format: ``ros2msg``, ``ros2idl``
    type_hash: str = ""  #: of the type as it was recorded; empty when the bag does not say


def topic_named(where: str, present: Sequence[Topic], name: str) -> Topic:
    """Return the topic called `name`, with or without the leading slash.

    Raises
    ------
    InputError
        When there is none; the line says `where`.
    """
    for topic in present:
        if topic.name in (name, f"/{name}"):
            return topic
    names = ", ".join(topic.name for topic in present) or "none"
    raise InputError(f"{where} has no topic {name}: it has {names}")


class RawMessage(NamedTuple):
    """One message as recorded: CDR bytes and the time of recording (ns since the epoch)."""

    topic: str
    type_name: str
    log_time_ns: int
    data: bytes


class BagReader:
    """Read a bag as a stream of raw messages in log-time order.

    Memory does not grow with the bag: what is held is one chunk, or those chunks whose times
    overlap. No file is kept open between calls, so several iterations may run at once.

    Parameters
    ----------
    path
        A folder with the files of a bag, or one: ``.mcap``, ``.db3`` (sqlite3) or ``.bag`` (ROS 1,
        whose messages come in ROS 2's encoding). Files, messages and chunks may be compressed.
        A file that is compressed as a whole is unpacked for as long as the reader lives.

    Raises
    ------
    InputError
        When the path is missing, empty, damaged or no bag.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = place(path)
        self._warnings: list[str] = []
        self._metadata: dict[str, Any] = {}
        self._unpacked: TemporaryDirectory[str] | None = None
        with reached(self.path):
            self._files = [self._open(file) for file in self._find_files()]
        self._routes = [self._route(file) for file in self._files]
        self._topics = self._collect_topics()
        if not self._topics:
            self._refuse_without_topics()

    @property
    def topics(self) -> tuple[Topic, ...]:
        """The topics, by name."""
        return self._topics

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the bag, a line each; damaged chunks join when they are read."""
        return tuple(self._warnings)

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(topic.message_count for topic in self._topics)

    @property
    def start_ns(self) -> int | None:
        """Log time of the first message (ns since the epoch); None without messages."""
        return min((f.start_ns for f in self._files if f.start_ns is not None), default=None)

    @property
    def end_ns(self) -> int | None:
        """Log time of the last message (ns since the epoch); None without messages."""
        return max((f.end_ns for f in self._files if f.end_ns is not None), default=None)

    def topic(self, name: str) -> Topic:
        """Return the topic called `name`, with or without the leading slash.

        Raises
        ------
        InputError
            When the bag has no such topic.
        """
        return topic_named(str(self.path), self._topics, name)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages by log time; those of one time in the order of the file.

        Parameters
        ----------
        topics
            Names of the topics wanted; all when None.

        Raises
        ------
        InputError
            When a topic is not in the bag.
        """
        if topics is not None:
            for name in topics:
                self.topic(name)
        wanted = None if topics is None else frozenset(topics)
        routes = [
            {
                channel_id: (name, type_name)
                for channel_id, (name, type_name) in route.items()
                if wanted is None or name in wanted
            }
            for route in self._routes
        ]
        merged = self._merge(routes)
        others = [
            self._stream(file, route)
            for file, route in zip(self._files, routes, strict=True)
            if isinstance(file, RosbagsFile)
        ]
        if others:
            merged = heapq.merge(merged, *others, key=lambda message: message.log_time_ns)
        return self._unpack_messages(merged)

    def _unpack_messages(self, messages: Iterator[RawMessage]) -> Iterator[RawMessage]:
        """Return the messages, unpacked where each is compressed, as the first of them tells."""
        first = next(messages, None)
        if first is None:
            return iter(())
        messages = itertools.chain([first], messages)
        # CDR begins with a 0, whatever the message.
        if not first.data.startswith(_ZSTD):
            return messages
        packer = zstandard.ZstdDecompressor()
        return (_unpacked(message, packer) for message in messages)

    def _stream(
        self, file: RosbagsFile, route: dict[int, tuple[str, str]]
    ) -> Iterator[RawMessage]:
        try:
            for time_ns, channel_id, data in file.rows(route.keys()):
                yield RawMessage(*route[channel_id], time_ns, data)
        except DamageError as error:
            self._warn(f"{file.path.name} is damaged: the rest of it is lost ({error})")

    def _merge(self, routes: list[dict[int, tuple[str, str]]]) -> Iterator[RawMessage]:
        """Yield the messages of the MCAP files."""
        # Spans wait, the earliest last, until the stream of messages reaches their first time.
        waiting = sorted(
            (
                (span.start_ns, order, file_index, span)
                for order, (file_index, span) in enumerate(self._spans())
                if span.channel_ids is None or span.channel_ids & routes[file_index].keys()
            ),
            key=lambda entry: entry[:2],
            reverse=True,
        )
        active: list[tuple[int, int, int, list[Row], dict[int, tuple[str, str]]]] = []
        while waiting or active:
            while waiting and (not active or waiting[-1][0] <= active[0][0]):
                _, order, file_index, span = waiting.pop()
                file = self._files[file_index]
                rows = self._load(file, span) if isinstance(file, McapFile) else []
                if rows:
                    entry = (rows[0].log_time_ns, order, 0, rows, routes[file_index])
                    heapq.heappush(active, entry)
            if not active:
                return
            _, order, index, rows, route = heapq.heappop(active)
            # All that comes before the others' next message can go without asking the heap again.
            others = [entry[0] for entry in active[:1]] + [entry[0] for entry in waiting[-1:]]
            limit_ns = min(others, default=rows[-1].log_time_ns + 1)
            end = max(index + 1, bisect.bisect_left(rows, limit_ns, index, key=log_time))
            for log_time_ns, channel_id, data in rows[index:end]:
                target = route.get(channel_id)
                if target is not None:
                    yield RawMessage(*target, log_time_ns, data)
            if end < len(rows):
                heapq.heappush(active, (rows[end].log_time_ns, order, end, rows, route))

    def _spans(self) -> Iterator[tuple[int, Span]]:
        for index, file in enumerate(self._files):
            if isinstance(file, McapFile):
                yield from ((index, span) for span in file.spans)

    def _load(self, file: McapFile, span: Span) -> list[Row]:
        try:
            with reached(file.path):
                return file.load(span)
        except ChunkError as error:
            self._warn(f"{file.path.name}: the chunk at byte {span.offset} is lost ({error})")
        except OSError as error:
            raise InputError(f"{file.path} cannot be read: {error.strerror}") from None
        return []

    def _warn(self, warning: str) -> None:
        if warning not in self._warnings:
            self._warnings.append(warning)

    # Finding and opening the files

    def _find_files(self) -> list[Path]:
        if not exists(self.path):
            raise InputError(f"{self.path} does not exist: {_EXPECTED}")
        if not is_folder(self.path):
            return [self.path]
        listed = self._read_metadata()
        present = [path for path in listed if exists(path)]
        for path in listed:
            if path not in present:
                self._warn(f"{path.name} is listed in {METADATA_FILE} but missing: not used")
        if present:
            return present
        for pattern in _RECORDINGS:
            if found := _glob(self.path, pattern):
                return found
        raise InputError(f"{self.path} holds no bag: expected an .mcap, .db3 or .bag file in it")

    def _read_metadata(self) -> list[Path]:
        path = self.path / METADATA_FILE
        try:
            metadata = yaml.safe_load(path.read_text(encoding="utf-8"))
            self._metadata = dict(metadata["rosbag2_bagfile_information"])
            names = [Path(str(name)) for name in self._metadata["relative_file_paths"]]
        except FileNotFoundError:
            self._warn(f"no {METADATA_FILE} (interrupted recording?): all files are used")
            return []
        except (OSError, ValueError, TypeError, KeyError, yaml.YAMLError):
            self._warn(f"{METADATA_FILE} cannot be read: all files are used")
            return []
        mode, packing = (self._metadata.get(f"compression_{key}") for key in ("mode", "format"))
        if str(mode).lower() == "message" and packing != "zstd":
            raise InputError(f"{self.path} has messages compressed by {packing}: expected zstd")
        # Bags of ROS 2 Dashing and older name the files with the folder in front.
        return [
            self.path / name if exists(self.path / name) else self.path / name.name
            for name in names
        ]

    def _open(self, path: Path) -> McapFile | RosbagsFile:
        if is_remote(path):
            return read_index(path) or self._open_copy(path)
        try:
            return self._read(path)
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror or error}") from None

    def _read(self, path: Path) -> McapFile | RosbagsFile:
        with path.open("rb") as file:
            head = file.read(16)
        if head.startswith((_ZSTD, _LZ4)):
            path = self._unpack_file(path, head)
            with path.open("rb") as file:
                head = file.read(16)
        if not head:
            raise InputError(f"{path} is empty: {_EXPECTED}")
        if head == _SQLITE3:
            return read_sqlite3(self._recovered(path))
        if head.startswith(_ROS1):
            return read_ros1(path)
        if head.startswith(MAGIC):
            return self._read_mcap(path)
        if any(magic.startswith(head) for magic in (MAGIC, _SQLITE3, _ROS1)):
            raise _cut_short(path)
        raise InputError(f"{path} is no bag: {reason_of(head) or _EXPECTED}")

    def _read_mcap(self, path: Path) -> McapFile:
        file = read_mcap(path)
        if file.cut_off_at is not None:
            self._warn(
                f"{path.name} is cut off at byte {file.cut_off_at}: "
                f"its {file.message_count} complete messages are used"
            )
        return file

    def _unpack_file(self, path: Path, head: bytes) -> Path:
        """Return the path of an unpacked copy."""
        unpacked = self._place() / path.stem
        with path.open("rb") as packed, unpacked.open("wb") as file:
            try:
                if head.startswith(_ZSTD):
                    zstandard.ZstdDecompressor().copy_stream(packed, file)
                else:
                    with lz4.frame.open(packed) as stream:
                        shutil.copyfileobj(stream, file)
            except (zstandard.ZstdError, RuntimeError, EOFError) as error:
                self._warn(f"{path.name} cannot be unpacked to its end ({error})")
        return unpacked

    def _open_copy(self, path: Path) -> McapFile | RosbagsFile:
        copy = self._copied(path)
        with called(copy, path):
            return self._open(copy)

    def _copied(self, path: Path) -> Path:
        """Return the path of a copy here, with what an interrupted writer has left beside it."""
        for suffix in _LEFTOVERS:
            beside = path.with_name(path.name + suffix)
            if path.suffix == ".db3" and exists(beside):
                copied(beside, self._place())
        return copied(path, self._place())

    def _recovered(self, path: Path) -> Path:
        """Return a sqlite3 file with what an interrupted writer has left beside it."""
        left = [Path(f"{path}{suffix}") for suffix in _LEFTOVERS]
        left = [beside for beside in left if beside.is_file() and beside.stat().st_size]
        if not left:
            return path
        names = ", ".join(beside.name for beside in left)
        self._warn(f"{names} was left next to {path.name} (interrupted recording): used too")
        copies = [Path(shutil.copy(one, self._place())) for one in (path, *left)]
        try:
            with contextlib.closing(sqlite3.connect(copies[0])) as database:
                database.execute("PRAGMA journal_mode = DELETE").fetchall()
        except sqlite3.Error:
            return path
        return copies[0]

    def _place(self) -> Path:
        """Return the folder of what is unpacked, which vanishes with the reader."""
        if self._unpacked is None:
            self._unpacked = TemporaryDirectory(prefix="fden_")
        return Path(self._unpacked.name)

    # Topics

    def _route(self, file: McapFile | RosbagsFile) -> dict[int, tuple[str, str]]:
        """Return topic and type name by channel id."""
        route: dict[int, tuple[str, str]] = {}
        for channel in file.channels.values():
            schema = file.schemas.get(channel.schema_id)
            if schema is None or channel.message_encoding != MessageEncoding.CDR:
                self._warn(
                    f"topic {channel.topic} is not in ROS 2's CDR encoding "
                    f"({channel.message_encoding or 'none'}): not used"
                )
                continue
            try:
                route[channel.id] = (channel.topic, full_type_name(schema.name))
            except InputError as error:
                self._warn(f"topic {channel.topic} is not used: {error}")
        return route

    def _collect_topics(self) -> tuple[Topic, ...]:
        counts: Counter[tuple[str, str]] = Counter()
        profiles: dict[tuple[str, str], dict[Qos, None]] = {}
        schemas: dict[tuple[str, str], tuple[str, str]] = {}
        hashes: dict[tuple[str, str], str] = {}
        for file, route in zip(self._files, self._routes, strict=True):
            for channel_id, key in route.items():
                channel = file.channels[channel_id]
                schema = file.schemas[channel.schema_id]
                counts[key] += file.counts[channel_id]
                offered = parse_profiles(channel.metadata.get("offered_qos_profiles"))
                profiles.setdefault(key, {}).update(dict.fromkeys(offered))
                hashes[key] = channel.metadata.get("topic_type_hash", "")
                schemas[key] = (schema.data.decode("utf-8", "replace"), schema.encoding)
        listed = _listed_profiles(self._metadata)
        return tuple(
            Topic(
                name=name,
                type_name=type_name,
                message_count=counts[name, type_name],
                offered_qos=tuple(profiles[name, type_name]) or listed.get(name, ()),
                schema=schemas[name, type_name][0],
                schema_encoding=schemas[name, type_name][1],
                type_hash=hashes[name, type_name],
            )
            for name, type_name in sorted(counts)
        )

    def _refuse_without_topics(self) -> None:
        if any(file.channels for file in self._files):
            raise InputError(
                f"{self.path} holds no ROS 2 messages: expected topics encoded in CDR"
            )
        for file in self._files:
            if isinstance(file, McapFile) and file.cut_off_at is not None:
                raise _cut_short(file.path)


def decode(message: RawMessage) -> Any:
    """Return the message as an instance of its class.

    Raises
    ------
    InputError
        When its type is not installed or its bytes do not fit the type.
    """
    decoded = decoder(message.type_name)
    try:
        return decoded(message.data)
    except Exception as error:
        raise InputError(
            f"a message on {message.topic} is no valid {message.type_name}: the bag is damaged "
            "or was made with another version of the type"
        ) from error


def _unpacked(message: RawMessage, packer: zstandard.ZstdDecompressor) -> RawMessage:
    """Return a message that is compressed by itself, unpacked; damaged, it stays as it is."""
    try:
        return message._replace(data=packer.decompressobj().decompress(message.data))
    except zstandard.ZstdError:
        return message


def _cut_short(path: Path) -> InputError:
    return InputError(
        f"{path} is cut off before its first topic, at {path.stat().st_size} bytes: copy it anew"
    )


def _listed_profiles(metadata: dict[str, Any]) -> dict[str, tuple[Qos, ...]]:
    try:
        entries = [entry["topic_metadata"] for entry in metadata["topics_with_message_count"]]
        return {
            str(entry["name"]): parse_profiles(entry.get("offered_qos_profiles"))
            for entry in entries
        }
    except (KeyError, TypeError, AttributeError):
        return {}


def is_bag_file(path: Path) -> bool:
    """Return whether a file is one of a bag by its name."""
    is_file = is_remote(path) or path.is_file()
    return is_file and any(fnmatch.fnmatch(path.name, pattern) for pattern in _RECORDINGS)


def _glob(folder: Path, pattern: str) -> list[Path]:
    found = (path for path in folder.glob(pattern) if path.is_file())
    return sorted(found, key=_natural_order)


def _natural_order(path: Path) -> list[tuple[int, str]]:
    """Order ``x_2`` before ``x_10``."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdigit() else (0, part) for part in parts]
