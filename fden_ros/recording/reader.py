# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Reading bags: rosbag2 folders and bare MCAP files, split, compressed or cut off."""

from __future__ import annotations

import bisect
import heapq
import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.well_known import MessageEncoding

from fden_ros.errors import InputError
from fden_ros.recording.definitions import full_type_name, message_class
from fden_ros.recording.mcap_file import (
    MAGIC,
    ChunkError,
    McapFile,
    Row,
    Span,
    log_time,
    read_mcap,
)
from fden_ros.recording.qos import Qos, parse_profiles

_METADATA_FILE = "metadata.yaml"
_SQLITE3 = b"SQLite format 3\0"
_ROS1 = b"#ROSBAG V"
_ZSTD = b"\x28\xb5\x2f\xfd"
_LZ4 = b"\x04\x22\x4d\x18"
_RECORDINGS = ("*.mcap",)
_FOREIGN = ("*.mcap.*", "*.db3", "*.db3.zstd", "*.bag")


@dataclass(frozen=True)
class Topic:
    """One topic of a bag."""

    name: str  #: such as ``/force``
    type_name: str  #: such as ``geometry_msgs/msg/WrenchStamped``
    message_count: int
    offered_qos: tuple[Qos, ...] = ()  #: by its publishers; empty when the bag does not say
    schema: str = ""  #: definition of the type as the bag carries it
    schema_encoding: str = ""  #: its format: ``ros2msg``, ``ros2idl``


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
    overlap. Nothing is kept open between calls, so several iterations may run at once.

    Parameters
    ----------
    path
        A rosbag2 folder (one file or several) or an ``.mcap`` file; chunks may be compressed with
        zstd or lz4.

    Raises
    ------
    InputError
        When the path is missing, empty, or another format (the line says how to convert it).
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._warnings: list[str] = []
        self._metadata: dict[str, Any] = {}
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
        return self._merge(None if topics is None else frozenset(topics))

    def _merge(self, topics: frozenset[str] | None) -> Iterator[RawMessage]:
        routes = [
            {
                channel_id: (name, type_name)
                for channel_id, (name, type_name) in route.items()
                if topics is None or name in topics
            }
            for route in self._routes
        ]
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
                rows = self._load(self._files[file_index], span)
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
            for span in file.spans:
                yield index, span

    def _load(self, file: McapFile, span: Span) -> list[Row]:
        try:
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
        if not self.path.exists():
            raise InputError(f"{self.path} does not exist: give a bag folder or an .mcap file")
        if not self.path.is_dir():
            return [self.path]
        listed = self._read_metadata()
        present = [path for path in listed if path.is_file()]
        for path in listed:
            if path not in present:
                self._warn(f"{path.name} is listed in {_METADATA_FILE} but missing: not used")
        if present:
            return present
        found = _glob(self.path, _RECORDINGS) or _glob(self.path, _FOREIGN)
        if not found:
            raise InputError(f"{self.path} holds no bag: expected an .mcap file in it")
        return found

    def _read_metadata(self) -> list[Path]:
        path = self.path / _METADATA_FILE
        try:
            metadata = yaml.safe_load(path.read_text(encoding="utf-8"))
            self._metadata = dict(metadata["rosbag2_bagfile_information"])
            names = [Path(str(name)) for name in self._metadata["relative_file_paths"]]
        except FileNotFoundError:
            self._warn(f"no {_METADATA_FILE} (interrupted recording?): all files are used")
            return []
        except (OSError, ValueError, TypeError, KeyError, yaml.YAMLError):
            self._warn(f"{_METADATA_FILE} cannot be read: all files are used")
            return []
        if str(self._metadata.get("compression_mode", "")).upper() == "MESSAGE":
            raise InputError(
                f"{self.path} compresses each message, which MCAP bags do not: "
                f"convert it with: {_convert_command(self.path)}"
            )
        # Bags of ROS 2 Dashing and older name the files with the folder in front.
        return [
            self.path / name if (self.path / name).is_file() else self.path / name.name
            for name in names
        ]

    def _open(self, path: Path) -> McapFile:
        try:
            file = read_mcap(self._check_format(path))
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
        if file.cut_off_at is not None:
            self._warn(
                f"{path.name} is cut off at byte {file.cut_off_at}: "
                f"its {file.message_count} complete messages are used"
            )
        return file

    def _check_format(self, path: Path) -> Path:
        """Return the path of an MCAP file, or raise."""
        with path.open("rb") as file:
            head = file.read(16)
        if head.startswith(MAGIC):
            return path
        if not head:
            raise InputError(f"{path} is empty: give a bag folder or an .mcap file")
        if head.startswith((_ZSTD, _LZ4)):
            tool = "zstd" if head.startswith(_ZSTD) else "lz4"
            raise InputError(
                f"{path} is compressed as a whole: unpack it with: {tool} -d {path}; chunks of a "
                "bag may be compressed"
            )
        if MAGIC.startswith(head):
            raise _cut_short(path)
        if head == _SQLITE3:
            raise InputError(
                f"{path} is a sqlite3 bag: convert it with: {_convert_command(self.path)}"
            )
        if head.startswith(_ROS1):
            raise InputError(
                f"{path} is a ROS 1 bag: convert it with: pip install rosbags && "
                f"rosbags-convert --src {path} --dst {path.with_suffix('')} --dst-storage mcap"
            )
        raise InputError(f"{path} is not an MCAP file: give a bag folder or an .mcap file")

    # Topics

    def _route(self, file: McapFile) -> dict[int, tuple[str, str]]:
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
        for file, route in zip(self._files, self._routes, strict=True):
            for channel_id, key in route.items():
                channel = file.channels[channel_id]
                schema = file.schemas[channel.schema_id]
                counts[key] += file.counts[channel_id]
                offered = parse_profiles(channel.metadata.get("offered_qos_profiles"))
                profiles.setdefault(key, {}).update(dict.fromkeys(offered))
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
            )
            for name, type_name in sorted(counts)
        )

    def _refuse_without_topics(self) -> None:
        if any(file.channels for file in self._files):
            raise InputError(
                f"{self.path} holds no ROS 2 messages: expected topics encoded in CDR"
            )
        for file in self._files:
            if file.cut_off_at is not None:
                raise _cut_short(file.path)


def decode(message: RawMessage) -> Any:
    """Return the message as an instance of its class.

    Raises
    ------
    InputError
        When its type is not installed or its bytes do not fit the type.
    """
    from rclpy.serialization import deserialize_message

    try:
        return deserialize_message(message.data, message_class(message.type_name))
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"a message on {message.topic} is no valid {message.type_name}: the bag is damaged "
            "or was made with another version of the type"
        ) from error


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


def _glob(folder: Path, patterns: tuple[str, ...]) -> list[Path]:
    found = [path for pattern in patterns for path in folder.glob(pattern) if path.is_file()]
    return sorted(found, key=_natural_order)


def _natural_order(path: Path) -> list[tuple[int, str]]:
    """Order ``x_2`` before ``x_10``."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdigit() else (0, part) for part in parts]


def _convert_command(path: Path) -> str:
    target = f"{path.with_suffix('')}_mcap"
    return (
        f"echo 'output_bags: [{{uri: {target}, storage_id: mcap, all: true}}]' > convert.yaml "
        f"&& ros2 bag convert -i {path} -o convert.yaml"
    )
