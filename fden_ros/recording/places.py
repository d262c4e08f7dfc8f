# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The place of a recording: a path of this machine, or a URL of another that fsspec opens.

``upath`` makes of a URL an object that is used like a path.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fden_ros.errors import InputError

EXTRA = "pip install '.[cluster]' in the folder of fden_ros"
#: End of an error line that another try may not meet.
NOT_REACHED = "cannot be reached"
#: Packages by which fsspec reaches other machines: their errors are of the place.
_CLIENTS = ("aiobotocore", "aiohttp", "asyncssh", "botocore", "fsspec", "s3fs", "sshfs")
_NOT_FOUND = 404
#: A large file of which little is needed is read in pieces of this many bytes.
_PIECE = 1 << 16


@contextmanager
def needs_extra(what: str) -> Iterator[None]:
    """Name what to install where a package of the extra is missing."""
    try:
        yield
    except ImportError as error:
        raise InputError(f"{what} needs an extra ({error}): {EXTRA}") from None


def place(where: str | Path) -> Path:
    """Return a path, or the object that stands for a URL."""
    if not isinstance(where, str):
        return where
    if "://" not in where:
        return Path(where)
    with needs_extra(where):
        import fsspec

        _name_hosts()
        from upath import UPath
    try:
        with needs_extra(where):
            fsspec.get_filesystem_class(where.partition("://")[0])
        found: Any = UPath(where)
    except ValueError as error:
        raise InputError(f"{where} is not a URL that can be read: {error}") from None
    return found


@functools.cache
def _name_hosts() -> None:
    """Let a path of sftp be written with its host, which upath leaves out."""
    from upath.implementations.sftp import SFTPPath
    from upath.registry import register_implementation

    class HostPath(SFTPPath):
        def __str__(self) -> str:
            stated: Any = self.storage_options
            user = f"{stated['username']}@" if stated.get("username") else ""
            port = f":{stated['port']}" if stated.get("port") else ""
            return f"{self.protocol}://{user}{stated['host']}{port}{self.path}"

    for protocol in ("sftp", "ssh"):
        register_implementation(protocol, HostPath, clobber=True)


def is_remote(path: Path) -> bool:
    """Return whether a place is a URL."""
    return not isinstance(path, Path)


@contextmanager
def reached(path: Path) -> Iterator[None]:
    """Return in one line why a URL cannot be read."""
    try:
        yield
    except Exception as error:
        is_of_place = type(error).__module__.partition(".")[0] in _CLIENTS
        if not is_remote(path) or not (is_of_place or isinstance(error, OSError)):
            raise
        if isinstance(error, FileNotFoundError):
            raise InputError(f"{path} does not exist") from None
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path} {NOT_REACHED}: {reason}") from None


def exists(path: Path) -> bool:
    """Return whether there is anything at a place."""
    if not is_remote(path):
        return path.exists()
    with reached(path):
        return _is_there(path)


def _is_there(path: Path) -> bool:
    try:
        path.stat()
    except FileNotFoundError as error:
        # fsspec reports this for any answer of the web, and for none.
        cause = error.__cause__
        is_of_web = type(cause).__module__.startswith("aiohttp")
        if cause is not None and is_of_web and getattr(cause, "status", 0) != _NOT_FOUND:
            raise cause from None
        return False
    return True


def is_folder(path: Path) -> bool:
    """Return whether a place is a folder; on the web, one whose URL ends with a slash."""
    if str(path).startswith(("http://", "https://")):
        return str(path).endswith("/")
    with reached(path):
        return path.is_dir()


def opened(path: Path, **options: Any) -> Any:
    """Open a file of which little is read; `options` are those of fsspec for a URL."""
    remote: Any = path
    return remote.open("rb", block_size=_PIECE, **options) if is_remote(path) else path.open("rb")


def copied(path: Path, folder: str | Path) -> Path:
    """Return the path of a copy of a URL in a folder."""
    copy = Path(folder) / (path.name.partition("?")[0] or "recording")
    remote: Any = path
    remote.fs.get_file(remote.path, str(copy))
    return copy


@contextmanager
def called(copy: Path, path: Path) -> Iterator[None]:
    """Name the URL, not its copy, in errors."""
    try:
        yield
    except InputError as error:
        raise InputError(str(error).replace(str(copy), str(path)), error.hint) from None
