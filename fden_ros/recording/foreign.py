# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Files of other programs, neither bags nor text tables, and how to convert them."""

from __future__ import annotations

_AS_CSV = "save its columns as CSV"
#: By the first bytes of a file: its kind, and what to do.
_KINDS: tuple[tuple[bytes | tuple[bytes, ...], str], ...] = (
    (b"PK\x03\x04", "it is a zip archive or a workbook: unpack it, or save its sheet as CSV"),
    (b"\xd0\xcf\x11\xe0", "it is a workbook: save its sheet as CSV"),
    (b"\x1f\x8b", "it is compressed with gzip: unpack it, or name it .csv.gz"),
    (b"\x28\xb5\x2f\xfd", "it is compressed with zstd: unpack it with zstd -d"),
    (b"\x04\x22\x4d\x18", "it is compressed with lz4: unpack it with lz4 -d"),
    (b"7z\xbc\xaf", "it is compressed with 7-Zip: unpack it"),
    (b"MATLAB", f"it is a MATLAB file: {_AS_CSV}"),
    (b"\x89HDF", f"it is an HDF5 file, such as MATLAB 7.3 writes: {_AS_CSV}"),
    (b"PAR1", f"it is a Parquet file: {_AS_CSV}"),
    (b"TDSm", f"it is a LabVIEW TDMS file: {_AS_CSV}"),
    (b"\x93NUMPY", f"it is a numpy array: {_AS_CSV}"),
    ((b"{", b"[{", b"[["), f"it is JSON: {_AS_CSV}"),
    (b"<?xml", f"it is XML: {_AS_CSV}"),
    ((b"<html", b"<!DOCTYPE", b"<table"), f"it is an HTML page: {_AS_CSV}"),
)


def reason_of(head: bytes) -> str:
    """Return the kind of a foreign file and what to do, by its first bytes; "": unknown."""
    begin = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    return next((reason for magic, reason in _KINDS if begin.startswith(magic)), "")
