# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One MCAP file: its topics and its messages, with or without an index, whole or cut off.

The ``mcap`` package reads the summary and parses the rare records. The messages, of which there
are millions, are taken from the chunks here: under 2 µs each instead of 13 µs.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Schema
from mcap.summary import Summary

from fden_ros.recording.places import opened, piece

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")  # opcode, length of what follows
_MESSAGE = struct.Struct("<BQHIQQ")  # record header, channel, sequence, log time, publish time
_CHUNK = struct.Struct("<QQQI")  # first and last log time, uncompressed size, CRC-32
# Files without chunks are read in pieces of about this many bytes.
_PIECE = 1 << 20
# rosbag2 makes chunks of 768 KiB; a damaged size must not ask for all memory.
_LARGEST_CHUNK = 1 << 31
# What the mcap package lets through for bytes that are no MCAP.
_DAMAGE = (McapError, struct.error, ValueError, LookupError, OverflowError, MemoryError, OSError)
_BAD_CHUNK = (struct.error, ValueError, RuntimeError, MemoryError, zstandard.ZstdError)


class Row(NamedTuple):
    """One message as it lies in the file: log time (ns), channel id and bytes."""

    log_time_ns: int
    channel_id: int
    data: bytes


class ChunkError(Exception):
    """A chunk cannot be unpacked."""


@dataclass(frozen=True)
class Span:
    """A stretch of the file that is loaded at once: a chunk, or a run of messages without one.

    Attributes
    ----------
    start_ns
        Smallest log time in it.
    offset, length
        Where the bytes lie: a chunk record's content, or the run of records.
    packed
        Whether the bytes are a chunk record's content.
    cut_off
        Whether the file ends within it.
    channel_ids
        The channels that occur; None when not known.
    """

    start_ns: int
    offset: int
    length: int
    packed: bool
    cut_off: bool = False
    channel_ids: frozenset[int] | None = None


@dataclass
class BagFile:
    """What one file of a bag holds; the messages themselves are read on demand.

    Attributes
    ----------
    path
        The file.
    schemas, channels
        Records by id, as MCAP has them.
    counts
        Messages by channel id.
    start_ns, end_ns
        Times of recording of the first and the last message (ns); None without messages.
    """

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    start_ns: int | None = None
    end_ns: int | None = None


@dataclass
class McapFile(BagFile):
    """One MCAP file.

    Attributes
    ----------
    spans
        Where the messages lie, in the order of the file.
    cut_off_at
        Offset (bytes) from which on the file is incomplete; None when it is whole.
    kept
        The span that was read last, and its bytes.
    """

    spans: list[Span] = field(default_factory=list)
    cut_off_at: int | None = None
    kept: tuple[Span, bytes] | None = field(default=None, repr=False)

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(self.counts.values())

    def load(self, span: Span) -> list[Row]:
        """Return the messages of a span in log-time order.

        Raises
        ------
        ChunkError
            When it is damaged.
        """
        if self.kept is None or self.kept[0] is not span:
            # The beginning is looked at before all is read.
            self.kept = (span, piece(self.path, span.offset, span.length))
        content = self.kept[1]
        rows = list(_rows(_unpack(content, span.cut_off) if span.packed else content))
        rows.sort(key=log_time)
        return rows


def read_mcap(path: Path) -> McapFile:
    """Return what the file at `path` holds, from its index or, without a usable one, by a scan."""
    return read_index(path) or _Scan(path).file


def log_time(row: Row) -> int:
    """Return the log time of a row (ns), to sort and to search by."""
    return row.log_time_ns


def read_index(path: Path) -> McapFile | None:
    """Return what the index of a file says that it holds; None without a usable one."""
    with opened(path) as stream:
        try:
            summary = SeekingReader(stream).get_summary()
        except _DAMAGE:
            return None
    if summary is None or not _is_complete(summary, path.stat().st_size):
        return None
    statistics = summary.statistics
    file = McapFile(path, dict(summary.schemas), dict(summary.channels))
    if statistics is None or statistics.message_count == 0:
        return file
    file.counts.update(statistics.channel_message_counts)
    file.start_ns = statistics.message_start_time
    file.end_ns = statistics.message_end_time
    file.spans = [
        Span(
            start_ns=index.message_start_time,
            offset=index.chunk_start_offset + _RECORD.size,
            length=index.chunk_length - _RECORD.size,
            packed=True,
            channel_ids=frozenset(index.message_index_offsets) or None,
        )
        for index in sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
    ]
    return file


def _is_complete(summary: Summary, size: int) -> bool:
    statistics = summary.statistics
    if statistics is None:
        return False
    counts = statistics.channel_message_counts
    return (
        sum(counts.values()) == statistics.message_count
        and counts.keys() <= summary.channels.keys()
        and all(
            c.schema_id in summary.schemas or not c.schema_id for c in summary.channels.values()
        )
        and len(summary.chunk_indexes) == statistics.chunk_count
        and bool(summary.chunk_indexes) == bool(statistics.message_count)
        and all(i.chunk_start_offset + i.chunk_length <= size for i in summary.chunk_indexes)
    )


