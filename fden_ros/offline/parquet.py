# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""A table of results as Parquet."""

from __future__ import annotations

from pathlib import Path

from fden_ros.offline.rows import LISTS
from fden_ros.recording.places import needs_extra

_WORDS = (
    "bag", "configuration", "inputs", "error", "warnings", "frame", "alpha_source", "label",
    *LISTS,
)  # fmt: skip
_WHOLE = (
    "pairs", "contacts", "contact_id", "site", "start_ns", "end_ns", "samples", "rejected",
)  # fmt: skip
_YES_OR_NO = ("converged", "complete")


def write_parquet(table: Path, path: Path) -> None:
    """Write a table (CSV) as Parquet, a block of rows at a time."""
    with needs_extra(".parquet"):
        import pyarrow
        from pyarrow import csv, parquet
    with table.open(encoding="utf-8") as file:
        kinds = dict.fromkeys(file.readline().rstrip().split(","), pyarrow.float64())
    for names, kind in (
        (_WORDS, pyarrow.string()),
        (_WHOLE, pyarrow.int64()),
        (_YES_OR_NO, pyarrow.bool_()),
    ):
        kinds |= dict.fromkeys(names, kind)
    options = csv.ConvertOptions(column_types=kinds, null_values=[""], strings_can_be_null=True)
    draft = path.with_name(f".{path.name}.part")
    with (
        csv.open_csv(table, convert_options=options) as reader,
        parquet.ParquetWriter(draft, reader.schema) as writer,
    ):
        for batch in reader:
            writer.write_batch(batch)
    draft.replace(path)
