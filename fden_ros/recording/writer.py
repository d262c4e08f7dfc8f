# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Writing rosbag2 folders, an MCAP file and ``metadata.yaml``, complete or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from fden_ros.errors import InputError
from fden_ros.recording.message_types import full_type_name, known_types, serialize
from fden_ros.recording.qos import RELIABLE, Qos

_METADATA_FILE = "metadata.yaml"


class BagWriter:
    """Write a bag into a folder; it is not visible before it is complete.

    The bag grows in a hidden folder next to the target, and is renamed when the ``with``
    block ends. An exception inside the block leaves nothing behind. The same messages give the
    same bytes. With `overwrite` an existing bag is replaced, and nothing but a bag.
    """

    def __init__(self, folder: str | Path, *, overwrite: bool = False) -> None:
        self.target = Path(os.path.abspath(folder))
        self._overwrite = overwrite
        self._topics: dict[str, Connection] = {}

    @property
    def folder(self) -> Path:
        """Where the bag grows: files put here become part of it."""
        return self._writer.path

    def __enter__(self) -> BagWriter:
        """Make the hidden folder and start the file."""
        self._check_target()
        with self._one_line():
            self.target.parent.mkdir(parents=True, exist_ok=True)
            made = tempfile.mkdtemp(prefix=f".{self.target.name}.", dir=self.target.parent)
            self._hidden = Path(made)
            self._writer = Writer(
                self._hidden / self.target.name, version=9, storage_plugin=StoragePlugin.MCAP
            )
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        return self

    def __exit__(
        self,
        exception_type: type[BaseException] | None,
        exception: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Finish the bag and rename it, or remove it after an exception."""
        try:
            if exception_type is not None:
                self._writer.abort()
                return
            with self._one_line():
                self._writer.close()
                self._publish()
        finally:
            shutil.rmtree(self._hidden, ignore_errors=True)

    def add_topic(self, topic: str, type_name: str, *offered_qos: Qos) -> None:
        """Declare a topic before its first message, with its publishers' offer (`RELIABLE`)."""
        type_name = full_type_name(type_name)
        if topic in self._topics:
            raise InputError(f"topic {topic} is in the bag already: declare it once")
        self._topics[topic] = self._writer.add_connection(
            topic,
            type_name,
            typestore=known_types(type_name),
            offered_qos_profiles=[qos.to_bag() for qos in offered_qos or (RELIABLE,)],
        )

    def write(self, topic: str, message: Any, stamp_ns: int) -> None:
        """Write a message, or its CDR bytes, at its time of recording (ns since the epoch)."""
        if topic not in self._topics:
            raise InputError(f"topic {topic} is not in the bag: declare it with add_topic first")
        data = message if isinstance(message, bytes) else serialize(message)
        with self._one_line():
            self._writer.write(self._topics[topic], stamp_ns, data)

    def _check_target(self) -> None:
        if not os.path.lexists(self.target):
            return
        if self.target.is_dir() and not any(self.target.iterdir()):
            return
        if not self._overwrite:
            raise InputError(f"{self.target} exists: choose another or replace it (--force)")
        if not (self.target / _METADATA_FILE).is_file():
            raise InputError(f"{self.target} is not a bag, so it is not replaced: choose another")

    def _publish(self) -> None:
        retired = self._hidden / "retired"
        if os.path.lexists(self.target):
            self.target.rename(retired)
        try:
            self._writer.path.rename(self.target)
        except BaseException:
            if retired.exists():
                retired.rename(self.target)
            raise

    @contextlib.contextmanager
    def _one_line(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise InputError(
                f"{self.target} cannot be written ({error.strerror}): choose another place"
            ) from error
