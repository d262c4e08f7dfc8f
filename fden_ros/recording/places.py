# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Where a recording is: a path of this machine, or a URL that fsspec opens."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from fden_ros.errors import InputError

EXTRA = "pip install '.[cluster]' in the folder of fden_ros"
#: Packages by which fsspec reaches other machines: their errors are of the place.
_CLIENTS = ("aiobotocore", "aiohttp", "asyncssh", "botocore", "fsspec", "s3fs", "sshfs")
#: The index of an MCAP file lies in its last bytes: read so many at a time.
_BLOCK = 1 << 16


@contextmanager
def needs_extra(what: str) -> Iterator[None]:
    """Say what to install where a package of the extra is missing."""
    try:
        yield
    except ImportError as error:
        raise InputError(f"{what} needs an extra ({error}): {EXTRA}") from None
