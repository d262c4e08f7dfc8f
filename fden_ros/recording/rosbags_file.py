# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One file of an older kind of bag, sqlite3 or ROS 1: its topics and its messages, as CDR.

The package ``rosbags`` reads both. Of ROS 1 it turns every message into ROS 2's encoding, whose
header has no ``seq``, so that what follows need not know which kind a bag is.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag1,
    ConnectionExtRosbag2,
    MessageDefinitionFormat,
)
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fden_ros.errors import InputError
from fden_ros.recording.mcap_file import BagFile, Row
from fden_ros.recording.qos import LATCHED, Qos, dump_profiles

_HEADER = "std_msgs/msg/Header"
_ENCODINGS = {
    MessageDefinitionFormat.MSG: SchemaEncoding.ROS2,
    MessageDefinitionFormat.IDL: "ros2idl",
}

#: Definition and hash of the type of a connection, by its number.
_Types = dict[int, tuple[str, str]]
_Convert = Callable[[bytes, str], bytes]


class DamageError(Exception):
    """The rest of a file cannot be read."""


@dataclass
class RosbagsFile(BagFile):
    """One file that the package reads: how it is opened, and its messages turned into CDR."""

    open: Callable[[], AbstractContextManager[Any]] = field(kw_only=True)
    convert: _Convert = field(kw_only=True)

    def rows(self, channel_ids: Collection[int]) -> Iterator[Row]:
        """Yield the messages of some channels by time of recording.

        Raises
        ------
        DamageError
            Where the file breaks.
        """
        try:
            with self.open() as reader:
                wanted = [c for c in reader.connections if c.id in channel_ids]
                if not wanted:
                    return
                for connection, time_ns, data in reader.messages(wanted):
                    yield Row(time_ns, connection.id, self.convert(data, connection.msgtype))
        except Exception as error:
            # For bytes that are no bag the package lets through errors of every kind.
            raise DamageError(_reason(error)) from None


def read_sqlite3(path: Path) -> RosbagsFile:
    """Return what the sqlite3 file at `path` holds.

    Raises
    ------
    InputError
        If it is damaged, or none of rosbag2.
    """

    def take(connections: Sequence[Connection]) -> _Types:
        return {c.id: (c.msgdef.data, c.digest) for c in connections}

    return _read(path, lambda: Ros2Reader(path), take, lambda data, type_name: data)


def read_ros1(path: Path) -> RosbagsFile:
    """Return what the ROS 1 bag at `path` holds.

    Raises
    ------
    InputError
        If it is damaged, or was not closed.
    """
    types = get_typestore(Stores.EMPTY)

    def take(connections: Sequence[Connection]) -> _Types:
        found: dict[str, Any] = {}
        for connection in connections:
            found |= get_types_from_msg(connection.msgdef.data, connection.msgtype)
        if _HEADER in found:
            found[_HEADER] = get_typestore(Stores.ROS2_JAZZY).fielddefs[_HEADER]
        types.register(found)
        return {
            c.id: (
                types.generate_msgdef(c.msgtype, ros_version=2)[0],
                types.hash_rihs01(c.msgtype),
            )
            for c in connections
        }

    return _read(
        path,
        lambda: Ros1Reader(path),
        take,
        lambda data, type_name: bytes(types.ros1_to_cdr(data, type_name)),
    )


def _read(
    path: Path,
    opened: Callable[[], AbstractContextManager[Any]],
    types_of: Callable[[Sequence[Connection]], _Types],
    convert: _Convert,
) -> RosbagsFile:
    file = RosbagsFile(path, open=opened, convert=convert)
    try:
        with opened() as reader:
            types = types_of(reader.connections)
            for connection in reader.connections:
                _add(file, connection, *types[connection.id])
            if reader.message_count:
                file.start_ns, file.end_ns = reader.start_time, reader.end_time - 1
    except Exception as error:
        reason = _reason(error)
        if "not indexed" in reason:
            raise InputError(
                f"{path} was not closed, so it has no index (interrupted recording?): write the "
                f"index where ROS 1 is installed, with: rosbag reindex {shlex.quote(str(path))}"
            ) from None
        raise InputError(f"{path} is damaged ({reason}): copy it anew") from None
    return file


def _add(file: RosbagsFile, connection: Connection, definition: str, digest: str) -> None:
    ext = connection.ext
    is_ros1 = isinstance(ext, ConnectionExtRosbag1)
    number = connection.id
    file.schemas[number] = Schema(
        id=number,
        name=connection.msgtype,
        encoding=SchemaEncoding.ROS2
        if is_ros1
        else _ENCODINGS.get(connection.msgdef.format, SchemaEncoding.ROS2),
        data=definition.encode(),
    )
    file.channels[number] = Channel(
        id=number,
        topic=connection.topic,
        message_encoding=MessageEncoding.CDR
        if not isinstance(ext, ConnectionExtRosbag2)
        else ext.serialization_format,
        metadata={
            "offered_qos_profiles": dump_profiles(_offered(ext)),
            "topic_type_hash": digest,
        },
        schema_id=number,
    )
    file.counts[number] = connection.msgcount


def _offered(ext: ConnectionExtRosbag1 | ConnectionExtRosbag2) -> list[Qos]:
    if isinstance(ext, ConnectionExtRosbag1):
        return [LATCHED] if ext.latching else []
    return [
        Qos(
            reliability=qos.reliability.name.lower(),
            durability=qos.durability.name.lower(),
            depth=max(0, qos.depth),
            history=qos.history.name.lower(),
        )
        for qos in ext.offered_qos_profiles
    ]


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
