# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Writing rosbag2 folders: an MCAP file and ``metadata.yaml``, as ``ros2 bag record`` does."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import yaml
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, Writer

from fden_ros.errors import InputError
from fden_ros.recording.cdr import serialize
from fden_ros.recording.definitions import full_type_name, message_definition, type_hash
from fden_ros.recording.qos import RELIABLE, Qos, dump_profiles

# rosbag2_storage/bag_metadata.hpp of Jazzy.
_METADATA_VERSION = 9
_METADATA_FILE = "metadata.yaml"
# What rosbag2 writes as the start of a bag without messages.
_NO_START = 2**63 - 1


class BagWriter:
    """Write a bag; nothing is seen of it before it is complete.

    The bag grows in a hidden folder beside the target, which takes its name when the ``with``
    block ends. An exception inside the block leaves nothing behind. The same messages give the
    same bytes.

    Parameters
    ----------
    folder
        The bag folder to make; its parent is made too.
    overwrite
        Replace a bag that is there already. Only a bag is ever replaced, or an empty folder.

    Raises
    ------
    InputError
        When the target exists (and is not to be, or must not be, replaced) or cannot be written.
    """

    def __init__(self, folder: str | Path, *, overwrite: bool = False) -> None:
        self.target = Path(os.path.abspath(folder))
        self._overwrite = overwrite
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._types: dict[str, tuple[str, tuple[Qos, ...]]] = {}
        self._counts: dict[str, int] = {}
        self._first_ns = _NO_START
        self._last_ns = 0

    @property
    def folder(self) -> Path:
        """Where the bag grows: files put here become part of it."""
        return self._folder

    @property
    def message_count(self) -> int:
        """How many messages were written so far."""
        return sum(self._counts.values())

    def __enter__(self) -> BagWriter:
        """Make the hidden folder and start the file."""
        self._check_target()
        with self._one_line(), contextlib.ExitStack() as on_failure:
            self.target.parent.mkdir(parents=True, exist_ok=True)
            self._folder = self._hidden_folder()
            # Not entered, so never left: an interruption here would leave the folder behind.
            on_failure.callback(shutil.rmtree, self._folder, ignore_errors=True)
            self._file: BinaryIO = (self._folder / self._file_name).open("wb")
            self._writer = Writer(self._file, compression=CompressionType.ZSTD)
            # A library name without a version: the bytes are the same on every machine.
            self._writer.start(profile=Profile.ROS2, library="fden_ros")
            on_failure.pop_all()
        return self

    def __exit__(
        self,
        exception_type: type[BaseException] | None,
        exception: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Finish the bag and give it its name, or remove it after an exception."""
        try:
            if exception_type is None:
                with self._one_line():
                    self._finish()
        finally:
            self._file.close()
            shutil.rmtree(self._folder, ignore_errors=True)

    def add_topic(self, topic: str, type_name: str, *offered_qos: Qos) -> None:
        """Declare a topic before its first message.

        Parameters
        ----------
        topic
            Full name, such as ``/force``.
        type_name
            Message type, such as ``geometry_msgs/msg/WrenchStamped``.
        *offered_qos
            What the publishers offer; `RELIABLE` when nothing is given.

        Raises
        ------
        InputError
            When the type is not installed, or the topic is there with another type.
        """
        type_name = full_type_name(type_name)
        if topic in self._types:
            raise InputError(f"topic {topic} is in the bag already: declare it once")
        profiles = offered_qos or (RELIABLE,)
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(
                type_name, SchemaEncoding.ROS2, message_definition(type_name).encode()
            )
        self._channels[topic] = self._writer.register_channel(
            topic,
            MessageEncoding.CDR,
            self._schemas[type_name],
            {
                "offered_qos_profiles": dump_profiles(profiles),
                "topic_type_hash": type_hash(type_name),
            },
        )
        self._types[topic] = (type_name, profiles)
        self._counts[topic] = 0

    def write(
        self, topic: str, message: Any, stamp_ns: int, *, receive_ns: int | None = None
    ) -> None:
        """Write one message.

        Parameters
        ----------
        topic
            A topic declared with `add_topic`.
        message
            The message, or its CDR bytes.
        stamp_ns
            Time of publication (ns since the epoch).
        receive_ns
            Time of recording (ns), by which bags are ordered; `stamp_ns` when not given.

        Raises
        ------
        InputError
            When the topic is not declared or the disk is full.
        """
        if topic not in self._channels:
            raise InputError(f"topic {topic} is not in the bag: declare it with add_topic first")
        data = message if isinstance(message, bytes) else serialize(message)
        log_ns = stamp_ns if receive_ns is None else receive_ns
        try:
            self._writer.add_message(
                self._channels[topic],
                log_time=log_ns,
                data=data,
                publish_time=stamp_ns,
                sequence=self._counts[topic],
            )
        except OSError as error:
            raise self._unwritable(error) from error
        self._counts[topic] += 1
        self._first_ns = min(self._first_ns, log_ns)
        self._last_ns = max(self._last_ns, log_ns)

    @property
    def _file_name(self) -> str:
        return f"{self.target.name}_0.mcap"

    def _hidden_folder(self) -> Path:
        return Path(tempfile.mkdtemp(prefix=f".{self.target.name}.", dir=self.target.parent))

    def _check_target(self) -> None:
        if not os.path.lexists(self.target):
            return
        if self.target.is_dir() and not any(self.target.iterdir()):
            return
        if not self._overwrite:
            raise InputError(f"{self.target} exists: choose another or replace it (--force)")
        if not (self.target / _METADATA_FILE).is_file():
            raise InputError(f"{self.target} is not a bag, so it is not replaced: choose another")

    def _finish(self) -> None:
        metadata = self._metadata()
        # A reader of the bare file finds the metadata in it, as rosbag2 provides.
        self._writer.flush()
        self._writer.add_metadata("rosbag2", {"serialized_metadata": _dump(metadata)})
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        path = self._folder / _METADATA_FILE
        path.write_text(_dump({"rosbag2_bagfile_information": metadata}), encoding="utf-8")
        umask = os.umask(0)
        os.umask(umask)
        self._folder.chmod(0o777 & ~umask)
        self._publish()

    def _publish(self) -> None:
        if not os.path.lexists(self.target):
            self._folder.rename(self.target)
            return
        retired = self._hidden_folder()
        self.target.rename(retired / "old")
        try:
            self._folder.rename(self.target)
        except BaseException:
            (retired / "old").rename(self.target)
            raise
        finally:
            shutil.rmtree(retired, ignore_errors=True)

    def _metadata(self) -> dict[str, Any]:
        start = {"nanoseconds_since_epoch": self._first_ns}
        duration = {"nanoseconds": max(0, self._last_ns - self._first_ns)}
        count = self.message_count
        return {
            "version": _METADATA_VERSION,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": topic,
                        "type": type_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": [qos.to_dict() for qos in profiles],
                        "type_description_hash": type_hash(type_name),
                    },
                    "message_count": self._counts[topic],
                }
                for topic, (type_name, profiles) in self._types.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._file_name],
            "files": [
                {
                    "path": self._file_name,
                    "starting_time": start,
                    "duration": duration,
                    "message_count": count,
                }
            ],
            "custom_data": None,
            "ros_distro": "jazzy",
        }

    @contextlib.contextmanager
    def _one_line(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> InputError:
        return InputError(
            f"{self.target} cannot be written ({error.strerror}): choose another place"
        )


class _PlainDumper(yaml.SafeDumper):
    """YAML without anchors, which not every reader of bags follows."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _dump(value: dict[str, Any]) -> str:
    return yaml.dump(value, Dumper=_PlainDumper, sort_keys=False)
