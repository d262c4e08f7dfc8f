# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Labelled contacts to learn from: bags, and tables of results."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fden_ros.core.arrays import Array
from fden_ros.core.classification.classifier import UNKNOWN
from fden_ros.core.estimation.estimator_config import Prior
from fden_ros.core.outputs import ContactSummary, Flag, OrderSource
from fden_ros.errors import InputError
from fden_ros.experiments.columns import read_table
from fden_ros.offline.batch import find_bags
from fden_ros.offline.replay import replay
from fden_ros.offline.rows import CORRELATIONS
from fden_ros.parameters import Parameters, pipeline_config
from fden_ros.recording.source import Selection
from fden_ros.recording.table import TABLE_SUFFIXES
from fden_ros.tissues.training import Contacts, contacts_of

_LABEL = re.compile(r"(?P<tissue>[^=/]+)(?:/(?P<specimen>[^=]+))?=(?P<path>.+)", re.DOTALL)
_VALUES = ("g", "g_n", "alpha")
_NOT_CONVERGED, _NO_ESTIMATE = "not converged", "without an estimate"
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


class _Row(NamedTuple):
    """One contact: its tissue and specimen, and (ln G, ln Gn, alpha) as estimated."""

    tissue: str
    specimen: str
    mean: Array
    covariance: Array
    order_counts: bool
    mismatch: bool


@dataclass
class _Rows:
    """Contacts as they come in."""

    prior: Prior | None
    found: list[_Row] = field(default_factory=list)
    skipped: Counter[str] = field(default_factory=Counter)

    def add(self, row: _Row, name: str) -> None:
        if row.tissue == UNKNOWN:
            raise InputError(
                f"{name}: a tissue cannot be called `{UNKNOWN}`: that is what fits none; leave "
                "these contacts out"
            )
        self.found.append(row)

    def contacts(self, source: str) -> Contacts:
        rows = self.found
        return contacts_of(
            [row.tissue for row in rows],
            [row.specimen for row in rows],
            np.array([row.mean for row in rows], dtype=float).reshape(-1, 3),
            np.array([row.covariance for row in rows], dtype=float).reshape(-1, 3, 3),
            self.prior,
            [row.order_counts for row in rows],
            sources=(source,),
            mismatched=sum(row.mismatch for row in rows),
            skipped=dict(self.skipped),
        )


def read_source(
    source: Source, parameters: Parameters, selection: Selection | None = None
) -> Contacts:
    """Return the contacts of a source.

    Parameters
    ----------
    source : Source
        A bag, a folder of bags, or a table of results (CSV, TSV), whose columns ``tissue`` and
        ``specimen`` count where the source does not say them.
    parameters : mapping
        Checked parameter values: bags are identified with them, and the prior in them is taken
        out of results that have a column ``alpha_source``, as those of ``fden`` do.
    selection : Selection, optional
        Topics or fields of bags.

    Raises
    ------
    InputError
        If it cannot be read, or does not say which tissue the contacts are of.
    """
    if not source.path.exists():
        raise InputError(
            f"{source.path}: no such file or folder; give TISSUE=BAG, TISSUE/SPECIMEN=BAG, or a "
            "table with a column tissue"
        )
    if source.path.suffix in TABLE_SUFFIXES:
        return _from_table(source, parameters)
    if not source.tissue:
        raise InputError(
            f"{source.path}: which tissue is it? Write TISSUE={source.path}, or "
            f"TISSUE/SPECIMEN={source.path}"
        )
    return _from_bags(source, parameters, selection)


def _from_bags(source: Source, parameters: Parameters, selection: Selection | None) -> Contacts:
    # What the present library makes of them does not matter, nor whether it fits.
    own = parameters.changed({"classifier.library": ""})
    rows = _Rows(pipeline_config(own).estimator.prior)
    for bag in find_bags([str(source.path)]):
        for summary in replay(bag, own, selection).summaries:
            _add_summary(rows, summary, source, f"{bag}, contact {summary.contact_id}")
    return rows.contacts(str(source.path))


def _add_summary(rows: _Rows, summary: ContactSummary, source: Source, name: str) -> None:
    estimate = summary.estimate
    if estimate is None:
        rows.skipped[_NO_ESTIMATE] += 1
    elif not summary.converged:
        rows.skipped[_NOT_CONVERGED] += 1
    else:
        is_learned = summary.order_source is not OrderSource.GIVEN
        mismatch = bool(summary.flags & Flag.MODEL_MISMATCH)
        group = source.tissue, source.specimen
        rows.add(_Row(*group, estimate.mean, estimate.covariance, is_learned, mismatch), name)


# Tables


def _from_table(source: Source, parameters: Parameters) -> Contacts:
    table = read_table(source.path)
    if "tissue" not in table and not source.tissue:
        is_labelled = "label" in table
        hint = (
            "; its column label is what the classifier said, not the truth" if is_labelled else ""
        )
        raise InputError(
            f"{source.path}: which tissue is it? Add a column tissue, or write "
            f"TISSUE={source.path}{hint}"
        )
    missing = [name for name in ("g", "g_sd", "g_n", "g_n_sd") if name not in table]
    if missing:
        raise InputError(
            f"{source.path}: column {missing[0]} is missing; a table of results has g, g_sd, "
            "g_n, g_n_sd, and alpha, alpha_sd where known"
        )
    is_posterior = "alpha_source" in table
    config = pipeline_config(parameters.changed({"classifier.library": ""}))
    found = _Rows(config.estimator.prior if is_posterior else None)
    for index, cells in enumerate(table.rows):
        row = dict(zip(table.names, cells, strict=False))
        _add_row(found, row, source, f"{source.path}: row {index + 1}")
    return found.contacts(str(source.path))


def _group(row: Mapping[str, str], source: Source, where: str) -> tuple[str, str]:
    tissue = source.tissue or row.get("tissue", "").strip()
    if not tissue:
        raise InputError(f"{where}: tissue is empty; name the tissue or drop the row")
    return tissue, source.specimen or row.get("specimen", "").strip()


def _add_row(found: _Rows, row: Mapping[str, str], source: Source, where: str) -> None:
    if _number(row, "g", where) is None:
        found.skipped[_NO_ESTIMATE] += 1
        return
    if row.get("converged", "").lower() in ("false", "0"):
        found.skipped[_NOT_CONVERGED] += 1
        return
    values = [_number(row, name, where) for name in _VALUES]
    deviations = [_number(row, f"{name}_sd", where) for name in _VALUES]
    given = row.get("alpha_source", "") in ("given", "none")
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
    mean, flags = np.array([math.log(g), math.log(g_n), order]), row.get("flags", "")
    group = _group(row, source, where)
    own = _Row(*group, mean, covariance, order_counts, "model_mismatch" in flags)
    found.add(own, where)


def _number(row: Mapping[str, str], name: str, where: str) -> float | None:
    value = row.get(name, "")
    if not value:
        return None
    try:
        number = float(value)
    except ValueError:
        raise InputError(f"{where}: {name} is {value!r}, must be a number") from None
    return number if math.isfinite(number) else None
