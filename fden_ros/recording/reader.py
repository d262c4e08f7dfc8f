# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Reading bags of every kind: folders and bare files, split, compressed or cut off."""

from __future__ import annotations

import fnmatch
import heapq
import json
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from fden_ros.errors import InputError
from fden_ros.recording.bag_files import (
    MAGIC,
    BagFile,
    RawMessage,
    Topic,
    cut_short,
    read_mcap,
    read_rosbag,
    scan_mcap,
)
from fden_ros.recording.foreign import reason_of
from fden_ros.recording.message_types import decoder
from fden_ros.recording.places import called, copied, exists, is_folder, is_remote, place, reached

METADATA_FILE = "metadata.yaml"
TRUTH_TOPIC, TRUTH_TYPE = "/simulation/truth", "std_msgs/msg/String"
_SQLITE3 = b"SQLite format 3\0"
_ROS1 = b"#ROSBAG V"
#: Names of the files of a bag without metadata; the first pattern that some match counts.
_RECORDINGS = ("*.mcap", "*.db3", "*.bag")
_EXPECTED = "give a bag folder, or an .mcap, .db3 or .bag file"


class BagReader:
    """Read a bag as a stream of raw messages by time of recording.

    Several iterations may run at once.

    Parameters
    ----------
    path
        A folder with the files of a bag, or one: ``.mcap``, ``.db3`` (sqlite3) or ``.bag`` (ROS 1,
        whose messages come in ROS 2's encoding).
    """

    def __init__(self, path: str | Path) -> None:
        self.path = place(path)
        self._warnings: list[str] = []
        self._copies: TemporaryDirectory[str] | None = None
        with reached(self.path):
            self._files = [self._open(file) for file in self._find_files()]
        self._files.sort(key=lambda file: file.start_ns or 0)
        self._topics = self._joined()
        if not self._topics:
            raise InputError(f"{self.path} holds no ROS messages: expected topics encoded in CDR")

    @property
    def topics(self) -> tuple[Topic, ...]:
        """The topics, by name."""
        return self._topics

    @property
    def warnings(self) -> tuple[str, ...]:
        """The problems of the bag, a line each; damage is added when it is read."""
        return (*self._warnings, *(line for file in self._files for line in file.warnings))

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(topic.message_count for topic in self._topics)

    @property
    def start_ns(self) -> int | None:
        """Time of recording of the first message (ns since the epoch); None without messages."""
        return min((f.start_ns for f in self._files if f.start_ns is not None), default=None)

    @property
    def end_ns(self) -> int | None:
        """Time of recording of the last message (ns since the epoch); None without messages."""
        return max((f.end_ns for f in self._files if f.end_ns is not None), default=None)

    def topic(self, name: str) -> Topic:
        """Return the topic called `name`, with or without the leading slash."""
        for topic in self._topics:
            if topic.name in (name, f"/{name}"):
                return topic
        names = ", ".join(topic.name for topic in self._topics)
        raise InputError(f"{self.path} has no topic {name}: it has {names}")

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield the messages of some topics, or all, by time of recording.

        Those of one time come in the order of the file.
        """
        names = [topic.name for topic in self._topics] if topics is None else topics
        return self._merged([self.topic(name).name for name in names])

    def _merged(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of the files, of which those that overlap are open at once."""
        files = list(self._files)
        while files:
            group = [files.pop(0)]
            while files and (files[0].start_ns or 0) <= max(file.end_ns or 0 for file in group):
                group.append(files.pop(0))
            streams = [file.messages(wanted) for file in group]
            yield from heapq.merge(*streams, key=lambda message: message.log_time_ns)

    def _joined(self) -> tuple[Topic, ...]:
        """Return the topics of the files, each with the messages of all its channels."""
        found: dict[str, Topic] = {}
        for topic in (topic for file in self._files for topic in file.topics):
            same = found.get(topic.name, replace(topic, message_count=0))
            if same.type_name != topic.type_name:
                raise InputError(
                    f"{self.path}: topic {topic.name} has two types, {same.type_name} and "
                    f"{topic.type_name}: record it again"
                )
            count = same.message_count + topic.message_count
            found[topic.name] = replace(same, message_count=count)
        return tuple(found[name] for name in sorted(found))

    # Finding and opening the files

    def _find_files(self) -> list[Path]:
        if not exists(self.path):
            raise InputError(f"{self.path} does not exist: {_EXPECTED}")
        if not is_folder(self.path):
            return [self.path]
        listed = self._read_metadata()
        present = [path for path in listed if exists(path)]
        self._warnings += [
            f"{path.name} is listed in {METADATA_FILE} but missing: not used"
            for path in listed
            if path not in present
        ]
        if present:
            return present
        for pattern in _RECORDINGS:
            if found := sorted(one for one in self.path.glob(pattern) if one.is_file()):
                return found
        raise InputError(f"{self.path} holds no bag: expected an .mcap, .db3 or .bag file in it")

    def _read_metadata(self) -> list[Path]:
        path = self.path / METADATA_FILE
        try:
            metadata = yaml.safe_load(path.read_text(encoding="utf-8"))
            metadata = metadata["rosbag2_bagfile_information"]
            names = [Path(str(name)) for name in metadata["relative_file_paths"]]
            if metadata.get("compression_format"):
                # rosbags unpacks its files, or each of its messages.
                return [self.path]
        except (OSError, ValueError, TypeError, KeyError, AttributeError, yaml.YAMLError):
            self._warnings.append(
                f"{METADATA_FILE} is missing or cannot be read (interrupted recording?): all "
                "files are used"
            )
            return []
        return [self.path / name for name in names]

    def _open(self, path: Path) -> BagFile:
        if is_remote(path):
            return read_mcap(path) or self._open_copy(path)
        if path.is_dir():
            return read_rosbag(path)
        try:
            return _read(path)
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror or error}") from None

    def _open_copy(self, path: Path) -> BagFile:
        if self._copies is None:
            self._copies = TemporaryDirectory(prefix="fden_")
        copy = copied(path, self._copies.name)
        with called(copy, path):
            return self._open(copy)


