# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Labelled contacts to learn from: bags, lists of bags, and tables of results."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fden_ros.core.classification.classifier import UNKNOWN
from fden_ros.core.estimation.estimator_config import Prior
from fden_ros.core.outputs import ContactSummary, Flag, OrderSource
from fden_ros.errors import InputError
from fden_ros.experiments.columns import read_table
from fden_ros.offline.rows import CORRELATIONS
from fden_ros.parameters import Parameters, pipeline_config
from fden_ros.recording.source import Selection
from fden_ros.recording.table import TABLE_SUFFIXES
from fden_ros.tissues.training import Contacts, contacts_of

_LABEL = re.compile(r"(?P<tissue>[^=/]+)(?:/(?P<specimen>[^=]+))?=(?P<path>.+)", re.DOTALL)
_VALUES = ("g", "g_n", "alpha")
_NOT_CONVERGED, _NO_ESTIMATE, _UNREADABLE = (
    "not converged",
    "without an estimate",
    "bags that cannot be read",
)
_NO_DEVIATION = 1e-6


@dataclass(frozen=True)
class Source:
    """One argument: where contacts are, and what is known of all of them."""

    path: Path
    tissue: str = ""
    specimen: str = ""

    @staticmethod
    def parse(text: str) -> Source:
        """Return the source of ``PATH``, ``TISSUE=PATH`` or ``TISSUE/SPECIMEN=PATH``."""
        match = None if Path(text).exists() else _LABEL.fullmatch(text)
        if match is None:
            return Source(Path(text))
        return Source(Path(match["path"]), match["tissue"].strip(), match["specimen"] or "")


@dataclass(frozen=True)
class Columns:
    """Names of the columns that say what a row belongs to."""

    tissue: str = "tissue"
    specimen: str = "specimen"


class _Rows:
    """Contacts as they come in."""

    def __init__(self, prior: Prior | None) -> None:
        self._prior = prior
        self._tissues: list[str] = []
        self._specimens: list[str] = []
        self._means: list[Any] = []
        self._covariances: list[Any] = []
        self._counts: list[bool] = []
        self._names: list[str] = []
        self.mismatched = 0
        self.skipped: Counter[str] = Counter()

    def add(
        self,
        group: tuple[str, str],
        estimate: tuple[Any, Any],
        order_counts: bool,
        mismatch: bool,
        name: str,
    ) -> None:
        tissue, specimen = group
        if tissue == UNKNOWN:
            raise InputError(
                f"{name}: a tissue cannot be called `{UNKNOWN}`: that is what fits none; leave "
                "these contacts out"
            )
        self._tissues.append(tissue)
        self._specimens.append(specimen)
        self._means.append(estimate[0])
        self._covariances.append(estimate[1])
        self._counts.append(order_counts)
        self._names.append(name)
        self.mismatched += mismatch

    def contacts(self, source: str) -> Contacts:
        return contacts_of(
            self._tissues,
            self._specimens,
            np.array(self._means, dtype=float).reshape(-1, 3),
            np.array(self._covariances, dtype=float).reshape(-1, 3, 3),
            self._prior,
            self._counts,
            names=tuple(self._names),
            sources=(source,),
            mismatched=self.mismatched,
            skipped=dict(self.skipped),
        )


def read_source(
    source: Source,
    parameters: Parameters,
    selection: Selection | None = None,
    columns: Columns | None = None,
) -> Contacts:
    """Return the contacts of a source.

    Parameters
    ----------
    source : Source
        A bag, a folder of bags, a table of results (CSV, TSV or Parquet), or a table that lists
        bags.
    parameters : mapping
        Checked parameter values: bags are identified with them, and the prior in them is taken
        out of results that have a column ``alpha_source``, as those of ``fden`` do.
    selection : Selection, optional
        Topics or fields of bags.
    columns : Columns, optional

    Raises
    ------
    InputError
        If it cannot be read, or does not say which tissue the contacts are of.
    """
    columns = columns or Columns()
    if not source.path.exists():
        raise InputError(
            f"{source.path}: no such file or folder; give TISSUE=BAG, TISSUE/SPECIMEN=BAG, or a "
            "table with a column tissue"
        )
    if source.path.suffix in (*TABLE_SUFFIXES, ".parquet"):
        return _from_table(source, parameters, selection, columns)
    _require_tissue(source, columns)
    return _from_bags(
        [(bag, source.tissue, source.specimen) for bag in _bags(source.path)],
        parameters,
        selection,
        str(source.path),
    )


def _require_tissue(source: Source, columns: Columns) -> None:
    if not source.tissue:
        raise InputError(
            f"{source.path}: which tissue is it? Write TISSUE={source.path}, or "
            f"TISSUE/SPECIMEN={source.path}; in a table, a column {columns.tissue} says it"
        )


def _bags(path: Path) -> list[Path]:
    from fden_ros.offline.batch import find_bags

    return find_bags([str(path)])


def _from_bags(
    bags: Iterable[tuple[Path, str, str]],
    parameters: Parameters,
    selection: Selection | None,
    name: str,
) -> Contacts:
    from fden_ros.offline.replay import replay

    # What the present library makes of them does not matter, nor whether it fits.
    own = parameters.changed({"classifier.library": ""})
    rows = _Rows(pipeline_config(own).estimator.prior)
    for bag, tissue, specimen in bags:
        for summary in replay(bag, own, selection).summaries:
            _add_summary(rows, summary, tissue, specimen, f"{bag}, contact {summary.contact_id}")
    return rows.contacts(name)