class _Scan:
    """Walks over the records of a file from its start to where it ends or breaks."""

    def __init__(self, path: Path) -> None:
        self.file = McapFile(path)
        self._size = path.stat().st_size
        self._run_offset = 0
        self._run_start_ns: int | None = None
        with path.open("rb") as stream:
            stream.seek(len(MAGIC))
            self._walk(stream)

    def _walk(self, stream: BinaryIO) -> None:
        while True:
            offset = stream.tell()
            head = stream.read(_RECORD.size)
            if len(head) < _RECORD.size:
                self._break_off(offset)
                return
            opcode, length = _RECORD.unpack(head)
            end = offset + _RECORD.size + length
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                self._close_run(offset)
                return
            if end > self._size:
                if opcode == Opcode.CHUNK:
                    self._close_run(offset)
                    # A damaged length may be more than memory holds.
                    left = self._size - offset - _RECORD.size
                    content = Span(0, offset + _RECORD.size, left, packed=True, cut_off=True)
                    self._add_chunk(stream, content)
                self._break_off(offset)
                return
            self._take(stream, opcode, offset, length)
            stream.seek(end)

    def _take(self, stream: BinaryIO, opcode: int, offset: int, length: int) -> None:
        if opcode == Opcode.MESSAGE:
            stream.seek(offset)
            _, _, channel_id, _, log_time_ns, _ = _MESSAGE.unpack(stream.read(_MESSAGE.size))
            if self._run_start_ns is None:
                self._run_offset, self._run_start_ns = offset, log_time_ns
            self._run_start_ns = min(self._run_start_ns, log_time_ns)
            self._count(channel_id, log_time_ns)
            if offset - self._run_offset > _PIECE:
                self._close_run(offset + _RECORD.size + length)
            return
        self._close_run(offset)
        if opcode == Opcode.CHUNK:
            self._add_chunk(stream, Span(0, offset + _RECORD.size, length, packed=True))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._register(opcode, stream.read(length))

    def _add_chunk(self, stream: BinaryIO, span: Span) -> None:
        content = stream.read(span.length)
        try:
            records = _unpack(content, span.cut_off)
        except ChunkError:
            # Counted as nothing here; whoever loads it meets the damage again and says so.
            self.file.spans.append(span)
            return
        for opcode, body in _rare_records(records):
            self._register(opcode, body)
        rows = list(_rows(records))
        for row in rows:
            self._count(row.channel_id, row.log_time_ns)
        if rows:
            start_ns = min(row.log_time_ns for row in rows)
            channel_ids = frozenset(row.channel_id for row in rows)
            self.file.spans.append(
                Span(start_ns, span.offset, span.length, True, span.cut_off, channel_ids)
            )

    def _register(self, opcode: int, body: bytes) -> None:
        stream = ReadDataStream(BytesIO(body))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self.file.schemas[schema.id] = schema
            else:
                channel = Channel.read(stream)
                self.file.channels[channel.id] = channel
        except _DAMAGE:
            return

    def _count(self, channel_id: int, log_time_ns: int) -> None:
        file = self.file
        file.counts[channel_id] += 1
        if file.start_ns is None or log_time_ns < file.start_ns:
            file.start_ns = log_time_ns
        if file.end_ns is None or log_time_ns > file.end_ns:
            file.end_ns = log_time_ns

    def _close_run(self, end: int) -> None:
        if self._run_start_ns is None:
            return
        length = end - self._run_offset
        self.file.spans.append(Span(self._run_start_ns, self._run_offset, length, packed=False))
        self._run_start_ns = None

    def _break_off(self, offset: int) -> None:
        self._close_run(offset)
        self.file.cut_off_at = offset


def _rows(records: bytes) -> Iterator[Row]:
    offset, size = 0, len(records)
    unpack, message_opcode, head = _MESSAGE.unpack_from, int(Opcode.MESSAGE), _RECORD.size
    # The smallest record that can follow is shorter than a message's head: pad what is unpacked.
    padded = records + bytes(_MESSAGE.size)
    while offset + head <= size:
        opcode, length, channel_id, _, log_time_ns, _ = unpack(padded, offset)
        end = offset + head + length
        if end > size:
            return
        if opcode == message_opcode:
            yield Row(log_time_ns, channel_id, records[offset + _MESSAGE.size : end])
        offset = end


def _rare_records(records: bytes) -> Iterator[tuple[int, bytes]]:
    offset = 0
    while offset + _RECORD.size <= len(records):
        opcode, length = _RECORD.unpack_from(records, offset)
        offset += _RECORD.size
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            yield opcode, records[offset : offset + length]
        offset += length


def _unpack(content: bytes, cut_off: bool) -> bytes:
    """Return the records in a chunk; of one that is cut off, as many bytes as can be had."""
    try:
        _, _, size, crc = _CHUNK.unpack_from(content)
        offset = _CHUNK.size + 4
        (name_length,) = struct.unpack_from("<I", content, _CHUNK.size)
        compression = content[offset : offset + name_length].decode()
        offset += name_length
        (data_length,) = struct.unpack_from("<Q", content, offset)
        data = content[offset + 8 : offset + 8 + data_length]
        if size > _LARGEST_CHUNK:
            raise ChunkError("its size is impossible")
        if cut_off:
            return _PARTIAL[compression](data)
        records = _DECOMPRESS[compression](data, size)
    except KeyError as error:
        raise ChunkError(f"unknown compression {error}") from None
    except _BAD_CHUNK as error:
        raise ChunkError(str(error)) from None
    if len(records) != size or (crc and zlib.crc32(records) != crc):
        raise ChunkError("checksum differs")
    return records


_DECOMPRESS: dict[str, Callable[[bytes, int], bytes]] = {
    "": lambda data, size: data,
    "zstd": lambda data, size: zstandard.decompress(data, max_output_size=size),
    "lz4": lambda data, size: lz4.frame.decompress(data),
}
_PARTIAL: dict[str, Callable[[bytes], bytes]] = {
    "": lambda data: data,
    "zstd": lambda data: zstandard.ZstdDecompressor().decompressobj().decompress(data),
    "lz4": lambda data: lz4.frame.LZ4FrameDecompressor().decompress(data),
}