def _read(path: Path) -> BagFile:
    with path.open("rb") as file:
        head = file.read(16)
    if not head:
        raise InputError(f"{path} is empty: {_EXPECTED}")
    if head == _SQLITE3:
        log = path.with_name(path.name + "-wal")
        if log.is_file() and log.stat().st_size:
            raise InputError(
                f"{log.name} was left next to {path.name} (interrupted recording): join them "
                f"with: sqlite3 {path.name} 'PRAGMA journal_mode = DELETE'"
            )
        return read_rosbag(path)
    if head.startswith(_ROS1):
        return read_rosbag(path, is_ros1=True)
    if head.startswith(MAGIC):
        return read_mcap(path) or scan_mcap(path)
    if any(magic.startswith(head) for magic in (MAGIC, _SQLITE3, _ROS1)):
        raise cut_short(path)
    raise InputError(f"{path} is not a bag: {reason_of(head) or _EXPECTED}")


def decode(message: RawMessage) -> Any:
    """Return a message decoded."""
    decoded = decoder(message.type_name)
    try:
        return decoded(message.data)
    except Exception as error:
        raise InputError(
            f"a message on {message.topic} is not a valid {message.type_name}: the bag is damaged "
            "or was made with another version of the type"
        ) from error


def is_bag_file(path: Path) -> bool:
    """Return whether a file is one of a bag by its name."""
    is_file = is_remote(path) or path.is_file()
    return is_file and any(fnmatch.fnmatch(path.name, pattern) for pattern in _RECORDINGS)


def read_truth(bag: BagReader) -> dict[str, Any] | None:
    """Return the truth that a simulated bag carries, as ``fden bag`` writes it; or None."""
    if not any((one.name, one.type_name) == (TRUTH_TOPIC, TRUTH_TYPE) for one in bag.topics):
        return None
    for message in bag.messages([TRUTH_TOPIC]):
        try:
            truth: dict[str, Any] = dict(json.loads(decode(message).data))
        except (ValueError, TypeError) as error:
            raise InputError(
                f"{TRUTH_TOPIC} holds no JSON object ({error}): make it again"
            ) from None
        return truth
    return None