def _add_summary(
    rows: _Rows, summary: ContactSummary, tissue: str, specimen: str, name: str
) -> None:
    estimate = summary.estimate
    if estimate is None:
        rows.skipped[_NO_ESTIMATE] += 1
    elif not summary.converged:
        rows.skipped[_NOT_CONVERGED] += 1
    else:
        rows.add(
            (tissue, specimen),
            (estimate.mean, estimate.covariance),
            summary.order_source is not OrderSource.GIVEN,
            bool(summary.flags & Flag.MODEL_MISMATCH),
            name,
        )


# Tables


def _from_table(
    source: Source,
    parameters: Parameters,
    selection: Selection | None,
    columns: Columns,
) -> Contacts:
    rows, names = read_rows(source.path)
    if columns.tissue not in names and not source.tissue:
        hint = (
            "; its column label is what the classifier said, not the truth"
            if "label" in names
            else ""
        )
        raise InputError(
            f"{source.path}: which tissue is it? Add a column {columns.tissue} (or name yours "
            f"with --tissue-column), or write TISSUE={source.path}{hint}"
        )
    if "g" not in names and "bag" in names:
        bags = [
            (
                source.path.parent / str(row["bag"]),
                *_group(row, source, columns, f"{source.path}: row {i + 1}"),
            )
            for i, row in enumerate(rows)
        ]
        return _from_bags(bags, parameters, selection, str(source.path))
    missing = [name for name in ("g", "g_sd", "g_n", "g_n_sd") if name not in names]
    if missing:
        raise InputError(
            f"{source.path}: column {missing[0]} is missing; a table of results has g, g_sd, "
            "g_n, g_n_sd, and alpha, alpha_sd where known; a list of bags has bag"
        )
    is_posterior = "alpha_source" in names
    config = pipeline_config(parameters.changed({"classifier.library": ""}))
    found = _Rows(config.estimator.prior if is_posterior else None)
    for index, row in enumerate(rows):
        _add_row(found, row, source, columns, f"{source.path}: row {index + 1}")
    return found.contacts(str(source.path))


def _group(
    row: Mapping[str, Any], source: Source, columns: Columns, where: str
) -> tuple[str, str]:
    tissue = source.tissue or str(row.get(columns.tissue) or "").strip()
    if not tissue:
        raise InputError(f"{where}: {columns.tissue} is empty; name the tissue or drop the row")
    specimen = row.get(columns.specimen)
    return tissue, source.specimen or ("" if specimen is None else str(specimen).strip())


def _add_row(
    found: _Rows, row: Mapping[str, Any], source: Source, columns: Columns, where: str
) -> None:
    if _number(row, "g", where) is None:
        found.skipped[_NO_ESTIMATE] += 1
        return
    if str(row.get("converged", True)).lower() in ("false", "0"):
        found.skipped[_NOT_CONVERGED] += 1
        return
    values = [_number(row, name, where) for name in _VALUES]
    deviations = [_number(row, f"{name}_sd", where) for name in _VALUES]
    given = str(row.get("alpha_source", "")) in ("given", "none")
    order_counts = values[2] is not None and bool(deviations[2]) and not given
    if values[2] is None:
        values[2], deviations[2] = 0.2, 1.0
    for name, value, deviation in zip(_VALUES[:2], values, deviations, strict=False):
        if value is None or deviation is None or value <= 0.0 or deviation <= 0.0:
            raise InputError(
                f"{where}: {name} and {name}_sd are {value} and {deviation}, must be positive; "
                "the standard deviation is what tells estimation error from spread"
            )
    g, g_n, order = (float(value or 0.0) for value in values)
    scale = [
        float(deviations[0] or 0.0) / g,
        float(deviations[1] or 0.0) / g_n,
        float(deviations[2] or _NO_DEVIATION),
    ]
    covariance = np.diag(np.square(scale))
    for name, (i, j) in CORRELATIONS.items():
        correlation = _number(row, name, where) or 0.0
        covariance[i, j] = covariance[j, i] = correlation * scale[i] * scale[j]
    found.add(
        _group(row, source, columns, where),
        (np.array([math.log(g), math.log(g_n), order]), covariance),
        order_counts,
        "model_mismatch" in str(row.get("flags") or ""),
        where,
    )


def _number(row: Mapping[str, Any], name: str, where: str) -> float | None:
    value = row.get(name)
    if value is None or value == "":
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{where}: {name} is {value!r}, must be a number") from None
    return number if math.isfinite(number) else None


def read_rows(path: Path) -> tuple[Sequence[Mapping[str, Any]], tuple[str, ...]]:
    """Return the rows of a table (CSV, TSV or Parquet) and the names of its columns.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    if path.suffix == ".parquet":
        return _parquet(path)
    table = read_table(path)
    rows = [
        dict(zip(table.names, (*row, *[""] * len(table.names)), strict=False))
        for row in table.rows
    ]
    return rows, table.names


def _parquet(path: Path) -> tuple[Sequence[Mapping[str, Any]], tuple[str, ...]]:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise InputError(
            f"{path}: Parquet needs pyarrow: pip install 'fden_ros[batch]', or give CSV"
        ) from None
    try:
        table = parquet.read_table(path)
    except (pyarrow.ArrowException, OSError) as error:
        raise InputError(f"{path}: not a Parquet table: {' '.join(str(error).split())}") from None
    return table.to_pylist(), tuple(table.column_names)
